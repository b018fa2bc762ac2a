"""Convert observations in photographs to captures in the device frame."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from wlr_render.captures.boards.board import BoardObservation
from wlr_render.captures.correspondences import AnyCaptures, DisplayCaptures, SeeThroughCaptures, concatenate, select
from wlr_render.captures.decoded import DecodedSamples
from wlr_render.captures.photo_session import CHANNELS, CodeSet, SessionEntry
from wlr_render.errors import BadInputError
from wlr_render.geometry import transforms
from wlr_render.geometry.directions import ARCMIN
from wlr_render.geometry.lens import Lens, radians_per_pixel
from wlr_render.mappings import EyeBox, Panel
from wlr_render.numerics.arrays import BoolArray, FloatArray
from wlr_render.usual import CAMERA_SYSTEMATIC_PX

_BEYOND_FIELD = 0.05  # margin on each side of the panel's field: solves start and interpolate there


@dataclass(frozen=True)
class Headset:
    """The headset and eye that captures belong to.

    Attributes:
        device: its name.
        eye: "left" or "right".
        eye_box: where the pupil may be, device frame.
    """

    device: str
    eye: str
    eye_box: EyeBox


def panel_captures(
    headset: Headset, panel: Panel, camera: Lens, pose: FloatArray, samples: DecodedSamples, **columns: Any
) -> DisplayCaptures:
    """Return captures of the panel decoded at one camera pose.

    Args:
        headset: the headset.
        panel: its panel.
        camera: the lens; it has OpenCV's axes.
        pose: (4, 4) device_from_camera.
        samples: the decoded panel positions.
        **columns: other columns of captures: `capture`, and the recorded ones.

    Raises:
        BadInputError: the camera does not look at the optics.
    """
    # The uncertainty of a decoded panel position becomes one of its direction, in camera pixels.
    rows, sound = _rows(headset, camera, pose, samples.camera_pixel, samples.sigma_px / samples.scale)
    return DisplayCaptures(panel=panel, pixel=samples.panel_pixel[sound], **rows, **columns)


def target_captures(
    headset: Headset,
    camera: Lens,
    pose: FloatArray,
    device_from_target: FloatArray,
    observation: BoardObservation,
    target_point: FloatArray,
    **columns: Any,
) -> SeeThroughCaptures:
    """Return captures of the target observed through the optics at one camera pose.

    Args:
        headset, pose, **columns: as in `panel_captures`.
        camera: the lens as it is at this target's distance.
        device_from_target: (4, 4).
        observation: the features found.
        target_point: (n, 3) their true places, target's frame.

    Raises:
        BadInputError: the camera does not look at the optics.
    """
    pixel, discs = observation.pixel, observation.discs
    if discs is not None:
        pixel = discs.centres(camera, target_point, pixel)
    rows, sound = _rows(headset, camera, pose, pixel, observation.sigma_px)
    on_target = target_point[sound]
    point = transforms.apply(device_from_target, on_target)
    return SeeThroughCaptures(point=point, target_point=on_target, **rows, **columns)


def joined_views(views: Sequence[AnyCaptures], what: str) -> AnyCaptures:
    """Return the captures of all views; `what` names the photographed thing in the error.

    Raises:
        BadInputError: `views` is empty.
    """
    if not views:
        raise BadInputError(f"no photographs of {what} are left to fit a model to; see which were rejected.")
    return concatenate(views)


def within_field(see_through: SeeThroughCaptures, display: DisplayCaptures) -> SeeThroughCaptures:
    """Return the dots within the field of view of the panel plus a margin, where the model is used.

    Raises:
        BadInputError: no dot was.
    """
    shown = display.tangents
    low, high = shown.min(axis=0), shown.max(axis=0)
    beyond = _BEYOND_FIELD * (high - low)
    seen = see_through.tangents
    inside = np.all((seen >= low - beyond) & (seen <= high + beyond), axis=-1)
    if not inside.any():
        raise BadInputError("no dot of the target was seen in the directions of the panel; put the target before it.")
    return select(see_through, inside)


def recorded_of(taken: SessionEntry) -> dict[str, Any]:
    """Return what session.toml records of a photograph or a set, by the names of columns of captures."""
    stated = {"stage": taken.stage, "time_s": taken.time_s, "temperature_c": taken.temperature_c}
    if isinstance(taken, CodeSet) and taken.channel is not None:
        stated["channel"] = CHANNELS.index(taken.channel)
    return {name: value for name, value in stated.items() if value is not None}


def _rows(
    headset: Headset, camera: Lens, pose: FloatArray, pixel: FloatArray, sigma_px: FloatArray
) -> tuple[dict[str, Any], BoolArray]:
    """Columns that captures of both kinds have, of the pixels that the camera model has, and which (n,) these are.

    Args:
        headset: the headset.
        camera: the lens; it has OpenCV's axes.
        pose: (4, 4) device_from_camera.
        pixel: (n, 2) camera pixels.
        sigma_px: (n,) their standard deviations.

    Raises:
        BadInputError: some of them do not lead forward in the device frame.
    """
    in_camera = camera.dir_of_pixel(pixel)
    direction = transforms.rotate(pose, in_camera)
    if np.any(direction[:, 2] >= 0):
        raise BadInputError(
            "the eyeball camera looks back, not through the optics; check 'frame' and the tracking camera's 'rotation' "
            "in session.toml."
        )
    sound = np.asarray(np.isfinite(in_camera).all(axis=-1))
    arcmin_per_px = radians_per_pixel(camera, in_camera) / ARCMIN
    rows = {
        "device": headset.device,
        "eye": headset.eye,
        "eye_box": headset.eye_box,
        "viewpoint": pose[:3, 3],
        "view_dir": direction[sound],
        "sigma_arcmin": (np.hypot(sigma_px, CAMERA_SYSTEMATIC_PX.value) * arcmin_per_px)[sound],
        "device_from_camera": pose[:3, :3] @ transforms.OPENXR_FROM_OPENCV,
    }
    return rows, sound
