"""Exact mappings of an eye by ray tracing: the ground truth that fitted models are measured against.

The two maps from a view direction take one trace each. The other two are solved by Newton's method for the two
tangents of the view direction, with a Jacobian from forward differences of exact traces.
"""

from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from wlr_render.errors import BadInputError
from wlr_render.geometry import rays
from wlr_render.geometry.directions import dir_of_tangents, normalised, tangents_of_dir
from wlr_render.io.input_files import shown
from wlr_render.mappings import Eye, Panel, QueryResult, Status, StatusArray, count_unsolved
from wlr_render.numerics import newton
from wlr_render.numerics.arrays import FloatArray
from wlr_render.numerics.polynomial import Box, Polynomial, basis, total_degree
from wlr_render.optics.device import Device, EyeOptics
from wlr_render.optics.media import GREEN_UM
from wlr_render.optics.tracer import trace

TRACED = " (traced)"
"""Suffix of the name of mappings that trace a device exactly."""

_DEGREE = 4
_VIEWPOINTS = 60
_SEARCH = np.linspace(-2.0, 2.0, 61)  # tangents that are searched for the panel: 63 degrees to each side
_GRID = 15  # directions per axis and viewpoint
_MARGIN = 0.1  # margin of the field, which moves with the viewpoint

_AHEAD = dir_of_tangents(np.stack(np.meshgrid(*[np.linspace(-0.6, 0.6, 9)] * 2), axis=-1).reshape(-1, 2))

_BLOCK = 65_536  # queries solved at a time: bounds the memory that a whole panel takes
_TANGENT_STEP = 1e-7  # step of the forward differences
_PIXEL_TOLERANCE = 1e-9  # tolerance of solved pixels
_ANGLE_TOLERANCE = 1e-13  # tolerance of solved directions, radians
_MOST_UNSOLVED = 0.2  # largest share of unsolved pixels: an unsolved pixel takes a thousand times as long as others
_WAVELENGTHS_UM = 0.3, 3.0


def _fit_first_guess(display: "TracedDisplay") -> Polynomial:
    """Fit tangents to (u, v, x, y, z), from directions traced over the whole eye box that reach the panel.

    Raises:
        BadInputError: no direction from the nominal viewpoint reaches the panel.
    """
    panel, eye_box = display.panel, display.optics.eye_box
    search = np.stack(np.meshgrid(_SEARCH, _SEARCH), axis=-1).reshape(-1, 2)
    hits = search[_reaches(panel, *display.plane_pixel(dir_of_tangents(search), eye_box.centre))]
    if len(hits) == 0:
        raise BadInputError(
            f"{display.name}: no ray from the middle of the eye box reaches the panel; check the paths and "
            "apertures, and that all lengths are in mm."
        )
    low, high = hits.min(axis=0), hits.max(axis=0)
    margin = _MARGIN * (high - low) + (_SEARCH[1] - _SEARCH[0])
    axes = np.linspace(low - margin, high + margin, _GRID)
    tangents = np.stack(np.meshgrid(axes[:, 0], axes[:, 1]), axis=-1).reshape(-1, 2)
    viewpoint = eye_box.at(_spread(_VIEWPOINTS))[:, None, :]
    pixel, status = display.plane_pixel(dir_of_tangents(tangents), viewpoint)
    kept = _reaches(panel, pixel, status)
    inputs = np.concatenate([pixel, np.broadcast_to(viewpoint, (*pixel.shape[:-1], 3))], axis=-1)[kept]
    half = 0.5 * eye_box.size
    box = Box(np.r_[0.0, 0.0, eye_box.centre - half], np.r_[panel.size_px, eye_box.centre + half])
    targets = np.broadcast_to(tangents, pixel.shape)[kept]
    orders = total_degree(5, _DEGREE)
    design = basis(inputs, orders, box)
    coefficients, _, rank, _ = np.linalg.lstsq(design, targets, rcond=1e-9)
    if rank < design.shape[1]:
        raise BadInputError(f"{display.name}: the panel is not seen from most of the eye box; make 'eye_box' smaller.")
    return Polynomial(orders, box, coefficients)


def _guessed(guess: Polynomial, pixel: FloatArray, viewpoint: FloatArray) -> FloatArray:
    """Return the guessed tangents (n, 2) of pixels (n, 2) from viewpoints (n, 3), with inputs clipped to the fit."""
    return guess(np.clip(np.concatenate([pixel, viewpoint], axis=-1), guess.box.low, guess.box.high))


def _reaches(panel: Panel, pixel: FloatArray, status: StatusArray) -> NDArray[np.bool_]:
    """Return which rays end on the panel or just outside; rays just outside stabilise the fit at the panel's edge."""
    inside = np.all(np.abs(pixel / panel.size_px - 0.5) <= 0.55, axis=-1)
    return np.asarray(inside & (status == Status.OK))


def _spread(count: int) -> FloatArray:
    """Return points (count, 3) evenly spread over -1..1 in three axes: multiples of the powers of a root, modulo 1.

    The root solves g^4 = g + 1, the generalised golden ratio for three axes.
    """
    powers = 1.2207440846057596 ** -np.arange(1.0, 4.0)
    return np.asarray(2.0 * np.mod(0.5 + np.arange(count)[:, None] * powers, 1.0) - 1.0)


Miss = Callable[[FloatArray, NDArray[np.int64]], FloatArray]
"""Function (tangents (k, m, 2), index (m,) into the queries) -> offsets of the rays from their targets, (k, m, 2)."""


def traced_eye(device: Device, eye: str = "right", wavelength_um: float = GREEN_UM) -> Eye:
    """Return the mappings of one eye of a device at one vacuum wavelength in micrometres.

    Raises:
        BadInputError: the device has no such eye, its see-through path loses every ray, or the wavelength is not of
            visible or near-visible light.
    """
    shortest, longest = _WAVELENGTHS_UM
    if not shortest <= wavelength_um <= longest:
        raise BadInputError(
            f"the wavelength is {shown(wavelength_um)}; give micrometres from {shortest:g} to {longest:g}."
        )
    optics = device.optics(eye)
    display, see_through = TracedDisplay(optics, wavelength_um, device.name), TracedSeeThrough(optics, wavelength_um)
    lost = count_unsolved([see_through.real_ray_of_view_dir(_AHEAD, optics.eye_box.centre).status])
    if sum(lost.values()) == len(_AHEAD):
        why = ", ".join(f"{count} {status}" for status, count in lost.items())
        raise BadInputError(
            f"{device.name}: every see-through ray from the middle of the eye box is lost ({why}); check "
            "'see_through_path', the surfaces and their apertures, and that all lengths are in mm."
        )
    return Eye(device.name + TRACED, eye, display, see_through, optics.eye_box, optics.field)


@dataclass(frozen=True, eq=False)
class _Traced:
    """A mapping by ray tracing.

    Attributes:
        optics: the eye.
        wavelength_um: micrometres.
        name: name of the device, for messages.
    """

    optics: EyeOptics
    wavelength_um: float
    name: str = "device"


@dataclass(frozen=True, eq=False)
class TracedDisplay(_Traced):
    """Exact `mappings.DisplayMapping` by ray tracing."""

    @property
    def panel(self) -> Panel:
        """The panel of the eye."""
        return self.optics.panel.pixels

    def pixel_of_view_dir(
        self, view_dir: FloatArray, viewpoint: FloatArray, warm_start: FloatArray | None = None
    ) -> QueryResult:
        """Answer the backward query by one trace: CLIPPED outside the panel, MISS if the ray does not meet it."""
        pixel, status = self.plane_pixel(view_dir, viewpoint)
        outside = ~self.panel.contains(pixel)
        return _mapped(pixel, np.where((status == Status.OK) & outside, Status.CLIPPED, status))

    def view_dir_of_pixel(
        self, pixel: FloatArray, viewpoint: FloatArray, warm_start: FloatArray | None = None
    ) -> QueryResult:
        """Answer the forward query, solved to 1e-9 pixels; CLIPPED for pixels outside the panel."""
        lead = np.broadcast_shapes(pixel.shape[:-1], viewpoint.shape[:-1])
        wanted, eyes = _flat(pixel, lead), _flat(viewpoint, lead)
        outside = ~self.panel.contains(wanted)
        start = np.full_like(wanted, np.nan) if warm_start is None else warm_start.reshape(wanted.shape).copy()
        cold = ~outside & ~_found(start)
        # A first guess costs more than hundreds of queries, and fails for a display that cannot be solved.
        if warm_start is None or cold.any():
            start[cold] = _guessed(self._guess, wanted[cold], eyes[cold])
        tangents = self._solve(wanted, eyes, start)
        if warm_start is not None and (lost := ~outside & ~cold & ~_found(tangents)).any():
            tangents[lost] = self._solve(wanted[lost], eyes[lost], _guessed(self._guess, wanted[lost], eyes[lost]))
        view_dir = dir_of_tangents(tangents)
        status = np.where(_found(tangents), self.plane_pixel(view_dir, eyes)[1], Status.NOT_CONVERGED)
        status = np.where(outside, Status.CLIPPED, status)
        return _mapped(view_dir.reshape(*lead, 3), status.reshape(lead), tangents.reshape(*lead, 2))

    def plane_pixel(self, view_dir: FloatArray, viewpoint: FloatArray) -> tuple[FloatArray, StatusArray]:
        """Return the pixel (..., 2) on the panel, continued beyond its edges, even for CLIPPED rays, and the status."""
        traced = trace(self.optics.display, viewpoint, view_dir, self.wavelength_um)
        pixel = self.optics.panel.pixel_of_ray(traced.origin, traced.direction)
        status = np.where(np.isnan(pixel[..., 0]) & (traced.status == Status.OK), Status.MISS, traced.status)
        return pixel, status

    def _solve(self, pixel: FloatArray, viewpoint: FloatArray, start: FloatArray) -> FloatArray:
        """Return the tangents (n, 2) of pixels (n, 2) from viewpoints (n, 3); NaN where they are not found."""

        def miss(tangents: FloatArray, index: NDArray[np.int64]) -> FloatArray:
            return self.plane_pixel(dir_of_tangents(tangents), viewpoint[index])[0] - pixel[index]

        return _shoot(miss, start, _PIXEL_TOLERANCE)

    @cached_property
    def _guess(self) -> Polynomial:
        """First guess of tangents; an error if Newton's method then fails for over 20 % of the panel."""
        guess = _fit_first_guess(self)
        pixel = self.panel.grid(_GRID, _GRID).reshape(-1, 2)
        viewpoint = np.broadcast_to(self.optics.eye_box.centre, (len(pixel), 3))
        unsolved = np.mean(~_found(self._solve(pixel, viewpoint, _guessed(guess, pixel, viewpoint))))
        if unsolved > _MOST_UNSOLVED:
            raise BadInputError(
                f"{self.name}: no ray was found from the middle of the eye box to {unsolved:.0%} of the "
                "panel's pixels; check the surfaces, 'display_path' and the panel, and that all lengths are in mm."
            )
        return guess


@dataclass(frozen=True, eq=False)
class TracedSeeThrough(_Traced):
    """Exact `mappings.SeeThroughMapping` by ray tracing."""

    def real_ray_of_view_dir(
        self, view_dir: FloatArray, viewpoint: FloatArray, warm_start: FloatArray | None = None
    ) -> QueryResult:
        """Answer the forward query by one trace; the ray's point lies on the last surface."""
        traced = trace(self.optics.see_through, viewpoint, view_dir, self.wavelength_um)
        return _mapped(rays.pack(traced.origin, traced.direction), traced.status)

    def view_dir_of_real_point(
        self, point: FloatArray, viewpoint: FloatArray, warm_start: FloatArray | None = None
    ) -> QueryResult:
        """Answer the backward query, solved to 1e-13 rad at the viewpoint, starting with the straight line.

        MISS for points that are not in front of the eye or not beyond the optics.
        """
        lead = np.broadcast_shapes(point.shape[:-1], viewpoint.shape[:-1])
        wanted, eyes = _flat(point, lead), _flat(viewpoint, lead)
        ahead = wanted[:, 2] < eyes[:, 2]
        to_point = np.where(ahead[:, None], wanted - eyes, [0.0, 0.0, -1.0])
        distance = np.linalg.norm(to_point, axis=-1)
        across = _across(to_point / distance[:, None])

        def miss(tangents: FloatArray, index: NDArray[np.int64]) -> FloatArray:
            past, _, _ = self._passing(dir_of_tangents(tangents), eyes[index], wanted[index])
            return np.asarray(np.einsum("mij,...mj->...mi", across[index], past) / distance[index, None])

        cold = np.where(ahead[:, None], tangents_of_dir(to_point / distance[:, None]), np.nan)
        start = cold
        if warm_start is not None:
            warm = warm_start.reshape(cold.shape)
            start = np.where(_found(warm + cold)[:, None], warm, cold)
        tangents = _shoot(miss, start, _ANGLE_TOLERANCE)
        if warm_start is not None and (lost := ahead & ~_found(tangents)).any():
            tangents[lost] = self.view_dir_of_real_point(wanted[lost], eyes[lost]).warm_start
        view_dir = dir_of_tangents(tangents)
        _, along, status = self._passing(view_dir, eyes, wanted)
        status = np.where((status == Status.OK) & ~(along > 0.0), Status.MISS, status)
        status = np.where(ahead, np.where(_found(tangents), status, Status.NOT_CONVERGED), Status.MISS)
        return _mapped(view_dir.reshape(*lead, 3), status.reshape(lead), tangents.reshape(*lead, 2))

    def _passing(
        self, view_dir: FloatArray, viewpoint: FloatArray, point: FloatArray
    ) -> tuple[FloatArray, FloatArray, StatusArray]:
        """Return the closest approach of each world ray to its point: offset, distance, status."""
        traced = trace(self.optics.see_through, viewpoint, view_dir, self.wavelength_um)
        gap = traced.origin - point
        along = -np.sum(gap * traced.direction, axis=-1)
        return gap + along[..., None] * traced.direction, along, traced.status


def _across(direction: FloatArray) -> FloatArray:
    """Return two unit vectors perpendicular to each direction (n, 3) that looks forward, z < 0: (n, 2, 3)."""
    x, _, z = np.moveaxis(direction, -1, 0)
    first = normalised(np.stack([-z, np.zeros_like(x), x], axis=-1))
    return np.stack([first, np.cross(first, direction)], axis=-2)


def _flat(array: FloatArray, lead: tuple[int, ...]) -> FloatArray:
    return np.broadcast_to(array, (*lead, array.shape[-1])).reshape(-1, array.shape[-1])


def _found(tangents: FloatArray) -> NDArray[np.bool_]:
    return np.asarray(np.isfinite(tangents).all(axis=-1))


def _shoot(miss: Miss, start: FloatArray, tolerance: float) -> FloatArray:
    """Return the tangents (n, 2) at which `miss` vanishes, NaN where they are not found, block by block."""
    tangents = np.empty_like(start)
    shifts = _TANGENT_STEP * np.array([[[0.0, 0.0]], [[1.0, 0.0]], [[0.0, 1.0]]])
    for first in range(0, len(start), _BLOCK):
        rows = slice(first, first + _BLOCK)

        def residual(
            unknown: FloatArray, index: NDArray[np.int64], first: int = first
        ) -> tuple[FloatArray, FloatArray]:
            value = miss(unknown + shifts, index + first)
            return value[0], np.stack([value[1] - value[0], value[2] - value[0]], axis=-1) / _TANGENT_STEP

        root = newton.solve_2x2(residual, start[rows], tolerance)
        tangents[rows] = np.where(root.converged[:, None], root.unknown, np.nan)
    return tangents


def _mapped(value: FloatArray, status: NDArray[np.integer], warm_start: FloatArray | None = None) -> QueryResult:
    lost = np.expand_dims(status != Status.OK, -1)
    return QueryResult(np.where(lost, np.nan, value), np.asarray(status, dtype=np.uint8), warm_start)
