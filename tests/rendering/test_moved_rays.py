import numpy as np
import pytest
from cpu_warp import in_camera_frame

from wlr_render.geometry import transforms

RAYS = np.random.default_rng(4).uniform(-0.5, 0.5, (4, 3, 5)) * np.array([1, 1, 0.02, 0.02])[:, None, None]


def moved(angles=(0.1, -0.2, 0.05), by=(0.02, -0.01, 0.03)):
    return transforms.rigid(transforms.rotations_of_vectors(np.array(angles)), np.array(by))


def point_at(slope_offset, depth):
    """The point of each ray at a depth in front of its own camera, (rows, columns, 3)."""
    a, b, c, d = slope_offset
    return np.stack([a * depth + c, b * depth + d, -depth * np.ones_like(a)], axis=-1)


@pytest.mark.parametrize("depth", [0.3, 2.0, 50.0])
def test_points_of_a_ray_stay_on_it(depth):
    there = transforms.apply(moved(), point_at(RAYS, depth))
    again = point_at(in_camera_frame(RAYS, moved()), -there[..., 2])
    np.testing.assert_allclose(again, there, rtol=1e-12, atol=1e-14)


def test_no_motion_changes_nothing_and_two_motions_are_their_product():
    np.testing.assert_allclose(in_camera_frame(RAYS, np.eye(4)), RAYS, rtol=1e-15)
    first, second = moved(), moved((-0.3, 0.1, 0.2), (0.0, 0.05, -0.02))
    np.testing.assert_allclose(
        in_camera_frame(in_camera_frame(RAYS, first), second), in_camera_frame(RAYS, second @ first), rtol=1e-11
    )


def test_each_row_is_moved_by_its_own_transform():
    by_row = np.stack([moved(by=(0.01 * k, 0, 0)) for k in range(3)])
    result = in_camera_frame(RAYS, by_row)
    for row in range(3):
        np.testing.assert_array_equal(result[:, row], in_camera_frame(RAYS, by_row[row])[:, row])


def test_rays_that_lead_backwards_in_the_other_frame_and_holes_are_nan_and_the_type_stays():
    rays = RAYS.astype(np.float32)
    rays[:, 1, 2] = np.nan
    rays[0, 0, 0], rays[0, 0, 1] = 1.5, -1.5
    result = in_camera_frame(rays, transforms.rigid(transforms.rotation_about("y", 0.8), np.zeros(3)))
    lost = np.isnan(result).all(axis=0)
    assert result.dtype == np.float32
    assert lost[1, 2]
    # Turned left by 46 degrees, the camera has rays to the right of 44 degrees behind it.
    assert lost[0, 0] != lost[0, 1]
    assert lost.sum() == 2
