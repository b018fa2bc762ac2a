"""What an experiment of the sampling study is, and what it may be told."""

from collections.abc import Callable, Hashable, Mapping, Sequence
from dataclasses import dataclass, field

import numpy as np

from wlr_render.jobs.evaluate.trials import DisplayTrial, Measure, NoModelTrial, Outcome, SeeThroughTrial
from wlr_render.report.blocks import ReportTable

AnyTrial = DisplayTrial | SeeThroughTrial | NoModelTrial
Key = tuple[Hashable, ...]
"""Names a cell of an experiment: device first, then what the experiment varies."""


@dataclass(frozen=True)
class StudyOptions:
    """How much to compute.

    Attributes:
        devices: shipped names or paths of device files.
        experiments: their names in `sampling_study.EXPERIMENTS`; empty for all.
        degrees: total degrees of the dense comparison.
        repeats: how often a trial with random errors is repeated.
        seed: of all random numbers.
        workers: processes, or None for one per usable core; results do not depend on it.
    """

    devices: tuple[str, ...] = ("northstar", "freeform40", "birdbath28")
    experiments: tuple[str, ...] = ()
    degrees: tuple[int, ...] = (3, 4, 5)
    repeats: int = 3
    seed: int = 0
    workers: int | None = None


@dataclass(frozen=True)
class Line:
    """One line of a plot; NaN leaves a gap."""

    label: str
    x: Sequence[float]
    y: Sequence[float]


@dataclass(frozen=True)
class Plot:
    """Lines over a linear x and a logarithmic y.

    Attributes:
        name: file name without its suffix.
        title, x_label, y_label: with units.
        lines: what is drawn.
    """

    name: str
    title: str
    x_label: str
    y_label: str
    lines: tuple[Line, ...]


@dataclass(frozen=True)
class Findings:
    """What an experiment found."""

    tables: tuple[ReportTable, ...]
    plots: tuple[Plot, ...] = field(default_factory=tuple)


@dataclass(frozen=True)
class Experiment:
    """One question put to the mappings.

    Attributes:
        name: to select it by.
        cells: the trials that it needs, by key.
        findings: tables and plots from their outcomes, by the same keys.
    """

    name: str
    cells: Callable[[StudyOptions], Mapping[Key, AnyTrial]]
    findings: Callable[[StudyOptions, Mapping[Key, Outcome]], Findings]


def pooled(outcomes: Sequence[Outcome], measure: Measure) -> float:
    """Root mean square over repetitions of equal size."""
    return float(np.sqrt(np.mean([outcome.rms(measure) ** 2 for outcome in outcomes])))


def repetitions(options: StudyOptions, error: float) -> range:
    """Numbers of the repetitions of a trial with a random error of some size; without one, a single trial tells all."""
    return range(options.repeats if error > 0 else 1)


def spread_note(groups: Sequence[Sequence[Outcome]], measure: Measure) -> str:
    """How much repetitions differ, in words."""
    repeated = [[outcome.rms(measure) for outcome in group] for group in groups if len(group) > 1]
    if not repeated:
        return "Random errors were drawn once: raise the number of repetitions to see the spread."
    worst = max(np.std(values, ddof=1) / np.mean(values) for values in repeated)
    return f"Over {len(repeated[0])} repetitions each rms varies by at most {100 * worst:.2g} % (standard deviation)."
