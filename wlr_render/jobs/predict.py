"""Predict the captures of a session with a bench model found elsewhere, and say how well that succeeds."""

from collections.abc import Iterator, Sequence
from dataclasses import KW_ONLY, dataclass
from pathlib import Path
from typing import Annotated

import numpy as np

from wlr_render.diagnosis.bench_prediction import BenchPrediction, PredictedGroup, predict_session
from wlr_render.diagnosis.observations import DISPLAY, PART_NAMES, SEE_THROUGH
from wlr_render.errors import BadInputError
from wlr_render.files import output_folder
from wlr_render.jobs.options import Options, ProgressArgument, described
from wlr_render.progress import SILENT
from wlr_render.report.blocks import Block, Cell, Plot, Report, ReportTable
from wlr_render.report.plots import arrow_map, axis
from wlr_render.report.save import save_report
from wlr_render.simulation.bench import Bench
from wlr_render.simulation.bench_file import load_bench
from wlr_render.simulation.measurements import load_measurements
from wlr_render.simulation.session_folder import bench_for_session, load_session

_MOST_MAPS = 8
_POSE_TOLERANCE_M = 1e-6


@dataclass(frozen=True)
class PredictOptions(Options):
    """Options of `predict`."""

    bench: Annotated[Path, described("Bench file, or a folder with bench.toml, e.g. DIR/corrected of a diagnosis.")]
    session: Annotated[Path, described("Folder of a bench session or of `calibrate photos`, or a capture file.")]
    _: KW_ONLY
    out: Annotated[Path, described("Output folder.")] = Path("out/predict")


def predict(options: PredictOptions, *, progress: ProgressArgument = SILENT) -> Report:
    """Predict a session of one capture or more with a bench; writes the report into `options.out`.

    Raises:
        BadInputError: faulty files, a bench of another headset, or a folder that cannot be written.
    """
    progress.say("reading the session")
    path = options.bench / "bench.toml" if options.bench.is_dir() else options.bench
    if not path.is_file():
        raise BadInputError(f"{path}: does not exist; name a bench file, or a folder with bench.toml.")
    own, warnings = None, list[str]()
    if (options.session / "bench.toml").is_file():
        own, session = load_session(options.session)
        stated = load_bench(path)
        bench = bench_for_session(stated, own, path, options.session)
        warnings += _other_poses(stated, own, path)
    else:
        bench, session = load_measurements(options.session, path)
        warnings.append(
            "Captures state places and directions as calibrated: of the bench, only the headset's optics are tested."
        )
    folder = output_folder(options.out)
    progress.say("predicting the readings")
    found = predict_session(bench, session, own)
    report = Report(
        f"Prediction of {session.name} by {options.bench}",
        verdict=" ".join(_verdict(found, options.bench)),
        advice=[_advice(found, path, options.session)],
        warnings=[*warnings, *_warnings(found, bench)],
        blocks=[*_tables(found), _captures_plot(found), *_maps(found)],
        inputs=[options.bench, options.session],
        record=found,
    )
    return save_report(report, folder)


def _other_poses(stated: Bench, own: Bench, path: Path) -> list[str]:
    """A note if the bench file states other target poses than the session."""
    poses, used = stated.target.device_from_target, own.target.device_from_target
    if len(poses) == 0 or len(used) == 0:
        return []
    if poses.shape == used.shape and np.abs(poses - used).max() < _POSE_TOLERANCE_M:
        return []
    return [f"The target poses are those of the session; {path} states others, which are not used."]


def _verdict(found: BenchPrediction, bench: Path) -> Iterator[str]:
    """Whether the bench predicts the session to the noise; what the session's own bench does."""
    count = len(found.captures)
    captures = "the only capture" if count == 1 else f"the {count} captures"
    by_part = ", ".join(f"{part.name} {part.reduced_chi_squared:.3g}" for part in found.parts)
    noisy = [part for part in found.parts if not part.is_noise]
    chi_squared = f"reduced chi-squared {found.reduced_chi_squared:.3g} against the stated noise"
    detail = f"{chi_squared} ({by_part})" if len(found.parts) > 1 else chi_squared
    if not noisy:
        yield f"{bench} predicts {captures} of {found.session} to the noise: {detail}."
    else:
        worst = max(noisy, key=lambda part: part.reduced_chi_squared)
        yield (
            f"{bench} predicts {captures} of {found.session} to {worst.beyond_noise_arcmin:.2g}' rms per axis beyond "
            f"the noise of {worst.noise_arcmin:.2g}' ({worst.name}): {detail}."
        )
    if found.by_own_bench is not None:
        yield f"By the session's own bench it is {found.by_own_bench:.3g}."


def _advice(found: BenchPrediction, bench: Path, session: Path) -> str:
    if all(part.is_noise for part in found.parts):
        return f"Use this bench for such captures: wlr-render calibrate captures {session} --bench {bench}"
    return (
        "See which captures and distances are predicted worst, and diagnose what is left: "
        f"wlr-render diagnose {session} --bench {bench}"
    )


def _warnings(found: BenchPrediction, bench: Bench) -> Iterator[str]:
    if found.without_slip is not None:
        yield (
            f"The bench states a slip at {bench.mount.slip_time_s:g} s, which belongs to the session that it was found "
            f"in. Without it, the reduced chi-squared is {found.without_slip:.3g}."
        )
    if found.outliers:
        yield f"{found.outliers} readings are far from all others of their capture; no figure contains them."
    if found.unseen:
        yield f"{found.unseen} readings are not predicted: by this bench, they cannot be seen."


def _tables(found: BenchPrediction) -> Iterator[Block]:
    """Parts, target distances and captures."""
    notes = (
        "Residual: measured minus predicted, rms per axis. Reduced chi-squared: its mean square over that of the "
        "stated noise (point_sigma_px, or sigma_px of each reading); 1 is noise alone. No value is fitted.",
        "Scatter within photographs: about a smooth surface over each photograph; it shows the noise as it is.",
    )
    within = ("scatter within photographs (arcmin)", "reduced chi-squared against it")
    columns, rows = _group_table("part", found.parts)
    scatter = [[*row, each.within_arcmin, each.against_within] for row, each in zip(rows, found.parts, strict=True)]
    yield ReportTable("Parts", (*columns, *within), scatter, notes)
    if found.distances:
        yield ReportTable("Distances of the target from the camera", *_group_table("distance", found.distances))
    yield ReportTable("Captures", *_group_table("capture", found.captures))


def _group_table(first: str, groups: Sequence[PredictedGroup]) -> tuple[tuple[str, ...], list[list[Cell]]]:
    """Columns and rows; the session's own bench has a column if it is known."""
    columns = ("readings", "residual (arcmin)", "mean right (arcmin)", "mean down (arcmin)")
    more = ("stated noise (arcmin)", "reduced chi-squared", "standard error")
    rows: list[list[Cell]] = [
        [
            each.name,
            each.readings,
            each.rms_arcmin,
            *each.mean_arcmin,
            each.noise_arcmin,
            each.reduced_chi_squared,
            each.error,
            each.by_own_bench,
        ]
        for each in groups
    ]
    if all(each.by_own_bench is None for each in groups):
        return (first, *columns, *more), [row[:-1] for row in rows]
    return (first, *columns, *more, "by the session's own bench"), rows


def _captures_plot(found: BenchPrediction) -> Plot:
    """Rms residual of each capture over the stated noise."""
    series = [("this bench", [each.reduced_chi_squared for each in found.captures])]
    own = [each.by_own_bench for each in found.captures if each.by_own_bench is not None]
    if own:
        series.append(("the session's own bench", own))
    data = [
        {"type": "scatter", "mode": "markers", "name": name, "x": [each.name for each in found.captures]}
        | {"y": [float(np.sqrt(value)) for value in values]}
        for name, values in series
    ]
    layout = {"yaxis": axis("rms residual (sigma)", log=True), "xaxis": {"showticklabels": False}}
    return Plot("Residual of each capture", data, layout, "1 is noise alone.", 340)


def _maps(found: BenchPrediction) -> Iterator[Plot]:
    """Residuals over the camera's image, of the captures that are predicted worst."""
    observations = found.observations
    plan, readings = observations.session.plan, observations.session.readings
    places = {
        DISPLAY: None if plan.display is None else plan.display.camera_pixel,
        SEE_THROUGH: readings.dot_pixel,
    }
    for part, place in places.items():
        mine = observations.part == part
        if place is None or not np.any(mine & found.used):
            continue
        seen = observations.arcminutes(found.residual, part) * [1.0, -1.0]
        shown = _worst([each for each in found.captures if each.part == PART_NAMES[part]])
        named = np.array([str(capture) for capture in observations.captures])[observations.group]
        groups = {each.name: rows for each in shown if (rows := (found.used & (named == each.name))[mine]).any()}
        yield arrow_map(
            f"Residual over the camera's image: {PART_NAMES[part]}",
            {name: (place[rows], seen[rows]) for name, rows in groups.items()},
            "arcmin",
            ("u (px)", "v (px)"),
            y_down=True,
            caption="Measured minus predicted, of the captures that are predicted worst. Arrows in all directions are "
            "noise.",
        )


def _worst(captures: Sequence[PredictedGroup]) -> list[PredictedGroup]:
    return sorted(captures, key=lambda each: -each.reduced_chi_squared)[:_MOST_MAPS]
