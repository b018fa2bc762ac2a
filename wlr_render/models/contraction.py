"""Uniqueness of solves: how strongly the fixed-point form of a solve contracts.

A query x = g(x) whose g shrinks every distance by a factor below 1 over a convex domain has at most one solution there
(Banach's fixed-point theorem). At 1 or above it may have two, and Newton's method would return either of them.
"""

import numpy as np

from wlr_render.errors import BadInputError
from wlr_render.mappings import EYE_BOX_MARGIN, EyeBox
from wlr_render.numerics.arrays import FloatArray
from wlr_render.numerics.polynomial import Box

NEAREST_POINT_M = 0.25
"""Nearest real point, in front of the viewpoint, for which a see-through solve must be unique."""


def require_unique(contraction: float, kind: str, side: str) -> float:
    """Refuse a model that may have two solutions; otherwise return its contraction.

    Args:
        contraction: contraction of the model's solve.
        kind: "planar" or another kind.
        side: "display" or "see-through".

    Raises:
        BadInputError: the contraction is 1 or more.
    """
    if contraction < 1.0:
        return contraction
    remedy = "add camera positions, or use a lower degree"
    if kind == "planar":
        remedy = "add camera positions, move the base plane to the middle of the eye box, or make the box shallower"
    raise BadInputError(
        f"the {kind} {side} model may have two solutions at one viewpoint: its contraction over the eye box is "
        f"{contraction:.2g} and must stay below 1; {remedy}."
    )


def viewpoints_of(eye_box: EyeBox) -> Box:
    """Return the box of all viewpoints that count as inside an eye box."""
    half = 0.5 * eye_box.size + EYE_BOX_MARGIN
    return Box(eye_box.centre - half, eye_box.centre + half)


def grid_over(box: Box, levels: list[int]) -> FloatArray:
    """Return the grid over a box from edge to edge: (product of levels, variables)."""
    axes = [np.linspace(low, high, n) for low, high, n in zip(box.low, box.high, levels, strict=True)]
    return np.stack(np.meshgrid(*axes, indexing="ij"), axis=-1).reshape(-1, len(levels))


def largest_norm(matrices: FloatArray) -> float:
    """Return the largest spectral norm of matrices (n, 2, 2); 0 without matrices."""
    return float(np.linalg.norm(matrices, ord=2, axis=(-2, -1)).max(initial=0.0))
