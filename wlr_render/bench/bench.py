"""Bench model: headset, eyeball camera, stage, target, tracking, eye tracking and clock as one frozen value.

Device frame (OpenXR), metres, radians, seconds, pixels with (0, 0) at the outer corner of the top-left pixel. The
defaults of all parts describe a perfect bench.
"""

from collections.abc import Mapping
from dataclasses import dataclass, field
from functools import cached_property, partial
from typing import Annotated

import numpy as np

from wlr_render.bench.bench_effects import BenchEffect
from wlr_render.geometry.directions import dir_of_tangents, tangents_of_dir
from wlr_render.geometry.pose_keys import ROTATION, pose_keys
from wlr_render.io.file_records import CAMERA_PIXEL, ELSEWHERE, LENGTH, MATRIX, POINT, TURN, Key, Keys, Quantity, Rule
from wlr_render.io.input_files import LIMITS
from wlr_render.lenses.lens_camera import LensCamera
from wlr_render.numerics.arrays import FloatArray
from wlr_render.optics.device import Device, EyeOptics

_FAR, _LARGE = 1e4, 1e6  # largest length in a file, mm, and largest other number
_ZERO_2, _ZERO_3, _UNIT_3 = partial(np.zeros, 2), partial(np.zeros, 3), partial(np.eye, 3)
_number = partial(Key, most=_LARGE)
_positive = partial(Key, above=0, most=_LARGE)
_size = partial(Key, type=int, least=1, most=LIMITS.picture_side)
_point = partial(Key, quantity=POINT, shape=(3,), most=_FAR)
_BOW = Quantity(lambda value, axes: axes[2, 2] * value, lambda value, axes: axes[2, 2] * value)
_INVERTIBLE = Rule("a matrix of determinant 0.1 or more", lambda value: bool(abs(np.linalg.det(value)) >= 0.1))
_ROTATION = Key("rotation", MATRIX, shape=(3, 3), rule=ROTATION)
_POSE = pose_keys(_ROTATION, Key("translation", POINT, shape=(3,), most=1e5))


def _pair(first: Key, second: Key) -> Keys:
    return Keys((first, second), lambda *pair: np.array(pair, dtype=np.float64), lambda pair: pair)


@dataclass(frozen=True, eq=False)
class EyeballCamera:
    """The eyeball camera: a pinhole camera with radial lens distortion that looks along -z.

    Attributes:
        size_px: (2,) width and height.
        focal_px: (2,) pixels per unit tangent in u and v.
        centre_px: (2,) principal point.
        distortion: (2,) k1 and k2 of the radial model of D. C. Brown, "Close-range camera calibration", Photogrammetric
            Engineering 37 (1971) 855: distorted tangents = true tangents * (1 + k1 r^2 + k2 r^4).
        device_from_camera: (3, 3) camera rotation; the identity looks along -z.
        pupil_offset: (3,) true minus nominal centre of projection, metres.
        point_sigma_px: stated repeatability of an image point, per axis.
    """

    size_px: Annotated[FloatArray, _pair(_size("width"), _size("height"))]
    focal_px: Annotated[FloatArray, _pair(_positive("fx"), _positive("fy"))]
    centre_px: Annotated[FloatArray, _pair(_number("cx", CAMERA_PIXEL), _number("cy", CAMERA_PIXEL))]
    point_sigma_px: Annotated[float, Key(least=1e-6, most=100)]
    distortion: Annotated[FloatArray, _number(shape=(2,))] = field(default_factory=_ZERO_2)
    device_from_camera: Annotated[FloatArray, _ROTATION] = field(default_factory=_UNIT_3)
    pupil_offset: Annotated[FloatArray, _point("pupil_offset_mm")] = field(default_factory=_ZERO_3)

    @cached_property
    def _lens(self) -> LensCamera:
        """The lens, whose y axis points down."""
        width, height = self.size_px
        return LensCamera(
            (int(width), int(height)), self.focal_px, self.centre_px, np.append(self.distortion, np.zeros(3))
        )

    def pixel_of_tangents(self, tangents: FloatArray) -> FloatArray:
        """Return the pixels (n, 2) of tangents (n, 2) in the camera frame, y up; NaN outside the field of view."""
        return self._lens.pixel_of_tangents(tangents * [1.0, -1.0])

    def tangents_of_pixel(self, pixel: FloatArray) -> FloatArray:
        """Return the tangents (n, 2) of pixels (n, 2), y up; NaN where the lens model has none."""
        return self._lens.tangents_of_pixel(pixel) * [1.0, -1.0]

    def view_dir_of_pixel(self, pixel: FloatArray) -> FloatArray:
        """Return the unit directions (n, 3) of pixels (n, 2) in the device frame, before any slip."""
        return np.asarray(dir_of_tangents(self.tangents_of_pixel(pixel)) @ self.device_from_camera.T)

    def pixel_of_view_dir(self, view_dir: FloatArray) -> FloatArray:
        """Return the pixels (n, 2) of directions (n, 3) in the device frame, before any slip."""
        return self.pixel_of_tangents(tangents_of_dir(view_dir @ self.device_from_camera))


@dataclass(frozen=True, eq=False)
class Stage:
    """The motion stage.

    Attributes:
        origin: (3,) stage reading about which `axes` acts.
        axes: (3, 3) true displacement from `origin` = axes @ displacement read.
        backlash: (2,) true minus read x after a move towards +x and after a move towards -x, metres.
    """

    origin: Annotated[FloatArray, _point()]
    axes: Annotated[FloatArray, Key("", MATRIX, shape=(3, 3), most=2, rule=_INVERTIBLE)] = field(
        default_factory=_UNIT_3
    )
    backlash: Annotated[FloatArray, Key("backlash_mm", LENGTH, shape=(2,), most=_FAR)] = field(default_factory=_ZERO_2)


@dataclass(frozen=True, eq=False)
class Target:
    """The printed target: dots in its plane z = 0, in metres.

    Attributes:
        device_from_target: (k, 4, 4) poses reported by tracking.
        pitch: (k,) distance of neighbouring dots at each pose.
        scale: (2,) true size divided by stated size, in x and y.
        bow: (k, 2) curvature at each pose, z = bow_x x^2 + bow_y y^2, per metre.
    """

    device_from_target: FloatArray
    pitch: FloatArray
    scale: Annotated[FloatArray, _positive(shape=(2,))] = field(default_factory=partial(np.ones, 2))
    bow: Annotated[FloatArray, _number("bow_per_m", _BOW, shape=(-1, 2))] = field(
        default_factory=partial(np.zeros, (1, 2))
    )


@dataclass(frozen=True, eq=False)
class TargetPose:
    """A pose of the target in a bench file: device_from_target (4, 4) as reported by tracking, and the dots' pitch."""

    device_from_target: Annotated[FloatArray, _POSE]
    pitch: Annotated[float, _positive("pitch_mm", LENGTH)]


@dataclass(frozen=True, eq=False)
class Tracking:
    """Errors of the headset's tracking camera.

    Attributes:
        true_from_reported: (4, 4) transforms reported points to true points, device frame.
    """

    true_from_reported: Annotated[FloatArray, _POSE] = field(default_factory=partial(np.eye, 4))


@dataclass(frozen=True, eq=False)
class Mount:
    """Movements during the session.

    Attributes:
        panel_creep: (2,) total creep of the panel along u and v until it is warm, metres.
        warm_up_s: time constant of the creep, of which the fraction 1 - exp(-t / warm_up_s) has happened at time t.
        slip_time_s: time at which the headset slips; infinite for never.
        slip: (3,) displacement of the camera by the slip, device frame, metres.
        slip_rotation: (3,) rotation of the camera by the slip, device frame, radians about x, y, z.
    """

    panel_creep: Annotated[FloatArray, Key("panel_creep_mm", LENGTH, shape=(2,), most=_FAR)] = field(
        default_factory=_ZERO_2
    )
    warm_up_s: Annotated[float, _positive()] = 900.0
    slip_time_s: Annotated[float, _number()] = np.inf
    slip: Annotated[FloatArray, _point("slip_mm")] = field(default_factory=_ZERO_3)
    slip_rotation: Annotated[FloatArray, _number("slip_rotation_deg", TURN, shape=(3,))] = field(
        default_factory=_ZERO_3
    )


@dataclass(frozen=True, eq=False)
class PanelReadout:
    """Errors of decoded panel positions.

    Attributes:
        origin_px: (2,) decoded minus true position.
        channel_scale: (3,) magnification about the panel's centre in red, green and blue.
        channel_shift_px: (3, 2) shift of the red, green and blue pictures.
    """

    origin_px: Annotated[FloatArray, _number(shape=(2,))] = field(default_factory=_ZERO_2)
    channel_scale: Annotated[FloatArray, _positive(shape=(3,))] = field(default_factory=partial(np.ones, 3))
    channel_shift_px: Annotated[FloatArray, _number(shape=(3, 2))] = field(default_factory=partial(np.zeros, (3, 2)))


@dataclass(frozen=True, eq=False)
class EyeTracking:
    """Errors of eye tracking.

    Attributes:
        bias: (3,) true minus tracked position of the pupil, metres.
        gaze_radius: radius r, metres, of the pupil motion that tracking misses: r * (gaze - straight ahead).
    """

    bias: Annotated[FloatArray, _point("bias_mm")] = field(default_factory=_ZERO_3)
    gaze_radius: Annotated[float, Key("gaze_radius_mm", LENGTH, most=_FAR)] = 0.0


@dataclass(frozen=True, eq=False)
class Clock:
    """Delays of the display.

    Attributes:
        latency_s: delay from the time for which a frame is drawn to the display of its first row.
        scanout_s: time between the displays of the panel's first and last row.
    """

    latency_s: Annotated[float, _number()] = 0.0
    scanout_s: Annotated[float, _number()] = 0.0


@dataclass(frozen=True, eq=False)
class Bench:
    """Everything that determines the readings of a session.

    Attributes:
        device: the headset.
        eye: "left" or "right".
        camera, stage, target, tracking, mount, readout, eye_tracking, clock: parts of the bench.
        wavelengths_um: (3,) vacuum wavelengths of red, green and blue light, micrometres.
        target_wavelength_um: wavelength in which targets and real dots are observed.
        effects: smooth displacements at stations of the bench that no attribute of a part describes.
        priors: (mean, sigma) of each parameter, by the names of cause and parameter, in the parameter's unit.
    """

    device: Device
    eye: Annotated[str, ELSEWHERE]
    camera: EyeballCamera
    stage: Stage
    target: Target
    tracking: Tracking = field(default_factory=Tracking)
    mount: Mount = field(default_factory=Mount)
    readout: PanelReadout = field(default_factory=PanelReadout)
    eye_tracking: EyeTracking = field(default_factory=EyeTracking)
    clock: Clock = field(default_factory=Clock)
    wavelengths_um: Annotated[tuple[float, float, float], Key("channels_um", least=0.2, most=2)] = (0.65, 0.55, 0.45)
    target_wavelength_um: Annotated[float, Key("target_um", least=0.2, most=2)] = 0.55
    effects: tuple[BenchEffect, ...] = ()
    priors: Mapping[str, Mapping[str, tuple[float, float]]] = field(default_factory=dict)

    @property
    def optics(self) -> EyeOptics:
        """The eye's optics."""
        return self.device.eyes[self.eye]
