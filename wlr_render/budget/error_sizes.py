"""Sizes of the errors that a budget counts: those of trackers, of drawing, and of what a model cannot follow."""

from collections.abc import Mapping
from dataclasses import dataclass, field, fields
from typing import Any

import numpy as np

from wlr_render.errors import BadInputError
from wlr_render.numerics.arrays import FloatArray

PerAxis = float | tuple[float, float, float]
"""One standard deviation for all three axes of the device frame, or one each."""


@dataclass(frozen=True)
class _Sizes:
    """Sizes, of which none is negative."""

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
        noise_m: standard deviation of a report, per axis.
        bias_m: standard deviation, over wearers, of the constant error of all reports, per axis.
        latency_s: from the eye's motion to the frame that uses it, less what prediction makes up for.
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
        rotation_rad, position_m: standard deviation per axis, of rotation about the origin of the device frame, and of
            position.
        latency_s: from the head's motion to the light of the frame, less what prediction and late warp make up for.
        angular_speed_rad_s, speed_m_s: rms speeds of the head, per axis.
    """

    rotation_rad: PerAxis = 0.0
    position_m: PerAxis = 0.0
    latency_s: float = 0.0
    angular_speed_rad_s: PerAxis = 0.0
    speed_m_s: PerAxis = 0.0


@dataclass(frozen=True)
class Drawing(_Sizes):
    """Errors of drawing, which are counted as if every pixel had the bound.

    Attributes:
        warp_grid_arcmin: bound of the interpolation error of the warp grid (`rendering.choose_warp_grid`).
        raster_arcmin: of a raster frame against a ray-traced one.
        is_rounded: whether edges lie on whole pixels. A warp that filters does not round: the place of an edge between
            two pixels is in their brightness. Without filter an edge is off by up to half a pixel, evenly distributed.
    """

    warp_grid_arcmin: float = 0.0
    raster_arcmin: float = 0.0
    is_rounded: bool = False


@dataclass(frozen=True)
class Truncation(_Sizes):
    """What the models cannot follow, as standard deviations per axis of a direction, arcminutes.

    Attributes:
        display_arcmin, see_through_arcmin: of both models.
    """

    display_arcmin: float = 0.0
    see_through_arcmin: float = 0.0

    @classmethod
    def from_report(cls, report: Mapping[str, Any]) -> "Truncation":
        """From the rows and columns of camera positions that the fits of a model file left out.

        A row that was left out is predicted by a fit to the others, with the error that the fit expects there: noise,
        motions of the camera and the covariance of the model. Found over expected variance is what the model's terms or
        its prior cannot follow. It is zero unless the mean over rows and columns exceeds two standard errors of
        itself. A left-out row is farther from its neighbours than anything is from the captures of the whole fit, so
        that the value is an upper one.

        Args:
            report: `EyeModel.report`; a side without rows and columns has none.
        """
        return cls(*(_excess_arcmin(report.get(side, {})) for side in ("display", "see_through")))


@dataclass(frozen=True)
class ErrorSizes:
    """Sizes of all errors beside those that fitted models state of themselves; none by default.

    Attributes:
        eye: errors of the eye tracker, metres and seconds.
        head: errors of the head tracker, radians, metres and seconds.
        drawing: errors of drawing, arcminutes.
        truncation: what the models cannot follow, arcminutes.
    """

    eye: EyeTracker = field(default_factory=EyeTracker)
    head: HeadTracker = field(default_factory=HeadTracker)
    drawing: Drawing = field(default_factory=Drawing)
    truncation: Truncation = field(default_factory=Truncation)


def variances(*sizes: PerAxis) -> FloatArray:
    """Variances (3 k,) of k sizes."""
    return np.concatenate([np.broadcast_to(np.asarray(size, np.float64), (3,)) for size in sizes]) ** 2


_SIGNIFICANT = 2.0


def _excess_arcmin(side: Any) -> float:
    """Root of the excess variance per axis."""
    rows = side.get("held_out") or () if isinstance(side, Mapping) else ()
    try:
        found, expected, captures = (
            np.array([[row["rms_arcmin"], row["expected_arcmin"], row["captures"]] for row in rows], np.float64)
            .reshape(-1, 3)
            .T
        )
    except (KeyError, TypeError, ValueError):  # reports are free: one that says nothing of this is no fault
        return 0.0
    if len(found) < 3 or not np.all(np.isfinite(found + expected) & (captures > 0)):
        return 0.0
    excess, weight = found**2 - expected**2, captures / captures.sum()
    mean = float(weight @ excess)
    error = float(np.sqrt(np.sum((weight * (excess - mean)) ** 2) * len(excess) / (len(excess) - 1)))
    return float(np.sqrt(0.5 * mean)) if mean > _SIGNIFICANT * error else 0.0
