"""Outcomes of trials that are kept: what is run again, what is deleted, seeds apart."""

from dataclasses import dataclass

import pytest

from wlr_render.jobs import kept_trials
from wlr_render.jobs.kept_trials import finished_trials


@dataclass(frozen=True)
class NamedTrial:
    file: str


@dataclass(frozen=True)
class NamedOutcome:
    trial: NamedTrial
    seed: int


TASKS = [NamedTrial("a.json"), NamedTrial("b.json")]


@pytest.fixture
def runs(monkeypatch):
    """Names of the trials that were run, each with its seed; all are run in this process."""
    monkeypatch.setattr(kept_trials, "as_finished", lambda run, tasks, workers: map(run, tasks))
    return []


def finished(runs, folder, seed, resume, tasks=TASKS):
    def run(trial, seed):
        runs.append((trial.file, seed))
        return NamedOutcome(trial, seed)

    def load(trial, content):
        return NamedOutcome(trial, content["seed"])

    return list(finished_trials(run, load, tasks, seed=seed, folder=folder, resume=resume, workers=1))


def test_only_what_is_missing_is_run_again(runs, tmp_path):
    first = finished(runs, tmp_path, 1, resume=False, tasks=TASKS[:1])
    assert finished(runs, tmp_path, 1, resume=True) == [*first, NamedOutcome(TASKS[1], 1)]
    assert runs == [("a.json", 1), ("b.json", 1)]


def test_without_resume_all_is_run_again(runs, tmp_path):
    finished(runs, tmp_path, 1, resume=False)
    finished(runs, tmp_path, 1, resume=False, tasks=TASKS[:1])
    assert runs == [("a.json", 1), ("b.json", 1), ("a.json", 1)]
    assert [path.name for path in tmp_path.rglob("*.json")] == ["a.json"]


def test_outcomes_of_another_seed_are_not_used(runs, tmp_path):
    finished(runs, tmp_path, 1, resume=False)
    assert finished(runs, tmp_path, 2, resume=True) == [NamedOutcome(task, 2) for task in TASKS]
