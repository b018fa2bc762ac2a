"""A source picture for exports, and our own warp of it, which other programs' results are compared with."""

import cv2
import numpy as np

from wlr_render.exports.view import ExportedView
from wlr_render.rendering.sampling import remap


def smooth_picture(size_px, seed=3):
    """(height, width, 3) float32, codes 0 to 255, with detail of some pixels."""
    width, height = size_px
    noise = np.random.default_rng(seed).uniform(size=(height, width, 3)).astype(np.float32)
    blurred = cv2.GaussianBlur(noise, (0, 0), 2.0)
    return np.ascontiguousarray(255 * (blurred - blurred.min()) / np.ptp(blurred), dtype=np.float32)


def our_warp(picture, view: ExportedView, colour="all"):
    """The panel's picture by our own sampling, and where a pixel has a ray into the source picture."""
    return remap(picture, view.source_px(colour))
