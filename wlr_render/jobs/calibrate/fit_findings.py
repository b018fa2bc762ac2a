"""Report of a fit: predicted error, noise and stage as found, warnings and advice, and tables."""

from collections.abc import Callable, Sequence
from typing import Any

import numpy as np

from wlr_render.calibration.fit_eye import Calibration, KindComparison
from wlr_render.calibration.fit_prescription import IMPLAUSIBLE
from wlr_render.calibration.fit_report import ErrorShare, FitReport, ModelFit
from wlr_render.calibration.label_errors import MATTERS, STANDS_OUT
from wlr_render.calibration.moved_captures import MotionAgreement
from wlr_render.calibration.smooth_prior import LARGEST_SHIFT_M, LARGEST_TURN_RAD
from wlr_render.captures.correspondences import Captures
from wlr_render.error_sources import ErrorSource, remedy
from wlr_render.jobs.calibrate.fit_plots import position_names, predicted_maps, residual_plots
from wlr_render.mappings import Eye
from wlr_render.models.fitted_model import FittedDisplay, FittedSeeThrough
from wlr_render.optics.assembly import ASSEMBLY_NAMES, ASSEMBLY_SIZES
from wlr_render.report.blocks import Block, Cell, Columns, Number, ReportTable, table

AS_STATED = 1.5
"""Noise found over the stated one, or the reverse, from which a report warns."""
WORTH_A_ROW, FEW_POSITIONS = 0.1, 0.3
"""Parts of the predicted error that one more row of positions takes away: to be advised, and to be warned of."""
MOTIONS_DIFFER = 3.0
"""Standard deviations between fitted motions and the bench's beyond which a report warns."""
_NEAR_BOUND = 0.9
_MOST_OF_IT = 0.7  # share of the predicted error from which the report advises on its source: half of its square
_NO_MOTION = 0.05  # size of a motion that counts as none, um or microradians
_NEAR_MIDDLE_M = 0.01  # largest |x| of an eye whose frame may have its origin in the eye: the eyes are at +-20 to 40 mm


_AnyFit = ModelFit[FittedDisplay] | ModelFit[FittedSeeThrough]


def _reports(fit: Calibration) -> list[tuple[str, FitReport]]:
    return [(name, side.report) for name, side in fit.sides.items()]


def fit_sentences(comparison: KindComparison) -> str:
    """Return `fit_sentence` of the best type of model, and the gain by a prescription."""
    return f"{fit_sentence(comparison.chosen)} {comparison.sentence}".rstrip()


def fit_sentence(fit: Calibration) -> str:
    """State the predicted error of both models and the estimated noise and stage errors, in one sentence."""
    parts = []
    for name, report in _reports(fit):
        found = [f"noise {_digits(report.noise_arcmin, 3)}' found"]
        if report.stated_noise_arcmin is not None:
            found[0] += f", {report.stated_noise_arcmin:.3g}' stated"
        if report.motion_agreement is not None:
            found.append(_agreement(report.motion_agreement))
        elif max(report.repeatability_um, report.wobble_urad) > _NO_MOTION:
            shift, turn = _digits(report.repeatability_um), _digits(report.wobble_urad)
            found.append(f"repeatability {shift} um, wobble {turn} urad")
        elif report.repeatability_um > 0:
            found.append("the stage repeats exactly")
        found += [f"errors by {each.label} {_digits(each.size_arcmin)}'" for each in report.labels if each.matters]
        parts.append(f"{name} {_digits(report.predicted_arcmin)}' predicted rms ({'; '.join(found)})")
    return f"{fit.mappings.eye.capitalize()} eye: {'; '.join(parts)}."


def _agreement(motions: MotionAgreement) -> str:
    """State the bench's sigmas of the camera's motions, and whether the readings agree."""
    stated = f"stage repeatability {_digits(1e6 * motions.shift_m)} um, {_digits(1e6 * motions.turn_rad)} urad"
    factors = f"factors {_digits(motions.shift_factor)} and {_digits(motions.turn_factor)}"
    agree = max(motions.shift_sigmas, motions.turn_sigmas) <= MOTIONS_DIFFER
    return f"{stated} from the bench, the readings {'agree' if agree else 'disagree'}: {factors}"


def fit_warnings(fit: Calibration, display_names: Sequence[str] = (), *, sigma_is_given: bool = True) -> list[str]:
    """Return warnings about disagreement with the captures' sigmas, and about limits of the models.

    Args:
        fit: the models.
        display_names: names of the display's camera positions; empty to number them.
        sigma_is_given: True if the user states the noise of the captures, and can correct it.
    """
    of_sides = [
        warning
        for name, side in fit.sides.items()
        for warning in _warnings(name.capitalize(), side, display_names, sigma_is_given)
    ]
    return [*eye_warnings(fit.mappings), *of_sides, *_assembly_warnings(fit)]


def eye_warnings(fitted: Eye) -> list[str]:
    """Warn if the eye box is where the other eye is; x is 0 where the eye is the frame's origin."""
    x, is_right = fitted.eye_box.centre[0], fitted.eye == "right"
    if abs(x) <= _NEAR_MIDDLE_M or (x > 0) == is_right:
        return []
    other = "left" if is_right else "right"
    return [
        f"The eye box of the {fitted.eye} eye is at x = {1e3 * x:+.3g} mm (x right), where the {other} eye is if the "
        "frame's origin lies between the eyes: check 'eye', 'frame' and the sign of x."
    ]


def _assembly_warnings(fit: Calibration) -> list[str]:
    if fit.assembly is None:
        return []
    sizes = np.abs(fit.assembly.values) / ASSEMBLY_SIZES
    if sizes.max() <= IMPLAUSIBLE:
        return []
    name = ASSEMBLY_NAMES[int(np.argmax(sizes))]
    return [
        f"The fitted assembly errors are implausibly large ({name} is {sizes.max():.0f} times a usual one): a surface "
        "may have another shape than in the prescription. The models are valid, these values are not."
    ]


def _label_warnings(title: str, report: FitReport) -> list[str]:
    return [
        f"{title}: the residuals show errors by {each.label} of {_digits(each.size_arcmin)}' rms (log10 odds "
        f"{each.log10_odds:.0f}), which the model lacks. They cause errors of the model of about "
        f"{_digits(each.in_model_arcmin)}', which the predicted error contains as '{each.source}'. "
        f"{each.source.remedy}"
        for each in report.labels
        if each.matters
    ]


def _warnings(title: str, side: _AnyFit, display_names: Sequence[str], sigma_is_given: bool) -> list[str]:
    report, found = side.report, []
    names = position_names(side.captures, display_names)
    _, first = np.unique(side.smooth.readings.capture, return_index=True)
    for each in report.moved + report.unsure:
        conclusion = (
            "the camera or the headset moved, its entry is wrong, or the optics are less smooth there than the model. "
            "The model was fitted without them."
            if each in report.moved
            else "these captures do not show whether it moved or the optics are less smooth there than the model. The "
            "model was fitted with them; take this capture again, or add positions near it."
        )
        found.append(
            f"{title}: the readings of {names[first[each.capture]]} lie as if its camera had stood "
            f"{_digits(1e6 * each.shift_m)} um and {_digits(1e6 * each.turn_rad)} microradians from where it is "
            f"stated (log10 odds {each.log10_odds:.0f} against noise and an ordinary stage): {conclusion}"
        )
    found += _noise_warnings(title, report, sigma_is_given)
    found += _motion_warnings(title, report)
    found += _label_warnings(title, report)
    if (gain := _gain(report)) > FEW_POSITIONS:
        found.append(
            f"{title}: the number of camera positions limits the predicted error; one more row or column of them would "
            f"lower it by {100 * gain:.0f} %."
        )
    if report.viewpoints == 1 and report.kind != "static":
        found.append(
            f"{title}: the model is known at one camera position only; add positions over the whole eye box, to the "
            "left and right, above and below."
        )
    return found


def _noise_warnings(title: str, report: FitReport, sigma_is_given: bool) -> list[str]:
    """Warn of noise that differs from the stated noise."""
    found = list[str]()
    stated = report.stated_noise_arcmin
    beside = "" if stated is None else f"({_digits(report.noise_arcmin, 3)}' beside {stated:.3g}')"
    if stated is not None and report.noise_arcmin > AS_STATED * stated:
        found.append(
            f"{title}: the noise found is {report.noise_arcmin / stated:.1f} times the stated one {beside}: the "
            "stated sigma is too small, or the readings have errors other than noise (lens, decoding, target)."
        )
    if sigma_is_given and stated is not None and report.noise_arcmin < stated / AS_STATED:
        found.append(
            f"{title}: the stated noise is {stated / report.noise_arcmin:.1f} times the one found {beside}: state "
            "a smaller sigma."
        )
    return found


def _motion_warnings(title: str, report: FitReport) -> list[str]:
    """Warn of camera motions at their bounds, or different from the bench's."""
    found = list[str]()
    for value, most, quantity, unit in (
        (report.repeatability_um, 1e6 * LARGEST_SHIFT_M, "repeatability of positions", "um"),
        (report.wobble_urad, 1e6 * LARGEST_TURN_RAD, "wobble", "microradians"),
    ):
        if value > _NEAR_BOUND * most and report.motion_agreement is None:
            found.append(
                f"{title}: the {quantity} found is at its bound, {most:g} {unit}, which no stage has: check "
                "viewpoints, units and axes of the captures."
            )
    if (motions := report.motion_agreement) is not None:
        for moved, factor, sigmas in (
            ("shifted", motions.shift_factor, motions.shift_sigmas),
            ("turned", motions.turn_factor, motions.turn_sigmas),
        ):
            if sigmas > MOTIONS_DIFFER:
                why = (
                    "the predicted errors are too large"
                    if factor < 1
                    else "camera or headset moved after the bench was photographed, or the optics are less smooth than "
                    "the model"
                )
                found.append(
                    f"{title}: between captures the camera seems to have {moved} {_digits(factor, 3)} times as far as "
                    f"the bench states (off by {sigmas:.1f} sigma): {why}."
                )
    return found


def fit_advice(fit: Calibration) -> list[str]:
    """Return advice against the largest source of the predicted error, and to add positions that reduce it.

    Noise needs no advice of its own: further positions reduce it.
    """
    steps = []
    for name, report in _reports(fit):
        whole = report.predicted_arcmin
        steps += [
            f"{name.capitalize()}: {_digits(each.arcmin)}' of the predicted {_digits(whole)}' come from "
            f"the source '{each.source}'{_sizes(each)}. {remedy(each.source)}"
            for each in report.shares
            if each.source != ErrorSource.NOISE_AND_STAGE and each.arcmin > _MOST_OF_IT * whole
        ]
        if report.one_more is not None and _gain(report) > WORTH_A_ROW:
            now, then = _digits(report.predicted_arcmin), _digits(report.one_more.predicted_arcmin)
            falls = f"the predicted error falls from {now}' to {then}'."
            steps.append(f"{name.capitalize()}: add {report.one_more.positions}; {falls}")
    return steps


def _gain(report: FitReport) -> float:
    """Return the share of the predicted error that one more row of positions removes."""
    if report.one_more is None or report.predicted_arcmin == 0:
        return 0.0
    return 1.0 - report.one_more.predicted_arcmin / report.predicted_arcmin


def fit_blocks(comparison: KindComparison, captures: Captures, display_names: Sequence[str] = ()) -> list[Block]:
    """Return tables, maps of the predicted error and plots of the residuals.

    Args:
        comparison: the models of one or more types; the best is shown.
        captures: the fitted captures.
        display_names: names of the display's camera positions; empty to number them.
    """
    fit = comparison.chosen
    tables = [_fit_table(fit), _share_table(fit), _motion_table(fit), _label_table(fit), _size_table(fit)]
    tables += [_held_out_table(fit), _one_more_table(fit)]
    if len(comparison.fits) > 1:
        tables.insert(0, _kinds_table(comparison))
    maps = [] if fit.display is None else predicted_maps(fit.display.mapping)
    return [*(table for table in tables if table.rows), *maps, *residual_plots(fit, captures, display_names)]


def _fit_table(fit: Calibration) -> ReportTable:
    columns: Columns = {
        "model": "kind",
        "predicted rms error (arcmin)": "predicted_arcmin",
        "residual rms (arcmin)": "residual_arcmin.rms",
        "residual p95 (arcmin)": "residual_arcmin.p95",
        "noise found (arcmin)": "noise_arcmin",
        "noise stated (arcmin)": "stated_noise_arcmin",
        "repeatability (um)": lambda report: report.repeatability_um or None,
        "wobble (urad)": lambda report: report.wobble_urad if report.repeatability_um > 0 else None,
    }
    notes = (
        "Predicted error: the standard error of the fit over the eye box. Residuals include the noise.",
        "Noise, repeatability of the camera's positions and wobble of its turns are standard deviations per axis.",
    )
    return table("Fit", _reports(fit), columns, notes, name="mapping")


def _share_table(fit: Calibration) -> ReportTable:
    columns: Columns = {
        "source": "source",
        "part of the predicted error (arcmin)": "arcmin",
        "size found": lambda share: _size_text(share.size, share.unit),
        "usual size": lambda share: _size_text(share.usual, share.unit),
    }
    notes = [
        "Squares of the parts add up to the square of the predicted error. Size: rms of the errors of the "
        "source; the usual size is assumed where the captures do not show it."
    ]
    notes += [
        f"{name.capitalize()}: the predicted error does not contain the following errors, because the captures lack "
        f"the data in brackets: {'; '.join(report.unseen)}."
        for name, report in _reports(fit)
        if report.unseen
    ]
    return table("Predicted error by source", _each(fit, "shares"), columns, notes, name="mapping")


def _each(fit: Calibration, name: str) -> list[tuple[str, Any]]:
    """Return each item of a list in the reports, with the name of the mapping."""
    return [(mapping, item) for mapping, report in _reports(fit) for item in getattr(report, name)]


def _sizes(share: ErrorShare) -> str:
    """Return the size of a source's errors in words, next to the usual size, which the fit may merely have assumed."""
    if share.size is None or share.usual is None:
        return ""
    return f" ({_size_text(share.size, share.unit)} in the fit, usually {_size_text(share.usual, share.unit)})"


def _size_text(value: float | None, unit: str) -> str | None:
    """Return the size of an error in words, e.g. "48 um" or "0.12'"."""
    if value is None:
        return None
    return f"{_digits(1e6 * value)} um" if unit == "m" else f"{_digits(value)}'"


def _motion_table(fit: Calibration) -> ReportTable:
    rows: list[list[Cell]] = []
    for name, report in _reports(fit):
        if (motions := report.motion_agreement) is not None:
            shift = [1e6 * motions.shift_m, report.repeatability_um, motions.shift_factor, motions.shift_sigmas]
            turn = [1e6 * motions.turn_rad, report.wobble_urad, motions.turn_factor, motions.turn_sigmas]
            rows += [[name, "shift (um)", *shift], [name, "turn (urad)", *turn]]
    columns = ["mapping", "motion", "from the bench", "found", "factor", "sigmas"]
    notes = (
        "Motion of the camera between captures, rms per axis: as the calibration of the bench states it, and as "
        "found from the readings that the model is fitted to. Sigmas: distance of the factor from 1.",
    )
    return ReportTable("Motion of the camera", columns, rows, notes)


def _size_table(fit: Calibration) -> ReportTable:
    columns: Columns = {
        "highest orders": "orders",
        "coefficients determined": lambda report: f"{report.determined:.0f} of {report.coefficients}",
        "viewpoints": "viewpoints",
        "samples": "samples",
        "outliers": "outliers",
        "captures that moved": lambda report: len(report.moved),
        "unsolved": "unsolved",
        "contraction": "contraction",
        "log evidence": lambda report: Number(report.log_evidence, ".1f"),
    }
    notes = (
        "Coefficients: number that the captures determine; the smoothness prior determines the others.",
        "Contraction: below 1, every query has one solution. Log evidence: natural logarithm; among models of the same "
        "captures, the one with the largest is the most probable.",
    )
    return table("Sizes", _reports(fit), columns, notes, name="mapping")


def _held_out_table(fit: Calibration) -> ReportTable:
    columns: Columns = {
        "left out": "left_out",
        "captures": "captures",
        "error found, rms (arcmin)": "rms_arcmin",
        "error expected (arcmin)": "expected_arcmin",
        "ratio": lambda each: each.rms_arcmin / each.expected_arcmin,
    }
    notes = []
    for name, report in _reports(fit):
        if report.held_out_arcmin is not None:
            error, expected = map(_digits, report.held_out_arcmin)
            notes.append(f"{name.capitalize()}: left-out positions are predicted to {error}' ({expected}' expected).")
    notes.append("Each row and column of camera positions was left out and predicted from the others, noise included.")
    return table("Held-out camera positions", _each(fit, "held_out"), columns, notes, name="mapping")


def _label_table(fit: Calibration) -> ReportTable:
    columns: Columns = {
        "label": "label",
        "groups": "groups",
        "mean square / expected": "ratio",
        "log10 odds": lambda each: Number(each.log10_odds, ".1f"),
        "errors, rms (arcmin)": "size_arcmin",
        "error of the model that they cause (arcmin)": "in_model_arcmin",
    }
    notes = (
        "Mean square: of the weighted mean residuals of the groups; expected: from noise, motions and the fit. Log10 "
        f"odds above {STANDS_OUT:.0f}: readings of one group share errors that the model lacks, in addition to those "
        f"of the labels above. A warning names labels whose errors cause more than {MATTERS:.1f} of the error that the "
        "fit predicts without them.",
    )
    return table("Errors by label", _each(fit, "labels"), columns, notes, name="mapping")


def _one_more_table(fit: Calibration) -> ReportTable:
    columns: Columns = {
        "positions to add": "one_more.positions",
        "predicted rms error now (arcmin)": "predicted_arcmin",
        "with them (arcmin)": "one_more.predicted_arcmin",
    }
    known = [(name, report) for name, report in _reports(fit) if report.one_more is not None]
    return table("Gain of one more row of positions", known, columns, name="mapping")


def _kinds_table(comparison: KindComparison) -> ReportTable:
    def of(side: str, value: Callable[[FitReport], Cell]) -> Callable[[str], Cell]:
        return lambda kind: value(comparison.fits[kind].sides[side].report)

    figures: dict[str, Callable[[FitReport], Cell]] = {
        "predicted": lambda report: report.predicted_arcmin,
        "held-out": lambda report: None if report.held_out_arcmin is None else report.held_out_arcmin[0],
        "noise found": lambda report: report.noise_arcmin,
    }
    columns: Columns = {
        "model": str,
        "": lambda kind: "saved" if kind == comparison.best else "",
        "log10 odds against planar": lambda kind: Number(comparison.log10_odds(kind), ".1f"),
        **{
            f"{side} {name} (arcmin)": of(side, figures[name])
            for name in figures
            for side in ("display", "see-through")
        },
    }
    return table("Gain of the prescription", comparison.fits, columns, (comparison.sentence,))


def _digits(value: float, count: int = 2) -> str:
    """Format a number with `count` significant digits, e.g. 250, 9.1 or 1.00, without exponent from 0.0001 on."""
    rounded = float(f"{value:.{count}g}")
    return f"{rounded:#.{count}g}".rstrip(".") if 1e-4 <= abs(rounded) < 10.0**count else f"{rounded:g}"
