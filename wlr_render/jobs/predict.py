"""Predict the captures of a session with a bench model from elsewhere, and report how well it predicts them."""

import shlex
from collections.abc import Iterator, Sequence
from dataclasses import KW_ONLY, dataclass
from pathlib import Path
from typing import Annotated

import numpy as np

from wlr_render.bench.bench import Bench
from wlr_render.bench.bench_file import load_bench
from wlr_render.bench.measurements import load_measurements
from wlr_render.bench.session_folder import bench_for_session, load_session
from wlr_render.diagnosis.bench_prediction import BenchPrediction, PredictedGroup, PredictedPart, predict_session
from wlr_render.diagnosis.diagnosis_plots import captures_plot
from wlr_render.diagnosis.noise import MATERIAL_VARIANCE
from wlr_render.diagnosis.observations import DISPLAY, PART_NAMES, SEE_THROUGH
from wlr_render.diagnosis.report import CORRECTED
from wlr_render.errors import BadInputError
from wlr_render.io.atomic_files import output_folder
from wlr_render.io.input_files import prefix_errors
from wlr_render.jobs.job import job
from wlr_render.jobs.options import Against, Options, ProgressArgument, described
from wlr_render.report.blocks import Block, Columns, Plot, Report, capitalised, table
from wlr_render.report.plots import arrow_map
from wlr_render.work.progress import SILENT

_MOST_MAPS = 8
_POSE_TOLERANCE_M = 1e-6


@dataclass(frozen=True)
class PredictOptions(Options):
    """Options of `predict`."""

    bench: Annotated[Path, described("Bench file, or a folder with bench.toml, e.g. DIR/corrected of a diagnosis.")]
    session: Annotated[Path, described("Bench session, output folder of `calibrate` on photographs, or capture file.")]
    _: KW_ONLY
    out: Annotated[Path, described("Output folder.")] = Path("out/predict")
    against: Against = None


@job
def predict(options: PredictOptions, *, progress: ProgressArgument = SILENT) -> Report:
    """Predict a session of one capture or more with a bench; writes the report into `options.out`.

    Raises:
        BadInputError: faulty files, a bench of another headset, or a folder that cannot be written.
    """
    progress.say("reading the session")
    path = _bench_file(options.bench)
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
    with prefix_errors(options.session):
        found = predict_session(bench, session, own)
    return Report(
        f"Prediction of {session.name} by {options.bench}",
        verdict=" ".join(_verdict(found, options.bench)),
        advice=[_advice(found, path, options.session, folder)],
        warnings=[*warnings, *_warnings(found, bench)],
        blocks=[*_tables(found), _captures_plot(found), *_maps(found)],
        inputs=[options.bench, options.session],
        record=found,
    )


def _bench_file(given: Path) -> Path:
    """Return the bench file that an argument names.

    Raises:
        BadInputError: it does not exist; for the report folder of `diagnose`, the message names the right folder.
    """
    path = given / "bench.toml" if given.is_dir() else given
    if path.is_file():
        return path
    corrected = given / CORRECTED
    if (corrected / "bench.toml").is_file():
        raise BadInputError(f"{given}: is the report folder of a diagnosis; its corrected bench is in {corrected}.")
    raise BadInputError(f"{path}: does not exist; name a bench file, or a folder with bench.toml.")


def _other_poses(stated: Bench, own: Bench, path: Path) -> list[str]:
    """Return a note if the bench file states other target poses than the session."""
    poses, used = stated.target.device_from_target, own.target.device_from_target
    if len(poses) == 0 or len(used) == 0:
        return []
    if poses.shape == used.shape and np.abs(poses - used).max() < _POSE_TOLERANCE_M:
        return []
    return [f"The session's target poses are used; the different ones in {path} are ignored."]


def _verdict(found: BenchPrediction, bench: Path) -> Iterator[str]:
    """Yield whether the bench predicts the session to noise and repeatability, then a sentence on each part."""
    count = len(found.captures)
    captures = f"the {count} captures of {found.session}" if count > 1 else f"the only capture of {found.session}"
    good, bad = ([part.name for part in found.parts if part.is_noise is wanted] for wanted in (True, False))
    if not bad:
        yield f"{bench} predicts {captures} to noise and repeatability."
    elif not good:
        yield f"{bench} does not predict {captures}."
    else:
        yield (
            f"{bench} does not predict {captures}: it predicts {' and '.join(good)} to noise and "
            f"repeatability, but not {' and '.join(bad)}."
        )
    for part in found.parts:
        yield _part_sentence(part, found.session)


def _part_sentence(part: PredictedPart, session: str) -> str:
    """Return a sentence on residual, noise and repeatability, and the comparison with the session's own bench."""
    noise = [f"noise {part.noise_arcmin:.3g}'"]
    noise += [f"errors of the bench's effects {part.effects_arcmin:.2g}'"] if part.effects_arcmin > 0.0 else []
    if part.shift_um is not None and part.is_noise:
        noise.append(f"repeatability {part.shift_um:.2g} um, {part.turn_urad:.2g} urad")
    text = (
        f"{capitalised(part.name)}: residual {part.rms_arcmin:.3g}' ({', '.join(noise)}), "
        f"reduced chi-squared {part.reduced_chi_squared:.4g}"
    )
    text += f" ({part.whitened:.3g} with measured noise and repeatability)" if part.is_noise else ""
    if part.by_own_bench is None:
        return f"{text}."
    is_worse = part.reduced_chi_squared > (1.0 + MATERIAL_VARIANCE) * part.by_own_bench
    compared = "better" if _is_better(part) else "worse" if is_worse else "no better"
    return f"{text}, {compared} than {session}'s own bench ({part.by_own_bench:.4g})."


def _is_better(part: PredictedPart) -> bool:
    """Return whether the bench predicts a part clearly better than the session's own bench does."""
    own = part.by_own_bench
    return own is not None and own > (1.0 + MATERIAL_VARIANCE) * part.reduced_chi_squared


def _advice(found: BenchPrediction, bench: Path, session: Path, folder: Path) -> str:
    def command(verb: str, with_bench: bool, out: str) -> str:
        chosen = ["--bench", str(bench)] if with_bench else []
        return "wlr-render " + shlex.join([*verb.split(), str(session), *chosen, "--out", str(folder / out)])

    known = found.by_own_bench is not None
    if found.is_noise:
        if not known:
            return "The optics of this bench predict these captures; they need no correction."
        if not {PART_NAMES[DISPLAY], PART_NAMES[SEE_THROUGH]} <= {part.name for part in found.parts}:
            return "This bench needs no correction for such captures."
        return f"Use this bench for such captures: {command('calibrate', True, 'calibrate')}"
    if known and not any(_is_better(part) for part in found.parts):
        return (
            "This bench predicts no better than the session's own; diagnose the session with its own bench: "
            f"{command('diagnose', False, 'diagnose')}"
        )
    return (
        "Find the captures and distances with the largest residuals below, and diagnose the rest: "
        f"{command('diagnose', True, 'diagnose')}"
    )


def _warnings(found: BenchPrediction, bench: Bench) -> Iterator[str]:
    if found.without_slip is not None:
        yield (
            f"The bench states a slip at {bench.mount.slip_time_s:g} s, which belongs to the session of its diagnosis. "
            f"Without the slip, the reduced chi-squared is {found.without_slip:.3g}."
        )
    if found.outliers:
        yield f"{found.outliers} readings are outliers among their neighbours in the photograph; all figures omit them."
    if found.unseen:
        yield f"{found.unseen} readings are not predicted: this bench predicts that they are not visible."


def _tables(found: BenchPrediction) -> Iterator[Block]:
    """Yield the tables of parts, target distances and captures."""
    notes = (
        "Residual: measured minus predicted, rms per axis. Reduced chi-squared: mean square of the residual over the "
        "variance of the stated noise (point_sigma_px, or sigma_px of each reading); 1 is noise alone. No value is "
        "fitted.",
        "With measured noise and repeatability: reduced chi-squared against the noise within the photographs, without "
        "the small motions of the camera from capture to capture. Shift and turn: their sizes, the repeatability.",
    )
    sizes = {"shift (um)": "shift_um", "turn (urad)": "turn_urad"}
    yield table("Parts", found.parts, {**_columns("part", found), **sizes}, notes)
    if found.distances:
        yield table("Distances of the target from the camera", found.distances, _columns("distance", found))
    yield table("Captures", found.captures, _columns("capture", found))


def _columns(first: str, found: BenchPrediction) -> Columns:
    """Return the columns of a table of groups, with one for the session's own bench if it is known."""
    own = {} if found.by_own_bench is None else {"by the session's own bench": "by_own_bench"}
    has_errors = any(part.effects_arcmin > 0.0 for part in found.parts)
    effects = {"errors of the bench's effects (arcmin)": "effects_arcmin"} if has_errors else {}
    return {
        first: "name",
        "readings": "readings",
        "residual (arcmin)": "rms_arcmin",
        "mean right (arcmin)": lambda group: group.mean_arcmin[0],
        "mean down (arcmin)": lambda group: group.mean_arcmin[1],
        "stated noise (arcmin)": "noise_arcmin",
        **effects,
        "reduced chi-squared": "reduced_chi_squared",
        "with measured noise and repeatability": "whitened",
        **own,
    }


def _captures_plot(found: BenchPrediction) -> Plot:
    """Plot the rms residual of each capture over the stated noise."""
    squares = {"this bench": [each.reduced_chi_squared for each in found.captures]}
    if found.by_own_bench is not None:
        squares["the session's own bench"] = [each.by_own_bench or np.nan for each in found.captures]
    rms = {name: [float(np.sqrt(value)) for value in values] for name, values in squares.items()}
    return captures_plot([each.name for each in found.captures], rms, "1 is noise alone.")


def _maps(found: BenchPrediction) -> Iterator[Plot]:
    """Yield residual maps over the camera's image, of the captures that are predicted worst."""
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
