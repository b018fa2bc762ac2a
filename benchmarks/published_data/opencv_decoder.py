"""OpenCV's Gray-code decoder (`cv2.structured_light`, in its contrib build only), for comparison with ours."""

from collections.abc import Iterable
from dataclasses import dataclass
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from benchmarks.published_data.flat_surfaces import Lenses, PlaneSurvey, distance_to_planes
from wlr_render.captures.decoded import Decoded
from wlr_render.captures.photographs import Photograph
from wlr_render.mappings import Panel
from wlr_render.numerics.arrays import IntArray
from wlr_render.report.blocks import Cell, ReportTable

_COMPARED = 100_000  # number of camera pixels for OpenCV's decoder, which decodes them one by one
_ON_SURFACE_PX = 1.5  # largest distance from a plane, wide enough for whole panel pixels
_BLACK_THRESHOLD = 40  # OpenCV's default contrast of white over black, in grey values of 255
_WHITE_THRESHOLD = 5  # OpenCV's default contrast of a bit over its inverse


@dataclass(frozen=True, eq=False)
class OpencvCodes:
    """Codes decoded by OpenCV.

    Attributes:
        code: (n, 2) whole panel pixel (column, row).
        accepted: (n,) whether OpenCV accepts the camera pixel.
    """

    code: IntArray
    accepted: NDArray[np.bool_]


def has_opencv_decoder() -> bool:
    """Return whether this OpenCV was built with the module."""
    return hasattr(cv2, "structured_light")


def opencv_codes(photographs: Iterable[Photograph], panel: Panel, camera_pixel: IntArray) -> OpencvCodes:
    """Decode 8-bit photographs, white and black first, at camera pixels (n, 2) given as (column, row).

    Only the values at these pixels are kept, as strips one pixel high, because the decoder holds all pictures at once.
    """
    column, row = np.asarray(camera_pixel).T
    strips = [np.ascontiguousarray(photograph[row, column][None]) for photograph in photographs]
    white, black, bits = strips[0].astype(np.int64), strips[1].astype(np.int64), strips[2:]
    module: Any = cv2.structured_light  # type: ignore[attr-defined]  # absent from the stubs
    decoder = module.GrayCodePattern.create(panel.width_px, panel.height_px)
    decoder.setWhiteThreshold(_WHITE_THRESHOLD)
    answers = [decoder.getProjPixel(bits, place, 0) for place in range(len(column))]
    clear = np.array([not unclear for unclear, _ in answers], dtype=bool)
    code = np.array([place for _, place in answers], dtype=np.int64).reshape(-1, 2)
    return OpencvCodes(code, clear & ((white - black)[0] > _BLACK_THRESHOLD))


def compared_with_opencv(
    decoded: Decoded, photographs: Iterable[Photograph], panel: Panel, survey: PlaneSurvey, lenses: Lenses
) -> ReportTable:
    """Decode a random sample of the camera's pixels with OpenCV, and compare with our positions."""
    height, width = decoded.rejection.shape
    place = np.random.default_rng(0).choice(height * width, min(_COMPARED, height * width), replace=False)
    pixel = np.stack([place % width, place // width], axis=-1)
    return comparison_table(decoded, opencv_codes(photographs, panel, pixel), place, survey, lenses)


def comparison_table(
    decoded: Decoded, theirs: OpencvCodes, place: NDArray[np.int64], survey: PlaneSurvey, lenses: Lenses
) -> ReportTable:
    """Compare our decoder and OpenCV's at the same camera pixels, with flat indices `place` (n,), by flat surfaces."""
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
