"""A second family of bench imperfections, from function classes that models of a bench do not use.

`BenchImperfections` draws cubic curves, Brown-like lenses and quadratic boards. A workshop draws the same physical
errors from other classes: sawtooth screws, random walks, random fields and a radially oscillating lens residual. Every
error has a switch and its own stream of random numbers, so that a switch changes only that error.
"""

import zlib
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import ClassVar, Self

import numpy as np
import scipy

from wlr_render.errors import BadInputError
from wlr_render.numerics.arrays import FloatArray

SWITCHES = ("screw", "hysteresis", "abbe", "repeatability", "print", "bow", "lens", "pupil", "drift")
"""Names of the imperfections."""

# Screw: peak of the periodic error; lead screws have 10 um (precision grade) to 25 um (commercial grade) from peak to
# peak (Dover Motion, motion control handbook). Period: pitch of common screws.
_SCREW_UM, _SCREW_PERIOD_MM = (5.0, 10.0), (1.0, 2.0)
# Hysteresis: difference between the two directions of travel; assumption: a worn anti-backlash nut
_HYSTERESIS_UM = 5.0
# Pitch, yaw and roll over 20 mm, peak to valley; assumption: data sheets of crossed-roller stages state tens of urad
_TURN_URAD, _TURN_TRAVEL_M, _KNOT_M = (30.0, 60.0), 0.020, 0.0025
ARM_M = np.array([0.02, 0.08, 0.05])
"""Arm (m) from the carriage's guide to the pupil, which rotations displace; assumption: a camera on a bracket."""
# Repeatability of a visit, standard deviations per axis. A single axis has 1 um (data sheet of Optimal Engineering
# Systems); assumption: three axes, a load and a cable.
SHIFT_UM, WOBBLE_URAD, _WOBBLE_CORRELATION = 5.0, 15.0, 0.7
# Print, rms per axis: assumption, a small part of the line accuracy of plotters, 0.1 % (data sheets of HP DesignJet)
_PRINT_MM, _PRINT_LENGTH_M, _PRINT_WAVES = (0.03, 0.08), 0.08, 300
# Feed: one swath of a print head of 0.85 inch, and the rms error of its position; printers correct only the mean feed
# (United States patent on line feed error by roller diameters, Hewlett-Packard); size: assumption
_SWATH_M, _FEED_MM = 0.0216, 0.03
_SHEET_M = 0.6  # half the side of the sheet over which print errors have the stated rms
# Board: range of the heights; assumption. Composite plates above 0.8 x 0.6 m need a frame to stay flat (calib.io,
# "Calibration target substrates 101").
_BOW_MM = (0.1, 0.3)
# Lens: rms residual of parametric models; assumption. The pattern is systematic and not radial (Schoeps et al., "Why
# having 10,000 parameters in your camera model is better than twelve", CVPR 2020).
_LENS_PX = (0.1, 0.2)
# Pupil: travel along the axis from middle to corner; assumption: a tenth of the travel in fisheye lenses ("Calibration
# of fisheye camera using entrance pupil", arXiv 1907.01759)
_PUPIL_MM = (0.05, 0.2)
# Drift: shift of the image from first to last photograph, change of scale at the corner in parts of the shift, and time
# constant in parts of the session. Sensors of 3.45 um per pixel move by 3 um per kelvin of self-heating ("Modeling of
# systematic errors in stereo-digital image correlation due to camera self-heating", Scientific Reports 9, 2019).
_DRIFT_PX, _FOCAL_DRIFT, _DRIFT_TIME = (0.3, 0.5), 0.5, 1.0 / 3.0

TAIL_DEGREES = 4.0
"""Degrees of freedom of Student's t distribution, for random errors; assumption."""
PICTURE = np.stack(np.meshgrid(np.linspace(-0.8, 0.8, 25), np.linspace(-0.6, 0.6, 19)), axis=-1).reshape(-1, 2)
"""Image positions (n, 2) over the whole picture, in half diagonals."""
_BEYOND = 1.5  # distance from the middle up to which the board's shape continues, in half sizes of the board
_SQUARE = np.stack(np.meshgrid(*[np.linspace(-1.0, 1.0, 41)] * 2), axis=-1).reshape(-1, 2)


@dataclass(frozen=True)
class Workshop:
    """The imperfections of one bench, drawn from a seed.

    Attributes:
        seed: seed of all errors.
        level: common factor on all sizes: 1 for ordinary equipment, 0 for a perfect bench.
        switches: names of the active imperfections, from `SWITCHES`.

    Raises:
        BadInputError: a switch is unknown, or the level is negative.
    """

    seed: int
    level: float = 1.0
    switches: frozenset[str] = field(default_factory=lambda: frozenset(SWITCHES))
    KNOWN: ClassVar[tuple[str, ...]] = SWITCHES

    def __post_init__(self) -> None:
        object.__setattr__(self, "switches", frozenset(self.switches))
        if unknown := sorted(self.switches - set(self.KNOWN)):
            raise BadInputError(f"workshop: unknown imperfection '{unknown[0]}'; choose from {', '.join(self.KNOWN)}.")
        if not 0.0 <= self.level < np.inf:
            raise BadInputError(f"workshop: 'level' is {self.level}; give 0 or more.")

    def only(self, *names: str) -> Self:
        """Return the same bench with only these imperfections."""
        return replace(self, switches=frozenset(names))

    def without(self, *names: str) -> Self:
        """Return the same bench without these imperfections."""
        return replace(self, switches=self.switches - self.only(*names).switches)

    def stage_motion(self, reading: FloatArray, travel: FloatArray) -> FloatArray:
        """Return the repeatable error (m, 6) of the stage: rotation vector (rad) and displacement of the pupil (m).

        Args:
            reading: (m, 3) stage readings, metres.
            travel: (m, 3) direction of the last move along each axis, +1 or -1.
        """
        turn = 1e-6 * self._factor("abbe") * np.sum([c(r) for c, r in zip(self._turns, reading.T, strict=True)], axis=0)
        screw = 1e-6 * self._factor("screw") * self._screw_um(reading)
        hysteresis = 0.5e-6 * self._factor("hysteresis") * _HYSTERESIS_UM * travel
        return np.concatenate([turn, screw + hysteresis + np.cross(turn, ARM_M)], axis=1)

    def visit_motion(self, count: int, sweep: int) -> FloatArray:
        """Return the random motion (count, 6) in visits of a sweep, with correlated successive rotations."""
        rng = self._rng(f"repeatability {sweep}")
        shock, shift = student(rng, (count, 3)), student(rng, (count, 3))
        turn, kept = shock.copy(), _WOBBLE_CORRELATION
        for visit in range(1, count):
            turn[visit] = kept * turn[visit - 1] + np.sqrt(1.0 - kept**2) * shock[visit]
        return 1e-6 * self._factor("repeatability") * np.concatenate([WOBBLE_URAD * turn, SHIFT_UM * shift], axis=1)

    def drift_px(self, part: FloatArray, unit: FloatArray) -> FloatArray:
        """Return the image drift (m, n, 2), pixels, as direction and focal length change during warm-up.

        The mean over the session is 0, because calibration of the bench determines the mean camera.

        Args:
            part: (m,) elapsed part of the session.
            unit: (n, 2) or (m, n, 2) image positions from the middle, in half diagonals of the picture.
        """
        rng = self._rng("drift")
        size, angle, sign = rng.uniform(*_DRIFT_PX), rng.uniform(0.0, 2.0 * np.pi), rng.choice([-1.0, 1.0])
        cold = np.exp(-1.0 / _DRIFT_TIME)
        warm = _DRIFT_TIME - np.exp(-part / _DRIFT_TIME) / (1.0 - cold)
        whole = np.array([np.cos(angle), np.sin(angle)]) + sign * _FOCAL_DRIFT * unit
        return np.asarray(self._factor("drift") * size * warm[:, None, None] * whole)

    def lens_px(self, unit: FloatArray) -> FloatArray:
        """Return the lens residual (..., 2), pixels, at image positions (..., 2) in half diagonals of the picture."""
        size = self._rng("lens").uniform(*_LENS_PX) / rms(self._lens_shape(PICTURE))
        return np.asarray(self._factor("lens") * size * self._lens_shape(unit))

    def pupil_m(self, unit: FloatArray) -> FloatArray:
        """Return the travel (...) of the entrance pupil along the axis, metres, at image positions (..., 2)."""
        rim = self._rng("pupil").uniform(*_PUPIL_MM)
        shape = (np.cosh(2.0 * radius_of(unit)) - 1.0) / (np.cosh(2.0) - 1.0)
        return np.asarray(1e-3 * self._factor("pupil") * rim * shape)

    def printed_m(self, place: FloatArray) -> FloatArray:
        """Return displacements (..., 2) of the print, metres, at positions (..., 2) from the board's middle."""
        if not self._factor("print"):
            return np.zeros(np.shape(place))
        mean, rms = self._sheet
        smooth = (self._print_shape(place) - mean) * self._rng("print").uniform(*_PRINT_MM) / rms
        feed = np.stack([np.zeros_like(place[..., 1]), _FEED_MM * self._feed_shape(place[..., 1])], axis=-1)
        return np.asarray(1e-3 * self._factor("print") * (smooth + feed))

    def height_m(self, unit: FloatArray) -> FloatArray:
        """Return heights (...) of the board, metres, at positions (..., 2) in the board's half widths and half heights.

        The best-fitting plane is subtracted, because a lab measures the board's pose. Far beyond the board, the height
        is constant.
        """
        unit = np.clip(unit, -_BEYOND, _BEYOND)
        plane, span = self._board_plane
        size = self._rng("bow").uniform(*_BOW_MM) / span
        return np.asarray(1e-3 * self._factor("bow") * size * (self._board_shape(unit) - unit @ plane[:2] - plane[2]))

    def _factor(self, name: str) -> float:
        return self.level if name in self.switches else 0.0

    def _rng(self, name: str) -> np.random.Generator:
        return np.random.default_rng([self.seed, zlib.crc32(name.encode())])

    def _screw_um(self, reading: FloatArray) -> FloatArray:
        """Return the periodic screw error (m, 3) along each axis, micrometres."""
        rng = self._rng("screw")
        peak, period = rng.uniform(*_SCREW_UM, 3), rng.uniform(*_SCREW_PERIOD_MM, 3)
        phase = rng.uniform(0.0, 2.0 * np.pi, (3, 3))
        one_turn = np.linspace(0.0, 2.0 * np.pi, 721)[:, None]
        shape = _screw_shape(2e3 * np.pi * reading / period, phase)
        return np.asarray(peak * shape / np.abs(_screw_shape(one_turn, phase)).max(axis=0))

    @cached_property
    def _turns(self) -> "list[scipy.interpolate.PchipInterpolator]":
        """Rotation vector (3,), urad, by the reading of each axis: a random walk over knots, and a step; 0 at 0."""
        rng, half = self._rng("abbe"), 0.5 * _TURN_TRAVEL_M
        knots = np.arange(-4.0 * half, 4.0 * half + _KNOT_M, _KNOT_M)
        curves = []
        for _ in range(3):
            step = np.tanh((knots[:, None] - rng.uniform(-half, half, 3)) / _KNOT_M) * rng.choice([-2.0, 2.0], 3)
            walk = np.cumsum(rng.standard_normal((len(knots), 3)), axis=0) + step
            curve = scipy.interpolate.PchipInterpolator(knots, walk)
            span = np.ptp(curve(np.linspace(-half, half, 81)), axis=0)
            curves.append(
                scipy.interpolate.PchipInterpolator(knots, (walk - curve(0.0)) * rng.uniform(*_TURN_URAD, 3) / span)
            )
        return curves

    def _lens_shape(self, unit: FloatArray) -> FloatArray:
        """Return tangential, thin-prism and radially oscillating distortion (..., 2), of equal rms over the picture."""
        rng = self._rng("lens shape")
        p, s, turns, phase = rng.normal(size=2), rng.normal(size=(2, 2)), rng.uniform(1.5, 2.5), rng.uniform(0, 6.28)

        def parts(unit: FloatArray) -> list[FloatArray]:
            square = np.sum(unit**2, axis=-1, keepdims=True)
            tangential = p * square + 2.0 * unit * np.sum(p * unit, axis=-1, keepdims=True)
            ripple = unit * np.cos(2.0 * np.pi * turns * np.sqrt(square) + phase)
            return [tangential, s[0] * square + s[1] * square**2, ripple]

        return np.asarray(sum(part / rms(full) for part, full in zip(parts(unit), parts(PICTURE), strict=True)))

    @cached_property
    def _sheet(self) -> tuple[FloatArray, float]:
        """Mean (2,) and rms of the print's shape over the sheet."""
        shape = self._print_shape(_SHEET_M * _SQUARE)
        mean = np.asarray(shape.mean(axis=0))
        return mean, rms(shape - mean)

    def _print_shape(self, place: FloatArray) -> FloatArray:
        """Return a random field (..., 2) with a Matern 5/2 spectrum, by random Fourier features."""
        rng = self._rng("print shape")
        wave = rng.standard_normal((2, 2, _PRINT_WAVES)) / np.sqrt(rng.chisquare(5.0, (2, 1, _PRINT_WAVES)) / 5.0)
        phase = rng.uniform(0.0, 2.0 * np.pi, (2, _PRINT_WAVES))
        return np.stack([np.cos(place @ wave[k] / _PRINT_LENGTH_M + phase[k]).sum(axis=-1) for k in (0, 1)], axis=-1)

    def _feed_shape(self, y: FloatArray) -> FloatArray:
        """Return the error (...) of the paper feed: constant in each swath, correlated from swath to swath, rms 1."""
        error, middle = self._rng("feed").standard_normal(401), 200
        for swath in range(1, len(error)):
            error[swath] += 0.8 * error[swath - 1]
        sheet = error[middle - round(_SHEET_M / _SWATH_M) : middle + round(_SHEET_M / _SWATH_M)]
        swath = np.clip(np.floor(y / _SWATH_M) + middle, 0, len(error) - 1).astype(np.intp)
        return np.asarray((error[swath] - sheet.mean()) / sheet.std())

    @cached_property
    def _board_plane(self) -> tuple[FloatArray, float]:
        """Slopes and offset (3,) of the plane that fits the board's shape, and the range of the residual."""
        design = np.column_stack([_SQUARE, np.ones(len(_SQUARE))])
        shape = self._board_shape(_SQUARE)
        plane = np.linalg.lstsq(design, shape, rcond=None)[0]
        return np.asarray(plane), float(np.ptp(shape - design @ plane))

    def _board_shape(self, unit: FloatArray) -> FloatArray:
        """Return the sum (...) of a bow along a random direction, a curled edge and a dent."""
        rng = self._rng("bow shape")
        angle, centre, sign = rng.uniform(0.0, 2.0 * np.pi, 2), rng.uniform(-0.6, 0.6, 2), rng.choice([-1.0, 1.0], 3)
        across, towards = (unit @ np.array([np.cos(each), np.sin(each)]) for each in angle)
        bow, curl = np.cosh(1.5 * across) / np.cosh(1.5), np.exp((towards - 1.0) / 0.3)
        dent = 1.0 / (1.0 + np.sum((unit - centre) ** 2, axis=-1) / 0.3**2)
        return np.asarray(sign[0] * bow + 0.5 * sign[1] * curl + 0.5 * sign[2] * dent)


def travel_of(reading: FloatArray) -> FloatArray:
    """Return the direction (m, 3) of the last move along each axis, +1 or -1; the first one is +1."""
    step = np.sign(np.diff(reading, axis=0, prepend=-np.ones((1, reading.shape[1]))))
    for visit in range(1, len(step)):
        step[visit] = np.where(step[visit] == 0.0, step[visit - 1], step[visit])
    return np.asarray(step)


def _screw_shape(turned: FloatArray, phase: FloatArray) -> FloatArray:
    """Return the sum (m, 3) of a sine, its second harmonic and a rounded sawtooth, with phases (3, 3)."""
    saw = turned + phase[2]
    sawtooth = np.arctan2(0.9 * np.sin(saw), 1.0 - 0.9 * np.cos(saw))
    return np.asarray(np.sin(turned + phase[0]) + 0.35 * np.sin(2.0 * turned + phase[1]) + 0.5 * sawtooth)


def student(rng: np.random.Generator, shape: tuple[int, ...], degrees: float = TAIL_DEGREES) -> FloatArray:
    """Draw numbers with variance 1 from Student's t distribution; infinite degrees of freedom give Gaussian numbers."""
    if np.isinf(degrees):
        return rng.standard_normal(shape)
    return np.asarray(rng.standard_t(degrees, shape) * np.sqrt((degrees - 2.0) / degrees))


def radius_of(unit: FloatArray) -> FloatArray:
    """Return the distances (...) of positions (..., 2) from the middle."""
    return np.asarray(np.linalg.norm(unit, axis=-1))


def rms(values: FloatArray) -> float:
    """Return the root mean square of all values."""
    return float(np.sqrt(np.mean(np.square(values))))
