"""Captures: view directions of panel pixels and real points from known viewpoints.

Everything is in the device frame (OpenXR), metres. One row is one measured direction; `capture` is the number of its
camera position, so that held-out tests can leave out whole positions.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, TypeVar

import numpy as np
from numpy.typing import NDArray

from wlr_render.captures.capture_writer import joined_column, write_captures
from wlr_render.captures.feature_captures import (
    PANEL_PIXEL,
    REAL_POINT,
    CaptureMotionPrior,
    FeatureCaptures,
    column,
    columns_of,
    summary_of,
)
from wlr_render.errors import BadInputError
from wlr_render.mappings import Panel
from wlr_render.numerics.arrays import FloatArray, IntArray

_GREEN = 1


@dataclass(frozen=True, eq=False, kw_only=True)
class DisplayCaptures(FeatureCaptures):
    """Observations of panel pixels from camera positions; further attributes in `FeatureCaptures`.

    Attributes:
        panel: the panel whose pixels were decoded.
        pixel: (n, 2) panel pixels.
    """

    kind, side = PANEL_PIXEL, "display"

    panel: Panel
    pixel: FloatArray = column(2)

    @property
    def feature(self) -> FloatArray:
        """Panel pixels u, v and NaN, (n, 3)."""
        return np.column_stack([self.pixel, np.full(len(self), np.nan)])


@dataclass(frozen=True, eq=False, kw_only=True)
class SeeThroughCaptures(FeatureCaptures):
    """Observations of real points through the optics; further attributes in `FeatureCaptures`.

    Attributes:
        point: (n, 3) the real point. A fit needs at least two depths.

    Raises:
        BadInputError: as `FeatureCaptures`, or a point is not in front of its viewpoint.
    """

    kind, side = REAL_POINT, "see-through"

    point: FloatArray = column(3)

    def __post_init__(self) -> None:
        super().__post_init__()
        if np.any(self.point[:, 2] >= self.viewpoint[:, 2]):
            raise BadInputError(
                "captures: 'point' has real points that are not in front of their viewpoint (smaller z); check the "
                "unit (metres) and the frame of both, or leave these rows out."
            )

    @property
    def feature(self) -> FloatArray:
        """The real points, (n, 3)."""
        return self.point


@dataclass(frozen=True)
class Captures:
    """All captures of one eye, device frame, metres: the content of a capture file.

    `load_captures` reads them, `simulate` simulates them, `calibrate` fits models to them.

    Attributes:
        display: captures of the panel; None without photographs of it.
        see_through: captures of the world; None without photographs of it, or with opaque optics.
        panel: the eye's panel; None if unknown. The panel of `display`, if there are display captures.

    Raises:
        BadInputError: both parts are missing, or they have different eyes or different common errors.
    """

    display: DisplayCaptures | None
    see_through: SeeThroughCaptures | None = None
    panel: Panel | None = None

    @property
    def parts(self) -> list[DisplayCaptures | SeeThroughCaptures]:
        """Parts that exist, the display first."""
        return [part for part in (self.display, self.see_through) if part is not None]

    @property
    def source(self) -> DisplayCaptures | SeeThroughCaptures:
        """Part that states device, eye and eye box: the display if there is one."""
        return self.parts[0]

    @property
    def both(self) -> "tuple[DisplayCaptures, SeeThroughCaptures]":
        """Display and see-through captures; `BadInputError` if one of them is missing."""
        if self.display is None or self.see_through is None:
            lacking = "display" if self.display is None else "see-through"
            raise BadInputError(f"the captures of {self.source.device} have no {lacking} part; add it.")
        return self.display, self.see_through

    def __post_init__(self) -> None:
        other = self.see_through
        if self.display is None and other is None:
            raise BadInputError("captures: there are none of the panel or of a target; give at least one.")
        if self.display is None:
            return
        object.__setattr__(self, "panel", self.display.panel)
        if other is not None and (other.device, other.eye) != (self.display.device, self.display.eye):
            raise BadInputError(
                f"captures: the display captures are of {self.display.device} ({self.display.eye} eye), the "
                f"see-through captures of {other.device} ({other.eye} eye); take both from one eye."
            )
        named = [each.common.sources if each.common else () for each in (self.display, other or self.display)]
        if named[0] != named[1]:
            raise BadInputError(
                "captures: the common errors of display and see-through must have the same variables; give both the "
                "same 'sources', with zeros for variables without effect on one of them."
            )

    def in_colour(self, channel: int | None = None) -> "Captures":
        """Return the captures with the panel in one colour channel: by default green, or the first if green is missing.

        Raises:
            BadInputError: no captures are left.
        """
        if self.display is None:
            return self
        shown = np.unique(self.display.channel)
        channel = channel if channel is not None else _GREEN if _GREEN in shown else int(shown[0])
        display = select(self.display, self.display.channel == channel) if channel in shown else None
        return replace(self, display=display)

    def of_device(self, name: str) -> "Captures":
        """Return the captures with another name of the device."""
        display = None if self.display is None else replace(self.display, device=name)
        see_through = None if self.see_through is None else replace(self.see_through, device=name)
        return replace(self, display=display, see_through=see_through)

    def save(self, path: str | Path) -> Path:
        """Write a capture file (.npz) atomically; `load_captures` reads it, and docs/files.md has the format.

        Raises:
            BadInputError: another suffix, or a file that cannot be written.
        """
        return write_captures(path, self.parts, self.panel)

    def _repr_html_(self) -> str:
        return summary_of(self.parts)


AnyCaptures = TypeVar("AnyCaptures", DisplayCaptures, SeeThroughCaptures)


def select(captures: AnyCaptures, rows: IntArray | NDArray[np.bool_]) -> AnyCaptures:
    """Return the captures of some rows, by index or mask (n,)."""
    columns: dict[str, Any] = {name: getattr(captures, name)[rows] for name in columns_of(type(captures))}
    return replace(captures, **columns)


def concatenate(parts: Sequence[AnyCaptures]) -> AnyCaptures:
    """Concatenate captures of one eye (one part or more); `capture` indices keep their values.

    The motion and the common errors of the result come from the first part that has any.

    Raises:
        BadInputError: this motion, or these common errors, do not cover a capture.
    """
    names = columns_of(type(parts[0]))
    joined: dict[str, Any] = {name: joined_column(name, [getattr(part, name) for part in parts]) for name in names}
    for name in ("motion", "common"):
        joined[name] = next((value for part in parts if (value := getattr(part, name)) is not None), None)
    return replace(parts[0], **joined)


def with_copies(captures: AnyCaptures, rows: IntArray, position: IntArray) -> AnyCaptures:
    """Return captures with copies of rows (m,) appended as new camera positions, numbered `position` (m,) from 0.

    Each copied visit is a separate visit, with a camera motion of the same size as in the original.
    """
    names, visit = captures.visits
    copied, row = np.unique(np.stack([position, visit[rows]], axis=1), axis=0, return_inverse=True)
    whole = select(captures, np.append(np.arange(len(captures)), rows))
    last = int(captures.capture.max())
    new = last + 1 + copied[:, 0]
    changes: dict[str, Any] = {"capture": np.append(captures.capture, last + 1 + position)}
    if captures.has_visits:
        new = int(captures.visit.max()) + 1 + np.arange(len(copied))
        changes["visit"] = np.append(captures.visit, new[row.reshape(-1)])
    new, first = np.unique(new, return_index=True)
    originals = names[copied[first, 1]]
    if (prior := captures.motion) is not None:
        here = np.isin(prior.capture, names)  # the prior may include captures that were left out
        size = np.concatenate([prior.size[here], prior.of(originals).size])
        changes["motion"] = CaptureMotionPrior(np.append(prior.capture[here], new), size, prior.log_sigma)
    if (common := captures.common) is not None:
        here = np.isin(common.capture, names)
        motion = np.concatenate([common.motion[here], common.of(originals)])
        changes["common"] = replace(common, capture=np.append(common.capture[here], new), motion=motion)
    return replace(whole, **changes)
