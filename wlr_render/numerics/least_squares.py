"""Linear least squares, column-scaled and rank-checked."""

from dataclasses import dataclass

import numpy as np

from wlr_render.numerics.arrays import FloatArray


class RankDeficientError(ValueError):
    """The design does not determine all coefficients; `rank` of `columns` are determined."""

    def __init__(self, rank: int, columns: int) -> None:
        super().__init__(f"the design matrix has rank {rank} of {columns}")
        self.rank = rank
        self.columns = columns


@dataclass(frozen=True)
class Solution:
    """Result of `solve`.

    Attributes:
        coefficients: (columns, outputs).
        condition: condition number of the scaled design.
        residual: (rows, outputs) observed minus fitted.
    """

    coefficients: FloatArray
    condition: float
    residual: FloatArray


def solve(design: FloatArray, observed: FloatArray, tolerance: float = 1e-9) -> Solution:
    """Minimise |observed - design @ c|^2.

    Args:
        design: (rows, columns).
        observed: (rows, outputs).
        tolerance: singular values below this fraction of the largest count as zero.

    Raises:
        RankDeficientError: fewer independent rows than columns. A minimum-norm solution is never returned, because
            it would be wrong between the samples.
    """
    rows, columns = design.shape
    if rows < columns:
        raise RankDeficientError(rows, columns)
    scale = np.linalg.norm(design, axis=0)
    scale = np.where(scale > 0, scale, 1.0)
    # R of a QR has the design's singular values at a fraction of the cost of an SVD of all rows.
    q, r = np.linalg.qr(design / scale)
    u, singular, vt = np.linalg.svd(r)
    rank = int(np.sum(singular > tolerance * singular[0]))
    if rank < columns:
        raise RankDeficientError(rank, columns)
    coefficients = (vt.T @ ((u.T @ (q.T @ observed)) / singular[:, None])) / scale[:, None]
    return Solution(coefficients, float(singular[0] / singular[-1]), observed - design @ coefficients)
