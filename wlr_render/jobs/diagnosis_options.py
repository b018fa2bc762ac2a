"""Options shared by the jobs that diagnose a session: what was measured, the bench, and the causes to consider."""

from collections.abc import Mapping
from dataclasses import KW_ONLY, dataclass
from pathlib import Path
from typing import Annotated

from wlr_render.bench.bench import Bench
from wlr_render.bench.measurements import load_measurements
from wlr_render.captures.session import Session
from wlr_render.diagnosis.cause import Cause
from wlr_render.diagnosis.causes.user_causes import causes_for
from wlr_render.diagnosis.settings import DEFAULT
from wlr_render.input_files import naming
from wlr_render.jobs.options import Options, Range, described


@dataclass(frozen=True)
class DiagnosisOptions(Options):
    """Options of `diagnose` and `hold-out`."""

    session: Annotated[Path, described("Folder of a bench session or of `calibrate photos`, or a capture file.")]
    _: KW_ONLY
    bench: Annotated[Path | None, described("Bench file to compare with (default: the session's own).")] = None
    device: Annotated[
        str | None,
        described("Headset that captures are compared with: name or file (default: the shipped one that they name)."),
    ] = None
    causes: Annotated[
        tuple[str, ...], described("Names of the causes to consider (default: all).", flag=True, many=True)
    ] = ()
    exclude: Annotated[
        tuple[str, ...], described("Names of causes to leave out (default: none).", flag=True, many=True)
    ] = ()
    add_causes: Annotated[
        tuple[str, ...],
        described("Python files or modules that define CAUSES, further causes to consider.", flag=True, many=True),
    ] = ()
    max_causes: Annotated[
        int, described("Most causes that are named; 0 measures the noise only."), Range(at_least=0, at_most=100)
    ] = DEFAULT.max_causes

    def measurements(self) -> tuple[Bench, Session]:
        """The bench to compare with, and the session.

        Raises:
            BadInputError: see `load_measurements`.
        """
        with naming(self.session):
            return load_measurements(self.session, self.bench, self.device)

    def candidates(self, nominal: Bench) -> Mapping[str, Cause]:
        """The causes to consider, by name.

        Raises:
            BadInputError: see `causes_for`.
        """
        return causes_for(nominal, self.add_causes, self.causes, self.exclude)

    def inputs(self) -> tuple[Path, ...]:
        """The files and folders that the options name."""
        device = [Path(self.device)] if self.device and Path(self.device).is_file() else []
        return (self.session, *([self.bench] if self.bench else []), *device)
