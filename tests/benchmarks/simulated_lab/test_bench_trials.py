"""The benchmark of simulated benches: errors over sigmas, which sentences name a fault, tables."""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
import pytest

from benchmarks.simulated_lab import bench_trial
from benchmarks.simulated_lab.bench_sigmas import SquaredErrors
from benchmarks.simulated_lab.bench_tables import bench_tables
from benchmarks.simulated_lab.bench_trial import BenchOutcome, BenchTrial, BenchTrialKind, FailedCheck

_EXCHANGED = BenchTrial(BenchTrialKind.BARE_EXCHANGED, 0)


def test_errors_drawn_from_a_covariance_are_one_sigma_and_a_wrong_covariance_shows() -> None:
    rng = np.random.default_rng(1)
    root = rng.normal(size=(400, 400)) * np.geomspace(1.0, 1e-2, 400)[:, None]
    error = root @ rng.normal(size=400)
    right, small = (SquaredErrors.of(error, factor * root @ root.T) for factor in (1.0, 0.25))
    assert right.joint == pytest.approx(1.0, abs=0.25)
    assert small.mean_square == pytest.approx(4.0 * right.mean_square)
    assert small.joint == pytest.approx(4.0 * right.joint)


@pytest.mark.parametrize(
    ("sentences", "named", "alone"),
    [
        ([], False, False),
        (["the readings of a and b look exchanged"], True, True),
        (["a lies elsewhere", "b lies elsewhere"], True, True),
        (["a lies elsewhere"], False, False),
        (["the readings of a and b look exchanged", "the stage is loose"], True, False),
    ],
)
def test_a_fault_is_named_where_the_sentences_have_all_its_words(
    sentences: Sequence[str], named: bool, alone: bool
) -> None:
    said = [FailedCheck("step", "quantity", sentence) for sentence in sentences]
    outcome = bench_trial._judged(BenchOutcome(_EXCHANGED), said, (("a ",), ("b ",)))
    assert outcome.named == named
    assert (outcome.named and outcome.first) == alone


def test_tables_count_sessions_and_take_the_rms_over_them() -> None:
    clean = [
        BenchOutcome(BenchTrial(BenchTrialKind.CLEAN, number), sigmas={"shape": SquaredErrors(square, 1.0)})
        for number, square in enumerate((1.0, 7.0))
    ]
    alarmed = replace(clean[1], failed=[FailedCheck("board", "shape", "is bent", True)])
    unnamed = BenchOutcome(_EXCHANGED, "a and b, 3 mm")
    tables = {table.title: table.text_rows() for table in bench_tables([clean[0], alarmed, unnamed])}
    accepted = tables["Sessions without faults"]
    assert [row[:4] for row in accepted][-1] == ["all", "2", "1", "1"]
    assert tables["Errors over stated sigmas, 2 sessions"][0][:2] == ["shape", "2"]
    assert tables["One thing wrong"][-1][:3] == ["all", "1", "0"]
    assert tables["Faults that were not named, or not alone"][0][1:] == ["a and b, 3 mm", "no", "nothing"]
