"""Calibrate cameras, stage and one eye from the photographs of a session."""

from dataclasses import KW_ONLY, dataclass
from pathlib import Path
from typing import Annotated

from wlr_render.calibration.calibrate_session import SessionCalibration, calibrate_session, tracking_of
from wlr_render.captures.photo_session_file import load_photo_session
from wlr_render.captures.session_reading import read_session
from wlr_render.files import output_folder
from wlr_render.jobs.calibrate.fit import DEFAULT_FIT, FitOptions, OutputFolder, save_models
from wlr_render.jobs.calibrate.fit_findings import fit_warnings
from wlr_render.jobs.calibrate.photo_report import advice, headline, session_blocks, set_names
from wlr_render.jobs.options import Options, ProgressArgument, Workers, described
from wlr_render.progress import SILENT
from wlr_render.report.blocks import Report
from wlr_render.report.save import save_report

READ = "read"
"""Folder, in the output folder, of what was read from photographs, so that a later run reads only what is new."""


@dataclass(frozen=True)
class CalibratePhotosOptions(Options):
    """Options of `calibrate photos`."""

    session: Annotated[Path, described("Folder of photographs with session.toml.")]
    _: KW_ONLY
    workers: Workers = None
    fit: FitOptions = DEFAULT_FIT
    out: OutputFolder = Path("out/calibrate")


def calibrate_photos(options: CalibratePhotosOptions, *, progress: ProgressArgument = SILENT) -> Report:
    """Calibrate; writes model.json, station-EYE.json, captures-EYE.npz and the report into `options.out`.

    Raises:
        BadInputError: session.toml is faulty, too little could be read, or the steps contradict each other; what was
            read is kept.
    """
    return report_of(calibrated(options, progress=progress), options)


def calibrated(options: CalibratePhotosOptions, *, progress: ProgressArgument = SILENT) -> SessionCalibration:
    """Read the photographs and calibrate; writes station-EYE.json and captures-EYE.npz."""
    session = load_photo_session(options.session)
    tracking_of(session)  # what cannot be calibrated is refused before anything is read
    options.fit.prescription_of(session.eye)
    folder = output_folder(options.out)
    reading = read_session(session, folder / READ, options.workers, progress)
    progress.say("calibrating cameras and station, fitting the models")
    return calibrate_session(session, reading, folder, options.fit.fit)


def report_of(found: SessionCalibration, options: CalibratePhotosOptions) -> Report:
    """Write model.json, pictures and the report of a calibration."""
    session, folder = found.session, output_folder(options.out)
    model, notes = save_models(folder, [found.fit])
    blocks = session_blocks(found, folder)
    report = Report(
        f"Calibration of {session.device}, {session.eye} eye",
        verdict=headline(found),
        advice=advice(found),
        warnings=[*fit_warnings(found.fit, set_names(found)), *notes],
        blocks=blocks,
        inputs=[options.session, *options.fit.inputs],
        files=[model, folder / f"captures-{session.eye}.npz", folder / f"station-{session.eye}.json"],
        faults=found.faults,
        record={"options": options, "device": session.device, "eye": session.eye, "fit": found.fit.model().report},
    )
    return save_report(report, folder)
