"""Viewpoint designs in one plane, in the eye box or at its centre, and random test viewpoints.

A total-degree polynomial of degree N is determined only by viewpoints with more than N levels on every axis: a k x k
grid does not determine terms of degree k in one variable, however large k^2 is. These designs therefore give every
viewpoint a separate level, and concentrate levels near the edges like Chebyshev points, because least squares is
weakest there.
"""

import numpy as np
import scipy

from wlr_render.errors import BadInputError
from wlr_render.mappings import EyeBox
from wlr_render.numerics.arrays import FloatArray

_GOLDEN = 0.5 * (np.sqrt(5.0) - 1.0)


def planar(eye_box: EyeBox, reach: FloatArray, count: int) -> FloatArray:
    """Return viewpoints in the plane through the eye box's centre: a rank-1 Chebyshev lattice (Cools & Poppe 2011).

    The lattice has the golden step. It covers the region where the display's rays through any viewpoint of the eye box
    meet the plane; in a smaller region the projected viewpoints would leave the fitted box.

    Args:
        eye_box: the eye box.
        reach: (2,) largest |tx| and |ty| of the rays.
        count: number of viewpoints.

    Returns:
        The viewpoints (count, 3), device frame, metres.
    """
    steps = np.arange(_at_least_one(count))
    unit = np.stack([(steps + 0.5) / count, (steps * _GOLDEN + 0.5) % 1.0], axis=-1)
    half = 0.5 * eye_box.size[:2] + 0.5 * eye_box.size[2] * np.asarray(reach)
    in_plane = _chebyshev_spaced(unit) * half
    return np.asarray(eye_box.centre + np.concatenate([in_plane, np.zeros((count, 1))], axis=-1))


def volumetric(eye_box: EyeBox, count: int) -> FloatArray:
    """Return viewpoints (count, 3) in the whole eye box: the first points of a Sobol sequence, Chebyshev-spaced."""
    power = int(np.ceil(np.log2(_at_least_one(count))))
    unit = scipy.stats.qmc.Sobol(3, scramble=False).random_base2(power)[:count] + 0.5 / 2**power
    return eye_box.at(_chebyshev_spaced(unit))


def nominal(eye_box: EyeBox) -> FloatArray:
    """Return the centre of the eye box, (1, 3), the only viewpoint in the fit of a static map."""
    return np.array(eye_box.centre, dtype=np.float64)[None]


def random_in_eye_box(eye_box: EyeBox, count: int, rng: np.random.Generator) -> FloatArray:
    """Return uniformly random viewpoints (count, 3) in the eye box, mostly off the plane, for tests of models."""
    return eye_box.at(rng.uniform(-1.0, 1.0, (_at_least_one(count), 3)))


def _chebyshev_spaced(unit: FloatArray) -> FloatArray:
    """Map 0..1 to -1..1, denser towards the ends and stretched to the boundary."""
    spaced = -np.cos(np.pi * unit)
    return np.asarray(spaced / np.maximum(np.abs(spaced).max(axis=0), 1e-9))


def _at_least_one(count: int) -> int:
    if count < 1:
        raise BadInputError(f"the number of viewpoints is {count}; give at least 1.")
    return count
