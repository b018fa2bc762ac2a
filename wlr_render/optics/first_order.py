"""Focal length, image distance, orientation, magnification and distortion of a display.

All are computed from traced rays; no pixel is solved.
"""

from dataclasses import dataclass

import numpy as np

from wlr_render.geometry.directions import dir_of_tangents, tangents_of_dir
from wlr_render.mappings import Status
from wlr_render.numerics.arrays import FloatArray
from wlr_render.optics.device import EyeOptics
from wlr_render.optics.ray_losses import judged_directions, on_panel
from wlr_render.optics.traced_mappings import TracedDisplay

_TANGENT_STEP = 1e-4
_EYE_STEP_M = 1e-4


@dataclass(frozen=True)
class FirstOrder:
    """First-order imaging of the panel around the middle of the field, along x and y of the device.

    Attributes:
        focal_length_m: distance on the panel for a tangent of 1.
        vergence_per_m: inverse distance of the virtual image; negative where it lies behind the eye.
        distortion_rms: departure of positions on the panel from the scale at the middle, relative to the farthest
            position; rms over the field.
        distortion_max: largest departure.
        u_direction: unit vector (to the wearer's right, up) in which u of the panel grows in the view.
        v_direction: the same for v.
    """

    focal_length_m: tuple[float, float]
    vergence_per_m: tuple[float, float]
    distortion_rms: float
    distortion_max: float
    u_direction: tuple[float, float]
    v_direction: tuple[float, float]

    @property
    def magnification(self) -> tuple[float, float]:
        """Size of the virtual image relative to the panel; infinite for an image at infinity."""
        x, y = (
            1.0 / abs(vergence * focal) if vergence and focal else np.inf
            for vergence, focal in zip(self.vergence_per_m, self.focal_length_m, strict=True)
        )
        return x, y


def first_order(optics: EyeOptics, wavelength_um: float) -> FirstOrder | None:
    """Compute the first-order imaging from the rays that reach the panel; None if rays around their middle are lost.

    Args:
        optics: the eye.
        wavelength_um: vacuum wavelength in micrometres.
    """
    tangents = tangents_of_dir(judged_directions(optics))
    place = _place(optics, tangents, optics.eye_box.centre, wavelength_um)
    arriving = on_panel(optics, optics.panel.pixel_of_local(place))
    if not arriving.any():
        return None
    tangents, place = tangents[arriving], place[arriving]
    nearest = int(np.argmin(np.linalg.norm(tangents - tangents.mean(axis=0), axis=-1)))
    middle = tangents[nearest]
    steps = np.concatenate([np.eye(2), -np.eye(2)])
    by_tangent = _place(optics, middle + _TANGENT_STEP * steps, optics.eye_box.centre, wavelength_um)
    eyes = optics.eye_box.centre + _EYE_STEP_M * np.pad(steps, ((0, 0), (0, 1)))
    by_eye = _place(optics, np.broadcast_to(middle, (4, 2)), eyes, wavelength_um)
    scale = ((by_tangent[:2] - by_tangent[2:]) / (2.0 * _TANGENT_STEP)).T
    shift = ((by_eye[:2] - by_eye[2:]) / (2.0 * _EYE_STEP_M)).T
    if not (np.isfinite(scale).all() and np.isfinite(shift).all()) or np.linalg.det(scale) == 0.0:
        return None
    # A position on the panel stays the same if the eye moves by e and the tangent by -e / distance.
    vergence = np.linalg.solve(scale, shift)
    straight = (tangents - middle) @ scale.T
    away = np.linalg.norm(place - place[nearest] - straight, axis=-1)
    farthest = max(float(np.linalg.norm(straight, axis=-1).max()), np.finfo(float).tiny)
    focal = np.linalg.norm(scale, axis=0)
    in_view = np.linalg.inv(scale)
    (u_right, v_right), (u_up, v_up) = (in_view / np.linalg.norm(in_view, axis=0)).tolist()
    return FirstOrder(
        (float(focal[0]), float(focal[1])),
        (float(vergence[0, 0]), float(vergence[1, 1])),
        float(np.sqrt(np.mean(away**2)) / farthest),
        float(away.max() / farthest),
        (u_right, u_up),
        (v_right, v_up),
    )


def _place(optics: EyeOptics, tangents: FloatArray, viewpoint: FloatArray, wavelength_um: float) -> FloatArray:
    """Return positions on the panel (n, 2) in metres from its middle; NaN for lost rays."""
    pixel, status = TracedDisplay(optics, wavelength_um).plane_pixel(dir_of_tangents(tangents), viewpoint)
    local = (pixel / optics.panel.pixels.size_px - 0.5) * optics.panel.size
    return np.where((status == Status.OK)[..., None], local, np.nan)
