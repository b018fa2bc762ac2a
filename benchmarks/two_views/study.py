"""Display models supported by captures from two viewpoints."""

from dataclasses import KW_ONLY, dataclass
from pathlib import Path
from typing import Annotated

from benchmarks.published_data.northstar_vcam import read_northstar_vcam
from benchmarks.two_views.evidence import viewpoint_evidence
from benchmarks.two_views.tables import tables, verdict
from wlr_render.atomic_files import output_folder
from wlr_render.jobs.options import Options, ProgressArgument, described
from wlr_render.progress import SILENT
from wlr_render.report.blocks import Report
from wlr_render.report.save import save_report


@dataclass(frozen=True)
class TwoViewsOptions(Options):
    """Options of `two-views`."""

    captures: Annotated[Path, described("Folder of North Star captures (docs/measured-data.md).")]
    _: KW_ONLY
    out: Annotated[Path, described("Output folder.")] = Path("out/benchmarks/two-views")


def run(options: TwoViewsOptions, *, progress: ProgressArgument = SILENT) -> Report:
    """Compare display models on the captures of both eyes; writes two-views.html, .md and .json.

    Raises:
        BadInputError: faulty captures, or an output folder that cannot be written.
    """
    progress.say("reading the captures")
    captures = read_northstar_vcam(options.captures)
    folder = output_folder(options.out)
    progress.say("fitting the models")
    evidence = viewpoint_evidence([captures.left, captures.right])
    title = f"Captures from two viewpoints: {options.captures.resolve().name}"
    report = Report(title, verdict(evidence), blocks=tables(evidence), inputs=[options.captures])
    return save_report(report, folder, "two-views")
