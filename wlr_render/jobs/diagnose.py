"""Diagnose a measured session; write the report, and the session with the corrected bench."""

from dataclasses import dataclass, replace
from pathlib import Path
from typing import Annotated

import numpy as np

from wlr_render.atomic_files import output_folder, write_text
from wlr_render.bench.bench import Bench
from wlr_render.bench.session_folder import remove_session, save_session
from wlr_render.captures.session import SeeThroughPlan, Session
from wlr_render.diagnosis.diagnosis import Diagnosis
from wlr_render.diagnosis.improvement import ImprovementInUse, improvement_in_use
from wlr_render.diagnosis.procedure import diagnose as diagnose_session
from wlr_render.diagnosis.report import CORRECTED, diagnosis_report
from wlr_render.diagnosis.settings import DEFAULT
from wlr_render.errors import BadInputError
from wlr_render.input_files import naming
from wlr_render.jobs.diagnosis_options import DiagnosisOptions
from wlr_render.jobs.job import job
from wlr_render.jobs.options import ProgressArgument, described
from wlr_render.progress import SILENT
from wlr_render.report.blocks import Report
from wlr_render.report.save import save_report

STEM = "diagnosis"


@dataclass(frozen=True)
class DiagnoseOptions(DiagnosisOptions):
    """Options of `diagnose`."""

    out: Annotated[Path, described("Output folder.")] = Path("out/diagnose")
    json: Annotated[Path | None, described("File for the JSON record (default: diagnosis.json in the folder).")] = None
    html: Annotated[Path | None, described("File for the HTML page (default: diagnosis.html in the folder).")] = None


@job
def diagnose(options: DiagnoseOptions, *, progress: ProgressArgument = SILENT) -> Report:
    """Diagnose a session; writes the report and, where causes were found, the corrected session into `options.out`.

    Raises:
        BadInputError: faulty measurements, too few readings, faulty causes, or a file that cannot be written.
    """
    progress.say("reading the session")
    nominal, session = options.measurements()
    _check_enough_readings(session)
    folder = output_folder(options.out)
    if (folder / CORRECTED).resolve() == options.session.resolve():
        raise BadInputError(f"{options.session}: the results would replace this session; choose another --out.")
    for path in (options.json, options.html):
        if path is not None:
            _check_writable(path)
    causes = options.candidates(nominal)
    settings = replace(DEFAULT, max_causes=options.max_causes)
    with naming(options.session):
        found = diagnose_session(nominal, session, progress.say, causes=causes, settings=settings)
        progress.say("comparing models fitted with both benches")
        in_use = _in_use(nominal, found)
    progress.say("writing the report")
    files = _write_corrected(folder / CORRECTED, found)
    report = diagnosis_report(found, in_use, options.inputs(), folder, options.add_causes)
    limits = [*_not_considered(options), *report.warnings, *_not_recorded(session)]
    report = replace(report, warnings=limits, files=files)
    report = save_report(report, folder, STEM)
    return _moved(_moved(report, folder / f"{STEM}.json", options.json), folder / f"{STEM}.html", options.html)


def _check_enough_readings(session: Session) -> None:
    """Refuse a session of whose readings every one may be due to a small motion of the camera.

    Raises:
        BadInputError: there is no run-time recording, and no capture has `_FEWEST_READINGS` points.
    """
    plan = session.plan
    tables = [
        [part.capture, part.target_pose] if isinstance(part, SeeThroughPlan) else [part.capture]
        for part in (plan.display, plan.see_through)
        if part is not None
    ]
    most = max((int(np.unique(np.stack(each), axis=1, return_counts=True)[1].max()) for each in tables), default=0)
    if plan.run_time is None and most < _FEWEST_READINGS:
        raise BadInputError(
            f"{session.name}: no capture has more than {most} points, and a small motion of the camera explains "
            "them; record 30 or more points over the whole image in each capture."
        )


_FEWEST_READINGS = 4  # of two values each, against the six of a camera pose


def _not_considered(options: DiagnoseOptions) -> list[str]:
    """A warning if the options restrict the causes that are considered."""
    only = [name for name in options.causes if name not in options.exclude]
    if only:
        return [f"Only {', '.join(only)} {'was' if len(only) == 1 else 'were'} considered (--causes)."]
    return [f"Not considered: {', '.join(options.exclude)} (--exclude)."] if options.exclude else []


def _not_recorded(session: Session) -> list[str]:
    """A warning if the session states no times."""
    times = [part.time_s for part in session.plan.parts if part is not None]
    if any(np.any(time_s) for time_s in times):
        return []
    return ["No times are recorded: causes that depend on time (slip, warm-up) cannot be found."]


def _in_use(nominal: Bench, found: Diagnosis) -> ImprovementInUse | None:
    """What the causes, if any were found, improve on the readings that count."""
    if not found.causes:
        return None
    return improvement_in_use(nominal, found.corrected, found.observations.of_rows(found.used).session)


def _write_corrected(folder: Path, found: Diagnosis) -> list[Path]:
    """Write the corrected bench with the readings that count, as a session; an earlier diagnosis's is removed."""
    if folder.is_dir():
        remove_session(folder)
    if not found.causes:
        return []
    # What was expected of the causes found is now in the bench itself.
    names = {cause.name for cause in found.causes}
    priors = {name: stated for name, stated in found.corrected.priors.items() if name not in names}
    corrected = replace(found.corrected, priors=priors)
    return [save_session(folder, corrected, found.observations.of_rows(found.used).session)]


def _check_writable(path: Path) -> None:
    output_folder(path.parent)
    if path.is_dir():
        raise BadInputError(f"{path}: is a folder; name a file.")


def _moved(report: Report, written: Path, wanted: Path | None) -> Report:
    """The report with one of its files moved to where the user wants it."""
    if wanted is None or wanted.resolve() == written.resolve():
        return report
    write_text(wanted, written.read_text(encoding="utf-8"))
    written.unlink()
    return replace(report, files=[wanted if path == written else path for path in report.files])
