"""Residuals as people state them: panel pixels, arcminutes, multiples of the noise."""

import numpy as np

from wlr_render.diagnosis.diagnosis import Figures
from wlr_render.diagnosis.observations import DISPLAY, RUN_TIME, SEE_THROUGH, Observations
from wlr_render.geometry.directions import ARCMIN
from wlr_render.numerics.arrays import BoolArray, FloatArray


def of_residual(observations: Observations, residual: FloatArray, used: BoolArray) -> Figures:
    """Root mean squares per axis of a residual (n, 2) in units of sigma, over the readings that count."""
    used = used & np.isfinite(residual).all(axis=1)
    return Figures(
        _rms(panel_pixels(observations, residual)[used[observations.part == DISPLAY]]),
        _rms(arcminutes(observations, residual, SEE_THROUGH)[used[observations.part == SEE_THROUGH]]),
        _rms(arcminutes(observations, residual, RUN_TIME)[used[observations.part == RUN_TIME]]),
        float(np.sqrt(np.mean(residual[used] ** 2))),
    )


def of_noise(observations: Observations, used: BoolArray) -> Figures:
    """The same figures for noise alone."""
    camera_px = _panel_from_camera(observations)[used[observations.part == DISPLAY]] * observations.sigma_px[DISPLAY]
    arcmin = 1.0 / (np.mean(observations.nominal.camera.focal_px) * ARCMIN)
    present = [np.any(observations.part == part) for part in range(3)]
    return Figures(
        float(np.sqrt(np.mean(np.sum(camera_px**2, axis=(1, 2))) / 2)) if present[DISPLAY] else None,
        float(observations.sigma_px[SEE_THROUGH] * arcmin) if present[SEE_THROUGH] else None,
        float(observations.sigma_px[RUN_TIME] * arcmin) if present[RUN_TIME] else None,
        1.0,
    )


def panel_pixels(observations: Observations, residual: FloatArray) -> FloatArray:
    """Residual of the display readings in panel pixels, (n_display, 2)."""
    own = residual[observations.part == DISPLAY] * observations.sigma_px[DISPLAY]
    return np.asarray((_panel_from_camera(observations) @ own[:, :, None])[:, :, 0])


def arcminutes(observations: Observations, residual: FloatArray, part: int) -> FloatArray:
    """Residual of a part's readings in arcminutes at the middle of the camera's image, (n_part, 2)."""
    own = residual[observations.part == part] * observations.sigma_px[part]
    return np.asarray(own / (observations.nominal.camera.focal_px * ARCMIN))


def _panel_from_camera(observations: Observations) -> FloatArray:
    if len(observations.camera_from_panel) == 0:
        return observations.camera_from_panel
    return np.asarray(np.linalg.inv(observations.camera_from_panel))


def _rms(values: FloatArray) -> float | None:
    return float(np.sqrt(np.mean(values**2))) if len(values) else None
