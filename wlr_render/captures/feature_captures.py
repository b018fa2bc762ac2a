"""Features observed from known camera positions: the common part of captures of a panel and of real points.

Everything is in the device frame (OpenXR), metres. One row is one measured direction.
"""

from collections.abc import Sequence
from dataclasses import dataclass, field, fields
from functools import cached_property, partial
from typing import Any, ClassVar

import numpy as np
from numpy.typing import ArrayLike

from wlr_render.errors import BadInputError
from wlr_render.geometry.directions import tangents_by_turn, tangents_of_dir
from wlr_render.html_summary import SummaryTable, html_summary
from wlr_render.mappings import EyeBox
from wlr_render.numerics.arrays import FloatArray, IntArray
from wlr_render.numerics.polynomial import Polynomial

PANEL_PIXEL, REAL_POINT = 0, 1
"""Kinds of features."""


@dataclass(frozen=True)
class CaptureMotionPrior:
    """Prior of the camera's motion relative to the poses that captures state.

    A small motion of the camera about its own entrance pupil, in axes of the device frame.

    Attributes:
        capture: (k,) index of the camera position, or of the visit if the captures number all visits.
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
        object.__setattr__(self, "capture", indices_of("capture", self.capture, count, "capture motions"))
        object.__setattr__(self, "size", rows_of("size", self.size, (count, 6), what="capture motions"))
        if count == 0 or len(np.unique(self.capture)) < count:
            raise BadInputError("capture motions: 'capture' must name one capture or more, and each only once.")
        if np.any(self.size < 0):
            raise BadInputError("capture motions: 'size' has negative standard deviations; give zero or more.")
        if not (np.ndim(self.log_sigma) == 0 and np.isfinite(self.log_sigma) and self.log_sigma > 0):
            raise BadInputError(f"capture motions: 'log_sigma' is {self.log_sigma}; it must be a positive number.")
        object.__setattr__(self, "log_sigma", float(self.log_sigma))

    def of(self, capture: IntArray) -> "CaptureMotionPrior":
        """Return the prior of captures (m,), which may repeat, renumbered 0..m - 1.

        Raises:
            BadInputError: a capture is missing.
        """
        at = _positions_of(self.capture, capture, "'motion' has no size", "capture")
        return CaptureMotionPrior(np.arange(len(capture)), self.size[at], self.log_sigma)


def point_terms(point: FloatArray) -> FloatArray:
    """Return the terms 1, X, Y, Z, X^2, X Y, Y^2 (n, 7) of real points (n, 3), as used by `CommonErrors.target`."""
    (x, y, z), one = point.T, np.ones(len(point))
    return np.stack([one, x, y, z, x * x, x * y, y * y], axis=-1)


@dataclass(frozen=True, eq=False)
class CommonErrors:
    """Errors common to all captures: change of the stated values per unit of each of k standard normal variables.

    An error of a lens, a board, or a pose of the tracking camera or of a target is common to all captures, so that a
    fit cannot see it. The display and the see-through captures of an eye have the same variables.

    Attributes:
        sources: (k,) source of error of each variable, e.g. "lens".
        capture: (m,) index of the camera position, or of the visit, as in `CaptureMotionPrior`.
        motion: (m, 6, k) motion of each camera about its entrance pupil, device axes: rotation vector in radians, then
            shift in metres.
        lens: tangents (x, y) of a direction in the camera's frame (OpenXR axes) -> (2 * k), change of x by each
            variable, then of y; None for an exact lens. It needs `device_from_camera` of the captures.
        target_pose: (p,) index of the target's pose.
        target: (p, 7, 3, k) coefficients of `point_terms` for the change of the target's real points, metres, device
            frame. The first term is a shift, a rotation w about the origin is w x (X, Y, Z), and the other terms
            describe a board's scale and bow.
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
        for name, size in (("capture", count), ("target_pose", poses)):
            index = indices_of(name, getattr(self, name), size, what)
            if len(np.unique(index)) < size:
                raise BadInputError(f"common errors: '{name}' has an index twice; give each once.")
            object.__setattr__(self, name, index)
        object.__setattr__(self, "motion", rows_of("motion", self.motion, (count, 6, k), what=what))
        for name, shape in (("target", (poses, 7, 3, k)), ("focus", (poses, k))):
            stated = getattr(self, name) if np.size(getattr(self, name)) else np.zeros(shape)
            object.__setattr__(self, name, rows_of(name, stated, shape, what=what))
        if not k or not all(isinstance(each, str) and each for each in self.sources):
            raise BadInputError("common errors: 'sources' must name the source of error of one variable or more.")
        if self.lens is not None and (len(self.lens.box.low), self.lens.outputs) != (2, 2 * k):
            raise BadInputError(
                f"common errors: 'lens' must have 2 variables and {2 * k} outputs, two of each variable."
            )

    def of(self, capture: IntArray) -> FloatArray:
        """Return the motions (m, 6, k) of captures (m,), which may repeat.

        Raises:
            BadInputError: a capture is missing.
        """
        return self.motion[_positions_of(self.capture, capture, "the common errors have no motion", "capture")]

    def combined(self, root: FloatArray, sources: Sequence[str]) -> "CommonErrors":
        """Return the errors in terms of m other variables with `sources`: old variables = root (k, m) @ new ones."""
        lens = self.lens
        if lens is not None:
            change = lens.coefficients.reshape(len(lens.orders), 2, -1) @ root
            lens = Polynomial(lens.orders, lens.box, change.reshape(len(lens.orders), -1))
        motion, target, focus = self.motion @ root, self.target @ root, self.focus @ root
        return CommonErrors(tuple(sources), self.capture, motion, lens, self.target_pose, target, focus)

    def changes(self, captures: "FeatureCaptures", rows: slice | IntArray) -> "CommonChanges":
        """Return the change of the stated values of some rows of captures per unit of each variable."""
        names, visit = captures.visits
        motion, tangents = self.of(names)[visit[rows]], captures.tangents[rows]
        turned = tangents_by_turn(tangents) @ motion[:, :3]
        pose = point = None
        if captures.kind == REAL_POINT and len(self.target_pose):
            pose = self._pose_of(captures)[rows]
            point = np.einsum("nt,ntak->nak", point_terms(captures.feature[rows]), self.target[pose])
        if self.lens is not None or pose is not None:
            turned = turned + self._of_camera(captures, rows, pose)
        return CommonChanges(motion[:, 3:], turned, point)

    def _pose_of(self, captures: "FeatureCaptures") -> IntArray:
        return _positions_of(self.target_pose, captures.target_pose, "the common errors have nothing", "target pose")

    def _of_camera(self, captures: "FeatureCaptures", rows: slice | IntArray, pose: IntArray | None) -> FloatArray:
        """Return the change (n, 2, k) of device-frame tangents due to lens and focus."""
        if self.lens is None and not self.focus.any():
            return np.zeros((1, 2, 1))
        rotation = captures.device_from_camera[rows]
        in_camera = tangents_of_dir(np.einsum("nji,nj->ni", rotation, captures.view_dir[rows]))
        change = np.zeros((len(in_camera), 2, len(self.sources)))
        if self.lens is not None:
            change += self.lens(in_camera).reshape(change.shape)
        if pose is not None:
            change += in_camera[:, :, None] * self.focus[pose][:, None]
        # Rotated to the device frame, (tx, ty, -1) of the camera's frame no longer has z = -1.
        moved = rotation[:, :, :2] @ change
        depth = -np.einsum("ni,ni->n", rotation[:, 2], np.column_stack([in_camera, -np.ones(len(in_camera))]))
        tangents = captures.tangents[rows]
        return np.asarray((moved[:, :2] + tangents[:, :, None] * moved[:, 2:]) / depth[:, None, None])

    def require_of(self, captures: "FeatureCaptures") -> None:
        """Refuse captures that these errors do not fully cover.

        Raises:
            BadInputError: a capture or target pose is missing, or the camera's rotation is needed for errors of the
                lens.
        """
        self.of(captures.visits[0])
        if captures.kind == REAL_POINT and len(self.target_pose):
            self._pose_of(captures)
        if self.lens is None and not self.focus.any():
            return
        if not np.isfinite(captures.device_from_camera).all():
            raise BadInputError(
                "captures: errors of the lens need the camera's rotation in every row; give 'device_from_camera'."
            )


@dataclass(frozen=True)
class CommonChanges:
    """Change of the stated values of n rows of captures per unit of each of k variables.

    Attributes:
        viewpoint: (n, 3, k) metres.
        tangents: (n, 2, k) tangents of the view direction.
        point: (n, 3, k) real point, metres; None for the panel.
    """

    viewpoint: FloatArray
    tangents: FloatArray
    point: FloatArray | None


def _positions_of(indices: IntArray, wanted: IntArray, what: str, noun: str) -> IntArray:
    """Return the positions (m,) of the `wanted` indices in `indices` (k,); a missing one raises `BadInputError`."""
    missing = np.setdiff1d(wanted, indices)
    if missing.size:
        raise BadInputError(f"captures: {what} for {noun} {missing[0]}; give one for every {noun}.")
    order = np.argsort(indices)
    return np.asarray(order[np.minimum(np.searchsorted(indices[order], wanted), len(order) - 1)])


def column(*row: int, whole: bool = False, optional: bool = False) -> Any:
    """Return a dataclass field with an array of shape `row` (-1: any length) for each row of captures.

    An optional field is -1 (whole numbers) or NaN where not recorded.
    """
    absent = np.full([max(size, 0) for size in row], -1 if whole else np.nan)
    rule = {"row": row, "whole": whole, "optional": optional}
    return field(default_factory=lambda: absent, metadata=rule) if optional else field(metadata=rule)


@dataclass(frozen=True, eq=False, kw_only=True)
class FeatureCaptures:
    """Observations of features of one kind from camera positions.

    A single value is repeated for all rows. `visit` and the columns after it are -1 or NaN where not recorded.

    Attributes:
        device: device name.
        eye: "left" or "right".
        eye_box: eye box that the captures should cover.
        capture: (n,) index of the camera position.
        target_pose: (n,) index of the target's pose; -1 for a panel.
        target_point: (n, 3) the point in the frame of its target; NaN where unknown, and for a panel.
        viewpoint: (n, 3) the camera's entrance pupil.
        view_dir: (n, 3) unit direction of the feature, from the viewpoint outwards.
        sigma_arcmin: (n,) standard deviation of `view_dir` about each of its two transverse axes. All zero for exact
            data.
        visit: (n,) number of the photograph, or of the set of code photographs, within its target pose.
        channel: (n,) colour of the light: 0 red, 1 green, 2 blue.
        time_s: (n,) time since the session's start.
        temperature_c: (n,) temperature of the bench, degrees Celsius.
        travel: (n,) direction of the stage's last move in x, +1 or -1.
        stage: (n, m) stage reading, metres or radians, in the axes of the stage; m = 0 without a stage.
        device_from_camera: (n, 3, 3) camera rotation; a camera of OpenXR's axes looks along its -z.
        motion: prior of the camera's motion at each visit of a position; None without knowledge of the stage.
        common: errors that all captures share; None if unknown.

    Raises:
        BadInputError: a shape does not fit, a number is not finite, a direction is not a unit vector looking forward,
            or `motion` or `common` leaves out a capture.
    """

    kind: ClassVar[int]
    side: ClassVar[str]

    device: str
    eye: str
    eye_box: EyeBox
    capture: IntArray = column(whole=True)
    target_pose: IntArray = column(whole=True, optional=True)
    target_point: FloatArray = column(3, optional=True)
    viewpoint: FloatArray = column(3)
    view_dir: FloatArray = column(3)
    sigma_arcmin: FloatArray = column()
    visit: IntArray = column(whole=True, optional=True)
    channel: IntArray = column(whole=True, optional=True)
    time_s: FloatArray = column(optional=True)
    temperature_c: FloatArray = column(optional=True)
    travel: FloatArray = column(optional=True)
    stage: FloatArray = column(-1, optional=True)
    device_from_camera: FloatArray = column(3, 3, optional=True)
    motion: CaptureMotionPrior | None = None
    common: CommonErrors | None = None

    def __post_init__(self) -> None:
        if self.eye not in ("left", "right"):
            raise BadInputError(f"captures: 'eye' is '{self.eye}'; it must be 'left' or 'right'.")
        count = len(np.atleast_2d(self.view_dir))
        if count == 0:
            raise BadInputError("captures: the table is empty; a fit needs at least one measured direction.")
        for name in columns_of(type(self)):
            object.__setattr__(self, name, column_of(type(self), name, getattr(self, name), count))
        length = np.linalg.norm(self.view_dir, axis=1)
        if np.any(np.abs(length - 1.0) > 1e-6) or np.any(self.view_dir[:, 2] >= 0):
            raise BadInputError(
                "captures: 'view_dir' must be unit vectors that look forward (z < 0); normalise or turn them."
            )
        # A weighted fit cannot mix infinite weights with finite ones.
        if not (np.all(self.sigma_arcmin > 0) or np.all(self.sigma_arcmin == 0)):
            raise BadInputError(
                "captures: 'sigma_arcmin' must be positive everywhere, or zero everywhere for exact data."
            )
        if self.motion is not None:
            self.motion.of(self.visits[0])
        if self.common is not None:
            self.common.require_of(self)

    @property
    def feature(self) -> FloatArray:
        """Features (n, 3): panel pixels u, v and NaN, or real points."""
        raise NotImplementedError

    @cached_property
    def tangents(self) -> FloatArray:
        """Tangents of `view_dir`, (n, 2)."""
        return tangents_of_dir(self.view_dir)

    @property
    def has_visits(self) -> bool:
        """True if the visit of every row is numbered."""
        return bool(np.all(self.visit >= 0))

    @cached_property
    def visits(self) -> tuple[IntArray, IntArray]:
        """Visits of camera positions, during each of which the camera stood still.

        The stage is moved again for each target pose. Without numbers, there is one visit per position and pose.

        Returns:
            The number (visits,) of each visit in `motion`, and the index (n,) of each row's visit.
        """
        number = self.visit if self.has_visits else np.zeros_like(self.visit)
        keys = np.stack([self.capture, self.target_pose, number], axis=1)
        visits, row = np.unique(keys, axis=0, return_inverse=True)
        return visits[:, 2 if self.has_visits else 0], row.reshape(-1)

    def __len__(self) -> int:
        return len(self.viewpoint)

    def _repr_html_(self) -> str:
        return summary_of([self])


def summary_of(parts: Sequence[FeatureCaptures]) -> str:
    """Return an HTML summary of one eye's captures, for notebooks."""
    columns = ("captures", "directions", "camera positions", "their range, x, y, z (mm)", "targets", "sigma (arcmin)")
    rows = []
    for part in parts:
        depth = part.viewpoint[:, 2] - part.feature[:, 2]
        low, high = 1e3 * part.viewpoint.min(axis=0), 1e3 * part.viewpoint.max(axis=0)
        places = ", ".join(f"{a:.3g} to {b:.3g}" for a, b in zip(low, high, strict=True))
        counted = [str(each) for each in (len(part), len(np.unique(part.capture)))]
        poses = len(np.unique(part.target_pose))
        targets = f"{poses} at {depth.min():.3g} to {depth.max():.3g} m" if part.kind == REAL_POINT else "-"
        rows.append([part.side, *counted, places, targets, f"{np.median(part.sigma_arcmin):.3g}"])
    first = parts[0]
    return html_summary(f"Captures of {first.device}, {first.eye} eye", [], [SummaryTable(columns, rows)])


def columns_of(kind: type[FeatureCaptures]) -> list[str]:
    """Return the names of the attributes with one row per capture."""
    return [each.name for each in fields(kind) if each.metadata]


def column_of(kind: type[FeatureCaptures], name: str, value: ArrayLike, count: int) -> Any:
    """Return a column of `count` rows; a single value is repeated.

    Raises:
        BadInputError: the shape does not fit, or a number of a required column is not finite.
    """
    rule = next(each.metadata for each in fields(kind) if each.name == name)
    array = np.asarray(value)
    row = tuple(array.shape[-1] if size < 0 and array.ndim else size for size in rule["row"])
    if array.shape == row:
        array = np.repeat(array[None], count, axis=0)
    if rule["whole"]:
        return indices_of(name, array, count)
    return rows_of(name, array, (count, *row), finite=not rule["optional"])


def rows_of(
    name: str, value: ArrayLike, shape: tuple[int, ...], *, finite: bool = True, what: str = "captures"
) -> FloatArray:
    """Convert to an array of this shape; refuse another shape, and, if `finite`, numbers that are not finite."""
    array = np.asarray(value)
    if array.shape != shape:
        raise BadInputError(f"{what}: '{name}' must have shape {shape}, not {array.shape}.")
    array = np.asarray(array, dtype=np.float64)
    if finite and not np.isfinite(array).all():
        raise BadInputError(f"{what}: '{name}' has numbers that are not finite; leave out the rows without a value.")
    return array


def indices_of(name: str, value: ArrayLike, count: int, what: str = "captures") -> IntArray:
    """Convert to an array of `count` whole numbers; refuse anything else."""
    array = np.asarray(value)
    if array.shape != (count,) or not np.issubdtype(array.dtype, np.integer):
        raise BadInputError(
            f"{what}: '{name}' must be {count} whole numbers, not {array.dtype} of shape {array.shape}."
        )
    return array.astype(np.int64)
