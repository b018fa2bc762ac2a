"""Outcomes of trials that are kept: what is run again, what is deleted, seeds apart."""

import hashlib
import json
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import pytest
from small_photo_session import in_this_process

from benchmarks import kept_trials
from benchmarks.kept_trials import damaged_outcomes, finished_trials
from wlr_render.work.workers import LOCAL


@dataclass(frozen=True)
class NamedTrial:
    file: str


@dataclass(frozen=True)
class NamedOutcome:
    trial: NamedTrial
    seed: int


TASKS = [NamedTrial("a.json"), NamedTrial("b.json")]


@pytest.fixture
def runs(monkeypatch: pytest.MonkeyPatch) -> list[tuple[str, int]]:
    """Names of the trials that were run, each with its seed; all are run in this process."""
    monkeypatch.setattr(kept_trials, "as_finished", in_this_process)
    return []


def finished(
    runs: list[tuple[str, int]], folder: Path, seed: int, resume: bool, tasks: Sequence[NamedTrial] = TASKS
) -> list[NamedOutcome]:
    def run(trial: NamedTrial, seed: int) -> NamedOutcome:
        runs.append((trial.file, seed))
        return NamedOutcome(trial, seed)

    def load(trial: NamedTrial, content: dict[str, Any]) -> NamedOutcome:
        return NamedOutcome(trial, content["seed"])

    return list(finished_trials(run, load, tasks, seed=seed, folder=folder, resume=resume, workers=LOCAL))


def test_only_what_is_missing_is_run_again(runs: list[tuple[str, int]], tmp_path: Path) -> None:
    first = finished(runs, tmp_path, 1, resume=False, tasks=TASKS[:1])
    assert finished(runs, tmp_path, 1, resume=True) == [*first, NamedOutcome(TASKS[1], 1)]
    assert runs == [("a.json", 1), ("b.json", 1)]


def test_without_resume_all_is_run_again(runs: list[tuple[str, int]], tmp_path: Path) -> None:
    finished(runs, tmp_path, 1, resume=False)
    finished(runs, tmp_path, 1, resume=False, tasks=TASKS[:1])
    assert runs == [("a.json", 1), ("b.json", 1), ("a.json", 1)]
    assert [path.name for path in tmp_path.rglob("*.json")] == ["a.json"]


def test_outcomes_of_another_seed_are_not_used(runs: list[tuple[str, int]], tmp_path: Path) -> None:
    finished(runs, tmp_path, 1, resume=False)
    assert finished(runs, tmp_path, 2, resume=True) == [NamedOutcome(task, 2) for task in TASKS]


@pytest.mark.parametrize(
    "damage",
    [
        lambda text: text[:-9],
        lambda text: text.replace('"seed": 1', '"seed": 7'),
        str.upper,
        lambda text: "[" * 100_000,
        lambda text: json.dumps({"outcome": 1, "sha256": hashlib.sha256(b"1").hexdigest()}),
    ],
)
def test_an_outcome_that_is_not_as_it_was_written_is_run_again_and_named(
    runs: list[tuple[str, int]], tmp_path: Path, damage: Callable[..., Any]
) -> None:
    first = finished(runs, tmp_path, 1, resume=False)
    path = tmp_path / "seed-1" / "b.json"
    assert damaged_outcomes(tmp_path, 1) == []
    path.write_text(damage(path.read_text()))
    assert damaged_outcomes(tmp_path, 1) == [path]
    assert finished(runs, tmp_path, 1, resume=True) == first
    assert runs == [("a.json", 1), ("b.json", 1), ("b.json", 1)]
    assert damaged_outcomes(tmp_path, 1) == []
