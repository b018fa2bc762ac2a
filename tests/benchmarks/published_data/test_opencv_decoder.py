"""OpenCV's decoder on its own terms, where this OpenCV has it: ours must show what it reads."""

from dataclasses import replace

import numpy as np
import pytest
from present import as_number

from benchmarks.published_data.flat_surfaces import Lenses, find_planes, fit_planes
from benchmarks.published_data.opencv_decoder import (
    OpencvCodes,
    comparison_table,
    has_opencv_decoder,
    opencv_codes,
)
from wlr_render.captures.decoded import DecodeOptions
from wlr_render.captures.patterns.catalogue import GrayCode
from wlr_render.mappings import Panel


@pytest.mark.skipif(not has_opencv_decoder(), reason="cv2.structured_light comes with opencv-contrib-python only")
def test_opencv_reads_our_gray_code() -> None:
    panel = Panel(40, 48)  # as many bits on both axes: older OpenCV mixes them up
    pattern = GrayCode(panel)
    photographs = [pattern.image(index) // 2 + 10 for index in range(len(pattern.names()))]
    photographs[0][5, 7] = 20
    pixel = np.array([[0, 0], [39, 47], [12, 31], [7, 5]])
    found = opencv_codes(photographs, panel, pixel)
    np.testing.assert_array_equal(found.code, pixel)
    np.testing.assert_array_equal(found.accepted, [True, True, True, False])


def test_decoders_are_compared_pixel_by_pixel() -> None:
    panel = Panel(96, 64)
    pattern = GrayCode(panel)
    photographs = [pattern.image(index) // 2 + 20 for index in range(len(pattern.names()))]
    decoded = pattern.decode(photographs, DecodeOptions(255))
    survey = fit_planes(decoded, find_planes(decoded))
    place = np.arange(96 * 64)
    code = np.stack([place % 96, place // 96], axis=-1)
    code[:30] += 9
    refused = np.zeros(96 * 64, dtype=bool)
    refused[-40:] = True
    table = comparison_table(decoded, OpencvCodes(code, ~refused), place, survey, Lenses())
    rows = {row[0]: row[1:] for row in table.rows}
    assert rows["accepted by both, another code"][:3] == [30, 30, 0]
    assert rows["accepted by us only"][0] == 40
    assert sum(as_number(row[0]) for row in rows.values()) == 96 * 64
    swapped = replace(decoded, pixel=decoded.pixel + 9.0)
    table = comparison_table(swapped, OpencvCodes(code, ~refused), place, survey, Lenses())
    assert table.rows[0][:3] == ["accepted by both, same code", 30, 0]
