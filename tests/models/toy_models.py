"""One model of each kind with smooth maps of a plausible size, fitted to closed forms on a dense random sample."""

from collections.abc import Callable
from dataclasses import replace
from typing import Any, TypeVar

import numpy as np

from wlr_render.geometry.planes import BasePlane
from wlr_render.mappings import EyeBox, Panel
from wlr_render.models.display_model import DisplayModel
from wlr_render.models.fitted_model import FittedModel
from wlr_render.models.model_place import NOWHERE, VIEWPOINT
from wlr_render.models.point_per_pixel import PointPerPixelDisplay
from wlr_render.models.see_through_model import SeeThroughModel
from wlr_render.numerics.arrays import FloatArray
from wlr_render.numerics.polynomial import Box, Polynomial, basis, total_degree

EYE_BOX = EyeBox(np.array([0.03, 0.0, 0.02]), np.array([0.010, 0.008, 0.006]))
PLANE = BasePlane(0.02)
PANEL = Panel(1000, 800)

PIXELS = ([0.0, 0.0], [1000.0, 800.0])
IN_PLANE = ([0.02, -0.01], [0.04, 0.01])
IN_BOX = ([0.024, -0.005, 0.016], [0.036, 0.005, 0.024])
TANGENTS = ([-0.5, -0.5], [0.5, 0.5])


def box(*parts: tuple[list[float], list[float]]) -> Box:
    return Box(np.concatenate([p[0] for p in parts]), np.concatenate([p[1] for p in parts]))


def polynomial(function: Callable[..., Any], domain: Box, degree: int) -> Polynomial:
    """Least-squares polynomial of a function (n, variables) -> (n, outputs); exact where it is one of that degree."""
    orders = total_degree(len(domain.low), degree)
    sample = np.random.default_rng(0).uniform(domain.low, domain.high, (6 * len(orders), len(domain.low)))
    coefficients, *_ = np.linalg.lstsq(basis(sample, orders, domain), function(sample))
    return Polynomial(orders, domain, coefficients)


def swim(x: FloatArray, y: FloatArray) -> FloatArray:
    x, y = (x - 0.03) / 0.005, y / 0.005
    return np.stack([0.03 * x - 0.004 * x * y, 0.02 * y + 0.005 * x**2], axis=-1)


def seen(inputs: FloatArray) -> FloatArray:
    """Tangents of pixels (u, v, x, y): linear in the pixel, quadratic in the position."""
    u, v, x, y = inputs[:, :4].T
    return np.stack([(u - 500) * 6e-4, (400 - v) * 7e-4], axis=-1) + swim(x, y)


def shown(inputs: FloatArray) -> FloatArray:
    """The pixel (x, y, tx, ty) -> (u, v) that `seen` sends there."""
    x, y = inputs[:, :2].T
    return (inputs[:, -2:] - swim(x, y)) / [6e-4, -7e-4] + [500, 400]


def bend(inputs: FloatArray) -> FloatArray:
    """(x, y, tx, ty) -> A, B."""
    x, y, tx, ty = inputs.T
    x, y = (x - 0.03) / 0.005, y / 0.005
    a = [2e-3 * tx + 1e-3 * x * ty, 3e-3 - 1e-3 * ty**2 + 5e-4 * y]
    return np.stack([*a, 1e-3 * tx + 1e-4 * x**2, 5e-4 * ty + 2e-4], axis=-1)


Fitted = TypeVar("Fitted", bound=FittedModel)


def changed(model: Fitted, **changes: object) -> Fitted:
    """The model with other values of some attributes."""
    record: Any = model  # a dataclass, as every model is
    found: Fitted = replace(record, **changes)
    return found


def bundle_display() -> DisplayModel:
    forward, backward = box(PIXELS, IN_PLANE), box(IN_PLANE, TANGENTS)
    return DisplayModel(PANEL, EYE_BOX, PLANE, polynomial(seen, forward, 2), polynomial(shown, backward, 2))


def bundle_see_through() -> SeeThroughModel:
    return SeeThroughModel(EYE_BOX, PLANE, polynomial(bend, box(IN_PLANE, TANGENTS), 2))


def volumetric_display() -> DisplayModel:
    def forward(inputs: FloatArray) -> FloatArray:
        return seen(inputs) + 8.0 * (inputs[:, 4:] - 0.02) * (inputs[:, 2:4] - 0.03)

    def backward(inputs: FloatArray) -> FloatArray:
        moved = inputs[:, 3:] - 8.0 * (inputs[:, 2:3] - 0.02) * (inputs[:, :2] - 0.03)
        return shown(np.hstack([inputs[:, :2], moved]))

    return DisplayModel(
        PANEL,
        EYE_BOX,
        VIEWPOINT,
        polynomial(forward, box(PIXELS, IN_BOX), 2),
        polynomial(backward, box(IN_BOX, TANGENTS), 2),
    )


def volumetric_see_through() -> SeeThroughModel:
    def forward(inputs: FloatArray) -> FloatArray:
        return bend(np.delete(inputs, 2, axis=1))

    return SeeThroughModel(EYE_BOX, VIEWPOINT, polynomial(forward, box(IN_BOX, TANGENTS), 2))


def at_centre(function: Callable[..., Any], first: bool) -> Callable[[FloatArray], FloatArray]:
    """A function of (x, y, tx, ty) or (u, v, x, y) at the nominal viewpoint."""

    def at(inputs: FloatArray) -> FloatArray:
        centre = np.broadcast_to(EYE_BOX.centre[:2], (len(inputs), 2))
        return np.asarray(function(np.hstack([inputs, centre] if first else [centre, inputs])))

    return at


def static_display() -> DisplayModel:
    forward, backward = at_centre(seen, True), at_centre(shown, False)
    return DisplayModel(
        PANEL, EYE_BOX, NOWHERE, polynomial(forward, box(PIXELS), 1), polynomial(backward, box(TANGENTS), 1)
    )


def static_see_through() -> SeeThroughModel:
    return SeeThroughModel(EYE_BOX, NOWHERE, polynomial(at_centre(bend, False), box(TANGENTS), 2))


def point_per_pixel_display() -> PointPerPixelDisplay:
    def point(pixel: FloatArray) -> FloatArray:
        inverse_depth = 1.5 + 1e-3 * (pixel[:, 0] - 700.0)
        return np.column_stack([at_centre(seen, True)(pixel), inverse_depth])

    return PointPerPixelDisplay(PANEL, EYE_BOX, polynomial(point, box(PIXELS), 1))


DISPLAYS = {
    "planar": bundle_display,
    "volumetric": volumetric_display,
    "static": static_display,
    "point-per-pixel": point_per_pixel_display,
}
SEE_THROUGHS = {
    "planar": bundle_see_through,
    "volumetric": volumetric_see_through,
    "static": static_see_through,
}
