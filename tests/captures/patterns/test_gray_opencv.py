"""OpenCV's structured-light module against ours; it is only in the contrib build of OpenCV.

What differs: OpenCV keeps white and black apart from the pictures of the bits, and its `getProjPixel` returns the
number of the panel pixel, where ours is a position with the pixel's centre at +0.5. Order and polarity are the same.
"""

from collections.abc import Callable
from typing import Any

import cv2
import numpy as np
import pytest

from wlr_render.captures.patterns.catalogue import GrayCode
from wlr_render.mappings import Panel

pytestmark = [
    pytest.mark.oracle,
    pytest.mark.skipif(
        not hasattr(cv2, "structured_light"), reason="cv2.structured_light comes with opencv-contrib-python only"
    ),
]


def opencv_decoder(panel: Panel) -> Any:
    return vars(cv2)["structured_light"].GrayCodePattern.create(panel.width_px, panel.height_px)


@pytest.mark.parametrize("size", [(64, 32), (100, 75), (1920, 1080)])
def test_pictures_are_the_same(size: tuple[int, int]) -> None:
    pattern = GrayCode(Panel(*size))
    decoder = opencv_decoder(pattern.panel)
    done, pictures = decoder.generate()
    black, white = decoder.getImagesForShadowMasks(np.zeros(size[::-1], np.uint8), np.zeros(size[::-1], np.uint8))
    assert done
    assert len(pictures) + 2 == len(pattern.names())
    for index, picture in enumerate([white, black, *pictures]):
        assert np.array_equal(pattern.image(index), picture)


def test_decoded_numbers_agree(toy_camera: Callable[..., Any]) -> None:
    camera = toy_camera(Panel(221, 175), scale=1.3, black=20.0, white=180.0, noise=2.0)
    pattern = GrayCode(camera.panel)
    shown = list(camera.photographs(pattern))
    ours = pattern.decode(shown)
    decoder = opencv_decoder(camera.panel)
    decoder.setWhiteThreshold(0)
    decoder.setBlackThreshold(20)
    places = np.argwhere(ours.accepted)[::23]
    answers = [decoder.getProjPixel(shown[2:], int(x), int(y)) for y, x in places]
    theirs = np.array([pixel for failed, pixel in answers if not failed])
    mine = ours.pixel[tuple(places[[not failed for failed, _ in answers]].T)]
    assert len(theirs) > 0.95 * len(places) > 300
    # A number is the position rounded down, but for pixels that see two panel pixels equally.
    off = np.abs(mine - (theirs + 0.5))
    assert off.max() < 1.2
    assert np.mean(off < 0.6) > 0.97
    assert np.abs(np.mean(mine - (theirs + 0.5))) < 0.03
