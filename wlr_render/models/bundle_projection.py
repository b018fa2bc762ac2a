"""The projection of the bundle: any viewpoint is carried onto the base plane along its ray.

Where the view direction is given (display backward, see-through forward) this is `BasePlane.carry`, a closed form.
Where it is asked for (display forward, see-through backward) it is a 2 x 2 root-find in tangents, which takes about
four Newton steps from cold and fewer from the last frame's solution (paper: section 3.2).
"""

import numpy as np

from wlr_render.geometry.planes import BasePlane
from wlr_render.numerics.arrays import FloatArray, IntArray
from wlr_render.numerics.newton import Residual, Root, solve_2x2
from wlr_render.numerics.polynomial import Polynomial

TOLERANCE = 1e-12
"""On the residual: metres in the base plane for the display, tangents for see-through."""


def solve_display(
    tangents_of: Polynomial, plane: BasePlane, pixel: FloatArray, viewpoint: FloatArray, start: FloatArray | None
) -> Root:
    """Where the ray by which a pixel reaches a viewpoint meets the base plane.

    Solves p~ = viewpoint_xy + (viewpoint_z - plane_z) t(pixel, p~). Cold start: the viewpoint's x and y.

    Args:
        tangents_of: (u, v, x, y) -> (tx, ty), fitted on the plane.
        plane: the base plane.
        pixel: (n, 2).
        viewpoint: (n, 3).
        start: (n, 2) earlier solutions, or None.

    Returns:
        Root whose unknown is p~, (n, 2) metres.
    """
    depth = viewpoint[:, 2] - plane.z

    def residual(point: FloatArray, index: IntArray) -> tuple[FloatArray, FloatArray]:
        tangents, jacobian = tangents_of.with_jacobian(np.concatenate([pixel[index], point], axis=1), axes=(2, 3))
        dz = depth[index, None]
        return point - viewpoint[index, :2] - dz * tangents, np.eye(2) - dz[..., None] * jacobian

    return _solve(residual, start, viewpoint[:, :2])


def solve_see_through(
    deviation: Polynomial, plane: BasePlane, point: FloatArray, viewpoint: FloatArray, start: FloatArray | None
) -> Root:
    """In which direction a viewpoint sees a real point.

    Unknown are the view tangents t at the viewpoint, so the solve does not degenerate for a viewpoint in the plane.
    With p~ = carry(viewpoint, t), the real ray leaves p~ + B with tangents t + A and misses the point laterally by
    p~ + B + Z (t + A) - point_xy, where Z is the point's depth in front of the plane. The residual is that miss over
    the point's depth in front of the eye: t - s + (Z A + B) / depth, with s the straight line's tangents, which are
    also the cold start.

    Args:
        deviation: (x, y, tx, ty) -> (A, B), see `models.see_through`.
        plane: the base plane.
        point: (n, 3) in front of the viewpoint.
        viewpoint: (n, 3).
        start: (n, 2) earlier solutions, or None.

    Returns:
        Root whose unknown is t, (n, 2).
    """
    offset = (viewpoint[:, 2] - plane.z)[:, None]
    depth = (viewpoint[:, 2] - point[:, 2])[:, None]
    depth_from_plane = plane.depth_of(point)[:, None]
    straight = (point[:, :2] - viewpoint[:, :2]) / depth

    def residual(tangents: FloatArray, index: IntArray) -> tuple[FloatArray, FloatArray]:
        in_plane = viewpoint[index, :2] + offset[index] * tangents
        value, jacobian = deviation.with_jacobian(np.concatenate([in_plane, tangents], axis=1))
        # p~ moves with t as well.
        by_tangents = jacobian[..., 2:] + offset[index, :, None] * jacobian[..., :2]
        far, near = depth_from_plane[index] / depth[index], 1.0 / depth[index]
        bent = far * value[:, :2] + near * value[:, 2:]
        slope = far[..., None] * by_tangents[:, :2] + near[..., None] * by_tangents[:, 2:]
        return tangents - straight[index] + bent, np.eye(2) + slope

    return _solve(residual, start, straight)


def _solve(residual: Residual, start: FloatArray | None, cold: FloatArray) -> Root:
    if start is None:
        return solve_2x2(residual, cold, TOLERANCE)
    warm = solve_2x2(residual, np.where(np.isfinite(start), start, cold), TOLERANCE)
    lost = np.flatnonzero(~warm.converged)
    if lost.size == 0:
        return warm
    # A start from another frame must never cost an answer that the cold start would have found.
    again = solve_2x2(lambda unknown, index: residual(unknown, lost[index]), cold[lost], TOLERANCE)
    unknown, converged = warm.unknown.copy(), warm.converged.copy()
    unknown[lost], converged[lost] = again.unknown, again.converged
    return Root(unknown, converged, warm.iterations + again.iterations)
