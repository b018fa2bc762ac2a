"""Poses and positions a few milliseconds ahead, at constant velocity."""

import numpy as np

from wlr_render.errors import BadInputError
from wlr_render.geometry import transforms
from wlr_render.numerics.arrays import FloatArray

LONGEST_S = 0.1
"""Longest time ahead, and between two poses: a head at 100 deg/s that stops is then predicted 10 degrees too far."""


def check_prediction(between_s: float, ahead_s: float) -> None:
    """Check the times of a prediction.

    Raises:
        BadInputError: `between_s` is not above 0, `ahead_s` is below 0, or one is above 100 ms.
    """
    if not (0 < between_s <= LONGEST_S and 0 <= ahead_s <= LONGEST_S):
        raise BadInputError(
            f"a prediction by {ahead_s * 1e3:g} ms from two poses {between_s * 1e3:g} ms apart is not possible; "
            f"give 0 to {LONGEST_S * 1e3:g} ms, from poses at most {LONGEST_S * 1e3:g} ms apart."
        )


def predicted_pose(before: FloatArray, last: FloatArray, between_s: float, ahead_s: float) -> FloatArray:
    """Return the pose (4, 4) at `ahead_s` after `last`, extrapolating the motion from `before` to `last`, each (4, 4).

    Args:
        before, last: rigid transforms, e.g. world_from_device.
        between_s: seconds from `before` to `last`.
        ahead_s: seconds from `last` to the predicted pose; 0 returns `last`.

    Raises:
        BadInputError: see `check_prediction`.
    """
    check_prediction(between_s, ahead_s)
    (pose,) = transforms.between(before, last, np.array([1.0 + ahead_s / between_s]))
    return np.asarray(pose)


def predicted_point(before: FloatArray, last: FloatArray, between_s: float, ahead_s: float) -> FloatArray:
    """Return the position (3,) at `ahead_s` after `last`, extrapolating the motion from `before` to `last`.

    Raises:
        BadInputError: see `check_prediction`.
    """
    check_prediction(between_s, ahead_s)
    return np.asarray(last + (ahead_s / between_s) * (last - before))
