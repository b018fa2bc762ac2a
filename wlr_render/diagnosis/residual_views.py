"""Residuals of each part of a session: over the field of view, and against each variable."""

from collections.abc import Iterable, Mapping
from dataclasses import dataclass

import numpy as np

from wlr_render.captures.session import StagePlan
from wlr_render.diagnosis.diagnosis import DiagnosisRecord
from wlr_render.diagnosis.observations import DISPLAY, PART_NAMES, PART_UNITS, Observations
from wlr_render.geometry.directions import ARCMIN, tangents_of_dir
from wlr_render.numerics.arrays import BoolArray, FloatArray, IntArray

_MOST = 8  # largest number of maps of a part


@dataclass(frozen=True, eq=False)
class Variable:
    """A variable that a residual may depend on.

    Attributes:
        name: name with unit.
        values: (m,) value at each reading.
        outwards: (m, 2) unit direction of the residual's first component in the image; None for right and down.
    """

    name: str
    values: FloatArray
    outwards: FloatArray | None = None


@dataclass(frozen=True, eq=False)
class PartView:
    """One part of a session.

    Attributes:
        name: name of the part.
        seen: (m, 2) residual in arcminutes, right and down in the camera's image, by name of the bench: as described
            and, if corrected, corrected. NaN where a reading is not used or not predicted.
        on_map: (m, 2) the same in the unit of the maps.
        sigma_arcmin: noise per axis.
        motion: (m, 2, 6) change of the readings, right and down in arcminutes, by the usual motion of their capture.
        group: (m,) capture number of each reading.
        place: (m, 2) place of each reading in the field, right and down.
        map_unit: unit of the arrows of the maps.
        place_label: titles of the maps' axes.
        maps: (m,) mask of the readings of each map to draw, by its title.
        variables: variables that differ between readings.
    """

    name: str
    seen: Mapping[str, FloatArray]
    on_map: Mapping[str, FloatArray]
    sigma_arcmin: float
    motion: FloatArray
    group: IntArray
    place: FloatArray
    map_unit: str
    place_label: tuple[str, str]
    maps: Mapping[str, BoolArray]
    variables: tuple[Variable, ...]


def part_views(diagnosis: DiagnosisRecord) -> list[PartView]:
    """Return a view of every part with used readings."""
    benches = {"bench as described": diagnosis.residual_before}
    if diagnosis.is_corrected:
        benches["corrected bench"] = diagnosis.residual_after
    observations, used = diagnosis.observations, diagnosis.used
    parts = np.unique(observations.part[used])
    return [part_view(observations, int(part), used, benches, diagnosis.usual_motion) for part in parts]


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
        part: index of the part.
        used: (n,) mask of the readings to use.
        states: (n, 2) residuals, or changes of readings, in units of sigma, by name.
        usual_motion: (n, 2, q) change of the readings by the usual motion of their capture, in units of sigma.
    """
    rows = observations.part == part
    counted = {name: np.where(used[:, None], residual, np.nan) for name, residual in states.items()}
    used = used[rows]
    place, maps, variables = (_display, _see_through, _run_time)[part](observations, used)
    sigma_px = float(np.sqrt(np.mean(observations.sigma_of(part) ** 2)))
    motion = [observations.arcminutes(each, part) for each in np.moveaxis(usual_motion, 2, 0)]
    return PartView(
        PART_NAMES[part],
        {name: observations.arcminutes(each, part) for name, each in counted.items()},
        {name: observations.in_unit_of(part, each) for name, each in counted.items()},
        sigma_px / float(np.mean(observations.nominal.camera.focal_px) * ARCMIN),
        np.stack(motion, axis=-1),
        observations.group[rows],
        place,
        PART_UNITS[part],
        ("panel u (px)", "panel v (px)") if part == DISPLAY else ("right (deg)", "down (deg)"),
        maps,
        tuple(variable for variable in variables if np.ptp(variable.values) > 1e-9),
    )


_View = tuple[FloatArray, dict[str, BoolArray], list[Variable]]
"""Place (m, 2) in the field of view, right and down, of each reading of a part; maps of the part; its variables."""


def _display(observations: Observations, used: BoolArray) -> _View:
    plan, pixel = observations.session.plan.display, observations.session.readings.panel_pixel
    assert plan is not None
    assert pixel is not None
    from_middle = pixel - 0.5 * observations.nominal.optics.panel.pixels.size_px
    outwards = _unit(np.einsum("nij,nj->ni", observations.camera_from_panel, from_middle))
    variables = [
        *_times_and_stage(observations, plan),
        Variable("colour (0 red, 1 green, 2 blue)", plan.channel.astype(np.float64), outwards),
        Variable("radius on panel (px)", np.linalg.norm(from_middle, axis=1), outwards),
        _camera_radius(observations, plan.camera_pixel),
    ]
    # The capture in the middle of all, then repeatedly the one farthest from the chosen captures.
    captures = np.flatnonzero(used)[np.unique(plan.capture[used], return_index=True)[1]]
    stage = plan.stage[captures]
    middle = captures[np.argmin(np.linalg.norm(stage - stage.mean(axis=0), axis=1))]
    others = _far_apart(plan.stage, [captures] * (min(_MOST, len(captures)) - 1), plan.stage[middle])
    maps = {_title(observations, plan, row): used & (plan.capture == plan.capture[row]) for row in (middle, *others)}
    return pixel, maps, variables


def _see_through(observations: Observations, used: BoolArray) -> _View:
    plan, pixel = observations.session.plan.see_through, observations.session.readings.dot_pixel
    assert plan is not None
    assert pixel is not None
    distance, radius = observations.target_distance(), _camera_radius(observations, pixel)
    variables = [
        *_times_and_stage(observations, plan),
        Variable("distance of the target (m)", distance),
        Variable("distance of the target (m)", distance, radius.outwards),
        Variable("radius on target (mm)", 1e3 * np.linalg.norm(plan.dot, axis=1)),
        radius,
    ]
    camera = observations.nominal.camera
    place = np.degrees(np.arctan((pixel - camera.centre_px) / camera.focal_px))
    # One capture for each target pose, near to far, each far from the captures of the other poses.
    poses, first = np.unique(plan.target_pose[used], return_index=True)
    of_pose = [
        np.flatnonzero(used & (plan.target_pose == pose)) for pose in _some(poses[np.argsort(distance[used][first])])
    ]
    maps = {
        f"target pose {plan.target_pose[row]} at {distance[row]:.2f} m, {_title(observations, plan, row)}": (
            used & (plan.target_pose == plan.target_pose[row]) & (plan.capture == plan.capture[row])
        )
        for row in _far_apart(plan.stage, of_pose, plan.stage[used].mean(axis=0))
    }
    return place, maps, variables


def _run_time(observations: Observations, used: BoolArray) -> _View:
    plan, seen = observations.session.plan.run_time, observations.session.readings.run_time_pixel
    assert plan is not None
    assert seen is not None
    real_deg = np.degrees(np.arctan(tangents_of_dir(observations.nominal.camera.view_dir_of_pixel(seen[:, 2:]))))
    head = plan.world_from_device[:, :3, 3]
    rate = np.degrees(np.einsum("nji,nj->ni", plan.world_from_device[:, :3, :3], plan.head_rate))
    gaze = np.degrees(np.arctan(tangents_of_dir(plan.gaze)))
    variables = [
        Variable("time (s)", plan.time_s),
        Variable("distance of the dot (m)", np.linalg.norm(plan.dot - head, axis=1)),
        Variable("head turns up (deg/s)", rate[:, 0]),
        Variable("head turns left (deg/s)", rate[:, 1]),
        Variable("gaze right (deg)", gaze[:, 0]),
        Variable("gaze up (deg)", gaze[:, 1]),
        Variable("dot down in the field (deg)", -real_deg[:, 1]),
    ]
    numbers = _some(np.unique(plan.capture[used]))
    maps = {f"recording {number}": used & (plan.capture == number) for number in numbers}
    return real_deg * [1.0, -1.0], maps, variables


def _times_and_stage(observations: Observations, plan: StagePlan) -> list[Variable]:
    x, y, z = 1e3 * (plan.stage - observations.nominal.stage.origin).T
    return [
        Variable("time (s)", plan.time_s),
        Variable("stage x, right (mm)", x),
        Variable("stage y, up (mm)", y),
        Variable("stage z, back (mm)", z),
    ]


def _camera_radius(observations: Observations, pixel: FloatArray) -> Variable:
    from_centre = pixel - observations.nominal.camera.centre_px
    return Variable("radius on camera (px)", np.linalg.norm(from_centre, axis=1), _unit(from_centre))


def _unit(vectors: FloatArray) -> FloatArray:
    return np.asarray(vectors / np.linalg.norm(vectors, axis=1, keepdims=True).clip(1e-12))


def _title(observations: Observations, plan: StagePlan, row: int) -> str:
    """Return the name of a row's capture, and its place relative to the zero of the stage."""
    x, y, z = 1e3 * (plan.stage[row] - observations.nominal.stage.origin)
    return f"capture {plan.capture[row]} at ({x:+.1f}, {y:+.1f}, {z:+.1f}) mm"


def _far_apart(places: FloatArray, choices: Iterable[IntArray], start: FloatArray) -> list[int]:
    """Return one row of each choice of rows: the one farthest from `start` (3,) and from the rows chosen before."""
    rows, chosen = list[int](), [start]
    for choice in choices:
        nearest = np.linalg.norm(places[choice][:, None] - np.array(chosen), axis=-1).min(axis=1)
        rows.append(int(choice[np.argmax(nearest)]))
        chosen.append(places[rows[-1]])
    return rows


def _some(numbers: IntArray) -> IntArray:
    """Return at most `_MOST` of the numbers, evenly spaced."""
    return np.asarray(numbers[np.linspace(0, len(numbers) - 1, min(_MOST, len(numbers))).round().astype(int)])
