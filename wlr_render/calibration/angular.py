"""From tangents to angles, and from measured sigmas to weights."""

import numpy as np

from wlr_render.geometry.directions import ARCMIN
from wlr_render.numerics.arrays import FloatArray


def angular_metric(tangents: FloatArray) -> FloatArray:
    """Arcminutes per unit of tangent at tangents (n, 2): (n,).

    With n^2 = 1 + tx^2 + ty^2 a small step of tangents is an angle of 1 / n^2 of it radially and 1 / n across; camera
    noise is the same in both. Their geometric mean is taken (within 8 % of either at 30 degrees off axis), so that one
    design serves both outputs.
    """
    square = 1.0 + np.sum(tangents**2, axis=-1)
    return np.asarray(square**-0.75 / ARCMIN)


def relative_sigma(sigma: FloatArray) -> FloatArray:
    """Sigmas (n,) to weight by: as they are, or ones where the data are stated to be exact (all zero)."""
    return sigma if np.any(sigma > 0) else np.ones_like(sigma)
