"""Dots of two photographs are matched by what they are, and their distance is an angle at the camera."""

from collections.abc import Sequence
from typing import Any

import numpy as np
import pytest

from wlr_render.captures.boards.board import BoardObservation
from wlr_render.evaluation.photograph_pair import pair_misalignment
from wlr_render.geometry.directions import ARCMIN
from wlr_render.lenses.lens_camera import LensCamera

CAMERA = LensCamera((1000, 800), np.array([1000.0, 1000.0]), np.array([500.0, 400.0]))


def observation(index: Sequence[Any], pixel: Sequence[Any], sigma: float = 0.1) -> BoardObservation:
    return BoardObservation(np.array(index), np.array(pixel, dtype=float), np.full(len(index), sigma))


def test_dots_are_matched_whatever_their_order() -> None:
    off = observation([[0, 0], [1, 0], [2, 0]], [[500, 400], [600, 400], [700, 400]])
    on = observation([[2, 0], [5, 5], [0, 0]], [[700, 402], [1, 1], [501, 400]])
    pair = pair_misalignment(off, on, CAMERA)
    assert pair.index.tolist() == [[0, 0], [2, 0]]
    assert pair.virtual_px.tolist() == [[501, 400], [700, 402]]
    # One pixel on the axis is 1 / 1000 rad; off it, across the direction of the field, cos(angle) less.
    assert pair.arcmin[0] == pytest.approx(1e-3 / ARCMIN, rel=1e-5)
    assert pair.arcmin[1] == pytest.approx(2e-3 * np.cos(np.arctan(0.2)) / ARCMIN, rel=1e-4)
    assert pair.sigma_arcmin[0] == pytest.approx(np.sqrt(2) * 0.1e-3 / ARCMIN, rel=1e-4)


def test_photographs_without_a_common_dot_give_none() -> None:
    pair = pair_misalignment(observation([[0, 0]], [[5, 5]]), observation([[1, 0]], [[5, 5]]), CAMERA)
    assert len(pair) == 0
