"""Printing errors of a board: found, and part of the predicted error."""

from dataclasses import replace

import numpy as np
import pytest
from toy_device import EYE_BOX, PLANE, bend_of, grid_in_plane, see_through_captures

from wlr_render.calibration.fit_see_through import fit_see_through
from wlr_render.calibration.print_field import print_field
from wlr_render.geometry.directions import arcmin_between, dir_of_tangents

DEPTHS = (0.4, 0.8, 1.5)


def printed(seed, size_m=2e-5):
    """Captures of a board whose dots lie beside their places by random plane waves."""
    rng = np.random.default_rng(seed)
    captures = see_through_captures(grid_in_plane(4, 4), DEPTHS, sigma_arcmin=0.1, seed=seed)
    dot = captures.point[:, :2]
    waves, phase = rng.normal(0.0, 12.0, (2, 30, 2)), rng.uniform(0.0, 2 * np.pi, (2, 30))
    off = np.stack([np.cos(dot @ waves[axis].T + phase[axis]).sum(axis=1) for axis in (0, 1)], axis=-1)
    for pose in range(len(DEPTHS)):  # a pose of the board is fitted to its dots
        rows = captures.target_pose == pose
        affine = np.column_stack([np.ones(rows.sum()), dot[rows]])
        off[rows] -= affine @ np.linalg.lstsq(affine, off[rows], rcond=None)[0]
    stated = captures.point.copy()
    stated[:, :2] -= size_m / np.sqrt(15.0) * off
    target = np.column_stack([dot, np.zeros(len(dot))])
    return replace(captures, point=stated, target_point=target)


def errors_arcmin(mapping, rng):
    """True and predicted error at random real points and viewpoints of the eye box."""
    base = rng.uniform(*EYE_BOX.at(np.array([[-1.0, -1, 0], [1, 1, 0]]))[:, :2], (200, 2))
    tangents, depth = rng.uniform([-0.35, -0.25], [0.35, 0.25], (200, 2)), rng.uniform(*DEPTHS[::2], (200, 1))
    a, b = bend_of(base, tangents)
    point = np.hstack([base + b + depth * (tangents + a), PLANE.z - depth])
    viewpoint = PLANE.lift(base)
    seen = mapping.view_dir_of_real_point(point, viewpoint).value
    return arcmin_between(seen, dir_of_tangents(tangents)), mapping.sigma(point, viewpoint)


def test_the_predicted_error_contains_printing_errors():
    ratios = []
    for has_target in (True, False):
        squares = []
        for seed in range(3):
            captures = printed(seed)
            captures = captures if has_target else replace(captures, target_point=np.full(3, np.nan))
            true, predicted = errors_arcmin(fit_see_through(captures, "planar", 4).mapping, np.random.default_rng(seed))
            squares.append([np.mean(true**2), np.mean(predicted**2)])
        ratios.append(np.sqrt(np.divide(*np.mean(squares, axis=0))))
    print(ratios)
    assert 0.7 < ratios[0] < 1.4
    assert ratios[1] > 1.5 * ratios[0]


def test_a_board_that_fills_no_area_has_no_field():
    dot = np.stack([np.linspace(0.0, 1.0, 20), np.zeros(20)], axis=-1)
    assert print_field(dot, np.ones(20)) is None
    assert print_field(np.full((20, 2), np.nan), np.ones(20)) is None


def test_waves_do_what_no_pose_of_the_board_does():
    dot = np.stack(np.meshgrid(np.linspace(-0.5, 0.5, 12), np.linspace(-0.4, 0.4, 9)), axis=-1).reshape(-1, 2)
    field = print_field(dot, np.full(len(dot), 2.0))
    affine = np.column_stack([np.ones(len(dot)), dot])
    assert np.abs(affine.T @ field.columns).max() == pytest.approx(0.0, abs=1e-9)
