"""The measuring bench as one frozen value: headset, eyeball camera, stage, target, tracking, eye tracking, clock.

Device frame (OpenXR), metres, radians, seconds, pixels with (0, 0) at the outer corner of the top-left pixel. Every
part has defaults that leave a perfect bench as it is; a bench believed to be wrong somewhere is another bench.
"""

from dataclasses import dataclass, field
from functools import partial

import numpy as np

from wlr_render.numerics.arrays import FloatArray
from wlr_render.optics.device import Device, EyeOptics


@dataclass(frozen=True, eq=False)
class EyeballCamera:
    """The camera in the place of the eye: a pinhole with radial lens distortion that looks along -z.

    Attributes:
        size_px: (2,) width and height.
        focal_px: (2,) pixels per unit tangent in u and v.
        centre_px: (2,) where the optical axis meets the image.
        distortion: (2,) k1 and k2 of the radial model of D. C. Brown, "Close-range camera calibration", Photogrammetric
            Engineering 37 (1971) 855: seen tangents = true tangents * (1 + k1 r^2 + k2 r^4).
        device_from_camera: (3, 3) rotation by which the camera is turned from looking along -z.
        pupil_offset: (3,) from where the stage believes the centre of projection to be, to where it is.
        point_sigma_px: stated repeatability of a point, per axis.
    """

    size_px: FloatArray
    focal_px: FloatArray
    centre_px: FloatArray
    point_sigma_px: float
    distortion: FloatArray = field(default_factory=partial(np.zeros, 2))
    device_from_camera: FloatArray = field(default_factory=partial(np.eye, 3))
    pupil_offset: FloatArray = field(default_factory=partial(np.zeros, 3))


@dataclass(frozen=True, eq=False)
class Stage:
    """The motion stage.

    Attributes:
        origin: (3,) reading about which its axes are wrong.
        axes: (3, 3) true displacement from the origin = axes @ displacement that is read.
        backlash: (2,) true x minus read x where the last move was towards +x, and towards -x, metres.
    """

    origin: FloatArray
    axes: FloatArray = field(default_factory=partial(np.eye, 3))
    backlash: FloatArray = field(default_factory=partial(np.zeros, 2))


@dataclass(frozen=True, eq=False)
class Target:
    """The printed target: dots in its plane z = 0, in metres.

    Attributes:
        device_from_target: (k, 4, 4) its poses as tracking reports them.
        pitch: (k,) distance of neighbouring dots at each pose.
        scale: (2,) true size over stated size in x and y.
        bow: (k, 2) at each pose, z = bow_x x^2 + bow_y y^2, per metre: how far it is from flat.
    """

    device_from_target: FloatArray
    pitch: FloatArray
    scale: FloatArray = field(default_factory=partial(np.ones, 2))
    bow: FloatArray = field(default_factory=partial(np.zeros, (1, 2)))


@dataclass(frozen=True, eq=False)
class Tracking:
    """The headset's own tracking camera, by what it says of the target.

    Attributes:
        true_from_reported: (4, 4) carries a reported point, device frame, to where it is.
    """

    true_from_reported: FloatArray = field(default_factory=partial(np.eye, 4))


@dataclass(frozen=True, eq=False)
class Mount:
    """What moves while the session lasts.

    Attributes:
        panel_creep: (2,) how far the panel creeps in its plane along u and v until it is warm, metres.
        warm_up_s: time constant of the creep: after t it is 1 - exp(-t / warm_up_s) of the whole.
        slip_time_s: when the headset slips; never, if infinite.
        slip: (3,) displacement of the camera in the device frame from then on, metres.
        slip_rotation: (3,) rotation of the camera in the device frame from then on, radians about x, y, z.
    """

    panel_creep: FloatArray = field(default_factory=partial(np.zeros, 2))
    warm_up_s: float = 900.0
    slip_time_s: float = np.inf
    slip: FloatArray = field(default_factory=partial(np.zeros, 3))
    slip_rotation: FloatArray = field(default_factory=partial(np.zeros, 3))


@dataclass(frozen=True, eq=False)
class PanelReadout:
    """From where light leaves the panel to the position that is decoded.

    Attributes:
        origin_px: (2,) decoded minus true position.
        channel_scale: (3,) magnification about the panel's centre in red, green and blue.
    """

    origin_px: FloatArray = field(default_factory=partial(np.zeros, 2))
    channel_scale: FloatArray = field(default_factory=partial(np.ones, 3))


@dataclass(frozen=True, eq=False)
class EyeTracking:
    """From where tracking says the pupil is to where it is.

    Attributes:
        bias: (3,) true minus tracked place of the pupil, metres.
        gaze_radius: by so much, in metres, the pupil moves with the gaze beyond what tracking reports: along the gaze
            minus straight ahead.
    """

    bias: FloatArray = field(default_factory=partial(np.zeros, 3))
    gaze_radius: float = 0.0


@dataclass(frozen=True, eq=False)
class Clock:
    """Delays of the picture.

    Attributes:
        latency_s: from the time a frame is drawn for to the time its first row is seen.
        scanout_s: from the first row of the panel to its last.
    """

    latency_s: float = 0.0
    scanout_s: float = 0.0


@dataclass(frozen=True, eq=False)
class Bench:
    """Everything that decides what a session reads.

    Attributes:
        device: the headset.
        eye: which of its eyes.
        camera, stage, target, tracking, mount, readout, eye_tracking, clock: the parts; see there.
        wavelengths_um: (3,) vacuum wavelengths of red, green and blue light, micrometres.
        target_wavelength_um: of the light in which targets and real dots are seen.
    """

    device: Device
    eye: str
    camera: EyeballCamera
    stage: Stage
    target: Target
    tracking: Tracking = field(default_factory=Tracking)
    mount: Mount = field(default_factory=Mount)
    readout: PanelReadout = field(default_factory=PanelReadout)
    eye_tracking: EyeTracking = field(default_factory=EyeTracking)
    clock: Clock = field(default_factory=Clock)
    wavelengths_um: tuple[float, float, float] = (0.65, 0.55, 0.45)
    target_wavelength_um: float = 0.55

    @property
    def optics(self) -> EyeOptics:
        """The eye's optics."""
        return self.device.eyes[self.eye]
