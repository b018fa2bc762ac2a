"""Pictures that are hard to warp have what they are to have."""

import numpy as np
import pytest
from speed_work import needs_gl, small_work

from benchmarks.speed import pictures
from wlr_render.geometry.pinhole import Pinhole


def test_a_near_object_is_as_wide_as_it_says():
    """Focal lengths of 100 px a unit of tangent: 20 mm at 0.1 m are 20 px, and nothing is none."""
    camera = Pinhole(200, 100, np.array([-1.0, -0.5]), np.array([1.0, 0.5]))
    mask = np.zeros((100, 200))
    mask[pictures.near_pixels(camera, 0.020)] = 1
    assert mask.sum() == 400
    assert mask[10:30, 10:30].all()
    mask[pictures.near_pixels(camera, 0.0)] = 2
    assert mask.max() == 1


def test_stripes_are_one_pixel_wide():
    colour, depth = pictures.striped(6, 2)
    np.testing.assert_array_equal(colour[1, :, 2], [0, 255, 0, 255, 0, 255])
    assert (depth.shape, colour.shape) == ((2, 6), (2, 6, 3))


@pytest.mark.gl
def test_stripes_keep_their_light(small_panel_model):
    needs_gl()
    assert pictures.stripes_light(small_work(small_panel_model), "auto") == pytest.approx(0.5, abs=pictures.LIGHT_GOAL)


@pytest.mark.gl
def test_each_near_object_is_timed(small_panel_model):
    needs_gl()
    figures = pictures.near_object(small_work(small_panel_model), "auto").figures
    assert len(figures) == len(pictures.OBJECTS_M)
    assert all(each.goal == "<= 1.3" for each in figures)
