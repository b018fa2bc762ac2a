"""Plan of a simulated session: commanded and true poses of the cameras, and session.toml."""

from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from wlr_render.captures.boards.board import BoardNotFoundError
from wlr_render.captures.boards.dot_board import identify
from wlr_render.captures.boards.dot_lattice import LEAST_AREA_PX
from wlr_render.captures.decoded import DecodeOptions
from wlr_render.captures.patterns.pattern import Pattern
from wlr_render.captures.photo_session import (
    BoardPhotograph,
    CodeSet,
    PhotoSession,
    SessionCamera,
    SessionPanel,
    StageAxis,
    StageDescription,
)
from wlr_render.captures.photo_session_entries import with_places
from wlr_render.captures.photograph_format import PhotographFormat
from wlr_render.geometry import transforms
from wlr_render.lenses.lens_camera import LensCamera
from wlr_render.numerics.arrays import FloatArray
from wlr_render.simulation.photographs.camera import Sensor, SimulatedLens
from wlr_render.simulation.photographs.photo_bench import PhotoBench, stage_readings

_TILTS_DEG = ((0, 0), (28, 0), (-28, 0), (0, 28), (0, -28), (20, 20), (-20, 20), (20, -20), (-20, -20))
_GROUND_PX = 4.0  # width of the background around a measured dot
_FILL = (0.75, 1.1)  # alternating sizes of the board in the picture, as shares of the picture's size
_PLACES, _TURNS, _READINGS, _CREEP, _STATED = 17, 18, 19, 20, 22  # streams of random numbers
_CREEP_TIME = 0.3  # time constant of the creep, as a share of the session
_VISIT_S = 30.0  # time from one visit to the next
READING_DIGITS = 8  # decimals of a reading in metres, for an encoder of 10 nm


@dataclass(frozen=True, eq=False)
class PhotoPlan:
    """Commanded positions of the photographs of a session.

    Attributes:
        sweep: (m, 3) stage readings for the panel, and for the target through the optics.
        bare: (n, 3) stage readings for the target without the headset, along all axes.
        bare_poses: target poses that are photographed without the headset: the first before the headset is mounted, the
            last after it is removed, so that a target that moved in between is noticed.
        eyeball_boards, tracking_boards: (k, 4, 4) camera_from_board, for the intrinsics of each camera.
    """

    sweep: FloatArray
    bare: FloatArray
    bare_poses: tuple[int, ...]
    eyeball_boards: FloatArray
    tracking_boards: FloatArray


def plan_photographs(bench: PhotoBench, viewpoints: int) -> PhotoPlan:
    """Plan all photographs of a session with `viewpoints` camera positions."""
    axes = len(bench.options.stage)
    sweep = stage_readings(bench, viewpoints)
    sweep[:, axes:] = 0.0
    steps = bare_steps(axes, bench.options.sampling == "volumetric" or bool(np.any(sweep[:, 2])))
    if bench.options.stated_axes_deg:
        steps = np.zeros((1, 3))
    reach = [*np.abs(sweep[:, :2]).max(axis=0), 0.5 * bench.optics.eye_box.size[2]]
    poses = len(bench.device_from_target)
    return PhotoPlan(
        sweep,
        np.round(steps * reach, 4),
        tuple(dict.fromkeys((0, poses - 1))),
        _boards_before(bench.eyeball.camera, bench.board.size_m),
        _boards_before(bench.tracking.camera, bench.board.size_m),
    )


def unreadable_targets(bench: PhotoBench) -> list[str]:
    """Return warnings about target poses whose photographs show too few whole dots or too small dots."""
    warnings = []
    for number, target in enumerate(bench.device_from_target):
        for name, lens, camera in (
            ("eyeball", bench.eyeball.camera, bench.device_from_camera),
            ("tracking", bench.tracking.camera, bench.device_from_tracking),
        ):
            in_camera = transforms.apply(transforms.inverse(camera) @ target, bench.printed.points)
            pixel, index = lens.pixel_of_point(in_camera), bench.board.indices()
            radius = 0.5 * bench.board.diameter_of(index) * lens.focal_px[0] / in_camera[:, 2]
            edge = radius[:, None] + _GROUND_PX
            whole = np.all((pixel > edge) & (pixel < np.array(lens.size_px) - edge), axis=1)
            size = f"the {name} camera's pictures of {lens.size_px[0]} x {lens.size_px[1]} pixels are too small"
            try:
                identify(index[whole], bench.board.large[index[whole, 1], index[whole, 0]], bench.board.large)
            except BoardNotFoundError as error:
                warnings.append(f"Target pose {number}: {size} to identify the board: {error}")
            if np.any(np.pi * radius[whole] ** 2 < LEAST_AREA_PX):
                warnings.append(
                    f"Target pose {number}: {size}: dots of {2 * radius[whole].min():.2g} pixels are not found."
                )
    return warnings


def bare_steps(axes: int, in_depth: bool) -> FloatArray:
    """Return the stage positions (n, 3) of photographs without the headset, between -1 and 1 along each axis.

    Args:
        axes: number of axes of the stage.
        in_depth: True if the sweep travels along z too.
    """
    steps = np.stack(np.meshgrid(*[[-1.0, 0.0, 1.0]] * 2, [0.0]), axis=-1).reshape(-1, 3)
    # With three levels per axis, a cubic error of the stage looks linear; five levels distinguish them.
    between = [[-0.5, 0.0, 0.0], [0.5, 0.0, 0.0], [0.0, -0.5, 0.0], [0.0, 0.5, 0.0]]
    if in_depth:
        between += [[0.0, 0.0, -0.5], [0.0, 0.0, 0.5]]
    steps = np.concatenate([steps, [[0.0, 0.0, -1.0], [0.0, 0.0, 1.0]], between])
    return np.asarray(steps[~np.any(steps[:, axes:], axis=1)])


def _boards_before(camera: LensCamera, board_m: FloatArray) -> FloatArray:
    """Return camera_from_board (k, 4, 4) of boards that fill the picture, tilted in all directions and off centre."""
    poses = []
    for number, tilt in enumerate(_TILTS_DEG):
        for fill, side in zip(_FILL, (1, -1), strict=True):
            depth = float(np.max(board_m / np.array(camera.size_px) * camera.focal_px)) / fill
            shift = 0.12 * side * depth * np.array(camera.size_px) / camera.focal_px
            turn = transforms.rotations_of_vectors(np.deg2rad([*tilt, 90.0 * (number % 4) + 11.0 * side]))
            poses.append(transforms.rigid(turn, np.array([shift[0], shift[1] * (-1) ** number, depth])))
    return np.stack(poses)


@dataclass(frozen=True, eq=False)
class Visit:
    """A stay of the camera at one position, from arrival to departure.

    Attributes:
        reading: (m,) readings of the stage's encoders, metres.
        device_from_camera: (4, 4) true pose of the eyeball camera.
        time_s: seconds since the first visit, for a camera that warms up; None if unknown.
    """

    reading: FloatArray
    device_from_camera: FloatArray
    time_s: float | None = None


@dataclass(frozen=True, eq=False)
class SessionVisits:
    """The visits of a session, in the order of the lists of its session.toml.

    Attributes:
        bare: visit of each photograph of the target without the headset.
        see_through: visit of each photograph of the target through the optics.
        display: visit of each panel set; the same visits as for photographs of the first target pose.
    """

    bare: tuple[Visit, ...]
    see_through: tuple[Visit, ...]
    display: tuple[Visit, ...]


def true_camera_poses(bench: PhotoBench, plan: PhotoPlan) -> SessionVisits:
    """Return the visits of a session, with random errors from the bench's seed.

    The stage travels through the bare positions of the first target pose, the sweep of each target pose with a return
    to the first position, and the bare positions of the other bare target pose. It creeps in this order.
    """
    axes = len(bench.options.stage)
    sweep = np.concatenate([plan.sweep, plan.sweep[:1]])
    poses, places, bare = len(bench.device_from_target), len(plan.sweep), len(plan.bare)
    commanded = np.concatenate([np.tile(plan.bare, (len(plan.bare_poses), 1)), np.tile(sweep, (poses, 1))])
    bare_count = bare * len(plan.bare_poses)
    taken = np.concatenate([np.arange(bare), np.arange(bare, bare_count) + poses * len(sweep)])
    taken = np.concatenate([taken, bare + np.arange(poses * len(sweep))])
    # This order keeps the random numbers of existing simulated sessions.
    drawn = np.concatenate([bare_count + np.arange(places), np.arange(bare_count)])
    drawn = np.concatenate([drawn, np.arange(bare_count + places, len(commanded))])

    sizes, seed, left = bench.options.imperfections, bench.options.seed, int(bench.eye == "left")
    place, turn, reading = (np.random.default_rng([seed, stream, left]) for stream in (_PLACES, _TURNS, _READINGS))
    position = commanded.copy()
    position[drawn] += place.normal(0.0, 1e-6 * sizes.repeatability_um, commanded.shape)
    turns = turn.normal(0.0, 1e-6 * sizes.turn_jitter_urad, commanded.shape)
    error = np.concatenate([turns, np.outer(_creep(taken), whole_creep(bench))], axis=1)
    error += bench.workshop_motion(commanded, taken / max(1, len(taken) - 1))
    stated = commanded + np.round(reading.normal(0.0, 1e-6 * sizes.readback_um, commanded.shape), READING_DIGITS)
    times = [None] * len(taken) if bench.workshop is None else [_VISIT_S * float(number) for number in taken]
    visits = tuple(
        Visit(row[:axes], bench.camera_at(at, off), time_s=time_s)
        for row, at, off, time_s in zip(stated, position, error, times, strict=True)
    )
    through = visits[bare_count:]
    return SessionVisits(visits[:bare_count], through, through[:places])


def whole_creep(bench: PhotoBench) -> FloatArray:
    """Return the thermal displacement (3,) of the stage, metres, from the first photograph to the last."""
    direction = np.random.default_rng([bench.options.seed, _CREEP, int(bench.eye == "left")]).standard_normal(3)
    return np.asarray(1e-6 * bench.options.imperfections.creep_um * direction / np.linalg.norm(direction))


def _creep(taken: FloatArray) -> FloatArray:
    """Return the fraction (n,) of the whole creep at photographs number `taken` (n,)."""
    part = 1.0 - np.exp(-taken / (_CREEP_TIME * max(1, len(taken) - 1)))
    return np.asarray(part / (1.0 - np.exp(-1.0 / _CREEP_TIME)))


def planned_session(
    root: Path, bench: PhotoBench, plan: PhotoPlan, visits: SessionVisits, pattern: Pattern
) -> PhotoSession:
    """Return the session of these visits, with photographs in the folder `root` and without true values."""
    poses = range(len(bench.device_from_target))
    eyeball = _camera(root / "intrinsics" / "eyeball", bench.eyeball, bench.eyeball_sensor, len(plan.eyeball_boards))
    tracking = _camera(
        root / "intrinsics" / "tracking", bench.tracking, bench.tracking_sensor, len(plan.tracking_boards)
    )
    bare = [f"bare/pose{pose}_{n:02d}.png" for pose in plan.bare_poses for n in range(len(plan.bare))]
    # Each sweep ends at its first reading again, to reveal any motion in between.
    sweep = len(visits.see_through) // len(poses)
    through = [
        (pose, f"pose{pose}_{n:02d}.png", visits.see_through[pose * sweep + n]) for pose in poses for n in range(sweep)
    ]
    sizes = bench.options.imperfections
    sigma = (float(np.radians(sizes.extrinsics_deg)), 1e-3 * sizes.extrinsics_mm)

    def stated(visit: Visit) -> dict[str, Any]:
        return {"stage": visit.reading, "eye": bench.eye, "time_s": visit.time_s}

    session = PhotoSession(
        folder=root,
        device=bench.device.name,
        eyes=(bench.eye,),
        eye_boxes={bench.eye: bench.optics.eye_box},
        panels={bench.eye: SessionPanel(pattern)},
        decoding=DecodeOptions(full_scale=eyeball.format.full_scale),
        board=bench.board,
        eyeball_camera=eyeball,
        tracking_camera=tracking,
        device_from_tracking=bench.stated_device_from_tracking,
        tracking_sigma=sigma if all(sigma) else None,
        stage=_described_stage(bench),
        bare=tuple(
            BoardPhotograph(root, name, plan.bare_poses[number // len(plan.bare)], **stated(visit))
            for number, (name, visit) in enumerate(zip(bare, visits.bare, strict=True))
        ),
        tracking=tuple(
            BoardPhotograph(root, f"tracking/pose{pose}_{when}.png", pose)
            for pose in poses
            for when in ("before", "after")
        ),
        see_through=tuple(
            BoardPhotograph(root, f"see_through/{name}", pose, **stated(visit)) for pose, name, visit in through
        ),
        display=tuple(
            CodeSet(root / "display" / f"{number:02d}", **stated(visit)) for number, visit in enumerate(visits.display)
        ),
    )
    return with_places(session)


def _described_stage(bench: PhotoBench) -> StageDescription:
    """Return the stage of session.toml: axes at right angles, all rotated by one random error."""
    options, axes = bench.options, len(bench.options.stage)
    if not options.stated_axes_deg:
        return StageDescription((StageAxis(),) * axes)
    rng = np.random.default_rng([options.seed, _STATED, int(bench.eye == "left")])
    sigma = float(np.radians(options.stated_axes_deg))
    error = transforms.rotations_of_vectors(sigma * rng.standard_normal(3))
    true = bench.device_from_camera[:3, :3].T @ bench.stage_axes
    left, _, right = np.linalg.svd(true)  # nearest rotation, because a lab does not state the skew of a stage
    stated = error @ left @ right
    return StageDescription(tuple(StageAxis("linear", each, sigma, is_in_camera=True) for each in stated.T[:axes]))


def _camera(folder: Path, lens: SimulatedLens, sensor: Sensor, count: int) -> SessionCamera:
    paths = tuple(folder / f"{number:02d}.png" for number in range(count))
    return SessionCamera(lens.camera.size_px, PhotographFormat(sensor.bits), paths)
