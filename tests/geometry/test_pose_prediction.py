from collections.abc import Callable

import numpy as np
import pytest

from wlr_render.errors import BadInputError
from wlr_render.geometry import transforms
from wlr_render.geometry.pose_prediction import predicted_point, predicted_pose
from wlr_render.numerics.arrays import FloatArray


def turned(angle: float, x: float = 0.0) -> FloatArray:
    return transforms.rigid(transforms.rotation_about("y", angle), np.array([x, 1.5, -0.2]))


def test_a_head_at_constant_speed_is_predicted_exactly() -> None:
    start = transforms.rigid(transforms.rotation_about("x", 0.4), np.array([0.1, 0.2, 0.3]))
    poses = [start @ turned(0.0), start @ turned(0.02, 0.01), start @ turned(0.05, 0.025)]
    there = predicted_pose(poses[0], poses[1], 0.010, 0.015)
    np.testing.assert_allclose(there[:3, :3], poses[2][:3, :3], atol=1e-12)
    np.testing.assert_allclose(there[:3, 3], poses[2][:3, 3], atol=1e-12)
    np.testing.assert_allclose(predicted_pose(poses[0], poses[1], 0.010, 0.0), poses[1], atol=1e-12)


def test_a_pupil_moves_on_along_its_line() -> None:
    np.testing.assert_allclose(
        predicted_point(np.array([0.0, 1.0, 2.0]), np.array([0.1, 1.0, 1.8]), 0.02, 0.05), [0.35, 1.0, 1.3]
    )


@pytest.mark.parametrize(("between_s", "ahead_s"), [(0.01, 0.101), (0.01, -0.001), (0.0, 0.01), (0.2, 0.01)])
def test_far_predictions_are_refused(between_s: float, ahead_s: float) -> None:
    predictions: list[Callable[[], FloatArray]] = [
        lambda: predicted_pose(turned(0.0), turned(0.1), between_s, ahead_s),
        lambda: predicted_point(np.zeros(3), np.ones(3), between_s, ahead_s),
    ]
    for predict in predictions:
        with pytest.raises(BadInputError, match="give 0 to 100 ms, from poses at most 100 ms apart"):
            predict()
