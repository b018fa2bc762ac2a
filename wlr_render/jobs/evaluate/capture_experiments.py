"""What captures cost and what spoils them: number of viewpoints, camera noise, errors of position."""

from collections.abc import Mapping
from itertools import product

from wlr_render.jobs.evaluate.experiment import (
    AnyTrial,
    Experiment,
    Findings,
    Key,
    Line,
    Plot,
    StudyOptions,
    pooled,
    repetitions,
    spread_note,
)
from wlr_render.jobs.evaluate.trials import DisplayTrial, Measure, Outcome
from wlr_render.numerics.polynomial import term_count
from wlr_render.report.blocks import Cell, ReportTable

SPARSE = ((3, 16), (4, 25), (5, 25), (6, 49))
"""Degree and number of viewpoints; those above the study's degrees are left out."""
OVER_VIEWPOINTS = {"planar": (21, 25, 49, 121), "volumetric": (56, 84, 125)}
NOISES_ARCMIN = (0.0, 0.25, 1.0)
POSITION_ERROR_MM = 0.05
# 25 viewpoints each: volumetric sampling can carry degree 3 on them and no more.
MODELS = (("planar", 5), ("volumetric", 3), ("point-per-pixel", 5), ("static", 5))
_DEGREE, _VIEWPOINTS = 5, 25


def _volumetric_counts(degree: int) -> tuple[int, int]:
    """The fewest viewpoints that determine the fit, and half as many again, which make it sound."""
    fewest = term_count(3, degree)
    return fewest, fewest * 3 // 2


def _sparse(options: StudyOptions) -> list[tuple[int, int]]:
    return [pair for pair in SPARSE if pair[0] <= max(options.degrees)]


def viewpoint_cells(options: StudyOptions) -> Mapping[Key, AnyTrial]:
    """Keys: device, kind, degree, number of viewpoints."""
    planar = [("planar", *pair) for pair in _sparse(options)]
    volumetric = [("volumetric", n, count) for n, same in _sparse(options) for count in (same, *_volumetric_counts(n))]
    curves = [(kind, _DEGREE, count) for kind, counts in OVER_VIEWPOINTS.items() for count in counts]
    return {
        (device, kind, degree, count): DisplayTrial(device, kind, degree, count)
        for device in options.devices
        for kind, degree, count in (*planar, *volumetric, *curves)
    }


def viewpoint_findings(options: StudyOptions, outcomes: Mapping[Key, Outcome]) -> Findings:
    """How few camera positions each model does with."""
    rows: list[list[Cell]] = []
    for device, (degree, count) in product(options.devices, _sparse(options)):
        fewest, sound = _volumetric_counts(degree)
        keys = [("planar", count), ("volumetric", count), ("volumetric", fewest), ("volumetric", sound)]
        errors = [outcomes[device, kind, degree, n].cell(Measure.FORWARD) for kind, n in keys]
        rows.append([device, degree, count, errors[0], errors[1], fewest, errors[2], sound, errors[3]])
    columns = ["device", "N", "viewpoints", "planar (arcmin)", "volumetric (arcmin)"]
    columns += ["fewest", "volumetric on the fewest (arcmin)", "1.5 times the fewest", "volumetric on those (arcmin)"]
    lines = tuple(
        Line(f"{device}, {kind}", counts, [outcomes[device, kind, _DEGREE, n].rms(Measure.FORWARD) for n in counts])
        for device in options.devices
        for kind, counts in OVER_VIEWPOINTS.items()
    )
    title = f"Number of viewpoints, N={_DEGREE}, noise-free"
    plot = Plot("error_over_viewpoints", title, "number of viewpoints", "forward rms (arcmin)", lines)
    return Findings((ReportTable("Number of viewpoints: forward rms, noise-free", columns, rows),), (plot,))


def noise_cells(options: StudyOptions) -> Mapping[Key, AnyTrial]:
    """Keys: device, kind, noise, repetition."""
    return {
        (device, kind, noise, repeat): DisplayTrial(
            device, kind, degree, _VIEWPOINTS, camera_noise_arcmin=noise, repeat=repeat
        )
        for device in options.devices
        for kind, degree in MODELS
        for noise in NOISES_ARCMIN
        for repeat in repetitions(options, noise)
    }


def noise_findings(options: StudyOptions, outcomes: Mapping[Key, Outcome]) -> Findings:
    """Camera noise, on the models that 25 viewpoints can carry and on the baselines."""
    rows: list[list[Cell]] = []
    lines, noisy = [], []
    for device, (kind, degree) in product(options.devices, MODELS):
        groups = [[outcomes[device, kind, s, k] for k in repetitions(options, s)] for s in NOISES_ARCMIN]
        errors = [pooled(group, Measure.FORWARD) for group in groups]
        rows.append([device, kind, degree, *errors, pooled(groups[-1], Measure.BACKWARD)])
        lines.append(Line(f"{device}, {kind}", NOISES_ARCMIN, errors))
        noisy += groups[1:]
    columns = ["device", "model", "N", *(f"forward rms at {s:g}' noise (arcmin)" for s in NOISES_ARCMIN)]
    columns.append(f"backward rms at {NOISES_ARCMIN[-1]:g}' noise (px)")
    note = spread_note(noisy, Measure.FORWARD)
    title = f"Camera noise, {_VIEWPOINTS} viewpoints (static: one)"
    plot = Plot("error_over_noise", title, "camera noise (arcmin)", "forward rms (arcmin)", tuple(lines))
    return Findings((ReportTable(title, columns, rows, (note,)),), (plot,))


def position_cells(options: StudyOptions) -> Mapping[Key, AnyTrial]:
    """Keys: device, "exact" or "stage" or "tracking", repetition."""
    errors = {
        "exact": (0.0, 0.0),
        "stage": (POSITION_ERROR_MM, 0.0),
        "tracking": (0.0, POSITION_ERROR_MM),
    }
    return {
        (device, name, repeat): DisplayTrial(
            device, "planar", _DEGREE, _VIEWPOINTS, stage_error_mm=stage, tracking_error_mm=tracking, repeat=repeat
        )
        for device in options.devices
        for name, (stage, tracking) in errors.items()
        for repeat in repetitions(options, stage + tracking)
    }


def position_findings(options: StudyOptions, outcomes: Mapping[Key, Outcome]) -> Findings:
    """Errors of the stage at calibration, and of eye tracking at use."""
    rows: list[list[Cell]] = []
    noisy: list[list[Outcome]] = []
    for device in options.devices:
        groups = [[outcomes[device, name, k] for k in range(options.repeats)] for name in ("stage", "tracking")]
        exact = outcomes[device, "exact", 0].rms(Measure.FORWARD)
        rows.append([device, exact, *(pooled(group, Measure.FORWARD) for group in groups)])
        noisy += groups
    columns = ["device", "exact positions (arcmin)", "stage error (arcmin)", "eye-tracking error (arcmin)"]
    errors = f"Errors of position of {POSITION_ERROR_MM:g} mm per axis"
    title = f"{errors}: forward rms, planar N={_DEGREE}, {_VIEWPOINTS} viewpoints"
    note = spread_note(noisy, Measure.FORWARD)
    return Findings((ReportTable(title, columns, rows, (note,)),))


VIEWPOINT_EXPERIMENT = Experiment("viewpoints", viewpoint_cells, viewpoint_findings)
NOISE_EXPERIMENT = Experiment("noise", noise_cells, noise_findings)
POSITION_EXPERIMENT = Experiment("position", position_cells, position_findings)
