"""Fit both mappings of one eye."""

from dataclasses import asdict, dataclass

from wlr_render.calibration.fit_display import fit_display
from wlr_render.calibration.fit_report import FitReport
from wlr_render.calibration.fit_see_through import fit_see_through
from wlr_render.captures.correspondences import EyeCaptures
from wlr_render.errors import BadInputError
from wlr_render.geometry.planes import BasePlane
from wlr_render.mappings import EyeMappings
from wlr_render.models.model_file import EyeModel

_SEE_THROUGH_KIND = {"point-per-pixel": "static"}  # a display-only model goes with a see-through that is as simple


@dataclass(frozen=True)
class EyeFit:
    """Fitted mappings of one eye, with both fit reports."""

    mappings: EyeMappings
    device: str
    display: FitReport
    see_through: FitReport

    def model(self) -> EyeModel:
        """As `models.model_file.save_eye_models` takes it."""
        report = {"display": asdict(self.display), "see_through": asdict(self.see_through)}
        return EyeModel(self.mappings, self.device, report)


def fit_eye(
    captures: EyeCaptures,
    kind: str = "planar",
    display_degree: int | None = None,
    see_through_degree: int | None = None,
    base_plane: BasePlane | None = None,
) -> EyeFit:
    """Fit display and see-through of one kind; degrees are chosen by held-out camera positions where None is given.

    Raises:
        BadInputError: there are no see-through captures, or as `fit_display` and `fit_see_through`.
    """
    if captures.see_through is None:
        raise BadInputError(
            f"the captures of {captures.display.device} have no see-through part; fit the display alone, or add one."
        )
    display, display_report = fit_display(captures.display, kind, display_degree, base_plane)
    see_through_kind = _SEE_THROUGH_KIND.get(kind, kind)
    see_through, see_through_report = fit_see_through(
        captures.see_through, see_through_kind, see_through_degree, base_plane
    )
    source = captures.display
    name = f"{source.device} ({kind} N={display_report.degree}, see-through N={see_through_report.degree})"
    mappings = EyeMappings(name, source.eye, display, see_through, source.eye_box)
    return EyeFit(mappings, source.device, display_report, see_through_report)
