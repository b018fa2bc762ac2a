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
"""The two cameras: in the place of the eye, and on the headset."""

APART = LIMITS.index + 1
"""Target poses and mountings that are set apart after a fault have their number plus a multiple of this."""

FEWEST_FEATURES = 8
"""A pose has 6 unknowns; four features give 8 readings, and twice that shows whether they are right."""

Sigma = tuple[float, float]
"""Standard deviations per axis of a rotation (rad) and a position (m)."""


@dataclass(frozen=True, eq=False)
class BoardView:
    """Features of a board in one photograph, seen directly.

    Attributes:
        name: of the photograph, as messages should have it.
        camera: `EYEBALL` or `TRACKING`.
        feature: (n, 2) column and row on the board.
        point: (n, 3) where the board's file has them, board frame, metres.
        pixel: (n, 2) where they are seen, from the outer corner of the top-left pixel.
        sigma_px: (n,) standard deviation of `pixel` per axis; the adjustment finds a common factor for each camera.
        target: number of the target pose; None for a board held freely before the camera.
        place: name of the camera place; None where the camera's place does not matter (free board) or is the headset's.
        board: name of the board; a target with a separate board has another name.
        discs: of dots, from which `pixel` is found again once the lens is known; None for corners.
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
        """Return some of the features, by mask (n,)."""
        return replace(
            self,
            feature=self.feature[rows],
            point=self.point[rows],
            pixel=self.pixel[rows],
            sigma_px=self.sigma_px[rows],
            discs=None if self.discs is None else self.discs.only(rows),
        )

    def seen_by(self, lens: Lens) -> "BoardView":
        """Return the view with the centres of its dots as a known lens sees them."""
        if self.discs is None:
            return self
        return replace(self, pixel=self.discs.centres(lens, self.point, self.pixel))


@dataclass(frozen=True, eq=False)
class CameraPlace:
    """A place of the eyeball camera.

    Attributes:
        reading: (m,) of the stage's axes; None without a stage, when the pose is free.
        orientation: number of the mounting in which the camera sits on the stage.
        time_s: seconds from any origin; None if unknown.
    """

    reading: FloatArray | None
    orientation: int = 0
    time_s: float | None = None


@dataclass(frozen=True, eq=False)
class KnownPose:
    """A pose given beforehand.

    Attributes:
        pose: (4, 4).
        sigma: of its rotation and its position.
    """

    pose: FloatArray
    sigma: Sigma = (0.0, 0.0)


@dataclass(frozen=True, eq=False)
class CameraSetup:
    """A camera of the bench.

    Attributes:
        size_px: width and height.
        kind: of its lens model; "auto" to choose by held-out photographs.
        calibrated: the lens if it is calibrated already.
        calibrated_sigma: (values,) standard deviations of its values; zero where they count as exact.
    """

    size_px: tuple[int, int]
    kind: str = "auto"
    calibrated: Lens | None = None
    calibrated_sigma: FloatArray | None = None


@dataclass(frozen=True, eq=False)
class BenchObservations:
    """All direct views of a bench, in the order in which they were taken, and prior knowledge of the bench.

    Attributes:
        views: of all cameras.
        cameras: by name.
        places: by name: every place of a view, and any other place whose pose is required.
        axes: of the stage; empty without one.
        device_from_tracking: where the tracking camera sits; None without one.
        targets: poses device_from_target that are given beforehand.
        device_from_camera: of the eyeball camera in orientation 0 at the middle of the readings, where that defines the
            device frame.
        tolerances: of the boards, by name.
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
        """All but the views with these names."""
        return replace(self, views=[view for view in self.views if view.name not in names])

    @cached_property
    def duration(self) -> tuple[float, float] | None:
        """Middle and half range of the times of the places, seconds; None where they are unknown, or all are one."""
        times = [place.time_s for place in self.places.values() if place.time_s is not None]
        if len(set(times)) < 2:
            return None
        return 0.5 * (max(times) + min(times)), 0.5 * (max(times) - min(times))

    @property
    def travel(self) -> tuple[FloatArray, FloatArray]:
        """Middle and half range (axes,) of the readings; 1 where an axis stands still."""
        readings = np.array([place.reading for place in self.places.values() if place.reading is not None])
        if not len(readings):
            return np.zeros(len(self.axes)), np.ones(len(self.axes))
        low, high = readings.min(axis=0), readings.max(axis=0)
        half = 0.5 * (high - low)
        return 0.5 * (low + high), np.where(half > 0, half, 1.0)
