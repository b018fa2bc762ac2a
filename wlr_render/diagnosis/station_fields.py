"""Fields at the stations of a bench: what a displacement of any smooth shape there does to every reading.

Physics acts at a station: the panel, a surface of the combiner, the camera's sensor, the target, the stage, or at a
time. A displacement there moves a reading by the reading's derivative, which the simulator gives, times the
displacement at the reading's coordinates of the station. A field is that displacement as a sum of smooth functions of
the coordinates with unknown coefficients; every function is one column. Fields at different stations tell where an
effect acts, whatever its shape.
"""

from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from functools import partial
from typing import Any

import numpy as np

from wlr_render.bench.bench_effects import BenchEffect
from wlr_render.bench.simulate_run_time import drawn_pixels
from wlr_render.bench.simulate_session import (
    camera_positions,
    display_dirs,
    dot_geometry,
    dot_pixels,
    simulate_to_first_order,
)
from wlr_render.captures.session import SeeThroughPlan, SessionPlan
from wlr_render.diagnosis.cause import Cause, Parameter
from wlr_render.diagnosis.causes import CAUSES
from wlr_render.diagnosis.causes.optics import of_optics
from wlr_render.diagnosis.observations import DISPLAY, RUN_TIME, SEE_THROUGH, Observations
from wlr_render.diagnosis.prediction import Explanation, Hypothesis, Predictor
from wlr_render.diagnosis.weighed_readings import WeighedReadings
from wlr_render.geometry.directions import tangents_of_dir
from wlr_render.geometry.transforms import inverse
from wlr_render.numerics.arrays import BoolArray, FloatArray, IntArray
from wlr_render.numerics.polynomial import Box, Polynomial, basis, total_degree
from wlr_render.optics.assembly import combiner_middle
from wlr_render.optics.combiner_form import SURFACES, surfaces_raised
from wlr_render.optics.device import EyeOptics, Path
from wlr_render.optics.sag_surfaces import XYPolynomial
from wlr_render.optics.tracer import trace

_CODE_PERIOD_PX = 64  # of the finest stripes of a Gray code that are looked for
_SCREW_PERIODS_M = tuple(np.geomspace(0.00025, 0.004, 13))  # of the leads of screws and their fractions
_STEP_M = 1e-5  # of a dot on the target, for the differences
_SLOPE_STEP = 1e-4  # of scaled coordinates, for the slope of a height
ELSEWHERE = ("stage", "time")  # stations whose constants are those of another: of the camera, or of the panel
_IDLE = 1e-9  # rms of a column in sigma below which it does nothing


@dataclass(frozen=True, eq=False)
class StationField:
    """A displacement at a station as a sum of smooth functions, each with an unknown coefficient.

    Attributes:
        station: where it acts.
        coordinates: of the station, on which the displacement depends.
        form: what is displaced, and how.
        columns: (n, 2, c) change of each reading by each function, in units of sigma; rms 1 over the readings.
        order: (c,) order of each function; a field of lower degree has those up to it.
        degrees: that are tried, ascending.
        place: (n, v) coordinates of each reading; those in `acts` (n,) feel the field.
        unit: of the displacement.
        displacement: coefficients (c,) -> (n, d) displacement in the unit.
        in_bench: coefficients (c,) -> effects of a bench that do the same; None where no bench file can state them.
    """

    station: str
    coordinates: str
    form: str
    columns: FloatArray
    order: IntArray
    degrees: tuple[int, ...]
    place: FloatArray
    acts: BoolArray
    unit: str
    displacement: Callable[[FloatArray], FloatArray]
    in_bench: Callable[[FloatArray], tuple[BenchEffect, ...]] | None = None


def station_fields(readings: WeighedReadings) -> list[StationField]:
    """Return all fields that a session can show, at the nominal bench."""
    plan = readings.observations.session.plan
    makers: list[Callable[[WeighedReadings], Iterator[StationField]]] = []
    if plan.display is not None:
        makers.append(_panel_fields)
    if plan.display is not None or plan.see_through is not None:
        makers += [_combiner_fields, _camera_fields, _stage_fields, _time_fields]
    if plan.see_through is not None and plan.see_through.bare_pixel is None:
        makers.append(_target_fields)
    if plan.run_time is not None:
        makers.append(_run_time_fields)
    return [field for maker in makers for field in maker(readings) if field.order.size]


@dataclass(frozen=True, eq=False)
class _Terms:
    """Smooth functions of coordinates.

    Attributes:
        coordinates: their name.
        place: (n, v) coordinates of each reading; zero where the functions are.
        values: (n, t) functions. order: (t,) of each.
        degrees: that are tried, ascending.
        polynomials: orders (t, v) and box of the functions, where they are polynomials of `place`; of each target pose,
            if there are `copies`.
        means: (t,) what was taken off each of these polynomials.
    """

    coordinates: str
    place: FloatArray
    values: FloatArray
    order: IntArray
    degrees: tuple[int, ...]
    polynomials: tuple[IntArray, Box] | None = None
    copies: int = 1
    means: FloatArray | None = None

    def varying(self) -> "_Terms":
        """Return the functions less their means, except a constant, of order 0."""
        means = np.where(self.order > 0, self.values.mean(axis=0), 0.0)
        return replace(self, values=self.values - means, means=means)

    def over(self, mask: BoolArray) -> "_Terms":
        """Return the functions at some of the readings (n,), zero elsewhere; they are given for these (m,) only."""
        return replace(self, place=_over(mask, self.place), values=_over(mask, self.values))


def _smooth(coordinates: str, variables: FloatArray, *degrees: int) -> _Terms:
    """Polynomials of variables (n, v) up to the last of the degrees."""
    orders = total_degree(variables.shape[1], degrees[-1])
    box = Box.around(variables)
    values = basis(variables, orders, box)
    return _Terms(coordinates, variables, values, np.asarray(orders.sum(axis=1)), degrees, (orders, box))


def _as_effects(
    station: str,
    displaces: str,
    orders: IntArray,
    box: Box,
    components: int,
    copies: int,
    values: FloatArray,
    means: FloatArray | None = None,
) -> tuple[BenchEffect, ...]:
    """Effects of a bench by coefficients of all terms and components; of each target pose, where there are copies."""
    terms = values.reshape(-1, components)
    if means is not None:
        terms = np.concatenate([terms[:1] - means @ terms, terms[1:]])
    parts = np.split(terms, copies)
    poses = range(copies) if copies > 1 else (-1,)
    return tuple(
        BenchEffect(station, displaces, Polynomial(orders, box, part), pose)
        for part, pose in zip(parts, poses, strict=True)
    )


def _field(station: str, form: str, unit: str, terms: _Terms, lever: FloatArray, displaces: str = "") -> StationField:
    """Return a field of terms, each acting through all components of a lever (n, 2, k): sigma per unit.

    `displaces` is what an effect of a bench at that station displaces alike; empty where there is none.
    """
    columns = (lever[:, :, None, :] * terms.values[:, None, :, None]).reshape(len(lever), 2, -1)
    components = np.repeat(terms.values[:, :, None], lever.shape[2], axis=2)

    def displacement(values: FloatArray) -> FloatArray:
        return np.asarray(np.einsum("ntk,tk->nk", components, values.reshape(-1, lever.shape[2])))

    in_bench = None
    if displaces and terms.polynomials is not None:
        in_bench = partial(
            _as_effects, station, displaces, *terms.polynomials, lever.shape[2], terms.copies, means=terms.means
        )
    order, acts = np.repeat(terms.order, lever.shape[2]), np.any(terms.values != 0.0, axis=1)
    return _scaled(
        StationField(
            station,
            terms.coordinates,
            form,
            columns,
            order,
            terms.degrees,
            terms.place,
            acts,
            unit,
            displacement,
            in_bench,
        )
    )


def _scaled(field: StationField) -> StationField:
    """Return the field with columns of rms 1, without columns of no effect."""
    size = np.sqrt(np.mean(field.columns**2, axis=(0, 1)))
    moves = np.isfinite(size) & (size > _IDLE)

    def whole(values: FloatArray) -> FloatArray:
        every = np.zeros(len(size))
        every[moves] = values / size[moves]
        return every

    def displacement(values: FloatArray) -> FloatArray:
        return field.displacement(whole(values))

    of_field = field.in_bench
    in_bench = None if of_field is None else lambda values: of_field(whole(values))

    highest = int(field.order[moves].max(initial=0))
    degrees = tuple(each for each in field.degrees if each < highest) + (highest,)
    columns, order = field.columns[:, :, moves] / size[moves], field.order[moves]
    return replace(field, columns=columns, order=order, degrees=degrees, displacement=displacement, in_bench=in_bench)


def _over(mask: BoolArray, values: FloatArray) -> FloatArray:
    """Values (m, ...) of the readings in a mask (n,), zero elsewhere."""
    full = np.zeros((len(mask), *values.shape[1:]))
    full[mask] = values
    return full


def _panel_lever(observations: Observations) -> FloatArray:
    """Change (n, 2, 2) of the readings by a panel pixel along u and v."""
    rows = observations.part == DISPLAY
    return _over(rows, observations.camera_from_panel / observations.sigma_of(DISPLAY)[:, :, None])


def _panel_fields(readings: WeighedReadings) -> Iterator[StationField]:
    observations = readings.observations
    plan, pixel = observations.session.plan.display, observations.session.readings.panel_pixel
    assert plan is not None
    assert pixel is not None
    rows, lever = observations.part == DISPLAY, _panel_lever(observations)
    smooth = _smooth("panel pixels", pixel, 1, 2, 4, 6, 8)
    yield _field("panel", "shift", "panel px", smooth.over(rows), lever, "shift")
    phase = np.mod(pixel, _CODE_PERIOD_PX).astype(int)
    for axis, name in enumerate(("columns", "rows")):
        stripes = np.eye(_CODE_PERIOD_PX)[phase[:, axis]]
        terms = _Terms("panel pixels", pixel, stripes, np.zeros(_CODE_PERIOD_PX, dtype=np.int64), (0,))
        yield _field("panel", f"shift that repeats every {_CODE_PERIOD_PX} {name}", "panel px", terms.over(rows), lever)
    stand = _scaled_to_box(plan.stage)
    coarse = _smooth("panel pixels", pixel, 6)
    swimming = np.concatenate([smooth.values, *(coarse.values * stand[:, [axis]] for axis in range(3))], axis=1)
    order = np.concatenate([smooth.order, *(coarse.order + 1,) * 3])
    terms = _Terms("panel pixels and viewpoint", pixel, swimming, order, (3, 5, 8))
    yield _field("panel", "shift", "panel px", terms.over(rows), lever)
    channels = np.unique(plan.channel)
    if len(channels) > 1:
        some = _smooth("panel pixels and colour", pixel, 4)
        each = np.concatenate([some.values * (plan.channel == channel)[:, None] for channel in channels], axis=1)
        order = np.tile(some.order, len(channels))
        terms = replace(some, values=each, order=order, degrees=(1, 2, 4), polynomials=None)
        yield _field("panel", "shift of each colour", "panel px", terms.over(rows), lever)


def _camera_fields(readings: WeighedReadings) -> Iterator[StationField]:
    """Shifts of the camera's image, the same in both parts.

    A point imaged at c is read at c + g(c). The panel is read at given pixels, so that what is read there belongs to
    c - g(c); a dot on the ray of its bare pixel moves with g there, too.
    """
    observations = readings.observations
    place = np.nan_to_num(observations.image_place)
    still = observations.part != RUN_TIME
    terms = _smooth("camera pixels", place, 1, 2, 4, 6, 8)
    plan = observations.session.plan.see_through
    if plan is not None and plan.bare_pixel is not None:
        # A dot on the ray of its bare pixel was seen there by the same camera: what moves both images moves no reading.
        still = still & (observations.part != SEE_THROUGH)
    sign = np.where(observations.part == DISPLAY, -1.0, 1.0) * still / observations.sigma_px
    lever = sign[:, None, None] * np.eye(2)
    yield _field("camera", "shift of the image", "px", terms, lever, "shift")


def _stage_fields(readings: WeighedReadings) -> Iterator[StationField]:
    """Poses of the camera as functions of the stage's readings, the same in both parts."""
    observations, motions = readings.observations, readings.camera_motions
    stage, still = _of_captures(observations, "stage", 3), observations.part != RUN_TIME
    yield _field(
        "stage",
        "pose of the camera",
        _POSE_UNIT,
        _smooth("stage readings", 1e3 * stage[still], 1, 2, 3, 4).varying().over(still),
        motions,
        "pose",
    )
    for axis, name in enumerate("xyz"):
        phases = [2.0 * np.pi * stage[:, axis] / period for period in _SCREW_PERIODS_M]
        waves = np.stack([wave(phase[still]) for phase in phases for wave in (np.sin, np.cos)], axis=1)
        order = np.ones(waves.shape[1], dtype=np.int64)
        terms = _Terms("stage readings", 1e3 * stage[still][:, [axis]], waves, order, (1,)).varying().over(still)
        yield _field("stage", f"shift along {name}, with periods of screws", "um", terms, motions[:, :, [axis]])
    travel = _of_captures(observations, "travel", 1)
    if len(np.unique(travel[still])) > 1:
        with_place = travel * np.concatenate([np.ones((len(stage), 1)), _scaled_to_box(stage)], axis=1)
        terms = _Terms("direction of travel", travel, with_place * still[:, None], np.array([0, 1, 1, 1]), (0, 1))
        yield _field("stage", "pose of the camera", _POSE_UNIT, terms, motions)


_POSE_UNIT = "um, urad"  # three shifts, then three turns


def _scaled_to_box(values: FloatArray) -> FloatArray:
    return Box.around(values).scaled(values)


def _time_fields(readings: WeighedReadings) -> Iterator[StationField]:
    observations, motions = readings.observations, readings.camera_motions
    time, still = _of_captures(observations, "time_s", 1), observations.part != RUN_TIME
    if len(np.unique(time[still])) < 4:
        return
    panel = observations.part == DISPLAY
    if panel.any() and len(np.unique(time[panel])) > 3:
        terms = _smooth("time", time[panel], 2, 5, 10, 16).varying().over(panel)
        yield _field("time", "shift of the panel", "panel px", terms, _panel_lever(observations), "shift")
    terms = _smooth("time", time[still], 1, 2, 5, 8, 12).varying().over(still)
    yield _field("time", "pose of the camera", _POSE_UNIT, terms, motions, "pose")


def _of_captures(observations: Observations, name: str, width: int) -> FloatArray:
    """Return a column of the tables, (n, width); zero at run time."""
    plan, values = observations.session.plan, np.zeros((len(observations), width))
    for part, table in ((DISPLAY, plan.display), (SEE_THROUGH, plan.see_through)):
        if table is not None:
            values[observations.part == part] = getattr(table, name).reshape(len(table), width)
    return values


def _target_fields(readings: WeighedReadings) -> Iterator[StationField]:
    """Displacements of the dots on the target, in its plane and out of it."""
    observations = readings.observations
    plan = observations.session.plan.see_through
    assert plan is not None
    rows, poses = observations.part == SEE_THROUGH, np.unique(plan.target_pose)
    lever = _over(rows, _dot_lever(readings.predictor, plan))
    pitches = plan.dot / observations.nominal.target.pitch[plan.target_pose][:, None]
    shared = _smooth("place on the target", pitches, 1, 2, 4, 6, 8)
    yield _field("target", "displacement, the same at each pose", "mm", shared.over(rows), lever, "shift")
    # A pose to each capture leaves nothing to hold out.
    if 1 < len(poses) <= len(np.unique(plan.capture)) / 2:
        one = _smooth("place on the target", pitches, 1, 2, 4, 6)
        own = np.concatenate([one.values * (plan.target_pose == pose)[:, None] for pose in poses], axis=1)
        polynomials = one.polynomials if np.array_equal(poses, np.arange(len(poses))) else None
        order = np.tile(one.order, len(poses))
        terms = replace(one, values=own, order=order, polynomials=polynomials, copies=len(poses))
        yield _field("target", "displacement of its own at each pose", "mm", terms.over(rows), lever, "shift")


def _dot_lever(predictor: Predictor, plan: SeeThroughPlan) -> FloatArray:
    """Change (m, 2, 3) of the dots' readings, in sigma, by a millimetre along the target's x, y and z."""
    state = predictor.state(Explanation())
    assert state.dot_views is not None
    height = np.zeros(len(plan)) if plan.height is None else plan.height
    here = dot_pixels(state.bench, plan, state.dot_views.tangents)
    columns = []
    for step in _STEP_M * np.eye(3):
        moved = replace(plan, dot=plan.dot + step[:2], height=height + step[2])
        seen = simulate_to_first_order(state.bench, SessionPlan(see_through=moved), state.dot_views).dot_pixel
        assert seen is not None
        columns.append((seen - here) * (1e-3 / _STEP_M))
    return np.nan_to_num(np.stack(columns, axis=-1)) / predictor.observations.sigma_of(SEE_THROUGH)[:, :, None]


def _with_height(optics: EyeOptics, values: FloatArray, *, path: str, step: int) -> EyeOptics:
    """Return the optics with a height where a path meets one surface: its piston (um) and slopes (um/mm)."""
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


def _height(path: str, step: int) -> Cause:
    """Return a cause with a height where a path meets one surface: its derivative is the surface's lever there."""
    return Cause(
        "height",
        "height added to a surface of the combiner",
        "device",
        (Parameter("piston", "um", 10.0), Parameter("slope_x", "um/mm", 10.0), Parameter("slope_y", "um/mm", 10.0)),
        source="",
        separated_by="",
        variants={"": of_optics(partial(_with_height, path=path, step=step))},
    )


@dataclass(frozen=True, eq=False)
class _Meeting:
    """Where a path meets a surface.

    Attributes:
        surface: its name.
        place: (n, 2) of each reading's line of sight, millimetres right and up of the combiner's middle; NaN where the
            path is not that of the reading.
        lever: (n, 2, 3) change of the readings by a height in micrometres and its slopes, in micrometres per
            millimetre, at that place.
    """

    surface: str
    place: FloatArray
    lever: FloatArray


def _meetings(readings: WeighedReadings) -> list[_Meeting]:
    """Return all places where the lines of sight meet the combiner's surfaces."""
    predictor, meetings = readings.predictor, []
    for path in ("display", "see_through"):
        for number, step in enumerate(getattr(readings.observations.nominal.optics, path).steps):
            place = footprints(predictor, path, number)
            lever = _lever(predictor, Hypothesis(_height(path, number), ""))
            # The levers of the slopes are those of heights x and y about the middle: less the heights themselves.
            lever[:, :, 1:] -= lever[:, :, :1] * np.nan_to_num(place)[:, None, :]
            lever[~np.isfinite(place).all(axis=1)] = 0.0
            meetings.append(_Meeting(step.surface.name, place, lever))
    return meetings


def _combiner_fields(readings: WeighedReadings) -> Iterator[StationField]:
    """Heights of the combiner's surfaces over the places where the lines of sight meet them."""
    if not readings.observations.nominal.optics.display.steps:
        yield from _view_fields(readings)
        return
    first = footprints(readings.predictor)
    met = np.asarray(np.isfinite(first).all(axis=1))
    if not met.any():
        return
    meetings = _meetings(readings)
    place, box = np.where(met[:, None], first, 0.0), Box.around(np.concatenate([_known(each) for each in meetings]))
    orders = total_degree(2, 12)
    value, order, done = basis(place, orders, box), np.asarray(orders.sum(axis=1)), list[set[str]]()

    def height(values: FloatArray) -> FloatArray:
        return np.asarray(value @ values)[:, None]

    for surfaces, names_of in SURFACES.items():
        names = names_of(readings.observations.nominal.optics)
        if not names or names in done:
            continue
        done.append(names)
        columns = sum(_by_height(each, orders, box) for each in meetings if each.surface in names)
        coordinates, degrees = "place on the combiner", (2, 4, 6, 8, 10, 12)
        form, in_bench = f"height of {surfaces}", partial(_as_effects, "combiner", surfaces, orders, box, 1, 1)
        field = StationField(
            "combiner", coordinates, form, np.asarray(columns), order, degrees, place, met, "um", height, in_bench
        )
        yield _scaled(field)


def _known(meeting: _Meeting) -> FloatArray:
    """Places (m, 2) that are known."""
    return np.asarray(meeting.place[np.isfinite(meeting.place).all(axis=1)])


def _by_height(meeting: _Meeting, orders: IntArray, box: Box) -> FloatArray:
    """Change (n, 2, t) of the readings by heights that are polynomials of the place."""
    columns = np.zeros((*meeting.lever.shape[:2], len(orders)))
    rows = np.isfinite(meeting.place).all(axis=1)
    place, lever = meeting.place[rows], meeting.lever[rows]
    steps = 2.0 * _SLOPE_STEP / box.per_unit
    values = [basis(place, orders, box)] + [
        (basis(place + 0.5 * step, orders, box) - basis(place - 0.5 * step, orders, box)) / np.sum(step)
        for step in np.diag(steps)
    ]
    for number, each in enumerate(values):
        columns[rows] += lever[:, :, [number]] * each[:, None, :]
    return columns


def _view_fields(readings: WeighedReadings) -> Iterator[StationField]:
    """Deflections of the view by optics that are not known: a turn and a shift of each line of sight, up and right."""
    observations, state = readings.observations, readings.predictor.state(Explanation())
    plan = observations.session.plan.see_through
    if plan is None or state.dot_views is None:
        return
    rows, tangents = observations.part == SEE_THROUGH, state.dot_views.tangents
    viewpoint, dot, _ = dot_geometry(state.bench, plan)
    here = dot_pixels(state.bench, plan, tangents)
    step = 1e-4  # of tangents
    by_tangent = [(dot_pixels(state.bench, plan, tangents + step * axis) - here) / step for axis in np.eye(2)]
    turn = 1e-3 * np.stack(by_tangent, axis=-1)
    shift = turn / (viewpoint - dot)[:, 2, None, None]
    lever = np.concatenate([turn, shift], axis=2) / observations.sigma_of(SEE_THROUGH)[:, :, None]
    terms = _smooth("direction of view", tangents, 1, 2, 3, 4, 6).over(rows)
    yield _field("combiner", "turn and shift of the line of sight", "mrad, mm", terms, _over(rows, lever))


def footprints(predictor: Predictor, path: str = "", step: int = 0) -> FloatArray:
    """Return where each reading's line of sight meets a surface of the combiner, (n, 2) millimetres right and up.

    From the combiner's middle, device frame; NaN at run time and where nothing is met.

    Args:
        predictor: of the readings.
        path: "display" or "see_through": only readings that look along it count; all if empty.
        step: number of the surface along the path.
    """
    observations, state = predictor.observations, predictor.state(Explanation())
    bench, plan, place = state.bench, observations.session.plan, np.full((len(observations), 2), np.nan)
    optics, middle = bench.optics, combiner_middle(bench.optics)
    if not optics.display.steps:
        return place
    if plan.display is not None and path != "see_through":
        met = trace(
            Path(optics.display.steps[: step + 1]),
            camera_positions(bench, plan.display),
            display_dirs(bench, plan.display),
            bench.wavelengths_um[1],
        )
        place[observations.part == DISPLAY] = 1e3 * (met.origin - middle)[:, :2]
    if plan.see_through is not None and state.dot_views is not None and path != "display":
        tangents = state.dot_views.tangents
        directions = np.concatenate([tangents, -np.ones((len(tangents), 1))], axis=1)
        directions /= np.linalg.norm(directions, axis=1, keepdims=True)
        steps = (optics.see_through if path else optics.display).steps[: step + 1]
        met = trace(Path(steps), camera_positions(bench, plan.see_through), directions, bench.target_wavelength_um)
        place[observations.part == SEE_THROUGH] = 1e3 * (met.origin - middle)[:, :2]
    return place


def _lever(predictor: Predictor, hypothesis: Hypothesis) -> FloatArray:
    """Change (n, 2, k) of the readings, in sigma, by each parameter of a cause in its unit, at the nominal bench."""
    nothing = Explanation()
    at = predictor.added(predictor.state(nothing), nothing.plus(hypothesis))
    lever = np.zeros((*at.residual.shape, len(hypothesis.cause.parameters)))
    lever[:, :, at.free] = at.jacobian
    return np.asarray(lever / [each.prior_sigma for each in hypothesis.cause.parameters])


def _run_time_fields(readings: WeighedReadings) -> Iterator[StationField]:
    """Return the fields of a recording of head motion: shifts of the virtual dot, and delays, by all variables."""
    observations, predictor = readings.observations, readings.predictor
    plan, seen = observations.session.plan.run_time, observations.session.readings.run_time_pixel
    assert plan is not None
    assert seen is not None
    rows = observations.part == RUN_TIME
    shift = _over(rows, np.broadcast_to(np.eye(2), (len(plan), 2, 2)) / observations.sigma_of(RUN_TIME)[:, :, None])
    delay = _lever(predictor, Hypothesis(CAUSES["latency"], next(iter(CAUSES["latency"].variants))))
    delay[~rows] = 0.0
    device_from_world = inverse(plan.world_from_device)[:, :3, :3]
    gravity = -device_from_world[:, :, 1]
    rate = np.einsum("nij,nj->ni", device_from_world, plan.head_rate)
    panel = drawn_pixels(observations.nominal, plan)
    gaze = tangents_of_dir(plan.gaze)

    def over(coordinates: str, variables: FloatArray, *degrees: int) -> _Terms:
        return _smooth(coordinates, variables, *degrees).over(rows)

    in_image = over("camera pixels", seen[:, 2:], 1, 2, 4)
    on_panel = over("panel pixels", panel, 1, 2, 4, 6)
    yield _field("camera", "shift of the image", "px", in_image, shift)
    yield _field("camera", "delay of its rows or columns", "ms", in_image, delay)
    yield _field("panel", "delay of its rows or columns", "ms", on_panel, delay)
    yield _field("panel", "shift", "px", over("panel pixels", panel, 1, 2, 4), shift)
    yield _field("head motion", "shift of the picture", "px", over("direction of gravity", gravity, 1, 2, 3), shift)
    yield _field("head motion", "shift of the picture", "px", over("rate of the head", rate, 1, 2), shift)
    yield _field("head motion", "delay", "ms", over("rate of the head", rate, 1, 2), delay)
    yield _field("eye tracking", "shift of the picture", "px", over("tracked pupil", plan.viewpoint, 1, 2, 3), shift)
    yield _field("eye tracking", "shift of the picture", "px", over("direction of gaze", gaze, 1, 2, 3), shift)
    yield _field("time", "shift of the picture", "px", over("time", plan.time_s[:, None], 2, 5, 10), shift)
