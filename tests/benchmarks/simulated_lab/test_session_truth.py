"""The benchmark that compares a calibration from photographs with the truth behind them."""

import numpy as np
import pytest
from small_photo_session import small_plan

from benchmarks.simulated_lab import session_truth
from wlr_render.evaluation.truth_tests import TruthTests
from wlr_render.jobs.calibrate.calibrate_device import predicted_errors
from wlr_render.optics.traced_mappings import traced_eye

pytestmark = pytest.mark.slow  # the session takes some twenty seconds to make


def test_poses_and_models_are_off_by_what_they_state(calibrated_session, monkeypatch):
    """Exact numbers have no errors of the stage, which four camera positions hardly average."""
    session, found, _ = calibrated_session
    bench = session.bench
    monkeypatch.setattr(session_truth, "plan_photographs", small_plan)
    compared = session_truth.compare_with_truth(bench, found, 1)
    first = bench.camera_at(found.session.display[0].stage)
    assert not np.allclose(compared.truth.display[0], first, atol=1e-6)  # visits have errors of their own
    models, poses = session_truth.truth_tables(compared, 1)
    assert [row[0] for row in poses.rows[1:]] == ["target pose 0", "target pose 1"]
    for row in poses.rows:
        off_mm, sigma_mm, off_arcmin, sigma_arcmin = row[1:]
        assert off_mm < 3 * sigma_mm
        assert off_arcmin < 3 * sigma_arcmin
    tests = TruthTests.of(traced_eye(bench.device, "right"), [1, 1])
    predicted = predicted_errors(tests, compared.measured)
    errors = {row[0]: row[1] for row in models.rows}
    for name, expected in predicted.items():
        assert errors[name] < 2 * expected, name
