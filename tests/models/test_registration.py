"""Covariance of the registration error, against draws of both models' coefficients."""

import dataclasses

import numpy as np
import pytest
from toy_models import EYE_BOX, bundle_display, bundle_see_through

from wlr_render.errors import BadInputError
from wlr_render.geometry.directions import ARCMIN
from wlr_render.models.registration import UNSHARED, model_registration_covariance, registration_changes, right_and_up
from wlr_render.models.spread import Covariance
from wlr_render.numerics.polynomial import Polynomial

SOURCES = ("lens", "lens", "stage")
PIXEL = np.array([[500.0, 400.0], [850.0, 120.0]])
VIEWPOINT = EYE_BOX.centre + [[0.002, -0.001, 0.001], [0.0, 0.003, -0.002]]
POINT = np.array([[0.1, 0.05, -1.0], [0.6, -0.2, -2.0]])


def with_spread(mapping, name, sources=SOURCES):
    """One apart variable per axis, the shared ones, and one more of its own."""
    polynomial, rng = getattr(mapping, name), np.random.default_rng(len(name))
    outputs = polynomial.outputs
    orders = polynomial.orders[:6]

    def factors(count):
        return Polynomial(orders, polynomial.box, 1e-5 * rng.normal(size=(6, count)))

    spread = Covariance(outputs, factors(outputs // 2), factors(outputs * (len(sources) + 1)), sources)
    return dataclasses.replace(mapping, spread=spread)


@pytest.fixture(scope="module")
def models():
    return with_spread(bundle_display(), "forward"), with_spread(bundle_see_through(), "deviation")


def drawn(mapping, name, shared, rng):
    """The mapping with coefficients drawn from its covariance, at given values (3,) of the shared variables."""
    polynomial, spread = getattr(mapping, name), mapping.spread
    outputs = spread.outputs
    joint = spread.joint.coefficients.reshape(6, outputs, 4) @ np.append(shared, rng.normal())
    for axis in (0, 1):
        joint[:, axis::2] += spread.apart.coefficients * rng.normal()
    moved = polynomial.plus(Polynomial(spread.joint.orders, polynomial.box, joint))
    return dataclasses.replace(mapping, **{name: moved})


def registration(display, see_through):
    gap = display.view_dir_of_pixel(PIXEL, VIEWPOINT).value - see_through.view_dir_of_real_point(POINT, VIEWPOINT).value
    return gap / ARCMIN


@pytest.fixture(scope="module")
def drawn_errors(models):
    """(draws, 2, 2) registration errors of drawn models, right and up, arcminutes."""
    display, see_through = models
    rng, errors = np.random.default_rng(1), []
    axes = right_and_up(display.view_dir_of_pixel(PIXEL, VIEWPOINT).value)
    start = registration(display, see_through)
    for _ in range(3000):
        shared = rng.normal(size=3)
        pair = drawn(display, "forward", shared, rng), drawn(see_through, "deviation", shared, rng)
        errors.append(np.einsum("nij,nj->ni", axes, registration(*pair) - start))
    return np.array(errors)


def test_covariance_is_that_of_drawn_models(models, drawn_errors):
    found = model_registration_covariance(*models, PIXEL, VIEWPOINT, POINT)
    assert list(found) == [UNSHARED, "lens", "stage"]
    total = sum(found.values())
    for row in range(2):
        drawn_covariance = np.cov(drawn_errors[:, row].T)
        size = np.sqrt(np.outer(np.diag(total[row]), np.diag(total[row])))
        np.testing.assert_allclose(drawn_covariance / size, total[row] / size, atol=0.08)


def test_changes_by_the_variables_are_the_covariance_between_places_too(models, drawn_errors):
    changes = registration_changes(*models, PIXEL, VIEWPOINT, POINT)
    joint = changes.reshape(4, -1) @ changes.reshape(4, -1).T
    total = sum(model_registration_covariance(*models, PIXEL, VIEWPOINT, POINT).values())
    for row in range(2):
        np.testing.assert_allclose(joint[2 * row : 2 * row + 2, 2 * row : 2 * row + 2], total[row], rtol=1e-9)
    size = np.sqrt(np.outer(np.diag(joint), np.diag(joint)))
    np.testing.assert_allclose(np.cov(drawn_errors.reshape(-1, 4).T) / size, joint / size, atol=0.08)


def test_what_both_share_alike_cancels(models):
    """Two displays of the same place would be displaced alike: only what each has alone remains."""
    display, see_through = models
    alone = model_registration_covariance(display, see_through, PIXEL, VIEWPOINT, POINT)

    class Same:
        """A display in the place of see-through, of which nothing is its own."""

        def view_dir_of_real_point(self, point, viewpoint):
            return display.view_dir_of_pixel(PIXEL, VIEWPOINT)

        def direction_errors(self, point, viewpoint, seen):
            return display.direction_errors(PIXEL, VIEWPOINT, seen)

    same = model_registration_covariance(display, Same(), PIXEL, VIEWPOINT, POINT)
    assert np.abs(same["lens"]).max() == 0.0
    assert np.abs(same["stage"]).max() == 0.0
    assert np.all(np.trace(alone["lens"], axis1=1, axis2=2) > 0)
    shown = display.sigma(PIXEL, VIEWPOINT)
    own = np.sqrt(np.trace(same[UNSHARED], axis1=1, axis2=2) / 2.0)
    assert np.all(own < shown)  # sigma has the shared part, too


def test_broadcasts_and_marks_what_is_not_answered(models):
    grid = model_registration_covariance(*models, PIXEL[:, None], VIEWPOINT, POINT)
    assert grid[UNSHARED].shape == (2, 2, 2, 2)
    single = model_registration_covariance(*models, PIXEL[1], VIEWPOINT[1], POINT[1])
    np.testing.assert_allclose(grid["lens"][1, 1], single["lens"], rtol=1e-9)
    behind = model_registration_covariance(*models, PIXEL, VIEWPOINT, POINT * [1, 1, -1])
    assert np.isnan(behind[UNSHARED]).all()
    assert np.isnan(behind["stage"]).all()


def test_models_of_two_fits_are_refused(models):
    other = with_spread(bundle_see_through(), "deviation", ("prescription",))
    with pytest.raises(BadInputError, match="take both from one eye of one model file"):
        model_registration_covariance(models[0], other, PIXEL, VIEWPOINT, POINT)


def test_axes_point_right_and_up():
    np.testing.assert_allclose(right_and_up(np.array([0.0, 0.0, -1.0])), [[1, 0, 0], [0, 1, 0]])
    direction = np.array([0.3, -0.4, -np.sqrt(0.75)])
    axes = right_and_up(direction)
    np.testing.assert_allclose(axes @ axes.T, np.eye(2), atol=1e-12)
    np.testing.assert_allclose(axes @ direction, 0.0, atol=1e-12)
    assert axes[1, 1] > 0
