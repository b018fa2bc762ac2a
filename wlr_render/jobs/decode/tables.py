"""Tables about a decoded set of photographs."""

from collections.abc import Mapping, Sequence

import numpy as np
from numpy.typing import NDArray

from wlr_render.captures.decoded import Decoded
from wlr_render.captures.patterns.gray_bits import WEAK, BitStrength
from wlr_render.evaluation.code_quality import TOLERANCE_PX, Lenses, PlaneSurvey, distance_to_planes
from wlr_render.evaluation.opencv_decoder import OpencvCodes
from wlr_render.report.blocks import Cell, ReportTable

_ON_SURFACE_PX = 1.5  # wide enough for whole panel pixels


def fate_table(decoded: Decoded) -> ReportTable:
    """How many camera pixels have which fate."""
    rows: list[list[Cell]] = [
        [reason.sentence, count, 100.0 * count / decoded.rejection.size] for reason, count in decoded.counts().items()
    ]
    return ReportTable("Camera pixels", ("fate", "pixels", "share (%)"), rows)


def strength_table(strengths: Sequence[BitStrength]) -> ReportTable:
    """Strength of each bit over the lit pixels, and which are weak."""
    rows = [
        [bit.name, bit.median, bit.percentile_5, bit.percentile_1, 100.0 * bit.unsure_share, "weak" if bit.weak else ""]
        for bit in strengths
    ]
    columns = ("bit", "median", "5 %", "1 %", "unsure (%)", "verdict")
    notes = (
        "Strength is |picture - inverse| / (white - black) over the well-lit camera pixels; a bit is weak if its "
        f"median is below {WEAK}. Pixels that see a stripe's border are faint in any case.",
    )
    return ReportTable("Strength of the bits", columns, rows, notes)


def flatness_table(surveys: Mapping[str, PlaneSurvey]) -> ReportTable:
    """What homographies of the flat surfaces leave, with the distortions taken away that the keys of `surveys` name."""
    rows: list[list[Cell]] = [
        [
            number + 1,
            100.0 * plane.share,
            distortion,
            plane.rms_per_axis,
            plane.residual.median,
            plane.residual.p95,
            plane.smooth_per_axis,
            plane.scatter_per_axis,
        ]
        for number in range(max(len(survey.planes) for survey in surveys.values()))
        for distortion, survey in surveys.items()
        for plane in survey.planes[number : number + 1]
    ]
    columns = (
        "surface",
        "of accepted (%)",
        "distortion taken away",
        "rms per axis (px)",
        "median (px)",
        "95 % (px)",
        "smooth part (px)",
        "scatter (px)",
    )
    notes = (
        f"Panel pixels between decoded and predicted; members of a surface lie within {TOLERANCE_PX} px of it.",
        "Smooth part: rms per axis of means over 16 x 16 camera pixels, which lenses and bent surfaces leave; scatter: "
        "about these means. Whole panel pixels would scatter by 0.29 px.",
    )
    return ReportTable("Homographies of flat surfaces", columns, rows, notes)


def opencv_table(
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
    return ReportTable("Beside OpenCV's decoder", columns, rows, (note,))


def no_opencv_table(reason: str) -> ReportTable:
    """In place of the comparison, why there is none."""
    return ReportTable("Beside OpenCV's decoder", ("camera pixels",), (), (reason,))
