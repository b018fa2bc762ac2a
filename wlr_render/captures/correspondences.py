"""Captures: view directions of panel pixels and real points from known viewpoints.

Everything is in the device frame (OpenXR), metres. One row is one measured direction; `capture` is the number of its
camera position, so that held-out tests can leave out whole positions.
"""

from collections.abc import Sequence
from dataclasses import dataclass, field, fields, replace
from functools import cached_property, partial
from pathlib import Path
from typing import Any, ClassVar, TypeVar

import numpy as np
from numpy.typing import ArrayLike, NDArray

from wlr_render.errors import BadInputError
from wlr_render.geometry.directions import tangents_by_turn, tangents_of_dir
from wlr_render.html_summary import SummaryTable, html_summary
from wlr_render.mappings import EyeBox, Panel
from wlr_render.numerics.arrays import FloatArray, IntArray
from wlr_render.numerics.polynomial import Polynomial


@dataclass(frozen=True, eq=False)
class Conditions:
    """Conditions of the rows of captures; NaN, or -1 for an integer, if not recorded.

    Attributes:
        visit: (n,) number of the photograph, or of the set of code photographs, within its target pose.
        channel: (n,) colour of the light: 0 red, 1 green, 2 blue.
        time_s: (n,) time since the session's start.
        temperature_c: (n,) temperature of the bench, degrees Celsius.
        travel: (n,) direction of the stage's last move in x, +1 or -1.
        stage: (n, m) stage reading, metres or radians, in the axes of the stage; m = 0 without a stage.
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
        """Return the conditions of `count` rows; missing columns are not recorded, and one row serves for all."""
        shapes = {"device_from_camera": (3, 3), "stage": (0,)}
        filled: dict[str, Any] = {}
        for column in fields(cls):
            shape, default = shapes.get(column.name, ()), -1 if column.name in ("visit", "channel") else np.nan
            value = np.asarray(columns.get(column.name, np.full(shape, default)))
            filled[column.name] = np.repeat(value[None], count, axis=0) if value.ndim == len(shape) else value
        return cls(**filled)


@dataclass(frozen=True)
class CaptureMotionPrior:
    """Prior of the camera's motion relative to the poses that captures state.

    A small motion of the camera about its own entrance pupil, in axes of the device frame.

    Attributes:
        capture: (k,) index of the camera position, or of the visit if the conditions number all visits.
        size: (k, 6) standard deviations: rotation about x, y and z in radians, then shift along x, y and z in metres.
        log_sigma: standard deviation of the natural logarithm of a common factor on all sizes; 0.1 is 10 %.

    Raises:
        BadInputError: a shape does not fit, an index occurs twice, or a number is not finite or negative.
    """

    capture: IntArray
    size: FloatArray
    log_sigma: float

    def __post_init__(self) -> None:
        count = np.size(self.capture)
        _set_indices(self, "capture", count, "capture motions")
        _set_rows(self, "size", (count, 6), what="capture motions")
        if count == 0 or len(np.unique(self.capture)) < count:
            raise BadInputError("capture motions: 'capture' must name one capture or more, and each only once.")
        if np.any(self.size < 0):
            raise BadInputError("capture motions: 'size' has negative standard deviations; give zero or more.")
        if not (np.ndim(self.log_sigma) == 0 and np.isfinite(self.log_sigma) and self.log_sigma > 0):
            raise BadInputError(f"capture motions: 'log_sigma' is {self.log_sigma}; it must be a positive number.")
        object.__setattr__(self, "log_sigma", float(self.log_sigma))

    def of(self, capture: IntArray) -> "CaptureMotionPrior":
        """Return the prior of captures (m,), which may repeat, numbered 0..m - 1.

        Raises:
            BadInputError: one of them is missing.
        """
        at = _positions_of(self.capture, capture, "'motion' has no size", "capture")
        return CaptureMotionPrior(np.arange(len(capture)), self.size[at], self.log_sigma)


def point_terms(point: FloatArray) -> FloatArray:
    """Return terms 1, X, Y, Z, X^2, X Y, Y^2 (n, 7) of real points (n, 3), by which `CommonErrors.target` changes."""
    (x, y, z), one = point.T, np.ones(len(point))
    return np.stack([one, x, y, z, x * x, x * y, y * y], axis=-1)


@dataclass(frozen=True, eq=False)
class CommonErrors:
    """Errors that captures share: change of the stated values per unit of each of k standard normal variables.

    An error of a lens, a board, or a pose of the tracking camera or of a target is common to all captures, so that a
    fit cannot see it. The display and the see-through captures of an eye have the same variables.

    Attributes:
        sources: (k,) source of error of each variable, e.g. "lens".
        capture: (m,) index of the camera position, or of the visit, as in `CaptureMotionPrior`.
        motion: (m, 6, k) motion of each camera about its entrance pupil, device axes: rotation vector in radians, then
            shift in metres.
        lens: tangents (x, y) of a direction in the camera's frame (OpenXR axes) -> (2 * k), their change: along x by
            each variable, then along y; None for an exact lens. It needs `Conditions.device_from_camera`.
        target_pose: (p,) index of the target's pose.
        target: (p, 7, 3, k) change of its real points by `point_terms`, metres, device frame. A shift is in the first
            term, a rotation w about the origin is w x (X, Y, Z), and a board's scale and bow are in the rest.
        focus: (p, k) relative change of the tangents of `lens` in photographs of this target pose.

    Raises:
        BadInputError: a shape does not fit, an index occurs twice, or a number is not finite.
    """

    sources: tuple[str, ...]
    capture: IntArray
    motion: FloatArray
    lens: Polynomial | None = None
    target_pose: IntArray = field(default_factory=lambda: np.zeros(0, np.int64))
    target: FloatArray = field(default_factory=partial(np.zeros, 0))
    focus: FloatArray = field(default_factory=partial(np.zeros, 0))

    def __post_init__(self) -> None:
        what, k = "common errors", len(self.sources)
        object.__setattr__(self, "sources", tuple(self.sources))
        count, poses = np.size(self.capture), np.size(self.target_pose)
        _set_indices(self, "capture", count, what)
        _set_indices(self, "target_pose", poses, what)
        _set_rows(self, "motion", (count, 6, k), what=what)
        for name, shape in (("target", (poses, 7, 3, k)), ("focus", (poses, k))):
            if np.size(getattr(self, name)) == 0:
                object.__setattr__(self, name, np.zeros(shape))
            _set_rows(self, name, shape, what=what)
        for name in ("capture", "target_pose"):
            if len(np.unique(getattr(self, name))) < np.size(getattr(self, name)):
                raise BadInputError(f"common errors: '{name}' has an index twice; give each once.")
        if not k or not all(isinstance(each, str) and each for each in self.sources):
            raise BadInputError("common errors: 'sources' must name the source of error of one variable or more.")
        if self.lens is not None and (len(self.lens.box.low), self.lens.outputs) != (2, 2 * k):
            raise BadInputError(
                f"common errors: 'lens' must have 2 variables and {2 * k} outputs, two of each variable."
            )

    def of(self, capture: IntArray) -> FloatArray:
        """Return the motions (m, 6, k) of captures (m,), which may repeat.

        Raises:
            BadInputError: one of them is missing.
        """
        return self.motion[_positions_of(self.capture, capture, "the common errors have no motion", "capture")]

    def combined(self, root: FloatArray, sources: Sequence[str]) -> "CommonErrors":
        """Return the errors in terms of other variables (m,) and sources: variables = root (k, m) @ others."""
        lens = self.lens
        if lens is not None:
            change = lens.coefficients.reshape(len(lens.orders), 2, -1) @ root
            lens = Polynomial(lens.orders, lens.box, change.reshape(len(lens.orders), -1))
        motion, target, focus = self.motion @ root, self.target @ root, self.focus @ root
        return CommonErrors(tuple(sources), self.capture, motion, lens, self.target_pose, target, focus)

    def changes(self, captures: "DisplayCaptures | SeeThroughCaptures", rows: slice | IntArray) -> "CommonChanges":
        """Return the change of the stated values of some rows of captures by each variable."""
        names, visit = captures.visits
        motion, tangents = self.of(names)[visit[rows]], captures.tangents[rows]
        turned = tangents_by_turn(tangents) @ motion[:, :3]
        pose = point = None
        if isinstance(captures, SeeThroughCaptures) and len(self.target_pose):
            pose = self._pose_of(captures)[rows]
            point = np.einsum("nt,ntak->nak", point_terms(captures.point[rows]), self.target[pose])
        if self.lens is not None or pose is not None:
            turned = turned + self._of_camera(captures, rows, pose)
        return CommonChanges(motion[:, 3:], turned, point)

    def _pose_of(self, captures: "SeeThroughCaptures") -> IntArray:
        return _positions_of(self.target_pose, captures.target_pose, "the common errors have nothing", "target pose")

    def _of_camera(
        self, captures: "DisplayCaptures | SeeThroughCaptures", rows: slice | IntArray, pose: IntArray | None
    ) -> FloatArray:
        """Return the change (n, 2, k) of device tangents by lens and focus."""
        if self.lens is None and not self.focus.any():
            return np.zeros((1, 2, 1))
        assert captures.conditions is not None
        rotation = captures.conditions.device_from_camera[rows]
        in_camera = tangents_of_dir(np.einsum("nji,nj->ni", rotation, captures.view_dir[rows]))
        change = np.zeros((len(in_camera), 2, len(self.sources)))
        if self.lens is not None:
            change += self.lens(in_camera).reshape(change.shape)
        if pose is not None:
            change += in_camera[:, :, None] * self.focus[pose][:, None]
        # (tx, ty, -1) of the camera's frame becomes a vector of another length in the device frame.
        moved = rotation[:, :, :2] @ change
        depth = -np.einsum("ni,ni->n", rotation[:, 2], np.column_stack([in_camera, -np.ones(len(in_camera))]))
        tangents = captures.tangents[rows]
        return np.asarray((moved[:, :2] + tangents[:, :, None] * moved[:, 2:]) / depth[:, None, None])

    def require_of(self, captures: "DisplayCaptures | SeeThroughCaptures") -> None:
        """Refuse captures that these errors do not fully cover.

        Raises:
            BadInputError: a capture or target pose is missing, or the camera's rotation is needed for errors of the
                lens.
        """
        self.of(captures.visits[0])
        if isinstance(captures, SeeThroughCaptures) and len(self.target_pose):
            self._pose_of(captures)
        if self.lens is None and not self.focus.any():
            return
        if captures.conditions is None or not np.isfinite(captures.conditions.device_from_camera).all():
            raise BadInputError(
                "captures: errors of the lens need the camera's rotation in every row; give 'device_from_camera' among "
                "the conditions."
            )


@dataclass(frozen=True)
class CommonChanges:
    """Change of the stated values of n rows of captures by each of k variables.

    Attributes:
        viewpoint: (n, 3, k) metres.
        tangents: (n, 2, k) tangents of the view direction.
        point: (n, 3, k) of the real point, metres; None for the panel.
    """

    viewpoint: FloatArray
    tangents: FloatArray
    point: FloatArray | None


def _positions_of(indices: IntArray, wanted: IntArray, what: str, noun: str) -> IntArray:
    """Return the positions of the indices (m,) in `indices` (k,); refuses an index that is missing."""
    missing = np.setdiff1d(wanted, indices)
    if missing.size:
        raise BadInputError(f"captures: {what} for {noun} {missing[0]}; give one for every {noun}.")
    order = np.argsort(indices)
    return np.asarray(order[np.minimum(np.searchsorted(indices[order], wanted), len(order) - 1)])


class _Rows:
    """Properties of both kinds of captures that follow from their rows."""

    side: ClassVar[str]

    device: str
    eye: str
    sigma_arcmin: FloatArray
    viewpoint: FloatArray
    view_dir: FloatArray
    capture: IntArray
    conditions: Conditions | None
    motion: CaptureMotionPrior | None
    common: CommonErrors | None

    @cached_property
    def tangents(self) -> FloatArray:
        """Tangents of `view_dir`, (n, 2)."""
        return tangents_of_dir(self.view_dir)

    @property
    def has_visits(self) -> bool:
        """True if the conditions number the visit of every row."""
        return self.conditions is not None and bool(np.all(self.conditions.visit >= 0))

    @cached_property
    def visits(self) -> tuple[IntArray, IntArray]:
        """Visits of camera positions, during each of which the camera stood still.

        The stage is moved again for each target pose. Without numbers, there is one visit per position and pose.

        Returns:
            The number (visits,) of each visit in `motion`, and the index (n,) of each row's visit.
        """
        pose = getattr(self, "target_pose", np.zeros_like(self.capture))
        number = self.conditions.visit if self.conditions is not None and self.has_visits else np.zeros_like(pose)
        visits, row = np.unique(np.stack([self.capture, pose, number], axis=1), axis=0, return_inverse=True)
        return visits[:, 2 if self.has_visits else 0], row.reshape(-1)

    @property
    def targets(self) -> str:
        """Targets for a summary; a panel has none."""
        return "-"

    def __len__(self) -> int:
        return len(self.viewpoint)

    def _repr_html_(self) -> str:
        return _summary([self])


@dataclass(frozen=True)
class DisplayCaptures(_Rows):
    """Observations of panel pixels from camera positions.

    Attributes:
        device: device name.
        eye: "left" or "right".
        eye_box: eye box that the captures should cover.
        panel: the panel whose pixels were decoded.
        viewpoint: (n, 3) the camera's entrance pupil.
        view_dir: (n, 3) unit direction of the pixel, from the viewpoint outwards.
        pixel: (n, 2) panel pixels.
        capture: (n,) index of the camera position.
        sigma_arcmin: (n,), or one number for all: standard deviation of `view_dir` about each of its two transverse
            axes. All zero for exact data.
        conditions: time, stage reading, camera rotation and so on of each row; None if not recorded.
        motion: prior of the camera's motion at each visit of a position; None without knowledge of the stage.
        common: errors that all captures share; None if unknown.

    Raises:
        BadInputError: a shape does not fit, a number is not finite, a direction is not a unit vector looking forward,
            or `motion` or `common` leaves out a capture.
    """

    side = "display"

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
    motion: CaptureMotionPrior | None = None
    common: CommonErrors | None = None

    def __post_init__(self) -> None:
        _check_rows(self)
        _set_rows(self, "pixel", (len(self), 2))
        _check_bench(self)


@dataclass(frozen=True)
class SeeThroughCaptures(_Rows):
    """Observations of real points through the optics from camera positions.

    Attributes:
        device, eye, eye_box, viewpoint, view_dir, capture, sigma_arcmin, conditions, motion, common: as in
            `DisplayCaptures`.
        point: (n, 3) the real point.
        target_pose: (n,) index of the target's pose; at least two depths are needed for a fit.
        target_point: (n, 3) the point in the frame of its target, NaN where unknown; None without targets.

    Raises:
        BadInputError: as `DisplayCaptures`, or a point is not in front of its viewpoint.
    """

    side = "see-through"

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
    motion: CaptureMotionPrior | None = None
    common: CommonErrors | None = None

    def __post_init__(self) -> None:
        _check_rows(self)
        _set_rows(self, "point", (len(self), 3))
        if self.target_point is not None:
            _set_rows(self, "target_point", (len(self), 3), finite=False)
        _set_indices(self, "target_pose", len(self))
        if np.any(self.point[:, 2] >= self.viewpoint[:, 2]):
            raise BadInputError(
                "captures: 'point' has real points that are not in front of their viewpoint (smaller z); check the "
                "unit (metres) and the frame of both, or leave these rows out."
            )
        _check_bench(self)

    @property
    def targets(self) -> str:
        """Number of target poses and their range of depths."""
        depth = self.viewpoint[:, 2] - self.point[:, 2]
        return f"{len(np.unique(self.target_pose))} at {depth.min():.3g} to {depth.max():.3g} m"


@dataclass(frozen=True)
class Captures:
    """All captures of one eye, device frame, metres: the content of a capture file.

    `load_captures` reads them, `simulate` simulates them, `calibrate` fits models to them.

    Attributes:
        display: captures of the panel; None without photographs of it.
        see_through: captures of the world; None without photographs of it, or with opaque optics.

    Raises:
        BadInputError: both parts are missing, or they have different eyes or different common errors.
    """

    display: DisplayCaptures | None
    see_through: SeeThroughCaptures | None = None

    @property
    def source(self) -> DisplayCaptures | SeeThroughCaptures:
        """Part that states device, eye and eye box: the display if there is one."""
        part = self.display if self.display is not None else self.see_through
        assert part is not None
        return part

    @property
    def both(self) -> "tuple[DisplayCaptures, SeeThroughCaptures]":
        """Return display and see-through captures; refuses captures without one of them."""
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

    def save(self, path: str | Path) -> Path:
        """Write a capture file (.npz), whole or not at all, which `load_captures` reads; docs/files.md has the format.

        Raises:
            BadInputError: another suffix, or a file that cannot be written.
        """
        from wlr_render.captures.capture_file import save_captures  # imports this module

        return save_captures(path, self)

    def _repr_html_(self) -> str:
        return _summary([part for part in (self.display, self.see_through) if part is not None])


def _summary(parts: "Sequence[_Rows]") -> str:
    """Return the summary of one eye's captures for notebooks."""
    columns = ("captures", "directions", "camera positions", "their range, x, y, z (mm)", "targets", "sigma (arcmin)")
    rows = []
    for part in parts:
        low, high = 1e3 * part.viewpoint.min(axis=0), 1e3 * part.viewpoint.max(axis=0)
        places = ", ".join(f"{a:.3g} to {b:.3g}" for a, b in zip(low, high, strict=True))
        counted = [str(each) for each in (len(part), len(np.unique(part.capture)))]
        rows.append([part.side, *counted, places, part.targets, f"{np.median(part.sigma_arcmin):.3g}"])
    first = parts[0]
    return html_summary(f"Captures of {first.device}, {first.eye} eye", [], [SummaryTable(columns, rows)])


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
    """Concatenate captures of one eye (one part or more); `capture` indices keep their values.

    Rows of a part without conditions or target points count as not recorded. The motion and the common errors of the
    result come from the first part that has any.

    Raises:
        BadInputError: this motion, or these common errors, do not cover a capture.
    """
    counts = [len(part.visit if isinstance(part, Conditions) else part) for part in parts]
    joined = {
        each.name: _joined(each.name, [getattr(part, each.name) for part in parts], counts) for each in fields(parts[0])
    }
    return replace(parts[0], **joined)


def _joined(name: str, values: Sequence[Any], counts: Sequence[int]) -> Any:
    """Join one attribute of all parts, None for a part that lacks it, given their numbers of rows."""
    first = next((value for value in values if value is not None), None)
    if isinstance(first, Conditions):
        pairs = zip(values, counts, strict=True)
        return concatenate([Conditions.recorded(count) if value is None else value for value, count in pairs])
    if not isinstance(first, np.ndarray):
        return first
    rows = [
        np.full((count, *first.shape[1:]), np.nan) if value is None else value
        for value, count in zip(values, counts, strict=True)
    ]
    return np.concatenate(_of_one_width(rows) if name == "stage" else rows)


def _of_one_width(stages: Sequence[FloatArray]) -> list[FloatArray]:
    """Return the stage readings (n, m), with missing ones filled with NaN."""
    width = max(each.shape[1] for each in stages)
    return [np.pad(each, ((0, 0), (0, width - each.shape[1])), constant_values=np.nan) for each in stages]


def _per_row(captures: DisplayCaptures | SeeThroughCaptures | Conditions) -> list[str]:
    """Return the names of the attributes with one row per capture."""
    return [f.name for f in fields(captures) if isinstance(getattr(captures, f.name), np.ndarray | Conditions)]


def with_copies(captures: AnyCaptures, rows: IntArray, position: IntArray) -> AnyCaptures:
    """Return captures and copies of rows (m,), as if of further camera positions `position` (m,) from 0.

    Each copied visit is a separate visit, with a camera motion of the same size as in the original.
    """
    names, visit = captures.visits
    copied, row = np.unique(np.stack([position, visit[rows]], axis=1), axis=0, return_inverse=True)
    whole = select(captures, np.append(np.arange(len(captures)), rows))
    last = int(captures.capture.max())
    new = last + 1 + copied[:, 0]
    changes: dict[str, Any] = {"capture": np.append(captures.capture, last + 1 + position)}
    if captures.conditions is not None and whole.conditions is not None and captures.has_visits:
        number = captures.conditions.visit
        new = int(number.max()) + 1 + np.arange(len(copied))
        changes["conditions"] = replace(whole.conditions, visit=np.append(number, new[row.reshape(-1)]))
    new, first = np.unique(new, return_index=True)
    originals = names[copied[first, 1]]
    if (prior := captures.motion) is not None:
        here = np.isin(prior.capture, names)  # it may also name captures that were left out
        size = np.concatenate([prior.size[here], prior.of(originals).size])
        changes["motion"] = CaptureMotionPrior(np.append(prior.capture[here], new), size, prior.log_sigma)
    if (common := captures.common) is not None:
        here = np.isin(common.capture, names)
        motion = np.concatenate([common.motion[here], common.of(originals)])
        changes["common"] = replace(common, capture=np.append(common.capture[here], new), motion=motion)
    return replace(whole, **changes)


def _check_rows(captures: DisplayCaptures | SeeThroughCaptures) -> None:
    if captures.eye not in ("left", "right"):
        raise BadInputError(f"captures: 'eye' is '{captures.eye}'; it must be 'left' or 'right'.")
    count = len(np.atleast_1d(captures.viewpoint))
    if count == 0:
        raise BadInputError("captures: the table is empty; a fit needs at least one measured direction.")
    _set_rows(captures, "viewpoint", (count, 3))
    _set_rows(captures, "view_dir", (count, 3))
    _set_indices(captures, "capture", count)
    length = np.linalg.norm(captures.view_dir, axis=1)
    if np.any(np.abs(length - 1.0) > 1e-6) or np.any(captures.view_dir[:, 2] >= 0):
        raise BadInputError(
            "captures: 'view_dir' must be unit vectors that look forward (z < 0); normalise or turn them."
        )
    _set_sigma(captures, count)
    if captures.conditions is not None and len(captures.conditions.visit) != count:
        raise BadInputError(f"captures: the conditions have {len(captures.conditions.visit)} rows, not {count}.")


def _check_bench(captures: DisplayCaptures | SeeThroughCaptures) -> None:
    """Refuse captures that motions or common errors do not cover."""
    if captures.motion is not None:
        captures.motion.of(captures.visits[0])
    if captures.common is not None:
        captures.common.require_of(captures)


def _set_rows(
    captures: object, name: str, shape: tuple[int, ...], *, finite: bool = True, what: str = "captures"
) -> None:
    value = np.asarray(getattr(captures, name))
    if value.shape != shape:
        raise BadInputError(f"{what}: '{name}' must have shape {shape}, not {value.shape}.")
    value = np.asarray(value, dtype=np.float64)
    if finite and not np.isfinite(value).all():
        raise BadInputError(f"{what}: '{name}' has numbers that are not finite; leave out the rows without a value.")
    object.__setattr__(captures, name, value)


def _set_indices(captures: object, name: str, count: int, what: str = "captures") -> None:
    value = np.asarray(getattr(captures, name))
    if value.shape != (count,) or not np.issubdtype(value.dtype, np.integer):
        raise BadInputError(
            f"{what}: '{name}' must be {count} whole numbers, not {value.dtype} of shape {value.shape}."
        )
    object.__setattr__(captures, name, value.astype(np.int64))


def _set_sigma(captures: DisplayCaptures | SeeThroughCaptures, count: int) -> None:
    given: ArrayLike = captures.sigma_arcmin
    value = np.asarray(given, dtype=np.float64)
    if value.shape not in ((), (count,)):
        raise BadInputError(f"captures: 'sigma_arcmin' must be one number or {count}, not of shape {value.shape}.")
    # A weighted fit cannot mix infinite weights with finite ones.
    if not (np.isfinite(value).all() and (np.all(value > 0) or np.all(value == 0))):
        raise BadInputError("captures: 'sigma_arcmin' must be positive everywhere, or zero everywhere for exact data.")
    object.__setattr__(captures, "sigma_arcmin", np.array(np.broadcast_to(value, (count,))))
