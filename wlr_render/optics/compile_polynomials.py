"""Polynomials in place of traced optics: a model file that holds them needs no tracer, and a shader can evaluate them.

Rays are traced from a grid of points on a base plane, from each in a grid of directions, and polynomials are fitted to
them by least squares. The orders grow until rays that were not fitted agree within `GOAL_ARCMIN`. Rays that miss the
optics or pass outside a clear aperture are not fitted; where the box has no other rays, a ridge that grows with the
order keeps the terms small, so that the polynomial continues smoothly there.
"""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
import scipy

from wlr_render.errors import BadInputError
from wlr_render.geometry.directions import ARCMIN, dir_of_tangents, tangents_of_dir
from wlr_render.geometry.planes import BasePlane
from wlr_render.mappings import Status
from wlr_render.numerics.arrays import BoolArray, FloatArray, IntArray
from wlr_render.numerics.polynomial import BOX_SLACK, Box, Polynomial, basis, limited_orders
from wlr_render.optics.assembly import ASSEMBLY_NAMES, assembled
from wlr_render.optics.device import EyeOptics
from wlr_render.optics.media import GREEN_UM
from wlr_render.optics.traced_mappings import TracedDisplay
from wlr_render.optics.tracer import trace

GOAL_ARCMIN = 0.003
"""Rms error at which the orders stop growing: a tenth of the error of 25 camera positions with 0.25' of noise."""

Limits = tuple[int, int, int]
"""Limits of the total order of the first two inputs, of the last two, and of all four."""

DISPLAY_LIMITS: tuple[Limits, ...] = ((8, 5, 8), (10, 5, 10), (10, 6, 10), (12, 6, 12))
"""Order limits of (pixel, place), in the sequence in which they are tried."""
SEE_THROUGH_LIMITS: tuple[Limits, ...] = ((4, 6, 7), (4, 8, 8), (6, 8, 10), (6, 10, 12))
"""Order limits of (place, direction)."""

_SEARCH = np.linspace(-2.0, 2.0, 41)  # tangents that are searched for the box of pixels: 63 degrees to each side
_SEARCHED_AGAIN = 25  # directions per axis and place in the second search, within the range that the first found
_BORDER = BOX_SLACK  # share by which samples extend beyond the box; farther out the basis is linear
_RIDGE = 1e-12  # ridge, times (1 + order)^2, relative to the mean square of a term
_CHECKED = 4000  # rays that are traced to measure the error and are not fitted
_TANGENT_STEP = 1e-6
_VALUE_STEP = 1e-4  # step of the assembly errors, degrees or millimetres
_NOT_REACHED = (
    "hardly any ray of the captured box of places and pixels passes the optics of the prescription; check that it is "
    "of this headset and this eye, and in the device frame."
)
_NEAREST_M = 0.3  # errors of see-through rays are stated at points from here to infinity


@dataclass(frozen=True, eq=False)
class CompiledMap:
    """A map of the traced optics as polynomials.

    Attributes:
        polynomial: the map.
        by_assembly_error: (terms, outputs, 12) derivatives of its coefficients by the values of `assembled`.
        rms_arcmin: error at random rays that were not fitted.
        reached: fraction of the rays of the box that pass the optics inside all clear apertures.
    """

    polynomial: Polynomial
    by_assembly_error: FloatArray
    rms_arcmin: float
    reached: float


def compile_display(optics: EyeOptics, values: FloatArray, plane: BasePlane, box: Box) -> CompiledMap:
    """Compile the display with assembly errors `values` (12,): (u px, v px, x m, y m) -> (tx, ty) over `box`.

    Args:
        optics: the prescription.
        values: see `assembled`.
        plane: the base plane; (x, y) is where a ray meets it.
        box: box of the inputs.

    Raises:
        BadInputError: hardly any ray reaches the box.
    """
    return _compiled(_DisplayRays(optics, np.asarray(values), plane, box), DISPLAY_LIMITS)


def compile_see_through(optics: EyeOptics, values: FloatArray, plane: BasePlane, box: Box) -> CompiledMap:
    """Compile the see-through deviation: (x m, y m, tx, ty) -> (Ax, Ay, Bx m, By m) over `box`; see `compile_display`.

    The ray that meets the base plane in p~ with tangents t is, in the world, the ray through p~ + B with tangents
    t + A; B lies in the plane z = constant through p~.
    """
    return _compiled(_SeeThroughRays(optics, np.asarray(values), plane, box), SEE_THROUGH_LIMITS)


@dataclass(frozen=True, eq=False)
class _Samples:
    """Traced rays.

    Attributes:
        place: (n, 2) positions on the base plane.
        tangents: (n, 2) tangents of the view directions.
        inputs, outputs: (n, 4), (n, outputs) inputs and outputs of the polynomial.
        reached: fraction of the rays of the box that passed.
    """

    place: FloatArray
    tangents: FloatArray
    inputs: FloatArray
    outputs: FloatArray
    reached: float


@dataclass(frozen=True, eq=False)
class _Rays:
    """Sampling and tracing of the rays of a map; see `compile_display`."""

    optics: EyeOptics
    values: FloatArray
    plane: BasePlane
    box: Box


def _compiled(rays: "_DisplayRays | _SeeThroughRays", ladder: tuple[Limits, ...]) -> CompiledMap:
    check = rays.samples(*rays.random(np.random.default_rng(0)))
    for limits in ladder:
        orders = limited_orders(2, limits[0], 2, limits[1], limits[2])
        fitted = rays.samples(*rays.lattice(limits), _BORDER)
        if len(fitted.inputs) < len(orders) or len(check.inputs) == 0:
            raise BadInputError(_NOT_REACHED)
        solve = _ridge_regression(fitted.inputs, orders, rays.box)
        polynomial = Polynomial(orders, rays.box, solve(fitted.outputs))
        error = rays.error_arcmin(polynomial(check.inputs) - check.outputs, check)
        rms = float(np.sqrt(np.mean(error**2)))
        if rms <= GOAL_ARCMIN:
            break
    by_values = rays.by_values(fitted)
    change = solve(by_values.reshape(len(by_values), -1)).reshape(len(orders), -1, len(ASSEMBLY_NAMES))
    return CompiledMap(polynomial, change, rms, check.reached)


def _by_stepped_values(rays: "_DisplayRays | _SeeThroughRays", samples: _Samples, outputs: FloatArray) -> FloatArray:
    """Return (n, outputs, 12) derivatives of traced outputs by the assembly errors, along fixed rays."""
    stepped = rays.values + _VALUE_STEP * np.eye(len(rays.values))
    changed = [rays.traced(values, samples.place, samples.tangents)[0] for values in stepped]
    return np.stack([moved - outputs for moved in changed], axis=-1) / _VALUE_STEP


def _ridge_regression(inputs: FloatArray, orders: IntArray, box: Box) -> Callable[[FloatArray], FloatArray]:
    """Return the function from outputs (n, k) to coefficients (terms, k)."""
    design = basis(inputs, orders, box)
    ridge = _RIDGE * len(design) * (1.0 + orders.sum(axis=1)) ** 2
    factor = scipy.linalg.cho_factor(design.T @ design + np.diag(ridge), lower=True, overwrite_a=True)

    def solve(outputs: FloatArray) -> FloatArray:
        first = scipy.linalg.cho_solve(factor, design.T @ outputs)
        # One refinement: the normal equations lose half of the digits.
        rest = design.T @ (outputs - design @ first) - ridge[:, None] * first
        return np.asarray(first + scipy.linalg.cho_solve(factor, rest))

    return solve


class _DisplayRays(_Rays):
    """Rays of the display, traced from the eye; each meets the panel in some pixel."""

    def traced(self, values: FloatArray, place: FloatArray, tangents: FloatArray) -> tuple[FloatArray, BoolArray]:
        """Trace rays with assembly errors: pixels (n, 2), and which rays pass."""
        display = TracedDisplay(assembled(self.optics, values), GREEN_UM)
        pixel, status = display.plane_pixel(dir_of_tangents(tangents), self.plane.lift(place))
        return pixel, np.asarray(status == Status.OK)

    def _in_box(self, pixel: FloatArray, border: float) -> BoolArray:
        return self.box.select((0, 1)).contains(pixel, border)

    def _bounds(self, place: FloatArray, axes: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Return lowest and highest tangents (n, 2) of a grid `axes` (m, 2) that reach the box from places (n, 2)."""
        grid = _grid(axes[:, 0], axes[:, 1])
        pixel, passes = self.traced(self.values, np.repeat(place, len(grid), axis=0), np.tile(grid, (len(place), 1)))
        reaching = (self._in_box(pixel, _BORDER) & passes).reshape(len(place), -1, 1)
        step = axes[1] - axes[0]
        low = np.where(reaching, grid, np.inf).min(axis=1) - step
        return low, np.where(reaching, grid, -np.inf).max(axis=1) + step

    def _reach(self) -> FloatArray:
        """Return m tangents per axis, (m, 2), over the range in which the box of pixels is visible from any place."""
        low, high = self._bounds(_nodes_2d(self.box, (2, 3), 3), np.stack([_SEARCH, _SEARCH], axis=1))
        if not np.isfinite(low).any():
            raise BadInputError(_NOT_REACHED)
        return np.linspace(low.min(axis=0), high.max(axis=0), _SEARCHED_AGAIN)

    def lattice(self, limits: Limits) -> tuple[FloatArray, FloatArray]:
        """Return places, and from each place the directions in which the box of pixels is visible."""
        place = _nodes_2d(self.box, (2, 3), limits[1] + 3)
        low, high = self._bounds(place, self._reach())
        visible = np.isfinite(low).all(axis=1)
        place, low, high = place[visible], low[visible, None], high[visible, None]
        unit = 0.5 * (1.0 + _grid(_nodes(limits[0] + 6), _nodes(limits[0] + 6)))
        return np.repeat(place, len(unit), axis=0), (low + unit * (high - low)).reshape(-1, 2)

    def random(self, rng: np.random.Generator) -> tuple[FloatArray, FloatArray]:
        """Return random places and tangents, (n, 2) each."""
        place = rng.uniform(self.box.low[2:], self.box.high[2:], (_CHECKED, 2))
        reach = self._reach()
        return place, rng.uniform(reach[0], reach[-1], (_CHECKED, 2))

    def samples(self, place: FloatArray, tangents: FloatArray, border: float = 0.0) -> _Samples:
        """Trace rays and keep the rays that pass, in the box grown by `border` of its size."""
        pixel, passes = self.traced(self.values, place, tangents)
        meant = self._in_box(pixel, border)
        kept = meant & passes
        inputs, reached = _joined(pixel, place)[kept], kept.sum() / max(1, meant.sum())
        return _Samples(place[kept], tangents[kept], inputs, tangents[kept], float(reached))

    def by_values(self, samples: _Samples) -> FloatArray:
        """Return the derivatives dt/dvalue = -(dpixel/dt)^-1 dpixel/dvalue, with dpixel/dvalue along a fixed ray."""
        place, tangents = samples.place, samples.tangents
        pixel = samples.inputs[:, :2]
        shifted = [self.traced(self.values, place, tangents + _TANGENT_STEP * axis)[0] for axis in np.eye(2)]
        by_tangents = np.stack([moved - pixel for moved in shifted], axis=-1) / _TANGENT_STEP
        return np.asarray(-np.linalg.solve(by_tangents, _by_stepped_values(self, samples, pixel)))

    def error_arcmin(self, difference: FloatArray, samples: _Samples) -> FloatArray:
        """Return the angles between the view directions."""
        return _angle_arcmin(samples.tangents, difference)


class _SeeThroughRays(_Rays):
    """Rays of the see-through mapping, traced from the eye to the world."""

    def traced(self, values: FloatArray, place: FloatArray, tangents: FloatArray) -> tuple[FloatArray, BoolArray]:
        """Return the deviations (n, 4), and which rays pass."""
        start, path = self.plane.lift(place), assembled(self.optics, values).see_through
        traced = trace(path, start, dir_of_tangents(tangents), GREEN_UM)
        beyond = tangents_of_dir(traced.direction)
        back = (traced.origin[:, 2] - start[:, 2])[:, None] * beyond
        return _joined(beyond - tangents, traced.origin[:, :2] + back - place), np.asarray(traced.status == Status.OK)

    def lattice(self, limits: Limits) -> tuple[FloatArray, FloatArray]:
        place, tangents = _nodes_2d(self.box, (0, 1), limits[0] + 3), _nodes_2d(self.box, (2, 3), limits[1] + 4)
        return np.repeat(place, len(tangents), axis=0), np.tile(tangents, (len(place), 1))

    def random(self, rng: np.random.Generator) -> tuple[FloatArray, FloatArray]:
        inputs = rng.uniform(self.box.low, self.box.high, (_CHECKED, 4))
        return inputs[:, :2], inputs[:, 2:]

    def samples(self, place: FloatArray, tangents: FloatArray, border: float = 0.0) -> _Samples:
        """Trace rays, which all lie in the box, and keep the rays that pass."""
        deviation, passes = self.traced(self.values, place, tangents)
        place, tangents = place[passes], tangents[passes]
        return _Samples(place, tangents, _joined(place, tangents), deviation[passes], float(passes.mean()))

    def by_values(self, samples: _Samples) -> FloatArray:
        return _by_stepped_values(self, samples, samples.outputs)

    def error_arcmin(self, difference: FloatArray, samples: _Samples) -> FloatArray:
        """Return the larger of the errors at the nearest point and at infinity."""
        far, offset = difference[:, :2], difference[:, 2:] / _NEAREST_M
        angles = [_angle_arcmin(samples.tangents, each) for each in (far, far + offset)]
        return np.maximum(*angles)


def _joined(*parts: FloatArray) -> FloatArray:
    return np.concatenate(parts, axis=-1)


def _grid(x: FloatArray, y: FloatArray) -> FloatArray:
    return np.stack(np.meshgrid(x, y), axis=-1).reshape(-1, 2)


def _nodes(count: int) -> FloatArray:
    """Return `count` Chebyshev points, stretched so that the outermost ones are -1 and 1."""
    x = -np.cos((np.arange(count) + 0.5) * np.pi / count)
    return np.asarray(x / x[-1])


def _nodes_2d(box: Box, axes: tuple[int, int], count: int) -> FloatArray:
    """Return (count^2, 2) Chebyshev points over two axes of a box."""
    low, high = box.low[list(axes)], box.high[list(axes)]
    unit = _grid(_nodes(count), _nodes(count))
    return np.asarray(0.5 * (low + high) + 0.5 * unit * (high - low))


def _angle_arcmin(tangents: FloatArray, change: FloatArray) -> FloatArray:
    """Return the angles (n,) by which directions turn when their tangents (n, 2) change a little."""
    square = 1.0 + np.sum(tangents**2, axis=-1)
    along = np.sum(tangents * change, axis=-1)
    return np.asarray(np.sqrt(np.sum(change**2, axis=-1) / square - (along / square) ** 2) / ARCMIN)
