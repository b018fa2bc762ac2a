"""Small neural networks of tanh units: as a regressor, as an offset from a static map, and as a decoder of maps.

As a regressor in the structure "planar" this is the ray bundle's form of the neural distortion field (NDF; see
`distortion_field`): the content of a pixel is constant along a ray, so that the field's sum along the ray is not
needed. `network_training` defines the layers and their training. Training ends after a process time, so that the
results of `network` and `offset_network` depend on the speed of the machine.
"""

from collections.abc import Callable

import numpy as np
from scipy.optimize import minimize

from benchmarks.rivals.map_tables import components_with_scores
from benchmarks.rivals.network_training import ProjectedLoss, TanhLayers, trained
from benchmarks.rivals.numeric_regressor import NumericRegressor
from benchmarks.rivals.samples import Samples
from wlr_render.numerics.arrays import FloatArray
from wlr_render.numerics.polynomial import Polynomial, basis, limited_orders

_UNITS = (32, 32)
_STATIC_DEGREE = 6
_DECAYS = (1e-6, 1e-4, 1e-2)  # decay of the decoder's weights, chosen by held-out positions
_COUNTS = (3, 6, 10, 14)
_DECODER_ITERATIONS = 60


def network(
    samples: Samples, seconds: float, trend_degree: int = 3, known: Polynomial | None = None
) -> NumericRegressor:
    """Fit tanh layers and a polynomial trend.

    Args:
        samples: samples to fit.
        seconds: process time of the training; see `network_training` for its effects.
        trend_degree: degree of the polynomial that is fitted together with the last layer.
        known: polynomial of the same inputs; the network is fitted to its residual.
    """
    return trained(samples, TanhLayers((len(samples.is_place), *_UNITS)), seconds, trend_degree, known)


def offset_network(samples: Samples, seconds: float) -> NumericRegressor:
    """Fit a network to the offset from a static map, the map of the most central camera position.

    HUDNet (Displays, 2023) and direct distortion prediction (Yu et al., Applied Optics 62(21) 5720, 2023) do so for
    head-up displays in the structure "volumetric", according to their abstracts; their layers and losses differ.
    """
    positions = range(int(samples.position.max()) + 1)
    place = samples.scaled[:, samples.is_place]
    distance = [np.linalg.norm(place[samples.position == each].mean(axis=0)) for each in positions]
    rows = np.flatnonzero(samples.position == int(np.argmin(distance)))
    places = int(samples.is_place.sum())
    orders = limited_orders(2, _STATIC_DEGREE, places, 0, _STATIC_DEGREE)
    by_column = np.empty_like(orders)
    by_column[:, ~samples.is_place], by_column[:, samples.is_place] = orders[:, :2], orders[:, 2:]
    box = samples.readings.box
    static = Polynomial(by_column, box, samples.solve(basis(samples.readings.inputs[rows], by_column, box), rows))
    return network(samples, seconds, trend_degree=0, known=static)


def decoded_components(samples: Samples) -> NumericRegressor:
    """Fit a decoder of maps: a network of the place gives the scores of the maps' principal components.

    It has the form of OSTNet (Someya et al., 2019): a network that returns a distortion map for a viewpoint. OSTNet's
    decoder was larger; held-out positions choose the number of components and the decay of the weights.
    """
    return components_with_scores(samples, _COUNTS, _DECAYS, _decoder)


def _decoder(place: FloatArray, scores: FloatArray, decay: float) -> tuple[Callable[[FloatArray], FloatArray], int]:
    """Fit scores (k, count) by a network of places (k, variables); also return the number of its numbers."""
    hidden = TanhLayers((place.shape[1], *_UNITS))
    size = float(np.sqrt(np.mean(scores**2))) or 1.0

    def terms(place: FloatArray) -> FloatArray:
        return np.column_stack([np.ones(len(place)), place])

    loss = ProjectedLoss(hidden, place, terms(place), np.ones((len(place), 1)), scores / size, decay)
    options = {"maxiter": _DECODER_ITERATIONS}
    start = hidden.start(np.random.default_rng(0), np.ones(place.shape[1]))
    weights = minimize(loss, start, jac=True, method="L-BFGS-B", options=options).x
    solution = loss.solved(weights) * size
    return (
        lambda wanted: np.hstack([hidden.values(weights, wanted)[-1], terms(wanted)]) @ solution,
        weights.size + solution.size,
    )
