"""Exact camera views of panel and world through the optics, without light."""

from wlr_render.geometry.lens_camera import LensCamera
from wlr_render.geometry.transforms import inverse, rotate
from wlr_render.mappings import QueryResult
from wlr_render.numerics.arrays import FloatArray
from wlr_render.optics.device import EyeOptics
from wlr_render.optics.traced_mappings import TracedDisplay, TracedSeeThrough
from wlr_render.simulation.photographs.camera_view import WAVELENGTH_UM


def panel_position(
    optics: EyeOptics,
    camera: LensCamera,
    device_from_camera: FloatArray,
    pixel: FloatArray,
) -> QueryResult:
    """Return the panel positions that camera pixels (..., 2) see; `value` (..., 2) panel pixels."""
    direction = rotate(device_from_camera, camera.dir_of_pixel(pixel))
    return TracedDisplay(optics, WAVELENGTH_UM).pixel_of_view_dir(direction, device_from_camera[:3, 3])


def pixel_of_real_point(
    optics: EyeOptics,
    camera: LensCamera,
    device_from_camera: FloatArray,
    point: FloatArray,
) -> FloatArray:
    """Return the camera pixels (..., 2) of real points (..., 3), device frame, through the optics; NaN if not seen."""
    view = TracedSeeThrough(optics, WAVELENGTH_UM).view_dir_of_real_point(point, device_from_camera[:3, 3])
    return camera.pixel_of_point(rotate(inverse(device_from_camera), view.value))
