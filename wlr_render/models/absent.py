"""Mappings that were not calibrated, of a headset without a display or see-through session: every use is refused."""

from dataclasses import dataclass
from typing import NoReturn

from wlr_render.errors import BadInputError
from wlr_render.mappings import Panel, QueryResult
from wlr_render.numerics.arrays import FloatArray


def _refuse(side: str, wanted: str) -> NoReturn:
    raise BadInputError(
        f"the model has no {side} mapping, because it was calibrated without {wanted}; calibrate with both to use it "
        "here."
    )


@dataclass(frozen=True)
class AbsentDisplay:
    """A display that was not calibrated; every query raises BadInputError."""

    @property
    def panel(self) -> Panel:
        """Panel of the display: refused, because it is unknown."""
        _refuse("display", "photographs of the panel")

    def view_dir_of_pixel(
        self, pixel: FloatArray, viewpoint: FloatArray, warm_start: FloatArray | None = None
    ) -> QueryResult:
        """Refuse the forward query."""
        _refuse("display", "photographs of the panel")

    def pixel_of_view_dir(
        self, view_dir: FloatArray, viewpoint: FloatArray, warm_start: FloatArray | None = None
    ) -> QueryResult:
        """Refuse the backward query."""
        _refuse("display", "photographs of the panel")


@dataclass(frozen=True)
class AbsentSeeThrough:
    """A see-through mapping that was not calibrated; every query raises BadInputError."""

    def real_ray_of_view_dir(
        self, view_dir: FloatArray, viewpoint: FloatArray, warm_start: FloatArray | None = None
    ) -> QueryResult:
        """Refuse the forward query."""
        _refuse("see-through", "photographs through the optics")

    def view_dir_of_real_point(
        self, point: FloatArray, viewpoint: FloatArray, warm_start: FloatArray | None = None
    ) -> QueryResult:
        """Refuse the backward query."""
        _refuse("see-through", "photographs through the optics")
