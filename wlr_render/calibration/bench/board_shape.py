"""The true shape of a board.

It has bow along both sides, twist, errors of the scales in x and y and of the right angle, smooth random fields of
heights and of printing errors, and an error of every feature's position.
"""

from collections.abc import Sequence
from dataclasses import dataclass, field
from functools import cached_property, partial

import numpy as np

from wlr_render.calibration.bench.board_views import BoardView
from wlr_render.numerics.arrays import FloatArray, IntArray
from wlr_render.numerics.smooth_field import SmoothField

BOARD_SHAPE = ("bow x", "bow y", "twist", "scale x", "scale y", "shear")
"""First unknowns of a board's shape: heights in metres, and relative errors of scale and of the right angle."""
_HEIGHTS_M, _PRINT_M, _MOST_WAVES = 0.2, 0.1, 8  # shortest half waves of the fields, and most half waves along a side
_MOST_ROWS = 100_000  # more rows than any board has, so that one number can encode column and row


@dataclass(frozen=True, eq=False)
class BoardShape:
    """The true shape of a board.

    Attributes:
        half_m: (2,) half the board's width and height between the outermost features.
        low: (k,) the `BOARD_SHAPE`, then amplitudes of the waves of `fields`, metres: heights, x and y.
        feature: (f, 2) features with estimated positions. place: (f, 3) their further errors, metres.
        fields: fields of heights and of printing errors over the board; None without fields.
        point: (f, 3) positions of the estimated features in the board's file; empty for a shape read from a file.
    """

    half_m: FloatArray
    low: FloatArray
    feature: IntArray
    place: FloatArray
    fields: tuple[SmoothField, SmoothField] | None = None
    point: FloatArray = field(default_factory=partial(np.zeros, (0, 3)))

    @classmethod
    def of(cls, views: Sequence[BoardView], rough: bool) -> "BoardShape":
        """Return the shape of a board as stated in its file, with the features that these views show.

        Args:
            views: views of the board.
            rough: True for a shape without `fields`.
        """
        feature, first = np.unique(np.concatenate([view.feature for view in views]), axis=0, return_index=True)
        point = np.concatenate([view.point for view in views])[first]
        low, high = point[:, :2].min(axis=0), point[:, :2].max(axis=0)
        half = np.maximum(np.abs(point[:, :2]).max(axis=0), 1e-6)
        fields, terms = None, len(BOARD_SHAPE)
        if not rough and np.all(high > low):
            heights, printed = (SmoothField.over(low, high, finest, _MOST_WAVES) for finest in (_HEIGHTS_M, _PRINT_M))
            fields, terms = (heights, printed), terms + len(heights) + 2 * len(printed)
        return cls(half, np.zeros(terms), feature, np.zeros((len(feature), 3)), fields, point)

    def point_of(self, feature: IntArray, nominal: FloatArray) -> FloatArray:
        """Return the true positions (n, 3) of features (n, 2), from the nominal ones (n, 3) in the board's file."""
        rows = self.rows_of(feature)
        own = np.where(rows[:, None] >= 0, self.place[rows], 0.0) if len(self.place) else np.zeros_like(nominal)
        return np.asarray(nominal + self.by_low(nominal) @ self.low + own)

    def rows_of(self, feature: IntArray) -> IntArray:
        """Return the rows (n,) of features (n, 2) among the estimated features; -1 if not there."""
        order = _code(self.feature)
        at = np.minimum(np.searchsorted(order, _code(feature)), len(order) - 1)
        return np.where(order[at] == _code(feature), at, -1) if len(order) else np.full(len(feature), -1)

    def by_low(self, nominal: FloatArray) -> FloatArray:
        """Return the derivative (n, 3, k) of true positions by `low`."""
        x, y = (nominal[:, :2] / self.half_m).T
        result = np.zeros((len(nominal), 3, len(self.low)))
        result[:, 2, 0], result[:, 2, 1], result[:, 2, 2] = 1.0 - x**2, 1.0 - y**2, x * y
        result[:, 0, 3], result[:, 1, 4] = nominal[:, 0], nominal[:, 1]
        result[:, 0, 5], result[:, 1, 5] = 0.5 * nominal[:, 1], 0.5 * nominal[:, 0]
        if self.fields is not None:
            height, printed = (each.waves(nominal[:, :2]) for each in self.fields)
            along_x = len(BOARD_SHAPE) + height.shape[1]
            along_y = along_x + printed.shape[1]
            result[:, 2, len(BOARD_SHAPE) : along_x] = height
            result[:, 0, along_x:along_y] = result[:, 1, along_y:] = printed
        return result

    @cached_property
    def by_feature(self) -> FloatArray:
        """Derivative (3 f, k) of the positions of the estimated features by `low`."""
        return self.by_low(self.point).reshape(-1, len(self.low))


def _code(feature: IntArray) -> IntArray:
    """Return one number (n,) for each (column, row), ordered by column, then row."""
    return np.asarray(feature[:, 0] * _MOST_ROWS + feature[:, 1])
