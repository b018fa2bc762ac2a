"""What is decided once for an eye: its axes, the camera of its intermediate image, how finely its field is known."""

import functools
from dataclasses import dataclass

from wlr_render.compositing.eye_camera import EyeCamera
from wlr_render.geometry.pinhole import Pinhole
from wlr_render.mappings import Channels
from wlr_render.numerics.arrays import FloatArray
from wlr_render.rendering.choose_lattice import ChosenLattice, choose_lattice
from wlr_render.rendering.covering import covering_camera
from wlr_render.rendering.map_shrink import shrink_over_eye_box, taps_for
from wlr_render.rendering.raster_eye import RasterEye
from wlr_render.rendering.ray_field import middle_axes
from wlr_render.rendering.view import View


@dataclass(frozen=True, eq=False)
class EyePlan:
    """Fixed for all frames of one eye.

    Attributes:
        eye: "left" or "right".
        channels: one pair of mappings, or one per colour channel.
        size_px: (width, height) of the display's picture, which covers the panel.
        device_from_camera: (3, 3) axes of the intermediate image and of the field.
        camera: of the intermediate image.
        raster_eye: where that camera stands for a viewpoint.
        taps: samples per display pixel and axis that the filter takes.
    """

    eye: str
    channels: Channels
    size_px: tuple[int, int]
    device_from_camera: FloatArray
    camera: Pinhole
    raster_eye: RasterEye
    taps: int

    @functools.cached_property
    def lattice(self) -> ChosenLattice:
        """Points between which the fields may be read bilinearly, and how far off that is.

        Of the colours, that which needs the finest; chosen when first asked for: who solves every pixel needs none.
        """
        chosen = [choose_lattice(mappings, self.device_from_camera, self.size_px) for mappings in self.channels]
        return min(chosen, key=lambda each: float(each.cell_px.min()))

    @classmethod
    def of(cls, channels: Channels, size_px: tuple[int, int], resolution: float, late_margin: float) -> "EyePlan":
        """Decide.

        Args:
            channels: of one eye.
            size_px: (width, height) of the display.
            resolution: of the intermediate image, as in `covering_camera`.
            late_margin: tangents by which the head may turn between drawing and scan-out.
        """
        middle = channels[len(channels) // 2]
        axes = middle_axes(middle)
        camera = covering_camera(channels, axes, resolution, size_px, late_margin)
        taps = taps_for(shrink_over_eye_box(middle, axes, camera, size_px))
        return cls(middle.eye, channels, size_px, axes, camera, RasterEye(middle, axes), taps)

    def eye_camera(self, viewpoint: FloatArray, world_from_device: FloatArray) -> EyeCamera:
        """From where to draw for a viewpoint (3,) and a head pose (4, 4)."""
        place = self.raster_eye.at(viewpoint)
        return EyeCamera(self.eye, View(self.camera, place, world_from_device, self.device_from_camera))
