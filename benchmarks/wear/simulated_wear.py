"""Half an hour of simulated wear: slips, a warming panel, an eye tracker with errors, and a wearer who clicks.

The truth is the traced headset. The simulation has effects that the estimator does not model: the tracker's error
depends on the gaze; the drifts of the tracker and of the panel are not random walks; a slip changes the tracker's error
by a share of the slip; the errors of the wearer's clicks have heavy tails; and the models are fitted to captures with
noise and stage errors.
"""

from dataclasses import dataclass, replace

import numpy as np

from wlr_render.calibration.fit_eye import calibrate
from wlr_render.calibration.self_calibration import Clicks, WearSettings, WearState
from wlr_render.captures.correspondences import Captures
from wlr_render.errors import BadInputError
from wlr_render.evaluation.misalignment import misalignment_arcmin
from wlr_render.geometry import directions, transforms
from wlr_render.geometry.directions import ARCMIN
from wlr_render.mappings import Eye, EyeBox
from wlr_render.models.moved_panel import MovedPanelDisplay
from wlr_render.models.registration import right_and_up
from wlr_render.numerics.arrays import FloatArray
from wlr_render.optics.device_file import load_device
from wlr_render.optics.traced_mappings import traced_eye
from wlr_render.simulation.capture_setup import CaptureSetup
from wlr_render.simulation.simulate_captures import simulate_display, simulate_see_through
from wlr_render.tracking.eye_model import RotatingEye

MINUTES, SLIPS, MOST_CLICKS = 30.0, 3, 8
SLIP_M = 1e-3, 4e-3
"""Shortest and longest slip: the larger of those measured for head-worn glasses in everyday tasks, 0.26 to 4.05 mm
for 35 wearers ("Slippage of head-worn glasses during real-world behavior: an examination, dataset and testing
protocol")."""
EYE_BOX_M = np.array([0.016, 0.012, 0.008])
"""Size of the eye box, larger than the devices' own so that the eye stays in it after slips."""
_CAPTURES = 25
_DEPTHS_M = 0.4, 1.0, 3.0
_CLICK_DEPTHS_M = 0.4, 2.0, 0.6, 4.0, 1.0
_FIELD_SHARE = 0.85
_MOST_TURN = np.sin(np.deg2rad(15.0))  # sine of the largest turn of the eye; beyond it, wearers turn the head
_LEAST_BETWEEN_MIN = 4.0
_WARM_MIN = 10.0


@dataclass(frozen=True)
class Wear:
    """Sizes of the errors during wear.

    Attributes:
        click_arcmin: scatter of clicks per axis.
        unseen: share of a slip that the eye tracker does not detect; 1 for a headset without an eye tracker.
        fitting_m: error of the tracked viewpoint per axis when the headset is put on.
        by_gaze: change of that error per metre that the pupil moves.
        noise_m: noise of one sample of the eye tracker.
        drift_m: drift of the eye tracker over the half hour.
        shift_px, growth: shift and relative growth of the warm panel.
        turn_arcmin: rotation error of the head tracker; it changes by half as much during the half hour.
        pointing_arcmin: the wearer's constant error per axis.
        wrong: share of clicks that are wrong by a third of a degree to a degree.
    """

    click_arcmin: float = 2.0
    unseen: float = 0.5
    fitting_m: float = 0.7e-3
    by_gaze: float = 0.04
    noise_m: float = 0.1e-3
    drift_m: float = 0.2e-3
    shift_px: float = 2.0
    growth: float = 0.5e-3
    turn_arcmin: float = 0.5
    pointing_arcmin: float = 0.5
    wrong: float = 0.03


@dataclass(frozen=True)
class Slip:
    """Misalignments around one slip, rms in arcminutes over field and depth.

    Attributes:
        minute: time of the slip.
        before: misalignment just before the slip.
        after: misalignments after the slip and 0, 1, ..., MOST_CLICKS clicks.
        predicted: the same, as predicted by the state.
        uncorrected: misalignment after the slip with only the calibrated models and the tracked viewpoint.
        is_named: whether exactly the wrong clicks were named as outliers in the end; None without wrong clicks.
    """

    minute: float
    before: float
    after: tuple[float, ...]
    predicted: tuple[float, ...]
    uncorrected: float
    is_named: bool | None


@dataclass(frozen=True)
class WearResult:
    """The result of one half hour of wear.

    Attributes:
        minutes: times.
        corrected, uncorrected: misalignments at those times, rms in arcminutes.
        slips: slips in order of time.
    """

    minutes: tuple[float, ...]
    corrected: tuple[float, ...]
    uncorrected: tuple[float, ...]
    slips: tuple[Slip, ...]


def worn_eye(device: str) -> Eye:
    """Return the traced right eye of a shipped device, with the larger eye box."""
    truth = traced_eye(load_device(device), "right")
    return replace(truth, eye_box=EyeBox(truth.eye_box.centre, EYE_BOX_M))


def calibrated(truth: Eye, rng: np.random.Generator) -> Eye:
    """Return models fitted to simulated captures with noise of 0.25' and stage errors of 10 um and 30 urad."""
    setup = CaptureSetup(truth, 0.25, 10e-6, truth.field, stage_turn_rad=30e-6)
    positions = setup.camera_positions("planar", _CAPTURES)
    captures = Captures(simulate_display(setup, positions, rng), simulate_see_through(setup, positions, rng))
    return replace(calibrate(captures).mappings, field=truth.field)


class Wearer:
    """The true state of a headset on a head over time."""

    def __init__(self, truth: Eye, wear: Wear, rng: np.random.Generator) -> None:
        self._truth, self._wear, self._rng = truth, wear, rng
        self._bias_m = rng.normal(0.0, wear.fitting_m, 3)
        self._by_gaze = rng.normal(0.0, wear.by_gaze, (3, 3))
        self._drift_m = rng.normal(0.0, wear.drift_m, 3)
        self._shift_px = wear.shift_px * directions.normalised(rng.normal(size=2)) * rng.uniform(0.5, 1.0)
        self._growth = rng.normal(0.0, wear.growth)
        self._turn = rng.normal(0.0, wear.turn_arcmin * ARCMIN, (2, 3))
        self._pointing = rng.normal(0.0, wear.pointing_arcmin, 2)
        self._position_m = np.zeros(3)
        self.minute = 0.0

    def slip(self) -> None:
        """Move the headset on the head."""
        room = 0.5 * EYE_BOX_M - 0.0105 * _MOST_TURN * np.array([1.0, 1.0, 0.2])
        while True:
            step = self._rng.uniform(*SLIP_M) * directions.normalised(self._rng.normal(size=3))
            if np.all(np.abs(self._position_m + step) <= room):
                break
        self._position_m = self._position_m + step
        self._bias_m = self._bias_m - self._wear.unseen * step

    @property
    def _now(self) -> Eye:
        warmth = 1.0 - np.exp(-self.minute / _WARM_MIN)
        return replace(
            self._truth,
            display=MovedPanelDisplay(self._truth.display, warmth * self._shift_px, warmth * self._growth),
        )

    def _seen(self, direction: FloatArray, depth_m: FloatArray) -> tuple[FloatArray, FloatArray, FloatArray]:
        """Return true pupils, tracked pupils without noise, and points, (n, 3) each, for a wearer who looks at dots."""
        ahead = self._truth.eye_box.centre
        eye = RotatingEye.looking_ahead_from(ahead + self._position_m)
        sine = np.linalg.norm(direction[:, :2], axis=1, keepdims=True)
        across = direction[:, :2] * (_MOST_TURN / np.maximum(sine, _MOST_TURN))
        gaze = np.concatenate([across, -np.sqrt(1.0 - np.sum(across**2, axis=1, keepdims=True))], axis=1)
        pupil = eye.viewpoint_of_gaze(gaze)
        travel = pupil - (ahead + self._position_m)
        share = self.minute / MINUTES
        tracked = pupil + self._bias_m + share * self._drift_m + travel @ self._by_gaze.T
        ray = self._truth.see_through.real_ray_of_view_dir(direction, pupil).value
        start, along = ray[:, :3], ray[:, 3:]
        step = (pupil[:, 2] - depth_m - start[:, 2]) / along[:, 2]
        return pupil, tracked, start + step[:, None] * along

    def _as_tracked(self, point: FloatArray) -> FloatArray:
        """Return points in the frame of the head tracker."""
        turn = self._turn[0] + self.minute / MINUTES * 0.5 * self._turn[1]
        return np.asarray(point @ transforms.rotations_of_vectors(turn))

    def clicks(self, count: int) -> tuple[Clicks, tuple[int, ...]]:
        """Return clicks at dots of several depths all over the field, and the numbers of the wrong clicks."""
        low, high = _inner_field(self._truth)
        found: list[tuple[FloatArray, FloatArray, FloatArray]] = []
        wrong = []
        while len(found) < count:
            depth = np.array([_CLICK_DEPTHS_M[len(found) % len(_CLICK_DEPTHS_M)]])
            direction = directions.dir_of_tangents(self._rng.uniform(low, high, (1, 2)))
            pupil, tracked, point = self._seen(direction, depth)
            error = self._pointing + self._rng.normal(0.0, self._wear.click_arcmin, 2)
            is_wrong = self._rng.uniform() < self._wear.wrong
            if is_wrong:
                error = error + self._rng.uniform(20.0, 60.0) * directions.normalised(self._rng.normal(size=2))
            aimed = directions.normalised(direction + (error * ARCMIN) @ right_and_up(direction)[0])
            shown = self._now.display.pixel_of_view_dir(aimed, pupil)
            if shown.ok.all() and np.all((shown.value > 0) & (shown.value < self._truth.display.panel.size_px)):
                wrong += [len(found)] if is_wrong else []
                sample = tracked + self._rng.normal(0.0, self._wear.noise_m, (1, 3))
                found.append((shown.value, self._as_tracked(point), sample))
        pixel, points, samples = (np.concatenate(each) for each in zip(*found, strict=True))
        return Clicks(pixel, points, samples), tuple(wrong)

    def misalignment(self, state: WearState) -> tuple[float, float]:
        """Return the true and the predicted rms over field and depth in arcminutes, without the tracker's noise."""
        low, high = _inner_field(self._truth)
        tangents = np.stack(np.meshgrid(*np.linspace(low, high, 4).T), axis=-1).reshape(-1, 2)
        direction = np.repeat(directions.dir_of_tangents(tangents), len(_DEPTHS_M), axis=0)
        pupil, tracked, point = self._seen(direction, np.tile(_DEPTHS_M, len(tangents)))
        as_tracked = self._as_tracked(point)
        pixel = state.pixel(as_tracked, tracked)
        size = self._truth.display.panel.size_px
        on_panel = np.all((pixel >= 0) & (pixel <= size), axis=1)
        error = misalignment_arcmin(self._now, pupil, np.where(on_panel[:, None], pixel, np.nan), point)
        kept = np.isfinite(error)
        predicted = state.sigma_arcmin(as_tracked[kept], tracked[kept])
        return float(np.sqrt(np.mean(error[kept] ** 2))), float(np.sqrt(np.mean(predicted**2)))


def _inner_field(truth: Eye) -> tuple[FloatArray, FloatArray]:
    assert truth.field is not None
    middle, half = 0.5 * (truth.field.low + truth.field.high), 0.5 * (truth.field.high - truth.field.low)
    return middle - _FIELD_SHARE * half, middle + _FIELD_SHARE * half


def _after(state: WearState, clicks: Clicks, count: int) -> WearState:
    """Return the state after the first clicks; unchanged if they are refused because they contradict each other."""
    try:
        return state.updated(Clicks(clicks.pixel[:count], clicks.point[:count], clicks.viewpoint[:count]))
    except BadInputError:
        return state


def half_hour(truth: Eye, models: Eye, wear: Wear, rng: np.random.Generator) -> WearResult:
    """Simulate wear: clicks when the headset is put on, then slips, each unannounced and followed by clicks."""
    wearer = Wearer(truth, wear, rng)
    never = WearState.begin(models)
    state = WearState.begin(models, WearSettings(click_arcmin=wear.click_arcmin))
    state = _after(state, wearer.clicks(MOST_CLICKS)[0], MOST_CLICKS)
    gaps = rng.dirichlet(np.ones(SLIPS + 1)) * (MINUTES - (SLIPS + 1) * _LEAST_BETWEEN_MIN) + _LEAST_BETWEEN_MIN
    slips = []
    time: list[tuple[float, float, float]] = []

    def record() -> None:
        time.append((wearer.minute, wearer.misalignment(state)[0], wearer.misalignment(never)[0]))

    record()
    for gap in gaps[:-1]:
        start = wearer.minute
        for part in (0.5, 1.0):
            wearer.minute = float(start + part * gap)
            record()
        before = time[-1][1]
        state = state.carried(60.0 * gap)
        wearer.slip()
        record()
        clicks, wrong = wearer.clicks(MOST_CLICKS)
        # Each number of clicks is one update of the same state, as if the wearer stopped at that number.
        states = [state, *(_after(state, clicks, count) for count in range(1, MOST_CLICKS + 1))]
        true, predicted = zip(*(wearer.misalignment(each) for each in states), strict=True)
        named = set(wrong) == set(states[-1].outliers) if wrong else None
        slips.append(Slip(wearer.minute, before, tuple(true), tuple(predicted), time[-1][2], named))
        state = states[-1]
        record()
    start = wearer.minute
    for part in (0.5, 1.0):
        wearer.minute = float(start + part * gaps[-1])
        record()
    minutes, corrected, uncorrected = (tuple(each) for each in zip(*time, strict=True))
    return WearResult(minutes, corrected, uncorrected, tuple(slips))
