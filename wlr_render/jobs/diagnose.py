"""Explain a measured session: the report of a diagnosis, and the session by the extended bench."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path

from wlr_render.diagnosis.diagnosis import Diagnosis
from wlr_render.diagnosis.gain import Gains, gains
from wlr_render.diagnosis.procedure import diagnose
from wlr_render.diagnosis.report_html import report_html
from wlr_render.diagnosis.report_json import report_json
from wlr_render.diagnosis.report_tables import tables
from wlr_render.diagnosis.report_text import advice, verdict_sentence, warnings
from wlr_render.errors import BadInputError
from wlr_render.files import output_folder, write_text
from wlr_render.report.blocks import ReportTable
from wlr_render.simulation.bench import Bench
from wlr_render.simulation.session_folder import check_enough_captures, load_session, remove_session, save_session

Tell = Callable[[str], None]

EXTENDED = "extended"


@dataclass(frozen=True)
class Options:
    """What to diagnose.

    Attributes:
        session: folder of the session.
        out: folder for the results.
        json, html: where the record and the page go; None for diagnosis.json and diagnosis.html in `out`.
        bench: file of the bench that it is compared with; None for the session's own.
    """

    session: Path
    out: Path = Path("out/diagnose")
    json: Path | None = None
    html: Path | None = None
    bench: Path | None = None


@dataclass(frozen=True, eq=False)
class Result:
    """What to tell.

    Attributes:
        sentence: the verdict.
        warnings, advice, reasons: sentences; the last say why the search for causes ended.
        tables: the evidence.
        files: what was written.
    """

    sentence: str
    warnings: Sequence[str]
    advice: Sequence[str]
    reasons: Sequence[str]
    tables: Sequence[ReportTable]
    files: Sequence[Path]


def run(options: Options, tell: Tell = lambda _: None) -> Result:
    """Diagnose a session and write the record, the page and, where causes were found, the extended bench.

    Raises:
        BadInputError: a faulty session, too few captures, or a place that cannot be written.
    """
    tell("reading the session")
    nominal, session = load_session(options.session, options.bench)
    check_enough_captures(session)
    folder = output_folder(options.out)
    if (folder / EXTENDED).resolve() == options.session.resolve():
        raise BadInputError(f"{options.session}: the results would replace this session; choose another --out.")
    record = _writable(options.json or folder / "diagnosis.json")
    page = _writable(options.html or folder / "diagnosis.html")
    found = diagnose(nominal, session, tell)
    tell("measuring what the extended bench is worth")
    worth = _worth(nominal, found)
    tell("writing the report")
    files = [write_text(record, report_json(found, worth)), write_text(page, report_html(found, worth))]
    files += _extended(folder / EXTENDED, found)
    return Result(verdict_sentence(found), warnings(found), advice(found), found.reasons, tables(found, worth), files)


def _worth(nominal: Bench, found: Diagnosis) -> Gains | None:
    """What causes, if any were found, are worth on the readings that count."""
    if not found.causes:
        return None
    return gains(nominal, found.extended, found.observations.of_rows(found.used).session)


def _extended(folder: Path, found: Diagnosis) -> list[Path]:
    """Write the extended bench with the readings that count, as a session; that of an earlier diagnosis is removed."""
    if folder.is_dir():
        remove_session(folder)
    if not found.causes:
        return []
    return [save_session(folder, found.extended, found.observations.of_rows(found.used).session)]


def _writable(path: Path) -> Path:
    """A file's path, once it is sure that the file can be written."""
    output_folder(path.parent)
    if path.is_dir():
        raise BadInputError(f"{path}: is a folder; name a file.")
    return path
