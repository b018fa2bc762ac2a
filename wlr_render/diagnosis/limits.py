"""The smallest effect of each cause that a session would have shown."""

from collections.abc import Mapping

import numpy as np

from wlr_render.diagnosis.cause import Cause
from wlr_render.diagnosis.diagnosis import DetectionLimit
from wlr_render.diagnosis.extension import Extension, Hypothesis, Predictor
from wlr_render.diagnosis.fit import fit
from wlr_render.numerics.arrays import BoolArray

_SIGMAS = 5.0


def detection_limits(
    thin: Predictor, thin_used: BoolArray, used: BoolArray, causes: Mapping[str, Cause]
) -> tuple[DetectionLimit, ...]:
    """Five standard errors of every parameter, each cause alone; those that a session says nothing of are left out.

    Args:
        thin: predictor of some of the readings; it stands for all of them.
        thin_used, used: which readings count, of those and of all.
        causes: to be considered.
    """
    found = []
    fewer = float(np.sqrt(thin_used.sum() / used.sum()))
    for cause in causes.values():
        hypothesis = Hypothesis(cause, next(iter(cause.variants)))
        start = np.array([0.0 if not np.isfinite(value) else value for value in cause.null()])
        alone = fit(thin, Extension().plus(hypothesis, start), thin_used, 0)
        for parameter, sigma in zip(cause.parameters, alone.sigmas(), strict=True):
            if sigma > 0.0:
                found.append(DetectionLimit(cause.name, parameter.name, parameter.unit, _SIGMAS * fewer * float(sigma)))
    return tuple(found)
