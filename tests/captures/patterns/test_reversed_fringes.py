"""Blur wider than a period shows fringes reversed: nothing is read from them, and no order is called wrong."""

import cv2
import numpy as np

from wlr_render.captures.decoded import DecodeOptions, Rejection
from wlr_render.captures.patterns.catalogue import GrayFringes
from wlr_render.mappings import Panel


def test_reversed_fringes_are_too_weak_to_be_read() -> None:
    code = GrayFringes(Panel(192, 128))
    width = 23  # panel pixels: 1.44 periods, of which a box leaves sin(1.44 pi) / (1.44 pi) = -0.22 of the contrast
    photographs = [cv2.blur(code.image(index), (width, 1)) for index in range(len(code.names()))]
    decoded = code.decode(photographs, DecodeOptions(end_of_scale=np.inf))
    inner = (slice(None), slice(width, -width))
    weak = np.isin(decoded.rejection[inner], [Rejection.WEAK_FRINGE, Rejection.UNSURE_BIT])
    assert weak.mean() > 0.9
