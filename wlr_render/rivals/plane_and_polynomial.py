"""A flat virtual image and a polynomial of what it leaves: Wientapper et al.

F. Wientapper, H. Wuest, P. Rojtberg and D. Fellner, "A camera-based calibration for automotive augmented reality
head-up-displays", ISMAR 2013: a view-independent virtual plane, and a "generic five-variate" polynomial of pixel and
head position on top. With the point on the base plane in place of the position it has four variables: the bundled
variant, which is not theirs.
"""

import numpy as np

from wlr_render.calibration.base_plane import choose_base_plane
from wlr_render.calibration.fit_display import DISPLAY
from wlr_render.calibration.fit_see_through import SEE_THROUGH
from wlr_render.captures.correspondences import DisplayCaptures, SeeThroughCaptures
from wlr_render.models.fitted_model import FittedDisplay, FittedSeeThrough
from wlr_render.numerics.arrays import FloatArray, IntArray
from wlr_render.numerics.polynomial import Polynomial, basis, term_count, total_degree
from wlr_render.numerics.regressor import NumericRegressor, Regressor
from wlr_render.rivals.pinhole import direct_plane
from wlr_render.rivals.samples import FOLDS, Samples, fit_structure

_MOST_COLUMNS = 520
"""Of a polynomial's equations: degree 5 or 6 in five variables, 6 to 8 in four."""
_RCOND = 1e-10


def wientapper_display(
    captures: DisplayCaptures, bundled: bool = False, degree: int | None = None
) -> tuple[FittedDisplay, Regressor]:
    """Fit the virtual image of `pinhole.direct_plane`, and a polynomial of the tangents that it leaves.

    Adapted: held-out camera positions choose the total degree; the fit minimises angles.

    Args:
        captures: of the panel.
        bundled: the polynomial is of pixel and point on the base plane, instead of pixel and viewpoint.
        degree: total degree of the polynomial; None for the one with the least error at held-out positions.

    Returns:
        The display, and image and polynomial as its regressor.

    Raises:
        BadInputError: the captures do not determine the virtual image.
    """
    image = direct_plane(captures)
    plane = choose_base_plane(captures.viewpoint, captures.eye_box)

    def fit(samples: Samples) -> Regressor:
        def seen(inputs: FloatArray) -> FloatArray:
            place = inputs[:, 2:]
            return image.tangents(inputs[:, :2], plane.lift(place) if bundled else place)

        trend = NumericRegressor(seen, samples.readings.box, 2, image.numbers)
        rest = fit_polynomial(samples, degree, trend)

        def value(inputs: FloatArray) -> FloatArray:
            return np.asarray(seen(inputs) + rest(inputs))

        return NumericRegressor(value, trend.box, 2, image.numbers + rest.numbers)

    return fit_structure(DISPLAY, captures, _structure(bundled), fit)


def wientapper_see_through(
    captures: SeeThroughCaptures, bundled: bool = False, degree: int | None = None
) -> tuple[FittedSeeThrough, Regressor]:
    """Fit a polynomial of the see-through deviation; see `wientapper_display`.

    Adapted: the paper corrects a display in front of a windscreen that is taken to be clear; this is its polynomial, in
    the same structure as the display's.

    Raises:
        BadInputError: the captures do not determine a see-through model.
    """

    def fit(samples: Samples) -> Regressor:
        return fit_polynomial(samples, degree)

    return fit_structure(SEE_THROUGH, captures, _structure(bundled), fit)


def fit_polynomial(samples: Samples, degree: int | None = None, trend: Regressor | None = None) -> Polynomial:
    """Least-squares polynomial of what a trend leaves, of a total degree.

    Without a degree it is the one with the least error at held-out positions. Of the polynomials of a degree that the
    readings do not determine, it is the one with the smallest coefficients.
    """
    readings, variables, blocks = samples.readings, len(samples.is_place), samples.readings.blocks
    most = degree or 1
    while degree is None and blocks * term_count(variables, most + 1) <= min(_MOST_COLUMNS, 0.8 * len(samples)):
        most += 1
    terms = term_count(variables, most)
    phi, target = basis(readings.inputs, total_degree(variables, most), readings.box), samples.target(trend)
    # All that the sums of squares of a fold need: a triangular matrix of the terms and of the target.
    roots = []
    for fold in range(FOLDS):
        rows = np.flatnonzero(samples.fold == fold)
        roots.append(_root(np.hstack([samples.design(phi[rows], rows), target[rows]])))

    def columns(order: int) -> IntArray:
        return np.concatenate([block * terms + np.arange(term_count(variables, order)) for block in range(blocks)])

    def solved(root: FloatArray, order: int) -> FloatArray:
        return np.asarray(np.linalg.lstsq(root[:, columns(order)], root[:, -2:], rcond=_RCOND)[0])

    def held_out_error(order: int) -> float:
        left = [
            out[:, columns(order)] @ solved(root, order) - out[:, -2:] for out, root in zip(roots, others, strict=True)
        ]
        return float(sum(np.sum(each**2) for each in left))

    best = degree
    if best is None:
        others = [_root(np.concatenate(roots[:fold] + roots[fold + 1 :])) for fold in range(FOLDS)]
        best = min(range(most + 1), key=held_out_error)
    found = samples.by_block(solved(_root(np.concatenate(roots)), best))
    return Polynomial(total_degree(variables, best), readings.box, np.ascontiguousarray(found))


def _root(rows: FloatArray) -> FloatArray:
    """Upper triangular, with the same products of columns."""
    return np.asarray(np.linalg.qr(rows, mode="r"))


def _structure(bundled: bool) -> str:
    return "planar" if bundled else "volumetric"
