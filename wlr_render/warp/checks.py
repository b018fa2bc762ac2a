"""Checks of an engine's input, made before anything is changed.

Every function raises a `BadInputError` that names the argument, its value and valid ones.
"""

from collections.abc import Callable, Collection, Mapping, Sequence
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
"""Largest distance of a viewpoint outside the eye box, as a share of the box's size on each axis. Polynomials
fitted inside may be extrapolated a little; farther out their values are meaningless.
"""
FARTHEST_M = 1e8
"""Largest distance of a head from the world's origin: float64 resolves 15 nm there, and Earth-centred frames fit."""
_ROTATION_SLACK = 1e-4
_IDENTITY = np.eye(3)
_ROUNDING = _ROUNDING_M = 1e-9


def _require(is_valid: bool | np.bool_, what: str, value: object, wanted: str) -> None:
    if not is_valid:
        raise BadInputError(f"{what} is {shown(value)}; {wanted}.")


def _checked_array(
    value: object, shape: tuple[int, ...], what: str, wanted: str, is_valid: Callable[[FloatArray], Any]
) -> FloatArray:
    """Return a float64 copy of an array of finite, valid numbers; `wanted` describes valid numbers."""
    array = finite_array(value, shape, what, wanted)
    _require(is_valid(array), what, value, f"give {wanted}")
    return array


def checked_eye(eye: str | None, eyes: Sequence[str]) -> str:
    """Return the eye that a caller names; it may be omitted if there is only one."""
    if eye is None and len(eyes) > 1:
        raise BadInputError(f"there are two eyes; name one of {', '.join(eyes)} with eye=.")
    return eyes[0] if eye is None else checked_choice(eye, eyes, "eye")


def checked_eyes(given: object, eyes: Sequence[str]) -> list[str]:
    """Return the given eyes, left first; all eyes if None."""
    named: Any = eyes if given is None else given
    is_some = isinstance(named, Collection) and not isinstance(named, str) and len(named) > 0
    _require(is_some, "eyes", given, f"give some of {', '.join(eyes)}, as in eyes=('left',)")
    wanted = {checked_choice(eye, eyes, "an eye of eyes") for eye in named}
    return [eye for eye in eyes if eye in wanted]


def check_stored(stored: object, stored_colour: object, rows: object) -> None:
    """Check the types of a picture's storage conventions."""
    if not (
        isinstance(stored, StoredDepth) and isinstance(stored_colour, StoredColour) and isinstance(rows, Rows | None)
    ):
        raise BadInputError(
            "stored must be a StoredDepth, stored_colour a StoredColour, and rows one of Rows (wlr_render.engine)."
        )


def check_submitted(eyes: Sequence[str], submitted: Collection[str]) -> None:
    """Check that all of some eyes have a picture."""
    for eye in eyes:
        if eye not in submitted:
            raise BadInputError(
                f"the {eye} eye has not been submitted; submit it before compose, or name the other in eyes."
            )


def checked_quad(size_m: object, world_from_quad: object, device_from_quad: object) -> Quad:
    """Return the quad of an overlay: one of the two poses is given, the size is positive."""
    wanted = "(width, height) of the quad in metres, both positive"
    size = _checked_array(size_m, (2,), "size_m", wanted, lambda array: (array > 0).all())
    if (world_from_quad is None) == (device_from_quad is None):
        raise BadInputError("an overlay has one pose; give either world_from_quad or device_from_quad.")
    if world_from_quad is None:
        return Quad(checked_pose(device_from_quad, "device_from_quad"), size, True)
    return Quad(checked_pose(world_from_quad, "world_from_quad"), size, False)


def checked_choice(value: object, choices: Sequence[str], what: str) -> str:
    """Return the value if it is one of the choices."""
    _require(isinstance(value, str) and value in choices, what, value, f"choose from {', '.join(choices)}")
    return str(value)


def checked_flag(value: object, what: str) -> bool:
    """Return True or False; "no" would count as true."""
    _require(isinstance(value, bool | np.bool_), what, value, "give True or False")
    return bool(value)


def checked_number(value: object, what: str, at_least: float, at_most: float) -> float:
    """Return a number within limits."""
    wanted = f"a number from {at_least:g} to {at_most:g}"
    return float(_checked_array(value, (), what, wanted, lambda number: at_least <= number <= at_most))


def checked_whole(value: Any, what: str, at_most: int) -> int:
    """Return a whole number from 0 to `at_most`."""
    _require(is_number(value) and 0 <= value <= at_most, what, value, f"give a whole number from 0 to {at_most}")
    return int(value)


def checked_size(size_px: Sequence[int]) -> tuple[int, int]:
    """Return (width, height) of one eye's display."""
    wanted = f"(width, height) in whole pixels, {LIMITS.picture_pixels} of them at most"
    width, height = _checked_array(
        size_px,
        (2,),
        "the size",
        wanted,
        lambda size: (size >= 1).all() and (size == size.round()).all() and size.prod() <= LIMITS.picture_pixels,
    )
    return int(width), int(height)


def checked_fov(fov_rad: object) -> FloatArray:
    """Return the angles (4,) of the left, right, upper and lower border of a field of view, each below 90 degrees."""
    return _checked_array(
        fov_rad,
        (4,),
        "fov_rad",
        "the angles (left, right, up, down) of its borders in radians, as EyeCamera.fov_rad, with left < right and "
        "down < up",
        lambda angle: (np.abs(angle) < 0.5 * np.pi).all() and angle[0] < angle[1] and angle[3] < angle[2],
    )


def checked_background(colour: Sequence[int]) -> tuple[int, int, int]:
    """Return the background as sRGB codes."""
    wanted = "(red, green, blue) as whole sRGB codes from 0 to 255"
    codes = _checked_array(
        colour, (3,), "the background", wanted, lambda array: all(code in range(256) for code in array.tolist())
    )
    red, green, blue = (int(code) for code in codes)
    return red, green, blue


def checked_models(models: Eye | Sequence[Eye] | Mapping[str, Eye | Sequence[Eye]]) -> dict[str, EyeChannels]:
    """Return the channels by eye, the left eye first."""
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
    channels = tuple(models) if isinstance(models, Sequence) else (models,)
    if len(channels) not in (1, 3):
        raise BadInputError(f"{eye} eye: {len(channels)} models are given; give one, or three for red, green and blue.")
    for mappings in channels:
        if _eye_of(mappings) != eye:
            raise BadInputError(f"{mappings.name}: is a model of the {mappings.eye} eye, given for the {eye} eye.")
        if mappings.display.panel != channels[0].display.panel:
            raise BadInputError(f"{mappings.name}: its panel is not that of {channels[0].name}; the colours share one.")
        box, first = mappings.eye_box, channels[0].eye_box
        if max(np.abs(box.centre - first.centre).max(), np.abs(box.size - first.size).max()) > _ROUNDING_M:
            raise BadInputError(
                f"{mappings.name}: its eye box is not that of {channels[0].name}; fit all colours to one."
            )
    return channels


def check_inset_field(inset: Pinhole, wider: Pinhole) -> None:
    """Check that an inset shows part of a wider picture of the same camera frame, with finer pixels."""
    slack = _ROUNDING * (wider.tangent_max - wider.tangent_min)
    if (inset.tangent_min < wider.tangent_min - slack).any() or (inset.tangent_max > wider.tangent_max + slack).any():
        raise BadInputError(
            f"the inset's field has the tangents {_rounded(inset.tangent_min)} to {_rounded(inset.tangent_max)}, and "
            f"the picture around it {_rounded(wider.tangent_min)} to {_rounded(wider.tangent_max)}; keep it within."
        )
    if (inset.focal_px <= (1 + _ROUNDING) * wider.focal_px).any():
        raise BadInputError(
            f"the inset has {_rounded(inset.focal_px)} pixels per unit tangent, and the picture around it "
            f"{_rounded(wider.focal_px)}; give it more, and submit each inset once."
        )


def _rounded(values: FloatArray) -> list[float]:
    rounded: list[float] = np.round(values, 3).tolist()
    return rounded


def check_camera_size(plan: EyePlan) -> None:
    """Check the number of pixels of the intermediate image before anything of that size is allocated."""
    width, height = plan.camera.width_px, plan.camera.height_px
    if width * height > LIMITS.picture_pixels or max(width, height) > LIMITS.picture_side:
        raise BadInputError(
            f"the {plan.eye} eye's camera would have {width} x {height} pixels; it can have {LIMITS.picture_pixels} "
            f"and sides of {LIMITS.picture_side} at most: make size, resolution or late_margin_deg smaller."
        )


def checked_panels(panel: object, eyes: Sequence[str], size_px: tuple[int, int]) -> dict[str, PanelLight]:
    """Return the light of each eye's panel; a uniformity map has the display's size."""
    by_eye: Mapping[str, Any] = panel if isinstance(panel, Mapping) else dict.fromkeys(eyes, panel)
    for eye in eyes:
        light: Any = by_eye.get(eye)
        _require(isinstance(light, PanelLight), f"panel of the {eye} eye", light, "give a PanelLight")
        if light.uniformity is not None and light.uniformity.shape[1::-1] != size_px:
            rows, columns = light.uniformity.shape[:2]
            raise BadInputError(
                f"the uniformity map of the {eye} eye has {columns} x {rows} pixels, and its picture "
                f"{size_px[0]} x {size_px[1]}; give one factor for each pixel of the picture."
            )
    return {eye: by_eye[eye] for eye in eyes}


def checked_pose(pose: object, what: str = "the pose") -> FloatArray:
    """Return a copy of a pose as (4, 4) float64: trackers overwrite their poses in place.

    Its rotation is the one nearest to the given matrix, which may be rounded to about four digits.
    """
    name, until = "world_from_device", ", and the last good one while the head is not tracked"
    if what.endswith("_quad"):
        name, until = what, ""
    try:
        matrix = finite_array(pose, (4, 4), what, f"{name} as a 4 x 4 matrix of finite numbers{until}")
    except BadInputError:
        if isinstance(pose, np.ndarray) and pose.shape == (4, 4) and pose.dtype.kind == "f":
            row, column = np.argwhere(~np.isfinite(pose))[0]
            found = f"{what} has {pose[row, column]} in row {row}, column {column}"
            raise BadInputError(f"{found}; give finite numbers{until}.") from None
        raise
    if np.abs(matrix[:3, 3]).max() > FARTHEST_M:
        raise BadInputError(
            f"{what} lies at {matrix[:3, 3].tolist()}; give metres, {FARTHEST_M:g} at most from the world's origin."
        )
    rotation = matrix[:3, :3]
    gram, is_affine = rotation @ rotation.T, matrix[3].tolist() == [0, 0, 0, 1]
    askew, scale = float(np.abs(gram - _IDENTITY).max()), float(np.sqrt(gram.trace() / 3))
    (a, b, c), (d, e, f), (g, h, i) = rotation.tolist()
    is_mirror = a * (e * i - f * h) + b * (f * g - d * i) + c * (d * h - e * g) < 0  # much faster than np.linalg.det
    if askew <= _ROTATION_SLACK and not is_mirror and is_affine:
        if askew > _ROUNDING:
            left, _, right = np.linalg.svd(rotation)
            matrix[:3, :3] = left @ right  # the nearest rotation: later code uses its transpose as its inverse
        return matrix
    if abs(scale - 1) > _ROTATION_SLACK and np.abs(gram - scale**2 * np.eye(3)).max() < 1e-6 * scale**2:
        remedy = f"it scales by {scale:g}; divide its first three columns by that"
    elif askew <= _ROTATION_SLACK and is_mirror:
        remedy = "it mirrors; convert from a left-handed frame on both sides, F @ pose @ F with F = diag(1, 1, -1, 1)"
    else:
        remedy = f"give {name} with the last row 0 0 0 1 (OpenGL takes its transpose)"
    raise BadInputError(f"{what} is not a rotation and a translation: {remedy}.")


def checked_viewpoints(
    viewpoint: FloatArray | Mapping[str, FloatArray], models: Mapping[str, EyeChannels]
) -> dict[str, FloatArray]:
    """Return copies (3,) of the given viewpoints by eye; each must lie in the eye box or not far outside."""
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
    """Return the nearest accepted viewpoint (3,)."""
    beside = checked_viewpoint(viewpoint) - box.centre
    return np.asarray(box.centre + np.clip(beside, -_reach(box), _reach(box)))


def _reach(box: EyeBox) -> FloatArray:
    return np.asarray((0.5 + REACH) * box.size + EYE_BOX_MARGIN)


def _near_the_box(eye: str, viewpoint: FloatArray, mappings: Eye) -> FloatArray:
    box = mappings.eye_box
    away = np.abs(viewpoint - box.centre)
    beyond = away - _reach(box)
    if (beyond > _ROUNDING_M).any():
        axis = int(np.argmax(beyond))
        question = "is it in metres? Else " if away.max() > 1 else ""
        raise BadInputError(
            f"the viewpoint of the {eye} eye lies {away[axis] * 1e3:.1f} mm from the eye box's centre in "
            f"{'xyz'[axis]}, and {mappings.name} was made for {0.5 * box.size[axis] * 1e3:.1f} mm; {question}hold the "
            "last good viewpoint, take the nearest that is accepted (within_reach), or refit."
        )
    return viewpoint
