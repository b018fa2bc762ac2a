"""Uniqueness of solves: how strongly the fixed-point form of a solve contracts.

A query x = g(x) whose g shrinks every distance by a factor below 1 over a convex domain has at most one solution there
(Banach's fixed-point theorem). At 1 or above it may have two, and Newton's method would return either of them.
"""

from collections.abc import Callable

import numpy as np

from wlr_render.errors import BadInputError
from wlr_render.geometry.planes import BasePlane
from wlr_render.mappings import EYE_BOX_MARGIN, EyeBox
from wlr_render.models.inverse import Deviation
from wlr_render.numerics.arrays import BoolArray, FloatArray
from wlr_render.numerics.polynomial import Box
from wlr_render.numerics.regressor import Regressor

NEAREST_POINT_M = 0.25
"""Nearest real point, in front of the viewpoint, for which a see-through solve must be unique."""

_PIXELS, _PLACES, _DIRECTIONS, _DEPTHS = 13, 9, 13, 5  # grid points per axis, from edge to edge


def display_contraction(forward: Regressor, plane: BasePlane, eye_box: EyeBox) -> float:
    """Return the largest norm of the derivative of p~ -> carry(viewpoint, t(pixel, p~)).

    On an untilted plane the norm is |s| ||dt/dp~||. On a plane of slope m it is h / (1 + m . t) times ||(I - t m^T / (1
    + m . t)) dt/dp~||, with h the height of the viewpoint over the plane along z. h is linear in the viewpoint and the
    rest does not depend on it, so the corners of the eye box suffice; pixels and p~ are taken on a grid over the box of
    `forward`.
    """
    inputs = _grid(forward.box, [_PIXELS] * 2 + [_PLACES] * 2)
    tangents, jacobian = forward.with_jacobian(inputs, axes=(2, 3))
    corners = _grid(_grown(eye_box), [2, 2, 2])
    height = np.abs(plane.depth_of(corners)).max()
    depth = height / (1.0 + tangents @ np.array(plane.slope))
    return _largest_norm(plane.carry_by_tangents(depth, tangents) @ jacobian)


def see_through_contraction(
    deviation_at: Callable[[FloatArray, FloatArray], Deviation],
    contains: Callable[[FloatArray, FloatArray], BoolArray],
    eye_box: EyeBox,
    directions: Box,
) -> float:
    """Return the largest norm of the derivative of t -> straight - (apparent displacement of the point at t).

    Real points are `NEAREST_POINT_M` away or farther. The displacement is linear in the point's inverse depth, so its
    two ends suffice; directions and viewpoints are taken on a grid.

    Args:
        deviation_at: the model at tangents (m, 2) and viewpoints (m, 3).
        contains: mask (m,) of the tangents and viewpoints inside the fit.
        eye_box: box of the viewpoints.
        directions: box of the tangents.
    """
    both = Box(np.append(_grown(eye_box).low, directions.low), np.append(_grown(eye_box).high, directions.high))
    inputs = _grid(both, [3, 3, _DEPTHS, _DIRECTIONS, _DIRECTIONS])
    viewpoint, tangents = inputs[:, :3], inputs[:, 3:]
    inside = contains(tangents, viewpoint)
    deviation = deviation_at(tangents[inside], viewpoint[inside])
    ends = (np.full(len(deviation.depth), inverse) for inverse in (0.0, 1.0 / NEAREST_POINT_M))
    return max(_largest_norm(deviation.seen_at(inverse)[1]) for inverse in ends)


def require_unique(contraction: float, kind: str, side: str) -> float:
    """Refuse a model that may have two solutions; returns the contraction of any other.

    Args:
        contraction: of the model.
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


def _grown(eye_box: EyeBox) -> Box:
    """Return the box of all viewpoints that count as inside."""
    half = 0.5 * eye_box.size + EYE_BOX_MARGIN
    return Box(eye_box.centre - half, eye_box.centre + half)


def _grid(box: Box, levels: list[int]) -> FloatArray:
    """Return the grid over a box from edge to edge: (product of levels, variables)."""
    axes = [np.linspace(low, high, n) for low, high, n in zip(box.low, box.high, levels, strict=True)]
    return np.stack(np.meshgrid(*axes, indexing="ij"), axis=-1).reshape(-1, len(levels))


def _largest_norm(matrices: FloatArray) -> float:
    """Return the largest spectral norm of matrices (n, 2, 2); 0 for none."""
    return float(np.linalg.norm(matrices, ord=2, axis=(-2, -1)).max(initial=0.0))
