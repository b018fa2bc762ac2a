"""Fields at the stations of a bench: changes of every reading by a displacement of any smooth shape there.

Physics acts at a station: the panel, a surface of the combiner, the camera's sensor, the target, the stage, or at a
time. A displacement at a station moves a reading by the derivative of the reading, which the simulator gives, times the
displacement at the reading's coordinates of that station. A field is a displacement as a sum of smooth functions of
the coordinates with unknown coefficients; every function is one column. Fields at different stations show where an
effect acts, whatever its shape.
"""

from collections.abc import Callable, Iterator, Sequence
from dataclasses import replace
from functools import partial

import numpy as np

from wlr_render.bench.simulate_run_time import places_by_plan
from wlr_render.bench.simulate_session import Views, camera_positions, dot_pixels, simulate
from wlr_render.captures.session import Readings, SeeThroughPlan, SessionPlan
from wlr_render.diagnosis.cause import changed
from wlr_render.diagnosis.combiner_fields import combiner_fields
from wlr_render.diagnosis.field_terms import StationField, field_of, smooth_terms
from wlr_render.diagnosis.observations import DISPLAY, RUN_TIME, SEE_THROUGH, Observations
from wlr_render.diagnosis.periodic_fields import screw_fields, stripe_fields
from wlr_render.diagnosis.prediction import Explanation, Predictor
from wlr_render.diagnosis.weighed_readings import WeighedReadings
from wlr_render.geometry.transforms import rotations_of_vectors
from wlr_render.numerics.arrays import FloatArray, IntArray
from wlr_render.numerics.polynomial import Box, total_degree

_LINE_DEGREES = (1, 2, 5, 10, 16, 24)  # degrees of functions of the row or of the column
_TIME_DEGREES = (1, 2, 5, 8, 12)
"""Degrees in time of the camera's pose and of the stretch of its image: equal, because a field that follows faster
changes would win for that alone."""
_FEWEST_TIMES = 4  # fewest distinct times that show a drift
_STEP_M = 1e-5  # finite-difference step of a dot on the target, metres
_DELAY = changed("clock", "latency_s", lambda old, ms: old + 1e-3 * float(ms[0])), np.array([0.02])
_PUPIL = changed("eye_tracking", "bias", lambda old, mm: old + 1e-3 * mm), np.full(3, 1e-3)
"""Changes of the delay of the picture, ms, and of the pupil, mm, with their finite-difference steps."""


def station_fields(
    readings: WeighedReadings, like: Sequence[StationField] | None = None, spot: Box | None = None
) -> list[StationField]:
    """Return all fields that a session can show, at the nominal bench.

    Args:
        readings: the readings.
        like: fields of other readings; only fields of the same kinds are returned. None for all.
        spot: spot on the combiner, millimetres, in which finer heights are tried; None for no spot.
    """
    plan = readings.observations.session.plan
    makers: list[tuple[str, Callable[[WeighedReadings], Iterator[StationField]]]] = []
    if plan.display is not None:
        makers.append(("panel", partial(_panel_fields, like=like or ())))
    if plan.display is not None or plan.see_through is not None:
        makers += [("combiner", partial(combiner_fields, spot=spot)), ("camera", _camera_fields)]
        makers += [("stage", partial(_stage_fields, like=like or ())), ("time", _time_fields)]
    if plan.see_through is not None and plan.see_through.bare_pixel is None:
        makers.append(("target", _target_fields))
    if plan.run_time is not None:
        makers.append(("", _run_time_fields))
    kinds = None if like is None else {field.kind for field in like}
    stations = None if like is None else {"", *(field.station for field in like)}
    return [
        field
        for station, maker in makers
        if stations is None or station in stations
        for field in maker(readings)
        if field.order.size and (kinds is None or field.kind in kinds)
    ]


def _predicted(readings: WeighedReadings) -> Readings:
    """Return the readings that the nominal bench predicts."""
    return readings.predictor.state(Explanation()).readings


def _panel_lever(observations: Observations) -> FloatArray:
    """Return the change (n_display, 2, 2) of the display's readings, in sigma, by a panel pixel along u and v."""
    return np.asarray(observations.camera_from_panel / observations.sigma_of(DISPLAY)[:, :, None])


def _panel_fields(readings: WeighedReadings, like: Sequence[StationField]) -> Iterator[StationField]:
    observations = readings.observations
    plan = observations.session.plan.display
    assert plan is not None
    rows, lever = observations.part == DISPLAY, _panel_lever(observations)
    # Smooth functions are evaluated at predicted pixels: at measured ones they would contain the readings' noise.
    smooth_at = _predicted(readings).panel_pixel
    assert smooth_at is not None
    smooth = smooth_terms("panel pixels", smooth_at, 1, 2, 4, 6, 8)
    yield field_of("panel", "shift", "panel px", smooth, lever, rows, "shift")
    yield from stripe_fields(readings, smooth_at, lever, like)
    places = np.concatenate([smooth_at, 1e3 * camera_positions(observations.nominal, plan)], axis=1)
    orders = np.concatenate([_with_viewpoint(8), *(_with_viewpoint(6, axis) for axis in range(3))])
    swimming = smooth_terms("panel pixels and viewpoint", places, 3, 5, 8, orders=orders)
    yield field_of("panel", "shift", "panel px", swimming, lever, rows, "shift by viewpoint")
    if len(np.unique(plan.channel)) > 1:
        of_colours = smooth_terms("panel pixels and colour", smooth_at, 1, 2, 4).for_each("channel", plan.channel)
        yield field_of("panel", "shift of each colour", "panel px", of_colours, lever, rows, "shift")


def _with_viewpoint(degree: int, axis: int | None = None) -> IntArray:
    """Return orders (t, 5) of polynomials of the panel pixel, constant or linear along an axis of the viewpoint."""
    of_pixel = total_degree(2, degree)
    of_viewpoint = np.zeros((len(of_pixel), 3), dtype=np.int64)
    if axis is not None:
        of_viewpoint[:, axis] = 1
    return np.concatenate([of_pixel, of_viewpoint], axis=1)


def _camera_fields(readings: WeighedReadings) -> Iterator[StationField]:
    """Yield shifts of the camera's image, the same in both parts.

    A point imaged at c is read at c + g(c). The panel is read at given camera pixels, so that such a reading belongs to
    c - g(c). The shift at its bare pixel also moves a dot on the ray of that pixel.
    """
    observations = readings.observations
    place, dots = np.nan_to_num(observations.image_place), _predicted(readings).dot_pixel
    if dots is not None:
        place[observations.part == SEE_THROUGH] = dots
    still = observations.part != RUN_TIME
    terms = smooth_terms("camera pixels", place, 1, 2, 4, 6, 8)
    plan = observations.session.plan.see_through
    if plan is not None and plan.bare_pixel is not None:
        # The same camera saw such a dot at its bare pixel: a shift of both images moves no reading.
        still = still & (observations.part != SEE_THROUGH)
    sign = np.where(observations.part == DISPLAY, -1.0, 1.0) * still / observations.sigma_px
    lever = sign[:, None, None] * np.eye(2)
    yield field_of("camera", "shift of the image", "px", terms, lever, np.ones(len(place), dtype=bool), "shift")
    time = observations.of_captures("time_s", 1)
    if len(np.unique(time[still])) < _FEWEST_TIMES:
        return
    # A shift of the whole image over time cannot be distinguished from a turn of the camera.
    places = np.concatenate([place, time], axis=1)[still]
    for form, orders, degrees in (
        ("shift of the image", _with_time(4, 1), (2, 3, 5)),
        ("stretch of the image over time", _with_time(1, _TIME_DEGREES[-1]), [1 + each for each in _TIME_DEGREES]),
    ):
        terms = smooth_terms("camera pixels and time", places, *degrees, orders=orders)
        yield field_of("camera", form, "px", terms, lever[still], still, "shift by time")


def _with_time(of_pixel: int, of_time: int) -> IntArray:
    """Return orders (t, 3) of polynomials of the camera pixel, without a constant, times polynomials of the time."""
    return np.array([[*at, by] for at in total_degree(2, of_pixel) if at.sum() > 0 for by in range(of_time + 1)])


def _stage_fields(readings: WeighedReadings, like: Sequence[StationField]) -> Iterator[StationField]:
    """Yield poses of the camera as functions of the stage's readings, the same in both parts."""
    observations, motions = readings.observations, readings.camera_motions
    stage, still = observations.of_captures("stage", 3), observations.part != RUN_TIME
    terms = smooth_terms("stage readings", 1e3 * stage[still], 1, 2, 3, 4).varying()
    yield field_of("stage", "pose of the camera", _POSE_UNIT, terms, motions[still], still, "pose")
    yield from screw_fields(readings, stage, like)
    travel = observations.of_captures("travel", 1)
    if len(np.unique(travel[still])) > 1:
        orders = np.eye(4, dtype=np.int64)
        orders[:, 0] = 1
        places = np.concatenate([travel, 1e3 * stage], axis=1)[still]
        terms = smooth_terms("direction of travel", places, 0, 1, orders=orders)
        terms = replace(terms, place=travel[still], order=terms.order - 1)
        yield field_of("stage", "pose of the camera", _POSE_UNIT, terms, motions[still], still, "pose by travel")


_POSE_UNIT = "um, urad"  # three shifts, then three turns


def _time_fields(readings: WeighedReadings) -> Iterator[StationField]:
    observations, motions = readings.observations, readings.camera_motions
    time, still = observations.of_captures("time_s", 1), observations.part != RUN_TIME
    if len(np.unique(time[still])) < _FEWEST_TIMES:
        return
    panel = observations.part == DISPLAY
    if panel.any() and len(np.unique(time[panel])) >= _FEWEST_TIMES:
        terms = smooth_terms("time", time[panel], 2, 5, 10, 16).varying()
        yield field_of("time", "shift of the panel", "panel px", terms, _panel_lever(observations), panel, "shift")
    terms = smooth_terms("time", time[still], *_TIME_DEGREES).varying()
    yield field_of("time", "pose of the camera", _POSE_UNIT, terms, motions[still], still, "pose")


def _target_fields(readings: WeighedReadings) -> Iterator[StationField]:
    """Yield displacements of the dots on the target, in its plane and out of it."""
    observations = readings.observations
    plan = observations.session.plan.see_through
    assert plan is not None
    rows, poses = observations.part == SEE_THROUGH, np.unique(plan.target_pose)
    lever = dot_lever(readings.predictor, plan)
    pitches = plan.dot / observations.nominal.target.pitch[plan.target_pose][:, None]
    shared = smooth_terms("place on the target", pitches, 1, 2, 4, 6, 8, 10)
    yield field_of("target", "displacement, the same at each pose", "mm", shared, lever, rows, "shift")
    # With a pose for each capture, no capture can be held out.
    if 1 < len(poses) <= len(np.unique(plan.capture)) / 2:
        terms = smooth_terms("place on the target", pitches, 1, 2, 4, 6).for_each("target_pose", plan.target_pose)
        yield field_of("target", "displacement of its own at each pose", "mm", terms, lever, rows, "shift")


def dot_lever(predictor: Predictor, plan: SeeThroughPlan) -> FloatArray:
    """Return the change (m, 2, 3) of the dots' readings, in sigma, by a millimetre along the target's x, y and z."""
    state = predictor.state(Explanation())
    assert state.views.dots is not None
    height = np.zeros(len(plan)) if plan.height is None else plan.height
    here = dot_pixels(state.bench, plan, state.views.dots.tangents)
    columns = []
    for step in _STEP_M * np.eye(3):
        moved = SessionPlan(see_through=replace(plan, dot=plan.dot + step[:2], height=height + step[2]))
        seen = simulate(state.bench, moved, Views.of(state.bench, moved, state.views)).dot_pixel
        assert seen is not None
        columns.append((seen - here) * (1e-3 / _STEP_M))
    return np.nan_to_num(np.stack(columns, axis=-1)) / predictor.observations.sigma_of(SEE_THROUGH)[:, :, None]


def _run_time_fields(readings: WeighedReadings) -> Iterator[StationField]:
    """Yield the fields of a recording of head motion: shifts of the virtual dot, and delays, by all variables."""
    observations, predictor = readings.observations, readings.predictor
    plan, views = observations.session.plan.run_time, predictor.state(Explanation()).views.run_time
    assert plan is not None
    assert views is not None
    seen = views.pixel
    rows, sigma = observations.part == RUN_TIME, observations.sigma_of(RUN_TIME)[:, :, None]
    shift, turn = np.eye(2) / sigma, _picture_turned(observations, seen[:, :2]) / sigma
    delay, pupil = (predictor.lever(change, steps)[rows] for change, steps in (_DELAY, _PUPIL))
    places = places_by_plan(plan, views.drawn_at)
    for station, form, pixel in (("camera", "shift of the image", seen[:, 2:]), ("panel", "shift", views.drawn_at)):
        terms = smooth_terms(f"{station} pixels", pixel, 1, 2, 4, 6)
        yield field_of(station, form, "px", terms, shift, rows, "picture")
        for axis, lines in enumerate(("columns", "rows")):
            orders = np.arange(_LINE_DEGREES[-1] + 1)[:, None] * np.eye(2, dtype=np.int64)[axis]
            terms = smooth_terms(f"{station} pixels", pixel, *_LINE_DEGREES, orders=orders)
            yield field_of(station, f"delay of its {lines}", "ms", terms, delay, rows, "delay")
    for station, displaces, coordinates, form, unit, lever, degrees in (
        ("head motion", "picture by gravity", "direction of gravity", "turn of the picture", "mrad", turn, (1, 2, 3)),
        ("head motion", "picture by rate", "rate of the head", "turn of the picture", "mrad", turn, (1, 2)),
        ("head motion", "delay by rate", "rate of the head", "delay", "ms", delay, (1, 2)),
        ("eye tracking", "picture by pupil", "tracked pupil", "shift of the picture", "px", shift, (1, 2, 3)),
        ("eye tracking", "pupil by pupil", "tracked pupil", "place of the pupil", "mm", pupil, (1, 2, 3)),
        ("eye tracking", "pupil by gaze", "direction of gaze", "place of the pupil", "mm", pupil, (1, 2, 3, 4, 6, 8)),
        ("time", "picture", "time", "turn of the picture", "mrad", turn, (2, 5, 10, 16, 24)),
        ("time", "delay", "time", "delay", "ms", delay, (1, 2, 5, 10, 16, 24)),
    ):
        terms = smooth_terms(coordinates, places[station, displaces], *degrees)
        yield field_of(station, form, unit, terms, lever, rows, displaces)


def _picture_turned(observations: Observations, virtual: FloatArray) -> FloatArray:
    """Return the change (n, 2, 3) of the virtual dots' pixels (n, 2) by a milliradian about each axis of the device."""
    camera = observations.nominal.camera
    ahead = camera.view_dir_of_pixel(virtual)
    turns = rotations_of_vectors(1e-3 * np.eye(3))
    return np.stack([camera.pixel_of_view_dir(ahead @ turn.T) - virtual for turn in turns], axis=-1)
