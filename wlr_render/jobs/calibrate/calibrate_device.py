"""Simulate the captures of a device, fit models to them, and compare the models with the traced device."""

from collections.abc import Callable, Sequence
from dataclasses import replace

from wlr_render.calibration.fit_eye import Calibration, KindComparison
from wlr_render.captures.correspondences import Captures
from wlr_render.evaluation.metrics import Summary, summary
from wlr_render.evaluation.truth_tests import PIXEL_DIRECTION, POINT_DIRECTION, TEST_DEPTHS_M, TESTS, TruthTests
from wlr_render.io.atomic_files import output_folder
from wlr_render.jobs.calibrate.calibrate_options import (
    CalibrateOptions,
    remove_results,
    require_readable_models,
    save_models,
)
from wlr_render.jobs.calibrate.fit_findings import fit_advice, fit_blocks, fit_sentences, fit_warnings
from wlr_render.jobs.calibrate.validate import validated, with_validations
from wlr_render.jobs.options import ProgressArgument, eyes_of, seed_of
from wlr_render.mappings import Eye
from wlr_render.optics.device_file import device_path, load_device
from wlr_render.optics.traced_mappings import traced_eye
from wlr_render.report.blocks import Block, Cell, Report, ReportTable, Section
from wlr_render.simulation.simulate_captures import simulate
from wlr_render.work.progress import SILENT


def calibrate_device(options: CalibrateOptions, *, progress: ProgressArgument = SILENT) -> Report:
    """Simulate, fit and compare; writes model.json, captures-EYE.npz and the report into `options.out`.

    Raises:
        BadInputError: an unknown device, eye or prescription, an impossible bench, or captures that do not determine
            the models.
    """
    require_readable_models(options.out)
    device = load_device(options.path)
    truths = {eye: replace(traced_eye(device, eye), name=device.name) for eye in eyes_of(options.eye)}
    for eye in truths:
        options.fit.prescription_of(eye)
    blocks: list[Block] = []
    captures, fits, sentences = {}, [], []
    comparisons: dict[str, KindComparison] = {}
    for eye, truth in progress(truths.items(), len(truths), "eyes"):
        captures[eye] = simulate_captures(truth, options)
        comparison = comparisons[eye] = options.fit_of(captures[eye])
        fit = comparison.chosen
        fields = {} if truth.field is None else {"in the nominal field": truth.field}
        tests = {
            where: TruthTests.of(truth, seed_of(options.seed, truth.eye, 1), field)
            for where, field in (fields | {"over the whole panel": None}).items()
        }
        compared = {where: (test.errors(fit.mappings), predicted_errors(test, fit)) for where, test in tests.items()}
        fits.append(fit)
        rms = ", ".join(
            f"{errors[PIXEL_DIRECTION].rms:.3g}' {where} ({predicted[PIXEL_DIRECTION]:.3g}' predicted)"
            for where, (errors, predicted) in compared.items()
        )
        sentences.append(f"{fit_sentences(comparison)} Display error against the traced device, rms: {rms}.")
        blocks += [Section(f"The {eye} eye"), *fit_blocks(comparison, captures[eye])]
        blocks += [_truth_table(where, *each) for where, each in compared.items()]
    folder = output_folder(options.out)
    remove_results(folder, list(captures))
    model, notes = save_models(folder, fits)
    files = [model, *(each.save(folder / f"captures-{eye}.npz") for eye, each in captures.items())]
    report = Report(
        f"Calibration of {device.name}, simulated",
        verdict=" ".join(sentences),
        advice=_of_each(fits, fit_advice),
        warnings=[*_of_each(fits, fit_warnings), *notes],
        blocks=blocks,
        inputs=[device_path(options.path), *options.fit.inputs],
        files=files,
        record={
            "device": device.name,
            "fits": {fit.mappings.eye: fit.model().report for fit in fits},
        },
    )
    validations = {eye: validated(each, options, folder, progress) for eye, each in comparisons.items()}
    return with_validations(report, validations)


def simulate_captures(truth: Eye, options: CalibrateOptions) -> Captures:
    """Simulate display and see-through captures of an eye, from the positions that the type of model needs."""
    kind = options.fit.kind
    return simulate(
        truth,
        options.viewpoints,
        options.noise_arcmin,
        seed_of(options.seed, truth.eye),
        sampling=kind if kind == "volumetric" or kind == "static" else "planar",
        stage_error_m=1e-6 * options.repeatability_um,
        stage_turn_rad=1e-6 * options.turn_jitter_urad,
    )


def _of_each(fits: Sequence[Calibration], sentences: Callable[[Calibration], list[str]]) -> list[str]:
    """Return the sentences about each fit; they name the eye if there are two fits."""
    return [
        f"{fit.mappings.eye.capitalize()} eye: {sentence}" if len(fits) > 1 else sentence
        for fit in fits
        for sentence in sentences(fit)
    ]


def predicted_errors(tests: TruthTests, fit: Calibration) -> dict[str, float]:
    """Return the rms errors that a fit predicts for these tests."""
    shown, seen = tests.display, tests.see_through
    display, see_through = fit.both
    return {
        PIXEL_DIRECTION: summary(display.mapping.sigma(shown.pixel, shown.viewpoint)).rms,
        POINT_DIRECTION: summary(see_through.mapping.sigma(seen.point, seen.viewpoint)).rms,
    }


def _truth_table(where: str, errors: dict[str, Summary], predicted: dict[str, float]) -> ReportTable:
    rows: list[list[Cell]] = [
        [name, each.rms, predicted.get(name), each.median, each.p95, each.maximum, each.count, each.missing]
        for name, each in errors.items()
    ]
    (count, _), (near, far) = TESTS, TEST_DEPTHS_M
    columns = ["error", "rms", "predicted rms", "median", "p95", "maximum", "tests", "no answer"]
    notes = (
        f"{count} random viewpoints in the eye box; real points at {near:g} to {far:g} m.",
        "Predicted: the standard error of the fit at the same viewpoints, pixels and points.",
    )
    return ReportTable(f"Error against the traced device {where}", columns, rows, notes)
