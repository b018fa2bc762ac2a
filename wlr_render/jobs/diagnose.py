"""Diagnose a measured session; write the report, and the session with the corrected bench."""

from collections.abc import Mapping
from dataclasses import KW_ONLY, dataclass, replace
from pathlib import Path
from typing import Annotated

import numpy as np

from wlr_render.bench.bench import Bench
from wlr_render.bench.measurements import load_measurements
from wlr_render.bench.session_folder import check_enough_captures
from wlr_render.captures.session import SeeThroughPlan, Session
from wlr_render.diagnosis.cause import Cause, unknown_cause
from wlr_render.diagnosis.causes.user_causes import causes_for
from wlr_render.diagnosis.hold_out_report import with_held_out
from wlr_render.diagnosis.procedure import diagnose as diagnose_session
from wlr_render.diagnosis.report import CORRECTED, STEM, diagnosis_report, improvement_found, write_corrected
from wlr_render.diagnosis.settings import DEFAULT
from wlr_render.diagnosis.signature_report import signature_report
from wlr_render.errors import BadInputError
from wlr_render.io.atomic_files import output_folder
from wlr_render.io.input_files import prefix_errors
from wlr_render.jobs.job import job
from wlr_render.jobs.options import Against, Options, ProgressArgument, Range, described, option_group
from wlr_render.report.blocks import Report
from wlr_render.work.progress import SILENT

_BENCH = option_group("Bench to compare with", 1)
_CAUSES = option_group("Causes", 2)


@dataclass(frozen=True)
class DiagnoseOptions(Options):
    """Options of `diagnose`."""

    session: Annotated[Path, described("Bench session, output folder of `calibrate` on photographs, or capture file.")]
    _: KW_ONLY
    bench: Annotated[
        Path | None, described("Bench file to compare with (default: the session's own).", group=_BENCH)
    ] = None
    device: Annotated[
        str | None,
        described(
            "Headset that captures are compared with: name or file (default: the shipped one that they name).",
            group=_BENCH,
        ),
    ] = None
    causes: Annotated[
        tuple[str, ...],
        described("Names of the causes to consider (default: all).", flag=True, many=True, group=_CAUSES),
    ] = ()
    exclude: Annotated[
        tuple[str, ...], described("Names of causes to leave out (default: none).", flag=True, many=True, group=_CAUSES)
    ] = ()
    add_causes: Annotated[
        tuple[str, ...],
        described(
            "Python files or modules that define CAUSES, a list of additional causes.",
            flag=True,
            many=True,
            group=_CAUSES,
        ),
    ] = ()
    max_causes: Annotated[
        int,
        described("Maximum number of causes to report; 0 only measures the noise.", group=_CAUSES),
        Range(at_least=0, at_most=100),
    ] = DEFAULT.max_causes
    show_cause: Annotated[
        str | None,
        described("Only draw what this cause would do to the readings; nothing is fitted.", flag=True, group=_CAUSES),
    ] = None
    hold_out: Annotated[
        bool,
        described(
            "Also cross-validate: predict left-out captures and target distances, and state each value's standard "
            "error by the jackknife over captures.",
            flag=True,
        ),
    ] = False
    out: Annotated[Path, described("Output folder.")] = Path("out/diagnose")
    against: Against = None

    def measurements(self) -> tuple[Bench, Session]:
        """Load the bench to compare with, and the session.

        Raises:
            BadInputError: see `load_measurements`.
        """
        with prefix_errors(self.session):
            return load_measurements(self.session, self.bench, self.device)

    def candidates(self, nominal: Bench) -> Mapping[str, Cause]:
        """Return the causes to consider, by name.

        Raises:
            BadInputError: see `causes_for`.
        """
        return causes_for(nominal, self.add_causes, self.causes, self.exclude)

    def inputs(self) -> tuple[Path, ...]:
        """Return the files and folders that the options name."""
        device = [Path(self.device)] if self.device and Path(self.device).is_file() else []
        return (self.session, *([self.bench] if self.bench else []), *device)


@job
def diagnose(options: DiagnoseOptions, *, progress: ProgressArgument = SILENT) -> Report:
    """Diagnose a session; writes the report and, where causes were found, the corrected session into `options.out`.

    Raises:
        BadInputError: faulty measurements, too few readings, faulty causes, or a file that cannot be written.
    """
    progress.say("reading the session")
    nominal, session = options.measurements()
    _check_enough_readings(session)
    if options.hold_out:
        check_enough_captures(session)
    folder = output_folder(options.out)
    if options.show_cause is not None:
        return replace(_signature(options, options.show_cause, nominal, session), stem=SIGNATURE)
    if (folder / CORRECTED).resolve() == options.session.resolve():
        raise BadInputError(f"{options.session}: the results would replace this session; choose another --out.")
    causes = options.candidates(nominal)
    settings = replace(DEFAULT, max_causes=options.max_causes)
    with prefix_errors(options.session):
        found = diagnose_session(nominal, session, progress.say, causes=causes, settings=settings)
        progress.say("comparing models fitted with both benches")
        in_use = improvement_found(found)
    progress.say("writing the report")
    files = write_corrected(folder / CORRECTED, found)
    report = diagnosis_report(found, in_use, options.inputs(), folder, options.add_causes)
    limits = [*_not_considered(options), *report.warnings, *_not_recorded(session)]
    report = replace(report, warnings=limits, files=files, stem=STEM)
    if options.hold_out:
        progress.say("predicting left-out captures and distances")
        with prefix_errors(options.session):
            report = with_held_out(report, found)
    return report


SIGNATURE = "signature"
"""Name of the page of `--show-cause`, without its extension."""


def _signature(options: DiagnoseOptions, name: str, nominal: Bench, session: Session) -> Report:
    """Return the report of one cause's effect on the readings."""
    causes = causes_for(nominal, options.add_causes)
    if name not in causes:
        raise BadInputError(f"--show-cause: {unknown_cause(name, causes)}")
    with prefix_errors(options.session):
        return signature_report(nominal, session, causes[name], options.inputs())


def _check_enough_readings(session: Session) -> None:
    """Reject a session with so few points that a small camera motion could explain every capture.

    Raises:
        BadInputError: the session has no run-time recording, and all captures have fewer than `_FEWEST_READINGS`
            points.
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


_FEWEST_READINGS = 4  # fewest points of a capture, with two values each; a camera pose has six parameters


def _not_considered(options: DiagnoseOptions) -> list[str]:
    """Return a warning if the options restrict the causes to consider."""
    only = [name for name in options.causes if name not in options.exclude]
    if only:
        return [f"Only {', '.join(only)} {'was' if len(only) == 1 else 'were'} considered (--causes)."]
    return [f"Not considered: {', '.join(options.exclude)} (--exclude)."] if options.exclude else []


def _not_recorded(session: Session) -> list[str]:
    """Return a warning if the session states no times."""
    times = [part.time_s for part in session.plan.parts if part is not None]
    if any(np.any(time_s) for time_s in times):
        return []
    return ["No times are recorded: causes that depend on time (slip, warm-up) cannot be found."]
