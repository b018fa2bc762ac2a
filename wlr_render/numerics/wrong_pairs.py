"""Find which of several measured points are wrong, by the evidence."""

import math

import numpy as np

from wlr_render.numerics.arrays import BoolArray, FloatArray


def wrong_pairs(innovation: FloatArray, spread: FloatArray, share: float, scatter: float) -> tuple[BoolArray, float]:
    """Return which of n points, pairs of numbers, are most likely wrong, (n,), and the logarithm of the evidence.

    One pair after the other is called wrong, or right again, as long as that makes the whole more probable.

    Args:
        innovation: (2 n,) measured less expected. spread: (2 n, 2 n) its covariance if no pair is wrong.
        share: of wrong pairs, before the measurement. scatter: their standard deviation per axis.
    """
    count = len(innovation) // 2
    wrong = np.zeros(count, dtype=bool)
    log_share = math.log(share / (1.0 - share))
    while True:
        covariance = spread + np.diag(np.repeat(wrong, 2) * scatter**2)
        precision = np.asarray(np.linalg.inv(covariance))
        # By Woodbury's identity: what another variance of each click alone does to the evidence.
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
