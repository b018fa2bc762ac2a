"""Options of `budget`."""

from dataclasses import KW_ONLY, dataclass
from pathlib import Path
from typing import Annotated

import numpy as np

from wlr_render import usual
from wlr_render.budget.error_sizes import Drawing, ErrorSizes, EyeTracker, HeadTracker, PerAxis, Truncation
from wlr_render.errors import BadInputError
from wlr_render.jobs import limits
from wlr_render.jobs.options import Against, Eyes, Options, described, flag_of, option_group
from wlr_render.tracking.eye_model import PUPIL_DISTANCE_M

_MEDIAN_OF_RAYLEIGH = 1.177  # median length of a pair of standard normal numbers
_PUPIL_MM_PER_DEG = 1e3 * PUPIL_DISTANCE_M * np.pi / 180

PerAxisMm = tuple[float, ...]
_EYE = option_group("Eye tracking", 1)
_HEAD = option_group("Head tracking", 2)
_DRAWING = option_group("Drawing", 3)


@dataclass(frozen=True)
class BudgetOptions(Options):
    """Options of `budget`; docs/budget.md has the sources of the default sizes."""

    headset: Annotated[str, described("A model file, or a device or factory calibration (then without model errors).")]
    _: KW_ONLY
    eye: Annotated[Eyes, described("Eyes to analyse; both also gives the disparity error.")] = "right"
    depth_m: Annotated[float, described("Depth of the real points in metres."), limits.DEPTH_M] = 1.0
    eye_noise_mm: Annotated[
        PerAxisMm,
        described(
            "Noise of the tracked eye position in mm, one standard deviation for all axes, or x y z.",
            many=True,
            group=_EYE,
        ),
        limits.TRACKING_MM,
    ] = (round(usual.EYE_NOISE_DEG.value * _PUPIL_MM_PER_DEG, 2),)
    eye_bias_mm: Annotated[
        PerAxisMm,
        described(
            "Constant error of the tracked eye position in mm, one standard deviation over wearers for all axes, "
            "or x y z.",
            many=True,
            group=_EYE,
        ),
        limits.TRACKING_MM,
    ] = (round(usual.EYE_BIAS_DEG.value / _MEDIAN_OF_RAYLEIGH * _PUPIL_MM_PER_DEG, 2),)
    eye_latency_ms: Annotated[
        float,
        described("Latency of eye tracking in ms that remains after prediction.", group=_EYE),
        limits.LATENCY_MS,
    ] = usual.EYE_LATENCY_S.milli
    eye_speed_mm_s: Annotated[
        float, described("Speed of the pupil in mm/s, rms per axis, x and y.", group=_EYE), limits.PUPIL_MM_S
    ] = round(usual.HEAD_SPEED_DEG_S.value * _PUPIL_MM_PER_DEG, 1)
    head_noise_deg: Annotated[
        float,
        described("Noise of the head's rotation in degrees, one sigma per axis.", group=_HEAD),
        limits.TRACKING_DEG,
    ] = usual.HEAD_NOISE_DEG.value
    head_noise_mm: Annotated[
        float, described("Noise of the head's position in mm, one sigma per axis.", group=_HEAD), limits.TRACKING_MM
    ] = usual.HEAD_NOISE_M.milli
    head_latency_ms: Annotated[
        float,
        described("Latency of head tracking in ms that remains after prediction and late warp.", group=_HEAD),
        limits.LATENCY_MS,
    ] = usual.HEAD_LATENCY_S.milli
    head_speed_deg_s: Annotated[
        float, described("Angular speed of the head in degrees/s, rms per axis.", group=_HEAD), limits.HEAD_DEG_S
    ] = usual.HEAD_SPEED_DEG_S.value
    head_speed_m_s: Annotated[
        float, described("Speed of the head in m/s, rms per axis.", group=_HEAD), limits.HEAD_M_S
    ] = usual.HEAD_SPEED_M_S.value
    raster_arcmin: Annotated[
        float,
        described("Error of a raster frame against a ray-traced one, in arcmin.", group=_DRAWING),
        limits.ANGLE_ARCMIN,
    ] = 0.004
    whole_pixels: Annotated[
        bool,
        described(
            "Include the rounding of edges to whole pixels (drawing without a filter).", flag=True, group=_DRAWING
        ),
    ] = False
    without_cornea: Annotated[
        bool,
        described(
            "Leave out that the cornea moves the pupil for light beside the gaze; frames are drawn for one pupil.",
            flag=True,
            group=_DRAWING,
        ),
    ] = False
    camera_frame: Annotated[
        bool,
        described(
            "Head poses and pupils are measured by the tracking camera of the calibration, with the same stated "
            "pose: an error of that pose then cancels.",
            flag=True,
            group=_HEAD,
        ),
    ] = False
    out: Annotated[Path, described("Output folder.")] = Path("out/budget")
    against: Against = None

    def __post_init__(self) -> None:
        super().__post_init__()
        for name in ("eye_noise_mm", "eye_bias_mm"):
            if len(getattr(self, name)) not in (1, 3):
                flag, count = flag_of(type(self), name), len(getattr(self, name))
                raise BadInputError(f"{flag} has {count} values; give one for all axes, or x y z.")

    def sizes(self, warp_grid_arcmin: float, truncation: Truncation) -> ErrorSizes:
        """Return all error sizes in the package's units."""
        speed = 1e-3 * self.eye_speed_mm_s
        return ErrorSizes(
            EyeTracker(
                _per_axis(self.eye_noise_mm), _per_axis(self.eye_bias_mm), 1e-3 * self.eye_latency_ms, (speed, speed, 0)
            ),
            HeadTracker(
                float(np.deg2rad(self.head_noise_deg)),
                1e-3 * self.head_noise_mm,
                1e-3 * self.head_latency_ms,
                float(np.deg2rad(self.head_speed_deg_s)),
                self.head_speed_m_s,
            ),
            Drawing(warp_grid_arcmin, self.raster_arcmin, self.whole_pixels, not self.without_cornea),
            truncation,
        )


def _per_axis(mm: PerAxisMm) -> PerAxis:
    x, y, z = (1e-3 * each for each in (mm * 3 if len(mm) == 1 else mm))
    return x, y, z
