"""A simulated photographic bench with known true values: its design, and the true poses of its cameras and targets."""

from dataclasses import dataclass, field, replace
from typing import Annotated, Literal

import numpy as np

from wlr_render.captures.boards.board_design import design_board
from wlr_render.captures.boards.dot_board import DotBoard
from wlr_render.errors import BadInputError
from wlr_render.geometry import transforms
from wlr_render.geometry.directions import dir_of_tangents, normalised
from wlr_render.io.file_records import Key
from wlr_render.lenses.lens_camera import LensCamera
from wlr_render.mappings import Eye
from wlr_render.numerics.arrays import FloatArray
from wlr_render.optics.device import Device, EyeOptics
from wlr_render.optics.traced_mappings import traced_eye
from wlr_render.simulation.capture_setup import CaptureSetup
from wlr_render.simulation.photographs.camera import Sensor, SimulatedLens
from wlr_render.simulation.photographs.imperfections import BenchImperfections
from wlr_render.simulation.photographs.printed_board import PrintedBoard, WorkshopBoard
from wlr_render.simulation.photographs.stage_errors import StageErrors
from wlr_render.simulation.photographs.true_lens import true_lens
from wlr_render.simulation.viewpoints import planar, volumetric
from wlr_render.simulation.workshop import Workshop, travel_of

_MARGIN = 1.08  # ratio of the camera's field to the display's field
_BOARD_MARGIN = 1.15  # ratio of the board to the display's field at the farthest pose, if it can be printed
_LARGEST_BOARD_M = (1.189, 0.841)  # A0, the largest sheet of a plotter
_PITCH_PX = 24.0  # pitch of the board at its farthest pose, camera pixels
_EXPOSURE = 0.85  # exposure of a white panel, just below full scale
_TRACKING_SNR = 60.0  # signal-to-noise ratio of white, as for an 8-bit camera in daylight
_STAGE, _BOARD, _LENSES, _EXTRINSICS, _SENSORS = range(101, 106)  # streams of random numbers

Family = Literal["polynomial", "workshop"]
StageKind = Literal["xyz", "xy", "x"]
Sampling = Literal["planar", "volumetric"]

_CORNERS = np.stack(np.meshgrid(*[[-1.0, 0.0, 1.0]] * 3), axis=-1).reshape(-1, 3)


@dataclass(frozen=True)
class PhotoBenchOptions:
    """Options of a simulated photographic bench.

    Attributes:
        camera_px: width and height of the eyeball camera's photographs.
        bits: bits of the eyeball camera.
        pupil_mm: diameter of the eyeball camera's entrance pupil.
        focus_m: focus distance, for all photographs.
        snr: signal-to-noise ratio of a panel at full white.
        target_depths_m: distances of the target in front of the eye box; one pose each.
        seed: seed of all random numbers.
        imperfections: errors of stage, board, lenses, extrinsics and sensors.
        stage: moving axes of the stage.
        sampling: region of camera positions: the middle plane of the eye box, or the whole eye box.
        stated_axes_deg: standard deviation of the error of the stage rotation in session.toml; the bare target is then
            photographed once. 0 if session.toml does not state the rotation.
        tracking_px: width and height of the tracking camera's photographs.
        places_mm: camera positions relative to the centre of the eye box, in the order of visits; empty to use
            `sampling`.
        family: source of the errors of stage, board and lenses: "polynomial" for `imperfections`, "workshop" for a
            `Workshop`, with which only the errors of photographs, extrinsics and stage axes come from `imperfections`.
    """

    camera_px: tuple[int, int] = (1280, 1024)
    bits: int = 8
    pupil_mm: float = 0.5
    focus_m: float = 1.0
    snr: float = 50.0
    target_depths_m: tuple[float, ...] = (0.4, 1.0)
    seed: Annotated[int, Key(most=2**32 - 1)] = 1
    imperfections: BenchImperfections = field(default_factory=BenchImperfections)
    stage: StageKind = "xyz"
    sampling: Sampling = "planar"
    stated_axes_deg: float = 0.0
    tracking_px: tuple[int, int] = (1600, 1200)
    places_mm: tuple[tuple[float, float, float], ...] = ()
    family: Family = "polynomial"

    def __post_init__(self) -> None:
        if self.family == "workshop":
            object.__setattr__(self, "imperfections", self.imperfections.of_photographs)
        if self.sampling == "volumetric" and self.stage != "xyz":
            raise BadInputError(
                f"A stage with the axes {self.stage} carries no camera through the eye box: volumetric sampling needs "
                "the stage xyz."
            )


@dataclass(frozen=True, eq=False)
class PhotoBench:
    """True poses, lenses and sensors of a bench. Device frame, metres; cameras have OpenCV's axes.

    Attributes:
        device: the headset.
        eye: "left" or "right".
        board: the target as board.toml states it.
        printed: the target as printed and mounted.
        eyeball, tracking: lenses of the camera in place of the eye, and of the headset's tracking camera.
        eyeball_sensor, tracking_sensor: sensors of these cameras.
        device_from_camera: (4, 4) pose of the eyeball camera at stage reading zero.
        stage_axes: (3, 3) displacement in the device frame = axes @ position of the stage, plus `stage_errors`.
        stage_errors: smooth errors of the stage.
        device_from_tracking: (4, 4) pose of the tracking camera.
        stated_device_from_tracking: (4, 4) pose of the tracking camera in session.toml.
        device_from_target: (k, 4, 4) poses of the target.
        options: options of the design.
        workshop: errors of the second family; None for a bench of the first family.
    """

    device: Device
    eye: str
    board: DotBoard
    printed: PrintedBoard
    eyeball: SimulatedLens
    eyeball_sensor: Sensor
    tracking: SimulatedLens
    tracking_sensor: Sensor
    device_from_camera: FloatArray
    stage_axes: FloatArray
    stage_errors: StageErrors
    device_from_tracking: FloatArray
    stated_device_from_tracking: FloatArray
    device_from_target: FloatArray
    options: PhotoBenchOptions
    workshop: Workshop | None = None

    def workshop_motion(self, commanded: FloatArray, elapsed: FloatArray, sweep: int = 0) -> FloatArray:
        """Return the errors (n, 6) of a workshop's stage and of camera warm-up, for `camera_at`; 0 without a workshop.

        Warm-up does not change the focal length here.

        Args:
            commanded: (n, 3) positions of the stage.
            elapsed: (n,) elapsed part of the session at each position, 0 to 1; positions of the same time are visited
                in the order of the rows.
            sweep: number of the sweep, for the random errors of the visits.
        """
        motion = np.zeros((len(commanded), 6))
        if self.workshop is None:
            return motion
        by_time = np.argsort(elapsed, kind="stable")
        reading = commanded[by_time]
        motion[by_time] = self.workshop.stage_motion(reading, travel_of(reading))
        motion[by_time] += self.workshop.visit_motion(len(reading), sweep)
        drift_px = self.workshop.drift_px(elapsed, np.zeros((1, 2)))[:, 0]
        right, down = (drift_px / self.eyeball.camera.focal_px).T
        in_camera = np.stack([-down, right, np.zeros_like(right)], axis=-1)
        motion[:, :3] += in_camera @ self.device_from_camera[:3, :3].T
        return motion

    @property
    def optics(self) -> EyeOptics:
        """The eye's optics."""
        return self.device.eyes[self.eye]

    def camera_at(self, position: FloatArray, error: FloatArray | None = None) -> FloatArray:
        """Return device_from_camera (4, 4) at a stage position (3,).

        Args:
            position: position of the stage, metres.
            error: (6,) rotation vector (rad) and displacement (m) in addition to the smooth errors, device frame.
        """
        motion = self.stage_errors.motion(position)
        motion = motion if error is None else motion + error
        rotation, origin = self.device_from_camera[:3, :3], self.device_from_camera[:3, 3] + self.stage_axes @ position
        return transforms.rigid(transforms.rotations_of_vectors(motion[:3]) @ rotation, origin + motion[3:])

    def eyeball_focused(self, target_pose: int) -> SimulatedLens:
        """Return the eyeball lens focused on the target, with a focal length that depends on distance (breathing)."""
        nearness = 1.0 / np.linalg.norm(self.device_from_target[:, :3, 3] - self.optics.eye_box.centre, axis=-1)
        reach = float(np.ptp(nearness))
        if reach == 0.0 or self.options.imperfections.focus_breathing == 0.0:
            return self.eyeball
        part = float(nearness[target_pose] - nearness.min()) / reach - 0.5
        camera = self.eyeball.camera
        focal = camera.focal_px * (1.0 + self.options.imperfections.focus_breathing * part)
        return replace(self.eyeball, camera=replace(camera, focal_px=focal))


@dataclass(frozen=True, eq=False)
class _Aim:
    """View of the display from the eye box.

    Attributes:
        device_from_looking: (3, 3) axes of the view: x right, y down, z towards the middle.
        half_tangents: (2,) half extent of the view, horizontal and vertical, tangents.
    """

    device_from_looking: FloatArray
    half_tangents: FloatArray

    @classmethod
    def at(cls, truth: Eye) -> "_Aim":
        field = CaptureSetup(truth).field  # refuses an invisible panel
        box, pixel = truth.eye_box, truth.display.panel.grid(15, 11).reshape(-1, 2)
        view = truth.display.view_dir_of_pixel(pixel, box.at(_CORNERS)[:, None])
        view_dir = view.value[view.usable]
        forward = dir_of_tangents(0.5 * (field.low + field.high))
        for _ in range(3):  # the middle and the axes of the view depend on each other
            looking = _looking(forward)
            tangents = (view_dir @ looking)[:, :2] / (view_dir @ looking)[:, 2:]
            low, high = tangents.min(axis=0), tangents.max(axis=0)
            forward = normalised(looking @ [*(0.5 * (low + high)), 1.0])
        return cls(looking, np.maximum(np.abs(low), np.abs(high)))

    @property
    def forward(self) -> FloatArray:
        """Unit direction (3,) of the middle of the view."""
        return np.asarray(self.device_from_looking[:, 2])


def _looking(forward: FloatArray) -> FloatArray:
    right = normalised(np.cross(forward, [0.0, 1.0, 0.0]))
    return np.stack([right, np.cross(forward, right), forward], axis=-1)


def design_photo_bench(device: Device, eye: str, options: PhotoBenchOptions = PhotoBenchOptions()) -> PhotoBench:
    """Return a bench that photographs the display's whole field, with the small errors of a real bench.

    Raises:
        BadInputError: the device has no such eye, its panel is not visible from the eye box, or the options are
            impossible.
    """
    truth = traced_eye(device, eye)
    CaptureSetup(truth, target_depths_m=options.target_depths_m)  # refuses depths that do not determine a ray
    aim, sizes = _Aim.at(truth), options.imperfections
    box = device.eyes[eye].eye_box
    stage, printing, lenses, extrinsics, sensors = (
        np.random.default_rng([options.seed, stream, int(eye == "left")])
        for stream in (_STAGE, _BOARD, _LENSES, _EXTRINSICS, _SENSORS)
    )
    pose = transforms.rigid(aim.device_from_looking @ _turned(0.4, -0.3, 0.5), box.centre)
    eyeball = _camera(options.camera_px, aim.half_tangents * _MARGIN, [-0.06, 0.02, 4e-4, -3e-4, 0.0])
    tracking = _camera(options.tracking_px, np.array([0.72, 0.54]), [-0.10, 0.03, -5e-4, 2e-4, 0.0])
    board = _board(aim, max(options.target_depths_m), eyeball)
    device_from_tracking = _tracking_pose(aim, box.centre)
    errors = [_workshop(options, number) for number in (int(eye == "left"), 2)]
    return PhotoBench(
        device=device,
        eye=eye,
        board=board,
        printed=WorkshopBoard.of(board, errors[0]) if errors[0] else PrintedBoard.draw(board, sizes, printing),
        eyeball=SimulatedLens(true_lens(eyeball, sizes, lenses), 1e-3 * options.pupil_mm, options.focus_m, errors[0]),
        eyeball_sensor=_imperfect(
            Sensor.with_snr(options.snr, options.bits, _EXPOSURE, vignetting=0.3), sizes, sensors
        ),
        tracking=SimulatedLens(true_lens(tracking, sizes, lenses), 0.8e-3, 0.8, errors[1]),
        tracking_sensor=_imperfect(Sensor.with_snr(_TRACKING_SNR, 8, _EXPOSURE, vignetting=0.3), sizes, sensors),
        device_from_camera=pose,
        stage_axes=_turned(0.2, -0.1, 0.3) @ np.diag([1.001, 0.9995, 1.0]) @ _skewed(sizes.axes_skew_mrad, stage),
        stage_errors=StageErrors.draw(sizes, half_travel(truth), stage),
        device_from_tracking=device_from_tracking,
        stated_device_from_tracking=_misstated(device_from_tracking, sizes, extrinsics),
        device_from_target=np.stack([_target_pose(aim, box.centre, depth) for depth in options.target_depths_m]),
        options=options,
        workshop=errors[0],
    )


def _workshop(options: PhotoBenchOptions, number: int) -> Workshop | None:
    """Return the workshop errors of an eye's bench (0 or 1) or of the tracking camera (2); None without a workshop."""
    if options.family == "polynomial":
        return None
    return Workshop(3 * options.seed + number)


def half_travel(truth: Eye) -> FloatArray:
    """Return the largest distances (3,) of a session's readings from the middle, metres.

    In x and y, the readings extend as far as display rays through the eye box reach in its middle plane.
    """
    size, reach = truth.eye_box.size, CaptureSetup(truth).field.reach
    return np.asarray(0.5 * size + [*(0.5 * size[2] * reach), 0.0])


def _skewed(skew_mrad: float, rng: np.random.Generator) -> FloatArray:
    """Return axes (3, 3), of unit length to first order, with each pair off a right angle by `skew_mrad`."""
    return np.asarray(np.eye(3) + 1e-3 * skew_mrad * np.triu(rng.choice([-1.0, 1.0], (3, 3)), 1))


def _misstated(true: FloatArray, sizes: BenchImperfections, rng: np.random.Generator) -> FloatArray:
    """Return a pose (4, 4) with random errors of its position and of its rotation about its origin."""
    turn, shift = rng.standard_normal((2, 3))
    rotation = transforms.rotations_of_vectors(np.deg2rad(sizes.extrinsics_deg) * turn) @ true[:3, :3]
    return transforms.rigid(rotation, true[:3, 3] + 1e-3 * sizes.extrinsics_mm * shift)


def _imperfect(sensor: Sensor, sizes: BenchImperfections, rng: np.random.Generator) -> Sensor:
    gamma = 1.0 + float(rng.choice([-1.0, 1.0])) * sizes.gamma_error
    return replace(sensor, gamma=gamma, black_clip=sizes.black_clip)


def stage_readings(bench: PhotoBench, count: int) -> FloatArray:
    """Return readings (count, 3) that cover the base plane or the eye box, rounded to micrometres as on a stage.

    Positions stated in the options are returned in their order.
    """
    if bench.options.places_mm:
        return np.round(1e-3 * np.array(bench.options.places_mm), 6)
    box = bench.optics.eye_box
    if bench.options.sampling == "volumetric":
        return np.asarray(np.round(volumetric(box, count) - box.centre, 6))
    field = CaptureSetup(traced_eye(bench.device, bench.eye)).field
    return np.asarray(np.round(planar(box, field.reach, count) - box.centre, 6))


def _camera(size_px: tuple[int, int], half_tangents: FloatArray, distortion: list[float]) -> LensCamera:
    focal = float(np.min(0.5 * np.array(size_px) / half_tangents))
    centre = 0.5 * np.array(size_px) + [5.3, -3.7]
    return LensCamera(size_px, np.array([focal, 1.0007 * focal]), centre, np.array(distortion))


def _turned(x_deg: float, y_deg: float, z_deg: float) -> FloatArray:
    return transforms.rotations_of_vectors(np.deg2rad([x_deg, y_deg, z_deg]))


def _board(aim: _Aim, depth_m: float, camera: LensCamera) -> DotBoard:
    """Return a board that fills the display's field at the farthest pose, up to the largest printable size."""
    wanted = 2 * aim.half_tangents * depth_m * _BOARD_MARGIN
    largest = _LARGEST_BOARD_M if wanted[0] >= wanted[1] else _LARGEST_BOARD_M[::-1]
    pitch = 1e-3 * np.ceil(1e3 * _PITCH_PX * depth_m / float(camera.focal_px[0]))
    columns, rows = np.maximum(np.minimum(wanted, largest) / pitch - 1, 8).astype(int)
    return design_board(int(columns), int(rows), float(pitch))


def _tracking_pose(aim: _Aim, eye: FloatArray) -> FloatArray:
    """Return the tracking camera's pose above the eye, outside the headset, facing the display's field."""
    return transforms.rigid(aim.device_from_looking @ _turned(-1.5, 2.0, -1.0), eye + [-0.012, 0.045, -0.06])


def _target_pose(aim: _Aim, eye: FloatArray, depth_m: float) -> FloatArray:
    tilt = _turned(7.0, -9.0, 1.5)
    return transforms.rigid(aim.device_from_looking @ tilt, eye + aim.forward * depth_m)
