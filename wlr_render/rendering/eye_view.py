"""What the eye sees: the real scene through the combiner, and the panel reflected in it, by an eyeball camera."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from wlr_render.geometry import directions, rays
from wlr_render.geometry.pinhole import Pinhole
from wlr_render.mappings import EyeMappings
from wlr_render.numerics.arrays import FloatArray
from wlr_render.rendering.ray_render import RayRenderer
from wlr_render.rendering.sampling import remap
from wlr_render.rendering.srgb import decode_srgb, encode_srgb


@dataclass(frozen=True, eq=False)
class EyeView:
    """An eyeball camera's picture before the display is switched on, and where it sees the panel.

    Attributes:
        real: (height, width, 3) uint8 sRGB, the real scene as seen through the combiner.
        panel_pixel: (height, width, 2) which panel pixel is reflected there, NaN where none is.
    """

    real: NDArray[np.uint8]
    panel_pixel: FloatArray

    def with_display(self, shown: NDArray[np.uint8], gain: float = 1.0, see_through: float = 1.0) -> NDArray[np.uint8]:
        """Switch the display on: light adds up.

        Args:
            shown: (panel height, panel width, 3) uint8 sRGB, what the panel shows.
            gain: share of the panel's light that reaches the eye.
            see_through: share of the world's light that does.

        Returns:
            (height, width, 3) uint8 sRGB.
        """
        reflected, _ = remap(shown, self.panel_pixel)
        light = see_through * decode_srgb(self.real) + gain * decode_srgb(np.asarray(reflected, np.uint8))
        return encode_srgb(light.astype(np.float32))


def eye_view(
    truth: EyeMappings, renderer: RayRenderer, viewpoint: FloatArray, world_from_device: FloatArray, camera: Pinhole
) -> EyeView:
    """Look through the optics.

    Args:
        truth: the mappings of the optics that the eye really looks through.
        renderer: of the real scene.
        viewpoint: (3,) entrance pupil, device frame.
        world_from_device: (4, 4) head pose.
        camera: the eyeball camera; axes of the device frame.
    """
    view_dir = directions.dir_of_tangents(camera.pixel_centre_tangents())
    real_ray = rays.transformed(world_from_device, truth.see_through.real_ray_of_view_dir(view_dir, viewpoint).value)
    origin, direction = rays.split(real_ray)
    real = renderer.render_rays(origin, direction, shadows=True)
    return EyeView(real.colour, truth.display.pixel_of_view_dir(view_dir, viewpoint).value)
