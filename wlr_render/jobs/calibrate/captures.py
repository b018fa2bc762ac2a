"""Fit models to a capture file or to a bench session."""

from dataclasses import KW_ONLY, dataclass
from pathlib import Path
from typing import Annotated

from wlr_render.atomic_files import output_folder
from wlr_render.bench.session_captures import captures_of
from wlr_render.bench.session_folder import load_session
from wlr_render.captures.capture_file import load_captures, place_warnings
from wlr_render.errors import BadInputError
from wlr_render.input_files import naming
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
from wlr_render.jobs.options import Options, ProgressArgument, described
from wlr_render.progress import SILENT
from wlr_render.report.blocks import Report
from wlr_render.report.save import save_report


@dataclass(frozen=True)
class CalibrateCapturesOptions(Options):
    """Options of `calibrate captures`."""

    captures: Annotated[Path, described("A capture file (.npz), or the folder of a bench session.")]
    _: KW_ONLY
    bench: Annotated[
        Path | None,
        described("Bench file to read a session with, e.g. the corrected one (default: the session's own)."),
    ] = None
    fit: FitOptions = DEFAULT_FIT
    out: OutputFolder = Path("out/calibrate")


@job
def calibrate_captures(options: CalibrateCapturesOptions, *, progress: ProgressArgument = SILENT) -> Report:
    """Fit the models of one eye; writes model.json and the report into `options.out`.

    What an earlier calibration wrote there of this eye is removed: models of primaries, pictures, and the station and
    captures if they are not those of `options.captures`.

    Raises:
        BadInputError: captures, bench or prescription cannot be read, or the captures lack see-through captures or do
            not determine the models.
    """
    require_readable_models(options.out)
    progress.say("fitting the models")
    if options.captures.is_dir():
        captures = captures_of(*load_session(options.captures, options.bench))
    elif options.bench is not None:
        raise BadInputError(
            f"{options.captures}: is no session's folder, so no bench can be chosen for it; leave out --bench."
        )
    else:
        captures = load_captures(options.captures)
    with naming(options.captures):
        comparison = options.fit.fit(captures)
    fit, folder = comparison.chosen, output_folder(options.out)
    is_own = options.captures.resolve() == (folder / f"captures-{fit.mappings.eye}.npz").resolve()
    remove_results(folder, [fit.mappings.eye], keep_captures=is_own)
    model, notes = save_models(folder, [fit])
    report = Report(
        f"Calibration of {fit.device}, {fit.mappings.eye} eye",
        verdict=fit_sentences(comparison),
        advice=fit_advice(fit),
        warnings=[*place_warnings(captures), *fit_warnings(fit), *notes],
        blocks=fit_blocks(comparison, captures),
        inputs=[path for path in (options.captures, options.bench) if path is not None] + options.fit.inputs,
        files=[model],
        record={"options": options, "device": fit.device, "fits": {fit.mappings.eye: fit.model().report}},
    )
    return save_report(report, folder)
