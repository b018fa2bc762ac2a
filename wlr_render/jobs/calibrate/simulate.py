"""Simulate the captures of a device, fit models to them, and compare the models with the traced device."""

from collections.abc import Callable, Sequence
from dataclasses import KW_ONLY, dataclass, replace
from pathlib import Path
from typing import Annotated

import numpy as np

from wlr_render.atomic_files import output_folder
from wlr_render.calibration.fit_eye import EyeFit
from wlr_render.captures.capture_file import save_captures
from wlr_render.captures.correspondences import EyeCaptures
from wlr_render.evaluation import mapping_error
from wlr_render.evaluation.metrics import Summary, summary
from wlr_render.geometry.directions import dir_of_tangents
from wlr_render.jobs import limits
from wlr_render.jobs.calibrate.fit_findings import fit_advice, fit_blocks, fit_sentences, fit_warnings
from wlr_render.jobs.calibrate.fit_options import (
    DEFAULT_FIT,
    FitOptions,
    OutputFolder,
    remove_results,
    require_readable_models,
    save_models,
)
from wlr_render.jobs.job import job
from wlr_render.jobs.options import Eyes, Options, ProgressArgument, Seed, described, eyes_of, seed_of
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
_POINT_DIRECTION = "direction of a real point (arcmin)"


@dataclass(frozen=True)
class CalibrateSimulateOptions(Options):
    """Options of `calibrate simulate`."""

    device: Annotated[str, described("A shipped device or a device file (.toml).")]
    _: KW_ONLY
    eye: Annotated[Eyes, described("Eyes to calibrate.")] = "right"
    viewpoints: Annotated[int, described("Number of camera positions."), limits.PLACES] = 25
    noise_px: Annotated[
        float, described("Camera noise, standard deviation per axis, in pixels of 1 arcmin."), limits.ANGLE_ARCMIN
    ] = 0.25
    stage_error_mm: Annotated[
        float, described("Error of each camera position in mm, standard deviation per axis."), limits.POSITION_MM
    ] = 0.0
    stage_turn_urad: Annotated[
        float,
        described("Rotation error of the camera at each position in microradians, standard deviation per axis."),
        limits.ROTATION_URAD,
    ] = 0.0
    seed: Seed = 1
    fit: FitOptions = DEFAULT_FIT
    out: OutputFolder = Path("out/calibrate")


@job
def calibrate_simulate(options: CalibrateSimulateOptions, *, progress: ProgressArgument = SILENT) -> Report:
    """Simulate, fit and compare; writes model.json, captures-EYE.npz and the report into `options.out`.

    Raises:
        BadInputError: an unknown device, eye or prescription, an impossible bench, or captures that do not determine
            the models.
    """
    require_readable_models(options.out)
    device = load_device(options.device)
    truths = {eye: replace(traced_eye(device, eye), name=device.name) for eye in eyes_of(options.eye)}
    for eye in truths:
        options.fit.prescription_of(eye)
    blocks: list[Block] = []
    captures, fits, sentences = {}, [], []
    for eye, truth in progress(truths.items(), len(truths), "eyes"):
        captures[eye] = simulate_captures(truth, options)
        comparison = options.fit.fit(captures[eye])
        fit = comparison.chosen
        fields = {} if truth.field is None else {"in the nominal field": truth.field}
        tests = {
            where: TruthTests.of(truth, options.seed, field)
            for where, field in (fields | {"over the whole panel": None}).items()
        }
        compared = {where: (test.errors(fit.mappings), test.predicted(fit)) for where, test in tests.items()}
        fits.append(fit)
        rms = ", ".join(
            f"{errors[_PIXEL_DIRECTION].rms:.3g}' {where} ({predicted[_PIXEL_DIRECTION]:.3g}' predicted)"
            for where, (errors, predicted) in compared.items()
        )
        sentences.append(f"{fit_sentences(comparison)} Display error against the traced device, rms: {rms}.")
        blocks += [Section(f"The {eye} eye"), *fit_blocks(comparison, captures[eye])]
        blocks += [_truth_table(where, *each) for where, each in compared.items()]
    folder = output_folder(options.out)
    remove_results(folder, list(captures))
    model, notes = save_models(folder, fits)
    files = [model, *(save_captures(folder / f"captures-{eye}.npz", each) for eye, each in captures.items())]
    report = Report(
        f"Calibration of {device.name}, simulated",
        verdict=" ".join(sentences),
        advice=_of_each(fits, fit_advice),
        warnings=[*_of_each(fits, fit_warnings), *notes],
        blocks=blocks,
        inputs=[device_path(options.device), *options.fit.inputs],
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
    stage_turn_rad = 1e-6 * options.stage_turn_urad
    setup = CaptureSetup(truth, options.noise_px, 1e-3 * options.stage_error_mm, stage_turn_rad=stage_turn_rad)
    positions = setup.camera_positions(options.fit.kind or "planar", options.viewpoints)
    rng = np.random.default_rng(seed_of(options.seed, truth.eye))
    return EyeCaptures(simulate_display(setup, positions, rng), simulate_see_through(setup, positions, rng))


def _of_each(fits: Sequence[EyeFit], sentences: Callable[[EyeFit], list[str]]) -> list[str]:
    """Sentences about each fit, which name the eye if there are two."""
    return [
        f"{fit.mappings.eye.capitalize()} eye: {sentence}" if len(fits) > 1 else sentence
        for fit in fits
        for sentence in sentences(fit)
    ]


@dataclass(frozen=True)
class TruthTests:
    """Exact observations of an eye at random viewpoints in the eye box."""

    display: mapping_error.DisplayObservations
    see_through: mapping_error.SeeThroughObservations

    @classmethod
    def of(cls, truth: EyeMappings, seed: int, field: FieldOfView | None = None) -> "TruthTests":
        """Pixels random on the panel or, if `field` is given, in random directions of it; real points likewise."""
        rng = np.random.default_rng(seed_of(seed, truth.eye, 1))  # not the numbers that the captures were made with
        count, each = _TESTS
        viewpoint = viewpoints.random_in_eye_box(truth.eye_box, count, rng)[:, None]
        if field is None:
            pixel = rng.uniform(0.0, 1.0, (count, each, 2)) * truth.display.panel.size_px
            seen = mapping_error.observations_of_pixels(truth.display, viewpoint, pixel)
        else:
            view_dir = dir_of_tangents(rng.uniform(field.low, field.high, (count, each, 2)))
            seen = mapping_error.observations_of_dirs(truth.display, viewpoint, view_dir)
        near, far = _TEST_DEPTHS_M
        depth = 1.0 / rng.uniform(1.0 / far, 1.0 / near, len(seen.pixel))
        points = mapping_error.see_through_observations(truth.see_through, seen.viewpoint, seen.view_dir, depth)
        return cls(seen, points)

    def errors(self, model: EyeMappings) -> dict[str, Summary]:
        """Errors of a model, by name with unit."""
        display = mapping_error.display_error(model.display, self.display)
        world = mapping_error.see_through_error(model.see_through, self.see_through)
        return {
            _PIXEL_DIRECTION: summary(display.forward_arcmin),
            "pixel of a direction (px)": summary(display.backward_px),
            _POINT_DIRECTION: summary(world.backward_arcmin),
            "direction of a real ray (arcmin)": summary(world.forward_arcmin),
        }

    def predicted(self, fit: EyeFit) -> dict[str, float]:
        """Rms errors that a fit expects of itself there, of those that it predicts."""
        shown, seen = self.display, self.see_through
        display, see_through = fit.both
        return {
            _PIXEL_DIRECTION: summary(display.mapping.sigma(shown.pixel, shown.viewpoint)).rms,
            _POINT_DIRECTION: summary(see_through.mapping.sigma(seen.point, seen.viewpoint)).rms,
        }


def _truth_table(where: str, errors: dict[str, Summary], predicted: dict[str, float]) -> ReportTable:
    rows: list[list[Cell]] = [
        [name, each.rms, predicted.get(name), each.median, each.p95, each.maximum, each.count, each.missing]
        for name, each in errors.items()
    ]
    (count, _), (near, far) = _TESTS, _TEST_DEPTHS_M
    columns = ["error", "rms", "predicted rms", "median", "p95", "maximum", "tests", "no answer"]
    notes = (
        f"{count} random viewpoints in the eye box; real points at {near:g} to {far:g} m.",
        "Predicted: what the fit expects of itself at the same viewpoints, pixels and points.",
    )
    return ReportTable(f"Error against the traced device {where}", columns, rows, notes)
