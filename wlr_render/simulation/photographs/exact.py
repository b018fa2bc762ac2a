"""What a camera before true optics sees, ray by exact ray through the middle of its pupil: the truth to judge by."""

from wlr_render.geometry.lens_camera import LensCamera
from wlr_render.geometry.transforms import inverse, rotate
from wlr_render.mappings import QueryResult
from wlr_render.numerics.arrays import FloatArray
from wlr_render.optics.device import EyeOptics
from wlr_render.optics.traced_mappings import TracedDisplay, TracedSeeThrough


def panel_position(
    optics: EyeOptics,
    camera: LensCamera,
    device_from_camera: FloatArray,
    pixel: FloatArray,
    wavelength_um: float = 0.55,
) -> QueryResult:
    """Which place on the panel camera pixels (..., 2) see; `value` (..., 2) panel pixels."""
    direction = rotate(device_from_camera, camera.dir_of_pixel(pixel))
    return TracedDisplay(optics, wavelength_um).pixel_of_view_dir(direction, device_from_camera[:3, 3])


def pixel_of_panel_position(
    optics: EyeOptics,
    camera: LensCamera,
    device_from_camera: FloatArray,
    position: FloatArray,
    wavelength_um: float = 0.55,
) -> FloatArray:
    """The camera pixels (..., 2) that see places on the panel (..., 2); NaN where they are not seen."""
    seen = TracedDisplay(optics, wavelength_um).view_dir_of_pixel(position, device_from_camera[:3, 3])
    return camera.pixel_of_point(rotate(inverse(device_from_camera), seen.value))


def pixel_of_real_point(
    optics: EyeOptics,
    camera: LensCamera,
    device_from_camera: FloatArray,
    point: FloatArray,
    wavelength_um: float = 0.55,
) -> FloatArray:
    """The camera pixels (..., 2) that see real points (..., 3), device frame, through the optics; NaN where not."""
    seen = TracedSeeThrough(optics, wavelength_um).view_dir_of_real_point(point, device_from_camera[:3, 3])
    return camera.pixel_of_point(rotate(inverse(device_from_camera), seen.value))
