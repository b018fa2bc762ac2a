"""What is said of a cause that was found: values, evidence, and what it could be mistaken for."""

import numpy as np

from wlr_render.diagnosis import evidence
from wlr_render.diagnosis.diagnosis import FoundCause, Overlap, ParameterValue, Rival
from wlr_render.diagnosis.fit import Fit
from wlr_render.diagnosis.search import Round, Search

_ALIKE = 0.95  # cosine from which two causes are said to overlap
_RIVALS = 8


def found_cause(search: Search, found: Fit, number: int, contest: Round) -> FoundCause:
    """Describe one cause of a fit.

    Args:
        search: what it was found with.
        found: the fit of all causes.
        number: which of them.
        contest: the candidates for its place, the others being at work.
    """
    hypothesis = found.extension.hypotheses[number]
    cause = hypothesis.cause
    first = sum(len(values) for values in found.extension.values[:number])
    # Where more than noise is left, its misfit widens the error bars.
    widened = np.sqrt(max(1.0, evidence.misfit(found)))
    sigmas = widened * found.sigmas()[first : first + len(cause.parameters)]
    values = found.extension.values[number]
    parameters = tuple(
        ParameterValue(parameter.name, float(value), float(sigma), parameter.unit, parameter.plausible)
        for parameter, value, sigma in zip(cause.parameters, values, sigmas, strict=True)
    )
    without = search.full.residual(found.extension.without(number))
    change = (without - found.residual)[found.used]
    return FoundCause(
        cause.name,
        cause.title,
        cause.part,
        hypothesis.variant,
        parameters,
        search.gain(contest.current, found),
        _overlaps(contest, cause.name),
        _rivals(contest),
        float(np.sqrt(np.nanmean(change**2))),
        cause.remedy,
    )


def _overlaps(contest: Round, name: str) -> tuple[Overlap, ...]:
    """Causes whose best imitation of the effect is at a small angle to it.

    To first order a hypothesis at the angle a to the effect gains cos^2 a of what the effect's own cause does.
    """
    gains: dict[str, float] = {}
    separating: dict[str, str] = {}
    for each in contest.prospects:
        cause = each.hypothesis.cause
        gains[cause.name] = max(gains.get(cause.name, 0.0), each.gain)
        separating[cause.name] = cause.separated_by
    own = gains.get(name, 0.0)
    overlaps = [
        Overlap(other, min(1.0, float(np.sqrt(gain / own))), separating[other])
        for other, gain in gains.items()
        if other != name and own > 0 and gain / own > _ALIKE**2
    ]
    return tuple(sorted(overlaps, key=lambda overlap: -overlap.cosine))


def _rivals(contest: Round) -> tuple[Rival, ...]:
    """Those that were fitted, then the best of the others by what they promise to first order."""
    rivals = [Rival(c.hypothesis.cause.name, c.hypothesis.variant, c.misfit, c.behind) for c in contest.candidates]
    named = {rival.name for rival in rivals}
    values = 2 * int(contest.screened.used.sum())
    for each in contest.prospects:
        name = each.hypothesis.cause.name
        if name not in named:
            named.add(name)
            misfit = max(0.0, contest.screened.chi_squared - each.gain) / values
            rivals.append(Rival(name, f"{each.hypothesis.variant}; not fitted, to first order", misfit, np.nan))
    return tuple(rivals[:_RIVALS])
