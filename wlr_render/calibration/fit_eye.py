"""Fit both mappings of one eye."""

from dataclasses import asdict, dataclass

from wlr_render.calibration.fit_display import fit_display
from wlr_render.calibration.fit_report import ModelFit
from wlr_render.calibration.fit_see_through import fit_see_through
from wlr_render.captures.correspondences import EyeCaptures
from wlr_render.errors import BadInputError
from wlr_render.geometry.planes import BasePlane
from wlr_render.mappings import EyeMappings
from wlr_render.models.fitted_model import FittedDisplay, FittedSeeThrough
from wlr_render.models.model_file import EyeModel

_SEE_THROUGH_KIND = {"point-per-pixel": "static"}  # a display-only model goes with a see-through that is as simple


@dataclass(frozen=True)
class EyeFit:
    """Fitted mappings of one eye, with both fits."""

    mappings: EyeMappings
    device: str
    display: ModelFit[FittedDisplay]
    see_through: ModelFit[FittedSeeThrough]

    def model(self) -> EyeModel:
        """As `models.model_file.save_eye_models` takes it."""
        report = {"display": asdict(self.display.report), "see_through": asdict(self.see_through.report)}
        return EyeModel(self.mappings, self.device, report)


def fit_eye(
    captures: EyeCaptures,
    kind: str = "planar",
    display_degree: int | None = None,
    see_through_degree: int | None = None,
    base_plane: BasePlane | None = None,
) -> EyeFit:
    """Fit display and see-through of one kind by maximum evidence; a degree is a limit of the orders.

    Raises:
        BadInputError: there are no see-through captures, or as `fit_display` and `fit_see_through`.
    """
    if captures.see_through is None:
        raise BadInputError(
            f"the captures of {captures.display.device} have no see-through part; fit the display alone, or add one."
        )
    display = fit_display(captures.display, kind, display_degree, base_plane)
    see_through_kind = _SEE_THROUGH_KIND.get(kind, kind)
    see_through = fit_see_through(captures.see_through, see_through_kind, see_through_degree, base_plane)
    source = captures.display
    name = f"{source.device} ({kind})"
    mappings = EyeMappings(name, source.eye, display.mapping, see_through.mapping, source.eye_box)
    return EyeFit(mappings, source.device, display, see_through)
