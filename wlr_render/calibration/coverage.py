"""Explain in a sentence why samples do not determine a fit, with the number that is missing."""

import numpy as np

from wlr_render.calibration.regression import RANK_TOLERANCE
from wlr_render.numerics.arrays import FloatArray
from wlr_render.numerics.polynomial import Box, basis, term_count, total_degree

_SAME = 1e-5  # of the extent: positions closer than this count as one


def missing_coverage(noun: str, samples: FloatArray, axes: str, degree: int) -> str | None:
    """Return what sample positions lack to determine a polynomial of total degree `degree`.

    Args:
        noun: what the samples are, e.g. "viewpoints".
        samples: (n, variables), repeated positions allowed.
        axes: one letter for each variable.
        degree: total degree N.

    Returns:
        A sentence, or None where they determine it. C(N + variables, variables) positions are necessary; so are N + 1
        levels on each axis; and they must not all lie on one curve or surface of degree N.
    """
    distinct = _distinct(samples)
    needed = term_count(len(axes), degree)
    if len(distinct) < needed:
        missing = needed - len(distinct)
        return (
            f"degree {degree} needs at least {needed} {noun} and there are {len(distinct)}: "
            f"{missing} more, or a lower degree"
        )
    for axis, column in zip(axes, distinct.T, strict=True):
        levels = len(_distinct(column[:, None]))
        if levels <= degree:
            return (
                f"degree {degree} needs at least {degree + 1} levels of {axis} among the {noun} and there are "
                f"{levels}: {degree + 1 - levels} more, or a lower degree"
            )
    design = basis(distinct, total_degree(len(axes), degree), Box.around(distinct))
    singular = np.linalg.svd(design, compute_uv=False)
    if singular[-1] <= RANK_TOLERANCE * singular[0]:
        shape = "curve" if len(axes) == 2 else "surface"
        return f"the {len(distinct)} {noun} lie on one {shape} of degree {degree}: spread them, or use a lower degree"
    return None


def _distinct(samples: FloatArray) -> FloatArray:
    """One of each group of samples that agree to a small part of the extent, (m, variables)."""
    extent = np.ptp(samples, axis=0).max()
    if extent == 0.0:
        return samples[:1]
    _, first = np.unique(np.round(samples / (_SAME * extent)), axis=0, return_index=True)
    return np.asarray(samples[first])
