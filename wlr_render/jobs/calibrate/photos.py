"""Calibrate cameras, stage and one or both eyes from the photographs of a session."""

from collections.abc import Sequence
from pathlib import Path
from typing import Any

from wlr_render.calibration.calibrate_session import (
    RefusedCalibrationError,
    SessionCalibration,
    calibrate_session,
    worst_first,
)
from wlr_render.captures.photo_session import PhotoSession
from wlr_render.captures.photo_session_file import load_photo_session
from wlr_render.captures.session_reading import read_session
from wlr_render.errors import BadInputError
from wlr_render.io.atomic_files import output_folder
from wlr_render.io.input_files import prefix_errors
from wlr_render.jobs.calibrate.calibrate_options import (
    MODEL_FILE,
    MODELS_OF_PRIMARIES,
    RESULTS,
    CalibrateOptions,
    remove_results,
    require_readable_models,
    save_models,
)
from wlr_render.jobs.calibrate.fit_findings import fit_warnings
from wlr_render.jobs.calibrate.photo_report import advice, headline, reading_blocks, session_blocks, set_names
from wlr_render.jobs.calibrate.validate import validated, with_validations
from wlr_render.jobs.options import ProgressArgument
from wlr_render.models.model_file import remove_eye_models
from wlr_render.report.blocks import Report
from wlr_render.report.save import save_report
from wlr_render.work.progress import SILENT, Progress

_REPORT = ("report.html", "report.md", "report.json")
READ = "read"
"""Subfolder of the output folder for readings of photographs; a later run reads only new photographs."""


def calibrated(options: CalibrateOptions, *, progress: ProgressArgument = SILENT) -> SessionCalibration:
    """Read the photographs and calibrate; write station-EYE.json and captures-EYE.npz.

    Raises:
        BadInputError: session.toml is faulty, too few photographs could be read, or the steps contradict each other.
            The readings are kept, and the report shows how far the calibration got.
    """
    session = load_photo_session(Path(options.path))
    for eye in session.eyes:  # refuse a faulty prescription before the photographs are read
        options.fit.prescription_of(eye)
    folder = output_folder(options.out)
    _remove_results(folder, session.eyes)
    reading = read_session(session, folder / READ, options.worker_pool, progress)
    progress.say("calibrating the bench, fitting the models")
    with prefix_errors(Path(options.path)):
        try:
            return calibrate_session(session, reading, folder, options.fit_of)
        except RefusedCalibrationError as refused:
            _save_refusal(refused, session, options)
            raise BadInputError(f"{refused} What was read and found is in {folder / 'report.html'}.") from refused


def _remove_results(folder: Path, eyes: Sequence[str]) -> None:
    """Delete the results of an earlier run, so that a failed run leaves none."""
    require_readable_models(folder)
    remove_results(folder, eyes)
    remove_eye_models(folder / MODEL_FILE, eyes)
    for name in _REPORT:
        (folder / name).unlink(missing_ok=True)


def _save_refusal(refused: RefusedCalibrationError, session: PhotoSession, options: CalibrateOptions) -> None:
    """Write the report of a refused calibration, with the completed steps and every exclusion."""
    folder, found, reading = output_folder(options.out), refused.found, refused.reading
    report = Report(
        f"Calibration of {session.device}, {' and '.join(session.eyes)} eye: refused",
        verdict=f"Refused: {refused}",
        advice=[] if found is None else advice(found),
        warnings=reading.notes,
        blocks=reading_blocks(session, reading, worst_first(reading.excluded))
        if found is None
        else session_blocks(found, folder),
        inputs=[Path(options.path), *options.fit.inputs],
        record={"device": session.device, "is_refused": True},
        verb="calibrate",
        options=options.recipe_values(),
    )
    save_report(report, folder)


def _record(found: SessionCalibration) -> dict[str, Any]:
    fits = {eye: each.fit.model().report for eye, each in found.eyes.items()}
    return {"eye": found.session.eye, "fit": fits[found.session.eye]} if len(fits) == 1 else {"eyes": fits}


def report_of(found: SessionCalibration, options: CalibrateOptions, progress: Progress = SILENT) -> Report:
    """Write model.json and pictures of a calibration, and return its report."""
    session, folder = found.session, output_folder(options.out)
    model, notes = save_models(folder, [each.fit for each in found.eyes.values()])
    models = [model]
    for primary, name in MODELS_OF_PRIMARIES.items():
        if fits := [each.primaries[primary] for each in found.eyes.values() if primary in each.primaries]:
            models.append(save_models(folder, fits, name)[0])
    warnings = [
        warning
        for each in found.eyes.values()
        for warning in fit_warnings(each.fit, set_names(found, each), sigma_is_given=False)
    ]
    validations = {eye: validated(each.kinds, options, folder, progress) for eye, each in found.eyes.items()}
    report = Report(
        f"Calibration of {session.device}, {' and '.join(session.eyes)} eye{'s' * (len(session.eyes) > 1)}",
        verdict=headline(found),
        advice=advice(found),
        warnings=[*warnings, *found.reading.notes, *notes],
        blocks=session_blocks(found, folder),
        inputs=[Path(options.path), *options.fit.inputs],
        files=[*models, *(folder / f"{kind}-{eye}{suffix}" for eye in session.eyes for kind, suffix in RESULTS)],
        faults=found.faults,
        record={"device": session.device, **_record(found)},
    )
    return with_validations(report, validations)
