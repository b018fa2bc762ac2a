"""True lenses of a simulated bench: lens models slightly outside the five-term Brown family."""

from dataclasses import replace

import numpy as np

from wlr_render.errors import BadInputError
from wlr_render.lenses.lens_camera import LENS_KINDS, LensCamera
from wlr_render.numerics.arrays import FloatArray
from wlr_render.simulation.photographs.imperfections import BenchImperfections

_DENOMINATOR = np.array([0.3, 0.2, 1.5])  # k4 to k6, times powers 2, 4 and 6 of the corner's tangent
_PRISM = np.array([1.0, -0.6, -0.8, 0.5])  # s1 to s4, times powers 2 and 4 of the tangent and a common factor
_FISHEYE = np.array([-0.02, 0.006, -0.003, 0.0008])  # k1 to k4, a few pixels from an equidistant lens
_GRID = (33, 27)  # columns and rows of points at which the distortion is fitted
_ROUNDS = 4  # rounds until field and distortion converge


def true_lens(brown: LensCamera, sizes: BenchImperfections, rng: np.random.Generator) -> LensCamera:
    """Return the true lens for a Brown lens, of another kind and decentred, with about the same field of view.

    The distortion of "rational" and "thin-prism" lenses is scaled so that a fit of the Brown terms, focal lengths and
    centre, over the whole picture, has the rms residual `sizes.lens_px`.

    Raises:
        BadInputError: an unknown kind of lens.
    """
    if sizes.lens not in LENS_KINDS:
        raise BadInputError(f"Unknown kind of lens '{sizes.lens}'; choose one of {', '.join(LENS_KINDS)}.")
    decentring = sizes.decentring * rng.choice([-1.0, 1.0], 2)
    k1, k2, p1, p2, k3 = brown.distortion
    tangential = np.array([p1, p2]) + decentring
    if sizes.lens == "brown":
        return replace(brown, distortion=np.array([k1, k2, *tangential, k3]))
    half = 0.5 * np.array(brown.size_px) / brown.focal_px
    if sizes.lens == "fisheye":
        # The field of view stays the same: the focal length is in pixels per radian.
        ratio = float(np.max(half / np.arctan(half)))
        return replace(brown, kind="fisheye", focal_px=brown.focal_px * ratio, distortion=_FISHEYE)

    grid = np.stack(
        np.meshgrid(*(np.linspace(0, length, n) for length, n in zip(brown.size_px, _GRID, strict=True))), -1
    )
    lens = brown
    for _ in range(_ROUNDS):  # field and distortion depend on each other
        lens = _rational(brown, tangential, sizes, lens.tangents_of_pixel(grid.reshape(-1, 2)))
    return lens


def _rational(brown: LensCamera, tangential: FloatArray, sizes: BenchImperfections, tangents: FloatArray) -> LensCamera:
    """Return a "rational" or "thin-prism" lens with the residual `sizes.lens_px` at these tangents (n, 2)."""
    square = np.sum(tangents**2, axis=-1)
    powers = float(square.max()) ** np.array([1.0, 2.0, 3.0])
    k1, k2 = brown.distortion[:2]
    denominator = 1.0 + (square[:, None] ** [1, 2, 3] / powers) @ _DENOMINATOR
    radial = tangents * ((k1 * square + k2 * square**2) / denominator)[:, None]
    share = sizes.lens_px if sizes.lens == "rational" else sizes.lens_px / np.sqrt(2.0)
    factor = share / _left_px(radial, tangents, brown.focal_px)
    k4_to_k6 = _DENOMINATOR / powers
    rational = [*(k4_to_k6[:2] + factor * np.array([k1, k2])), *tangential, k4_to_k6[2], *k4_to_k6]
    if sizes.lens == "rational":
        return replace(brown, kind="rational", distortion=np.array(rational))
    prism = _PRISM / np.tile(powers[:2], 2)
    shift = np.stack([prism[:2] @ [square, square**2], prism[2:] @ [square, square**2]], axis=-1)
    prism *= share / _left_px(shift, tangents, brown.focal_px)
    return replace(brown, kind="thin-prism", distortion=np.array([*rational, *prism]))


def _left_px(shift: FloatArray, tangents: FloatArray, focal_px: FloatArray) -> float:
    """Return the rms residual per axis, pixels, of a fit of the Brown terms to a shift (n, 2) of tangents (n, 2)."""
    x, y = tangents.T
    square, none, one = x * x + y * y, np.zeros_like(x), np.ones_like(x)
    columns = [(x, none), (none, y), (one, none), (none, one)]
    columns += [(x * square**n, y * square**n) for n in (1, 2, 3)]
    columns += [(2 * x * y, square + 2 * y * y), (square + 2 * x * x, 2 * x * y)]
    design = np.stack([np.concatenate(column) for column in columns], axis=-1)
    wanted = shift.T.ravel()
    solution = np.linalg.lstsq(design / np.linalg.norm(design, axis=0), wanted, rcond=None)[0]
    left = (wanted - design / np.linalg.norm(design, axis=0) @ solution).reshape(2, -1) * focal_px[:, None]
    return float(np.sqrt(np.mean(left**2)))
