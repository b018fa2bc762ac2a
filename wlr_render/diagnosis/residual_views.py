"""Residuals of each part of a session: over the field of view, and against each variable.

Angles are seen by the camera, in arcminutes to the right and down.
"""

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from wlr_render.captures.session import DisplayPlan, SeeThroughPlan
from wlr_render.diagnosis.diagnosis import Diagnosis
from wlr_render.diagnosis.observations import DISPLAY, PART_NAMES, RUN_TIME, SEE_THROUGH, Observations
from wlr_render.geometry.directions import ARCMIN, tangents_of_dir
from wlr_render.numerics.arrays import BoolArray, FloatArray, IntArray

_MOST = 8  # most maps of a part


@dataclass(frozen=True, eq=False)
class Variable:
    """A variable that a residual may depend on.

    Attributes:
        name: with its unit.
        values: (m,) of each reading.
        outwards: (m, 2) unit direction of its first component as the camera sees it; None for right and down.
    """

    name: str
    values: FloatArray
    outwards: FloatArray | None = None


@dataclass(frozen=True, eq=False)
class FieldMap:
    """The readings that one map of the field of view shows.

    Attributes:
        title: one line.
        rows: (m,) mask of readings that count.
    """

    title: str
    rows: BoolArray


@dataclass(frozen=True, eq=False)
class BenchResiduals:
    """Residuals by one bench, right and down; NaN where a reading does not count or is not predicted.

    Attributes:
        name: of the bench.
        seen: (m, 2) in arcminutes as the camera sees it.
        on_map: (m, 2) in the unit of the maps.
    """

    name: str
    seen: FloatArray
    on_map: FloatArray


@dataclass(frozen=True, eq=False)
class PartView:
    """One part of a session.

    Attributes:
        name: of the part.
        states: by the bench as described and, where something is corrected, by the corrected one.
        sigma_arcmin: noise, per axis.
        motion: (m, 2, 6) change of the readings, right and down in arcminutes, by the usual motion of their capture.
        group: (m,) the capture of each reading, by number.
        place: (m, 2) where in the field each reading is, right and down.
        map_unit: unit of the arrows of the maps.
        place_label: titles of their axes.
        maps: maps to draw.
        variables: variables that differ between readings.
    """

    name: str
    states: tuple[BenchResiduals, ...]
    sigma_arcmin: float
    motion: FloatArray
    group: IntArray
    place: FloatArray
    map_unit: str
    place_label: tuple[str, str]
    maps: tuple[FieldMap, ...]
    variables: tuple[Variable, ...]


def part_views(diagnosis: Diagnosis) -> list[PartView]:
    """Return a view of every part that has readings that count."""
    return [_view(diagnosis, int(part)) for part in np.unique(diagnosis.observations.part[diagnosis.used])]


def _view(diagnosis: Diagnosis, part: int) -> PartView:
    benches = {"bench as described": diagnosis.residual_before}
    if diagnosis.is_corrected:
        benches["corrected bench"] = diagnosis.residual_after
    return part_view(diagnosis.observations, part, diagnosis.used, benches, diagnosis.usual_motion)


def part_view(
    observations: Observations,
    part: int,
    used: BoolArray,
    states: Mapping[str, FloatArray],
    usual_motion: FloatArray,
) -> PartView:
    """Return a view of one part.

    Args:
        observations: the readings.
        part: of the session.
        used: (n,) readings that count.
        states: (n, 2) residuals, or changes of readings, in units of sigma, by name.
        usual_motion: (n, 2, q) change of the readings by the usual motion of their capture, in units of sigma.
    """
    rows = observations.part == part
    used = used[rows]
    views = {DISPLAY: _display, SEE_THROUGH: _see_through, RUN_TIME: _run_time}
    place, maps, variables = views[part](observations, used)
    shown = []
    for name, residual in states.items():
        seen = observations.arcminutes(residual, part)
        on_map = observations.panel_pixels(residual) if part == DISPLAY else seen
        counted = (np.where(used[:, None], each, np.nan) for each in (seen, on_map))
        shown.append(BenchResiduals(name, *counted))
    sigma_px = float(np.sqrt(np.mean(observations.sigma_of(part) ** 2)))
    motion = [observations.arcminutes(each, part) for each in np.moveaxis(usual_motion, 2, 0)]
    return PartView(
        PART_NAMES[part],
        tuple(shown),
        sigma_px / float(np.mean(observations.nominal.camera.focal_px) * ARCMIN),
        np.stack(motion, axis=-1),
        observations.group[rows],
        place,
        "panel px" if part == DISPLAY else "arcmin",
        ("panel u (px)", "panel v (px)") if part == DISPLAY else ("right (deg)", "down (deg)"),
        maps,
        tuple(variable for variable in variables if np.ptp(variable.values) > 1e-9),
    )


_View = tuple[FloatArray, tuple[FieldMap, ...], tuple[Variable, ...]]
"""Place in the field of view (m, 2), right and down, of each reading of a part; its maps and variables."""


def _display(observations: Observations, used: BoolArray) -> _View:
    plan, pixel = observations.session.plan.display, observations.session.readings.panel_pixel
    assert plan is not None
    assert pixel is not None
    from_middle = pixel - 0.5 * observations.nominal.optics.panel.pixels.size_px
    outwards = _unit(np.einsum("nij,nj->ni", observations.camera_from_panel, from_middle))
    variables = (
        *_times_and_stage(observations, plan),
        Variable("colour (0 red, 1 green, 2 blue)", plan.channel.astype(np.float64), outwards),
        Variable("radius on panel (px)", np.linalg.norm(from_middle, axis=1), outwards),
        _camera_radius(observations, plan.camera_pixel),
    )
    return pixel, _display_maps(plan, used, observations.nominal.stage.origin), variables


def _see_through(observations: Observations, used: BoolArray) -> _View:
    plan, pixel = observations.session.plan.see_through, observations.session.readings.dot_pixel
    assert plan is not None
    assert pixel is not None
    distance, radius = observations.target_distance(), _camera_radius(observations, pixel)
    variables = (
        *_times_and_stage(observations, plan),
        Variable("distance of the target (m)", distance),
        Variable("distance of the target (m)", distance, radius.outwards),
        Variable("radius on target (mm)", 1e3 * np.linalg.norm(plan.dot, axis=1)),
        radius,
    )
    camera = observations.nominal.camera
    place = np.degrees(np.arctan((pixel - camera.centre_px) / camera.focal_px))
    return place, _see_through_maps(plan, used, observations.nominal.stage.origin, distance), variables


def _run_time(observations: Observations, used: BoolArray) -> _View:
    plan, seen = observations.session.plan.run_time, observations.session.readings.run_time_pixel
    assert plan is not None
    assert seen is not None
    real_deg = np.degrees(np.arctan(tangents_of_dir(observations.nominal.camera.view_dir_of_pixel(seen[:, 2:]))))
    head = plan.world_from_device[:, :3, 3]
    rate = np.degrees(np.einsum("nji,nj->ni", plan.world_from_device[:, :3, :3], plan.head_rate))
    gaze = np.degrees(np.arctan(tangents_of_dir(plan.gaze)))
    variables = (
        Variable("time (s)", plan.time_s),
        Variable("distance of the dot (m)", np.linalg.norm(plan.dot - head, axis=1)),
        Variable("head turns up (deg/s)", rate[:, 0]),
        Variable("head turns left (deg/s)", rate[:, 1]),
        Variable("gaze right (deg)", gaze[:, 0]),
        Variable("gaze up (deg)", gaze[:, 1]),
        Variable("dot down in the field (deg)", -real_deg[:, 1]),
    )
    numbers = _some(np.unique(plan.capture[used]))
    maps = tuple(FieldMap(f"recording {number}", used & (plan.capture == number)) for number in numbers)
    return real_deg * [1.0, -1.0], maps, variables


def _times_and_stage(observations: Observations, plan: DisplayPlan | SeeThroughPlan) -> list[Variable]:
    from_origin = 1e3 * (plan.stage - observations.nominal.stage.origin)
    named = zip(("right", "up", "back"), "xyz", from_origin.T, strict=True)
    return [
        Variable("time (s)", plan.time_s),
        *(Variable(f"stage {axis}, {way} (mm)", values) for way, axis, values in named),
    ]


def _camera_radius(observations: Observations, pixel: FloatArray) -> Variable:
    from_centre = pixel - observations.nominal.camera.centre_px
    return Variable("radius on camera (px)", np.linalg.norm(from_centre, axis=1), _unit(from_centre))


def _unit(vectors: FloatArray) -> FloatArray:
    return np.asarray(vectors / np.linalg.norm(vectors, axis=1, keepdims=True).clip(1e-12))


def _display_maps(plan: DisplayPlan, used: BoolArray, origin: FloatArray) -> tuple[FieldMap, ...]:
    """Return maps of the capture in the middle of all, then each time of the one farthest from those chosen.

    Args:
        plan: of the display.
        used: (m,) readings that count.
        origin: (3,) zero of the stage positions in titles, metres, device frame.
    """
    numbers, first = np.unique(plan.capture[used], return_index=True)
    stage = plan.stage[used][first]
    chosen = [int(np.argmin(np.linalg.norm(stage - stage.mean(axis=0), axis=1)))]
    while len(chosen) < min(_MOST, len(numbers)):
        chosen.append(_farthest(stage, stage[chosen]))
    return tuple(
        FieldMap(f"capture {numbers[k]} {_place(stage[k] - origin)}", used & (plan.capture == numbers[k]))
        for k in chosen
    )


def _see_through_maps(
    plan: SeeThroughPlan, used: BoolArray, origin: FloatArray, distance: FloatArray
) -> tuple[FieldMap, ...]:
    """Return a map of one capture for each target pose, near to far, each far from those of the other poses.

    Args:
        plan: of see-through.
        used: (m,) readings that count.
        origin: (3,) zero of the stage positions in titles, metres, device frame.
        distance: (m,) of the target, metres.
    """
    poses, first = np.unique(plan.target_pose[used], return_index=True)
    maps, places = [], [plan.stage[used].mean(axis=0)]
    for pose in _some(poses[np.argsort(distance[used][first])]):
        rows = np.flatnonzero(used & (plan.target_pose == pose))
        row = rows[_farthest(plan.stage[rows], np.array(places))]
        places.append(plan.stage[row])
        title = (
            f"target pose {pose} at {distance[row]:.2f} m, capture {plan.capture[row]} {_place(places[-1] - origin)}"
        )
        maps.append(FieldMap(title, used & (plan.target_pose == pose) & (plan.capture == plan.capture[row])))
    return tuple(maps)


def _farthest(places: FloatArray, chosen: FloatArray) -> int:
    """Return the index of the place (k, 3) whose nearest one among those chosen (c, 3) is farthest away."""
    return int(np.argmax(np.linalg.norm(places[:, None] - chosen, axis=-1).min(axis=1)))


def _place(from_origin: FloatArray) -> str:
    x, y, z = 1e3 * from_origin
    return f"at ({x:+.1f}, {y:+.1f}, {z:+.1f}) mm"


def _some(numbers: IntArray) -> IntArray:
    """Return as many numbers as maps are drawn, evenly spaced."""
    return np.asarray(numbers[np.linspace(0, len(numbers) - 1, min(_MOST, len(numbers))).round().astype(int)])
