"""Covariance of the registration error, against the changes by each variable of both models' coefficients."""

from typing import cast

import numpy as np
import pytest
from models.toy_models import EYE_BOX, Fitted, bundle_display, bundle_see_through, changed

from wlr_render.error_sources import ErrorSource
from wlr_render.errors import BadInputError
from wlr_render.geometry.directions import ARCMIN
from wlr_render.mappings import QueryResult
from wlr_render.models.display_model import DisplayModel
from wlr_render.models.fitted_model import DirectionErrors, FittedSeeThrough
from wlr_render.models.registration import model_registration_covariance, registration_changes, right_and_up
from wlr_render.models.see_through_model import SeeThroughModel
from wlr_render.models.spread import Covariance
from wlr_render.numerics.arrays import FloatArray
from wlr_render.numerics.polynomial import Polynomial

Models = tuple[DisplayModel, SeeThroughModel]

SOURCES = ("lens", "lens", "stage")
PIXEL = np.array([[500.0, 400.0], [850.0, 120.0]])
VIEWPOINT = EYE_BOX.centre + [[0.002, -0.001, 0.001], [0.0, 0.003, -0.002]]
POINT = np.array([[0.1, 0.05, -1.0], [0.6, -0.2, -2.0]])


def with_spread(mapping: Fitted, name: str, sources: tuple[str, ...] = SOURCES) -> Fitted:
    """One apart variable per axis, the shared ones, and one more of its own."""
    polynomial, rng = getattr(mapping, name), np.random.default_rng(len(name))
    outputs = polynomial.outputs
    orders = polynomial.orders[:6]

    def factors(count: int) -> Polynomial:
        return Polynomial(orders, polynomial.box, 1e-5 * rng.normal(size=(6, count)))

    spread = Covariance(outputs, factors(outputs // 2), factors(outputs * (len(sources) + 1)), sources)
    return mapping.with_spread(spread)


@pytest.fixture(scope="module")
def models() -> Models:
    return with_spread(bundle_display(), "forward"), with_spread(bundle_see_through(), "deviation")


def moved(mapping: Fitted, name: str, shared: FloatArray, own: FloatArray) -> Fitted:
    """The mapping at given values of the shared variables (3,), and of its own (3,): of both axes, then of each."""
    polynomial, spread = getattr(mapping, name), mapping.spread
    assert spread is not None
    joint = spread.joint.coefficients.reshape(6, spread.outputs, 4) @ np.append(shared, own[0])
    for axis in (0, 1):
        joint[:, axis::2] += spread.apart.coefficients * own[1 + axis]
    added = polynomial.plus(Polynomial(spread.joint.orders, polynomial.box, joint))
    return changed(mapping, **{name: added})


def registration(display: DisplayModel, see_through: SeeThroughModel) -> FloatArray:
    gap = display.view_dir_of_pixel(PIXEL, VIEWPOINT).value - see_through.view_dir_of_real_point(POINT, VIEWPOINT).value
    return gap / ARCMIN


@pytest.fixture(scope="module")
def changes_of_models(models: Models) -> FloatArray:
    """(9, 2, 2) change of the registration error by each variable of both models, right and up, arcminutes."""
    display, see_through = models
    axes = right_and_up(display.view_dir_of_pixel(PIXEL, VIEWPOINT).value)

    def error(variables: FloatArray) -> FloatArray:
        shared, of_display, of_see_through = variables.reshape(3, 3)
        pair = moved(display, "forward", shared, of_display), moved(see_through, "deviation", shared, of_see_through)
        return np.asarray(np.einsum("nij,nj->ni", axes, registration(*pair)))

    return np.array([0.5 * (error(one) - error(-one)) for one in np.eye(9)])


def test_covariance_is_that_of_the_changes_by_every_variable(models: Models, changes_of_models: FloatArray) -> None:
    found = model_registration_covariance(*models, PIXEL, VIEWPOINT, POINT)
    assert list(found) == [ErrorSource.NOISE_AND_STAGE, "lens", "stage"]
    total = np.sum([*found.values()], axis=0)
    for row in range(2):
        change = changes_of_models[:, row]
        size = np.sqrt(np.outer(np.diag(total[row]), np.diag(total[row])))
        np.testing.assert_allclose(change.T @ change / size, total[row] / size, atol=1e-4)


def test_changes_by_the_variables_are_the_covariance_between_places_too(
    models: Models, changes_of_models: FloatArray
) -> None:
    changes = registration_changes(*models, PIXEL, VIEWPOINT, POINT)
    joint = changes.reshape(4, -1) @ changes.reshape(4, -1).T
    total = np.sum([*model_registration_covariance(*models, PIXEL, VIEWPOINT, POINT).values()], axis=0)
    for row in range(2):
        np.testing.assert_allclose(joint[2 * row : 2 * row + 2, 2 * row : 2 * row + 2], total[row], rtol=1e-9)
    size = np.sqrt(np.outer(np.diag(joint), np.diag(joint)))
    change = changes_of_models.reshape(9, 4)
    np.testing.assert_allclose(change.T @ change / size, joint / size, atol=1e-4)


def test_what_both_share_alike_cancels(models: Models) -> None:
    """Two displays of the same place would be displaced alike: only what each has alone remains."""
    display, see_through = models
    alone = model_registration_covariance(display, see_through, PIXEL, VIEWPOINT, POINT)

    class Same:
        """A display in the place of see-through, of which nothing is its own."""

        def view_dir_of_real_point(self, point: object, viewpoint: object) -> QueryResult:
            return display.view_dir_of_pixel(PIXEL, VIEWPOINT)

        def direction_errors(self, point: object, viewpoint: object, seen: FloatArray) -> DirectionErrors:
            return display.direction_errors(PIXEL, VIEWPOINT, seen)

    same = model_registration_covariance(display, cast(FittedSeeThrough, Same()), PIXEL, VIEWPOINT, POINT)
    assert np.abs(same["lens"]).max() == 0.0
    assert np.abs(same["stage"]).max() == 0.0
    assert np.all(np.trace(alone["lens"], axis1=1, axis2=2) > 0)
    shown = display.sigma(PIXEL, VIEWPOINT)
    own = np.sqrt(np.trace(same[ErrorSource.NOISE_AND_STAGE], axis1=1, axis2=2) / 2.0)
    assert np.all(own < shown)  # sigma has the shared part, too


def test_broadcasts_and_marks_what_is_not_answered(models: Models) -> None:
    grid = model_registration_covariance(*models, PIXEL[:, None], VIEWPOINT, POINT)
    assert grid[ErrorSource.NOISE_AND_STAGE].shape == (2, 2, 2, 2)
    single = model_registration_covariance(*models, PIXEL[1], VIEWPOINT[1], POINT[1])
    np.testing.assert_allclose(grid["lens"][1, 1], single["lens"], rtol=1e-9)
    behind = model_registration_covariance(*models, PIXEL, VIEWPOINT, POINT * [1, 1, -1])
    assert np.isnan(behind[ErrorSource.NOISE_AND_STAGE]).all()
    assert np.isnan(behind["stage"]).all()


def test_models_of_two_fits_are_refused(models: Models) -> None:
    other = with_spread(bundle_see_through(), "deviation", ("prescription",))
    with pytest.raises(BadInputError, match="take both from one eye of one model file"):
        model_registration_covariance(models[0], other, PIXEL, VIEWPOINT, POINT)


def test_axes_point_right_and_up() -> None:
    np.testing.assert_allclose(right_and_up(np.array([0.0, 0.0, -1.0])), [[1, 0, 0], [0, 1, 0]])
    direction = np.array([0.3, -0.4, -np.sqrt(0.75)])
    axes = right_and_up(direction)
    np.testing.assert_allclose(axes @ axes.T, np.eye(2), atol=1e-12)
    np.testing.assert_allclose(axes @ direction, 0.0, atol=1e-12)
    assert axes[1, 1] > 0
