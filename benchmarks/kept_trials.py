"""Outcomes of trials, each kept in a file as soon as it is finished, so that a long run can be resumed."""

import hashlib
import json
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import asdict
from functools import partial
from pathlib import Path
from typing import Any, Protocol, TypeVar

from wlr_render.errors import BadInputError
from wlr_render.io.atomic_files import output_folder, write_text
from wlr_render.io.input_files import as_bad_input, read_text
from wlr_render.io.toml_files import parse_json
from wlr_render.work.workers import WorkerPool, as_finished


class KeptTrial(Protocol):
    """A trial with a file for its outcome."""

    @property
    def file(self) -> str:
        """Name of the file, unique among trials."""


AnyTrial = TypeVar("AnyTrial", bound=KeptTrial)
Outcome = TypeVar("Outcome")
Run = Callable[[AnyTrial, int], Outcome]
"""Function that runs a trial with a seed and returns a dataclass."""
Load = Callable[[AnyTrial, dict[str, Any]], Outcome]
"""Function that makes the outcome of a trial from the JSON values of its fields."""


_KIND, _REMEDY = "the outcome of a trial", "remove it"


def finished_trials(
    run: Run[AnyTrial, Outcome],
    load: Load[AnyTrial, Outcome],
    tasks: Sequence[AnyTrial],
    *,
    seed: int,
    folder: Path,
    resume: bool,
    workers: WorkerPool,
) -> Iterator[Outcome]:
    """Yield outcomes in the order in which they finish, see `as_finished`; each seed has its own folder.

    Args:
        run, load: functions for one trial, at module level, because they are passed between processes.
        tasks: the trials.
        seed: seed of all trials.
        folder: folder of the outcomes.
        resume: use existing outcomes instead of deleting them.
        workers: processes that run the trials.
    """
    own = outcome_folder(folder, seed, resume)
    return as_finished(partial(kept_outcome, run, load, own, seed), tasks, workers, own)


def outcome_folder(folder: Path, seed: int, resume: bool) -> Path:
    """Return the folder of the outcomes of a seed; existing outcomes are deleted unless a run is resumed."""
    own = output_folder(folder / f"seed-{seed}")
    if not resume:
        for path in own.glob("*.json"):
            path.unlink()
    return own


def kept_outcome(
    run: Run[AnyTrial, Outcome], load: Load[AnyTrial, Outcome], folder: Path, seed: int, trial: AnyTrial
) -> Outcome:
    """Return the outcome from the folder; if it is missing, run the trial and save its outcome."""
    path = folder / trial.file
    kept = _read(path)
    if kept is not None:
        with as_bad_input(path, _KIND, _REMEDY):
            return load(trial, kept)
    outcome = run(trial, seed)
    content: Mapping[str, Any] = asdict(outcome)  # type: ignore[call-overload]  # a type variable cannot be a dataclass
    write_text(path, json.dumps({"sha256": _sha256(content), "outcome": content}, indent=1))
    return outcome


def damaged_outcomes(folder: Path, seed: int) -> list[Path]:
    """Return the files of a seed that were changed or damaged; their trials are run again."""
    return [path for path in sorted((folder / f"seed-{seed}").glob("*.json")) if _read(path) is None]


def _read(path: Path) -> dict[str, Any] | None:
    """Read an outcome; None if the file is missing or damaged."""
    try:
        content = parse_json(path, read_text(path, _KIND), _KIND, _REMEDY)
        with as_bad_input(path, _KIND, _REMEDY):
            outcome = content["outcome"]
            return dict(outcome) if content["sha256"] == _sha256(outcome) else None
    except BadInputError:
        return None


def _sha256(content: object) -> str:
    return hashlib.sha256(json.dumps(content).encode()).hexdigest()
