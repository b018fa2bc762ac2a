"""What speaks for an extension: chi-squared, what its parameters cost, and whether its values are physical."""

import numpy as np
from numpy.typing import NDArray
from scipy.special import chdtrc

from wlr_render.diagnosis.cause import Role
from wlr_render.diagnosis.fit import Fit

_SANE = 20.0  # times the plausible size: beyond it another explanation is wanted
_WHOLE_CHOICES = 5  # multiples of a whole step that are as likely as each other


def misfit(found: Fit) -> float:
    """Mean square of the used residuals per degree of freedom: 1 at the noise floor."""
    return float(found.chi_squared / max(1, 2 * int(found.used.sum()) - found.at.free.size))


def cost(found: Fit) -> float:
    """-2 log of the extension's marginal likelihood, up to a constant: lower is better.

    Laplace's approximation with a normal prior of the plausible size for every parameter (D. MacKay, "Information
    Theory, Inference, and Learning Algorithms", 2003, chapter 28): a parameter that could have been anything pays for
    having been tuned. A cause whose values are multiples of a whole step pays for the choice of the multiple only.

    What an extension leaves above the noise counts as noise of unknown size in each part of the session by itself. So
    an extension that explains one part wholly is worth more than one that explains a little of both.
    """
    likelihood = 0.0
    for count, squares in found.by_part:
        variance = max(1.0, squares / count)
        likelihood += count * np.log(variance) + squares / variance
    values, parameters = found.extension.vector(), found.extension.parameters()
    plausible = np.array([parameter.plausible for parameter in parameters])
    information = np.linalg.inv(found.covariance)
    whole, off_step = _whole_steps(found)
    free = ~whole[found.at.free]
    sizes = (values / plausible)[found.at.free][free]
    _, log_determinant = np.linalg.slogdet(information[np.ix_(free, free)] + np.eye(int(free.sum())))
    choices = 2.0 * np.log(_WHOLE_CHOICES) * int(whole.sum())
    return float(likelihood + sizes @ sizes + log_determinant + off_step + choices)


def _whole_steps(found: Fit) -> tuple[NDArray[np.bool_], float]:
    """Which parameters move in whole steps (p,), and the chi-squared of rounding them."""
    whole, off_step, first = np.zeros(len(found.extension.vector()), dtype=bool), 0.0, 0
    for hypothesis, values in zip(found.extension.hypotheses, found.extension.values, strict=True):
        step, rows = hypothesis.cause.whole_steps, np.arange(first, first + len(values))
        first += len(values)
        if step is None:
            continue
        whole[rows] = True
        plausible = np.array([parameter.plausible for parameter in hypothesis.cause.parameters])
        off = (values - step * np.round(values / step)) / plausible
        places = np.flatnonzero(np.isin(found.at.free, rows))
        covariance = found.covariance[np.ix_(places, places)]
        off_step += float(
            off[found.at.free[places] - rows[0]] @ np.linalg.solve(covariance, off[found.at.free[places] - rows[0]])
        )
    return whole, off_step


def physical(found: Fit) -> bool:
    """Whether all values can be: above the lowest that are physical, to three standard errors, and of a sane size."""
    parameters, values = found.extension.parameters(), found.extension.vector()
    lowest = np.array([parameter.lowest for parameter in parameters])
    sizes = np.array([parameter.role is Role.SIZE for parameter in parameters])
    plausible = np.array([parameter.plausible for parameter in parameters])
    sane = np.abs(values[sizes]) <= _SANE * plausible[sizes]
    return bool(np.all(values >= lowest - 3.0 * found.sigmas()) and np.all(sane))


def condition(found: Fit) -> float:
    """Condition number of the correlations between the fitted values: 1 where each is known by itself."""
    sigma = np.sqrt(np.diag(found.covariance))
    return float(np.linalg.cond(found.covariance / sigma / sigma[:, None])) if len(sigma) else 1.0


def chance(gain: float, parameters: int, tries: int) -> float:
    """Probability that the best of `tries` causes of no effect gains so much chi-squared with so many parameters."""
    return float(min(1.0, tries * chdtrc(parameters, max(gain, 0.0))))
