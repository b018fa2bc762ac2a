"""Input of the joint adjustment: views of boards seen directly, and prior knowledge of the bench.

Frames: device (OpenXR's axes), camera and board (OpenCV's axes); metres, radians. A view through the headset's optics
is not direct and does not belong here.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property

import numpy as np

from wlr_render.captures.boards.board import BoardTolerances
from wlr_render.captures.boards.lattice_shape import Discs
from wlr_render.captures.photo_session import StageAxis, StageDescription
from wlr_render.io.input_files import LIMITS
from wlr_render.lenses.lens import Lens
from wlr_render.numerics.arrays import BoolArray, FloatArray, IntArray

EYEBALL, TRACKING = "eyeball", "tracking"
"""Names of the two cameras: in place of the eye, and on the headset."""

APART = LIMITS.index + 1
"""Offset, a multiple of which is added to the number of a target pose or mounting that is separated after a fault."""

FEWEST_FEATURES = 8
"""Fewest features of a view. A pose has 6 unknowns; four features give 8 readings, and twice as many allow a check."""

Sigma = tuple[float, float]
"""Standard deviations per axis of a rotation (rad) and a position (m)."""


@dataclass(frozen=True, eq=False)
class BoardView:
    """Features of a board that one photograph shows directly, not through the optics.

    Attributes:
        name: name of the photograph in messages.
        camera: `EYEBALL` or `TRACKING`.
        feature: (n, 2) column and row on the board.
        point: (n, 3) positions of the features in the board's file, board frame, metres.
        pixel: (n, 2) pixels of the features, from the outer corner of the top-left pixel.
        sigma_px: (n,) standard deviation of `pixel` per axis; the adjustment estimates a common factor for each camera.
        target: number of the target pose; None for a board held freely in front of the camera.
        place: name of the camera place; None if the place does not matter (free board) or is on the headset.
        board: name of the board; a target with a separate board has another name.
        discs: discs of dots, from which `pixel` is recomputed once the lens is known; None for corners.
    """

    name: str
    camera: str
    feature: IntArray
    point: FloatArray
    pixel: FloatArray
    sigma_px: FloatArray
    target: int | None = None
    place: str | None = None
    board: str = "board"
    discs: Discs | None = None

    def __len__(self) -> int:
        return len(self.point)

    def only(self, rows: BoolArray) -> "BoardView":
        """Return the view with the features selected by a mask (n,)."""
        return replace(
            self,
            feature=self.feature[rows],
            point=self.point[rows],
            pixel=self.pixel[rows],
            sigma_px=self.sigma_px[rows],
            discs=None if self.discs is None else self.discs.only(rows),
        )

    def seen_by(self, lens: Lens) -> "BoardView":
        """Return the view with dot centres recomputed for a known lens."""
        if self.discs is None:
            return self
        return replace(self, pixel=self.discs.centres(lens, self.point, self.pixel))


@dataclass(frozen=True, eq=False)
class CameraPlace:
    """A place of the eyeball camera.

    Attributes:
        reading: (m,) readings of the stage's axes; None without a stage, when the pose is free.
        orientation: number of the camera's mounting on the stage.
        time_s: seconds from any origin; None if unknown.
    """

    reading: FloatArray | None
    orientation: int = 0
    time_s: float | None = None


@dataclass(frozen=True, eq=False)
class KnownPose:
    """A pose that is known in advance.

    Attributes:
        pose: (4, 4) the pose.
        sigma: standard deviations of rotation and position.
    """

    pose: FloatArray
    sigma: Sigma = (0.0, 0.0)


@dataclass(frozen=True, eq=False)
class CameraSetup:
    """A camera of the bench.

    Attributes:
        size_px: width and height of the picture.
        kind: kind of the lens model; "auto" for a choice by held-out photographs.
        calibrated: the lens if it is already calibrated.
        calibrated_sigma: (values,) standard deviations of the lens's values; zero for exact values.
    """

    size_px: tuple[int, int]
    kind: str = "auto"
    calibrated: Lens | None = None
    calibrated_sigma: FloatArray | None = None


@dataclass(frozen=True, eq=False)
class BenchObservations:
    """All direct views of a bench, in the order in which they were taken, and prior knowledge of the bench.

    Attributes:
        views: views of all cameras.
        cameras: cameras by name.
        places: places by name: every place of a view, and any other place whose pose is required.
        axes: axes of the stage; empty without a stage.
        device_from_tracking: pose of the tracking camera; None without one.
        targets: poses device_from_target that are known in advance.
        device_from_camera: pose of the eyeball camera in orientation 0 at the middle of the readings, if it defines the
            device frame.
        tolerances: tolerances of the boards, by name.
    """

    views: Sequence[BoardView]
    cameras: Mapping[str, CameraSetup]
    places: Mapping[str, CameraPlace]
    axes: Sequence[StageAxis] = StageDescription().axes
    device_from_tracking: KnownPose | None = None
    targets: Mapping[int, KnownPose] = field(default_factory=dict)
    device_from_camera: KnownPose | None = None
    tolerances: Mapping[str, BoardTolerances] = field(default_factory=dict)

    def without(self, names: Sequence[str]) -> "BenchObservations":
        """Return the observations without the views of these names."""
        return replace(self, views=[view for view in self.views if view.name not in names])

    @cached_property
    def duration(self) -> tuple[float, float] | None:
        """Middle and half range of the times of the places, seconds; None if times are unknown or all equal."""
        times = [place.time_s for place in self.places.values() if place.time_s is not None]
        if len(set(times)) < 2:
            return None
        return 0.5 * (max(times) + min(times)), 0.5 * (max(times) - min(times))

    @property
    def travel(self) -> tuple[FloatArray, FloatArray]:
        """Middle and half range (axes,) of the readings; the half range is 1 for an axis that does not move."""
        readings = np.array([place.reading for place in self.places.values() if place.reading is not None])
        if not len(readings):
            return np.zeros(len(self.axes)), np.ones(len(self.axes))
        low, high = readings.min(axis=0), readings.max(axis=0)
        half = 0.5 * (high - low)
        return 0.5 * (low + high), np.where(half > 0, half, 1.0)
