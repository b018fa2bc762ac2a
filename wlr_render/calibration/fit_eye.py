"""Fit both mappings of one eye."""

from collections.abc import Mapping
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from wlr_render.calibration import fit_display as display_fit
from wlr_render.calibration import fit_see_through as see_through_fit
from wlr_render.calibration.fit_prescription import (
    FittedAssembly,
    Prescription,
    display_trend,
    fit_assembly,
    prescription_report,
    see_through_trend,
    with_posterior,
)
from wlr_render.calibration.fit_report import ModelFit
from wlr_render.calibration.model_kinds import choose_base_plane
from wlr_render.calibration.readings import Trend
from wlr_render.captures.correspondences import Captures
from wlr_render.errors import BadInputError
from wlr_render.geometry.planes import BasePlane
from wlr_render.html_summary import SummaryTable, html_summary
from wlr_render.mappings import Eye
from wlr_render.models.absent import ABSENT_DISPLAY, ABSENT_SEE_THROUGH
from wlr_render.models.fitted_model import FittedDisplay, FittedSeeThrough
from wlr_render.models.model_file import EyeModel, save_eye_models
from wlr_render.numerics.arrays import FloatArray

KINDS_BY_PRESCRIPTION = ("prescription", "grey-box")
"""Kinds that need a prescription."""

_SEE_THROUGH_KIND = {"point-per-pixel": "static"}  # see-through kind for a display-only kind, equally simple
_COMPARED = ("prescription", "planar", "grey-box")  # kinds from simple to complex
_WORTH = 2.0  # log10 odds from which a kind is preferred to a simpler one


@dataclass(frozen=True)
class Calibration:
    """The fitted models of one eye, from `calibrate`, with their evidence and predicted errors.

    Attributes:
        mappings: the fitted eye, for `render`, `world_rays`, `compare` and `ErrorMap`.
        device: name of the device.
        display, see_through: the fits; None for a side without captures.
        log_evidence: natural logarithm of the probability density of all readings of both sides.
        assembly: the prescription with the assembly errors estimated by both models; None without a prescription.
    """

    mappings: Eye
    device: str
    display: ModelFit[FittedDisplay] | None
    see_through: ModelFit[FittedSeeThrough] | None
    log_evidence: float
    assembly: FittedAssembly | None = None

    @property
    def sides(self) -> dict[str, ModelFit[FittedDisplay] | ModelFit[FittedSeeThrough]]:
        """The existing fits, by "display" and "see-through"."""
        both = {"display": self.display, "see-through": self.see_through}
        return {name: side for name, side in both.items() if side is not None}

    @property
    def both(self) -> tuple[ModelFit[FittedDisplay], ModelFit[FittedSeeThrough]]:
        """Display and see-through fits; BadInputError if one is missing."""
        if self.display is None or self.see_through is None:
            lacking = "display" if self.display is None else "see-through"
            raise BadInputError(f"the captures of {self.device} have no {lacking} part; add it.")
        return self.display, self.see_through

    def __repr__(self) -> str:
        return f"Calibration({self.mappings.name!r}, {self.mappings.eye} eye)"

    def _repr_html_(self) -> str:
        rows = []
        for name, fit in self.sides.items():
            side: Any = fit  # fit of either kind, with its own mapping
            rows.append((name, f"{side.kind}, {side.predicted_arcmin(side.mapping):.2g}'"))
        title = f"Fit of {self.mappings.name}, {self.mappings.eye} eye"
        return html_summary(
            title,
            [],
            [self.mappings.summary, SummaryTable((), rows, "Model and its predicted error, rms over the eye box")],
        )

    def save(self, path: str | Path) -> Path:
        """Write a model file (.json), which `open_eye` reads; docs/files.md has the format.

        Raises:
            BadInputError: the file cannot be written.
        """
        return save_eye_models(path, [self.model()])

    def model(self) -> EyeModel:
        """Return the model in the form for `models.model_file.save_eye_models`."""
        report = {name.replace("-", "_"): asdict(side.report) for name, side in self.sides.items()}
        if self.assembly is not None:
            report["prescription"] = prescription_report(self.assembly, self.device, self.mappings.eye)
        return EyeModel(self.mappings, self.device, report)


@dataclass(frozen=True)
class KindComparison:
    """Fits of several kinds to the same readings with the same weights.

    Attributes:
        fits: fits by kind.
        best: kind to use: the most probable one, or a simpler one of about the same probability.
    """

    fits: Mapping[str, Calibration]
    best: str

    @property
    def chosen(self) -> Calibration:
        """The best fit."""
        return self.fits[self.best]

    def log10_odds(self, kind: str) -> float:
        """Decimal logarithm of the odds of a kind against "planar", which needs no prescription."""
        return (self.fits[kind].log_evidence - self.fits["planar"].log_evidence) / float(np.log(10.0))

    @property
    def sentence(self) -> str:
        """Summary of the improvement by the prescription; empty for a single kind."""
        if len(self.fits) == 1:
            return ""
        planar, best = self.fits["planar"].both[0], self.chosen.both[0]
        if self.best == "planar":
            return (
                "The prescription does not help: the captures are at least as probable without it. Check that it is of "
                "this headset, or use the planar model."
            )
        how = "explains the captures" if self.best == "prescription" else "and a small smooth remainder explain them"
        found, without = best.predicted_arcmin(best.mapping), planar.predicted_arcmin(planar.mapping)
        return (
            f"The prescription with fitted assembly errors {how}: the display model's predicted error is {found:.2g}', "
            f"and {without:.2g}' without the prescription (log10 odds {self.log10_odds(self.best):.0f})."
        )


def calibrate(
    captures: Captures,
    kind: str = "planar",
    display_degree: int | None = None,
    see_through_degree: int | None = None,
    base_plane: BasePlane | None = None,
    prescription: Prescription | None = None,
) -> Calibration:
    """Fit the display and see-through models of one eye to captures, by maximum evidence.

    The fit estimates the noise, the repeatability of the stage and the orders of the models, excludes outliers, and
    predicts its own error.

    Args:
        captures: captures of the display, the world, or both, from `load_captures` or `simulate`.
        kind: type of model: "planar" (rays change with the pupil's place in a plane), "volumetric", "static" (one map
            for all pupil positions), or "point-per-pixel"; "grey-box" and "prescription" need a prescription, whose
            assembly errors are fitted.
        display_degree, see_through_degree: highest total degree; by default chosen from the captures.
        base_plane: base plane of planar models, device frame; None for the planes of `choose_base_plane`.
        prescription: prescription of the eye, device frame.

    Returns:
        The fit; its attribute `mappings` is the fitted eye, and `save` writes the model file.

    Raises:
        BadInputError: the captures do not determine the models, or lack one side for a prescription; or the kind is
            unknown.

    Example:
        >>> import wlr_render as wlr
        >>> fit = wlr.calibrate(wlr.load_captures("captures-right.npz"))
        >>> fit.save("model.json")
    """
    if kind in KINDS_BY_PRESCRIPTION:
        if prescription is None:
            raise BadInputError(f"a {kind} model needs the device's prescription; name it, or fit a planar model.")
        trends = eye_trends(captures, fit_assembly(captures, prescription), base_plane)
        return fit_with_trends(captures, kind, trends, (display_degree, see_through_degree))
    shown = seen = None
    if captures.see_through is not None:
        seen = see_through_fit.fit_see_through(
            captures.see_through, _SEE_THROUGH_KIND.get(kind, kind), see_through_degree, base_plane
        )
    if captures.display is not None:
        # The see-through deviation varies little with the viewpoint, so that see-through captures separate camera
        # motions from optics where display captures cannot.
        stage = None if seen is None else seen.smooth.stage
        shown = display_fit.fit_display(captures.display, kind, display_degree, base_plane, stage=stage)
    return _eye_fit(captures, shown, seen, sum(_log_evidence(each) for each in (shown, seen) if each is not None))


def fit_kinds(
    captures: Captures,
    prescription: Prescription,
    display_degree: int | None = None,
    see_through_degree: int | None = None,
    base_plane: BasePlane | None = None,
) -> KindComparison:
    """Fit a planar model, a grey box and the prescription with its assembly errors, and compare their evidence.

    All fits use the planar fit's outlier weights, because evidence compares only models of the same readings.

    Raises:
        BadInputError: as `calibrate`.
    """
    degrees = (display_degree, see_through_degree)
    planar = calibrate(captures, "planar", *degrees, base_plane)
    shown, seen = planar.both
    trends = eye_trends(captures, fit_assembly(captures, prescription), base_plane)
    weights = shown.smooth.kept, seen.smooth.kept
    fits = {"planar": planar} | {
        kind: fit_with_trends(captures, kind, trends, degrees, weights) for kind in KINDS_BY_PRESCRIPTION
    }
    most = max(fit.log_evidence for fit in fits.values())
    best = next(kind for kind in _COMPARED if fits[kind].log_evidence > most - _WORTH * np.log(10.0))
    return KindComparison(fits, best)


@dataclass(frozen=True)
class EyeTrends:
    """The fitted prescription as trends of both models, in the same parameters.

    Attributes:
        assembly: the prescription with its assembly errors.
        planes: base planes of display and see-through.
        display, see_through: see `fit_prescription.display_trend` and `see_through_trend`.
    """

    assembly: FittedAssembly
    planes: tuple[BasePlane, BasePlane]
    display: Trend
    see_through: Trend


def eye_trends(captures: Captures, assembly: FittedAssembly, base_plane: BasePlane | None = None) -> EyeTrends:
    """Compile the fitted prescription over the range of the captures' inputs.

    Raises:
        BadInputError: captures of one side are missing, or almost no ray passes the optics.
    """
    shown, seen = captures.both
    planes = (
        base_plane or choose_base_plane(shown.viewpoint, shown.eye_box),
        base_plane or choose_base_plane(seen.viewpoint, seen.eye_box),
    )
    return EyeTrends(
        assembly,
        planes,
        display_trend(assembly, planes[0], display_fit.DISPLAY.planar_box(shown, planes[0])),
        see_through_trend(assembly, planes[1], see_through_fit.SEE_THROUGH.planar_box(seen, planes[1])),
    )


def fit_with_trends(
    captures: Captures,
    kind: str,
    trends: EyeTrends,
    degrees: tuple[int | None, int | None] = (None, None),
    weights: tuple[FloatArray | None, FloatArray | None] = (None, None),
) -> Calibration:
    """Fit a grey box or a prescription to both sides, then update each with the other's assembly posterior.

    Both models then have the same posterior of the assembly errors. The log evidence of all readings is the sum for the
    display fit before its update and the see-through fit after its update.

    Args:
        captures: captures of both sides.
        kind: "grey-box" or "prescription".
        trends: see `eye_trends`.
        degrees: limits of the total orders of display and see-through.
        weights: weights of the readings of display and see-through; see `smooth_search.fit`.

    Raises:
        BadInputError: as `fit_display` and `fit_see_through`.
    """
    display, see_through = captures.both
    display_plane, see_through_plane = trends.planes
    seen = see_through_fit.fit_see_through(
        see_through, kind, degrees[1], see_through_plane, trends.see_through, weights[1]
    )
    shown = display_fit.fit_display(
        display, kind, degrees[0], display_plane, trends.display, weights[0], seen.smooth.stage
    )
    by_display, (mean, root) = shown.smooth.trend_parameters, seen.smooth.trend_parameters
    log_evidence = _log_evidence(shown)
    seen = see_through_fit.SEE_THROUGH.with_trend(seen, see_through_plane, trends.see_through.about(*by_display))
    shown = display_fit.DISPLAY.with_trend(shown, display_plane, trends.display.about(mean, root))
    log_evidence += _log_evidence(seen)
    added, rest = shown.smooth.trend_parameters
    assembly = with_posterior(trends.assembly, mean + root @ added, root @ rest @ rest.T @ root.T)
    return replace(_eye_fit(captures, shown, seen, log_evidence), assembly=assembly)


def _log_evidence(fitted: ModelFit[FittedDisplay] | ModelFit[FittedSeeThrough]) -> float:
    return fitted.smooth.posterior.log_evidence


def _eye_fit(
    captures: Captures,
    shown: ModelFit[FittedDisplay] | None,
    seen: ModelFit[FittedSeeThrough] | None,
    log_evidence: float,
) -> Calibration:
    source = captures.source
    of_display, of_see_through = (() if each is None else each.sources_by_label for each in (shown, seen))
    shown = shown and shown.with_label_errors(after=of_see_through)
    seen = seen and seen.with_label_errors(before=of_display)
    kind = next(each.kind for each in (shown, seen) if each is not None)
    mappings = Eye(
        f"{source.device} ({kind})",
        source.eye,
        ABSENT_DISPLAY if shown is None else shown.mapping,
        ABSENT_SEE_THROUGH if seen is None else seen.mapping,
        source.eye_box,
    )
    return Calibration(mappings, source.device, shown, seen, log_evidence)
