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


class _Rows:
    """What both kinds of captures derive from their rows."""

    viewpoint: FloatArray
    view_dir: FloatArray

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

    def __post_init__(self) -> None:
        _check_rows(self)
        _set_rows(self, "pixel", 2, len(self))


@dataclass(frozen=True)
class SeeThroughCaptures(_Rows):
    """Real points as seen through the optics from camera positions.

    Attributes:
        device, eye, eye_box, viewpoint, view_dir, capture, sigma_arcmin: as in `DisplayCaptures`.
        point: (n, 3) the real point.
        target_pose: (n,) index of the target's pose; at least two depths are needed for a fit.

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

    def __post_init__(self) -> None:
        _check_rows(self)
        _set_rows(self, "point", 3, len(self))
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


def select(captures: AnyCaptures, rows: IntArray | NDArray[np.bool_]) -> AnyCaptures:
    """Return the captures of some rows, by index or mask (n,)."""
    per_row: dict[str, Any] = {
        field.name: getattr(captures, field.name)[rows]
        for field in fields(captures)
        if isinstance(getattr(captures, field.name), np.ndarray)
    }
    return replace(captures, **per_row)


def concatenate(parts: Sequence[AnyCaptures]) -> AnyCaptures:
    """Concatenate captures of one eye; `capture` indices keep their values. There must be at least one part."""
    first = parts[0]
    per_row: dict[str, Any] = {
        field.name: np.concatenate([getattr(part, field.name) for part in parts])
        for field in fields(first)
        if isinstance(getattr(first, field.name), np.ndarray)
    }
    return replace(first, **per_row)


def _check_rows(captures: DisplayCaptures | SeeThroughCaptures) -> None:
    if captures.eye not in ("left", "right"):
        raise BadInputError(f"captures: 'eye' is '{captures.eye}'; it must be 'left' or 'right'.")
    count = len(np.atleast_1d(captures.viewpoint))
    if count == 0:
        raise BadInputError("captures: there are no rows; a fit needs at least one measured direction.")
    _set_rows(captures, "viewpoint", 3, count)
    _set_rows(captures, "view_dir", 3, count)
    _set_indices(captures, "capture", count)
    length = np.linalg.norm(captures.view_dir, axis=1)
    if np.any(np.abs(length - 1.0) > 1e-6) or np.any(captures.view_dir[:, 2] >= 0):
        raise BadInputError("captures: 'view_dir' must be unit vectors that look forward (z < 0).")
    _set_sigma(captures, count)


def _set_rows(captures: object, name: str, columns: int, count: int) -> None:
    value = np.asarray(getattr(captures, name), dtype=np.float64)
    if value.shape != (count, columns):
        raise BadInputError(f"captures: '{name}' must have shape ({count}, {columns}), not {value.shape}.")
    if not np.isfinite(value).all():
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
