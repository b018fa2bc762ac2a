"""Captures: view directions of panel pixels and real points from known viewpoints.

Everything is in the device frame (OpenXR), metres. One row is one measured direction; `capture` says which camera
position it was taken at, so that held-out tests can leave out whole positions.
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
            filled[each.name] = np.repeat(value[None], count, axis=0) if value.ndim == len(shape) else value
        return cls(**filled)


@dataclass(frozen=True)
class CaptureMotionPrior:
    """How far the camera may have stood from where captures state it, known before the fit of a model.

    A small motion of the camera about its own entrance pupil, in axes of the device frame.

    Attributes:
        capture: (k,) index of the camera position; of the visit, where the conditions number all visits.
        size: (k, 6) standard deviations: rotation about x, y and z in radians, then shift along x, y and z in metres.
        log_sigma: standard deviation of the natural logarithm of a factor that all sizes may be wrong by. 0.1 is 10 %.

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
        """Return the prior of captures (m,), some of which may be the same, numbered 0..m - 1.

        Raises:
            BadInputError: there is none for one of them.
        """
        at = _found(self.capture, capture, "'motion' has no size", "capture")
        return CaptureMotionPrior(np.arange(len(capture)), self.size[at], self.log_sigma)


def point_terms(point: FloatArray) -> FloatArray:
    """Return terms 1, X, Y, Z, X^2, X Y, Y^2 (n, 7) of real points (n, 3), by which `CommonErrors.target` changes."""
    (x, y, z), one = point.T, np.ones(len(point))
    return np.stack([one, x, y, z, x * x, x * y, y * y], axis=-1)


@dataclass(frozen=True, eq=False)
class CommonErrors:
    """Errors that captures share: how much they state too much, by k independent standard normal variables.

    A lens, a board, a pose of the tracking camera or of a target that is off is off for all captures alike, so that no
    fit can see it. In the display and the see-through captures of an eye the variables are the same.

    Attributes:
        sources: (k,) what each variable is an error of, e.g. "lens".
        capture: (m,) index of the camera position, or of the visit, as in `CaptureMotionPrior`.
        motion: (m, 6, k) of each camera about its entrance pupil, device axes: rotation vector in radians, then shift
            in metres.
        lens: tangents (x, y) of a direction in the camera's frame (OpenXR axes) -> (2 * k), their change: along x by
            each variable, then along y; None where the lens is exact. It needs `Conditions.device_from_camera`.
        target_pose: (p,) index of the target's pose.
        target: (p, 7, 3, k) change of its real points by `point_terms`, metres, device frame. A shift is in the first
            term, a turn w about the origin is w x (X, Y, Z), and a board's scale and bow take the rest.
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
            raise BadInputError("common errors: 'sources' must name one variable or more by what it is an error of.")
        if self.lens is not None and (len(self.lens.box.low), self.lens.outputs) != (2, 2 * k):
            raise BadInputError(
                f"common errors: 'lens' must have 2 variables and {2 * k} outputs, two of each variable."
            )

    def of(self, capture: IntArray) -> FloatArray:
        """Return the motions (m, 6, k) of captures (m,), some of which may be the same.

        Raises:
            BadInputError: there is none for one of them.
        """
        return self.motion[_found(self.capture, capture, "the common errors have no motion", "capture")]

    def combined(self, root: FloatArray, sources: Sequence[str]) -> "CommonErrors":
        """Return the errors by other variables (m,), of other sources: variables = root (k, m) @ others."""
        lens = self.lens
        if lens is not None:
            change = lens.coefficients.reshape(len(lens.orders), 2, -1) @ root
            lens = Polynomial(lens.orders, lens.box, change.reshape(len(lens.orders), -1))
        motion, target, focus = self.motion @ root, self.target @ root, self.focus @ root
        return CommonErrors(tuple(sources), self.capture, motion, lens, self.target_pose, target, focus)

    def changes(self, captures: "DisplayCaptures | SeeThroughCaptures", rows: slice | IntArray) -> "CommonChanges":
        """By how much some rows of captures state too much, by each variable."""
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
        return _found(self.target_pose, captures.target_pose, "the common errors have nothing", "target pose")

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
        """Refuse captures of which these errors leave something out.

        Raises:
            BadInputError: a capture or target pose is missing, or the camera's rotation where the lens has errors.
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
    """By how much n rows of captures state too much, by each of k variables.

    Attributes:
        viewpoint: (n, 3, k) metres. tangents: (n, 2, k) of the view direction.
        point: (n, 3, k) of the real point, metres; None for the panel.
    """

    viewpoint: FloatArray
    tangents: FloatArray
    point: FloatArray | None


def _found(known: IntArray, wanted: IntArray, what: str, noun: str) -> IntArray:
    """Where the indices (m,) are among the known ones (k,); BadInputError where one is not."""
    missing = np.setdiff1d(wanted, known)
    if missing.size:
        raise BadInputError(f"captures: {what} for {noun} {missing[0]}; give one for every {noun}.")
    order = np.argsort(known)
    return np.asarray(order[np.minimum(np.searchsorted(known[order], wanted), len(order) - 1)])


class _Rows:
    """What both kinds of captures derive from their rows."""

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
        """(n, 2) tangents of `view_dir`."""
        return tangents_of_dir(self.view_dir)

    @property
    def has_visits(self) -> bool:
        """Whether the conditions number the visit of every row."""
        return self.conditions is not None and bool(np.all(self.conditions.visit >= 0))

    @cached_property
    def visits(self) -> tuple[IntArray, IntArray]:
        """Visits of camera positions, during each of which the camera stood still.

        The stage is driven anew for each target pose. Visits that are not numbered are one of each position and pose.

        Returns:
            What `motion` calls each visit (visits,), and the index (n,) of each row's visit.
        """
        pose = getattr(self, "target_pose", np.zeros_like(self.capture))
        number = self.conditions.visit if self.conditions is not None and self.has_visits else np.zeros_like(pose)
        visits, row = np.unique(np.stack([self.capture, pose, number], axis=1), axis=0, return_inverse=True)
        return visits[:, 2 if self.has_visits else 0], row.reshape(-1)

    @property
    def targets(self) -> str:
        """What a summary says of targets; a panel has none."""
        return "-"

    def __len__(self) -> int:
        return len(self.viewpoint)

    def _repr_html_(self) -> str:
        return _summary([self])


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
        motion: prior of the camera's motion at each visit of a position; None where nothing is known of the stage.
        common: errors that all captures share; None where none are known.

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
    """Real points as seen through the optics from camera positions.

    Attributes:
        device, eye, eye_box, viewpoint, view_dir, capture, sigma_arcmin, conditions, motion, common: as in
            `DisplayCaptures`.
        point: (n, 3) the real point.
        target_pose: (n,) index of the target's pose; at least two depths are needed for a fit.
        target_point: (n, 3) the point in the frame of its target, NaN where unknown; None where no target is known.

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
class EyeCaptures:
    """All captures of one eye: what one capture file holds.

    Attributes:
        display: of the panel; None where none was photographed.
        see_through: of the world; None where none was photographed, or the optics cannot be seen through.

    Raises:
        BadInputError: there is neither part, or the two are of different eyes or of different common errors.
    """

    display: DisplayCaptures | None
    see_through: SeeThroughCaptures | None = None

    @property
    def source(self) -> DisplayCaptures | SeeThroughCaptures:
        """A part that states device, eye and eye box: the display where there is one."""
        found = self.display if self.display is not None else self.see_through
        assert found is not None
        return found

    @property
    def both(self) -> "tuple[DisplayCaptures, SeeThroughCaptures]":
        """Display and see-through; BadInputError where one is missing."""
        if self.display is None or self.see_through is None:
            lacking = "display" if self.display is None else "see-through"
            raise BadInputError(f"the captures of {self.source.device} have no {lacking} part; add it.")
        return self.display, self.see_through

    def __post_init__(self) -> None:
        other = self.see_through
        if self.display is None and other is None:
            raise BadInputError(
                "captures: there are neither of the panel nor of a target; there must be one of the two."
            )
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
                "same 'sources', with zeros for what does not touch one of them."
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


Captures = EyeCaptures


def _summary(parts: "Sequence[_Rows]") -> str:
    """Return what notebooks show of captures of one eye."""
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
    """Concatenate captures of one eye; `capture` indices keep their values. There must be at least one part.

    Rows of a part without conditions or target points have none recorded. The motion and the common errors of all are
    those of the first part that has any.

    Raises:
        BadInputError: this motion, or these common errors, leave out a capture.
    """
    counts = [len(part.visit if isinstance(part, Conditions) else part) for part in parts]
    joined = {
        each.name: _joined(each.name, [getattr(part, each.name) for part in parts], counts) for each in fields(parts[0])
    }
    return replace(parts[0], **joined)


def _joined(name: str, values: Sequence[Any], counts: Sequence[int]) -> Any:
    """One attribute of all parts, by its values in each, None where a part lacks it, and their numbers of rows."""
    known = next((value for value in values if value is not None), None)
    if isinstance(known, Conditions):
        pairs = zip(values, counts, strict=True)
        return concatenate([Conditions.recorded(count) if value is None else value for value, count in pairs])
    if not isinstance(known, np.ndarray):
        return known
    rows = [
        np.full((count, *known.shape[1:]), np.nan) if value is None else value
        for value, count in zip(values, counts, strict=True)
    ]
    return np.concatenate(_of_one_width(rows) if name == "stage" else rows)


def _of_one_width(stages: Sequence[FloatArray]) -> list[FloatArray]:
    """Return the stage readings (n, m), those without a reading filled up with NaN."""
    width = max(each.shape[1] for each in stages)
    return [np.pad(each, ((0, 0), (0, width - each.shape[1])), constant_values=np.nan) for each in stages]


def _per_row(captures: DisplayCaptures | SeeThroughCaptures | Conditions) -> list[str]:
    """Return the names of what has a row for each capture."""
    return [f.name for f in fields(captures) if isinstance(getattr(captures, f.name), np.ndarray | Conditions)]


def with_copies(captures: AnyCaptures, rows: IntArray, position: IntArray) -> AnyCaptures:
    """Return captures, then copies of rows (m,), as if of further camera positions, numbered `position` (m,) from 0.

    Each copied visit is a visit of its own, during which the camera moves as much as during the original.
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
    if (known := captures.motion) is not None:
        here = np.isin(known.capture, names)  # it may also name captures that were left out
        size = np.concatenate([known.size[here], known.of(originals).size])
        changes["motion"] = CaptureMotionPrior(np.append(known.capture[here], new), size, known.log_sigma)
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
        raise BadInputError("captures: there are no rows; a fit needs at least one measured direction.")
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
    """Refuse captures of which what is known of the bench leaves out some."""
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
    # An infinite weight beside finite ones has no meaning in a weighted fit.
    if not (np.isfinite(value).all() and (np.all(value > 0) or np.all(value == 0))):
        raise BadInputError("captures: 'sigma_arcmin' must be positive everywhere, or zero everywhere for exact data.")
    object.__setattr__(captures, "sigma_arcmin", np.array(np.broadcast_to(value, (count,))))
