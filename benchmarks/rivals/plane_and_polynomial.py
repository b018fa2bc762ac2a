"""A flat virtual image, and a polynomial for the rest: Wientapper et al.

F. Wientapper, H. Wuest, P. Rojtberg and D. Fellner, "A camera-based calibration for automotive augmented reality
head-up-displays", ISMAR 2013: a view-independent virtual plane, and a "generic five-variate" polynomial of pixel and
head position on top. With the point on the base plane in place of the position it has four variables: the bundled
variant, which they did not publish.
"""

import numpy as np

from benchmarks.rivals.numeric_regressor import NumericRegressor, Regressor
from benchmarks.rivals.pinhole import direct_plane
from benchmarks.rivals.samples import Samples, fit_structure
from wlr_render.calibration.fit_display import DISPLAY
from wlr_render.calibration.fit_see_through import SEE_THROUGH
from wlr_render.calibration.model_kinds import choose_base_plane
from wlr_render.captures.correspondences import DisplayCaptures, SeeThroughCaptures
from wlr_render.models.fitted_model import FittedDisplay, FittedSeeThrough
from wlr_render.numerics.arrays import FloatArray


def wientapper_display(
    captures: DisplayCaptures, bundled: bool = False, degree: int | None = None
) -> tuple[FittedDisplay, Regressor]:
    """Fit the virtual image of `pinhole.direct_plane`, and a polynomial for the rest of the view tangents.

    Adapted: held-out camera positions choose the total degree; the fit minimises angles.

    Args:
        captures: captures of the panel from two or more camera positions.
        bundled: True for a polynomial of pixel and point on the base plane, instead of pixel and viewpoint.
        degree: total degree of the polynomial; None for the degree with the least error at held-out positions.

    Returns:
        The display, and its regressor, which consists of image and polynomial.

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
        rest = samples.polynomial(degree, trend)

        def value(inputs: FloatArray) -> FloatArray:
            return np.asarray(seen(inputs) + rest(inputs))

        return NumericRegressor(value, trend.box, 2, image.numbers + rest.numbers)

    return fit_structure(DISPLAY, captures, _structure(bundled), fit)


def wientapper_see_through(captures: SeeThroughCaptures, bundled: bool = False) -> tuple[FittedSeeThrough, Regressor]:
    """Fit a polynomial of the see-through deviation; see `wientapper_display`.

    Adapted: the paper corrects a display and assumes that the windscreen does not refract; this is its polynomial, in
    the same structure as the display's.

    Raises:
        BadInputError: the captures do not determine a see-through model.
    """
    return fit_structure(SEE_THROUGH, captures, _structure(bundled), Samples.polynomial)


def _structure(bundled: bool) -> str:
    return "planar" if bundled else "volumetric"
