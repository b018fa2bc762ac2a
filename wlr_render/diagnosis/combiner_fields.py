"""Fields of the combiner: heights of its surfaces where lines of sight meet them, or deflections of the view."""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from functools import partial
from typing import Any

import numpy as np

from wlr_render.bench.bench_effects import AnyFunction
from wlr_render.bench.simulate_session import (
    camera_positions,
    display_dirs,
    dot_geometry,
    dot_pixels,
)
from wlr_render.diagnosis.causes.optics import of_optics
from wlr_render.diagnosis.field_terms import (
    StationField,
    Terms,
    field_of,
    polynomials,
    smooth_terms,
)
from wlr_render.diagnosis.observations import DISPLAY, SEE_THROUGH
from wlr_render.diagnosis.prediction import Explanation, Predictor
from wlr_render.diagnosis.weighed_readings import WeighedReadings
from wlr_render.geometry.directions import dir_of_tangents
from wlr_render.numerics.arrays import BoolArray, FloatArray
from wlr_render.numerics.polynomial import Box, basis, total_degree
from wlr_render.numerics.waves import LocalWaves, local_orders
from wlr_render.optics.combiner_form import SURFACES, places_on_combiner, surfaces_raised
from wlr_render.optics.device import EyeOptics, Path
from wlr_render.optics.sag_surfaces import XYPolynomial

_OF_CAUSES = ("all surfaces", "reflecting surfaces")  # groups of surfaces with causes for tilt and form
_DEGREES = (4, 6, 8, 10, 12)  # degrees of heights over the whole combiner
_SPOT_SHARES = (1.0, 0.65)  # sizes of the fitted box relative to the box around a spot; smaller boxes resolve more
_SPOT_DEGREES = (3, 5, 7, 9, 11, 14)
_HEIGHT_STEPS = np.full(3, 0.02)  # finite-difference steps of a height, um, and of its slopes, um/mm
_PLACE = "place on the combiner"


def _with_height(optics: EyeOptics, values: FloatArray, *, path: str, step: int) -> EyeOptics:
    """Return the optics with a height, given by piston (um) and slopes (um/mm), where a path meets one surface."""
    if not values.any():
        return optics
    piston, slope_x, slope_y = np.asarray(values) * [1e-6, 1e-3, 1e-3]
    coefficients = np.array([[piston, slope_y], [slope_x, 0.0]])
    steps = list(getattr(optics, path).steps)
    names = {steps[step].surface.name}
    other = surfaces_raised(optics, names, lambda sign: XYPolynomial(sign * coefficients))
    steps[step] = getattr(other, path).steps[step]
    changed: dict[str, Any] = {path: Path(tuple(steps))}
    return replace(optics, **changed)


@dataclass(frozen=True, eq=False)
class _Meeting:
    """The intersections of a path with a surface.

    Attributes:
        surface: name of the surface.
        place: (n, 2) of each reading's line of sight, millimetres right and up of the combiner's middle; NaN for
            readings of other paths.
        lever: (n, 2, 3) change of the readings by a height in micrometres and its slopes, in micrometres per
            millimetre, at that place.
    """

    surface: str
    place: FloatArray
    lever: FloatArray


def _meetings(readings: WeighedReadings) -> list[_Meeting]:
    """Return the intersections of the lines of sight with each surface of the combiner."""
    predictor, meetings = readings.predictor, []
    for path in ("display", "see_through"):
        for number, step in enumerate(getattr(readings.observations.nominal.optics, path).steps):
            place = footprints(predictor, path, number)
            lever = predictor.lever(of_optics(partial(_with_height, path=path, step=number)), _HEIGHT_STEPS)
            # Slopes are applied as heights x and y about the combiner's middle; subtract the height's part.
            lever[:, :, 1:] -= lever[:, :, :1] * np.nan_to_num(place)[:, None, :]
            lever[~np.isfinite(place).all(axis=1)] = 0.0
            meetings.append(_Meeting(step.surface.name, place, lever))
    return meetings


def combiner_fields(readings: WeighedReadings, spot: Box | None = None) -> Iterator[StationField]:
    """Yield heights of the combiner's surfaces as functions of the place where the lines of sight meet them.

    Args:
        readings: the readings.
        spot: box in millimetres for additional heights, which are zero outside it; None for no such heights.
    """
    if not readings.observations.nominal.optics.display.steps:
        yield from _view_fields(readings)
        return
    first = footprints(readings.predictor)
    met = np.asarray(np.isfinite(first).all(axis=1))
    if not met.any():
        return
    meetings, optics, done = _meetings(readings), readings.observations.nominal.optics, list[set[str]]()
    every = np.concatenate([each.place for each in meetings])
    orders, local = total_degree(2, _DEGREES[-1]), local_orders(_SPOT_DEGREES[-1])
    whole = polynomials(orders, Box.around(every[np.isfinite(every).all(axis=1)]))
    # Finite differences give the slopes of all terms in a tenth of the time of a polynomial's Jacobian.
    heights = AnyFunction(partial(basis, orders=orders, box=whole.box), whole.box)
    for surfaces, names_of in SURFACES.items():
        names = names_of(optics)
        if not names or names in done:
            continue
        done.append(names)
        of_surfaces = [each for each in meetings if each.surface in names]
        # Heights of first and second degree in these groups are tilts and form errors, which are causes.
        degrees = _DEGREES if surfaces in _OF_CAUSES else (2, *_DEGREES)
        columns, place = _by_height(of_surfaces, heights, len(orders)), np.where(met[:, None], first, 0.0)
        values = heights(place)
        # A constant height hardly changes the readings, so that its value is hardly determined.
        values = values - values[met].mean(axis=0)
        terms = Terms(_PLACE, place, values, np.asarray(orders.sum(axis=1)), degrees, (whole,))
        yield _height_field(surfaces, "", terms, columns, met)
        for box in () if spot is None else (_middle_of(spot, share) for share in _SPOT_SHARES):
            waves = LocalWaves(local, box, np.eye(len(local)))
            columns = _by_height(of_surfaces, waves, len(local))
            acts = np.any(columns != 0.0, axis=(1, 2)) & met
            terms = Terms(_PLACE, place, waves(place), local.sum(axis=1) - 1, _SPOT_DEGREES, (waves,))
            if acts.any():
                field = _height_field(
                    surfaces, f" in a spot {box.high[0] - box.low[0]:.2g} mm wide", terms, columns, acts
                )
                yield replace(field, is_in_spot=True)


def _middle_of(spot: Box, share: float) -> Box:
    middle, half = 0.5 * (spot.low + spot.high), 0.5 * share * (spot.high - spot.low)
    return Box(middle - half, middle + half)


def _height_field(surfaces: str, where: str, terms: Terms, columns: FloatArray, acts: BoolArray) -> StationField:
    """Return the field of a height, given its terms and the change (n, 2, t) of the readings by each term."""
    every, form = np.ones(len(acts), dtype=bool), f"height of {surfaces}{where}"
    return replace(field_of("combiner", form, "um", terms, columns[..., None], every, surfaces), acts=acts)


def _by_height(meetings: Sequence[_Meeting], heights: AnyFunction | LocalWaves, count: int) -> FloatArray:
    """Return the change (n, 2, count) of the readings by each of the height functions of the surfaces."""
    columns = np.zeros((*meetings[0].lever.shape[:2], count))
    for each in meetings:
        rows = heights.box.contains(each.place)
        height, slopes = heights.with_jacobian(each.place[rows])
        moved = np.concatenate([height[:, :, None], slopes], axis=2)
        columns[rows] += np.einsum("nik,ntk->nit", each.lever[rows], moved)
    return columns


def _view_fields(readings: WeighedReadings) -> Iterator[StationField]:
    """Yield deflections of the view by unknown optics: a turn and a shift of each line of sight."""
    observations, state = readings.observations, readings.predictor.state(Explanation())
    plan = observations.session.plan.see_through
    if plan is None or state.views.dots is None:
        return
    rows, tangents = observations.part == SEE_THROUGH, state.views.dots.tangents
    viewpoint, dot, _ = dot_geometry(state.bench, plan)
    here = dot_pixels(state.bench, plan, tangents)
    step = 1e-4  # finite-difference step, in tangents
    by_tangent = [(dot_pixels(state.bench, plan, tangents + step * axis) - here) / step for axis in np.eye(2)]
    turn = 1e-3 * np.stack(by_tangent, axis=-1)
    shift = turn / (viewpoint - dot)[:, 2, None, None]
    lever = np.concatenate([turn, shift], axis=2) / observations.sigma_of(SEE_THROUGH)[:, :, None]
    terms = smooth_terms("direction of view", tangents, 1, 2, 3, 4, 6)
    yield field_of("combiner", "turn and shift of the line of sight", "mrad, mm", terms, lever, rows)


def footprints(predictor: Predictor, path: str = "", step: int = 0) -> FloatArray:
    """Return where each reading's line of sight meets a surface of the combiner, (n, 2) millimetres right and up.

    The origin is the combiner's middle, in the device frame; NaN at run time and where the surface is missed.

    Args:
        predictor: predictor of the readings.
        path: "display" or "see_through": only readings that look along this path; all if empty.
        step: number of the surface along the path.
    """
    observations, state = predictor.observations, predictor.state(Explanation())
    bench, plan, place = state.bench, observations.session.plan, np.full((len(observations), 2), np.nan)
    optics, dots = bench.optics, state.views.dots
    if plan.display is not None and path != "see_through":
        lines = camera_positions(bench, plan.display), display_dirs(bench, plan.display)
        met = places_on_combiner(optics, *lines, step, optics.display, bench.wavelengths_um[1])
        place[observations.part == DISPLAY] = 1e3 * met
    if plan.see_through is not None and dots is not None and path != "display":
        lines = camera_positions(bench, plan.see_through), dir_of_tangents(dots.tangents)
        along = optics.see_through if path else optics.display
        met = places_on_combiner(optics, *lines, step, along, bench.target_wavelength_um)
        place[observations.part == SEE_THROUGH] = 1e3 * met
    return place
