"""Klemm's table of points on headsets whose virtual image is a surface, and on a traced one whose image is none."""

import dataclasses

import numpy as np
import pytest
from rival_headsets import EYE_BOX, IN_PLANE, PIXELS, display_captures, rms, traced

from benchmarks.rivals.point_table import klemm_grid
from wlr_render.captures.correspondences import concatenate
from wlr_render.errors import BadInputError
from wlr_render.evaluation.mapping_error import display_error
from wlr_render.geometry.directions import ARCMIN, arcmin_between, dir_of_tangents, normalised

RNG = np.random.default_rng(5)
PIXEL = RNG.uniform([60, 60], [940, 740], (200, 2))
VIEWPOINT = EYE_BOX.at(RNG.uniform(-1, 1, (200, 3)))
EXACT = 1e-6  # arcminutes


def surface(curvature, twist=0.01):
    """Directions of an image from one metre in front of the eye to beyond infinity; its tangents are curved."""

    def direction(pixel, viewpoint):
        x, y = ((pixel - [500.0, 400.0]) / 500.0).T
        a = np.stack([0.3 * x + twist * x * y + curvature * y**2, -0.35 * y], axis=1)
        w = (0.4 + 0.7 * x)[:, None]
        shift = viewpoint - EYE_BOX.centre
        return dir_of_tangents((a - w * shift[:, :2]) / (1.0 + w * shift[:, 2:]))

    return direction


def error(model, truth):
    return arcmin_between(model.view_dir_of_pixel(PIXEL, VIEWPOINT).value, truth(PIXEL, VIEWPOINT)).max()


def test_points_between_nodes_are_found_from_all_viewpoints():
    """The image is bilinear in the pixel, as the table is: its nodes' points are exact, off the plane, too."""
    truth = surface(0.0)
    model = klemm_grid(display_captures(IN_PLANE[:9], truth))
    assert error(model, truth) < EXACT
    back = model.pixel_of_view_dir(truth(PIXEL, VIEWPOINT), VIEWPOINT)
    np.testing.assert_allclose(back.value, PIXEL, atol=1e-6)
    assert model.point.numbers == 3 * 25 * 21


def test_a_finer_grid_interpolates_a_curved_image_better():
    truth = surface(0.05)
    captures = display_captures(IN_PLANE[:9], truth)
    coarse, fine = (error(klemm_grid(captures, n, n), truth) for n in (11, 21))
    assert fine == pytest.approx(coarse / 4.0, rel=0.1)


def test_nodes_that_one_position_sees_continue_the_others():
    """Two positions see the left part, a third only the right: its part has no baseline of its own."""
    truth = surface(0.0, twist=0.0)
    left, right = PIXELS[PIXELS[:, 0] < 700], PIXELS[PIXELS[:, 0] > 300]
    parts = [display_captures(IN_PLANE[:2], truth, left), display_captures(IN_PLANE[2:3], truth, right)]
    whole = concatenate(parts)
    assert error(klemm_grid(whole), truth) < EXACT
    noise = ARCMIN * np.random.default_rng(7).normal(size=whole.view_dir.shape)
    noisy = dataclasses.replace(whole, view_dir=normalised(whole.view_dir + noise))
    assert error(klemm_grid(noisy), truth) < 3.0  # a map continued beyond its own pixels adds twice that


def test_captures_that_do_not_serve_are_refused():
    truth = surface(0.0)
    with pytest.raises(BadInputError, match="needs two positions"):
        klemm_grid(display_captures(IN_PLANE[:1], truth))
    near = IN_PLANE[:1] + np.array([[0.0, 0.0, 0.0], [1e-4, 0.0, 0.0]])
    with pytest.raises(BadInputError, match="some millimetres apart"):
        klemm_grid(display_captures(near, truth))
    with pytest.raises(BadInputError, match="too few"):
        klemm_grid(display_captures(IN_PLANE[:4], truth, PIXELS[:5]))
    line = np.column_stack([PIXELS[:, 0], np.full(len(PIXELS), 400.0)])
    with pytest.raises(BadInputError, match="see only 0 of 525 grid nodes"):
        klemm_grid(display_captures(IN_PLANE[:4], truth, line))


def test_a_traced_headset_shows_no_surface():
    """North Star's pixels have no points in space: the table is as far off as the smooth model (10.2')."""
    _, display, _, observed, _ = traced()
    found = display_error(klemm_grid(display), observed)
    assert rms(found.forward_arcmin) == pytest.approx(10.0, abs=0.3)
    assert rms(found.backward_px) == pytest.approx(4.5, abs=0.2)
    assert np.isfinite(found.backward_px).all()
