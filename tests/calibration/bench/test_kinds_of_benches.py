"""Every kind of bench is adjusted: errors of poses are as large as their sigmas, with a real bench's imperfections."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from calibration.bench.imperfect_bench import TrueBench, adjusted, thinned, turned

from wlr_render.calibration.bench.adjustment import Adjustment
from wlr_render.calibration.bench.board_views import (
    EYEBALL,
    TRACKING,
    BenchObservations,
    CameraPlace,
    CameraSetup,
    KnownPose,
)
from wlr_render.calibration.poses import motion_between, small_motion
from wlr_render.captures.boards.board import USUAL_TOLERANCES
from wlr_render.captures.photo_session import StageAxis
from wlr_render.errors import BadInputError
from wlr_render.geometry import transforms
from wlr_render.numerics.arrays import FloatArray

PIVOT = np.array([1e-3, -5e-4, -0.012])
"""Of a rotary axis, camera frame: the camera's mount is not quite centred on the pupil of the eye."""


def along(direction: FloatArray) -> Callable[..., Any]:
    return lambda reading: transforms.rigid(np.eye(3), reading * np.asarray(direction))


def about_y(reading: float) -> FloatArray:
    turn = transforms.rotation_about("y", reading)
    return transforms.rigid(turn, PIVOT - turn @ PIVOT)


def observed(
    bench: TrueBench,
    axes: tuple[StageAxis, ...],
    readings: FloatArray | Sequence[FloatArray] | range,
    sweep: FloatArray | Sequence[FloatArray],
    poses: Callable[..., Any],
    orientation: Callable[..., Any] = lambda number: 0,
    **known: Any,
) -> tuple[BenchObservations, dict[str, FloatArray]]:
    """Observations of a bench: lens photographs, targets at readings from camera poses, the tracking camera.

    Args:
        bench: the truth.
        axes: as session.toml states them.
        readings: of the photographs of each target; None without a stage. sweep: others whose poses are wanted.
        poses: reading, or number of the place without a stage -> (4, 4) true pose in the first mounting.
        orientation: number of a photograph -> its mounting.
        known: attributes of `BenchObservations`.
    """
    views = [*bench.lens_views(EYEBALL, 6), *bench.lens_views(TRACKING, 6, 0.6)]
    places, true = {}, {}

    def visit(name: str, reading: FloatArray | int, mounting: int) -> None:
        true[name] = poses(reading) @ MOUNTS[mounting]
        stated = None
        if len(axes):
            stated = np.asarray(reading) + bench.size.readback_m * bench.rng.normal(size=len(axes))
        places[name] = CameraPlace(stated, mounting)

    for target in bench.targets:
        for number, reading in enumerate(readings):
            name = f"bare/pose{target}_{number:02d}.png"
            visit(name, reading, orientation(number))
            seen = transforms.inverse(true[name]) @ bench.targets[target]
            views.append(bench.view(name, EYEBALL, seen, target, name))
    for number, reading in enumerate(sweep):
        visit(f"sweep{number:02d}", reading, orientation(number))
    for target in bench.targets:
        seen = transforms.inverse(bench.device_from_tracking) @ bench.targets[target]
        views.append(bench.view(f"tracking/pose{target}.png", TRACKING, seen, target))
    sigma = (bench.size.extrinsics_rad, bench.size.extrinsics_m)
    known = {"device_from_tracking": KnownPose(bench.stated_tracking, sigma)} | known
    setups = {name: CameraSetup(lens.size_px, lens.kind) for name, lens in bench.lens.items()}
    tolerances = {"board": USUAL_TOLERANCES}
    return thinned(BenchObservations(views, setups, places, axes, tolerances=tolerances, **known)), true


SAME = np.eye(4)


def eyeball_alone(seen: BenchObservations) -> BenchObservations:
    views = [view for view in seen.views if view.camera == EYEBALL]
    return replace(seen, views=views, cameras={EYEBALL: seen.cameras[EYEBALL]})


MOUNTS = {0: np.eye(4), 1: transforms.rigid(turned(3, -2, 90), np.array([0.001, 0.002, -0.001]))}


def over_sigma(found: Adjustment, true: Mapping[str, FloatArray], own: FloatArray) -> FloatArray:
    """(n, 6) errors of the poses of places, and of targets, over their sigmas; `own` is from the device frame."""
    poses = [(found.camera_pose(place), own @ pose) for place, pose in true.items()]
    return np.array([motion_between(p.b_from_a, t) / np.sqrt(np.diag(p.covariance)) for p, t in poses])


def assert_true(found: Adjustment, bench: TrueBench, true: Mapping[str, FloatArray], own: FloatArray = SAME) -> None:
    """Errors are as large as their sigmas; those of all places go together, so that few are independent."""
    places = over_sigma(found, true, own)
    targets = [
        motion_between(found.target_pose(k).b_from_a, own @ bench.targets[k])
        / np.sqrt(np.maximum(np.diag(found.target_pose(k).covariance), 1e-18))
        for k in bench.targets
    ]
    assert np.sqrt(np.mean(places**2)) < 1.8
    assert np.sqrt(np.mean(np.square(targets))) < 1.8
    assert np.abs(places).max() < 5.0


def grid(axes: int, sweep: bool = False) -> FloatArray:
    steps = np.array(np.meshgrid(*[[-1.0, 0.0, 1.0]] * axes)).reshape(axes, -1).T
    return (0.006 if sweep else 0.008) * (steps if axes < 3 else steps[np.abs(steps).sum(axis=1) < 3])


@pytest.mark.slow
@pytest.mark.parametrize("axes", [2, 1])
def test_stages_of_two_and_one_linear_axes(axes: int) -> None:
    """Of three: test_adjustment.py, and mountings below."""
    bench = TrueBench(3)
    motions = [along(column) for column in bench.axes.T[:axes]]
    seen, true = observed(
        bench, (StageAxis(),) * axes, grid(axes), grid(axes, True), lambda reading: bench.carried(motions, reading)
    )
    assert_true(adjusted(seen), bench, true)


@pytest.mark.slow
def test_stated_axes_are_used_where_no_photograph_shows_them_and_corrected_where_some_do() -> None:
    bench = TrueBench(4)
    direction = (bench.base[:3, :3] @ bench.axes / np.linalg.norm(bench.axes, axis=0)).T
    stated = [turned(*(0.3 * bench.rng.normal(size=3))) @ each for each in direction]
    axes = tuple(StageAxis("linear", each, np.radians(0.3)) for each in stated)
    motions = [along(column) for column in bench.axes.T]
    flat = np.concatenate([grid(2), np.zeros((9, 1))], axis=1)
    sweep = [np.zeros(3), np.array([0.004, -0.004, 0.0]), np.array([0.0, 0.0, 0.004]), np.array([0.002, 0.0, -0.004])]
    seen, true = observed(bench, axes, flat, sweep, lambda reading: bench.carried(motions, reading))
    found = adjusted(seen)
    assert_true(found, bench, true)
    # The photographs measure x and y; the third axis is known as well as it is stated.
    shifts = [np.sqrt(np.diag(found.covariance_of([("axis", k)]))[3]) for k in range(3)]
    assert max(shifts[:2]) < 0.3 * np.radians(0.3) < 0.4 * shifts[2]


@pytest.mark.slow
def test_a_rotary_axis_about_the_pupil_beside_a_linear_one() -> None:
    bench = TrueBench(5)
    turns = np.radians([-12.0, -5.0, 0.0, 6.0, 12.0])
    readings = [np.array([shift, turn]) for shift in (-0.006, 0.0, 0.006) for turn in turns]
    sweep = [np.array([shift, turn]) for shift in (-0.004, 0.003) for turn in np.radians([-9.0, 2.0, 10.0])]
    motions = [along(bench.axes[:, 0]), about_y]
    axes = (StageAxis(), StageAxis("rotary"))
    seen, true = observed(bench, axes, readings, sweep, lambda reading: bench.carried(motions, reading))
    found = adjusted(seen)
    assert_true(found, bench, true)
    turn, shift = found.state.twists[1, :3], found.state.twists[1, 3:]
    assert np.linalg.norm(turn - [0, 1, 0]) < 2e-3
    assert np.linalg.norm(shift - np.cross(PIVOT, [0, 1, 0])) < 2e-4


def test_a_rotary_axis_that_no_photograph_shows_turns_about_its_stated_pivot() -> None:
    bench = TrueBench(6)
    direction = bench.base[:3, :3] @ turned(0.3, 0, -0.2) @ [0.0, 1.0, 0.0]
    pivot = transforms.apply(bench.base, PIVOT + [4e-4, 0.0, -6e-4])
    axes = (StageAxis(), StageAxis("rotary", direction, np.radians(0.3), pivot))
    motions = [along(bench.axes[:, 0]), about_y]
    readings = [np.array([shift, 0.0]) for shift in np.linspace(-0.008, 0.008, 9)]
    sweep = [np.array([0.003, turn]) for turn in np.radians([-10.0, 3.0, 10.0])]
    seen, true = observed(bench, axes, readings, sweep, lambda reading: bench.carried(motions, reading))
    assert_true(adjusted(seen), bench, true)


def test_mountings_of_the_camera_share_one_stage() -> None:
    bench = TrueBench(7)
    motions = [along(column) for column in bench.axes.T]
    seen, true = observed(
        bench,
        (StageAxis(),) * 3,
        np.concatenate([grid(3), grid(3)[::3]]),
        np.concatenate([grid(3, True)[:4]] * 2),
        lambda reading: bench.carried(motions, reading),
        lambda number: int(number >= len(grid(3)) or number in (1, 3)),
    )
    found = adjusted(seen)
    assert_true(found, bench, true)
    mount = found.state.mount(1)
    assert np.abs(motion_between(MOUNTS[1], mount)).max() < 2e-4


def free_places(bench: TrueBench, count: int) -> Callable[..., Any]:
    rng = np.random.default_rng(2)
    poses = [bench.base @ small_motion(rng.normal(size=6) * np.repeat([0.03, 0.004], 3)) for _ in range(count)]
    return lambda number: poses[number % count]


@pytest.mark.parametrize("gauge", ["tracking camera", "stated targets", "fiducials"])
def test_a_camera_in_the_hand_is_where_the_targets_beside_the_optics_say(gauge: str) -> None:
    bench, own = TrueBench(8), np.eye(4)
    known: dict[str, Any] = {}
    if gauge != "tracking camera":
        known["device_from_tracking"] = None
    if gauge == "stated targets":
        sigma = np.repeat([np.radians(0.05), 1e-4], 3)
        known["targets"] = {
            k: KnownPose(pose @ small_motion(-sigma * bench.rng.normal(size=6)), (sigma[0], sigma[3]))
            for k, pose in bench.targets.items()
        }
    elif gauge == "fiducials":
        frame = transforms.rigid(transforms.OPENXR_FROM_OPENCV, np.zeros(3))
        own = frame @ transforms.inverse(bench.targets[0])
        known["targets"] = {0: KnownPose(frame)}
    seen, true = observed(bench, (), range(12), (), free_places(bench, 12), **known)
    if gauge != "tracking camera":
        seen = eyeball_alone(seen)
    if gauge == "fiducials":  # the first target is a board of its own
        views = [replace(v, board="fiducials") if v.target == 0 else v for v in seen.views]
        seen = replace(seen, views=views, tolerances=dict(seen.tolerances) | {"fiducials": USUAL_TOLERANCES})
    if gauge != "tracking camera":  # each place sees both targets, which ties them
        names = {f"bare/pose1_{k:02d}.png": f"bare/pose0_{k:02d}.png" for k in range(12)}
        seen = replace(seen, views=[replace(v, place=v.place and names.get(v.place, v.place)) for v in seen.views])
        true = {place: pose for place, pose in true.items() if place not in names}
        seen = replace(seen, places={place: seen.places[place] for place in true})
    assert_true(adjusted(seen), bench, true, own)


def test_the_camera_itself_may_be_the_device_frame() -> None:
    bench = TrueBench(9)
    motions = [along(column) for column in bench.axes.T]
    at = transforms.rigid(transforms.OPENXR_FROM_OPENCV, np.array([0.03, 0.0, 0.01]))
    seen, true = observed(
        bench,
        (StageAxis(),) * 3,
        grid(3),
        grid(3, True),
        lambda reading: bench.carried(motions, reading),
        device_from_tracking=None,
        device_from_camera=KnownPose(at),
    )
    found = adjusted(eyeball_alone(seen))
    # The frame is that of a camera without the stage's errors, which are what the true camera differs from it by.
    own = at @ transforms.inverse(bench.base)
    off = np.mean([motion_between(found.camera_pose(k).b_from_a, own @ pose) for k, pose in true.items()], axis=0)
    assert np.linalg.norm(off[:3]) < 5 * bench.size.turn_rad
    assert_true(found, bench, true, small_motion(-off) @ own)


def test_what_nothing_fixes_is_named() -> None:
    bench = TrueBench(10)
    seen, _ = observed(bench, (), range(4), (), free_places(bench, 4), device_from_tracking=None)
    seen = eyeball_alone(seen)
    with pytest.raises(BadInputError, match=r"nothing places bare/pose0_00\.png in the device frame.*\[\[target\]\]"):
        adjusted(seen)
