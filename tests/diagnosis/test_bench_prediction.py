"""Repeatability excuses motions that differ from capture to capture, and no error that all captures have in common."""

import numpy as np
import pytest
from small_session import SIGMA_PX, measured, with_jitter

from wlr_render.diagnosis.bench_prediction import predict_session


def predicted(bench, plan, shift_um=0.0, turn_urad=0.0, **causes):
    """Parts by name of a session with a few small errors of the bench, whose stage repeats to some size."""
    observations = measured(bench, plan, SIGMA_PX, seed=3, **causes)
    observations = with_jitter(observations, bench, shift_um, np.random.default_rng(1), turn_urad, dof=5)
    return {part.name: part for part in predict_session(bench, observations.session).parts}


@pytest.mark.parametrize(("shift_um", "turn_urad"), [(0.0, 0.0), (15.0, 30.0), (60.0, 100.0)])
def test_captures_that_scatter_as_stages_do_are_predicted(bench, plan, shift_um, turn_urad):
    for part in predicted(bench, plan, shift_um, turn_urad).values():
        assert part.is_noise
        assert part.whitened == pytest.approx(1.0, abs=0.1)


@pytest.mark.parametrize("repeatability", [(0.0, 0.0), (15.0, 30.0)])
@pytest.mark.parametrize(
    ("causes", "parts"),
    [
        ({"camera_rotation": [0.01, 0.01, 0.0]}, ("display", "see-through")),
        ({"camera_pupil_offset": [0.1, 0.0, 0.0]}, ("display", "see-through")),
        ({"combiner_tilt": [0.02, 0.0, 0.0]}, ("display",)),
        ({"target_scale": [0.2]}, ("see-through",)),
    ],
    ids="+".join,
)
def test_an_error_that_all_captures_have_in_common_is_no_repeatability(bench, plan, repeatability, causes, parts):
    """Each is smaller than 200 um and 600 urad, so that random motions of each capture would explain it."""
    found = predicted(bench, plan, *repeatability, **causes)
    assert {name for name, part in found.items() if not part.is_noise} == set(parts)
    assert all(found[name].whitened > 1.05 for name in parts)
