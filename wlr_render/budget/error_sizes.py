"""Sizes of the errors in a budget: errors of the trackers, of drawing, and truncation errors of the models."""

from collections.abc import Mapping
from dataclasses import dataclass, field, fields
from typing import Any

import numpy as np

from wlr_render.errors import BadInputError
from wlr_render.numerics.arrays import FloatArray

PerAxis = float | tuple[float, float, float]
"""One standard deviation for all three axes of the device frame, or one per axis."""


@dataclass(frozen=True)
class _Sizes:
    """Base of the error sizes; requires every size to be finite and not negative."""

    def __post_init__(self) -> None:
        for each in fields(self):
            size = np.asarray(getattr(self, each.name), dtype=np.float64)
            if not np.all(np.isfinite(size) & (size >= 0.0)):
                raise BadInputError(
                    f"{each.name} of {type(self).__name__} is {getattr(self, each.name)}; it must be finite, 0 or more."
                )


@dataclass(frozen=True)
class EyeTracker(_Sizes):
    """Errors of the viewpoint that an eye tracker reports.

    Attributes:
        noise_m: standard deviation of a single report, per axis.
        bias_m: standard deviation of the constant error over wearers, per axis.
        latency_s: time from the eye's motion to the frame that uses it, less the time that prediction compensates.
        speed_m_s: rms speed of the pupil in the device frame, per axis.
    """

    noise_m: PerAxis = 0.0
    bias_m: PerAxis = 0.0
    latency_s: float = 0.0
    speed_m_s: PerAxis = 0.0


@dataclass(frozen=True)
class HeadTracker(_Sizes):
    """Errors of the device's pose in the world.

    Attributes:
        rotation_rad: standard deviation of the rotation about the origin of the device frame, per axis.
        position_m: standard deviation of the position, per axis.
        latency_s: time from the head's motion to the light of the frame, less the time that prediction and late warp
            compensate.
        angular_speed_rad_s, speed_m_s: rms speeds of the head, per axis.
    """

    rotation_rad: PerAxis = 0.0
    position_m: PerAxis = 0.0
    latency_s: float = 0.0
    angular_speed_rad_s: PerAxis = 0.0
    speed_m_s: PerAxis = 0.0


@dataclass(frozen=True)
class Drawing(_Sizes):
    """Errors of drawing; every pixel counts as if its error were the bound.

    Attributes:
        warp_grid_arcmin: bound of the interpolation error of the warp grid (`warp.choose_grid`).
        raster_arcmin: bound of the difference between a raster frame and a ray-traced one.
        is_rounded: whether edges are rounded to whole pixels. A warp with a filter does not round: the brightness of
            two neighbouring pixels places an edge between them. Without a filter, the error of an edge is uniform
            within half a pixel on either side.
        has_one_viewpoint: whether one entrance pupil serves a whole frame. The cornea moves it for view directions
            beside the gaze (`tracking.eye_model`); the error counts for an eye that looks straight ahead.
    """

    warp_grid_arcmin: float = 0.0
    raster_arcmin: float = 0.0
    is_rounded: bool = False
    has_one_viewpoint: bool = False


@dataclass(frozen=True)
class Truncation(_Sizes):
    """Truncation errors: parts of the true mappings that the models cannot represent.

    Attributes:
        display_arcmin, see_through_arcmin: standard deviation per axis of a direction, arcminutes.
    """

    display_arcmin: float = 0.0
    see_through_arcmin: float = 0.0

    @classmethod
    def from_report(cls, report: Mapping[str, Any]) -> "Truncation":
        """Estimate the truncation errors from the cross-validation in a model file.

        Cross-validation predicts each left-out row or column of camera positions from a fit to the others, and states
        the error to expect there: noise, motions of the camera and the covariance of the model. Variance beyond the
        expected one is truncation error: the model's terms or its prior cannot represent the data. It is set to zero
        unless its mean over rows and columns exceeds two standard errors. The estimate is an upper bound, because a
        left-out row is farther from its neighbours than any viewpoint is from the captures of the whole fit.

        Args:
            report: `EyeModel.report`; the error of a side without cross-validation is zero.
        """
        return cls(*(_excess_arcmin(report.get(side, {})) for side in ("display", "see_through")))


@dataclass(frozen=True)
class ErrorSizes:
    """Sizes of all errors except the uncertainty that fitted models state; zero by default.

    Attributes:
        eye: errors of the eye tracker, metres and seconds.
        head: errors of the head tracker, radians, metres and seconds.
        drawing: errors of drawing, arcminutes.
        truncation: truncation errors of the models, arcminutes.
    """

    eye: EyeTracker = field(default_factory=EyeTracker)
    head: HeadTracker = field(default_factory=HeadTracker)
    drawing: Drawing = field(default_factory=Drawing)
    truncation: Truncation = field(default_factory=Truncation)


def variances(*sizes: PerAxis) -> FloatArray:
    """Return the variances (3 k,), one per axis, of k standard deviations."""
    return np.concatenate([np.broadcast_to(np.asarray(size, np.float64), (3,)) for size in sizes]) ** 2


_SIGNIFICANT = 2.0  # standard errors above which an excess variance counts


def _excess_arcmin(side: Any) -> float:
    """Return the root of the excess variance per axis, arcminutes."""
    rows = side.get("held_out") or () if isinstance(side, Mapping) else ()
    try:
        measured, expected, captures = (
            np.array([[row["rms_arcmin"], row["expected_arcmin"], row["captures"]] for row in rows], np.float64)
            .reshape(-1, 3)
            .T
        )
    except (KeyError, TypeError, ValueError):  # a report without cross-validation is valid
        return 0.0
    if len(measured) < 3 or not np.all(np.isfinite(measured + expected) & (captures > 0)):
        return 0.0
    excess, weight = measured**2 - expected**2, captures / captures.sum()
    mean = float(weight @ excess)
    error = float(np.sqrt(np.sum((weight * (excess - mean)) ** 2) * len(excess) / (len(excess) - 1)))
    return float(np.sqrt(0.5 * mean)) if mean > _SIGNIFICANT * error else 0.0
