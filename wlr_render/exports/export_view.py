"""The view that every format writes: the rays of one panel for one pupil, and the camera of the source picture."""

import functools
import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, replace
from typing import Any, Protocol

import numpy as np

from wlr_render.geometry.pinhole import Pinhole
from wlr_render.mappings import COLOURS, Eye, EyeChannels, middle_channel
from wlr_render.numerics.arrays import BoolArray, Float32Array, FloatArray
from wlr_render.warp.raster_camera import RasterPlace, RasterPosition, intermediate_camera, ray_map_plans
from wlr_render.warp.ray_map import RayMapPlan, middle_axes, ray_map, solve_pixels
from wlr_render.warp.view import View

ALL_COLOURS = "all"
"""Name of the single map for all colours."""


class Predicted(Protocol):
    """Predicted registration error of one channel; `budget.error_map.PredictedError`."""

    @property
    def record(self) -> dict[str, Any]:
        """Errors over the field of view, plain JSON."""

    def at_pixel(self, pixel: FloatArray) -> FloatArray:
        """Return the rms errors (n,) in arcminutes at pixels (n, 2)."""


Predictor = Callable[[FloatArray, float], Predicted]
"""Function of viewpoint (3,) and depth (m) that returns the predicted error of one channel."""


@dataclass(frozen=True)
class Origin:
    """The headset that an export describes.

    Attributes:
        name: device name, and how its mappings were made.
        sha256: SHA-256 of each file that was read, by its name.
        wavelength_nm: wavelength at which the maps are traced, by colour; empty for fitted models.
    """

    name: str
    sha256: Mapping[str, str]
    wavelength_nm: Mapping[str, float]


@dataclass(frozen=True, eq=False)
class ExportedView:
    """One eye at one pupil position, with the camera of the source picture.

    All rays and positions are in the camera's frame: origin at its position, x right, y up, looking along -z.

    Attributes:
        origin: the headset.
        stem: start of the names of this view's files, e.g. "right" or "right-000012".
        channels: mappings of the eye: one, or one each for red, green and blue.
        plans: plans of the ray maps, one for each channel, in the axes of the camera.
        source: the camera and its place in the device; its world is the device.
        viewpoint: (3,) centre of the entrance pupil in the device frame, metres.
        depth_m: depth from the camera at which positions in the picture are correct; infinite by default.
        time_s: time stamp of a trajectory.
        place_of: position (3,) of the camera in the device as a function of the viewpoint.
        other_light: mappings of the other colours that one map serves, by name; empty if unknown, or if each colour has
            a map.
        predictors: predicted errors of each channel; empty for headsets without predicted errors.
    """

    origin: Origin
    stem: str
    channels: EyeChannels
    plans: tuple[RayMapPlan, ...]
    source: View
    viewpoint: FloatArray
    depth_m: float = math.inf
    time_s: float | None = None
    place_of: Callable[[FloatArray], FloatArray] = lambda viewpoint: viewpoint
    other_light: Mapping[str, Eye] = field(default_factory=dict)
    predictors: tuple[Predictor, ...] = ()

    def moved_to(self, viewpoint: FloatArray, stem: str, time_s: float | None) -> "ExportedView":
        """Return the view for another pupil position, with its camera."""
        source = replace(self.source, position_in_device=self.place_of(viewpoint))
        return replace(self, stem=stem, viewpoint=viewpoint, source=source, time_s=time_s)

    @property
    def eye(self) -> str:
        """Name of the eye: "left" or "right"."""
        return self.channels[0].eye

    @property
    def panel_size_px(self) -> tuple[int, int]:
        """(width, height) of the panel, and of every map."""
        panel = self.channels[0].display.panel
        return panel.width_px, panel.height_px

    @property
    def colours(self) -> tuple[str, ...]:
        """Names of the maps: `COLOURS`, or `ALL_COLOURS` alone."""
        return COLOURS if len(self.channels) > 1 else (ALL_COLOURS,)

    @property
    def all_colours(self) -> str:
        """Name of the file that has the maps of all colours."""
        return ", ".join(self.colours)

    @property
    def middle_colour(self) -> str:
        """Name of the map in the middle of the spectrum."""
        return middle_channel(self.colours)

    def mappings(self, colour: str) -> Eye:
        """Return the mappings of one colour."""
        return self.channels[self.colours.index(colour)]

    def predicted_error(self, colour: str) -> Mapping[str, Any] | None:
        """Return the predicted registration error of one colour at `viewpoint` and `depth_m`; None if unknown."""
        if not self.predictors:
            return None
        return self.predictors[self.colours.index(colour)](self.viewpoint, self.depth_m).record

    @property
    def stems(self) -> tuple[str, ...]:
        """Start of the file names of each colour."""
        return tuple(self.stem if colour == ALL_COLOURS else f"{self.stem}-{colour}" for colour in self.colours)

    def slope_offset(self, colour: str) -> Float32Array:
        """Return the rays (a, b, c, d) of all panel pixels, (4, height, width) float32; NaN where a pixel has no ray.

        At depth Z from the camera a ray is at (a Z + c, b Z + d, -Z), in metres.
        """
        return self._slope_offsets[self.colours.index(colour)]

    @functools.cached_property
    def _slope_offsets(self) -> tuple[Float32Array, ...]:
        maps = [ray_map(each, self.viewpoint, plan) for each, plan in zip(self.channels, self.plans, strict=True)]
        rays = [np.moveaxis(each.slope_offset, 0, -1).astype(np.float64) for each in maps]
        return tuple(self._at_camera(each, self.viewpoint).astype(np.float32) for each in rays)

    def rays_at(self, colour: str, pixel: FloatArray, viewpoint: FloatArray | None = None) -> FloatArray:
        """Return the exact rays of panel pixels (..., 2), like `slope_offset` but (..., 4) float64.

        Args:
            colour: colour of the map.
            pixel: positions anywhere on the panel; (0, 0) is the outer corner of the top left pixel.
            viewpoint: (3,) another pupil position; the camera stays.
        """
        return self.rays_of(self.mappings(colour), pixel, self.viewpoint if viewpoint is None else viewpoint)

    def rays_of(self, mappings: Eye, pixel: FloatArray, viewpoint: FloatArray) -> FloatArray:
        """Return the same rays for other mappings of this eye."""
        solved = solve_pixels(mappings, self.source.device_from_camera, pixel, viewpoint)
        return np.moveaxis(self._at_camera(solved.slope_offset, viewpoint), 0, -1)

    def tangents(self, rays: FloatArray, depth_m: float | None = None) -> FloatArray:
        """Return the tangents (..., 2), at the camera, of rays' points (4, ...) at a depth, by default `depth_m`."""
        return np.moveaxis(rays[:2] + rays[2:] / (self.depth_m if depth_m is None else depth_m), 0, -1)

    def source_px(self, colour: str) -> Float32Array:
        """Return positions (u, v) of panel pixels in the source picture, (height, width, 2) float32; NaN without a ray.

        (0, 0) is the outer corner of the top left pixel of the picture, v runs down. Positions may lie outside.
        """
        tangents = self.tangents(self.slope_offset(colour).astype(np.float64))
        return self.source.camera.pixel_of_tangents(tangents).astype(np.float32)

    def _at_camera(self, rays: FloatArray, viewpoint: FloatArray) -> FloatArray:
        """Move the origin of rays (..., 4) from a viewpoint to the camera: (4, ...)."""
        x, y, z = self.source.device_from_camera.T @ (self.source.position_in_device - viewpoint)
        a, b, c, d = np.moveaxis(rays, -1, 0)
        return np.stack([a, b, c - a * z - x, d - b * z - y])


def has_ray(position: FloatArray | Float32Array) -> BoolArray:
    """Return whether positions or tangents (..., 2) belong to a ray, and are not NaN."""
    return np.asarray(np.isfinite(position).all(axis=-1))


def view_from_centre(
    channels: EyeChannels,
    origin: Origin,
    *,
    is_turned: bool,
    resolution: float = 1.0,
    source_size: tuple[int, int] | None = None,
    source_camera: RasterPlace = "viewpoint",
    depth_m: float = math.inf,
    other_light: Mapping[str, Eye] | None = None,
    predictors: tuple[Predictor, ...] = (),
) -> ExportedView:
    """Return a view from the centre of the eye box, with a camera for the whole box.

    Args:
        channels, origin, depth_m, other_light, predictors: see `ExportedView`.
        is_turned: whether the camera looks at the middle of the field of view; else along the device's -z axis.
        resolution: pixels of the source picture per panel pixel and axis.
        source_size: (width, height) of the source picture, in place of `resolution`.
        source_camera: position of the camera: the viewpoint, or the point nearest to the bent rays.
    """
    middle = middle_channel(channels)
    panel, centre = middle.display.panel, middle.eye_box.centre
    axes = middle_axes(middle) if is_turned else np.eye(3)
    camera = intermediate_camera(channels, axes, resolution, (panel.width_px, panel.height_px), 0.0)
    if source_size:
        camera = Pinhole(*source_size, camera.tangent_min, camera.tangent_max)
    place_of = RasterPosition(middle, axes).at if source_camera == "nearest" else lambda viewpoint: viewpoint
    source = View(camera, place_of(centre), np.eye(4), axes)
    plans = ray_map_plans(channels, axes)
    return ExportedView(
        origin,
        middle.eye,
        channels,
        plans,
        source,
        centre,
        depth_m,
        place_of=place_of,
        other_light=other_light or {},
        predictors=predictors,
    )


def with_symmetric_camera(
    views: Mapping[str, ExportedView], source_size: tuple[int, int] | None = None
) -> dict[str, ExportedView]:
    """Return views with symmetric pictures, left to right and up to down, with the same borders for each eye.

    Args:
        views: views by eye.
        source_size: (width, height) of the pictures; by default as dense as the densest view.
    """
    cameras = [view.source.camera for view in views.values()]
    half = np.max([np.abs([camera.tangent_min, camera.tangent_max]) for camera in cameras], axis=(0, 1))
    density = np.max([camera.focal_px for camera in cameras], axis=0)
    width, height = source_size or np.ceil(2 * half * density).astype(int).tolist()
    camera = Pinhole(width, height, -half, half)
    return {eye: replace(view, source=replace(view.source, camera=camera)) for eye, view in views.items()}
