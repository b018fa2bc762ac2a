"""Errors by label as unknowns of a fit: by dot, by time, by the readings of a stage's axes and by its travel.

Readings of one label share an error. The size of each kind of error is a hyperparameter. Where the readings do not
determine it, it stays at the usual size, and the error is in the model's covariance: a raster scan shows neither drift
nor screw errors. The axes of the stage are assumed parallel to the axes of the device frame.
"""

from collections.abc import Iterator
from dataclasses import dataclass, replace

import numpy as np
import scipy

from wlr_render.captures.correspondences import DisplayCaptures, SeeThroughCaptures
from wlr_render.error_sources import ErrorSource
from wlr_render.numerics.arrays import BoolArray, FloatArray, IntArray
from wlr_render.numerics.polynomial import Box, basis, total_degree
from wlr_render.usual import (
    BOARD_HEIGHT_M,
    BOARD_PRINT_M,
    CAMERA_DRIFT_ARCMIN,
    STAGE_BACKLASH_M,
    STAGE_SCREW_M,
    Size,
)

USUAL_FALL, FALLS_DIFFER = 0.3, 0.3
"""Decrease of a wave's log size with its frequency, per radian in `_UNIT_M`, and the sigma of this decrease."""
_UNIT_M = 0.1  # a hand's width
_FINEST_M, _FINEST_HEIGHT_M = 0.095, 0.19  # half the shortest wave; printing errors extend over about a hand's width
_ALONG = 0.25  # largest ratio of cross-axis to along-axis response for which the outputs have separate print errors
_MOST_WAVES = 12  # most waves along an axis
_BEYOND = 1.15  # ratio of the board's extent to the extent of its dots
_TIMES = 4  # number of orders of a drift in time; sizes are inversely proportional to the order
_TURN, _ZOOM = 1.0, 0.3  # relative sizes of a uniform drift over the field, and of a linear one
_MEAN = 0.5  # ratio of a drift's mean to its first order; the camera's pose was measured at another time
_SAME_READING_M = 1e-4  # resolution at which readings of a stage's axis are the same
_MOST_READINGS = 32  # most distinct readings of an axis; more are binned
_SMOOTH_ORDER = 3  # highest order, in the place, of errors that optics could cause
_ROUGH_SHARE = 0.4  # least share of errors by reading that vary faster; they determine the size


@dataclass(frozen=True)
class LabelTerm:
    """Unknown errors of one kind of label: columns times unknowns.

    Attributes:
        name: name of the errors' size among the hyperparameters.
        source: source of the errors in an error budget.
        columns: change of `observed` by each unknown: (n, k) if each axis has separate unknowns, (n, 2, k) if both axes
            share the unknowns.
        offset: (k,) logarithm of the prior size of each unknown, for a size of one.
        usual: size expected without readings.
        frequency: (k,) frequency of each unknown, with which the prior size decreases; None for constant sizes.
        mean: size of an error that is equal in all readings, for a size of one; readings cannot show it.
    """

    name: str
    source: ErrorSource
    columns: FloatArray
    offset: FloatArray
    usual: Size
    frequency: FloatArray | None = None
    mean: float = 0.0

    def select(self, rows: BoolArray | IntArray) -> "LabelTerm":
        """Return the term for some of the readings."""
        return replace(self, columns=self.columns[rows])


@dataclass(frozen=True)
class StageLabels:
    """Labels whose errors are shifts of the camera along an axis of the stage.

    Attributes:
        group: (3, n) group of each camera reading, by the reading of each stage axis.
        reading: reading (groups,) of each group, metres, for axes x, y and z.
        travel: (n,) direction of travel along x, +1 or -1; 0 if unknown.
    """

    group: IntArray
    reading: tuple[FloatArray, ...]
    travel: FloatArray

    def select(self, rows: BoolArray | IntArray) -> "StageLabels":
        """Return the labels for some of the readings."""
        return replace(self, group=self.group[:, rows], travel=self.travel[rows])

    def terms(self, shift: FloatArray) -> Iterator[LabelTerm]:
        """Yield the terms of the labels, from the change (n, 2, 3) of `observed` by a shift of the camera."""
        columns = []
        for axis in self.axes:
            group = self.group[axis]
            own = np.zeros((len(group), 2, len(self.reading[axis])))
            own[np.arange(len(group)), :, group] = shift[:, :, axis]
            columns.append(own)
        if columns:
            joined = np.concatenate(columns, axis=2)
            yield LabelTerm("axes", ErrorSource.STAGE_AXES, joined, np.zeros(joined.shape[2]), STAGE_SCREW_M)
        if np.ptp(self.travel) > 0:
            by_travel = shift[:, :, :1] * self.travel[:, None, None]
            yield LabelTerm("travel", ErrorSource.TRAVEL, by_travel, np.zeros(1), STAGE_BACKLASH_M)

    @property
    def axes(self) -> list[int]:
        """Axes of the stage that move."""
        return [axis for axis, reading in enumerate(self.reading) if len(reading) > 1]

    def rough(self) -> FloatArray:
        """Return combinations (errors by reading, k) of the unknowns of "axes" that vary rapidly along each axis.

        Errors that vary smoothly are degenerate with the change of the optics with the place, and show nothing about
        the stage.
        """
        blocks = []
        for axis in self.axes:
            reading = self.reading[axis][:, None]
            smooth = smooth_basis(reading, 1.0 - _ROUGH_SHARE)
            blocks.append(np.linalg.qr(smooth, mode="complete")[0][:, smooth.shape[1] :])
        return np.asarray(scipy.linalg.block_diag(*blocks)) if blocks else np.zeros((0, 0))


def stage_labels(captures: DisplayCaptures | SeeThroughCaptures) -> StageLabels:
    """Return the labels of the stage for captures."""
    groups = np.stack([reading_groups(captures.viewpoint[:, axis]) for axis in range(3)])
    places = zip(groups, captures.viewpoint.T, strict=True)
    reading = tuple(means_by(group, along[:, None])[:, 0] for group, along in places)
    return StageLabels(groups, reading, np.nan_to_num(captures.travel))


def unseen_errors(captures: DisplayCaptures | SeeThroughCaptures) -> tuple[str, ...]:
    """Return the errors that a fit cannot model, with the missing data of the captures in brackets."""
    lacking = {
        "drift (times)": not np.isfinite(captures.time_s).all(),
        "direction of travel (travel)": not np.isfinite(captures.travel).any(),
        "motions between photographs from one position (visits)": not captures.has_visits,
        "lens and pose of the camera and whatever else all captures share (common errors)": captures.common is None,
    }
    if isinstance(captures, SeeThroughCaptures):
        places = "printing errors and shape of the board (places on the board)"
        lacking[places] = not np.isfinite(captures.target_point).all()
    return tuple(name for name, is_lacking in lacking.items() if is_lacking)


def reading_groups(reading: FloatArray) -> IntArray:
    """Return the group (n,) of each reading of a stage axis: one for each distinct reading, or for bins of many."""
    group = np.unique(np.round(reading / _SAME_READING_M), return_inverse=True)[1].reshape(-1)
    if group.max() < _MOST_READINGS:
        return np.asarray(group)
    part = (reading - reading.min()) / np.ptp(reading) * _MOST_READINGS
    return np.asarray(np.unique(np.minimum(part.astype(np.int64), _MOST_READINGS - 1), return_inverse=True)[1])


def drift_term(time_s: FloatArray, image: FloatArray, metric: FloatArray) -> LabelTerm | None:
    """Return a drift of the image, smooth in time: a rotation of the camera and a linear change over the field.

    All readings share the mean, which is the camera's rotation since its pose was measured.

    Args:
        time_s: (n,) times; NaN where unknown.
        image: (n, 2) positions in the image.
        metric: (n,) arcminutes per unit of `observed`.
    """
    if not np.isfinite(time_s).all() or len(np.unique(time_s)) <= _TIMES:
        return None
    of_time = basis(time_s[:, None], np.arange(1, _TIMES + 1)[:, None], Box.around(time_s[:, None]))
    of_field = basis(image, total_degree(2, 1), Box.around(image)) / metric[:, None]
    columns = ((of_time - of_time.mean(axis=0))[:, :, None] * of_field[:, None]).reshape(len(time_s), -1)
    order = np.repeat(np.arange(1, _TIMES + 1), of_field.shape[1])
    constant = total_degree(2, 1).sum(axis=1) == 0
    offset = np.log(np.tile(np.where(constant, _TURN, _ZOOM), _TIMES) / order)
    mean = _MEAN / float(np.median(metric))
    return LabelTerm("drift", ErrorSource.DRIFT, columns, offset, CAMERA_DRIFT_ARCMIN, mean=mean)


def means_by(group: IntArray, values: FloatArray) -> FloatArray:
    """Return means (groups, k) of values (n, k) by group (n,); 0 for an empty group."""
    sums = np.stack([np.bincount(group, column) for column in values.T], axis=-1)
    return np.asarray(sums / np.maximum(np.bincount(group), 1)[:, None])


def smooth_basis(place: FloatArray, share: float) -> FloatArray:
    """Return functions (n, k) of places (n, variables) as smooth as optics, up to the highest order allowed.

    Args:
        place: places of visits, or readings of an axis.
        share: largest number of functions relative to the number of places.
    """
    orders = (total_degree(place.shape[1], order) for order in range(_SMOOTH_ORDER, 0, -1))
    allowed = (each for each in orders if len(each) <= share * len(place))
    return basis(place, next(allowed, np.zeros((1, place.shape[1]), np.int64)), Box.around(place))


def board_terms(
    dot: FloatArray, point: FloatArray, pose: IntArray, by_point: FloatArray, is_pose_fitted: bool
) -> list[LabelTerm]:
    """Return printing errors in the plane of a board, and heights over its best-fit plane, equal at all poses.

    Args:
        dot: (n, 2) positions on the board, metres; NaN where unknown.
        point: (n, 3) these positions in the device frame. pose: (n,) number of the board's pose.
        by_point: (n, 2, 3) change of `observed` by the position of the point.
        is_pose_fitted: True if the poses and the scale of the board were fitted to its dots, which leaves no linear
            error of the print.
    """
    if not np.isfinite(dot).all():
        return []
    by_board = by_point @ _board_axes(dot, point, pose)
    terms = (_print_term(dot, by_board[..., :2], is_pose_fitted), _height_term(dot, by_board[..., 2]))
    return [each for each in terms if each is not None]


def _print_term(dot: FloatArray, by_shift: FloatArray, is_pose_fitted: bool) -> LabelTerm | None:
    """Return printing errors in the plane of a board, with separate waves for its two axes; None without an area.

    Args:
        dot: (n, 2) positions on the board, metres.
        by_shift: (n, 2, 2) change of `observed` by a shift along each axis of the board.
        is_pose_fitted: as in `board_terms`.
    """
    waves = _waves(dot, _FINEST_M, is_pose_fitted)
    if waves is None:
        return None
    columns, frequency = waves
    offset = np.full(len(frequency), -0.5 * np.log(0.25 * np.sum(np.exp(-2.0 * USUAL_FALL * frequency))))
    along, across = np.einsum("nkk->nk", by_shift), by_shift[:, [0, 1], [1, 0]]
    if np.linalg.norm(across) < _ALONG * np.linalg.norm(along):  # separate unknowns per output are cheaper
        # Signs differ between outputs if the board's y axis points down, and both change if the board is turned.
        columns = columns * (np.sign(along[:, 0]) * np.abs(along).mean(axis=1))[:, None]
    else:
        columns = (by_shift[..., None] * columns[:, None, None]).reshape(len(dot), 2, -1)
        offset, frequency = np.tile(offset, 2), np.tile(frequency, 2)
    return LabelTerm("print", ErrorSource.PRINTING, columns, offset, BOARD_PRINT_M, frequency)


def _height_term(dot: FloatArray, by_height: FloatArray) -> LabelTerm | None:
    """Return heights of a board over its best-fit plane; None without an area.

    Args:
        dot: (n, 2) positions on the board, metres.
        by_height: (n, 2) change of `observed` by a shift out of the board's plane.
    """
    waves = _waves(dot, _FINEST_HEIGHT_M, is_pose_fitted=True)
    if waves is None:
        return None
    height, frequency = waves
    columns = by_height[:, :, None] * height[:, None]
    size = np.exp(-USUAL_FALL * frequency)
    offset = np.log(size / np.sqrt(0.25 * np.sum(size**2)))
    return LabelTerm("heights", ErrorSource.BOARD_SHAPE, columns, offset, BOARD_HEIGHT_M)


def _board_axes(dot: FloatArray, point: FloatArray, pose: IntArray) -> FloatArray:
    """Return the axes x, y and z (n, 3, 3) of the board in the device frame, as columns of unit vectors."""
    axes = np.empty((len(point), 3, 3))
    for number in np.unique(pose):
        rows = pose == number
        flat = np.column_stack([dot[rows], np.ones(rows.sum())])
        along_x, along_y, _ = np.linalg.lstsq(flat, point[rows], rcond=None)[0]
        own = np.stack([along_x, along_y, np.cross(along_x, along_y)], axis=-1)
        axes[rows] = own / np.maximum(np.linalg.norm(own, axis=0), 1e-300)
    return axes


def _waves(dot: FloatArray, finest_m: float, is_pose_fitted: bool) -> tuple[FloatArray, FloatArray] | None:
    """Return waves (n, k) on a board and their frequencies (k,), radians per `_UNIT_M`; None without an area.

    A fit of the board's pose and scale to all dots removes the linear part of the waves.
    """
    every, row = np.unique(dot, axis=0, return_inverse=True)
    middle, half = 0.5 * (dot.max(axis=0) + dot.min(axis=0)), 0.5 * _BEYOND * np.ptp(dot, axis=0)
    if half.min() <= 0:
        return None
    counts = np.clip(np.ceil(2.0 * half / finest_m), 2, _MOST_WAVES).astype(int)
    orders = np.stack(np.meshgrid(*(np.arange(1, count + 1) for count in counts)), axis=-1).reshape(-1, 2)
    along = np.pi * orders / (2.0 * half)
    place = every - middle
    waves = np.sin((place[:, :1] + half[0]) * along[:, 0]) * np.sin((place[:, 1:] + half[1]) * along[:, 1])
    if is_pose_fitted:
        linear = basis(place, total_degree(2, 1), Box(-half, half))
        waves = waves - linear @ np.linalg.lstsq(linear, waves, rcond=None)[0]
    return waves[row.reshape(-1)], np.linalg.norm(along, axis=1) * _UNIT_M
