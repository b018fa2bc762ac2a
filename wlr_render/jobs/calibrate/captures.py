"""Fit models to a capture file or to a bench session."""

from pathlib import Path

from wlr_render.bench.session_captures import captures_of
from wlr_render.bench.session_folder import load_session
from wlr_render.captures.capture_checks import place_warnings
from wlr_render.captures.capture_file import load_captures
from wlr_render.io.atomic_files import output_folder
from wlr_render.io.input_files import prefix_errors
from wlr_render.jobs.calibrate.calibrate_options import (
    CalibrateOptions,
    remove_results,
    require_readable_models,
    save_models,
)
from wlr_render.jobs.calibrate.fit_findings import fit_advice, fit_blocks, fit_sentences, fit_warnings
from wlr_render.jobs.calibrate.validate import validated, with_validations
from wlr_render.jobs.options import ProgressArgument
from wlr_render.report.blocks import Report
from wlr_render.work.progress import SILENT


def calibrate_captures(options: CalibrateOptions, *, progress: ProgressArgument = SILENT) -> Report:
    """Fit the models of one eye; write model.json and the report into `options.out`.

    Files of this eye from an earlier calibration are removed: models of primaries, pictures, and the station and
    captures unless they are the input in `options.path`.

    Raises:
        BadInputError: captures, bench or prescription cannot be read, or the captures do not determine the models.
    """
    path = Path(options.path)
    require_readable_models(options.out)
    progress.say("fitting the models")
    captures = captures_of(*load_session(path, options.bench)).in_colour() if path.is_dir() else load_captures(path)
    with prefix_errors(path):
        comparison = options.fit_of(captures)
    fit, folder = comparison.chosen, output_folder(options.out)
    is_own = path.resolve() == (folder / f"captures-{fit.mappings.eye}.npz").resolve()
    remove_results(folder, [fit.mappings.eye], keep_captures=is_own)
    model, notes = save_models(folder, [fit])
    validation = validated(comparison, options, folder, progress)
    report = Report(
        f"Calibration of {fit.device}, {fit.mappings.eye} eye",
        verdict=fit_sentences(comparison),
        advice=fit_advice(fit),
        warnings=[*place_warnings(captures), *fit_warnings(fit), *notes],
        blocks=fit_blocks(comparison, captures),
        inputs=[each for each in (path, options.bench) if each is not None] + options.fit.inputs,
        files=[model],
        record={"device": fit.device, "fits": {fit.mappings.eye: fit.model().report}},
    )
    return with_validations(report, {fit.mappings.eye: validation})
