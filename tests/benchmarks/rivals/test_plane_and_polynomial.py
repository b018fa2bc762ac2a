"""Wientapper's plane and polynomial on headsets that are one, and on a traced one with noise."""

import numpy as np
import pytest
from rival_headsets import EYE_BOX, IN_PLANE, IN_VOLUME, display_captures, rms, see_through_captures, traced

from benchmarks.rivals.pinhole import direct_plane
from benchmarks.rivals.plane_and_polynomial import wientapper_display, wientapper_see_through
from wlr_render.captures.correspondences import select
from wlr_render.errors import BadInputError
from wlr_render.geometry.directions import ARCMIN, arcmin_between, dir_of_tangents, normalised, tangents_of_dir

RNG = np.random.default_rng(5)
PIXEL = RNG.uniform([60, 60], [940, 740], (200, 2))
VIEWPOINT = EYE_BOX.at(RNG.uniform(-0.8, 0.8, (200, 3)))


def distorted(amplitude):
    """Direction of (pixel, viewpoint): a screen 0.7 m away and a cubic of pixel and position in tangents."""

    def direction(pixel, viewpoint):
        u, v = ((pixel - [500.0, 400.0]) / 500.0).T
        shift = viewpoint - EYE_BOX.centre
        x, y, z = (shift / EYE_BOX.size).T
        screen = np.stack([0.3 * u, -0.3 * v, np.full(len(u), -1.0)], axis=1) - 1.4 * shift
        rest = np.stack([u * u * x + 0.5 * z * v, u * v * y - x * x + 0.3 * v**3], axis=1)
        return dir_of_tangents(tangents_of_dir(screen) + amplitude * rest)

    return direction


def error(model, truth):
    return arcmin_between(model.view_dir_of_pixel(PIXEL, VIEWPOINT).value, truth(PIXEL, VIEWPOINT)).max()


@pytest.mark.parametrize(("bundled", "positions"), [(False, IN_VOLUME), (True, IN_PLANE)])
def test_a_plane_alone_is_recovered(bundled, positions):
    truth = distorted(0.0)
    captures = display_captures(positions, truth)
    model, regressor = wientapper_display(captures, bundled)
    assert error(model, truth) < 1e-5
    back = model.pixel_of_view_dir(truth(PIXEL, VIEWPOINT), VIEWPOINT)
    np.testing.assert_allclose(back.value, PIXEL, atol=1e-5)
    assert regressor.numbers >= 11


def test_the_polynomial_explains_what_the_plane_leaves():
    """The best plane of the distorted image is another: the polynomial takes that up, too, to a hundredth."""
    truth = distorted(5e-3)
    captures = display_captures(np.concatenate([IN_VOLUME, EYE_BOX.at(RNG.uniform(-1, 1, (50, 3)))]), truth)
    plane = error(direct_plane(captures), truth)
    model, regressor = wientapper_display(captures)
    assert plane > 5.0
    assert error(model, truth) < 0.01 * plane
    assert regressor.numbers in (11 + 2 * 56, 11 + 2 * 126, 11 + 2 * 252)  # degree 3, 4 or 5
    assert wientapper_display(captures, degree=1)[1].numbers == 11 + 2 * 6
    assert error(wientapper_display(captures, degree=1)[0], truth) > 0.5 * plane


def test_only_the_bundled_variant_sees_along_rays():
    """From a viewpoint farther back on the same ray, a pixel is seen in the same direction."""
    _, display, _, observed, _ = traced()
    rows = slice(0, 400)
    pixel, viewpoint = observed.pixel[rows], observed.viewpoint[rows]
    changes = []
    for bundled in (False, True):
        model, _ = wientapper_display(display, bundled, degree=4)
        seen = model.view_dir_of_pixel(pixel, viewpoint).value
        behind = model.view_dir_of_pixel(pixel, viewpoint - 2e-3 * seen).value
        changes.append(rms(arcmin_between(seen, behind)))
    assert changes[0] > 1.0
    assert changes[1] < 1e-6


@pytest.mark.parametrize("bundled", [False, True])
def test_held_out_positions_choose_the_degree_of_the_deviation(bundled):
    """A is quadratic in the tangents and B linear; half an arcminute of noise hides no more and adds no more."""
    positions = EYE_BOX.at(np.random.default_rng(2).uniform(-1, 1, (40, 3)) * [1.0, 1.0, not bundled])

    def tangents(point, viewpoint):
        to_point = (point - viewpoint).T
        straight = (to_point[:2] / -to_point[2]).T
        bent = np.stack([0.05 * straight[:, 0] * straight[:, 1], 0.05 * straight[:, 1] ** 2], axis=1)
        noise = 0.5 * ARCMIN * np.random.default_rng(4).normal(size=straight.shape)
        return straight + bent + 1e-3 * straight / -to_point[2][:, None] + noise

    model, regressor = wientapper_see_through(see_through_captures(positions, tangents), bundled)
    variables = 4 if bundled else 5
    terms = [1, variables + 1, (variables + 1) * (variables + 2) // 2]
    terms.append(terms[-1] * (variables + 3) // 3)
    assert regressor.numbers in (4 * terms[2], 4 * terms[3])
    point = np.column_stack([VIEWPOINT[:, :2] + RNG.uniform(-0.1, 0.1, (200, 2)), RNG.uniform(-3, -0.5, 200)])
    straight = normalised(point - VIEWPOINT)
    seen = model.view_dir_of_real_point(point, VIEWPOINT).value
    t = tangents_of_dir(straight)
    true = t + np.stack([0.05 * t[:, 0] * t[:, 1], 0.05 * t[:, 1] ** 2], 1) + 1e-3 * t / (VIEWPOINT - point)[:, 2:]
    assert rms(arcmin_between(seen, dir_of_tangents(true))) < 0.1


def test_captures_that_do_not_serve_are_refused():
    display = display_captures(IN_VOLUME, distorted(0.0))
    with pytest.raises(BadInputError, match="two or more camera positions"):
        wientapper_display(select(display, display.capture == 0))
