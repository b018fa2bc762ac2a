"""The benchmark of budgets: errors of trackers that the budget predicts, and tables."""

import numpy as np
import pytest

from benchmarks.budget.study import tables
from benchmarks.budget.trial import (
    CAMERA_FRAME,
    CONDITIONS,
    MODEL_ALONE,
    WITH_TRACKERS,
    BudgetOutcome,
    BudgetTrial,
    Coverage,
    judged,
)
from wlr_render.budget.error_sizes import ErrorSizes, Truncation
from wlr_render.budget.statement import REGIONS
from wlr_render.geometry import transforms
from wlr_render.jobs.budget_options import BudgetOptions
from wlr_render.mappings import Eye
from wlr_render.numerics.arrays import FloatArray

SMALL = Truncation(1e-3)  # a covariance is never singular


TRACKERS = BudgetOptions("device", raster_arcmin=0.0).sizes(0.0, SMALL)


def over_seeds(eye: Eye, condition: str, sizes: ErrorSizes, frame: FloatArray) -> list[Coverage]:
    """Parts of many sessions with the same exact models."""
    found = [judged(condition, eye, eye, frame, sizes, np.random.default_rng(seed)) for seed in range(40)]
    return [part for parts in found for part in parts]


@pytest.mark.parametrize("trackers", ["eye", "head", "eye and head"])
def test_true_errors_of_trackers_are_as_large_as_predicted(flat_image_headset: Eye, trackers: str) -> None:
    own = {name: getattr(TRACKERS, name) for name in ("eye", "head") if name in trackers}
    found = over_seeds(flat_image_headset, WITH_TRACKERS, ErrorSizes(**own, truncation=SMALL), np.eye(4))
    points = sum(part.points for part in found)
    assert 0.60 < sum(part.inside[0] for part in found) / points < 0.76
    assert 0.92 < sum(part.inside[1] for part in found) / points < 0.98
    assert sum(part.predicted for part in found) / sum(part.true for part in found) == pytest.approx(1.0, abs=0.15)


def test_exact_models_have_no_error_in_their_frame_and_one_in_another(flat_image_headset: Eye) -> None:
    shifted = transforms.rigid(np.eye(3), np.array([1e-3, 0.0, 0.0]))
    own, other = (
        over_seeds(flat_image_headset, CAMERA_FRAME, ErrorSizes(truncation=SMALL), frame)
        for frame in (np.eye(4), shifted)
    )
    assert all(part.true < 1e-12 for part in own)
    assert all(part.true > 1.0 for part in other)


def outcome(number: int, true: float) -> BudgetOutcome:
    parts = [Coverage(name, region, 100, (68, 95), true, 4.0) for name in CONDITIONS for region in REGIONS]
    return BudgetOutcome(BudgetTrial(number), parts, Truncation(0.1, 0.0))


def test_tables_have_coverage_and_ratio() -> None:
    refused = BudgetOutcome(BudgetTrial(2), refused="the target moved")
    by_region, by_headset, missing = tables([outcome(0, 1.0), outcome(1, 1.0), refused])
    assert len(by_region.rows) == len(CONDITIONS) * len(REGIONS)
    assert by_region.rows[0][:4] == [MODEL_ALONE, "centre", 2, 68.0]
    assert by_region.rows[0][5] == 95.0
    assert by_region.rows[0][8] == 2.0
    assert [row[1] for row in by_headset.rows] == ["northstar", "freeform40"] * len(CONDITIONS)
    assert missing.rows == [[2, "birdbath28", "the target moved"]]
