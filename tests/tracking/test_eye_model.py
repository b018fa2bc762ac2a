import numpy as np
import pytest

from wlr_render.geometry import directions
from wlr_render.tracking.eye_model import RotatingEye

VIEWPOINT = np.array([0.032, 0.001, -0.03])


def test_the_eye_looking_ahead_has_its_pupil_at_the_viewpoint_and_turns_about_a_point_behind_it() -> None:
    model = RotatingEye.looking_ahead_from(VIEWPOINT)
    np.testing.assert_allclose(model.viewpoint_of_gaze(np.array([0, 0, -1.0])), VIEWPOINT, atol=1e-17)
    np.testing.assert_allclose(model.rotation_centre_in_device - VIEWPOINT, [0, 0, 0.0105], atol=1e-17)


@pytest.mark.parametrize("lead", [(), (1,), (3, 1, 2)])
def test_the_pupil_keeps_its_distance_and_follows_the_gaze(lead: tuple[int, ...]) -> None:
    model = RotatingEye(VIEWPOINT, pupil_distance_m=0.011)
    gaze_dir = directions.dir_of_tangents(np.random.default_rng(1).uniform(-1, 1, (*lead, 2)))
    offset = model.viewpoint_of_gaze(gaze_dir) - VIEWPOINT
    np.testing.assert_allclose(np.linalg.norm(offset, axis=-1), 0.011, atol=1e-16)
    np.testing.assert_allclose(np.sum(offset * gaze_dir, axis=-1), 0.011, atol=1e-16)


def test_looking_20_degrees_to_the_right_moves_the_pupil_3_6_mm_to_the_right() -> None:
    model = RotatingEye.looking_ahead_from(VIEWPOINT)
    angle = np.deg2rad(20)
    moved = model.viewpoint_of_gaze(np.array([np.sin(angle), 0, -np.cos(angle)])) - VIEWPOINT
    np.testing.assert_allclose(moved, [0.00359121, 0, 0.00063323], atol=1e-8)
