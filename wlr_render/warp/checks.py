"""Checks of an engine's input, made before anything is changed."""

from collections.abc import Collection, Mapping, Sequence
from typing import Any

import numpy as np

from wlr_render.errors import BadInputError
from wlr_render.geometry.pinhole import Pinhole
from wlr_render.gl.framebuffers import is_number
from wlr_render.io.input_files import LIMITS, shown
from wlr_render.mappings import EYE_BOX_MARGIN, Eye, EyeBox, EyeChannels
from wlr_render.numerics.arrays import FloatArray, finite_array
from wlr_render.warp.gl_overlay import Quad
from wlr_render.warp.panel_light import PanelLight
from wlr_render.warp.raster_camera import EyePlan
from wlr_render.warp.ray_map import checked_viewpoint
from wlr_render.warp.stored_picture import Rows, StoredColour, StoredDepth

REACH = 0.5
"""Largest distance of a viewpoint outside the eye box, as a share of the box's size on each axis. Polynomials fitted
inside may be extrapolated a little; farther out their values are meaningless.
"""
FARTHEST_M = 1e8
"""Distance of a head from the world's origin: float64 resolves 15 nm there, and Earth-centred frames fit in."""
_ROTATION_SLACK = 1e-4
_ROUNDING = _ROUNDING_M = 1e-9


def checked_eye(eye: str | None, eyes: Sequence[str]) -> str:
    """Return the eye that a caller names; it may be left out if there is one.

    Raises:
        BadInputError: the eye is unknown, or left out although there are two.
    """
    if eye is None and len(eyes) > 1:
        raise BadInputError(f"there are two eyes; name one of {', '.join(eyes)} with eye=.")
    return eyes[0] if eye is None else checked_choice(eye, eyes, "eye")


def checked_eyes(given: object, eyes: Sequence[str]) -> list[str]:
    """Return some of the eyes, the left one first; all if None.

    Raises:
        BadInputError: none are given, or another name.
    """
    named = eyes if given is None else given
    if isinstance(named, str) or not isinstance(named, Collection) or not named:
        raise BadInputError(f"eyes is {shown(given)}; give some of {', '.join(eyes)}, as in eyes=('left',).")
    wanted = {checked_choice(eye, eyes, "an eye of eyes") for eye in named}
    return [eye for eye in eyes if eye in wanted]


def check_stored(stored: object, stored_colour: object, rows: object) -> None:
    """Check the types of a picture's storage conventions.

    Raises:
        BadInputError: one is something else.
    """
    if not (
        isinstance(stored, StoredDepth) and isinstance(stored_colour, StoredColour) and isinstance(rows, Rows | None)
    ):
        raise BadInputError(
            "stored must be a StoredDepth, stored_colour a StoredColour, and rows one of Rows; see "
            "warp/stored_picture.py."
        )


def check_submitted(eyes: Sequence[str], submitted: Collection[str]) -> None:
    """Check that all of some eyes have a picture.

    Raises:
        BadInputError: one has none.
    """
    never = [eye for eye in eyes if eye not in submitted]
    if never:
        raise BadInputError(
            f"the {never[0]} eye has not been submitted; submit it before compose, or name the other in eyes."
        )


def checked_quad(size_m: object, world_from_quad: object, device_from_quad: object) -> Quad:
    """Return the quad of an overlay.

    Raises:
        BadInputError: both poses are given or neither, or one is not rigid; or a size that is not positive.
    """
    wanted = "(width, height) of the quad in metres, both positive"
    size = finite_array(size_m, (2,), "size_m", wanted)
    if (size <= 0).any():
        raise BadInputError(f"size_m is {shown(size_m)}; give {wanted}.")
    if (world_from_quad is None) == (device_from_quad is None):
        raise BadInputError("an overlay has one pose; give either world_from_quad or device_from_quad.")
    is_head_locked = world_from_quad is None
    name = "device_from_quad" if is_head_locked else "world_from_quad"
    given: Any = device_from_quad if is_head_locked else world_from_quad
    return Quad(checked_pose(given, name), size, is_head_locked)


def checked_choice(value: object, choices: Sequence[str], what: str) -> str:
    """One of the words that an argument takes.

    Raises:
        BadInputError: it is another one, or no word.
    """
    if not isinstance(value, str) or value not in choices:
        raise BadInputError(f"{what} is {shown(value)}; choose from {', '.join(choices)}.")
    return value


def checked_flag(value: object, what: str) -> bool:
    """Return True or False; "no" would count as true.

    Raises:
        BadInputError: it is neither.
    """
    if not isinstance(value, bool | np.bool_):
        raise BadInputError(f"{what} is {shown(value)}; give True or False.")
    return bool(value)


def checked_number(value: object, what: str, at_least: float, at_most: float) -> float:
    """Return a number within limits.

    Raises:
        BadInputError: the value is not a number, or outside the limits.
    """
    wanted = f"a number from {at_least:g} to {at_most:g}"
    number = float(finite_array(value, (), what, wanted))
    if not at_least <= number <= at_most:
        raise BadInputError(f"{what} is {shown(value)}; give {wanted}.")
    return number


def checked_models(
    models: Eye | Sequence[Eye] | Mapping[str, Eye | Sequence[Eye]],
) -> dict[str, EyeChannels]:
    """Channels by eye, the left eye first.

    Raises:
        BadInputError: no eye, an eye of another name than its mappings', or colours that do not belong together.
    """
    by_eye = models if isinstance(models, Mapping) else {_eye_of(models): models}
    if not by_eye or not set(by_eye) <= {"left", "right"}:
        raise BadInputError(f"models are given for {sorted(map(str, by_eye))}; give them for 'left', 'right' or both.")
    return {eye: _checked_channels(eye, by_eye[eye]) for eye in sorted(by_eye)}


def _eye_of(models: Eye | Sequence[Eye]) -> str:
    first = models[0] if isinstance(models, Sequence) and models else models
    if not isinstance(first, Eye):
        raise BadInputError(
            f"a {type(first).__name__} is not a model of an eye; give Eye, or a dictionary by eye for two."
        )
    return first.eye


def _checked_channels(eye: str, models: Eye | Sequence[Eye]) -> EyeChannels:
    if not isinstance(models, Sequence):
        _eye_of(models)
    channels = tuple(models) if isinstance(models, Sequence) else (models,)
    if len(channels) not in (1, 3):
        raise BadInputError(f"{eye} eye: {len(channels)} models are given; give one, or three for red, green and blue.")
    for mappings in channels:
        _eye_of(mappings)
        if mappings.eye != eye:
            raise BadInputError(f"{mappings.name}: is a model of the {mappings.eye} eye, given for the {eye} eye.")
        if mappings.display.panel != channels[0].display.panel:
            raise BadInputError(f"{mappings.name}: its panel is not that of {channels[0].name}; the colours share one.")
        ours, first = (np.stack([each.eye_box.centre, each.eye_box.size]) for each in (mappings, channels[0]))
        if np.abs(ours - first).max() > _ROUNDING_M:
            raise BadInputError(
                f"{mappings.name}: its eye box is not that of {channels[0].name}; fit all colours to one."
            )
    return channels


def checked_whole(value: Any, what: str, at_most: int) -> int:
    """Return a whole number from 0 to a largest one.

    Raises:
        BadInputError: it is not.
    """
    if not is_number(value) or not 0 <= value <= at_most:
        raise BadInputError(f"{what} is {shown(value)}; give a whole number from 0 to {at_most}.")
    return int(value)


def checked_size(size_px: Sequence[int]) -> tuple[int, int]:
    """(width, height) of one eye's display.

    Raises:
        BadInputError: it is not two whole positive numbers, or too many pixels.
    """
    wanted = f"(width, height) in whole pixels, {LIMITS.picture_pixels} of them at most"
    size = finite_array(size_px, (2,), "the size", wanted)
    if (size < 1).any() or (size != size.round()).any() or size.prod() > LIMITS.picture_pixels:
        raise BadInputError(f"the size is {shown(size_px)}; give {wanted}.")
    return int(size[0]), int(size[1])


def checked_fov(fov_rad: object) -> FloatArray:
    """(4,) angles of the left, right, upper and lower border of a field.

    Raises:
        BadInputError: not four angles within a right angle, or no field between them.
    """
    wanted = "the angles (left, right, up, down) of its borders in radians, as EyeCamera.fov_rad"
    angles = finite_array(fov_rad, (4,), "fov_rad", wanted)
    if (np.abs(angles) >= 0.5 * np.pi).any() or angles[0] >= angles[1] or angles[3] >= angles[2]:
        raise BadInputError(f"fov_rad is {shown(fov_rad)}; give {wanted}, with left < right and down < up.")
    return angles


def check_inset_field(inset: Pinhole, wider: Pinhole) -> None:
    """Check that an inset shows a part of a wider picture of the same camera frame, with more pixels.

    Raises:
        BadInputError: the inset reaches outside the wider picture, or is not sharper.
    """
    slack = _ROUNDING * (wider.tangent_max - wider.tangent_min)
    if (inset.tangent_min < wider.tangent_min - slack).any() or (inset.tangent_max > wider.tangent_max + slack).any():
        fields = (
            f"{np.round(each.tangent_min, 3).tolist()} to {np.round(each.tangent_max, 3).tolist()}"
            for each in (inset, wider)
        )
        raise BadInputError(
            "the inset's field has the tangents {}, and the picture around it {}; keep it within.".format(*fields)
        )
    if (inset.focal_px <= (1 + _ROUNDING) * wider.focal_px).any():
        ours, theirs = (each.focal_px.round(1).tolist() for each in (inset, wider))
        raise BadInputError(
            f"the inset has {ours} pixels per unit tangent, and the picture around it {theirs}; give it more, and "
            "submit each inset once."
        )


def check_camera_size(plan: EyePlan) -> None:
    """Check the number of pixels of the intermediate image, before anything of that size is made.

    Raises:
        BadInputError: there are too many.
    """
    width, height = plan.camera.width_px, plan.camera.height_px
    if width * height > LIMITS.picture_pixels or max(width, height) > LIMITS.picture_side:
        raise BadInputError(
            f"the {plan.eye} eye's camera would have {width} x {height} pixels; it can have {LIMITS.picture_pixels} "
            f"and sides of {LIMITS.picture_side} at most: make size, resolution or late_margin_deg smaller."
        )


def checked_background(colour: Sequence[int]) -> tuple[int, int, int]:
    """Return sRGB codes.

    Raises:
        BadInputError: it is not three whole numbers from 0 to 255.
    """
    wanted = "(red, green, blue) as whole sRGB codes from 0 to 255"
    codes = finite_array(colour, (3,), "the background", wanted)
    if any(code not in range(256) for code in codes.tolist()):
        raise BadInputError(f"the background is {shown(colour)}; give {wanted}.")
    red, green, blue = (int(code) for code in codes)
    return red, green, blue


def checked_panels(panel: object, eyes: Sequence[str], size_px: tuple[int, int]) -> dict[str, PanelLight]:
    """Return the light of each eye's panel.

    Raises:
        BadInputError: an eye has none, or a uniformity map is not of the display's size.
    """
    by_eye = panel if isinstance(panel, Mapping) else dict.fromkeys(eyes, panel)
    found = {}
    for eye in eyes:
        light = by_eye.get(eye)
        if not isinstance(light, PanelLight):
            raise BadInputError(f"panel of the {eye} eye is {shown(light)}; give a PanelLight.")
        if light.uniformity is not None and light.uniformity.shape[1::-1] != size_px:
            rows, columns = light.uniformity.shape[:2]
            raise BadInputError(
                f"the uniformity map of the {eye} eye has {columns} x {rows} pixels, and its picture "
                f"{size_px[0]} x {size_px[1]}; give one factor for each pixel of the picture."
            )
        found[eye] = light
    return found


def checked_pose(pose: FloatArray, what: str = "the pose") -> FloatArray:
    """Return a copy of `world_from_device` as (4, 4) float64: trackers write the next pose where the last one was.

    Raises:
        BadInputError: not finite, not a rotation and translation, or too far away.
    """
    matrix_name, until = (
        (what, "")
        if what.endswith("_quad")
        else ("world_from_device", ", and the last good one while the head is not tracked")
    )
    given = np.asarray(pose) if isinstance(pose, np.ndarray) else None
    if given is not None and given.shape == (4, 4) and given.dtype.kind == "f" and not np.isfinite(given).all():
        row, column = np.argwhere(~np.isfinite(given))[0]
        raise BadInputError(
            f"{what} has {given[row, column]} in row {row}, column {column}; give finite numbers{until}."
        )
    matrix = finite_array(pose, (4, 4), what, f"{matrix_name} as a 4 x 4 matrix of finite numbers{until}")
    if np.abs(matrix[:3, 3]).max() > FARTHEST_M:
        raise BadInputError(
            f"{what} lies at {matrix[:3, 3].tolist()}; give metres, {FARTHEST_M:g} at most from the world's origin."
        )
    rotation = matrix[:3, :3]
    askew = float(np.abs(rotation @ rotation.T - np.eye(3)).max())
    lengths = np.linalg.norm(rotation, axis=0)
    scale = lengths.mean()
    if (
        abs(scale - 1) > _ROTATION_SLACK
        and np.abs(rotation @ rotation.T - scale**2 * np.eye(3)).max() < 1e-6 * scale**2
    ):
        raise BadInputError(
            f"{what} is not a rotation and a translation: it scales by {scale:g}; divide its first three columns "
            "by that, and leave the translation in metres."
        )
    if askew <= _ROTATION_SLACK and np.linalg.det(rotation) < 0:
        raise BadInputError(
            f"{what} is not a rotation and a translation: it mirrors, as if converted from a left-handed frame "
            "on one side only; convert on both, F @ pose @ F with F = diag(1, 1, -1, 1) if z pointed forwards there."
        )
    if askew > _ROTATION_SLACK or np.linalg.det(rotation) < 0 or not np.array_equal(matrix[3], [0, 0, 0, 1]):
        raise BadInputError(
            f"{what} is not a rotation and a translation; give {matrix_name} with the last row 0 0 0 1 (its "
            "transpose is what OpenGL takes)."
        )
    if askew > _ROUNDING:
        left, _, right = np.linalg.svd(rotation)
        matrix[:3, :3] = left @ right  # the nearest rotation: what follows takes its transpose for its inverse
    return matrix


def checked_viewpoints(
    viewpoint: FloatArray | Mapping[str, FloatArray], models: Mapping[str, EyeChannels]
) -> dict[str, FloatArray]:
    """(3,) by eye, copies; of the eyes that are given.

    Raises:
        BadInputError: no eye is given or one is unknown, or a viewpoint is not three finite numbers or lies far outside
            the eye box.
    """
    if not isinstance(viewpoint, Mapping):
        if len(models) > 1 and viewpoint is not None:
            raise BadInputError("one viewpoint is given for two eyes; give {'left': ..., 'right': ...}.")
        viewpoint = dict.fromkeys(models, viewpoint)
    for eye in viewpoint:
        checked_choice(eye, ("left", "right"), "an eye of the viewpoints")
    given = [eye for eye in models if eye in viewpoint]
    if not given:
        raise BadInputError(f"there is no viewpoint of the {sorted(models)[0]} eye; give one, by eye.")
    return {eye: _near_the_box(eye, checked_viewpoint(viewpoint[eye]), models[eye][0]) for eye in given}


def nearest_in_reach(viewpoint: FloatArray, box: EyeBox) -> FloatArray:
    """Return the nearest accepted viewpoint (3,).

    Raises:
        BadInputError: it is not three finite numbers.
    """
    beside = checked_viewpoint(viewpoint) - box.centre
    return np.asarray(box.centre + np.clip(beside, -_reach(box), _reach(box)))


def _reach(box: EyeBox) -> FloatArray:
    return np.asarray((0.5 + REACH) * box.size + EYE_BOX_MARGIN)


def _near_the_box(eye: str, viewpoint: FloatArray, mappings: Eye) -> FloatArray:
    box = mappings.eye_box
    beyond = np.abs(viewpoint - box.centre) - _reach(box)
    if (beyond > _ROUNDING_M).any():
        axis = int(np.argmax(beyond))
        far_m = float(np.abs(viewpoint - box.centre).max())
        metres = "is it in metres? Else " if far_m > 1 else ""
        raise BadInputError(
            f"the viewpoint of the {eye} eye lies {abs(viewpoint[axis] - box.centre[axis]) * 1e3:.1f} mm from the eye "
            f"box's centre in {'xyz'[axis]}, and {mappings.name} was made for {0.5 * box.size[axis] * 1e3:.1f} mm; "
            f"{metres}hold the last good viewpoint, take the nearest that is accepted (within_reach), or refit the "
            "headset's place on the head."
        )
    return viewpoint
