import dataclasses

import numpy as np
import pytest
from fitted_eyes import fitted_eye

from wlr_render.errors import BadInputError
from wlr_render.mappings import Mapped, Status
from wlr_render.rendering import ray_field
from wlr_render.rendering.cpu_solve import CpuSolve
from wlr_render.rendering.pixel_solve import pixel_centres_on_panel


def test_one_pixel_each_is_the_exact_field(toy_headset_with_hole):
    panel, axes = toy_headset_with_hole.display.panel, ray_field.middle_axes(toy_headset_with_hole)
    viewpoint = toy_headset_with_hole.eye_box.at(np.array([0.4, -0.2, 0.9]))
    solve = CpuSolve(toy_headset_with_hole, (panel.width_px, panel.height_px), axes)
    exact = ray_field.exact_field(toy_headset_with_hole, viewpoint, axes)
    field = solve.solve(viewpoint).read()
    np.testing.assert_array_equal(field.bend, exact.bend)
    np.testing.assert_array_equal(field.status, exact.status)


def test_a_picture_of_its_own_size_covers_the_panel():
    centres = pixel_centres_on_panel(np.array([100.0, 80.0]), (10, 4))
    np.testing.assert_allclose(centres[0, 0], [5, 10])
    np.testing.assert_allclose(centres[-1, -1], [95, 70])
    np.testing.assert_allclose(np.diff(centres[1, :, 0]), 10)


def test_a_warm_start_changes_nothing():
    eye = fitted_eye("northstar", 3)
    solve, viewpoint = CpuSolve(eye, (18, 20), np.eye(3)), eye.eye_box.at(np.array([0.4, -0.2, 0.9]))
    cold = solve.solve(viewpoint).read()
    solve.solve(viewpoint + [1e-3, 0, 0])
    warm = solve.solve(viewpoint).read()
    np.testing.assert_allclose(warm.bend, cold.bend, atol=1e-9)
    solve.forget()
    np.testing.assert_array_equal(solve.solve(viewpoint).read().bend, cold.bend)


def test_a_pixel_whose_solve_fails_says_so(toy_headset):
    class Unsolved:
        panel = toy_headset.display.panel

        def view_dir_of_pixel(self, pixel, viewpoint, warm_start=None):
            return Mapped(np.full((*pixel.shape[:-1], 3), np.nan), np.full(pixel.shape[:-1], 2, np.uint8))

    eye = dataclasses.replace(toy_headset, display=Unsolved())
    field = CpuSolve(eye, (3, 2), np.eye(3)).solve(eye.eye_box.centre).read()
    assert (field.status == Status.NOT_CONVERGED).all()
    assert np.isnan(field.bend).all()


def test_a_viewpoint_that_is_none_is_refused(toy_headset):
    with pytest.raises(BadInputError, match="not three finite numbers"):
        CpuSolve(toy_headset, (3, 2), np.eye(3)).solve(np.full(3, np.nan))
