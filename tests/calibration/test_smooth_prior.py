"""What is expected of optics before the readings."""

import numpy as np
from toy_device import display_captures, grid_in_plane

from wlr_render.calibration.fit_display import fit_display
from wlr_render.calibration.smooth_prior import smoothness_prior


def test_mixed_terms_are_expected_as_a_power_of_the_footprint_has_them():
    """(a u + b x)^4 (c v + d y)^2: its coefficients are products of binomial ones and powers of a, b, c and d."""
    readings = fit_display(display_captures(grid_in_plane(5, 5)), "planar", 6).smooth.readings
    prior = smoothness_prior(readings, moving=False)
    factors = {"lambda 0": 0.5, "lambda 1": 0.4, "mu 2": 0.3, "mu 3": 0.2}
    values = {name: -np.log(factors[name]) for name in factors} | {"footprint": 1.0}
    size = np.exp(prior.features @ [values.get(name, 0.0) for name in prior.names])
    power = np.polynomial.polynomial.polypow([1.0, 1.0], 4)
    for order, of_place in enumerate(power):
        (column,) = np.flatnonzero((readings.orders == [4 - order, 1, order, 1]).all(axis=1))
        assert np.isclose(size[column], of_place * 0.5 ** (4 - order) * 0.3**order * 2.0 * 0.4 * 0.2)
