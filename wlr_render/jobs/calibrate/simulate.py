"""Simulate the captures of a device, fit models to them, and compare the models with the traced device."""

from dataclasses import KW_ONLY, dataclass, replace
from pathlib import Path
from typing import Annotated

import numpy as np

from wlr_render.captures.capture_file import save_captures
from wlr_render.captures.correspondences import EyeCaptures
from wlr_render.evaluation import mapping_error
from wlr_render.evaluation.metrics import Summary, summary
from wlr_render.files import output_folder
from wlr_render.geometry.directions import dir_of_tangents
from wlr_render.jobs.calibrate.fit import DEFAULT_FIT, FitOptions, OutputFolder, fit_blocks, fit_sentence, save_models
from wlr_render.jobs.options import Eyes, Options, ProgressArgument, Range, Seed, described, eyes_of, seed_of
from wlr_render.mappings import EyeMappings, FieldOfView
from wlr_render.optics.device_file import device_path, load_device
from wlr_render.optics.traced_mappings import traced_eye
from wlr_render.progress import SILENT
from wlr_render.report.blocks import Block, Cell, Report, ReportTable, Section
from wlr_render.report.save import save_report
from wlr_render.simulation import viewpoints
from wlr_render.simulation.simulate_captures import CaptureSetup, simulate_display, simulate_see_through

_TESTS = (100, 60)  # random viewpoints, and random pixels seen from each
_TEST_DEPTHS_M = (0.3, 5.0)
_PIXEL_DIRECTION = "direction of a pixel (arcmin)"


@dataclass(frozen=True)
class CalibrateSimulateOptions(Options):
    """Options of `calibrate simulate`."""

    device: Annotated[str, described("A shipped device or a device file (.toml).")]
    _: KW_ONLY
    eye: Annotated[Eyes, described("Eyes to calibrate.")] = "right"
    viewpoints: Annotated[int, described("Number of camera positions."), Range(at_least=1)] = 25
    noise_px: Annotated[
        float, described("Camera noise, standard deviation per axis, in pixels of 1 arcmin."), Range(at_least=0)
    ] = 0.25
    stage_error_mm: Annotated[
        float, described("Error of each camera position in mm, standard deviation per axis."), Range(at_least=0)
    ] = 0.0
    stage_turn_urad: Annotated[
        float,
        described("Rotation error of the camera at each position in microradians, standard deviation per axis."),
        Range(at_least=0),
    ] = 0.0
    seed: Seed = 1
    fit: FitOptions = DEFAULT_FIT
    out: OutputFolder = Path("out/calibrate")


def calibrate_simulate(options: CalibrateSimulateOptions, *, progress: ProgressArgument = SILENT) -> Report:
    """Simulate, fit and compare; writes model.json, captures-EYE.npz and the report into `options.out`.

    Raises:
        BadInputError: an unknown device or eye, an impossible bench, or too few viewpoints for the degree.
    """
    device = load_device(options.device)
    truths = {eye: replace(traced_eye(device, eye), name=device.name) for eye in eyes_of(options.eye)}
    blocks: list[Block] = []
    captures, fits, sentences = {}, [], []
    for eye, truth in progress(truths.items(), len(truths), "eyes"):
        captures[eye] = simulate_captures(truth, options)
        fit = options.fit.fit(captures[eye])
        errors = {"over the whole panel": truth_errors(fit.mappings, truth, options.seed)}
        if truth.field is not None:
            errors = {"in the nominal field": truth_errors(fit.mappings, truth, options.seed, truth.field)} | errors
        fits.append(fit)
        rms = ", ".join(f"{found[_PIXEL_DIRECTION].rms:.3g}' {where}" for where, found in errors.items())
        sentences.append(f"{fit_sentence(fit)} Display error against the traced device, rms: {rms}.")
        blocks += [Section(f"The {eye} eye"), *fit_blocks(fit, captures[eye])]
        blocks += [_truth_table(where, found) for where, found in errors.items()]
    folder = output_folder(options.out)
    model, notes = save_models(folder, fits)
    files = [model, *(save_captures(folder / f"captures-{eye}.npz", each) for eye, each in captures.items())]
    report = Report(
        f"Calibration of {device.name}, simulated",
        verdict=" ".join(sentences),
        warnings=notes,
        blocks=blocks,
        inputs=[device_path(options.device)],
        files=files,
        record={
            "options": options,
            "device": device.name,
            "fits": {fit.mappings.eye: fit.model().report for fit in fits},
        },
    )
    return save_report(report, folder)


def simulate_captures(truth: EyeMappings, options: CalibrateSimulateOptions) -> EyeCaptures:
    """Captures of both sides of an eye, taken where the type of model needs them."""
    setup = CaptureSetup(
        truth, options.noise_px, 1e-3 * options.stage_error_mm, stage_turn_rad=1e-6 * options.stage_turn_urad
    )
    positions = setup.camera_positions(options.fit.kind, options.viewpoints)
    rng = np.random.default_rng(seed_of(options.seed, truth.eye))
    return EyeCaptures(simulate_display(setup, positions, rng), simulate_see_through(setup, positions, rng))


def truth_errors(
    model: EyeMappings, truth: EyeMappings, seed: int, field: FieldOfView | None = None
) -> dict[str, Summary]:
    """Errors of a model at random viewpoints in the eye box, by name with unit.

    Pixels are random on the panel or, if `field` is given, in random directions of that field of view; real points lie
    in the same directions.
    """
    rng = np.random.default_rng(seed_of(seed, truth.eye, 1))  # not the numbers that the captures were made with
    count, each = _TESTS
    viewpoint = viewpoints.random_in_eye_box(truth.eye_box, count, rng)[:, None]
    if field is None:
        pixel = rng.uniform(0.0, 1.0, (count, each, 2)) * truth.display.panel.size_px
        seen = mapping_error.observations_of_pixels(truth.display, viewpoint, pixel)
    else:
        view_dir = dir_of_tangents(rng.uniform(field.low, field.high, (count, each, 2)))
        seen = mapping_error.observations_of_dirs(truth.display, viewpoint, view_dir)
    display = mapping_error.display_error(model.display, seen)
    near, far = _TEST_DEPTHS_M
    depth = 1.0 / rng.uniform(1.0 / far, 1.0 / near, len(seen.pixel))
    points = mapping_error.see_through_observations(truth.see_through, seen.viewpoint, seen.view_dir, depth)
    world = mapping_error.see_through_error(model.see_through, points)
    return {
        _PIXEL_DIRECTION: summary(display.forward_arcmin),
        "pixel of a direction (px)": summary(display.backward_px),
        "direction of a real point (arcmin)": summary(world.backward_arcmin),
        "direction of a real ray (arcmin)": summary(world.forward_arcmin),
    }


def _truth_table(where: str, errors: dict[str, Summary]) -> ReportTable:
    rows: list[list[Cell]] = [
        [name, each.rms, each.median, each.p95, each.maximum, each.count, each.missing] for name, each in errors.items()
    ]
    (count, _), (near, far) = _TESTS, _TEST_DEPTHS_M
    title = f"Error against the traced device {where}"
    note = f"{count} random viewpoints in the eye box; real points at {near:g} to {far:g} m."
    return ReportTable(title, ["error", "rms", "median", "p95", "maximum", "tests", "no answer"], rows, (note,))
