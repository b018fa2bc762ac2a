"""Exact camera views of panel and world through the optics, without light."""

import numpy as np

from wlr_render.geometry.transforms import inverse, rotate
from wlr_render.lenses.lens_camera import LensCamera
from wlr_render.mappings import QueryResult
from wlr_render.numerics.arrays import FloatArray
from wlr_render.optics.device import EyeOptics
from wlr_render.optics.traced_mappings import TracedDisplay, TracedSeeThrough
from wlr_render.simulation.photographs.camera_view import WAVELENGTH_UM
from wlr_render.simulation.workshop import Workshop

_ROUNDS = 4  # rounds of the search for a pixel; each leaves a hundredth of the residual distortion's error


def panel_position(
    optics: EyeOptics,
    camera: LensCamera,
    device_from_camera: FloatArray,
    pixel: FloatArray,
    workshop: Workshop | None = None,
) -> QueryResult:
    """Return the panel positions that camera pixels (..., 2) see; `value` (..., 2) panel pixels.

    A workshop gives the camera a residual distortion, and a pupil that moves with the field angle.
    """
    residual_px, pupil = _lens_errors(camera, pixel, workshop)
    direction = rotate(device_from_camera, camera.dir_of_pixel(pixel + residual_px))
    viewpoint = device_from_camera[:3, 3] + rotate(device_from_camera, pupil)
    return TracedDisplay(optics, WAVELENGTH_UM).pixel_of_view_dir(direction, viewpoint)


def pixel_of_point(camera: LensCamera, point_in_camera: FloatArray, workshop: Workshop | None = None) -> FloatArray:
    """Return the camera pixels (..., 2) of points (..., 3), camera frame, without optics; NaN if not seen."""
    pixel = camera.pixel_of_point(point_in_camera)
    for _ in range(_ROUNDS if workshop else 0):
        residual_px, pupil = _lens_errors(camera, pixel, workshop)
        pixel = camera.pixel_of_point(point_in_camera - pupil) - residual_px
    return pixel


def pixel_of_real_point(
    optics: EyeOptics,
    camera: LensCamera,
    device_from_camera: FloatArray,
    point: FloatArray,
    workshop: Workshop | None = None,
) -> FloatArray:
    """Return the camera pixels (..., 2) of real points (..., 3), device frame, through the optics; NaN if not seen."""
    see_through, camera_from_device = TracedSeeThrough(optics, WAVELENGTH_UM), inverse(device_from_camera)
    view = see_through.view_dir_of_real_point(point, device_from_camera[:3, 3])
    pixel = camera.pixel_of_point(rotate(camera_from_device, view.value))
    for _ in range(_ROUNDS if workshop else 0):
        residual_px, pupil = _lens_errors(camera, pixel, workshop)
        view = see_through.view_dir_of_real_point(point, device_from_camera[:3, 3] + rotate(device_from_camera, pupil))
        pixel = camera.pixel_of_point(rotate(camera_from_device, view.value)) - residual_px
    return pixel


def _lens_errors(camera: LensCamera, pixel: FloatArray, workshop: Workshop | None) -> tuple[FloatArray, FloatArray]:
    """Return the residual distortion (..., 2), pixels, and the place (..., 3) of the pupil, metres, camera frame."""
    if workshop is None:
        return np.zeros(2), np.zeros(3)
    size = np.array(camera.size_px)
    unit = (pixel - 0.5 * size) / (0.5 * np.linalg.norm(size))
    return workshop.lens_px(unit), workshop.pupil_m(unit)[..., None] * [0.0, 0.0, 1.0]
