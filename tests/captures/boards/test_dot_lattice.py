"""Dots of a bent, slanted, turned lattice get their integers back, among missing and foreign dots."""

import numpy as np
import pytest

from wlr_render.captures.boards.dot_lattice import Dots, link_lattices
from wlr_render.geometry.transforms import rotation_about
from wlr_render.numerics.arrays import FloatArray, IntArray

INDEX = np.stack(np.meshgrid(np.arange(16), np.arange(12)), axis=-1).reshape(-1, 2)
TURNS = [np.linalg.matrix_power(np.array([[0, 1], [-1, 0]]), q) for q in range(4)]


def seen(place: IntArray, turn_deg: float, tilt_deg: float) -> FloatArray:
    """Lattice coordinates (..., 2) -> pixels, in perspective and with barrel distortion."""
    flat = np.concatenate([0.05 * (place - [7.5, 5.5]), np.zeros((*place.shape[:-1], 1))], axis=-1)
    turned = flat @ (rotation_about("y", np.deg2rad(tilt_deg)) @ rotation_about("z", np.deg2rad(turn_deg))).T
    tangents = turned[..., :2] / (turned[..., 2:] + 1.6)
    return np.asarray(320 + 600 * tangents * (1 - 0.2 * np.sum(tangents**2, axis=-1, keepdims=True)))


def dots_at(index: IntArray, turn_deg: float = 0.0, tilt_deg: float = 0.0) -> Dots:
    """Ellipses of dots of 0.3 cells' radius, by differences."""
    step = 1e-4 * np.eye(2)
    slope = np.stack(
        [(seen(index + s, turn_deg, tilt_deg) - seen(index - s, turn_deg, tilt_deg)) / 2e-4 for s in step], -1
    )
    return Dots(seen(index, turn_deg, tilt_deg), 0.25 * 0.3**2 * slope @ np.swapaxes(slope, 1, 2))


def with_clutter(dots: Dots, number: int, seed: int) -> Dots:
    rng = np.random.default_rng(seed)
    place = rng.uniform(dots.centre.min(axis=0), dots.centre.max(axis=0), (number, 2))
    spread = np.eye(2) * rng.uniform(5, 40, (number, 1, 1))
    return Dots(np.concatenate([dots.centre, place]), np.concatenate([dots.spread, spread]))


def is_turned_and_shifted(found: IntArray, true: IntArray) -> bool:
    return any(len(np.unique(found @ turn - true, axis=0)) == 1 for turn in TURNS)


@pytest.mark.parametrize("tilt_deg", [0, 30, 50])
@pytest.mark.parametrize("turn_deg", [0, 20, 45, 133, 260])
def test_all_dots_of_a_view_are_linked(turn_deg: int, tilt_deg: int) -> None:
    lattice = link_lattices(dots_at(INDEX, turn_deg, tilt_deg))[0]
    assert len(lattice) == len(INDEX)
    assert is_turned_and_shifted(lattice.index, INDEX[lattice.dot])


@pytest.mark.parametrize("seed", range(6))
def test_missing_and_foreign_dots_do_not_mislead(seed: int) -> None:
    kept = INDEX[np.random.default_rng(seed).random(len(INDEX)) < 0.8]
    lattice = link_lattices(with_clutter(dots_at(kept, 31.0 * seed, 40.0), 60, seed))[0]
    own = lattice.dot < len(kept)
    assert own.sum() >= 0.9 * len(kept)
    assert is_turned_and_shifted(lattice.index[own], kept[lattice.dot[own]])


def test_two_pieces_are_two_lattices_and_share_no_dot() -> None:
    apart = INDEX[(INDEX[:, 0] < 6) | (INDEX[:, 0] > 9)]
    first, second = link_lattices(dots_at(apart, 12.0))[:2]
    assert sorted([len(first), len(second)]) == [72, 72]
    assert not set(first.dot) & set(second.dot)


@pytest.mark.parametrize("number", [0, 1, 8])
def test_too_few_dots_are_no_lattice(number: int) -> None:
    assert link_lattices(dots_at(INDEX[:number])) == []
