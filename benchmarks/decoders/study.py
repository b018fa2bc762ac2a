"""Our decoder of Gray code beside OpenCV's, at the same camera pixels, assessed by flat surfaces."""

from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

import numpy as np
from numpy.typing import NDArray

from benchmarks.decoders.opencv_decoder import MISSING, OpencvCodes, has_opencv_decoder, opencv_codes
from wlr_render.atomic_files import output_folder
from wlr_render.captures.decoded import Decoded
from wlr_render.captures.patterns.gray_code import GrayCode
from wlr_render.captures.photographs import read_each, read_photograph
from wlr_render.errors import BadInputError
from wlr_render.evaluation.code_quality import Lenses, PlaneSurvey, distance_to_planes, find_planes, fit_planes
from wlr_render.jobs.decode import DecodeVerbOptions, code_photographs
from wlr_render.jobs.options import ProgressArgument, described
from wlr_render.progress import SILENT
from wlr_render.report.blocks import Cell, Report, ReportTable
from wlr_render.report.save import save_report

_COMPARED = 100_000  # camera pixels that OpenCV's decoder is asked for; it takes them one by one
_ON_SURFACE_PX = 1.5  # wide enough for whole panel pixels


@dataclass(frozen=True)
class DecodersOptions(DecodeVerbOptions):
    """Options of `decoders`: those of `decode`."""

    out: Annotated[Path, described("Output folder.")] = Path("out/benchmarks/decoders")


def run(options: DecodersOptions, *, progress: ProgressArgument = SILENT) -> Report:
    """Decode with both; writes decoders.html, .md and .json.

    Raises:
        BadInputError: the photographs cannot be read, or OpenCV cannot decode them.
    """
    codes = code_photographs(options)
    if not isinstance(codes.pattern, GrayCode) or read_photograph(codes.files.paths[0]).dtype != np.uint8:
        raise BadInputError(f"{options.folder}: OpenCV decodes plain Gray code in photographs of 8 bits only.")
    if not has_opencv_decoder():
        raise BadInputError(MISSING)
    folder = output_folder(options.out)
    progress.say("decoding")
    decoded, lenses = codes.decoded(), Lenses(codes.lenses.camera)
    survey = fit_planes(decoded, find_planes(decoded, lenses), lenses)
    height, width = decoded.rejection.shape
    place = np.random.default_rng(0).choice(height * width, min(_COMPARED, height * width), replace=False)
    pixel = np.stack([place % width, place // width], axis=-1)
    progress.say("decoding with OpenCV")
    theirs = opencv_codes(read_each(codes.files.paths), codes.pattern.panel, pixel)
    table = comparison_table(decoded, theirs, place, survey, lenses)
    report = Report(f"Decoders: {codes.name}", blocks=[table], inputs=[options.folder], record=options)
    return save_report(report, folder, "decoders")


def comparison_table(
    decoded: Decoded, theirs: OpencvCodes, place: NDArray[np.int64], survey: PlaneSurvey, lenses: Lenses
) -> ReportTable:
    """Our decoder and OpenCV's at the same camera pixels, of flat index `place` (n,), judged by flat surfaces."""
    width = decoded.rejection.shape[1]
    seen = np.stack([place % width, place // width], axis=-1) + 0.5
    ours, accepted = decoded.pixel.reshape(-1, 2)[place], decoded.accepted.ravel()[place]
    distance = [distance_to_planes(survey.planes, seen, shown, lenses) for shown in (ours, theirs.code + 0.5)]
    equal = np.all(np.floor(ours) == theirs.code, axis=1)
    groups = {
        "accepted by both, same code": accepted & theirs.accepted & equal,
        "accepted by both, another code": accepted & theirs.accepted & ~equal,
        "accepted by us only": accepted & ~theirs.accepted,
        "accepted by OpenCV only": ~accepted & theirs.accepted,
        "accepted by neither": ~accepted & ~theirs.accepted,
    }
    rows: list[list[Cell]] = []
    for name, group in groups.items():
        of_each = [off[group & own] for off, own in zip(distance, (accepted, theirs.accepted), strict=True)]
        within = [int(np.sum(off < _ON_SURFACE_PX)) if off.size else None for off in of_each]
        median = [float(np.median(off)) if off.size else None for off in of_each]
        rows.append([name, int(group.sum()), *within, *median])
    columns = (
        "camera pixels",
        "count",
        "ours on a surface",
        "OpenCV's on a surface",
        "ours off by, median (px)",
        "OpenCV's off by, median (px)",
    )
    note = (
        f"{len(place)} camera pixels by chance; on a surface: within {_ON_SURFACE_PX} px of a homography's prediction. "
        "OpenCV's positions are whole panel pixels."
    )
    return ReportTable("Comparison with OpenCV's decoder", columns, rows, (note,))
