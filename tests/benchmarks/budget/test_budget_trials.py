"""The benchmark of budgets: errors of trackers that the budget predicts, tables, kept sessions."""

import numpy as np
import pytest

from benchmarks.budget.study import tables
from benchmarks.budget.trial import (
    CONDITIONS,
    MODEL_ALONE,
    WITH_TRACKERS,
    BudgetOutcome,
    BudgetTrial,
    Coverage,
    judged,
    loaded_outcome,
)
from wlr_render.budget.errors import Truncation
from wlr_render.budget.statement import REGIONS
from wlr_render.geometry import transforms
from wlr_render.jobs.kept_trials import kept_outcome

SMALL = Truncation(1e-3)  # a covariance is never singular


def test_true_errors_of_trackers_are_as_large_as_predicted(flat_image_headset):
    found = [
        part
        for seed in range(60)
        for part in judged(flat_image_headset, flat_image_headset, np.eye(4), SMALL, np.random.default_rng(seed))
    ]
    for region in REGIONS:
        own = [part for part in found if (part.condition, part.region) == (WITH_TRACKERS, region)]
        points = sum(part.points for part in own)
        assert 0.60 < sum(part.inside[0] for part in own) / points < 0.76
        assert 0.92 < sum(part.inside[1] for part in own) / points < 0.98
        assert sum(part.predicted for part in own) / sum(part.true for part in own) == pytest.approx(1.0, abs=0.12)


def test_exact_models_have_no_error_in_their_frame_and_one_in_another(flat_image_headset):
    shifted = transforms.rigid(np.eye(3), np.array([1e-3, 0.0, 0.0]))
    own, other = (
        judged(flat_image_headset, flat_image_headset, frame, SMALL, np.random.default_rng(1))
        for frame in (np.eye(4), shifted)
    )
    assert all(part.true < 1e-12 for part in own if part.condition == MODEL_ALONE)
    assert all(part.true > 1.0 for part in other if part.condition == MODEL_ALONE)


def outcome(number, true):
    parts = [Coverage(name, region, 100, (68, 95), true, 4.0) for name in CONDITIONS for region in REGIONS]
    return BudgetOutcome(BudgetTrial(number), parts, Truncation(0.1, 0.0))


def test_tables_have_coverage_and_ratio():
    refused = BudgetOutcome(BudgetTrial(2), refused="the target moved")
    by_region, by_headset, missing = tables([outcome(0, 1.0), outcome(1, 1.0), refused])
    assert len(by_region.rows) == len(CONDITIONS) * len(REGIONS)
    assert by_region.rows[0][:4] == [MODEL_ALONE, "centre", 2, 68.0]
    assert by_region.rows[0][5] == 95.0
    assert by_region.rows[0][8] == 2.0
    assert [row[1] for row in by_headset.rows] == ["northstar", "freeform40"] * 2
    assert missing.rows == [[2, "birdbath28", "the target moved"]]


def test_a_kept_session_is_read_again(tmp_path):
    made = outcome(4, 1.5)
    kept_outcome(lambda trial, seed: made, loaded_outcome, tmp_path, 1, made.trial)
    again = kept_outcome(lambda trial, seed: pytest.fail("was made again"), loaded_outcome, tmp_path, 1, made.trial)
    assert again == made
