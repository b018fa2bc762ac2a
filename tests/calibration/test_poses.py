import numpy as np
import pytest

from wlr_render.calibration.poses import Pose, motion_between, small_motion
from wlr_render.geometry import transforms
from wlr_render.geometry.directions import ARCMIN
from wlr_render.numerics.arrays import FloatArray

DRAWS = 20_000


def some_covariance(rng: np.random.Generator, size: float = 1e-3) -> FloatArray:
    root = rng.normal(size=(6, 6)) * size
    return root @ root.T


def some_pose(rng: np.random.Generator) -> FloatArray:
    return transforms.rigid(transforms.rotations_of_vectors(rng.normal(size=3)), rng.normal(size=3))


def drawn(pose: Pose, rng: np.random.Generator, count: int = DRAWS) -> FloatArray:
    return small_motion(rng.multivariate_normal(np.zeros(6), pose.covariance, count)) @ pose.b_from_a


@pytest.mark.parametrize("shape", [(), (1,), (3, 1, 2)])
def test_a_motion_is_what_carries_one_pose_to_the_other(shape: tuple[int, ...]) -> None:
    rng = np.random.default_rng(1)
    before, motion = some_pose(rng), rng.uniform(-1, 1, size=(*shape, 6))
    np.testing.assert_allclose(motion_between(before, small_motion(motion) @ before), motion, atol=1e-12)


def test_sigmas_are_those_of_turning_and_of_where_the_origin_lies() -> None:
    rng = np.random.default_rng(4)
    pose = Pose(some_pose(rng), some_covariance(rng))
    draws = drawn(pose, rng)
    np.testing.assert_allclose(pose.sigma_mm, 1e3 * draws[:, :3, 3].std(axis=0), rtol=0.03)
    turning = motion_between(pose.b_from_a, draws)[:, :3].std(axis=0)
    np.testing.assert_allclose(pose.sigma_arcmin, turning / ARCMIN, rtol=0.03)
