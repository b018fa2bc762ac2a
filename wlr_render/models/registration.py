"""Covariance of the registration error of an eye: direction of a pixel minus direction of a real point."""

from collections.abc import Sequence

import numpy as np

from wlr_render.error_sources import ErrorSource
from wlr_render.errors import BadInputError
from wlr_render.geometry.directions import ARCMIN, normalised
from wlr_render.models.fitted_model import FittedDisplay, FittedSeeThrough
from wlr_render.numerics.arrays import FloatArray


def model_registration_covariance(
    display: FittedDisplay, see_through: FittedSeeThrough, pixel: FloatArray, viewpoint: FloatArray, point: FloatArray
) -> dict[str, FloatArray]:
    """Return the covariance, by source, of the angle from a real point's direction to a pixel's, as the models predict.

    Both directions start at the viewpoint. An error that both models share, such as an error of the camera that
    measured both, counts by its difference: it cancels if it displaces both by the same angle.

    Args:
        display, see_through: the models of one eye, from one fit.
        pixel: (..., 2) panel pixels.
        viewpoint: (..., 3), device frame, metres.
        point: (..., 3) real points, device frame, metres.

    Returns:
        Covariances (..., 2, 2) in square arcminutes along the axes of `right_and_up` of the pixel's direction; their
        sum is the total covariance. The models do not share `NOISE_AND_STAGE`. NaN where a model has no answer.

    Raises:
        BadInputError: a model has no covariance, or the two are not from one fit.
    """
    shown = display.view_dir_of_pixel(pixel, viewpoint).value
    real = see_through.view_dir_of_real_point(point, viewpoint).value
    lead = np.broadcast_shapes(shown.shape[:-1], real.shape[:-1])
    shown, real = (np.broadcast_to(each, (*lead, 3)) for each in (shown, real))
    of_display = display.direction_errors(pixel, viewpoint, shown)
    of_see_through = see_through.direction_errors(point, viewpoint, real)
    _check_one_fit(of_display.sources, of_see_through.sources)
    axes = right_and_up(shown) / ARCMIN
    difference = axes @ (of_display.shared - of_see_through.shared)
    unshared = axes @ (of_display.unshared + of_see_through.unshared) @ np.swapaxes(axes, -1, -2)
    return {ErrorSource.NOISE_AND_STAGE: unshared} | {
        name: _from(difference, of_display.sources, name) for name in dict.fromkeys(of_display.sources)
    }


def registration_changes(
    display: FittedDisplay, see_through: FittedSeeThrough, pixel: FloatArray, viewpoint: FloatArray, point: FloatArray
) -> FloatArray:
    """Return the derivatives of the angles from real points' directions to pixels' by the covariance's variables.

    Products of the derivatives are the covariance, between different pixels and points, too.

    Args:
        display, see_through: the models of one eye, from one fit.
        pixel: (n, 2) panel pixels.
        viewpoint: (n, 3), device frame, metres.
        point: (n, 3) real points, device frame, metres; both models must have answers.

    Returns:
        (n, 2, k) arcminutes along `right_and_up` of the pixels' directions, by independent standard normal variables.

    Raises:
        BadInputError: a model has no covariance, or the two are not from one fit.
    """
    displayed = display.view_dir_of_pixel(pixel, viewpoint).value
    of_display = display.direction_changes(pixel, viewpoint, displayed)
    real = see_through.view_dir_of_real_point(point, viewpoint).value
    of_see_through = see_through.direction_changes(point, viewpoint, real)
    sources = [each.spread.sources for each in (display, see_through) if each.spread is not None]
    _check_one_fit(*sources)
    shared = len(sources[0])
    difference = of_display[..., :shared] - of_see_through[..., :shared]
    changes = np.concatenate([difference, of_display[..., shared:], -of_see_through[..., shared:]], axis=-1)
    return np.asarray(right_and_up(displayed) / ARCMIN @ changes)


def right_and_up(direction: FloatArray) -> FloatArray:
    """Return the axes (..., 2, 3) perpendicular to unit directions (..., 3): horizontal to the right, and up.

    Device frame, where y is up; the direction must not be vertical.
    """
    right = normalised(np.cross(direction, [0.0, 1.0, 0.0]))
    return np.stack([right, np.cross(right, direction)], axis=-2)


def _check_one_fit(of_display: tuple[str, ...], of_see_through: tuple[str, ...]) -> None:
    if of_display != of_see_through:
        raise BadInputError(
            "the display and the see-through model do not share the same variables; take both from one eye of one "
            "model file."
        )


def _from(difference: FloatArray, sources: Sequence[str], name: str) -> FloatArray:
    """Return the covariance (..., 2, 2) of changes (..., 2, k) from the variables of one source."""
    changes = difference[..., [source == name for source in sources]]
    return np.asarray(changes @ np.swapaxes(changes, -1, -2))
