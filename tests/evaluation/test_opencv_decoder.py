"""OpenCV's decoder on its own terms, where this OpenCV has it: ours must show what it reads."""

import numpy as np
import pytest

from wlr_render.captures.patterns.gray_code import GrayCode
from wlr_render.evaluation.opencv_decoder import has_opencv_decoder, opencv_codes
from wlr_render.mappings import Panel


@pytest.mark.skipif(not has_opencv_decoder(), reason="this OpenCV has no structured_light; docs/measured-data.md")
def test_opencv_reads_our_gray_code():
    panel = Panel(40, 48)  # as many bits on both axes: older OpenCV mixes them up
    pattern = GrayCode(panel)
    photographs = [pattern.image(index) // 2 + 10 for index in range(len(pattern.names()))]
    photographs[0][5, 7] = 20
    pixel = np.array([[0, 0], [39, 47], [12, 31], [7, 5]])
    found = opencv_codes(photographs, panel, pixel)
    np.testing.assert_array_equal(found.code, pixel)
    np.testing.assert_array_equal(found.accepted, [True, True, True, False])
