"""Captures on a bench with the errors of a `LabWorkshop`, with all data that a lab records.

A session is a sweep over the camera positions for each pose of one printed board; in the first sweep the panel is
decoded as well. The camera looks at the middle of the display's field; the stage moves along the axes of the device.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any

import numpy as np

from benchmarks.accuracy.lab_errors import LabWorkshop
from wlr_render.captures.correspondences import AnyCaptures, DisplayCaptures, SeeThroughCaptures, concatenate
from wlr_render.geometry import transforms
from wlr_render.geometry.directions import ARCMIN, dir_of_tangents, normalised, tangents_of_dir
from wlr_render.numerics.arrays import BoolArray, FloatArray, IntArray
from wlr_render.simulation.capture_setup import LEAST_SIGMA_ARCMIN, CaptureSetup
from wlr_render.simulation.workshop import Workshop, travel_of

HALF_DIAGONAL_PX = 1600.0
"""Half the diagonal of the camera's picture, 5 megapixels, which reaches to the corners of the display's field."""
_PANEL_S, _BOARD_S = 15.0, 10.0  # seconds for the panel's code, and for a move and a photograph of the board
_LARGEST_BOARD_M = np.array([1.189, 0.841])  # size of A0 paper
_TILTS_DEG = np.array([[4.0, -6.0, 1.0], [-5.0, 4.0, -2.0], [6.0, 5.0, 3.0]])  # tilts of boards that are set up by eye


@dataclass(frozen=True, eq=False)
class LabCamera:
    """The camera as the lab states it.

    Attributes:
        device_from_camera: (3, 3) rotation; the camera has OpenXR's axes, and looks along -z at the field's middle.
        half_diagonal: tangent of the angle between the camera's axis and the field's farthest corner.
    """

    device_from_camera: FloatArray
    half_diagonal: float

    @classmethod
    def of(cls, setup: CaptureSetup) -> "LabCamera":
        """Return the camera that looks at the display's field."""
        low, high = setup.field.low, setup.field.high
        back = -dir_of_tangents(0.5 * (low + high))
        right = normalised(np.cross([0.0, 1.0, 0.0], back))
        rotation = np.stack([right, np.cross(back, right), back], axis=-1)
        corner = dir_of_tangents(np.stack(np.meshgrid(*np.stack([low, high], axis=-1)), axis=-1).reshape(-1, 2))
        return cls(rotation, float(np.linalg.norm(tangents_of_dir(corner @ rotation), axis=-1).max()))

    def unit_of_dir(self, view_dir: FloatArray) -> FloatArray:
        """Return image positions (..., 2), in half diagonals, of directions (..., 3) in the device frame."""
        return tangents_of_dir(view_dir @ self.device_from_camera) / self.half_diagonal

    def dir_of_unit(self, unit: FloatArray) -> FloatArray:
        """Return the directions (..., 3), camera frame, of image positions (..., 2)."""
        return dir_of_tangents(unit * self.half_diagonal)


@dataclass(frozen=True, eq=False)
class LabSweep:
    """Visits of all camera positions, one after the other.

    Attributes:
        setup: the bench.
        workshop: errors of the bench.
        viewpoint: (m, 3) positions in the order of the visits, as the lab states them.
        number: number of the sweep, and of the board's pose.
        motion: (m, 6) true rotation (rad) and displacement (m) of the camera at each visit, device frame.
    """

    setup: CaptureSetup
    workshop: LabWorkshop
    viewpoint: FloatArray
    number: int
    motion: FloatArray

    @classmethod
    def driven(
        cls, setup: CaptureSetup, workshop: LabWorkshop, viewpoint: FloatArray, number: int, rng: np.random.Generator
    ) -> "LabSweep":
        """Drive the stage through all positions."""
        reading = viewpoint - setup.truth.eye_box.centre
        motion = workshop.stage_motion(reading, travel_of(reading)) + workshop.visit_motion(len(reading), number)
        if number == 0:
            motion[:, 3:] += workshop.bumps(len(reading))
        motion[:, 3:] += rng.normal(0.0, setup.stage_error_m, reading.shape)
        motion[:, :3] += rng.normal(0.0, setup.stage_turn_rad, reading.shape)
        return cls(setup, workshop, viewpoint, number, motion)

    @cached_property
    def camera(self) -> LabCamera:
        """The camera as the lab states it."""
        return LabCamera.of(self.setup)

    @property
    def time_s(self) -> FloatArray:
        """Time (m,) of each visit since the session's start."""
        visit, count = np.arange(len(self.viewpoint)) + 0.5, len(self.viewpoint)
        if self.number == 0:
            return np.asarray(visit * (_PANEL_S + _BOARD_S))
        return np.asarray(count * (_PANEL_S + self.number * _BOARD_S) + visit * _BOARD_S)

    @property
    def _elapsed(self) -> FloatArray:
        return self.time_s / (len(self.viewpoint) * (_PANEL_S + len(self.setup.target_depths_m) * _BOARD_S))

    def _image_error(self, unit: FloatArray) -> FloatArray:
        """Return true less stated image positions (m, n, 2) at stated positions (n, 2) or (m, n, 2)."""
        shift = self.workshop.lens_px(unit) + self.workshop.drift_px(self._elapsed, unit)
        return np.asarray(shift / HALF_DIAGONAL_PX)

    @cached_property
    def _true_rotation(self) -> FloatArray:
        return np.asarray(transforms.rotations_of_vectors(self.motion[:, :3]) @ self.camera.device_from_camera)

    def _pupil(self, unit: FloatArray) -> FloatArray:
        """Return the true entrance pupil (m, n, 3) of rays at true image positions (m, n, 2)."""
        along = -self.workshop.pupil_m(unit)[..., None] * self._true_rotation[:, None, :, 2]
        return np.asarray((self.viewpoint + self.motion[:, 3:])[:, None] + along)

    def rays_of_dirs(self, view_dir: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Return origins and directions (m, n, 3) of the true rays for stated directions (n, 3), device frame."""
        unit = self.camera.unit_of_dir(view_dir)
        unit = unit + self._image_error(unit)
        return self._pupil(unit), self.camera.dir_of_unit(unit) @ np.swapaxes(self._true_rotation, -1, -2)

    def views_of_points(self, point: FloatArray) -> tuple[FloatArray, BoolArray]:
        """Return the stated directions (m, n, 3) of true points (n, 3) through the optics, and a mask (m, n).

        The pupil depends on the direction, and the image error on the stated position: both are iterated.
        """
        true = normalised(point - (self.viewpoint + self.motion[:, 3:])[:, None])
        for _ in range(2):
            unit = tangents_of_dir(true @ self._true_rotation) / self.camera.half_diagonal
            view = self.setup.truth.see_through.view_dir_of_real_point(point[None], self._pupil(unit))
            true = view.value
        wanted = tangents_of_dir(true @ self._true_rotation) / self.camera.half_diagonal
        unit = wanted
        for _ in range(4):
            unit = wanted - self._image_error(unit)
        stated = self.camera.dir_of_unit(unit) @ self.camera.device_from_camera.T
        return stated, view.usable & self.setup.field.contains(stated)

    def columns(self, visit: IntArray) -> dict[str, Any]:
        """Return the columns of captures that depend on the visits (n,) of the readings."""
        reading = self.viewpoint - self.setup.truth.eye_box.centre
        return {
            "device": self.setup.truth.name,
            "eye": self.setup.truth.eye,
            "eye_box": self.setup.truth.eye_box,
            "viewpoint": self.viewpoint[visit],
            "capture": visit,
            "visit": self.number * len(self.viewpoint) + visit,
            "time_s": self.time_s[visit],
            "stage": reading[visit],
            "travel": travel_of(reading)[visit, 0],
            "device_from_camera": self.camera.device_from_camera,
            "sigma_arcmin": np.full(len(visit), self._stated_sigma_arcmin),
        }

    @property
    def _stated_sigma_arcmin(self) -> float:
        return self.setup.camera_noise_arcmin or (LEAST_SIGMA_ARCMIN if self.workshop.level > 0.0 else 0.0)

    def noisy(self, captures: AnyCaptures, rng: np.random.Generator) -> AnyCaptures:
        """Add the noise of the readings, visit by visit."""
        tangents = tangents_of_dir(captures.view_dir @ self.camera.device_from_camera)
        noise, size = np.zeros_like(tangents), self.setup.camera_noise_arcmin * ARCMIN
        for visit in np.unique(captures.capture):
            rows = captures.capture == visit
            noise[rows] = size * self.workshop.noise(tangents[rows] / self.camera.half_diagonal, rng)
        # A small angle changes the tangents differently along and across the radius.
        square = np.sum(tangents**2, axis=-1, keepdims=True)
        radial = tangents * np.sum(tangents * noise, axis=-1, keepdims=True)
        moved = tangents + np.sqrt(1.0 + square) * (noise + radial / (1.0 + np.sqrt(1.0 + square)))
        return replace(captures, view_dir=dir_of_tangents(moved) @ self.camera.device_from_camera.T)


@dataclass(frozen=True, eq=False)
class LabBoard:
    """One board at several poses; farther away, every second or third dot is read.

    Attributes:
        half_m: (2,) half the width and height.
        pitch_m: distance of neighbouring dots.
        device_from_target: (k, 4, 4) poses of the board.
        stride: (k,) step between the dots that are read.
    """

    half_m: FloatArray
    pitch_m: float
    device_from_target: FloatArray
    stride: Sequence[int]

    @classmethod
    def of(cls, setup: CaptureSetup) -> "LabBoard":
        """Return a board that fills the field at its farthest pose, if it can be printed."""
        camera, depth, box = LabCamera.of(setup), np.array(setup.target_depths_m), setup.truth.eye_box
        corners = np.stack(np.meshgrid(*np.stack([setup.field.low, setup.field.high], axis=-1)), axis=-1)
        half = np.abs(camera.unit_of_dir(dir_of_tangents(corners.reshape(-1, 2)))).max(axis=0) * camera.half_diagonal
        wanted = depth.max() * half + 0.5 * box.size[:2]
        largest = 0.5 * (_LARGEST_BOARD_M if wanted[0] >= wanted[1] else _LARGEST_BOARD_M[::-1])
        pitch = float(np.max(2.0 * (depth.min() * half + 0.5 * box.size[:2]) / (np.array(setup.grid) - 1.0)))
        poses = []
        for number, each in enumerate(depth):
            tilt = transforms.rotations_of_vectors(np.deg2rad(_TILTS_DEG[number % len(_TILTS_DEG)]))
            middle = box.centre - each * camera.device_from_camera[:, 2]
            poses.append(transforms.rigid(camera.device_from_camera @ tilt, middle))
        stride = [max(1, round(float(each))) for each in depth / depth.min()]
        return cls(np.minimum(wanted, largest), pitch, np.stack(poses), stride)

    def dots(self, pose: int) -> FloatArray:
        """Return the designed positions (n, 3) of the dots that are read at a pose, board frame."""
        step = self.pitch_m * self.stride[pose]
        x, y = (step * np.arange(-np.floor(half / step), np.floor(half / step) + 1.0) for half in self.half_m)
        place = np.stack(np.meshgrid(x, y), axis=-1).reshape(-1, 2)
        return np.column_stack([place, np.zeros(len(place))])

    def printed(self, dots: FloatArray, workshop: Workshop) -> FloatArray:
        """Return the true positions (n, 3) of designed positions (n, 3), board frame."""
        place = dots[:, :2]
        return np.column_stack([place + workshop.printed_m(place), workshop.height_m(place / self.half_m)])


def display_captures(
    setup: CaptureSetup, workshop: LabWorkshop, viewpoint: FloatArray, rng: np.random.Generator
) -> DisplayCaptures:
    """Decode the panel in the camera's pixels from positions (m, 3), device frame, in the order of their visits."""
    sweep = LabSweep.driven(setup, workshop, viewpoint, 0, rng)
    view_dir = setup.camera_dirs()
    origin, direction = sweep.rays_of_dirs(view_dir)
    shown = setup.truth.display.pixel_of_view_dir(direction, origin)
    visit, column = np.nonzero(shown.usable)
    panel, pixel = setup.truth.display.panel, shown.value[visit, column]
    captures = DisplayCaptures(panel=panel, pixel=pixel, view_dir=view_dir[column], **sweep.columns(visit))
    return sweep.noisy(captures, rng)


def see_through_captures(
    setup: CaptureSetup, workshop: LabWorkshop, viewpoint: FloatArray, rng: np.random.Generator
) -> SeeThroughCaptures:
    """Photograph the board at all poses through the optics, with a new sweep over positions (m, 3) for each pose."""
    board, parts = LabBoard.of(setup), []
    for pose, device_from_target in enumerate(board.device_from_target):
        sweep = LabSweep.driven(setup, workshop, viewpoint, pose, rng)
        dots = board.dots(pose)
        true = transforms.apply(device_from_target, board.printed(dots, workshop))
        view_dir, seen = sweep.views_of_points(true)
        visit, dot = np.nonzero(seen)
        captures = SeeThroughCaptures(
            view_dir=view_dir[visit, dot],
            point=transforms.apply(device_from_target, dots)[dot],
            target_point=dots[dot],
            target_pose=np.full(len(visit), pose),
            **sweep.columns(visit),
        )
        parts.append(sweep.noisy(captures, rng))
    return concatenate(parts)
