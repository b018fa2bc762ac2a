"""Simulated camera at one pose: light from panel and world through exact optics, or from the world alone.

Light is linear, as a fraction of full scale. A pixel's light is the mean over a fixed set of rays spread over the pixel
and the pupil; each ray is traced exactly, or interpolated with a bounded error.
"""

from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property, partial

import cv2
import numpy as np
from numpy.typing import NDArray

from wlr_render.errors import BadInputError
from wlr_render.geometry import rays
from wlr_render.geometry.transforms import inverse
from wlr_render.mappings import Panel, Status
from wlr_render.numerics.arrays import BoolArray, Float32Array, FloatArray
from wlr_render.optics.device import EyeOptics
from wlr_render.optics.traced_mappings import TracedDisplay, TracedSeeThrough
from wlr_render.simulation.photographs.camera import SimulatedLens
from wlr_render.simulation.photographs.pixel_map import PixelMap

Radiance = Callable[[Float32Array], NDArray[np.floating]]
"""Rays (h, w, 6) of some rows, away from the lens, NaN without light -> brightness (h, w) of the objects they hit."""

PANEL_GAMMA = 2.2  # gamma of most displays, close to sRGB
_PANEL_TOLERANCE_PX = 0.003  # largest interpolation error, below the resolution of decoding
_WORLD_TOLERANCE = np.array([2e-7, 2e-7, 1e-6, 1e-6])  # metres in the plane of the pupil, and tangents
_ROWS = 64  # rows computed at a time, so that intermediate results stay in the processor's cache
_OFF_PANEL = -10.0  # position far enough from the panel for its nearest pixels to be dark
_FARTHEST = 32_000.0  # largest position, because cv2.remap has indices of 16 bits
WAVELENGTH_UM = 0.55
_BLUR_STEP = 16  # step between the pixels that determine the blur
_NARROWEST_PX = 1e-3  # narrowest ramp between two panel pixels


@dataclass(frozen=True, eq=False)
class CameraView:
    """View of a lens at one pose, made by `through_optics` or `without_headset`.

    Attributes:
        lens: the lens.
        frame_from_camera: (4, 4) camera pose, in the device frame through the optics, in any frame without the headset.
        panel: the panel; None without the headset.
        on_panel: position of each sample on the panel, panel pixels; empty without the headset.
        in_world: world ray of each sample: x, y in the camera's plane z = 0, and two tangents, camera frame.
    """

    lens: SimulatedLens
    frame_from_camera: FloatArray
    panel: Panel | None
    on_panel: tuple[PixelMap, ...]
    in_world: tuple[PixelMap, ...]

    @classmethod
    def through_optics(
        cls,
        optics: EyeOptics,
        lens: SimulatedLens,
        device_from_camera: FloatArray,
        samples: int = 16,
    ) -> "CameraView":
        """Return the view of a lens in place of an eye; its rays are traced exactly at 0.55 micrometres."""
        display, see_through = TracedDisplay(optics, WAVELENGTH_UM), TracedSeeThrough(optics, WAVELENGTH_UM)
        camera_from_device = inverse(device_from_camera)

        def looking(pupil_point: FloatArray, pixel: FloatArray) -> tuple[FloatArray, FloatArray]:
            return rays.split(rays.transformed(device_from_camera, lens.ray_of_pixel(pixel, pupil_point)))

        def on_panel(pupil_point: FloatArray, pixel: FloatArray) -> tuple[FloatArray, BoolArray]:
            origin, direction = looking(pupil_point, pixel)
            place, status = display.plane_pixel(direction, origin)
            return place, np.asarray(status == Status.OK)

        def in_world(pupil_point: FloatArray, pixel: FloatArray) -> tuple[FloatArray, BoolArray]:
            origin, direction = looking(pupil_point, pixel)
            ray = see_through.real_ray_of_view_dir(direction, origin)
            return _offset_and_slope(rays.transformed(camera_from_device, ray.value))

        panel_maps = _maps(lens, samples, on_panel, np.full(2, _PANEL_TOLERANCE_PX))
        world_maps = _maps(lens, samples, in_world, _WORLD_TOLERANCE)
        return cls(lens, device_from_camera, optics.panel.pixels, panel_maps, world_maps)

    @classmethod
    def without_headset(cls, lens: SimulatedLens, frame_from_camera: FloatArray, samples: int = 16) -> "CameraView":
        """Return the view of a lens in free air: an eyeball camera on the bare stage, or the tracking camera."""

        def in_world(pupil_point: FloatArray, pixel: FloatArray) -> tuple[FloatArray, BoolArray]:
            return _offset_and_slope(lens.ray_of_pixel(pixel, pupil_point))

        return cls(lens, frame_from_camera, None, (), _maps(lens, samples, in_world, _WORLD_TOLERANCE))

    def panel_light(self, image: NDArray[np.uint8], gamma: float = PANEL_GAMMA) -> Float32Array:
        """Return the light (h, w) from the panel, 1 where a white panel fills the pixel; dark without a headset.

        Panel pixels are uniform adjoining squares with brightness (value / 255)^gamma.

        Raises:
            BadInputError: the image is not of the panel's size.
        """
        width, height = self.lens.camera.size_px
        total = np.zeros((height, width), dtype=np.float32)
        if self.panel is None:
            return total
        if image.shape != (self.panel.height_px, self.panel.width_px) or image.dtype != np.uint8:
            raise BadInputError(
                f"An image of shape {image.shape} and type {image.dtype} cannot be shown on a panel of "
                f"{self.panel.width_px} x {self.panel.height_px} pixels; give (height, width) grey values as uint8."
            )
        shining = ((np.arange(256) / 255.0) ** gamma).astype(np.float32)[image]
        for u, v in self._panel_maps:
            cv2.accumulate(cv2.remap(shining, u, v, cv2.INTER_LINEAR, borderMode=cv2.BORDER_CONSTANT), total)
        return total / np.float32(len(self.on_panel))

    def world_light(self, radiance: Radiance) -> Float32Array:
        """Return the light (h, w) from the world; dark where no ray arrives or `radiance` is NaN."""
        width, height = self.lens.camera.size_px
        total = np.zeros((height, width), dtype=np.float32)
        for field in self.in_world:
            offset_and_slope = field.planes()
            offset_and_slope[:, ~field.lit] = np.nan
            for first in range(0, height, _ROWS):
                rows = slice(first, first + _ROWS)
                total[rows] += np.nan_to_num(radiance(self._rays(offset_and_slope[:, rows]))) * field.lit[rows]
        return total / np.float32(len(self.in_world))

    def _rays(self, offset_and_slope: Float32Array) -> Float32Array:
        """Return the rays (h, w, 6) in the view's frame from offsets and slopes in the camera's frame, (4, h, w)."""
        x, y, tx, ty = offset_and_slope
        rotation, origin = self.frame_from_camera[:3, :3].astype(np.float32), self.frame_from_camera[:3, 3]
        scale = 1.0 / np.sqrt(1.0 + tx * tx + ty * ty)
        ray = np.empty((*x.shape, 6), dtype=np.float32)
        for axis, (right, down, forward) in enumerate(rotation):
            ray[..., axis] = right * x + down * y + np.float32(origin[axis])
            ray[..., 3 + axis] = (right * tx + down * ty + forward) * scale
        return ray

    @cached_property
    def _panel_maps(self) -> list[Float32Array]:
        """Maps (2, h, w), one for each sample, with which `cv2.remap` samples the panel's image bilinearly."""
        places = [field.planes() for field in self.on_panel]
        blur = _panel_blur(places, [field.lit for field in self.on_panel])
        for place, field in zip(places, self.on_panel, strict=True):
            place[:, ~field.lit] = _OFF_PANEL
            np.clip(place, _OFF_PANEL, _FARTHEST, out=place)
            _sharpen(place, blur)
        return places


def _maps(
    lens: SimulatedLens,
    samples: int,
    exact: Callable[[FloatArray, FloatArray], tuple[FloatArray, BoolArray]],
    tolerance: FloatArray,
) -> tuple[PixelMap, ...]:
    return tuple(
        PixelMap.sample(partial(exact, pupil_point), lens.camera.size_px, offset, tolerance)
        for offset, pupil_point in zip(*lens.samples(samples), strict=True)
    )


def _offset_and_slope(ray_in_camera: FloatArray) -> tuple[FloatArray, BoolArray]:
    """Return x, y in the plane z = 0 and the tangents of rays, (n, 4), and a mask (n,) of forward rays."""
    forward = ray_in_camera[:, 5] > 0.0
    ray = rays.at_z(np.where(forward[:, None], ray_in_camera, np.nan), 0.0)
    return np.concatenate([ray[:, :2], ray[:, 3:5] / ray[:, 5:]], axis=-1), forward


def _panel_blur(places: list[Float32Array], lit: list[BoolArray]) -> FloatArray:
    """Return the width (2,) of one sample in u and v, panel pixels: the spread of all samples over sqrt(samples).

    A box with standard deviation sigma is sqrt(12) sigma wide. The result is the median over the picture.
    """
    some = (slice(None, None, _BLUR_STEP), slice(None, None, _BLUR_STEP))
    everywhere = np.logical_and.reduce([one[some] for one in lit])
    sampled = np.array([place[:, some[0], some[1]][:, everywhere] for place in places])
    reach = np.sqrt(12.0 / len(places)) * sampled.std(axis=0)
    return np.median(reach, axis=-1) if reach.size else np.zeros(2)


def _sharpen(place: Float32Array, blur: FloatArray) -> None:
    """Convert panel positions (2, h, w) to OpenCV's, shifted so that bilinear sampling shows square pixels.

    Between two pixel centres, sampling then gives one pixel's value, a ramp as wide as `blur`, and the other's value.
    """
    for axis, width in zip(place, np.clip(blur, _NARROWEST_PX, 1.0).astype(np.float32), strict=True):
        axis -= np.float32(0.5)
        whole = np.floor(axis)
        axis[...] = whole + np.clip((axis - whole - np.float32(0.5)) / width + np.float32(0.5), 0.0, 1.0)
