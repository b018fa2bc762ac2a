"""`--validate`: refits that test the stated errors of a calibration, with a verdict and a table."""

import json
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import Any

from wlr_render import __version__
from wlr_render.calibration.fit_eye import KINDS_BY_PRESCRIPTION, Calibration, KindComparison
from wlr_render.calibration.validation import (
    BANDS,
    LEVEL,
    METHODS,
    NOISE,
    QUARTERS,
    Outcome,
    Ratio,
    Refit,
    ratios,
    refits,
)
from wlr_render.captures.feature_captures import columns_of
from wlr_render.errors import BadInputError
from wlr_render.io.atomic_files import output_folder, write_text
from wlr_render.io.input_files import LIMITS, read_bytes
from wlr_render.io.kept import Kept, recipe_of, sha256_of, signatures_of
from wlr_render.jobs.calibrate.calibrate_options import CalibrateOptions, FitOptions
from wlr_render.report.blocks import Block, Columns, Report, ReportTable, Section, table
from wlr_render.work.progress import Progress
from wlr_render.work.workers import as_finished

_MATTERS = 1.25
"""Ratio from which a report does not believe the stated errors: 25 % decides nothing that users do."""
_DRAWN_WRONG = 0.75
"""Ratio of refits to noise alone below which the arithmetic of the errors is doubted as well."""


@dataclass(frozen=True)
class Validation:
    """Outcome of the refits of one eye.

    Attributes:
        ratios: ratios of found to stated errors.
        refused: number of refits that failed.
        not_made: reason why there are no refits; empty if there are.
    """

    ratios: tuple[Ratio, ...]
    refused: int
    not_made: str = ""

    @property
    def sentence(self) -> str:
        """Verdict: which errors to believe, and how large they are."""
        if self.not_made:
            return f"The stated errors are not validated: {self.not_made}"
        wrong = [each for each in self.ratios if each.method == NOISE and not _is_right(each)]
        if wrong:
            worst = max(wrong, key=lambda each: abs(each.value - 1.0))
            return (
                f"Do not believe the stated errors of the {worst.side}: even refits to noise alone, of the sizes that "
                f"the fit found, differ by {_stated(worst)} times this error. The readings determine too little, or "
                "the fit took outliers or motions for optics; add camera positions."
            )
        larger = [each for each in self.ratios if each.method != NOISE and each.low > 1.0 and each.value > _MATTERS]
        if not larger:
            most = max(each.high for each in self.ratios)
            return (
                f"The refits do not contradict the stated errors: {_listed(self.ratios)}. They do not exclude "
                f"errors of up to {most:.1f} times the stated ones, and no refit shows errors that all camera "
                "positions share, as of the lens, the board or the frame, or a drift that runs along with the "
                "positions."
            )
        worst_of = {side: max((each for each in larger if each.side == side), key=_value) for side in _sides(larger)}
        parts = [
            f"the {each.method} finds {_stated(each)} times the stated error of the {side}: count on "
            f"{each.found_arcmin:.2g}' or more in place of {each.stated_arcmin:.2g}'"
            for side, each in worst_of.items()
        ]
        alone = " and ".join(_stated(each) for each in self.ratios if each.method == NOISE)
        methods = " and ".join(dict.fromkeys(f"the {each.method}" for each in worst_of.values()))
        return (
            f"Believe {methods}, not the stated errors: {'; '.join(parts)}. Refits to noise alone find "
            f"{alone} times the stated errors, so the camera positions share errors that the model lacks, or the "
            "optics are less smooth than it."
        )

    @property
    def table(self) -> ReportTable:
        """Table of stated and found errors of each mapping by each method."""
        columns: Columns = {
            "refits": "method",
            "number": "refits",
            "stated error, rms (arcmin)": "stated_arcmin",
            "found (arcmin)": "found_arcmin",
            "found / stated": "value",
            f"{100 * LEVEL:.0f} % interval": lambda each: f"{each.low:.2f} to {each.high:.2f}",
        }
        notes = [
            f"{NOISE.capitalize()}: fits to readings simulated from the fit, with all errors that it states. They "
            "test the arithmetic of these errors.",
            f"{QUARTERS.capitalize()}: fits without a quarter of the camera positions, chosen at random. Their "
            "expected difference from the fit to all positions is known if the positions' errors are independent.",
            f"{BANDS.capitalize()}: fits without a column or a row of positions, which are neighbours and share more "
            "errors.",
            "The intervals assume that the errors of different camera positions are independent; if positions share "
            "errors, the true errors are larger than those found.",
        ]
        if self.refused:
            notes.append(f"{self.refused} refits had too few positions, and are not counted.")
        return table(
            "Stated against found errors", [(each.side, each) for each in self.ratios], columns, notes, name="mapping"
        )

    @property
    def record(self) -> list[dict[str, Any]]:
        """The ratios as JSON."""
        return [asdict(each) | {"found_arcmin": each.found_arcmin} for each in self.ratios]


def _is_right(noise: Ratio) -> bool:
    return noise.high > _DRAWN_WRONG and noise.low < _MATTERS


def _value(ratio: Ratio) -> float:
    return ratio.value


def _sides(found: Sequence[Ratio]) -> list[str]:
    return list(dict.fromkeys(each.side for each in found))


def _stated(ratio: Ratio) -> str:
    return f"{ratio.value:.2f} ({ratio.low:.2f} to {ratio.high:.2f})"


def _listed(found: Sequence[Ratio]) -> str:
    parts = []
    for method in METHODS:
        values = [f"{each.value:.2f} ({each.side})" for each in found if each.method == method]
        parts += [f"{method} {', '.join(values)}"] if values else []
    return f"found over stated, more than 1 where the stated error is too small, is by {'; by '.join(parts)}"


def validated(
    comparison: KindComparison, options: CalibrateOptions, folder: Path, progress: Progress
) -> Validation | None:
    """Refit for `--validate`, and write each outcome into a subfolder of `folder` as soon as it is known.

    A rerun after an interruption continues with the missing refits.

    Returns:
        None without `--validate`. If the fit has left out so many camera positions that refits cannot test it, the
        result has no ratios: the calibration and its report are worth keeping.

    Raises:
        BadInputError: files cannot be written.
    """
    if not options.validate:
        return None
    fit = comparison.chosen
    try:
        tasks = [_Task(each, _as_chosen(options.fit, comparison)) for each in refits(fit)]
    except BadInputError as error:
        return Validation((), 0, str(error))
    own = output_folder(folder / f"validate-{fit.mappings.eye}")
    recipe = recipe_of("validate", {"fit": repr(tasks[0].options), "version": __version__}, {"captures": _hash(fit)})
    finished = Kept(own, recipe, replaces=True)
    files = {each.name: own / f"{each.name}.json" for each in tasks}
    missing = set(finished.unfinished(files.values()))
    waiting = [each for each in tasks if files[each.name] in missing]
    for name, outcome in progress(as_finished(_refitted, waiting, options.worker_pool, own), len(waiting), "refits"):
        write_text(files[name], json.dumps({"refused": True} if outcome is None else asdict(outcome)) + "\n")
        finished.add(signatures_of([files[name]]))
    finished.remove_replaced()
    known = [json.loads(read_bytes(path, LIMITS.record_bytes)) for path in files.values()]
    outcomes = [Outcome(**each) for each in known if "refused" not in each]
    return Validation(tuple(ratios(fit, outcomes)), len(known) - len(outcomes))


def _as_chosen(options: FitOptions, comparison: KindComparison) -> FitOptions:
    """Return the options for fitting only the chosen kind of model."""
    kind: Any = comparison.best  # a `kind` of `FitOptions`
    return replace(options, kind=kind, prescription=options.prescription if kind in KINDS_BY_PRESCRIPTION else None)


def _hash(fit: Calibration) -> str:
    """Return the hash of all fitted data."""
    parts = [side.captures for side in fit.sides.values()]
    columns = [getattr(part, name).tobytes() for part in parts for name in columns_of(type(part))]
    known = [repr((part.motion, part.common)).encode() for part in parts]
    return sha256_of(b"".join([*columns, *known]))


@dataclass(frozen=True, eq=False)
class _Task:
    refit: Refit
    options: FitOptions

    @property
    def name(self) -> str:
        return f"{self.refit.method.replace(' ', '-')}-{self.refit.number:02d}"


def _refitted(task: _Task) -> tuple[str, Outcome | None]:
    """Run one refit and return its outcome; None if the readings do not determine a model."""
    try:
        return task.name, task.refit.outcome(task.options.fit(task.refit.captures).chosen)
    except BadInputError:
        return task.name, None


def with_validations(report: Report, found: Mapping[str, Validation | None]) -> Report:
    """Return the report of a calibration with the validation of each eye at the start of its verdict."""
    known = {eye: each for eye, each in found.items() if each is not None}
    if not known:
        return report
    sentences = [
        f"{eye.capitalize()} eye: {each.sentence}" if len(known) > 1 else each.sentence for eye, each in known.items()
    ]
    tables: list[Block] = [
        replace(each.table, title=f"{each.table.title}, {eye} eye") if len(known) > 1 else each.table
        for eye, each in known.items()
        if not each.not_made
    ]
    record = {**report.record, "validation": {eye: each.record for eye, each in known.items()}}
    verdict = " ".join([*sentences, report.verdict])
    section = [Section("Validation"), *tables] if tables else []
    return replace(report, verdict=verdict, blocks=[*section, *report.blocks], record=record)
