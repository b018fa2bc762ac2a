"""Whether a cause has the same value in all halves of the readings, as no spurious match has."""

from collections.abc import Iterable

import numpy as np

from wlr_render.diagnosis.fit import Fit, reduced_chi_squared
from wlr_render.diagnosis.observations import DISPLAY, SEE_THROUGH, Observations
from wlr_render.numerics.arrays import BoolArray, FloatArray

_SPREADS = 4.0  # standard deviations above its mean up to which the square of a change may be noise
_HELD = 1e-2  # of the whole information: a half that determines less of a parameter does not move it


def instability(observations: Observations, found: Fit) -> FloatArray:
    """For each cause of a fit, the largest change of its effect between two halves of the readings, over the effect.

    A spurious match fits one half of the readings with one value and the other half with another. The halves are near
    and far from the image's centre, left and right, top and bottom, of the stage's x and y, and early and late. What
    noise alone may change is taken off. 0 is stable; near 1 and above there is no such cause.
    """
    effect = found.effects
    sized = effect != 0.0
    worst = np.zeros(len(found.explanation.values))
    scale = reduced_chi_squared(found)
    for half in _halves(observations):
        first, second = (_solved(found, rows) for rows in (half, ~half))
        change, covariance = first[0] - second[0], scale * (first[1] + second[1])
        for cause in range(len(worst)):
            mine = sized & (found.owner == cause)
            weight = found.information[np.ix_(mine, mine)]
            noise = weight @ covariance[np.ix_(mine, mine)]
            usual = float(np.trace(noise) + _SPREADS * np.sqrt(2.0 * np.trace(noise @ noise)))
            moved = max(0.0, float(change[mine] @ weight @ change[mine]) - usual)
            size = float(effect[mine] @ weight @ effect[mine])
            worst[cause] = max(worst[cause], float(np.sqrt(moved / size)) if size > 0 else 0.0)
    return worst


def _solved(found: Fit, rows: BoolArray) -> tuple[FloatArray, FloatArray]:
    """Change of the free parameters, and their covariance, by some rows alone; they stay where rows say nothing."""
    jacobian = found.jacobian[rows].reshape(-1, found.at.free.size)
    covariance = np.asarray(np.linalg.inv(jacobian.T @ jacobian + _HELD * found.information))
    return covariance @ (jacobian.T @ found.residual[rows].ravel()), covariance


def _halves(observations: Observations) -> Iterable[BoolArray]:
    """Masks (n,) of one half each, split at the median of every part."""
    plan, readings = observations.session.plan, observations.session.readings
    columns: dict[int, list[FloatArray]] = {}
    centre = observations.nominal.camera.centre_px
    for part, table, pixel in (
        (DISPLAY, plan.display, None if plan.display is None else plan.display.camera_pixel),
        (SEE_THROUGH, plan.see_through, readings.dot_pixel),
    ):
        if table is not None and pixel is not None:
            radius = np.linalg.norm(pixel - centre, axis=1)
            columns[part] = [radius, pixel[:, 0], pixel[:, 1], table.stage[:, 0], table.stage[:, 1], table.time_s]
    for number in range(6 if columns else 0):
        half = np.zeros(len(observations), dtype=bool)
        for part, variables in columns.items():
            half[observations.part == part] = variables[number] > np.median(variables[number])
        yield half
