"""Residuals of each part of a session: over the field of view, and against each variable.

Angles are those that the camera sees, in arcminutes to the right and down.
"""

from dataclasses import dataclass

import numpy as np

from wlr_render.captures.session import DisplayPlan, RunTimePlan, SeeThroughPlan
from wlr_render.diagnosis.diagnosis import Diagnosis
from wlr_render.diagnosis.observations import DISPLAY, PART_NAMES, RUN_TIME, SEE_THROUGH, Observations
from wlr_render.geometry.directions import ARCMIN, tangents_of_dir
from wlr_render.numerics.arrays import BoolArray, FloatArray, IntArray

_MOST = 8  # captures of which a map is drawn


@dataclass(frozen=True, eq=False)
class Variable:
    """Something that a residual may depend on.

    Attributes:
        name: with its unit.
        values: (m,) one for each reading.
        outwards: (m, 2) unit direction of its first component as the camera sees it; None for right and down.
    """

    name: str
    values: FloatArray
    outwards: FloatArray | None = None


@dataclass(frozen=True, eq=False)
class FieldMap:
    """Which readings one map of the field shows.

    Attributes:
        title: of the map.
        rows: (m,) mask, of readings that count.
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
        map_unit: of what the maps show.
        place_label: their axes.
        maps: which to draw.
        variables: that differ between readings.
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
    """Every part that has readings that count."""
    makers = {DISPLAY: _display, SEE_THROUGH: _see_through, RUN_TIME: _run_time}
    return [makers[int(part)](diagnosis) for part in np.unique(diagnosis.observations.part[diagnosis.used])]


def _display(diagnosis: Diagnosis) -> PartView:
    observations = diagnosis.observations
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
    used = diagnosis.used[observations.part == DISPLAY]
    maps = _display_maps(plan, used, observations.nominal.stage.origin)
    states = tuple(
        BenchResiduals(
            name,
            _seen(diagnosis, DISPLAY, residual),
            _where(used, observations.panel_pixels(residual)),
        )
        for name, residual in _residuals(diagnosis)
    )
    sigma, labels = _sigma_arcmin(observations, DISPLAY), ("panel u (px)", "panel v (px)")
    return PartView(
        PART_NAMES[DISPLAY],
        states,
        sigma,
        *_motion(diagnosis, DISPLAY),
        pixel,
        "panel px",
        labels,
        maps,
        _varying(variables),
    )


def _see_through(diagnosis: Diagnosis) -> PartView:
    observations = diagnosis.observations
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
    used = diagnosis.used[observations.part == SEE_THROUGH]
    maps = _see_through_maps(plan, used, observations.nominal.stage.origin, distance)
    return _angular_part(diagnosis, SEE_THROUGH, place, maps, variables)


def _run_time(diagnosis: Diagnosis) -> PartView:
    observations = diagnosis.observations
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
    place = real_deg * [1.0, -1.0]
    used = diagnosis.used[observations.part == RUN_TIME]
    maps = _run_time_maps(plan, used)
    return _angular_part(diagnosis, RUN_TIME, place, maps, variables)


def _angular_part(
    diagnosis: Diagnosis, part: int, place: FloatArray, maps: tuple[FieldMap, ...], variables: tuple[Variable, ...]
) -> PartView:
    """Return the view of a part whose maps show angles at angles."""
    seen = [(name, _seen(diagnosis, part, residual)) for name, residual in _residuals(diagnosis)]
    states = tuple(BenchResiduals(name, residual, residual) for name, residual in seen)
    sigma, labels = _sigma_arcmin(diagnosis.observations, part), ("right (deg)", "down (deg)")
    motion = _motion(diagnosis, part)
    return PartView(PART_NAMES[part], states, sigma, *motion, place, "arcmin", labels, maps, _varying(variables))


def _motion(diagnosis: Diagnosis, part: int) -> tuple[FloatArray, IntArray]:
    """Usual motion of each reading's capture (m, 2, 6) in arcminutes, and the capture's number (m,)."""
    observations = diagnosis.observations
    motion = [observations.arcminutes(each, part) for each in np.moveaxis(diagnosis.usual_motion, 2, 0)]
    return np.stack(motion, axis=-1), observations.group[observations.part == part]


def _residuals(diagnosis: Diagnosis) -> list[tuple[str, FloatArray]]:
    """Residuals (n, 2) of all parts by each bench that there is."""
    before = ("bench as described", diagnosis.residual_before)
    return [before, ("corrected bench", diagnosis.residual_after)] if diagnosis.is_corrected else [before]


def _seen(diagnosis: Diagnosis, part: int, residual: FloatArray) -> FloatArray:
    """Residual (m, 2) of one part, arcminutes right and down; NaN where a reading does not count."""
    observations = diagnosis.observations
    used = diagnosis.used[observations.part == part]
    return _where(used, observations.arcminutes(residual, part))


def _where(used: BoolArray, residual: FloatArray) -> FloatArray:
    """NaN where a reading does not count."""
    return np.where(used[:, None], residual, np.nan)


def _sigma_arcmin(observations: Observations, part: int) -> float:
    sigma_px = float(np.sqrt(np.mean(observations.sigma_of(part) ** 2)))
    return sigma_px / float(np.mean(observations.nominal.camera.focal_px) * ARCMIN)


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


def _varying(variables: tuple[Variable, ...]) -> tuple[Variable, ...]:
    return tuple(variable for variable in variables if np.ptp(variable.values) > 1e-9)


def _unit(vectors: FloatArray) -> FloatArray:
    return np.asarray(vectors / np.linalg.norm(vectors, axis=1, keepdims=True).clip(1e-12))


def _display_maps(plan: DisplayPlan, used: BoolArray, origin: FloatArray) -> tuple[FieldMap, ...]:
    """Return maps of the capture in the middle of all, then each time of the one farthest from those chosen.

    Args:
        plan: of the display.
        used: (m,) readings that count.
        origin: (3,) from which titles measure the stage.
    """
    numbers, first = np.unique(plan.capture[used], return_index=True)
    stage = plan.stage[used][first]
    chosen = [int(np.argmin(np.linalg.norm(stage - stage.mean(axis=0), axis=1)))]
    while len(chosen) < min(_MOST, len(numbers)):
        chosen.append(_farthest(stage, stage[chosen]))
    return tuple(
        FieldMap(f"capture {numbers[k]}\n{_place(stage[k] - origin)}", used & (plan.capture == numbers[k]))
        for k in chosen
    )


def _see_through_maps(
    plan: SeeThroughPlan, used: BoolArray, origin: FloatArray, distance: FloatArray
) -> tuple[FieldMap, ...]:
    """One capture for each target pose, near to far, each far from those of the other poses.

    Args:
        plan: of see-through.
        used: (m,) readings that count.
        origin: (3,) from which titles measure the stage.
        distance: (m,) of the target, metres.
    """
    poses, first = np.unique(plan.target_pose[used], return_index=True)
    maps, places = [], [plan.stage[used].mean(axis=0)]
    for pose in _some(poses[np.argsort(distance[used][first])]):
        rows = np.flatnonzero(used & (plan.target_pose == pose))
        row = rows[_farthest(plan.stage[rows], np.array(places))]
        places.append(plan.stage[row])
        title = (
            f"target pose {pose} at {distance[row]:.2f} m\ncapture {plan.capture[row]} {_place(places[-1] - origin)}"
        )
        maps.append(FieldMap(title, used & (plan.target_pose == pose) & (plan.capture == plan.capture[row])))
    return tuple(maps)


def _run_time_maps(plan: RunTimePlan, used: BoolArray) -> tuple[FieldMap, ...]:
    """Return maps of some recordings, from the first to the last."""
    return tuple(FieldMap(f"recording {n}", used & (plan.capture == n)) for n in _some(np.unique(plan.capture[used])))


def _farthest(places: FloatArray, chosen: FloatArray) -> int:
    """Index of the place (k, 3) whose nearest one among those chosen (c, 3) is farthest away."""
    return int(np.argmax(np.linalg.norm(places[:, None] - chosen, axis=-1).min(axis=1)))


def _place(from_origin: FloatArray) -> str:
    x, y, z = 1e3 * from_origin
    return f"at ({x:+.1f}, {y:+.1f}, {z:+.1f}) mm"


def _some(numbers: IntArray) -> IntArray:
    """As many as are drawn, evenly spaced."""
    return np.asarray(numbers[np.linspace(0, len(numbers) - 1, min(_MOST, len(numbers))).round().astype(int)])
