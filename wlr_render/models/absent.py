"""Placeholder for a mapping that was not calibrated, because its photographs are missing: any use is an error."""

from dataclasses import dataclass
from typing import NoReturn

from wlr_render.errors import BadInputError
from wlr_render.mappings import Panel, QueryResult
from wlr_render.numerics.arrays import FloatArray


@dataclass(frozen=True)
class Absent:
    """A display or see-through mapping that was not calibrated; every query raises BadInputError.

    Attributes:
        side: "display" or "see-through".
        lacking: photographs that the calibration lacked.
    """

    side: str
    lacking: str

    def _refuse(self) -> NoReturn:
        raise BadInputError(
            f"the model has no {self.side} mapping, because it was calibrated without {self.lacking}; calibrate with "
            "both to use it here."
        )

    @property
    def panel(self) -> Panel:
        """Panel of the display: unknown, so that access is an error."""
        self._refuse()

    def _answer(self, subject: FloatArray, viewpoint: FloatArray, warm_start: FloatArray | None = None) -> QueryResult:
        self._refuse()

    view_dir_of_pixel = pixel_of_view_dir = real_ray_of_view_dir = view_dir_of_real_point = _answer


ABSENT_DISPLAY = Absent("display", "photographs of the panel")
ABSENT_SEE_THROUGH = Absent("see-through", "photographs through the optics")
