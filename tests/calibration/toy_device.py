"""A device whose maps are polynomials on the plane z = PLANE.z, known in closed form both ways.

Display: t = M (pixel - middle) + g(p~), so the pixel is polynomial in (p~, t) too. See-through: A and B quadratic in
(p~, t).
"""

from collections.abc import Callable, Sequence
from typing import Any

import numpy as np

from wlr_render.captures.correspondences import DisplayCaptures, SeeThroughCaptures
from wlr_render.geometry.directions import ARCMIN, arcmin_between, dir_of_tangents
from wlr_render.geometry.planes import BasePlane
from wlr_render.mappings import EyeBox, Panel
from wlr_render.models.fitted_model import FittedDisplay
from wlr_render.numerics.arrays import FloatArray

PLANE = BasePlane(0.02)
EYE_BOX = EyeBox(np.array([0.03, 0.0, 0.02]), np.array([0.010, 0.008, 0.006]))
PANEL = Panel(1000, 800)
_M = np.array([[6e-4, 1e-4], [-5e-5, -7e-4]])


def _swim(in_plane: FloatArray) -> FloatArray:
    x, y = ((in_plane - EYE_BOX.centre[:2]) / 0.005).T
    return np.stack([0.03 * x - 0.004 * x * y, 0.02 * y + 0.005 * x**2], axis=-1)


def tangents_of(pixel: FloatArray, in_plane: FloatArray) -> FloatArray:
    return np.asarray((pixel - 0.5 * PANEL.size_px) @ _M.T + _swim(in_plane))


def bend_of(in_plane: FloatArray, tangents: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Deviation of tangents A (n, 2) and lateral offset B (n, 2) metres."""
    x, y = ((in_plane - EYE_BOX.centre[:2]) / 0.005).T
    tx, ty = tangents.T
    a = np.stack([2e-3 * tx + 1e-3 * x * ty, 3e-3 - 1e-3 * ty**2 + 5e-4 * y], axis=-1)
    b = np.stack([1e-3 * tx + 1e-4 * x**2, 5e-4 * ty + 2e-4], axis=-1)
    return a, b


def positions_in_plane(count: int, seed: int = 1) -> FloatArray:
    """Scattered over twice the eye box, so that no small count lies on a curve: (count, 2)."""
    unit = np.random.default_rng(seed).uniform(-1.0, 1.0, (count, 2))
    return EYE_BOX.centre[:2] + unit * EYE_BOX.size[:2]


def places_among(positions: FloatArray, count: int, seed: int) -> FloatArray:
    """Scattered over the box of `positions` (n, 2), where a fit to them holds: (count, 2)."""
    return np.random.default_rng(seed).uniform(positions.min(axis=0), positions.max(axis=0), (count, 2))


def grid_in_plane(columns: int, rows: int) -> FloatArray:
    x, y = np.meshgrid(np.linspace(-1, 1, columns), np.linspace(-1, 1, rows))
    return EYE_BOX.centre[:2] + np.stack([x.ravel(), y.ravel()], axis=-1) * EYE_BOX.size[:2]


def scattered(tangents: FloatArray, sigma_arcmin: float, seed: int) -> FloatArray:
    """Unit directions whose two transverse angles carry noise of sigma (a number or (n,))."""
    direction = dir_of_tangents(tangents)
    noise = np.random.default_rng(seed).normal(size=direction.shape) * np.multiply.outer(
        np.broadcast_to(sigma_arcmin, len(direction)) * ARCMIN, np.ones(3)
    )
    noise -= np.sum(noise * direction, axis=1, keepdims=True) * direction
    moved = direction + noise
    return np.asarray(moved / np.linalg.norm(moved, axis=1, keepdims=True))


def display_captures(
    in_plane: FloatArray,
    pixels: FloatArray | None = None,
    height: float = 0.0,
    sigma_arcmin: float = 0.0,
    seed: int = 0,
) -> DisplayCaptures:
    """Each pixel seen from `height` metres off the plane, where its ray through each base-plane point comes by."""
    pixels = PANEL.grid(9, 7).reshape(-1, 2) if pixels is None else pixels
    capture = np.repeat(np.arange(len(in_plane)), len(pixels))
    pixel, base = np.tile(pixels, (len(in_plane), 1)), in_plane[capture]
    tangents = tangents_of(pixel, base)
    viewpoint = np.column_stack([base - height * tangents, np.full(len(base), PLANE.z + height)])
    view_dir = scattered(tangents, sigma_arcmin, seed)
    return DisplayCaptures(
        device="toy",
        eye="right",
        eye_box=EYE_BOX,
        panel=PANEL,
        viewpoint=viewpoint,
        view_dir=view_dir,
        pixel=pixel,
        capture=capture,
        sigma_arcmin=np.full(len(pixel), sigma_arcmin),
    )


def errors_arcmin(mapping: FittedDisplay, rng: np.random.Generator) -> tuple[FloatArray, FloatArray]:
    """True and predicted error (200,) at random pixels and viewpoints of the eye box."""
    low, high = EYE_BOX.at(np.array([[-1.0, -1, 0], [1, 1, 0]]))[:, :2]
    place = rng.uniform(low, high, (200, 2))
    pixel = rng.uniform([100, 80], [900, 720], (200, 2))
    viewpoint = np.column_stack([place, np.full(200, PLANE.z)])
    seen = mapping.view_dir_of_pixel(pixel, viewpoint).value
    return arcmin_between(seen, dir_of_tangents(tangents_of(pixel, place))), mapping.sigma(pixel, viewpoint)


def see_through_captures(
    in_plane: FloatArray,
    depths: Sequence[float] = (0.4, 3.0),
    tilt: float = 0.0,
    bend: Callable[..., Any] = bend_of,
    sigma_arcmin: float = 0.0,
    seed: int = 0,
) -> SeeThroughCaptures:
    """Directions on a 9 x 7 grid at each base-plane point, for target depths that grow by `tilt` along tx."""
    grid = np.stack(np.meshgrid(np.linspace(-0.4, 0.4, 9), np.linspace(-0.3, 0.3, 7)), axis=-1).reshape(-1, 2)
    capture = np.repeat(np.arange(len(in_plane)), len(grid))
    base, tangents = in_plane[capture], np.tile(grid, (len(in_plane), 1))
    a, b = bend(base, tangents)
    points, poses = [], []
    for pose, depth in enumerate(depths):
        z = depth * (1.0 + tilt * tangents[:, :1])
        points.append(np.hstack([base + b + z * (tangents + a), PLANE.z - z]))
        poses.append(np.full(len(base), pose))
    repeat = len(depths)
    viewpoint = np.tile(PLANE.lift(base), (repeat, 1))
    view_dir = scattered(np.tile(tangents, (repeat, 1)), sigma_arcmin, seed)
    return SeeThroughCaptures(
        device="toy",
        eye="right",
        eye_box=EYE_BOX,
        viewpoint=viewpoint,
        view_dir=view_dir,
        point=np.concatenate(points),
        capture=np.tile(capture, repeat),
        target_pose=np.concatenate(poses),
        sigma_arcmin=np.full(len(viewpoint), sigma_arcmin),
    )
