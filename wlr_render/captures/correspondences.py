"""Captures: view directions of panel pixels and real points from known viewpoints.

Everything is in the device frame (OpenXR), metres. One row is one measured direction; `capture` says which camera
position it was taken at, so that held-out tests can leave out whole positions.
"""

from collections.abc import Sequence
from dataclasses import dataclass, fields, replace
from functools import cached_property
from typing import Any, TypeVar

import numpy as np
from numpy.typing import ArrayLike, NDArray

from wlr_render.errors import BadInputError
from wlr_render.geometry.directions import tangents_of_dir
from wlr_render.mappings import EyeBox, Panel
from wlr_render.numerics.arrays import FloatArray, IntArray


@dataclass(frozen=True, eq=False)
class Conditions:
    """Conditions under which the rows of captures were taken; NaN, or -1 for an integer, where they are not recorded.

    Attributes:
        visit: (n,) number of the photograph, or of the set of code photographs, among those of one target pose.
        channel: (n,) colour of the light: 0 red, 1 green, 2 blue.
        time_s: (n,) since the session's start.
        temperature_c: (n,) of the bench, degrees Celsius.
        travel: (n,) direction of the stage's last move in x, +1 or -1.
        stage: (n, m) stage reading, metres or radians, in the stage's own axes; m = 0 without a stage.
        device_from_camera: (n, 3, 3) camera rotation; a camera of OpenXR's axes looks along its -z.

    Raises:
        BadInputError: a shape does not fit.
    """

    visit: IntArray
    channel: IntArray
    time_s: FloatArray
    temperature_c: FloatArray
    travel: FloatArray
    stage: FloatArray
    device_from_camera: FloatArray

    def __post_init__(self) -> None:
        count = len(np.atleast_1d(self.visit))
        for name in ("visit", "channel"):
            _set_indices(self, name, count)
        for name in ("time_s", "temperature_c", "travel"):
            _set_rows(self, name, (count,), finite=False)
        _set_rows(self, "device_from_camera", (count, 3, 3), finite=False)
        columns = np.shape(self.stage)[-1] if np.ndim(self.stage) == 2 else 0
        _set_rows(self, "stage", (count, columns), finite=False)

    @classmethod
    def recorded(cls, count: int, **columns: ArrayLike) -> "Conditions":
        """Return conditions of `count` rows; a column that is not given is not recorded, one row serves for all."""
        shapes = {"device_from_camera": (3, 3), "stage": (0,)}
        filled: dict[str, Any] = {}
        for each in fields(cls):
            shape, default = shapes.get(each.name, ()), -1 if each.name in ("visit", "channel") else np.nan
            value = np.asarray(columns.get(each.name, np.full(shape, default)))
            filled[each.name] = np.array([value] * count) if value.ndim == len(shape) else value
        return cls(**filled)


class _Rows:
    """What both kinds of captures derive from their rows."""

    viewpoint: FloatArray
    view_dir: FloatArray
    conditions: Conditions | None

    @cached_property
    def tangents(self) -> FloatArray:
        """(n, 2) tangents of `view_dir`."""
        return tangents_of_dir(self.view_dir)

    def __len__(self) -> int:
        return len(self.viewpoint)


@dataclass(frozen=True)
class DisplayCaptures(_Rows):
    """Panel pixels as seen from camera positions.

    Attributes:
        device: device name.
        eye: "left" or "right".
        eye_box: the eye box that the captures are meant for.
        panel: the panel whose pixels were decoded.
        viewpoint: (n, 3) the camera's entrance pupil.
        view_dir: (n, 3) unit direction in which the pixel was seen, from the viewpoint outwards.
        pixel: (n, 2) panel pixels.
        capture: (n,) index of the camera position.
        sigma_arcmin: (n,), or one number for all: standard deviation of `view_dir` about each of its two transverse
            axes. All zero where the data are exact.
        conditions: time, stage reading, camera rotation and so on of each row; None where nothing is recorded.

    Raises:
        BadInputError: a shape does not fit, a number is not finite, a direction is not a unit vector looking forward.
    """

    device: str
    eye: str
    eye_box: EyeBox
    panel: Panel
    viewpoint: FloatArray
    view_dir: FloatArray
    pixel: FloatArray
    capture: IntArray
    sigma_arcmin: FloatArray
    conditions: Conditions | None = None

    def __post_init__(self) -> None:
        _check_rows(self)
        _set_rows(self, "pixel", (len(self), 2))


@dataclass(frozen=True)
class SeeThroughCaptures(_Rows):
    """Real points as seen through the optics from camera positions.

    Attributes:
        device, eye, eye_box, viewpoint, view_dir, capture, sigma_arcmin, conditions: as in `DisplayCaptures`.
        point: (n, 3) the real point.
        target_pose: (n,) index of the target's pose; at least two depths are needed for a fit.
        target_point: (n, 3) the point in the frame of its target, NaN where unknown; None where no target is known.

    Raises:
        BadInputError: as `DisplayCaptures`, or a point is not in front of its viewpoint.
    """

    device: str
    eye: str
    eye_box: EyeBox
    viewpoint: FloatArray
    view_dir: FloatArray
    point: FloatArray
    capture: IntArray
    target_pose: IntArray
    sigma_arcmin: FloatArray
    conditions: Conditions | None = None
    target_point: FloatArray | None = None

    def __post_init__(self) -> None:
        _check_rows(self)
        _set_rows(self, "point", (len(self), 3))
        if self.target_point is not None:
            _set_rows(self, "target_point", (len(self), 3), finite=False)
        _set_indices(self, "target_pose", len(self))
        if np.any(self.point[:, 2] >= self.viewpoint[:, 2]):
            raise BadInputError("captures: 'point' has rows that are not in front of their viewpoint (smaller z).")


@dataclass(frozen=True)
class EyeCaptures:
    """All captures of one eye: what one capture file holds.

    Attributes:
        display: of the panel.
        see_through: of the world, or None where the optics cannot be seen through.

    Raises:
        BadInputError: the two parts are of different eyes.
    """

    display: DisplayCaptures
    see_through: SeeThroughCaptures | None = None

    def __post_init__(self) -> None:
        other = self.see_through
        if other is not None and (other.device, other.eye) != (self.display.device, self.display.eye):
            raise BadInputError(
                f"captures: the display captures are of {self.display.device} ({self.display.eye} eye), the "
                f"see-through captures of {other.device} ({other.eye} eye); take both from one eye."
            )


AnyCaptures = TypeVar("AnyCaptures", DisplayCaptures, SeeThroughCaptures)
_AnyRows = TypeVar("_AnyRows", DisplayCaptures, SeeThroughCaptures, Conditions)


def select(captures: _AnyRows, rows: IntArray | NDArray[np.bool_]) -> _AnyRows:
    """Return the captures of some rows, by index or mask (n,)."""
    per_row: dict[str, Any] = {}
    for name in _per_row(captures):
        value = getattr(captures, name)
        per_row[name] = select(value, rows) if isinstance(value, Conditions) else value[rows]
    return replace(captures, **per_row)


def concatenate(parts: Sequence[_AnyRows]) -> _AnyRows:
    """Concatenate captures of one eye; `capture` indices keep their values. There must be at least one part."""
    per_row: dict[str, Any] = {}
    for name in _per_row(parts[0]):
        values = [getattr(part, name) for part in parts]
        if isinstance(values[0], Conditions):
            per_row[name] = concatenate(values)
        else:
            per_row[name] = np.concatenate(_of_one_width(values) if name == "stage" else values)
    return replace(parts[0], **per_row)


def _of_one_width(stages: Sequence[FloatArray]) -> list[FloatArray]:
    """Stage readings (n, m), those without a reading filled up with NaN."""
    width = max(each.shape[1] for each in stages)
    return [np.pad(each, ((0, 0), (0, width - each.shape[1])), constant_values=np.nan) for each in stages]


def _per_row(captures: DisplayCaptures | SeeThroughCaptures | Conditions) -> list[str]:
    """Names of what has a row for each capture."""
    return [f.name for f in fields(captures) if isinstance(getattr(captures, f.name), np.ndarray | Conditions)]


def _check_rows(captures: DisplayCaptures | SeeThroughCaptures) -> None:
    if captures.eye not in ("left", "right"):
        raise BadInputError(f"captures: 'eye' is '{captures.eye}'; it must be 'left' or 'right'.")
    count = len(np.atleast_1d(captures.viewpoint))
    if count == 0:
        raise BadInputError("captures: there are no rows; a fit needs at least one measured direction.")
    _set_rows(captures, "viewpoint", (count, 3))
    _set_rows(captures, "view_dir", (count, 3))
    _set_indices(captures, "capture", count)
    length = np.linalg.norm(captures.view_dir, axis=1)
    if np.any(np.abs(length - 1.0) > 1e-6) or np.any(captures.view_dir[:, 2] >= 0):
        raise BadInputError("captures: 'view_dir' must be unit vectors that look forward (z < 0).")
    _set_sigma(captures, count)
    if captures.conditions is not None and len(captures.conditions.visit) != count:
        raise BadInputError(f"captures: the conditions have {len(captures.conditions.visit)} rows, not {count}.")


def _set_rows(captures: object, name: str, shape: tuple[int, ...], *, finite: bool = True) -> None:
    value = np.asarray(getattr(captures, name), dtype=np.float64)
    if value.shape != shape:
        raise BadInputError(f"captures: '{name}' must have shape {shape}, not {value.shape}.")
    if finite and not np.isfinite(value).all():
        raise BadInputError(f"captures: '{name}' has numbers that are not finite; leave out the rows without a value.")
    object.__setattr__(captures, name, value)


def _set_indices(captures: object, name: str, count: int) -> None:
    value = np.asarray(getattr(captures, name))
    if value.shape != (count,) or not np.issubdtype(value.dtype, np.integer):
        raise BadInputError(
            f"captures: '{name}' must be {count} whole numbers, not {value.dtype} of shape {value.shape}."
        )
    object.__setattr__(captures, name, value.astype(np.int64))


def _set_sigma(captures: DisplayCaptures | SeeThroughCaptures, count: int) -> None:
    given: ArrayLike = captures.sigma_arcmin
    value = np.asarray(given, dtype=np.float64)
    if value.shape not in ((), (count,)):
        raise BadInputError(f"captures: 'sigma_arcmin' must be one number or {count}, not of shape {value.shape}.")
    # An infinite weight beside finite ones has no meaning in a weighted fit.
    if not (np.isfinite(value).all() and (np.all(value > 0) or np.all(value == 0))):
        raise BadInputError("captures: 'sigma_arcmin' must be positive everywhere, or zero everywhere for exact data.")
    object.__setattr__(captures, "sigma_arcmin", np.array(np.broadcast_to(value, (count,))))
