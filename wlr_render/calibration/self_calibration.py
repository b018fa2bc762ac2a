"""Self-calibration in use: estimates, from a few clicks, of the parameters that change while a headset is worn.

A click is a real point and the panel pixel that the wearer sees on it: the wearer moved a drawn dot there, or a camera
behind the optics found it. With the tracked viewpoint v, the display direction D and the see-through direction S, it
states

    D(pixel + shift + growth (pixel - middle), v + offset) = S(turn point, v + offset) + pointing + noise

    offset    of the entrance pupil from the tracked one, which a slip of the headset changes
    shift     of the panel's light, and its growth about the panel's middle, due to warming
    turn      of the headset against its head tracker
    pointing  the wearer's own constant error, which is estimated and never corrected

Shift, the turn about x and y, and pointing are nearly degenerate: the priors divide a constant angle among them. Only
dots at several depths separate offset from shift, and growth from an offset along z. An update is the Gaussian maximum
a posteriori by Gauss-Newton steps; evidence detects wrong clicks and unannounced slips. Errors of the models are equal
in all clicks at one place: they enter through the models' own covariance, with the correlation between clicks.
"""

import math
from dataclasses import dataclass, replace

import numpy as np
import scipy

from wlr_render.errors import BadInputError
from wlr_render.geometry import transforms
from wlr_render.geometry.directions import ARCMIN, arcmin_between
from wlr_render.io.input_files import shown
from wlr_render.mappings import Eye
from wlr_render.models.fitted_model import FittedDisplay, FittedSeeThrough
from wlr_render.models.moved_panel import MovedPanelDisplay, pixel_at_calibration
from wlr_render.models.registration import registration_changes, right_and_up
from wlr_render.numerics.arrays import FloatArray, finite_array
from wlr_render.numerics.wrong_pairs import wrong_pairs

OFFSET, SHIFT, GROWTH, TURN, POINTING = slice(0, 3), slice(3, 5), slice(5, 6), slice(6, 9), slice(9, 11)
"""Slices of the vector of parameters, in metres, pixels, a ratio, radians and arcminutes."""
PARAMETERS = 11

_STEPS = np.repeat([1e-5, 1e-2, 1e-5, 1e-5, 1e-2], [3, 2, 1, 3, 2])  # steps of central differences, per parameter
_ITERATIONS = 30  # most steps of Gauss-Newton
_STILL_ARCMIN = 1e-7  # change of the predicted clicks below which the iteration ends
_SETTLED = 0.01  # largest last change of a usable result, in the scatter of a click; it adds 1 % of the error
_NEAREST_M, _FARTHEST_M = 0.05, 100.0  # distances of real points that a wearer clicks on; others are in another unit
_FAR_FROM_BOX_M = 0.05  # largest distance of a pupil from the eye box, ten slips; beyond it, frame or unit is wrong
_FARTHEST_CLICK_ARCMIN = 300.0  # largest error of a click; beyond 5 degrees, pixel and point do not belong together
_LEAST_SIGMA_ARCMIN = 0.05  # least sigma of a click; a smaller one is implausible and lost to rounding


@dataclass(frozen=True)
class WearSettings:
    """Standard deviations, per axis, of the parameters that change in use, and properties of wrong clicks and slips.

    A standard deviation of zero keeps a parameter fixed.

    Attributes:
        offset_m: offset of the tracked viewpoint when the headset is put on, for a previously calibrated eye tracker.
        shift_px: shift of the panel, due to play of the mount and a day's temperatures.
        growth: growth of the panel: a pixel at the border of a panel of 2000 pixels.
        turn_arcmin: rotation of the head tracker relative to the headset.
        pointing_arcmin: constant error of the wearer, which limits estimates of a constant angle from clicks.
        tracking_m: error of the tracked viewpoint from click to click: noise, and errors that follow the gaze.
        slip_m: change of the offset by a slip. Glasses slip by 0.26 to 4.05 mm in everyday tasks ("Slippage of
            head-worn glasses during real-world behavior": 35 wearers, 10 tasks).
        offset_drift_m, shift_drift_px, growth_drift, turn_drift_arcmin: drift of these parameters in an hour, growing
            with the square root of time; 2 px for a panel that warms is an assumption.
        click_arcmin: scatter of a click. Crosshairs that a wearer moves with the head scatter by 6' to 12' over both
            axes (docs/measured-data.md, alignments of a wearer); a dot that is nudged moves by pixels of 1' to 2'.
        outlier_share: share of wrong clicks.
        outlier_arcmin: scatter of wrong clicks, on another dot or before the dot was moved.
        slip_share: share of updates after a slip for which `slipped` was not called; wearers mostly click when they
            have noticed an error.
    """

    offset_m: float = 1e-3
    shift_px: float = 2.0
    growth: float = 1e-3
    turn_arcmin: float = 1.0
    pointing_arcmin: float = 0.5
    tracking_m: float = 0.15e-3
    slip_m: float = 1.5e-3
    offset_drift_m: float = 0.3e-3
    shift_drift_px: float = 2.0
    growth_drift: float = 0.5e-3
    turn_drift_arcmin: float = 0.5
    click_arcmin: float = 2.0
    outlier_share: float = 0.02
    outlier_arcmin: float = 30.0
    slip_share: float = 0.5

    def __post_init__(self) -> None:
        for name, value in vars(self).items():
            finite_array(value, (), name, "zero or a positive number")
            if value < 0:
                raise BadInputError(f"{name} is {value:g}; a standard deviation or a share is zero or positive.")
            if name.endswith("_m") and value > 0.02:
                raise BadInputError(f"{name} is {value:g} m; is it in millimetres? Give metres, at most 0.02.")
        if not 0 < self.outlier_share < 0.5 or not 0 < self.slip_share < 1:
            raise BadInputError("outlier_share must lie between 0 and 0.5, slip_share between 0 and 1.")

    @property
    def at_start(self) -> FloatArray:
        """Variances (PARAMETERS,) when the headset is put on."""
        return _variances(self.offset_m, self.shift_px, self.growth, self.turn_arcmin, self.pointing_arcmin)

    @property
    def per_hour(self) -> FloatArray:
        """Variances (PARAMETERS,) added per hour."""
        return _variances(self.offset_drift_m, self.shift_drift_px, self.growth_drift, self.turn_drift_arcmin, 0.0)

    @property
    def by_slip(self) -> FloatArray:
        """Variances (PARAMETERS,) added by a slip."""
        return _variances(self.slip_m, 0.0, 0.0, 0.0, 0.0)


def _variances(offset_m: float, shift_px: float, growth: float, turn_arcmin: float, pointing: float) -> FloatArray:
    return np.repeat([offset_m, shift_px, growth, turn_arcmin * ARCMIN, pointing], [3, 2, 1, 3, 2]) ** 2


PANEL_KEPT = WearSettings(
    shift_px=0.0, growth=0.0, shift_drift_px=0.0, growth_drift=0.0, turn_arcmin=4.0, turn_drift_arcmin=4.0
)
"""Settings that keep the calibrated models: a shift of the panel is described as a turn, which is nearly equivalent."""


@dataclass(frozen=True, eq=False)
class Clicks:
    """Panel pixels that a wearer sees on real points.

    Attributes:
        pixel: (n, 2) panel pixels.
        point: (n, 3) real points in the device frame according to the head tracker, metres.
        viewpoint: (n, 3) entrance pupils according to the eye tracker, device frame, metres; or (3,) for all clicks.
    """

    pixel: FloatArray
    point: FloatArray
    viewpoint: FloatArray

    def __post_init__(self) -> None:
        count = len(self.pixel) if np.ndim(self.pixel) == 2 else 0
        if not count:
            raise BadInputError("there is no click; give pixels (n, 2) and points (n, 3) of at least one.")
        if np.shape(self.viewpoint) == (3,):
            object.__setattr__(self, "viewpoint", np.tile(self.viewpoint, (count, 1)))
        for name, size in {"pixel": 2, "point": 3, "viewpoint": 3}.items():
            wanted = f"{size} finite numbers for each of the {count} clicks"
            array = finite_array(getattr(self, name), (count, size), f"the {name} of the clicks", wanted)
            object.__setattr__(self, name, array)


@dataclass(frozen=True, eq=False)
class WearState:
    """Gaussian state of the parameters that change after the calibration of one eye; `begin` makes the first state.

    Draw with `viewpoint`, `pose` and `corrected` in place of the tracked viewpoint, the tracked pose and the calibrated
    mappings.

    Attributes:
        calibrated: the calibrated mappings.
        settings: expected sizes of the changes.
        mean: (PARAMETERS,) mean of the parameters, see the module's slices.
        covariance: (PARAMETERS, PARAMETERS) covariance of the parameters.
        outliers: numbers, from 0, of clicks in the last update that contradict the others and got less weight.
        has_slipped: True if the last update detected a slip that `slipped` did not announce.
    """

    calibrated: Eye
    settings: WearSettings
    mean: FloatArray
    covariance: FloatArray
    outliers: tuple[int, ...] = ()
    has_slipped: bool = False

    @classmethod
    def begin(cls, calibrated: Eye, settings: WearSettings = WearSettings()) -> "WearState":
        """Return the state when the headset is put on: zero means with the variances `WearSettings.at_start`."""
        return cls(calibrated, settings, np.zeros(PARAMETERS), np.diag(settings.at_start))

    def carried(self, seconds: float) -> "WearState":
        """Return the state some seconds later, with larger variances."""
        if not (math.isfinite(seconds) and seconds >= 0):
            raise BadInputError(f"the time that has passed is {shown(seconds)} s; give zero or more seconds.")
        return self._with_added(self.settings.per_hour * (seconds / 3600.0))

    def slipped(self) -> "WearState":
        """Return the state after a slip of the headset, with a larger variance of the offset."""
        return self._with_added(self.settings.by_slip)

    def updated(self, clicks: Clicks, click_arcmin: float | None = None) -> "WearState":
        """Return the state after one or more clicks. Only dots at two or more depths separate the parameters.

        Args:
            clicks: the new clicks.
            click_arcmin: scatter of a click per axis; None for `settings.click_arcmin`.

        Raises:
            BadInputError: a click is outside the panel or the field of view, a point or viewpoint is not in metres, or
                clicks contradict each other.
        """
        sigma = self.settings.click_arcmin if click_arcmin is None else click_arcmin
        if not (math.isfinite(sigma) and sigma >= _LEAST_SIGMA_ARCMIN):
            raise BadInputError(
                f"click_arcmin is {shown(sigma)}; give the scatter of clicks in arcminutes, e.g. 2, and at least "
                f"{_LEAST_SIGMA_ARCMIN:g}."
            )
        self._check(clicks)
        share = self.settings.slip_share
        tried = [
            (self._fitted(clicks, sigma, self.covariance, math.log(1.0 - share)), False),
            (self._fitted(clicks, sigma, self.covariance + np.diag(self.settings.by_slip), math.log(share)), True),
        ]
        found, has_slipped = max(tried, key=lambda each: each[0].log_odds)
        if not found.is_settled:
            raise BadInputError(
                f"the fit to {len(clicks.pixel)} clicks does not converge in {_ITERATIONS} steps; are the points in "
                "the device frame of the same moment? Click again."
            )
        count, wrong = len(clicks.pixel), len(found.outliers)
        if count > 2 and 2 * wrong > count:
            raise BadInputError(
                f"{wrong} of {count} clicks contradict the others; are the points in the device frame of the same "
                "moment? Click again."
            )
        return replace(
            self, mean=found.mean, covariance=found.covariance, outliers=found.outliers, has_slipped=has_slipped
        )

    def viewpoint(self, tracked: FloatArray) -> FloatArray:
        """Return entrance pupils (..., 3) for tracked ones, device frame, metres."""
        return np.asarray(tracked + self.mean[OFFSET])

    def pose(self, world_from_device: FloatArray) -> FloatArray:
        """Return the headset's pose (4, 4), world_from_device, from the head tracker's pose."""
        turn = transforms.rotations_of_vectors(self.mean[TURN])
        return np.asarray(world_from_device @ transforms.rigid(turn.T, np.zeros(3)))

    def corrected(self, mappings: Eye) -> Eye:
        """Return calibrated mappings, of any colour, with the panel moved; for corrected viewpoints and poses."""
        display = MovedPanelDisplay(mappings.display, self.mean[SHIFT], float(self.mean[GROWTH][0]))
        return replace(mappings, display=display)

    def pixel(self, point: FloatArray, tracked: FloatArray) -> FloatArray:
        """Return panel pixels (..., 2) that cover real points (..., 3) at tracked viewpoints (..., 3), or NaN.

        Points are in the device frame according to the head tracker, metres.
        """
        viewpoint = self.viewpoint(tracked)
        turned = point @ transforms.rotations_of_vectors(self.mean[TURN]).T
        seen = self.calibrated.see_through.view_dir_of_real_point(turned, viewpoint).value
        return self.corrected(self.calibrated).display.pixel_of_view_dir(seen, viewpoint).value

    def sigma_arcmin(self, point: FloatArray, tracked: FloatArray) -> FloatArray:
        """Return the expected misalignment (n,) of points (n, 3) from tracked viewpoints (n, 3), rms over both axes.

        It combines the state's covariance without pointing, the eye tracker's noise and the models' covariance. Request
        clicks where it exceeds the tolerance.
        """
        pixel = self.pixel(point, tracked)
        rows = np.flatnonzero(np.isfinite(pixel).all(axis=1))
        sigma = np.full(len(pixel), np.nan)
        if len(rows):
            at = np.broadcast_to(tracked, point.shape)[rows]
            clicks = Clicks(pixel[rows], point[rows], at)
            by_mean = self._linearised(self.mean, clicks)[1].reshape(len(rows), 2, PARAMETERS)[..., : POINTING.start]
            covariance = self.covariance[: POINTING.start, : POINTING.start].copy()
            covariance[OFFSET, OFFSET] += self.settings.tracking_m**2 * np.eye(3)
            spread = by_mean @ covariance
            changes = self._changes_of_models(clicks)
            sigma[rows] = np.sqrt(np.sum(spread * by_mean, axis=(1, 2)) + np.sum(changes**2, axis=(1, 2)))
        return sigma

    def _with_added(self, variances: FloatArray) -> "WearState":
        return replace(self, covariance=self.covariance + np.diag(variances), outliers=(), has_slipped=False)

    def _directions(self, parameters: FloatArray, clicks: Clicks) -> tuple[FloatArray, FloatArray]:
        """Return directions (..., n, 3) of clicked pixels and of their points, for parameters (..., 1, PARAMETERS)."""
        display, see_through = self.calibrated.display, self.calibrated.see_through
        viewpoint = clicks.viewpoint + parameters[..., OFFSET]
        pixel = pixel_at_calibration(clicks.pixel, display.panel, parameters[..., SHIFT], parameters[..., GROWTH])
        turn = transforms.rotations_of_vectors(parameters[..., TURN])
        point = np.einsum("...ij,...j->...i", turn, clicks.point)
        displayed = display.view_dir_of_pixel(pixel, viewpoint)
        return displayed.value, see_through.view_dir_of_real_point(point, viewpoint).value

    def _linearised(self, mean: FloatArray, clicks: Clicks) -> tuple[FloatArray, FloatArray]:
        """Return the registration errors (2 n,) of the clicks, arcmin, and their derivative by the parameters."""
        steps = np.concatenate([np.zeros((1, PARAMETERS)), np.diag(_STEPS), -np.diag(_STEPS)])
        displayed, seen = self._directions((mean + steps)[:, None], clicks)
        axes = right_and_up(seen[0]) / ARCMIN
        gap = np.einsum("nij,knj->kni", axes, displayed - seen) - (mean + steps)[:, None, POINTING]
        flat = gap.reshape(len(gap), -1)
        return flat[0], ((flat[1 : 1 + PARAMETERS] - flat[1 + PARAMETERS :]) / (2.0 * _STEPS[:, None])).T

    def _changes_of_models(self, clicks: Clicks) -> FloatArray:
        """Return changes (n, 2, k) of the registration errors, arcmin, by the variables of the models' covariance."""
        display, see_through = self.calibrated.display, self.calibrated.see_through
        if not isinstance(display, FittedDisplay) or not isinstance(see_through, FittedSeeThrough):
            return np.zeros((len(clicks.pixel), 2, 0))
        if display.spread is None or see_through.spread is None:
            return np.zeros((len(clicks.pixel), 2, 0))
        return registration_changes(display, see_through, clicks.pixel, self.viewpoint(clicks.viewpoint), clicks.point)

    def _tracking_noise(self, slope: FloatArray) -> FloatArray:
        """Return the covariance (2 n, 2 n) of clicks due to the eye tracker's noise, independent between clicks."""
        by_offset = slope.reshape(-1, 2, PARAMETERS)[..., OFFSET] * self.settings.tracking_m
        return np.asarray(scipy.linalg.block_diag(*(by_offset @ by_offset.transpose(0, 2, 1))))

    def _fitted(self, clicks: Clicks, sigma_arcmin: float, prior: FloatArray, log_prior: float) -> "_Fitted":
        """Find the posterior by Gauss-Newton steps, with a new choice of wrong clicks in each step."""
        count = len(clicks.pixel)
        changes = self._changes_of_models(clicks).reshape(2 * count, -1)
        noise = changes @ changes.T + sigma_arcmin**2 * np.eye(2 * count)
        mean = self.mean
        for _ in range(_ITERATIONS):
            gap, slope = self._linearised(mean, clicks)
            innovation = -(gap + slope @ (self.mean - mean))
            spread = slope @ prior @ slope.T + noise + self._tracking_noise(slope)
            wrong, log_odds = wrong_pairs(innovation, spread, self.settings.outlier_share, self.settings.outlier_arcmin)
            spread = spread + np.diag(np.repeat(wrong, 2) * self.settings.outlier_arcmin**2)
            gain = np.linalg.solve(spread, slope @ prior).T
            last, mean = mean, self.mean + gain @ innovation
            change = float(np.abs(slope @ (mean - last)).max())
            if change < _STILL_ARCMIN:
                break
        covariance = prior - gain @ slope @ prior
        outliers = tuple(int(number) for number in np.flatnonzero(wrong))
        settled = change < _SETTLED * sigma_arcmin
        return _Fitted(mean, 0.5 * (covariance + covariance.T), outliers, log_odds + log_prior, settled)

    def _check(self, clicks: Clicks) -> None:
        """Refuse impossible clicks.

        Raises:
            BadInputError: see `updated`.
        """
        panel, box, area = self.calibrated.display.panel, self.calibrated.eye_box, self.calibrated.field
        for number, (pixel, point, viewpoint) in enumerate(
            zip(clicks.pixel, clicks.point, clicks.viewpoint, strict=True)
        ):
            where = f"click {number}"
            if not np.all((pixel >= 0) & (pixel <= panel.size_px)):
                raise BadInputError(
                    f"{where}: the pixel {pixel.tolist()} is not on the panel of {panel.width_px} x {panel.height_px}; "
                    "give panel pixels, v down."
                )
            if np.any(np.abs(viewpoint - box.centre) > 0.5 * box.size + _FAR_FROM_BOX_M):
                raise BadInputError(
                    f"{where}: the viewpoint {viewpoint.tolist()} m is far from the eye box about "
                    f"{box.centre.tolist()} m; give metres in the device frame, not millimetres."
                )
            distance = float(np.linalg.norm(point - viewpoint))
            if not (_NEAREST_M <= distance <= _FARTHEST_M and point[2] < viewpoint[2]):
                raise BadInputError(
                    f"{where}: the point {point.tolist()} m is {distance:.3g} m from the eye; give metres in the "
                    f"device frame, -z ahead, not millimetres: from {_NEAREST_M:g} to {_FARTHEST_M:g} m before the eye."
                )
        displayed, seen = (each[0] for each in self._directions(self.mean[None, None], clicks))
        for number, off in enumerate(arcmin_between(displayed, seen)):
            where = f"click {number}: the point {clicks.point[number].tolist()} m"
            if not math.isfinite(off) or (area is not None and not area.contains(seen[number])):
                raise BadInputError(f"{where} is not in the field of view; click on others.")
            if off > _FARTHEST_CLICK_ARCMIN:
                raise BadInputError(
                    f"{where} is seen {off / 60.0:.1f} degrees from the pixel {clicks.pixel[number].tolist()}; check "
                    "that both are of the same eye and moment, and that v runs down."
                )


@dataclass(frozen=True)
class _Fitted:
    """A posterior: mean, covariance, wrong clicks, log of evidence times prior odds, and convergence."""

    mean: FloatArray
    covariance: FloatArray
    outliers: tuple[int, ...]
    log_odds: float
    is_settled: bool
