"""Calibrate one eye: captures in, model file and fit report out; the captures may be simulated."""

from collections.abc import Mapping
from dataclasses import asdict, dataclass, replace
from pathlib import Path

import numpy as np

from wlr_render import files
from wlr_render.calibration.fit_eye import EyeFit, fit_eye
from wlr_render.calibration.fit_report import FitReport
from wlr_render.captures.capture_file import load_captures, save_captures
from wlr_render.captures.correspondences import EyeCaptures
from wlr_render.errors import BadInputError
from wlr_render.evaluation import mapping_error
from wlr_render.evaluation.metrics import Summary, summary
from wlr_render.jobs.designs import camera_positions
from wlr_render.jobs.options import seed_of
from wlr_render.mappings import EyeMappings
from wlr_render.models.model_file import add_eye_models
from wlr_render.optics.device_file import load_device
from wlr_render.optics.traced_mappings import traced_eye
from wlr_render.report.blocks import Cell, ReportTable, tables_as_json
from wlr_render.simulation import viewpoints
from wlr_render.simulation.session_captures import captures_of
from wlr_render.simulation.session_folder import load_session
from wlr_render.simulation.simulate_captures import CaptureSetup, simulate_display, simulate_see_through

_TESTS = (100, 60)  # random viewpoints, and random pixels seen from each
_TEST_DEPTHS_M = (0.3, 5.0)


@dataclass(frozen=True)
class FitOptions:
    """Which models to fit.

    Attributes:
        kind: "planar", "volumetric", "static" or "point-per-pixel".
        display_degree, see_through_degree: total degrees N, or None to choose them by held-out camera positions.
    """

    kind: str = "planar"
    display_degree: int | None = 5
    see_through_degree: int | None = 3


@dataclass(frozen=True)
class SimulationOptions:
    """How captures are simulated.

    Attributes:
        viewpoints: number of camera positions.
        camera_noise_arcmin: standard deviation per axis; 1 is one pixel of a camera with a pixel per arcminute.
        stage_error_mm: standard deviation of each camera position per axis.
        seed: of all random numbers.
    """

    viewpoints: int = 25
    camera_noise_arcmin: float = 0.0
    stage_error_mm: float = 0.0
    seed: int = 0


@dataclass(frozen=True)
class Calibration:
    """A calibrated eye.

    Attributes:
        fit: the models.
        tables: what the fit says of itself and, for simulated captures, how far it is from the truth.
        files: what was written.
    """

    fit: EyeFit
    tables: tuple[ReportTable, ...]
    files: tuple[Path, ...]


def calibrate_simulated(
    device: str | Path,
    folder: str | Path,
    eye: str = "right",
    simulation: SimulationOptions = SimulationOptions(),
    fit: FitOptions = FitOptions(),
) -> Calibration:
    """Simulate the bench, fit, and compare with the traced truth; writes captures.npz, model.json, fit.md and fit.json.

    The camera stands where `designs.camera_positions` says for the kind of model.

    Raises:
        BadInputError: an unknown device or eye, an impossible bench, or too few viewpoints for the degree.
    """
    described = load_device(device)
    truth = replace(traced_eye(described, eye), name=described.name)
    captures = simulate(truth, fit.kind, simulation)
    fitted = fit_eye(captures, fit.kind, fit.display_degree, fit.see_through_degree)
    written = save_captures(files.output_folder(folder) / "captures.npz", captures)
    tables = (*fit_tables(fitted), _truth_table(fitted.mappings, truth, simulation.seed))
    context = {"device": described.name, "eye": eye, "simulation": asdict(simulation), "fit": asdict(fit)}
    return Calibration(fitted, tables, (written, *_write(folder, fitted, tables, context)))


def calibrate_from_captures(
    captures: str | Path, folder: str | Path, fit: FitOptions = FitOptions(), bench: str | Path | None = None
) -> Calibration:
    """Fit a capture file or a bench session; writes model.json, fit.md and fit.json.

    Args:
        captures: an .npz, or a session's folder.
        folder: for the results.
        fit: which models.
        bench: file of the bench that a session is read by; None for the session's own.

    Raises:
        BadInputError: what is given cannot be read, lacks see-through captures, or does not determine the models.
    """
    measured = _measured(captures, bench)
    fitted = fit_eye(measured, fit.kind, fit.display_degree, fit.see_through_degree)
    tables = fit_tables(fitted)
    context = {"device": measured.display.device, "eye": measured.display.eye, "fit": asdict(fit)}
    return Calibration(fitted, tables, _write(folder, fitted, tables, context))


def _measured(captures: str | Path, bench: str | Path | None) -> EyeCaptures:
    if Path(captures).is_dir():
        return captures_of(*load_session(captures, bench))
    if bench is not None:
        raise BadInputError(f"{captures}: is no session's folder, so no bench can be chosen for it; leave out --bench.")
    return load_captures(captures)


def simulate(truth: EyeMappings, kind: str, options: SimulationOptions) -> EyeCaptures:
    """Captures of both sides of an eye, taken where a kind of model wants them."""
    setup = CaptureSetup(truth, options.camera_noise_arcmin, 1e-3 * options.stage_error_mm)
    positions = camera_positions(setup, kind, options.viewpoints)
    rng = np.random.default_rng(seed_of(options.seed, truth.eye))
    return EyeCaptures(simulate_display(setup, positions, rng), simulate_see_through(setup, positions, rng))


def _write(
    folder: str | Path, fitted: EyeFit, tables: tuple[ReportTable, ...], context: Mapping[str, object]
) -> tuple[Path, ...]:
    into = files.output_folder(folder)
    text = "\n".join([f"# {fitted.mappings.name}\n", *(table.markdown() for table in tables)])
    add_eye_models(into / "model.json", [fitted.model()])
    return (
        into / "model.json",
        files.write_text(into / "fit.md", text),
        files.write_text(into / "fit.json", tables_as_json(tables, **context)),
    )


def fit_tables(fitted: EyeFit) -> tuple[ReportTable, ...]:
    """What the fits say of themselves: residuals, and errors at held-out camera positions."""
    return _residual_table(fitted), _held_out_table(fitted)


def _residual_table(fitted: EyeFit) -> ReportTable:
    rows: list[list[Cell]] = []
    for name, report in _reports(fitted):
        held_out = report.held_out_at_degree()
        sizes: list[Cell] = [report.kind, report.degree, report.viewpoints, report.samples, report.condition]
        residual = report.residual_arcmin
        rows.append([name, *sizes, residual.rms, residual.p95, held_out.rms if held_out else None, report.unsolved])
    columns = ["mapping", "model", "N", "viewpoints", "samples", "condition", "residual rms (arcmin)"]
    columns += ["residual p95 (arcmin)", "held-out rms (arcmin)", "unsolved"]
    return ReportTable("Fit", columns, rows, ("Held-out: camera positions that were left out of the fit.",))


def _held_out_table(fitted: EyeFit) -> ReportTable:
    rows = [
        [name, tried.degree, tried.rms, tried.standard_error, "chosen" if tried.degree == report.degree else ""]
        for name, report in _reports(fitted)
        for tried in report.held_out_arcmin
    ]
    columns = ["mapping", "N", "held-out rms (arcmin)", "its standard error (arcmin)", "degree"]
    return ReportTable("Held-out camera positions, by degree", columns, rows)


def _reports(fitted: EyeFit) -> tuple[tuple[str, FitReport], ...]:
    return ("display", fitted.display), ("see-through", fitted.see_through)


def truth_errors(model: EyeMappings, truth: EyeMappings, seed: int) -> dict[str, Summary]:
    """Errors of a model at random viewpoints in the eye box and random pixels and real points, by name with unit."""
    rng = np.random.default_rng(seed_of(seed, truth.eye, 1))  # not the numbers that the captures were made with
    count, each = _TESTS
    viewpoint = viewpoints.random_in_eye_box(truth.eye_box, count, rng)[:, None]
    pixel = rng.uniform(0.0, 1.0, (count, each, 2)) * truth.display.panel.size_px
    seen = mapping_error.sightings_of_pixels(truth.display, viewpoint, pixel)
    display = mapping_error.display_error(model.display, seen)
    near, far = _TEST_DEPTHS_M
    depth = 1.0 / rng.uniform(1.0 / far, 1.0 / near, len(seen.pixel))
    points = mapping_error.see_through_sightings(truth.see_through, seen.viewpoint, seen.view_dir, depth)
    world = mapping_error.see_through_error(model.see_through, points)
    return {
        "direction of a pixel (arcmin)": summary(display.forward_arcmin),
        "pixel of a direction (px)": summary(display.backward_px),
        "direction of a real point (arcmin)": summary(world.backward_arcmin),
        "direction of a real ray (arcmin)": summary(world.forward_arcmin),
    }


def _truth_table(model: EyeMappings, truth: EyeMappings, seed: int) -> ReportTable:
    rows = [_summary_row(name, errors) for name, errors in truth_errors(model, truth, seed).items()]
    (count, _), (near, far) = _TESTS, _TEST_DEPTHS_M
    title = f"Against the traced truth: {count} random viewpoints in the eye box, real points at {near:g} to {far:g} m"
    return ReportTable(title, ["error", "rms", "median", "p95", "maximum", "tests", "no answer"], rows)


def _summary_row(name: str, errors: Summary) -> list[Cell]:
    return [name, errors.rms, errors.median, errors.p95, errors.maximum, errors.count, errors.missing]
