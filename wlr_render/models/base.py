"""What all fitted models share: the protocols' queries, asked in chunks of a forward and a backward formula."""

from abc import ABC, abstractmethod
from typing import ClassVar

import numpy as np

from wlr_render.geometry.directions import tangents_of_dir
from wlr_render.mappings import EyeBox, QueryResult
from wlr_render.models.queries import Answer, Forms, answer_in_chunks, require_forms
from wlr_render.numerics.arrays import FloatArray


class FittedModel(ABC):
    """A model made of polynomials; a subclass is a frozen dataclass and gives the two formulas.

    Attributes:
        FORMS: variables and outputs of each polynomial, by attribute name.
        eye_box: where the pupil may be; a viewpoint outside it is OUTSIDE_FIT.
    """

    FORMS: ClassVar[Forms]
    eye_box: EyeBox

    def __post_init__(self) -> None:
        require_forms(self, self.FORMS)

    @abstractmethod
    def _forward(self, subject: FloatArray, viewpoint: FloatArray, start: FloatArray | None) -> Answer:
        """Display: pixels (m, 2) -> view directions. See-through: view tangents (m, 2) -> rays (m, 6)."""

    @abstractmethod
    def _backward(self, subject: FloatArray, viewpoint: FloatArray, start: FloatArray | None) -> Answer:
        """Display: view tangents (m, 2) -> pixels. See-through: points (m, 3) -> view directions."""


class FittedDisplay(FittedModel):
    """`DisplayMapping` by a forward and a backward formula."""

    def view_dir_of_pixel(
        self, pixel: FloatArray, viewpoint: FloatArray, warm_start: FloatArray | None = None
    ) -> QueryResult:
        """Forward; see `mappings.DisplayMapping`."""
        return answer_in_chunks(self._forward, pixel, viewpoint, self.eye_box, warm_start)

    def pixel_of_view_dir(
        self, view_dir: FloatArray, viewpoint: FloatArray, warm_start: FloatArray | None = None
    ) -> QueryResult:
        """Backward; see `mappings.DisplayMapping`."""
        tangents = tangents_of_dir(np.asarray(view_dir))
        return answer_in_chunks(self._backward, tangents, viewpoint, self.eye_box, warm_start)


class FittedSeeThrough(FittedModel):
    """`SeeThroughMapping` by a forward and a backward formula."""

    def real_ray_of_view_dir(
        self, view_dir: FloatArray, viewpoint: FloatArray, warm_start: FloatArray | None = None
    ) -> QueryResult:
        """Forward; see `mappings.SeeThroughMapping`."""
        tangents = tangents_of_dir(np.asarray(view_dir))
        return answer_in_chunks(self._forward, tangents, viewpoint, self.eye_box, warm_start)

    def view_dir_of_real_point(
        self, point: FloatArray, viewpoint: FloatArray, warm_start: FloatArray | None = None
    ) -> QueryResult:
        """Backward; see `mappings.SeeThroughMapping`."""
        in_front = _points_in_front(point, viewpoint)
        return answer_in_chunks(self._backward, in_front, viewpoint, self.eye_box, warm_start)


def _points_in_front(point: FloatArray, viewpoint: FloatArray) -> FloatArray:
    """Real points (..., 3), NaN where they are not in front of the viewpoint (..., 3)."""
    point, viewpoint = np.broadcast_arrays(np.asarray(point, dtype=np.float64), viewpoint)
    return np.where(point[..., 2:] < viewpoint[..., 2:], point, np.nan)
