"""Published methods and ours on third-party measurements, each judged by data to which it was not fitted."""

from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Literal

from benchmarks.published_data.itoh_alignments import read_itoh_alignments
from benchmarks.published_data.itoh_seethrough import read_itoh_seethrough
from benchmarks.published_data.northstar_vcam import read_northstar_vcam
from benchmarks.published_data.osvr_hdk13 import read_osvr_captures
from benchmarks.rivals.alignments import alignment_tables
from benchmarks.rivals.reliefs import relief_table
from benchmarks.rivals.viewpoints import viewpoint_table
from benchmarks.rivals.views import view_table
from wlr_render.errors import BadInputError
from wlr_render.io.atomic_files import output_folder
from wlr_render.report.blocks import Report, ReportTable, Text
from wlr_render.report.save import save_report
from wlr_render.work.progress import Progress

DataSet = Literal["alignments", "views", "viewpoints", "reliefs"]


def compare_on_measurements(folder: Path, sets: Sequence[DataSet], out: Path, progress: Progress) -> Report:
    """Fit every method to each measured set and judge it by left-out data.

    Args:
        folder: folder of the sets; missing sets are skipped.
        sets: sets to use; all if empty.
        out: output folder of rivals.html, .md and .json.
        progress: display of the set that is being fitted.

    Raises:
        BadInputError: the folder does not exist or has no set, a set is faulty, or the output folder
            cannot be written.
    """
    if not folder.is_dir():
        raise BadInputError(f"{folder}: there is no such folder; name the one that holds the sets.")
    out = output_folder(out)
    wanted = sets or tuple(SETS)
    present = [each for each in wanted if (folder / SETS[each][0]).is_dir()]
    if not present:
        missing = ", ".join(SETS[each][0] for each in wanted)
        raise BadInputError(f"{folder}: holds none of {missing}; docs/measured-data.md says where to get them.")
    blocks: list[Text | ReportTable] = []
    for each in present:
        progress.say(f"fitting all methods to {SETS[each][0]}")
        blocks += SETS[each][1](folder / SETS[each][0])
    left_out = [SETS[each][0] for each in wanted if each not in present]
    if left_out:
        blocks.append(Text(f"Not there, and left out: {', '.join(left_out)}."))
    verdict = (
        f"Every method on {len(present)} measured sets; the tables say what each leaves on data that was not fitted."
    )
    report = Report("Published methods on measured data", verdict, blocks=blocks, inputs=[folder])
    return save_report(report, out, "rivals")


def _alignments(folder: Path) -> list[ReportTable]:
    return alignment_tables(read_itoh_alignments(folder))


def _views(folder: Path) -> list[ReportTable]:
    return [view_table(read_itoh_seethrough(folder))]


def _viewpoints(folder: Path) -> list[ReportTable]:
    captures = read_northstar_vcam(folder)
    return [viewpoint_table([captures.left, captures.right])]


def _reliefs(folder: Path) -> list[ReportTable]:
    return [relief_table(read_osvr_captures(folder))]


SETS: dict[DataSet, tuple[str, Callable[[Path], list[ReportTable]]]] = {
    "alignments": ("itoh_hmd_calibration/dataset", _alignments),
    "views": ("itoh_seethrough/data", _views),
    "viewpoints": ("northstar_vcam_graycode/session2_head", _viewpoints),
    "reliefs": ("osvr_hdk13", _reliefs),
}
"""Subfolder of each set, and its tables."""
