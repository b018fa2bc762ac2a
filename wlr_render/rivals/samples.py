"""Readings as any regressor takes them, and the three structures that it can stand in.

A regressor is a function of the pixel (or view direction) and of a place. The structure says what the place is: nothing
("static"), the viewpoint ("volumetric"), or the point on the base plane where the ray crosses it ("planar", the ray
bundle of the paper's sections 3.3 and 3.4). So each regressor can stand in each structure.
"""

from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from wlr_render.calibration.base_plane import choose_base_plane
from wlr_render.calibration.fit_report import AnyModel
from wlr_render.calibration.model_kinds import Side
from wlr_render.calibration.readings import TREND_ALONE, FitReadings
from wlr_render.captures.correspondences import AnyCaptures
from wlr_render.numerics.arrays import BoolArray, FloatArray, IntArray
from wlr_render.numerics.polynomial import Polynomial, basis, total_degree
from wlr_render.numerics.regressor import Regressor

FOLDS = 5
"""Parts of the camera positions, each of which is left out once to choose hyperparameters."""


@dataclass(frozen=True, eq=False)
class Samples:
    """observed = sum over blocks b of multiplier_b f_b(inputs): one block for a display, A and B for see-through.

    Attributes:
        readings: of the captures, in a structure.
        position: (n,) index of the camera position, 0..positions - 1.
    """

    readings: FitReadings
    position: IntArray

    def __len__(self) -> int:
        return len(self.readings)

    @property
    def outputs(self) -> int:
        """Of the regressor: two for each block."""
        return 2 * self.readings.blocks

    @property
    def is_place(self) -> BoolArray:
        """(variables,) whether an input is of the place."""
        return self.readings.is_place

    @cached_property
    def scaled(self) -> FloatArray:
        """(n, variables) inputs, -1..1."""
        return self.readings.box.scaled(self.readings.inputs)

    @cached_property
    def fold(self) -> IntArray:
        """(n,) fold of each row: whole positions stay together, the rows of a single one are dealt out."""
        positions = int(self.position.max()) + 1
        if positions < FOLDS:
            return np.asarray(np.random.default_rng(0).permutation(len(self)) % FOLDS)
        return np.asarray((np.random.default_rng(0).permutation(positions) % FOLDS)[self.position])

    def design(self, features: FloatArray, rows: slice | IntArray = slice(None)) -> FloatArray:
        """Weighted columns (m, blocks * k) of features (m, k) at some rows."""
        weighted = self.readings.multiplier[rows] * self.readings.weight[rows, None]
        return np.asarray((weighted[:, :, None] * features[:, None]).reshape(len(features), -1))

    def target(self, trend: Regressor | None = None, rows: slice | IntArray = slice(None)) -> FloatArray:
        """Weighted observed values (m, 2) at some rows, less a trend."""
        rest = self.readings.observed
        if trend is not None:
            value = trend(self.readings.inputs).reshape(len(self), self.readings.blocks, 2)
            rest = rest - np.einsum("nb,nbo->no", self.readings.multiplier, value)
        return np.asarray((rest * self.readings.weight[:, None])[rows])

    def by_block(self, coefficients: FloatArray) -> FloatArray:
        """Coefficients (blocks * k, 2) of `design` as (k, outputs)."""
        blocks = self.readings.blocks
        return coefficients.reshape(blocks, -1, 2).transpose(1, 0, 2).reshape(-1, 2 * blocks)

    def by_column(self, coefficients: FloatArray) -> FloatArray:
        """The inverse of `by_block`: (k, outputs) as (blocks * k, 2)."""
        blocks = self.readings.blocks
        return coefficients.reshape(-1, blocks, 2).transpose(1, 0, 2).reshape(-1, 2)

    def polynomial(self, degree: int) -> Polynomial:
        """Least-squares polynomial of a total degree in all inputs."""
        orders = total_degree(len(self.is_place), degree)
        design = self.design(basis(self.readings.inputs, orders, self.readings.box))
        solution = np.linalg.lstsq(design, self.target(), rcond=1e-10)[0]
        return Polynomial(orders, self.readings.box, self.by_block(np.asarray(solution)))


Fit = Callable[[Samples], Regressor]
"""How a regressor is fitted."""


def fit_structure(
    side: Side[AnyCaptures, AnyModel], captures: AnyCaptures, structure: str, fit: Fit
) -> tuple[AnyModel, Regressor]:
    """Fit a regressor in a structure.

    Args:
        side: `fit_display.DISPLAY` or `fit_see_through.SEE_THROUGH`.
        captures: of that side.
        structure: "static", "volumetric" or "planar".
        fit: of the regressor.

    Returns:
        The model, and the regressor that it is made of.

    Raises:
        BadInputError: the regressor cannot use the captures.
    """
    how = side.kinds[structure]
    used = side.nearest(captures) if how.at_one_position else captures
    plane = choose_base_plane(used.viewpoint, used.eye_box)
    side.check(used, structure, plane)
    readings = how.readings(used, plane, TREND_ALONE, None)
    regressor = fit(Samples(readings, np.unique(used.capture, return_inverse=True)[1]))
    return how.model(used, plane, regressor, None), regressor
