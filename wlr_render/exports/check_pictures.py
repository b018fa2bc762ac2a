"""A source picture and the expected panel picture, to check another program against this one."""

from pathlib import Path

import cv2
import numpy as np
from numpy.typing import NDArray

from wlr_render.draw.sampling import remap
from wlr_render.exports.export_view import ALL_COLOURS, ExportedView
from wlr_render.exports.format import Capabilities
from wlr_render.numerics.srgb import decode_srgb, encode_srgb
from wlr_render.scene.image_files import write_png

CHECK_SOURCE, CHECK_PANEL = "check-source.png", "check-panel.png"
_CELLS = 16
_WORDS = (("TOP LEFT", 0.06, 0.1), ("BOTTOM RIGHT", 0.62, 0.94))


def write_check(folder: Path, view: ExportedView, holds: Capabilities) -> list[Path]:
    """Write `CHECK_SOURCE`, in the size of a view's source picture, and `CHECK_PANEL`, its warp for the panel.

    The warp is filtered in linear light.
    """
    source = check_picture(view.source.camera.size_px)
    colours = [view.middle_colour] * 3 if view.colours == (ALL_COLOURS,) else view.colours
    positions = {colour: view.source_px(colour) for colour in set(colours)}
    if not holds.between_pixels:
        positions = {colour: np.floor(each) + np.float32(0.5) for colour, each in positions.items()}
    light = decode_srgb(source)
    planes = [remap(light, positions[colour])[0][..., k] for k, colour in enumerate(colours)]
    panel = encode_srgb(np.stack(planes, axis=-1))
    return [write_png(folder / CHECK_SOURCE, source), write_png(folder / CHECK_PANEL, panel)]


def check_picture(size_px: tuple[int, int]) -> NDArray[np.uint8]:
    """Return a picture (height, width, 3): red grows to the right, green downwards, with a grid and lettering."""
    width, height = size_px
    u, v = (np.arange(size) / size for size in size_px)
    picture = np.zeros((height, width, 3), np.float32)
    picture[..., 0], picture[..., 1] = 40 + 180 * u, (40 + 180 * v)[:, None]
    picture[..., 2] = 90 * ((np.floor(_CELLS * u) + np.floor(_CELLS * v)[:, None]) % 2)
    card = np.ascontiguousarray(picture.round(), np.uint8)
    scale = width / 700
    for words, x, y in _WORDS:
        place = round(x * width), round(y * height)
        cv2.putText(card, words, place, cv2.FONT_HERSHEY_SIMPLEX, scale, (255, 255, 255), max(1, round(3 * scale)))
    return card
