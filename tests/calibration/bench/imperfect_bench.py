"""Direct views of an imperfect bench, made of numbers: what the adjustment's model does not contain is in them.

The stage's errors are sines over the travel with random phases, the board is bent to a saddle and a wave with every dot
off its place, the lens has terms that the fit may not have, and noise has outliers.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace
from typing import TYPE_CHECKING, Any

import numpy as np

from wlr_render.calibration.bench.adjustment import Adjustment, adjust
from wlr_render.calibration.bench.board_views import (
    EYEBALL,
    TRACKING,
    BenchObservations,
    BoardView,
    CameraPlace,
    CameraSetup,
    KnownPose,
)
from wlr_render.calibration.bench.start import start_lens, start_state
from wlr_render.calibration.bench.state import BenchState
from wlr_render.calibration.poses import small_motion
from wlr_render.captures.boards.board import USUAL_TOLERANCES
from wlr_render.captures.photo_session import StageDescription
from wlr_render.geometry import transforms
from wlr_render.lenses.lens_camera import LensCamera
from wlr_render.numerics.arrays import FloatArray

if TYPE_CHECKING:
    from calibration.bench.test_smooth_errors import RippledLens

PITCH_M, COLUMNS, ROWS = 0.016, 26, 20


@dataclass(frozen=True)
class Imperfections:
    """Sizes; all of ordinary equipment."""

    turn_rad: float = 1e-4
    turn_jitter_rad: float = 1e-5
    straightness_m: float = 2e-6
    repeatability_m: float = 5e-6
    readback_m: float = 5e-7
    skew_rad: float = 1e-3
    bow_m: float = 2e-4
    wave_m: float = 3e-5
    anisotropy: float = 5e-4
    scale: float = 2e-4
    dot_m: float = 1e-5
    extrinsics_rad: float = np.radians(0.05)
    extrinsics_m: float = 3e-4
    noise_px: float = 0.02
    outliers: float = 0.002
    lens_kind: str = "rational"
    focus_hunt: float = 0.0  # relative change of the focal length from one hand-held photograph to the next
    hand_px: float = 0.0  # that a hand moves the image while a rolling shutter reads it, and half as much bent


PERFECT = Imperfections(0, 0, 0, 0, 0, 0, 0, 0, 0, 0, 0, 0, 0, 0.02, 0, "brown")


def turned(x_deg: float, y_deg: float, z_deg: float) -> FloatArray:
    x, y, z = np.radians([x_deg, y_deg, z_deg])
    return transforms.rotation_about("x", x) @ transforms.rotation_about("y", y) @ transforms.rotation_about("z", z)


@dataclass
class TrueBench:
    """Everything true, and the views."""

    seed: int = 0
    size: Imperfections = field(default_factory=Imperfections)
    stage: bool = True
    stage_axes: int = 3

    def __post_init__(self) -> None:
        rng = self.rng = np.random.default_rng([self.seed, 5])
        self.hand = np.random.default_rng([self.seed, 6])
        size = self.size
        rational = np.array([-0.06, 0.02, 4e-4, -3e-4, 0.004, 0.03, 0.01, -0.004])
        terms = {"brown": rational[:5] * [1, 1, 1, 1, 0], "rational": rational}[size.lens_kind]
        self.lens = {
            EYEBALL: LensCamera(
                (1280, 1024), np.array([1400.0, 1401.0]), np.array([645.3, 508.3]), terms, size.lens_kind
            ),
            TRACKING: LensCamera(
                (1600, 1200),
                np.array([1110.0, 1110.7]),
                np.array([805.3, 596.3]),
                terms * (1.5 if size.lens_kind == "rational" else 1.0),
                size.lens_kind,
            ),
        }
        column, row = np.meshgrid(np.arange(COLUMNS), np.arange(ROWS))
        self.feature = np.stack([column, row], axis=-1).reshape(-1, 2)
        flat = (self.feature - 0.5 * np.array([COLUMNS - 1, ROWS - 1])) * PITCH_M
        self.nominal = np.concatenate([flat, np.zeros((len(flat), 1))], axis=1)
        x, y = (flat / np.abs(flat).max(axis=0)).T
        a, b = rng.uniform(0, 2 * np.pi, 2)
        side = rng.choice([-1.0, 1.0], 3)
        height = size.bow_m * side[0] * (1 - x**2) - 0.5 * side[1] * size.bow_m * (1 - y**2) + 0.25 * size.bow_m * x * y
        height += size.wave_m * np.sin(4 * x + a) * np.cos(3 * y + b)
        scale = 1 + size.scale * rng.normal()
        self.point = self.nominal * [scale, scale * (1 + size.anisotropy * side[2]), 1.0]
        self.point[:, 2] += height
        self.point += size.dot_m * rng.normal(size=self.point.shape) * [1, 1, 0.3]
        opencv = transforms.OPENXR_FROM_OPENCV
        self.device_from_tracking = transforms.rigid(turned(-12, 3, 0) @ opencv, np.array([0.005, 0.03, -0.06]))
        error = rng.normal(size=6) * np.repeat([size.extrinsics_rad, size.extrinsics_m], 3)
        self.stated_tracking = self.device_from_tracking @ small_motion(-error)
        self.targets = {
            0: transforms.rigid(turned(4, -6, 1) @ opencv, np.array([0.02, 0.01, -0.4])),
            1: transforms.rigid(turned(-5, 7, 2) @ opencv, np.array([0.03, 0.0, -1.0])),
        }
        self.base = transforms.rigid(turned(1, 2, -0.5) @ opencv, np.array([0.031, 0.002, 0.018]))
        skew = np.eye(3) + size.skew_rad * rng.normal(size=(3, 3))
        self.axes = turned(0.2, -0.1, 0.3) @ np.diag([1.001, 0.9995, 1.0]) @ skew
        self.phase = rng.uniform(0, 2 * np.pi, (3, 6))
        self.side = rng.normal(size=(3, 6))

    def smooth(self, reading: FloatArray) -> FloatArray:
        """(6,) error of the carriage at a reading: half a wave over the travel of 16 mm."""
        wave = np.sin(np.pi * reading[:, None] / 0.016 + self.phase) - np.sin(self.phase)
        size = np.repeat([self.size.turn_rad, self.size.straightness_m], 3)
        return np.asarray(np.sum(wave * self.side, axis=0) * size / np.sqrt(3 * 0.5))

    def camera_at(self, reading: FloatArray) -> FloatArray:
        """(4, 4) of one visit to a reading (3,)."""
        random = self.rng.normal(size=6) * np.repeat([self.size.turn_jitter_rad, self.size.repeatability_m], 3)
        moved = transforms.rigid(np.eye(3), self.axes @ reading)
        return self.base @ moved @ small_motion(self.smooth(reading) + random)

    def view(
        self,
        name: str,
        camera: str,
        camera_from_board: FloatArray,
        target: int | None = None,
        place: str | None = None,
        every: int = 1,
    ) -> BoardView:
        lens = self.lens[camera]
        pixel = lens.pixel_of_point(transforms.apply(camera_from_board, self.point))
        with np.errstate(invalid="ignore"):
            inside = np.all((pixel > 5) & (pixel < np.array(lens.size_px) - 5), axis=1)
        inside &= (self.feature.sum(axis=1) % every) == 0
        count = int(inside.sum())
        noise = self.size.noise_px * self.rng.normal(size=(count, 2))
        noise[self.rng.random(count) < self.size.outliers] *= 30.0
        pixel = pixel[inside] + (self.hand_held(pixel[inside], lens) if target is None else 0.0)
        sigma = np.full(count, 0.02)
        return BoardView(name, camera, self.feature[inside], self.nominal[inside], pixel + noise, sigma, target, place)

    def hand_held(self, pixel: FloatArray, lens: "LensCamera | RippledLens") -> FloatArray:
        """(n, 2) displacements: the focus hunts, and the hand moves evenly and then faster while rows are read."""
        rng, size = self.hand, np.array(lens.size_px)
        time = pixel[:, 1:] / size[1] - 0.5
        speed, faster = self.size.hand_px * rng.normal(size=(2, 2)) * [[1.0], [0.5]]
        return np.asarray(
            self.size.focus_hunt * rng.normal() * (pixel - lens.centre_px) + time * speed + time**2 * faster
        )

    def carried(self, motions: Sequence[Callable[..., Any]], reading: FloatArray) -> FloatArray:
        """(4, 4) of one visit to a reading (m,), by a stage of other axes.

        Args:
            motions: one function for each axis, reading -> (4, 4) motion in the camera's frame.
            reading: metres or radians.
        """
        random = self.rng.normal(size=6) * np.repeat([self.size.turn_jitter_rad, self.size.repeatability_m], 3)
        pose = self.base
        for motion, amount in zip(motions, reading, strict=True):
            pose = pose @ motion(amount)
        travel = np.zeros(3)
        travel[: len(reading)] = np.clip(reading, -0.008, 0.008)
        return pose @ small_motion(self.smooth(travel) + random)

    def lens_views(self, camera: str, count: int = 9, distance: float = 0.55) -> list[BoardView]:
        angles = np.arange(count - 1) * 2 * np.pi / (count - 1)
        tilts = [(0.0, 0.0)] + [(28 * np.cos(a), 28 * np.sin(a)) for a in angles]
        return [
            self.view(
                f"lens/{camera}/{i:02d}.png",
                camera,
                transforms.rigid(
                    turned(x, y, 40 * i),
                    np.array([0.02 * np.cos(2 * i), 0.02 * np.sin(3 * i), distance * (1 + 0.3 * (i % 3))]),
                ),
            )
            for i, (x, y) in enumerate(tilts)
        ]

    def readings(self) -> FloatArray:
        steps = [(x, y, 0) for x in (-1, 0, 1) for y in (-1, 0, 1)] + [(0, 0, -1), (0, 0, 1)]
        return 0.008 * np.array(steps, dtype=float)

    def observations(self, lens_photographs: int = 14, tracked: tuple[int, ...] = (0, 1)) -> BenchObservations:
        """The classic bench: lens photographs of both cameras, stage at two target poses, tracking before and after."""
        views = [*self.lens_views(EYEBALL, lens_photographs), *self.lens_views(TRACKING, lens_photographs, 0.6)]
        places, self.true_places = {}, {}
        for target in self.targets:
            for number, reading in enumerate(self.readings()):
                name = f"bare/pose{target}_{number:02d}.png"
                pose = self.camera_at(reading)
                places[name] = CameraPlace(np.round(reading + self.size.readback_m * self.rng.normal(size=3), 7))
                self.true_places[name] = pose
                views.append(self.view(name, EYEBALL, transforms.inverse(pose) @ self.targets[target], target, name))
        for target in tracked:
            for when in ("before", "after"):
                pose = transforms.inverse(self.device_from_tracking) @ self.targets[target]
                views.append(self.view(f"tracking/pose{target}_{when}.png", TRACKING, pose, target))
        x, y = np.meshgrid(*[np.linspace(-0.007, 0.007, 3)] * 2)
        for number, reading in enumerate(np.stack([x.ravel(), y.ravel(), 0 * x.ravel()], axis=-1)):
            name = f"sweep{number:02d}"
            places[name] = CameraPlace(np.round(reading + self.size.readback_m * self.rng.normal(size=3), 7))
            self.true_places[name] = self.camera_at(reading)
        return BenchObservations(
            views,
            {name: CameraSetup(lens.size_px, lens.kind) for name, lens in self.lens.items()},
            places,
            StageDescription().axes,
            KnownPose(self.stated_tracking, (self.size.extrinsics_rad, self.size.extrinsics_m)),
            tolerances={"board": USUAL_TOLERANCES},
        )


def thinned(observations: BenchObservations, every: int = 8) -> BenchObservations:
    """Fewer features, so that tests are quick."""
    views = [view.only((view.feature @ [1, 2]) % every == 0) for view in observations.views]
    return replace(observations, views=views)


def start_of(observations: BenchObservations) -> BenchState:
    lens = {}
    for name, setup in observations.cameras.items():
        views = [view for view in observations.views if view.camera == name and view.target is None]
        lens[name] = setup.calibrated if setup.calibrated is not None else start_lens(views, setup.size_px, setup.kind)
    return start_state(observations, lens)


def adjusted(observations: BenchObservations) -> Adjustment:
    return adjust(start_of(observations))
