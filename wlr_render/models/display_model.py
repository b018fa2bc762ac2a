"""Display model: view tangents as a function of the pixel and of the viewpoint's place.

The place of a planar model is the point p~ of the base plane where the ray through the viewpoint crosses it, so that
viewpoints on the same ray of a pixel see it in the same direction, by construction. Where the view direction is given,
p~ is a closed form. For a pixel it is the root of p~ = carry(viewpoint, t(pixel, p~)), which takes about four Newton
steps from a cold start and fewer from the last frame's solution (paper: section 3.3).

The paper takes the ray, with t >= 0, that passes nearest to the viewpoint (equation 8). Here the plane may lie on
either side of the viewpoint, and where no ray passes through it, the status is NOT_CONVERGED. `contraction.py` refuses
models whose root may not be the only one.
"""

from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from wlr_render.geometry.planes import BasePlane
from wlr_render.mappings import EyeBox, Panel
from wlr_render.models.contraction import grid_over, largest_norm, viewpoints_of
from wlr_render.models.fitted_model import Answer, FittedDisplay, Sensitivity, joined
from wlr_render.models.inverse import solve_warm_then_cold
from wlr_render.models.model_place import ModelPlace
from wlr_render.models.spread import Covariance
from wlr_render.numerics.arrays import FloatArray, IntArray
from wlr_render.numerics.newton import Root
from wlr_render.numerics.polynomial import Polynomial

_LEVELS = [13, 13, 9, 9]  # grid of u, v, x and y over which the contraction is taken, from edge to edge


@dataclass(frozen=True)
class DisplayModel(FittedDisplay):
    """A fitted `DisplayMapping`.

    Warm starts: pixels (..., 2) of the backward query, p~ (..., 2) of the forward query of a planar model.

    Attributes:
        panel: the panel.
        eye_box: box of valid viewpoints.
        place: base plane of the fit, or the coordinates of the viewpoint that the polynomials depend on.
        forward: (u px, v px, place m) -> (tx, ty).
        backward_start: (place m, tx, ty) -> (u px, v px), where backward queries start.
        spread: covariance of `forward`.
    """

    panel: Panel
    eye_box: EyeBox
    place: ModelPlace
    forward: Polynomial
    backward_start: Polynomial
    spread: Covariance | None = None

    MODELLED: ClassVar[str] = "forward"

    def contraction(self) -> float:
        """Return the largest norm of the derivative of p~ -> carry(viewpoint, t(pixel, p~)); 0 for closed forms.

        On an untilted plane the norm is |s| ||dt/dp~||. On a plane of slope m it is h / (1 + m . t) times
        ||(I - t m^T / (1 + m . t)) dt/dp~||, with h the height of the viewpoint over the plane along z. h is linear in
        the viewpoint and the rest does not depend on it, so the corners of the eye box suffice.
        """
        if not isinstance(self.place, BasePlane):
            return 0.0
        tangents, jacobian = self.forward.with_jacobian(grid_over(self.forward.box, _LEVELS), axes=(2, 3))
        height = np.abs(self.place.height_of(grid_over(viewpoints_of(self.eye_box), [2, 2, 2]))).max()
        depth = height / (1.0 + tangents @ np.array(self.place.slope))
        return largest_norm(self.place.carry_by_tangents(depth, tangents) @ jacobian)

    def solve_place(self, plane: BasePlane, pixel: FloatArray, viewpoint: FloatArray, start: FloatArray | None) -> Root:
        """Solve for the point on the base plane of the rays from pixels (n, 2) to viewpoints (n, 3), metres.

        `start` are earlier solutions (n, 2); a cold start is the viewpoint's x and y.
        """
        tangents_at = self.forward.held((0, 1), pixel)

        def residual(point: FloatArray, index: IntArray) -> tuple[FloatArray, FloatArray]:
            tangents, jacobian = tangents_at.with_jacobian(point, index)
            depth = plane.depth_along(viewpoint[index], tangents)
            carried = viewpoint[index, :2] + depth[:, None] * tangents
            return point - carried, np.eye(2) - plane.carry_by_tangents(depth, tangents) @ jacobian

        return solve_warm_then_cold(residual, start, viewpoint[:, :2], self.forward.rounding)

    def _forward(self, pixel: FloatArray, viewpoint: FloatArray, start: FloatArray | None) -> Answer:
        if not isinstance(self.place, BasePlane):
            inputs = joined(pixel, self.place.carry(viewpoint, pixel))
            return Answer(self.forward(inputs), self.forward.box.contains(inputs))
        root = self.solve_place(self.place, pixel, viewpoint, start)
        inputs = joined(pixel, root.unknown)
        return Answer(self.forward(inputs), self.forward.box.contains(inputs), root.converged, root.unknown)

    def _backward(self, tangents: FloatArray, viewpoint: FloatArray, start: FloatArray | None) -> Answer:
        place = self.place.carry(viewpoint, tangents)
        tangents_at = self.forward.held(range(2, 2 + self.place.coordinates), place)

        def residual(pixel: FloatArray, index: IntArray) -> tuple[FloatArray, FloatArray]:
            value, jacobian = tangents_at.with_jacobian(pixel, index)
            return value - tangents[index], jacobian

        cold = self.backward_start(joined(place, tangents))
        root = solve_warm_then_cold(residual, start, cold, self.forward.rounding)
        inside = self.forward.box.contains(joined(root.unknown, place))
        return Answer(root.unknown, inside, root.converged, root.unknown)

    def _sensitivity(self, subject: FloatArray, viewpoint: FloatArray, tangents: FloatArray) -> Sensitivity:
        inputs = joined(subject, self.place.carry(viewpoint, tangents))
        if not isinstance(self.place, BasePlane):
            return Sensitivity(inputs, np.broadcast_to(np.eye(2), (len(tangents), 2, 2)))
        _, jacobian = self.forward.with_jacobian(inputs, axes=(2, 3))
        # p~ moves with the tangents: t = f(pixel, p~(t)).
        depth = self.place.depth_along(viewpoint, tangents)
        along = np.eye(2) - jacobian @ self.place.carry_by_tangents(depth, tangents)
        return Sensitivity(inputs, np.asarray(np.linalg.inv(along)))
