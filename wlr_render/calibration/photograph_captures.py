"""Convert observations in photographs to captures in the device frame."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from wlr_render.captures.boards.board import BoardObservation
from wlr_render.captures.correspondences import DisplayCaptures, SeeThroughCaptures, concatenate, select
from wlr_render.captures.decoded import DecodedSamples
from wlr_render.captures.photo_session import CHANNELS, BoardPhotograph, CodeSet
from wlr_render.errors import BadInputError
from wlr_render.geometry import transforms
from wlr_render.geometry.directions import ARCMIN
from wlr_render.geometry.lens import Lens, radians_per_pixel
from wlr_render.mappings import EyeBox, Panel
from wlr_render.numerics.arrays import BoolArray, FloatArray

_BEYOND_FIELD = 0.05  # of the panel's field on each side: solves start and interpolate there
_SYSTEMATIC_PX = 0.01
"""Camera pixels that the lens model and the optics' own blur leave, of which the noise of a reading knows nothing:
without them a fit would follow a few readings of very little noise. In
simulated sessions fits find 0.008 to 0.017 px."""


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


@dataclass(frozen=True, eq=False)
class PanelView:
    """The panel decoded at one camera pose.

    Attributes:
        device_from_camera: (4, 4).
        samples: what was decoded.
        conditions: what was recorded, by the names of columns of captures.
    """

    device_from_camera: FloatArray
    samples: DecodedSamples
    conditions: Mapping[str, ArrayLike] = field(default_factory=dict)


@dataclass(frozen=True, eq=False)
class TargetView:
    """The target observed through the optics at one camera pose.

    Attributes:
        device_from_camera, device_from_target: (4, 4).
        target_pose: index of the target's place.
        capture: index of the camera's place.
        observation: the features found.
        target_point: (n, 3) their true places, target's frame.
        conditions: as of a `PanelView`.
        camera: the lens as it is at this target's distance; None where it is that of all views.
    """

    device_from_camera: FloatArray
    device_from_target: FloatArray
    target_pose: int
    capture: int
    observation: BoardObservation
    target_point: FloatArray
    conditions: Mapping[str, ArrayLike] = field(default_factory=dict)
    camera: Lens | None = None


def display_captures(headset: Headset, panel: Panel, camera: Lens, views: Sequence[PanelView]) -> DisplayCaptures:
    """Return captures of the panel; every view is one camera position.

    Raises:
        BadInputError: there are no views, or a camera does not look at the optics.
    """
    if not views:
        raise BadInputError("no photographs of the panel are left to fit the display to; see which were rejected.")
    parts = []
    for number, view in enumerate(views):
        samples = view.samples
        # The decoded panel position is uncertain; as a direction it is so by the camera pixels that it stands for.
        rows, sound = _rows(headset, camera, view, samples.camera_pixel, samples.sigma_px / samples.scale)
        capture = np.array(number)
        parts.append(DisplayCaptures(panel=panel, pixel=samples.panel_pixel[sound], capture=capture, **rows))
    return concatenate(parts)


def see_through_captures(headset: Headset, camera: Lens, views: Sequence[TargetView]) -> SeeThroughCaptures:
    """Return captures of the target through the optics.

    Raises:
        BadInputError: there are no views, or a target lies behind a camera.
    """
    if not views:
        raise BadInputError(
            "no photographs of the target through the optics are left to fit see-through to; see which were rejected."
        )
    parts = []
    for view in views:
        lens, discs = view.camera or camera, view.observation.discs
        pixel = (
            view.observation.pixel if discs is None else discs.centres(lens, view.target_point, view.observation.pixel)
        )
        rows, sound = _rows(headset, lens, view, pixel, view.observation.sigma_px)
        on_target = view.target_point[sound]
        parts.append(
            SeeThroughCaptures(
                point=transforms.apply(view.device_from_target, on_target),
                target_point=on_target,
                capture=np.array(view.capture),
                target_pose=np.array(view.target_pose),
                **rows,
            )
        )
    return concatenate(parts)


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


def recorded_of(taken: BoardPhotograph | CodeSet) -> dict[str, ArrayLike]:
    """Return what session.toml records of a photograph or a set, by the names of columns of captures."""
    stated = {"stage": taken.stage, "time_s": taken.time_s, "temperature_c": taken.temperature_c}
    if isinstance(taken, CodeSet) and taken.channel is not None:
        stated["channel"] = CHANNELS.index(taken.channel)
    return {name: value for name, value in stated.items() if value is not None}


def _rows(
    headset: Headset, camera: Lens, view: PanelView | TargetView, pixel: FloatArray, sigma_px: FloatArray
) -> tuple[dict[str, Any], BoolArray]:
    """Columns that captures of both kinds have, of the pixels that the camera model has, and which (n,) these are.

    Args:
        headset: the headset.
        camera: the lens; it has OpenCV's axes.
        view: one camera pose.
        pixel: (n, 2) camera pixels.
        sigma_px: (n,) their standard deviations.

    Raises:
        BadInputError: some of them do not lead forward in the device frame.
    """
    pose, in_camera = view.device_from_camera, camera.dir_of_pixel(pixel)
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
        "sigma_arcmin": (np.hypot(sigma_px, _SYSTEMATIC_PX) * arcmin_per_px)[sound],
        "device_from_camera": pose[:3, :3] @ transforms.OPENXR_FROM_OPENCV,
    }
    return {**view.conditions, **rows}, sound
