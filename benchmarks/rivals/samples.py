"""Readings in the form that all regressors take, and the three structures of a regressor.

A regressor is a function of the pixel (or view direction) and of a place. The structure defines the place: nothing
("static"), the viewpoint ("volumetric"), or the point on the base plane where the ray crosses it ("planar", the ray
bundle of the paper's sections 3.3 and 3.4). Each regressor can be fitted in each structure.
"""

from collections.abc import Callable, Iterable
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np

from benchmarks.rivals.numeric_regressor import Regressor
from wlr_render.calibration.fit_report import AnyModel
from wlr_render.calibration.model_kinds import Side, choose_base_plane, nearest_to_centre
from wlr_render.calibration.readings import TREND_ALONE, FitReadings
from wlr_render.captures.correspondences import AnyCaptures
from wlr_render.models.model_place import NOWHERE
from wlr_render.numerics.arrays import BoolArray, FloatArray, IntArray
from wlr_render.numerics.polynomial import Polynomial, basis, term_count, total_degree

FOLDS = 5
"""Number of folds of the camera positions; each fold is left out once to choose hyperparameters."""
_MOST_COLUMNS = 520  # most columns of a polynomial's equations: degree 5 or 6 in five variables, 6 to 8 in four

Solutions = Callable[[FloatArray, FloatArray], Iterable[FloatArray]]
"""Function of design (m, columns) and target (m, outputs); returns solutions (columns, outputs), one per setting."""


@dataclass(frozen=True, eq=False)
class Samples:
    """Readings of sum over blocks b of multiplier_b f_b(inputs): one block for a display, A and B for see-through.

    Attributes:
        readings: readings of the captures, in a structure.
        position: (n,) index of the camera position, 0..positions - 1.
    """

    readings: FitReadings
    position: IntArray

    def __len__(self) -> int:
        return len(self.readings)

    @property
    def outputs(self) -> int:
        """Number of outputs of the regressor: two for each block."""
        return 2 * self.readings.blocks

    @property
    def is_place(self) -> BoolArray:
        """(variables,) whether an input belongs to the place."""
        return self.readings.is_place

    @cached_property
    def scaled(self) -> FloatArray:
        """Inputs (n, variables) scaled to -1..1."""
        return self.readings.box.scaled(self.readings.inputs)

    @cached_property
    def fold(self) -> IntArray:
        """(n,) fold of each row: the rows of a position stay together, unless there are too few positions."""
        positions = int(self.position.max()) + 1
        if positions < FOLDS:
            return np.asarray(np.random.default_rng(0).permutation(len(self)) % FOLDS)
        return np.asarray((np.random.default_rng(0).permutation(positions) % FOLDS)[self.position])

    def design(self, features: FloatArray, rows: slice | IntArray = slice(None)) -> FloatArray:
        """Return weighted columns (m, blocks * k) of features (m, k) at some rows."""
        weighted = self.readings.multiplier[rows] * self.readings.weight[rows, None]
        return np.asarray((weighted[:, :, None] * features[:, None]).reshape(len(features), -1))

    def target(self, trend: Regressor | None = None, rows: slice | IntArray = slice(None)) -> FloatArray:
        """Return weighted observed values (m, 2) at some rows, less a trend."""
        rest = self.readings.observed
        if trend is not None:
            value = trend(self.readings.inputs).reshape(len(self), self.readings.blocks, 2)
            rest = rest - np.einsum("nb,nbo->no", self.readings.multiplier, value)
        return np.asarray((rest * self.readings.weight[:, None])[rows])

    def by_block(self, coefficients: FloatArray) -> FloatArray:
        """Return coefficients (blocks * k, 2) of `design` as (k, outputs)."""
        blocks = self.readings.blocks
        return coefficients.reshape(blocks, -1, 2).transpose(1, 0, 2).reshape(-1, 2 * blocks)

    def by_column(self, coefficients: FloatArray) -> FloatArray:
        """Invert `by_block`: return (k, outputs) as (blocks * k, 2)."""
        blocks = self.readings.blocks
        return coefficients.reshape(-1, blocks, 2).transpose(1, 0, 2).reshape(-1, 2)

    def solve(
        self, features: FloatArray, rows: slice | IntArray = slice(None), trend: Regressor | None = None
    ) -> FloatArray:
        """Fit coefficients (k, outputs) of features (m, k) to a trend's residual at some rows, by least squares."""
        return self.by_block(least_squares(self.design(features, rows), self.target(trend, rows)))

    def polynomial(self, degree: int | None = None, trend: Regressor | None = None) -> Polynomial:
        """Fit a polynomial in all inputs, of a total degree, to the residual of a trend by least squares.

        `trend` may be any function of the same inputs. By default, the smallest error at left-out camera positions
        chooses the degree.
        """
        if degree is None:
            degree = self._held_out_degree(trend)
        orders, box = total_degree(len(self.is_place), degree), self.readings.box
        return Polynomial(orders, box, self.solve(basis(self.readings.inputs, orders, box), trend=trend))

    def held_out_errors(
        self, features: FloatArray, target: FloatArray, solutions: Solutions, rows: IntArray
    ) -> FloatArray:
        """Return the sums of squared residuals (settings,) of solutions at left-out camera positions.

        Args:
            features: (m, k).
            target: (m, 2), weighted.
            solutions: function that fits the other folds in each setting, given their design and target in triangular
                form.
            rows: (m,) rows of the samples.
        """
        folds = [self.fold[rows] == number for number in range(FOLDS)]
        # A fold's sums of squares need only the products of its columns.
        roots = [_root(np.hstack([self.design(features[here], rows[here]), target[here]])) for here in folds]
        error: FloatArray = np.zeros(1)
        for number, out in enumerate(roots):
            others = np.hsplit(_root(np.vstack(roots[:number] + roots[number + 1 :])), [-2])
            design, wanted = np.hsplit(out, [-2])
            error = error + [np.sum((design @ each - wanted) ** 2) for each in solutions(*others)]
        return error

    def _held_out_degree(self, trend: Regressor | None) -> int:
        """Return the total degree of the polynomial with the least error at held-out camera positions."""
        variables, blocks = len(self.is_place), self.readings.blocks
        most = 1
        while blocks * term_count(variables, most + 1) <= min(_MOST_COLUMNS, 0.8 * len(self)):
            most += 1
        orders = total_degree(variables, most)

        def solutions(design: FloatArray, target: FloatArray) -> Iterable[FloatArray]:
            for degree in range(most + 1):
                used = np.tile(orders.sum(axis=1) <= degree, blocks)
                solution = np.zeros((design.shape[1], target.shape[1]))
                solution[used] = least_squares(design[:, used], target)
                yield solution

        phi = basis(self.readings.inputs, orders, self.readings.box)
        return int(np.argmin(self.held_out_errors(phi, self.target(trend), solutions, np.arange(len(self)))))


def least_squares(design: FloatArray, target: FloatArray) -> FloatArray:
    """Return the least-squares solution (columns, outputs) of a design (m, columns) and target (m, outputs).

    It is the minimum-norm solution if the rows do not determine it.
    """
    return np.asarray(np.linalg.lstsq(design, target, rcond=1e-10)[0], np.float64)


def _root(rows: FloatArray) -> FloatArray:
    """Return the upper triangular matrix with the same products of columns."""
    return np.asarray(np.linalg.qr(rows, mode="r"))


Fit = Callable[[Samples], Regressor]
"""Function that fits a regressor."""


def fit_structure(
    side: Side[AnyCaptures, AnyModel], captures: AnyCaptures, structure: str, fit: Fit
) -> tuple[AnyModel, Regressor]:
    """Fit a regressor in a structure.

    Args:
        side: `fit_display.DISPLAY` or `fit_see_through.SEE_THROUGH`.
        captures: captures of that side.
        structure: "static", "volumetric" or "planar".
        fit: function that fits the regressor.

    Returns:
        The model, and its regressor.

    Raises:
        BadInputError: the regressor cannot use the captures.
    """
    how = side.kinds[structure]
    used = nearest_to_centre(captures) if how.place is NOWHERE else captures
    plane = choose_base_plane(used.viewpoint, used.eye_box)
    side.check(used, structure, plane)
    place = how.place or plane
    readings = how.readings(used, place, TREND_ALONE, None)
    regressor: Any = fit(Samples(readings, np.unique(used.capture, return_inverse=True)[1]))
    return how.model(used, place, regressor, None), regressor
