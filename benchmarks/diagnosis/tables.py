"""Tables of the outcomes of many trials."""

from collections import Counter
from collections.abc import Callable, Iterable, Sequence

import numpy as np

from benchmarks.diagnosis.trial import DiagnosisOutcome, TrialKind
from benchmarks.intervals import INTERVAL, interval_percent
from wlr_render.diagnosis.diagnosis import NO_EFFECT, UNEXPLAINED
from wlr_render.report.blocks import Cell, ReportTable

_FIVE_SIGMA = 25.0  # chi-squared
_AT_FLOOR = 1.03


def tables(outcomes: Sequence[DiagnosisOutcome]) -> list[ReportTable]:
    """Figures, confusion, estimates, unlisted effects, faults; those of what has not been tried are left out."""
    made = (_figures(outcomes), _confusion(outcomes), _estimates(outcomes), _unlisted(outcomes), _faults(outcomes))
    return [table for table in made if table.rows]


def _of(outcomes: Sequence[DiagnosisOutcome], *kinds: TrialKind) -> list[DiagnosisOutcome]:
    return [outcome for outcome in outcomes if outcome.trial.kind in kinds]


def _strong(outcomes: Sequence[DiagnosisOutcome]) -> list[DiagnosisOutcome]:
    """Trials in which every hidden cause leaves 5 sigma that no other single cause explains."""
    return [outcome for outcome in outcomes if min(outcome.remainder) > _FIVE_SIGMA]


def _right(outcome: DiagnosisOutcome) -> bool:
    """Whether the hidden cause is the first that was named."""
    return outcome.first == outcome.trial.effects[0]


def _percent(truths: Iterable[bool]) -> float:
    return 100.0 * float(np.mean(list(truths)))


def _mean_square(values: Sequence[float]) -> float:
    return float(np.mean(np.square(values)))


def _covered(deviations: Sequence[float]) -> float:
    return _percent(abs(each) <= 1.0 for each in deviations)


def _median(values: Sequence[float]) -> float:
    return float(np.median(values))


def _deviations(outcomes: Sequence[DiagnosisOutcome]) -> list[float]:
    return [each for outcome in outcomes for each in outcome.deviations]


def _figures(outcomes: Sequence[DiagnosisOutcome]) -> ReportTable:
    one, two, moved = (_of(outcomes, kind) for kind in (TrialKind.ONE, TrialKind.TWO, TrialKind.MOVED))
    clean, unlisted = _of(outcomes, TrialKind.CLEAN, TrialKind.CLEAN_RUN_TIME), _of(outcomes, TrialKind.UNLISTED)
    held_out = [outcome.held_out for outcome in one if outcome.exact]
    deviations = _deviations(outcomes)
    figures: list[tuple[str, Sequence[DiagnosisOutcome] | Sequence[float], Callable[..., float], str | None]] = [
        ("right cause first, where 5 sigma remain (%)", _strong(one), _share(_right), ">= 95"),
        ("right cause first, in all trials (%)", one, _share(_right), None),
        ("right cause and no other, where 5 sigma remain (%)", _strong(one), _share(_exact), None),
        ("false alarms in clean sessions (%)", clean, _share(lambda o: o.verdict != NO_EFFECT), "<= 2"),
        ("68 % intervals cover (%)", deviations, _covered, "60 to 76"),
        ("variance of estimates over the Cramer-Rao bound", deviations, _mean_square, "<= 1.3"),
        ("held-out residual over the noise, median", held_out, _median, "<= 1.03"),
        ("held-out residual within 3 % of the noise (%)", held_out, _at_floor, None),
        ("both of two causes and no other, where 5 sigma remain (%)", _strong(two), _share(_exact), None),
        ("capture that moved excluded (%)", moved, _share(lambda o: o.moved[0] in o.excluded), None),
        ("sessions where another was excluded (%)", outcomes, _share(lambda o: bool(_wrongly(o))), None),
        ("effects that no cause stands for: unexplained (%)", unlisted, _share(_admitted), None),
        ("seconds for a diagnosis, median", [o.seconds for o in outcomes], _median, None),
    ]
    rows: list[list[Cell]] = []
    for text, each, found, goal in figures:
        if each:
            value = found(each)
            interval = _interval(value, len(each)) if text.endswith("(%)") else None  # all percentages are shares
            rows.append([text, value, len(each), interval, goal])
    columns = ("figure", "value", "of", INTERVAL, "goal")
    return ReportTable("Diagnoses where the truth is known", columns, rows, _NOTES)


def _interval(percent: float, total: int) -> str:
    return interval_percent(round(percent * total / 100), total)


_NOTES = (
    "5 sigma remain: the best other single cause in the place of a hidden one leaves a chi-squared larger by 25.",
    "Intervals and variance: parameters of the hidden causes, where exactly those were named.",
    "Held out: a second session on the same bench, predicted by the corrected one.",
)


def _share(holds: Callable[[DiagnosisOutcome], bool]) -> Callable[[Sequence[DiagnosisOutcome]], float]:
    return lambda outcomes: _percent(holds(outcome) for outcome in outcomes)


def _exact(outcome: DiagnosisOutcome) -> bool:
    return outcome.exact


def _at_floor(held_out: Sequence[float]) -> float:
    return _percent(each <= _AT_FLOOR for each in held_out)


def _admitted(outcome: DiagnosisOutcome) -> bool:
    return outcome.verdict == UNEXPLAINED


def _wrongly(outcome: DiagnosisOutcome) -> set[str]:
    """Excluded captures that did not move."""
    return set(outcome.excluded) - set(outcome.moved)


def _confusion(outcomes: Sequence[DiagnosisOutcome]) -> ReportTable:
    """The confusion matrix, without its zeros."""
    rows: list[list[Cell]] = []
    for name, mine in _by_effect(_of(outcomes, TrialKind.ONE)).items():
        strong = _strong(mine)
        right = _percent(map(_right, strong)) if strong else None
        interval = None if right is None else _interval(right, len(strong))
        rows.append([name, _counted(outcome.first for outcome in mine), _size(mine), len(strong), right, interval])
    for kind in (TrialKind.CLEAN, TrialKind.CLEAN_RUN_TIME):
        if mine := _of(outcomes, kind):
            rows.append([kind.value, _counted(outcome.first for outcome in mine), _size(mine), None, None, None])
    columns = ("hidden", "named first (trials)", "size over noise", "5 sigma remain", "of these right (%)", INTERVAL)
    return ReportTable("Confusion: what was hidden, and what was named first", columns, rows, (_SIZE_NOTE,))


_SIZE_NOTE = "Size over noise: median rms change of the readings, in units of their noise."


def _estimates(outcomes: Sequence[DiagnosisOutcome]) -> ReportTable:
    rows: list[list[Cell]] = []
    for name, mine in _by_effect(_of(outcomes, TrialKind.ONE)).items():
        deviations = _deviations(mine)
        if deviations:
            held_out = _median([outcome.held_out for outcome in mine if outcome.exact])
            covered = _covered(deviations)
            interval = _interval(covered, len(deviations))
            rows.append([name, len(deviations), covered, interval, _mean_square(deviations), held_out])
    columns = ("cause", "estimates", "68 % intervals cover (%)", INTERVAL, "variance / bound", "held-out / noise")
    return ReportTable("Parameters", columns, rows)


def _unlisted(outcomes: Sequence[DiagnosisOutcome]) -> ReportTable:
    rows: list[list[Cell]] = [
        [
            name,
            _counted(outcome.verdict for outcome in mine),
            _counted(outcome.depends_on or "-" for outcome in mine),
            _counted(cause for outcome in mine for cause in outcome.named),
            _size(mine),
        ]
        for name, mine in _by_effect(_of(outcomes, TrialKind.UNLISTED)).items()
    ]
    columns = ("effect", "verdict (trials)", "depends on (trials)", "causes named (trials)", "size over noise")
    return ReportTable("Effects that no cause stands for", columns, rows)


def _faults(outcomes: Sequence[DiagnosisOutcome]) -> ReportTable:
    """Trials to be looked into, so that they can be run again."""
    rows: list[list[Cell]] = [
        [
            outcome.trial.kind.value,
            ", ".join(outcome.trial.effects),
            outcome.trial.number,
            outcome.device,
            ", ".join((outcome.verdict, *outcome.named, *_wrongly(outcome))),
        ]
        for outcome in outcomes
        if _faulty(outcome)
    ]
    columns = ("kind", "hidden", "number", "device", "said")
    return ReportTable("Trials that went wrong", columns, rows)


def _faulty(outcome: DiagnosisOutcome) -> bool:
    match outcome.trial.kind:
        case TrialKind.ONE | TrialKind.TWO:
            wrong = min(outcome.remainder) > _FIVE_SIGMA and not outcome.exact
        case TrialKind.MOVED:
            wrong = outcome.moved[0] not in outcome.excluded
        case TrialKind.UNLISTED:
            wrong = not _admitted(outcome)
        case _:
            wrong = outcome.verdict != NO_EFFECT
    return wrong or bool(_wrongly(outcome))


def _by_effect(outcomes: Sequence[DiagnosisOutcome]) -> dict[str, list[DiagnosisOutcome]]:
    groups: dict[str, list[DiagnosisOutcome]] = {}
    for outcome in outcomes:
        groups.setdefault(outcome.trial.effects[0], []).append(outcome)
    return groups


def _size(outcomes: Sequence[DiagnosisOutcome]) -> float:
    return _median([outcome.size for outcome in outcomes])


def _counted(words: Iterable[str]) -> str:
    return ", ".join(f"{word} {count}" for word, count in Counter(words).most_common())
