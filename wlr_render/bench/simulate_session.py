"""Predict every reading of a session on a bench, without noise."""

from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import cached_property, partial

import numpy as np

from wlr_render.bench.bench import Bench
from wlr_render.bench.bench_effects import DISPLAY, SEE_THROUGH, before_shift, displacement, optics_with_effects
from wlr_render.bench.observed_points import ObservedPoints
from wlr_render.bench.simulate_run_time import RunTimeViews
from wlr_render.captures.session import DisplayPlan, Readings, SeeThroughPlan, SessionPlan, StagePlan
from wlr_render.geometry.directions import dir_of_tangents, tangents_of_dir
from wlr_render.geometry.transforms import inverse, rotations_of_vectors
from wlr_render.mappings import Status
from wlr_render.numerics.arrays import FloatArray
from wlr_render.optics.combiner_form import places_on_combiner
from wlr_render.optics.traced_mappings import TracedDisplay

_ROUNDS = 6  # fixed-point iterations for a stage reading, on which its own error depends

_QUIET = np.errstate(invalid="ignore", over="ignore", divide="ignore")  # invisible points are intentionally NaN


@dataclass(frozen=True, eq=False)
class DotViews:
    """View directions of all target dots on a bench, with the warm start for neighbouring benches.

    Attributes:
        bench: the bench.
        plan: setup of the see-through readings.
        near: views on a neighbouring bench with the same plan. They speed up the solve without changing its result,
            except that a dot that has moved past the edge of an aperture is still seen.
    """

    bench: Bench
    plan: SeeThroughPlan
    near: "DotViews | None" = None

    @cached_property
    def tangents(self) -> FloatArray:
        """Tangents (n, 2) of the view directions, device frame; NaN where a dot is not seen."""
        scene, near = _observed_points(self.bench, self.plan), self.near
        tangents = scene.solved() if near is None else scene.solved_from(near.tangents, near.tangents_from_miss)
        # Release the neighbour; otherwise a chain of neighbours would stay in memory.
        object.__setattr__(self, "near", None)
        return tangents

    @cached_property
    def tangents_from_miss(self) -> FloatArray:
        """Inverse Jacobian (n, 2, 2) of the solve."""
        return _observed_points(self.bench, self.plan).tangents_from_miss(self.tangents)


@dataclass(frozen=True, eq=False)
class Views:
    """Views of a session's dots on a bench; None for a missing part of the session."""

    dots: DotViews | None = None
    run_time: RunTimeViews | None = None

    @classmethod
    def of(cls, bench: Bench, plan: SessionPlan, near: "Views | None" = None) -> "Views":
        """Return the views on a bench, which may start from those on a neighbouring bench, `near`."""
        near = near or Views()
        return cls(
            near.dots if plan.see_through is None else DotViews(bench, plan.see_through, near.dots),
            near.run_time if plan.run_time is None else RunTimeViews(bench, plan.run_time, near.run_time),
        )


@_QUIET
def simulate(bench: Bench, plan: SessionPlan, views: Views | None = None) -> Readings:
    """Predict every reading of a session.

    Args:
        bench: the bench.
        plan: setup of each row.
        views: views of all dots of the plan on this bench, if they exist already.

    Returns:
        The readings; NaN where the panel or a dot cannot be seen.
    """
    views, dots = views or Views.of(bench, plan), None
    if plan.see_through is not None and views.dots is not None:
        dots = dot_pixels(bench, plan.see_through, views.dots.tangents)
    return Readings(
        None if plan.display is None else panel_pixels(bench, plan.display),
        dots,
        None if plan.run_time is None or views.run_time is None else views.run_time.pixel,
    )


def _observed_points(bench: Bench, plan: SeeThroughPlan) -> ObservedPoints:
    viewpoint, point, _ = dot_geometry(bench, plan)
    optics = optics_with_effects(bench.optics, bench.effects)
    return ObservedPoints(optics, bench.target_wavelength_um, viewpoint, point)


def panel_pixels(bench: Bench, plan: DisplayPlan) -> FloatArray:
    """Return the decoded panel position (n, 2) of each display row, by one ray trace."""
    viewpoint, view_dir = camera_positions(bench, plan), display_dirs(bench, plan)
    turned = _view_shift(bench, viewpoint, view_dir, DISPLAY)
    if turned is not None:
        view_dir = dir_of_tangents(tangents_of_dir(view_dir) - turned)
    pixel, optics = np.full((len(plan), 2), np.nan), optics_with_effects(bench.optics, bench.effects)
    for channel in np.unique(plan.channel):
        rows = plan.channel == channel
        display = TracedDisplay(optics, bench.wavelengths_um[channel])
        emitted, status = display.plane_pixel(view_dir[rows], viewpoint[rows])
        # A ray past the edge of an aperture is kept, because the position of the edge is not measured.
        lost = (status != Status.OK) & (status != Status.CLIPPED)
        pixel[rows] = np.where(lost[:, None], np.nan, emitted)
    return decoded(bench, plan, pixel)


def decoded(bench: Bench, plan: DisplayPlan, pixel: FloatArray) -> FloatArray:
    """Return the decoded positions (n, 2) of light emitted at pixels (n, 2) of the cold panel."""
    centre, scale, origin = _readout(bench, plan)
    shown = centre + scale * (pixel - _creep_px(bench, plan) - centre) + origin
    shift = _total(_panel_shift(bench, plan)(shown), _drift(bench, plan))
    return shown if shift is None else np.asarray(shown + shift)


def _panel_shift(bench: Bench, plan: DisplayPlan) -> Callable[[FloatArray], FloatArray | None]:
    """Return the function that maps positions (n, 2) on the panel to their shifts (n, 2); None without effects."""
    viewpoint = camera_positions(bench, plan) if bench.effects else np.zeros((len(plan), 3))
    displaced = partial(displacement, bench.effects, "panel", channel=plan.channel)

    def shift(pixel: FloatArray) -> FloatArray | None:
        places = np.concatenate([pixel, viewpoint], axis=1)
        return _total(displaced("shift", pixel), displaced("shift by viewpoint", places))

    return shift


def _drift(bench: Bench, plan: DisplayPlan) -> FloatArray | None:
    """Return the shift (n, 2) of decoded positions with time; None without effects."""
    return displacement(bench.effects, "time", "shift", plan.time_s[:, None], channel=plan.channel)


def _total(*displacements: FloatArray | None) -> FloatArray | None:
    """Return the sum of the displacements that are not None; None if all are None."""
    present = [each for each in displacements if each is not None]
    return np.sum(present, axis=0) if present else None


def undecoded(bench: Bench, plan: DisplayPlan, pixel: FloatArray) -> FloatArray:
    """Return the inverse of `decoded`."""
    centre, scale, origin = _readout(bench, plan)
    drift = _drift(bench, plan)
    pixel = before_shift(pixel if drift is None else pixel - drift, _panel_shift(bench, plan))
    return np.asarray(centre + (pixel - origin - centre) / scale + _creep_px(bench, plan))


def _readout(bench: Bench, plan: DisplayPlan) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Return the panel's centre (2,), and the magnification about the centre (n, 1) and shift (n, 2) of each row."""
    readout = bench.readout
    shift = readout.origin_px + readout.channel_shift_px[plan.channel]
    return 0.5 * bench.optics.panel.pixels.size_px, readout.channel_scale[plan.channel][:, None], shift


def _creep_px(bench: Bench, plan: DisplayPlan) -> FloatArray:
    """Return the panel's creep at each row, (n, 2) panel pixels."""
    panel, mount = bench.optics.panel, bench.mount
    warm = 1.0 - np.exp(-plan.time_s / mount.warm_up_s)
    return np.asarray(warm[:, None] * mount.panel_creep / panel.size * panel.pixels.size_px)


def dot_pixels(bench: Bench, plan: SeeThroughPlan, tangents: FloatArray) -> FloatArray:
    """Return the camera pixels (n, 2) of dots in directions of tangents (n, 2), device frame."""
    viewpoint, _, device_from_camera = dot_geometry(bench, plan)
    turned = _view_shift(bench, viewpoint, dir_of_tangents(tangents), SEE_THROUGH)
    tangents = tangents if turned is None else tangents + turned
    in_camera = np.einsum("nji,nj->ni", device_from_camera, dir_of_tangents(tangents))
    return imaged(bench, plan, bench.camera.pixel_of_tangents(tangents_of_dir(in_camera)))


def _view_shift(bench: Bench, viewpoint: FloatArray, view_dir: FloatArray, part: str) -> FloatArray | None:
    """Return the apparent shift, (n, 2) tangents, of objects in directions (n, 3); None without effects."""
    views = [each for each in bench.effects if each.displaces == "view" and each.part in ("", part)]
    if not views:
        return None
    total = np.zeros((len(view_dir), 2))
    for meeting in {effect.meeting for effect in views}:
        mine = [effect for effect in views if effect.meeting == meeting]
        moved = displacement(mine, "combiner", "view", places_on_combiner(bench.optics, viewpoint, view_dir, meeting))
        total += 0.0 if moved is None else moved
    return total


def imaged(bench: Bench, plan: StagePlan, pixel: FloatArray) -> FloatArray:
    """Return the pixels (n, 2), one for each row, where a camera with effects images the ideal pixels (n, 2)."""
    shift = _image_shift(bench, plan)(pixel)
    return pixel if shift is None else np.asarray(pixel + shift)


def unshifted(bench: Bench, plan: StagePlan, pixel: FloatArray) -> FloatArray:
    """Return the inverse of `imaged`."""
    return before_shift(pixel, _image_shift(bench, plan))


def _image_shift(bench: Bench, plan: StagePlan) -> Callable[[FloatArray], FloatArray | None]:
    """Return the function that maps places (n, 2) in the image to their shifts (n, 2); None without effects."""
    displaced = partial(displacement, bench.effects, "camera", part=part_of(plan))

    def shift(pixel: FloatArray) -> FloatArray | None:
        at_times = np.concatenate([pixel, plan.time_s[:, None]], axis=1)
        return _total(displaced("shift", pixel), displaced("shift by time", at_times))

    return shift


def part_of(plan: StagePlan) -> str:
    """Return the name of the session's part to which a plan belongs."""
    return DISPLAY if isinstance(plan, DisplayPlan) else SEE_THROUGH


def dot_geometry(bench: Bench, plan: SeeThroughPlan) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Return the camera positions (n, 3), dots (n, 3) and camera orientations (n, 3, 3), device frame."""
    viewpoint, device_from_camera = camera_positions(bench, plan), camera_orientations(bench, plan)
    point = _dots(bench, plan)
    if plan.bare_pixel is not None:
        in_camera = dir_of_tangents(bench.camera.tangents_of_pixel(unshifted(bench, plan, plan.bare_pixel)))
        ray = np.einsum("nij,nj->ni", device_from_camera, in_camera)
        point = viewpoint + np.linalg.norm(point - viewpoint, axis=1, keepdims=True) * ray
    return viewpoint, point, device_from_camera


def camera_positions(bench: Bench, plan: StagePlan) -> FloatArray:
    """Return the true positions of the camera's centre of projection, (n, 3), device frame."""
    origin = bench.stage.origin
    return np.asarray(origin + (plan.stage - origin) @ bench.stage.axes.T + _displacements(bench, plan))


def stage_readings(bench: Bench, plan: StagePlan, position: FloatArray) -> FloatArray:
    """Return the stage readings (n, 3) at camera positions (n, 3), the inverse of `camera_positions`."""
    origin, axes = bench.stage.origin, np.linalg.inv(bench.stage.axes).T
    reading = position
    for _ in range(_ROUNDS if bench.effects else 1):
        moved = position - _displacements(bench, replace(plan, stage=reading)) - origin
        reading = origin + moved @ axes
    return np.asarray(reading)


def _displacements(bench: Bench, plan: StagePlan) -> FloatArray:
    """Return camera positions minus stage positions, (n, 3): pupil offset, backlash and slip."""
    moved = np.where((plan.time_s >= bench.mount.slip_time_s)[:, None], bench.mount.slip, 0.0)
    moved[:, 0] += np.where(plan.travel > 0, *bench.stage.backlash)
    error = _pose_error(bench, plan)
    if error is not None:
        moved += error[:, :3]
    return np.asarray(moved + bench.camera.pupil_offset)


def _pose_error(bench: Bench, plan: StagePlan) -> FloatArray | None:
    """Return the shift (metres) and rotation (radians) of the camera, (n, 6), by effects of stage and time."""
    displaced, with_travel = partial(displacement, bench.effects, part=part_of(plan)), plan.travel[:, None]
    return _total(
        displaced("stage", "pose", plan.stage),
        displaced("stage", "pose by travel", np.concatenate([with_travel, plan.stage], axis=1)),
        displaced("time", "pose", plan.time_s[:, None]),
    )


def camera_orientations(bench: Bench, plan: StagePlan) -> FloatArray:
    """Return the true rotations device_from_camera (n, 3, 3) of the camera, including the slip."""
    turned = mounted(bench, plan)
    if plan.orientation is not None:
        turned = plan.orientation @ turned
    return slips(bench, plan.time_s) @ turned if bench.mount.slip_rotation.any() else turned


def mounted(bench: Bench, plan: StagePlan) -> FloatArray:
    """Return the rotations (n, 3, 3) of the camera on its mount, without slips and orientations of the plan."""
    error = _pose_error(bench, plan)
    if error is None:
        return np.broadcast_to(bench.camera.device_from_camera, (len(plan), 3, 3))
    return np.asarray(rotations_of_vectors(error[:, 3:]) @ bench.camera.device_from_camera)


def slips(bench: Bench, time_s: FloatArray) -> FloatArray:
    """Return the rotations (n, 3, 3) of the camera by the slip, device frame; the identity before the slip."""
    slipped = (time_s >= bench.mount.slip_time_s)[:, None, None]
    return np.asarray(np.where(slipped, rotations_of_vectors(bench.mount.slip_rotation), np.eye(3)))


def display_dirs(bench: Bench, plan: DisplayPlan) -> FloatArray:
    """Return the true unit view directions (n, 3) of the camera in each display row, device frame."""
    pixel = unshifted(bench, plan, plan.camera_pixel)
    if plan.orientation is None and not bench.mount.slip_rotation.any() and not bench.effects:
        return bench.camera.view_dir_of_pixel(pixel)
    in_camera = dir_of_tangents(bench.camera.tangents_of_pixel(pixel))
    return np.asarray(np.einsum("nij,nj->ni", camera_orientations(bench, plan), in_camera))


def printed_places(bench: Bench, plan: SeeThroughPlan, point: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Return the positions (n, 2) on the printed target, and heights (n,) above it, of points (n, 3), device frame.

    This inverts the positions of dots in `dot_geometry`.
    """
    target = bench.target
    target_from_device = inverse(bench.tracking.true_from_reported @ target.device_from_target)[plan.target_pose]
    in_target = np.einsum("nij,nj->ni", target_from_device[:, :3, :3], point) + target_from_device[:, :3, 3]
    bow = np.broadcast_to(target.bow, (len(target.device_from_target), 2))[plan.target_pose]

    def shift(place: FloatArray) -> FloatArray | None:
        return _print_shift(bench, plan, place[:, :2] / target.scale)

    flat = before_shift(in_target, shift)
    return flat[:, :2] / target.scale, flat[:, 2] - np.sum(bow * flat[:, :2] ** 2, axis=1)


def _print_shift(bench: Bench, plan: SeeThroughPlan, dot: FloatArray) -> FloatArray | None:
    """Return the displacements (n, 3) of dots printed at (n, 2), metres, target's axes; None without effects."""
    pitches = dot / bench.target.pitch[plan.target_pose][:, None]
    return displacement(bench.effects, "target", "shift", pitches, target_pose=plan.target_pose)


def _dots(bench: Bench, plan: SeeThroughPlan) -> FloatArray:
    """Return the true positions of the printed dots, (n, 3), device frame."""
    target = bench.target
    flat = plan.dot * target.scale
    bow = np.broadcast_to(target.bow, (len(target.device_from_target), 2))[plan.target_pose]
    height = np.sum(bow * flat * flat, axis=1) + (0.0 if plan.height is None else plan.height)
    in_target = np.column_stack([flat, height])
    shift = _print_shift(bench, plan, plan.dot)
    if shift is not None:
        in_target += shift
    device_from_target = (bench.tracking.true_from_reported @ target.device_from_target)[plan.target_pose]
    return np.asarray(np.einsum("nij,nj->ni", device_from_target[:, :3, :3], in_target) + device_from_target[:, :3, 3])
