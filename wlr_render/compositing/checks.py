"""Checks of an engine's input, made before anything is changed."""

from collections.abc import Mapping, Sequence

import numpy as np

from wlr_render.errors import BadInputError
from wlr_render.mappings import EYE_BOX_MARGIN, EyeBox, EyeChannels, EyeMappings
from wlr_render.numerics.arrays import FloatArray
from wlr_render.rendering.cpu_ray_maps import checked_viewpoint

REACH = 0.5
"""How far outside the eye box a viewpoint may lie, as a share of the box's size on each axis. Polynomials fitted inside
may be carried on a little; what they say farther out is not an image of anything."""
_ROTATION_SLACK = 1e-4
_ROUNDING = _ROUNDING_M = 1e-9


def checked_eye(eye: str | None, eyes: Sequence[str]) -> str:
    """The eye that a caller names; it may be left out if there is one.

    Raises:
        BadInputError: there is no such eye, or it is left out and there are two.
    """
    if eye is None and len(eyes) > 1:
        raise BadInputError(f"there are two eyes; name one of {', '.join(eyes)} with eye=.")
    if eye is not None and eye not in eyes:
        raise BadInputError(f"there is no eye '{eye}' here; name one of {', '.join(eyes)}.")
    return eye or eyes[0]


def checked_models(models: EyeMappings | Mapping[str, EyeMappings | Sequence[EyeMappings]]) -> dict[str, EyeChannels]:
    """Channels by eye, the left eye first.

    Raises:
        BadInputError: no eye, an eye of another name than its mappings', or colours that do not belong together.
    """
    by_eye = models if isinstance(models, Mapping) else {_eye_of(models): models}
    if not by_eye or not set(by_eye) <= {"left", "right"}:
        raise BadInputError(f"models are given for {sorted(map(str, by_eye))}; give them for 'left', 'right' or both.")
    return {eye: _checked_channels(eye, by_eye[eye]) for eye in sorted(by_eye)}


def _eye_of(models: EyeMappings | Sequence[EyeMappings]) -> str:
    first = models[0] if isinstance(models, Sequence) and models else models
    if not isinstance(first, EyeMappings):
        raise BadInputError(
            f"a {type(first).__name__} is not a model of an eye; give EyeMappings, or a dictionary by eye for two."
        )
    return first.eye


def _checked_channels(eye: str, models: EyeMappings | Sequence[EyeMappings]) -> EyeChannels:
    channels = (models,) if isinstance(models, EyeMappings) else tuple(models)
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


def checked_size(size_px: Sequence[int]) -> tuple[int, int]:
    """(width, height) of one eye's display.

    Raises:
        BadInputError: it is not two whole positive numbers.
    """
    size = _numbers(size_px, "size")
    if size.shape != (2,) or not np.isfinite(size).all() or (size < 1).any() or (size != size.round()).any():
        raise BadInputError(f"the size {size_px} is not (width, height) in whole pixels.")
    return int(size[0]), int(size[1])


def _numbers(value: object, what: str) -> FloatArray:
    """A copy as float64.

    Raises:
        BadInputError: it is not made of numbers.
    """
    try:
        return np.array(value, dtype=np.float64)
    except (TypeError, ValueError) as error:
        raise BadInputError(f"the {what} {value!r} is not made of numbers.") from error


def checked_background(colour: Sequence[int]) -> tuple[int, int, int]:
    """sRGB codes.

    Raises:
        BadInputError: it is not three whole numbers from 0 to 255.
    """
    codes = _numbers(colour, "background")
    if codes.shape != (3,) or any(code not in range(256) for code in codes.tolist()):
        raise BadInputError(f"the background {colour} is not (red, green, blue) of sRGB codes from 0 to 255.")
    red, green, blue = (int(code) for code in codes)
    return red, green, blue


def checked_pose(pose: FloatArray, what: str = "pose") -> FloatArray:
    """A copy of `world_from_device` as (4, 4) float64: trackers write the next pose where the last one was.

    Raises:
        BadInputError: not finite, or no rotation and translation.
    """
    matrix = _numbers(pose, what)
    if matrix.shape != (4, 4) or not np.isfinite(matrix).all():
        raise BadInputError(
            f"the {what} of shape {matrix.shape} is not a 4 x 4 matrix of finite numbers; give world_from_device, and "
            "the last good one while the head is not tracked."
        )
    rotation = matrix[:3, :3]
    askew = float(np.abs(rotation @ rotation.T - np.eye(3)).max())
    if askew > _ROTATION_SLACK or np.linalg.det(rotation) < 0 or not np.array_equal(matrix[3], [0, 0, 0, 1]):
        raise BadInputError(
            f"the {what} is not a rotation and a translation; give world_from_device with the last row 0 0 0 1 (its "
            "transpose is what OpenGL takes)."
        )
    if askew > _ROUNDING:
        left, _, right = np.linalg.svd(rotation)
        matrix[:3, :3] = left @ right  # the nearest rotation: what follows takes its transpose for its inverse
    return matrix


def checked_viewpoints(
    viewpoint: FloatArray | Mapping[str, FloatArray], models: Mapping[str, EyeChannels]
) -> dict[str, FloatArray]:
    """(3,) by eye, copies.

    Raises:
        BadInputError: an eye is missing, a viewpoint is not three finite numbers, or lies far outside the eye box.
    """
    if not isinstance(viewpoint, Mapping):
        if len(models) > 1 and viewpoint is not None:
            raise BadInputError("one viewpoint is given for two eyes; give {'left': ..., 'right': ...}.")
        viewpoint = dict.fromkeys(models, viewpoint)
    missing = set(models) - set(viewpoint)
    if missing:
        raise BadInputError(f"there is no viewpoint of the {sorted(missing)[0]} eye; give one for every eye.")
    return {eye: _near_the_box(eye, checked_viewpoint(viewpoint[eye]).copy(), models[eye][0]) for eye in models}


def nearest_in_reach(viewpoint: FloatArray, box: EyeBox) -> FloatArray:
    """Return the nearest accepted viewpoint (3,).

    Raises:
        BadInputError: it is not three finite numbers.
    """
    beside = checked_viewpoint(viewpoint) - box.centre
    return np.asarray(box.centre + np.clip(beside, -_reach(box), _reach(box)))


def _reach(box: EyeBox) -> FloatArray:
    return np.asarray((0.5 + REACH) * box.size + EYE_BOX_MARGIN)


def _near_the_box(eye: str, viewpoint: FloatArray, mappings: EyeMappings) -> FloatArray:
    box = mappings.eye_box
    beyond = np.abs(viewpoint - box.centre) - _reach(box)
    if (beyond > _ROUNDING_M).any():
        axis = int(np.argmax(beyond))
        raise BadInputError(
            f"the viewpoint of the {eye} eye lies {abs(viewpoint[axis] - box.centre[axis]) * 1e3:.1f} mm from the eye "
            f"box's centre in {'xyz'[axis]}, and {mappings.name} was made for {0.5 * box.size[axis] * 1e3:.1f} mm; "
            "hold the last good viewpoint, or refit the headset's place on the head."
        )
    return viewpoint
