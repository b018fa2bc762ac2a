"""Identification of wrong points among several measured ones, by evidence."""

import math

import numpy as np

from wlr_render.numerics.arrays import BoolArray, FloatArray


def wrong_pairs(innovation: FloatArray, spread: FloatArray, share: float, scatter: float) -> tuple[BoolArray, float]:
    """Return a mask (n,) of the points, pairs of numbers, that are most likely wrong, and the log evidence.

    The search flags one pair at a time as wrong, or as right again, as long as the evidence increases.

    Args:
        innovation: (2 n,) measured minus expected.
        spread: (2 n, 2 n) covariance of the innovation if no pair is wrong.
        share: prior share of wrong pairs.
        scatter: standard deviation of wrong pairs per axis.
    """
    count = len(innovation) // 2
    wrong = np.zeros(count, dtype=bool)
    log_share = math.log(share / (1.0 - share))
    while True:
        covariance = spread + np.diag(np.repeat(wrong, 2) * scatter**2)
        precision = np.asarray(np.linalg.inv(covariance))
        # Woodbury's identity gives the change of the evidence by another variance of each pair alone.
        added = np.where(wrong, -1.0, 1.0) * scatter**2
        own = precision.reshape(count, 2, count, 2)[np.arange(count), :, np.arange(count)]
        weighed = (precision @ innovation).reshape(count, 2)
        within = np.eye(2) + added[:, None, None] * own
        fit = np.einsum("ni,nij,nj->n", weighed, np.linalg.inv(within) * added[:, None, None], weighed)
        gain = 0.5 * (fit - np.log(np.linalg.det(within))) + log_share * np.sign(added)
        likeliest = int(np.argmax(gain))
        if gain[likeliest] <= 0.0:
            evidence = -0.5 * (innovation @ precision @ innovation + np.linalg.slogdet(covariance)[1])
            return wrong, float(evidence + log_share * wrong.sum())
        wrong = wrong ^ (np.arange(count) == likeliest)
