"""Neural distortion field (NDF): Hiroi, Someya, Itoh, Optics Express 30(22) 40628, 2022, in its published form.

A network gives the panel's pixel U and an occupancy o at a point in space and a direction; the pixel of a view
direction t at a viewpoint v is the weighted sum along its ray, u(v, t) = sum over k of w_k U(point_k, t), with w the
softmax of o. So the backward map is explicit, and the forward map inverts it.

Reduced relative to the published method, so that a CPU trains it in seconds: layers of tanh units, four frequencies of
Fourier features, and few points on the ray at fixed inverse depths. Points are given by their tangents and inverse
depth from the eye box's centre, so that the ray may pass through infinity (a virtual image lies beyond it where the
light converges). U's last layer is linear; as the weights sum to one, u is linear in it, and training is by variable
projection, with squares in place of a robust loss. An affine function of (v, t) is added to the sum. We do not know
widths, encodings and training time of the original.

On a ray bundle the sum is not needed, because the pixel is constant along a ray: that variant is `networks.network` in
the structure "planar".
"""

from dataclasses import dataclass
from functools import cached_property

import numpy as np

from benchmarks.rivals.network_training import TanhLayers, trained
from benchmarks.rivals.numeric_regressor import Regressor
from benchmarks.rivals.samples import Samples, least_squares
from wlr_render.calibration.readings import FitReadings
from wlr_render.captures.correspondences import DisplayCaptures
from wlr_render.mappings import EyeBox, Panel
from wlr_render.models.fitted_model import Answer, FittedDisplay, joined
from wlr_render.models.inverse import solve_warm_then_cold
from wlr_render.numerics.arrays import FloatArray, IntArray
from wlr_render.numerics.polynomial import Box, Polynomial, basis, total_degree

_FREQUENCIES = 2.0 ** np.arange(4) * np.pi / 2.0
_DIOPTRES = np.linspace(-1.0, 4.0, 8)
_FIRST_ROWS = 1_000
_ROUNDING_PX = 1e-8
_START_DEGREE = 3


@dataclass(frozen=True, eq=False)
class RayLayers:
    """Hidden layers with last values (n, units) that are weighted sums of values at points along rays.

    They implement `network_training.Layers`. The flat weights are the weights of `hidden`, then the occupancy (units,).

    Attributes:
        units: number of units of each layer.
        box: bounds of (x, y, z, tx, ty): viewpoints in metres, and view tangents.
        centre: (3,) metres, origin of the points' tangents and inverse depths.
        dioptres: (k,) inverse depths of a ray's points from the viewpoint, 1/m.
    """

    units: tuple[int, ...]
    box: Box
    centre: FloatArray
    dioptres: FloatArray

    @property
    def sizes(self) -> tuple[int, ...]:
        """Numbers of inputs of each point, and of units of each layer."""
        return self.hidden.sizes

    @cached_property
    def hidden(self) -> TanhLayers:
        """Layers that are applied to each point."""
        return TanhLayers((5 * (1 + 2 * len(_FREQUENCIES)), *self.units))

    def start(self, rng: np.random.Generator, size: FloatArray) -> FloatArray:
        """Draw random weights (numbers,): small for high frequencies, and with the same occupancy for all points.

        `size` is not used.
        """
        by_frequency = np.concatenate([[1.0], np.tile(0.5 / (_FREQUENCIES / _FREQUENCIES[0]), 2)])
        return np.concatenate([self.hidden.start(rng, np.repeat(by_frequency, 5)), np.zeros(self.units[-1])])

    def features(self, inputs: FloatArray) -> FloatArray:
        """Return Fourier features (n * k, sizes[0]) of the points of rays (n, 5), which `box` scales to -1..1."""
        low, high = self.box.low, self.box.high
        metric = 0.5 * (low + high) + 0.5 * inputs * (high - low)
        offset, tangents = (metric[:, :3] - self.centre)[:, None], metric[:, None, 3:]
        near = self.dioptres[:, None]
        share = 1.0 - near * offset[..., 2:]  # ratio of the depths from the viewpoint and the centre
        at, seen_from_centre = near / share, (tangents + near * offset[..., :2]) / share
        scale = self.box.select((3, 4))
        least, most = self.dioptres.min(), self.dioptres.max()
        points = [scale.scaled(seen_from_centre), (2.0 * at - least - most) / (most - least)]
        direction = np.broadcast_to(inputs[:, None, 3:], (len(inputs), len(near), 2))
        raw = np.concatenate([*points, direction], axis=2).reshape(-1, 5)
        waves = [wave(frequency * raw) for wave in (np.sin, np.cos) for frequency in _FREQUENCIES]
        return np.hstack([raw, *waves])

    def values(self, weights: FloatArray, inputs: FloatArray) -> list[FloatArray]:
        """Return values of the points' layers (n * k, size), the points' shares (n, k), and the sums (n, units)."""
        found = self.hidden.values(weights[: self.hidden.numbers], self.features(inputs))
        occupancy = (found[-1] @ weights[self.hidden.numbers :]).reshape(len(inputs), -1)
        raised = np.exp(occupancy - occupancy.max(axis=1, keepdims=True))
        shares = raised / raised.sum(axis=1, keepdims=True)
        by_point = found[-1].reshape(*shares.shape, -1)
        return [*found, shares, np.asarray((shares[:, None] @ by_point)[:, 0])]

    def gradient(self, weights: FloatArray, values: list[FloatArray], by_last: FloatArray) -> FloatArray:
        """Return the derivative (numbers,) of a loss by the weights, from its derivative by the sums (n, units)."""
        *layers, shares, _ = values
        points = layers[-1].reshape(*shares.shape, -1)
        by_share = (points @ by_last[:, :, None])[..., 0]
        by_occupancy = shares * (by_share - np.sum(shares * by_share, axis=1, keepdims=True))
        occupancy = weights[self.hidden.numbers :]
        by_points = shares[..., None] * by_last[:, None] + by_occupancy[..., None] * occupancy
        found = self.hidden.gradient(weights[: self.hidden.numbers], layers, by_points.reshape(-1, len(occupancy)))
        return np.concatenate([found, np.ravel(by_occupancy) @ layers[-1]])


@dataclass(frozen=True)
class DistortionFieldDisplay(FittedDisplay):
    """`DisplayMapping` of a distortion field: the backward query is in closed form, and the forward query inverts it.

    The warm start of the forward query is the view tangents.

    Attributes:
        panel: the panel.
        eye_box: box of valid viewpoints.
        field: (x m, y m, z m, tx, ty) -> (u px, v px).
        forward_start: (u px, v px, x m, y m, z m) -> (tx, ty), where forward queries start.
    """

    panel: Panel
    eye_box: EyeBox
    field: Regressor
    forward_start: Polynomial

    def _forward(self, pixel: FloatArray, viewpoint: FloatArray, start: FloatArray | None) -> Answer:
        field_at = self.field.held((0, 1, 2), viewpoint)

        def residual(tangents: FloatArray, index: IntArray) -> tuple[FloatArray, FloatArray]:
            value, jacobian = field_at.with_jacobian(tangents, index)
            return value - pixel[index], jacobian

        root = solve_warm_then_cold(residual, start, self.forward_start(joined(pixel, viewpoint)), self.field.rounding)
        inside = self.field.box.contains(joined(viewpoint, root.unknown))
        return Answer(root.unknown, inside, root.converged, root.unknown)

    def _backward(self, tangents: FloatArray, viewpoint: FloatArray, _: FloatArray | None) -> Answer:
        inputs = joined(viewpoint, tangents)
        return Answer(self.field(inputs), self.field.box.contains(inputs))


def distortion_field(
    captures: DisplayCaptures, seconds: float, units: tuple[int, ...] = (32, 32, 32)
) -> DistortionFieldDisplay:
    """Fit a distortion field to captures of the panel, from viewpoints anywhere.

    Args:
        captures: captures of the panel.
        seconds: process time of the training, so that the result depends on the speed of the machine.
        units: number of units of each hidden layer.
    """
    inputs = joined(captures.viewpoint, captures.tangents)
    readings = FitReadings(
        inputs=inputs,
        is_place=np.array([True, True, True, False, False]),
        observed=captures.pixel,
        multiplier=np.ones((len(captures), 1)),
        metric=np.ones(len(captures)),
        sigma=captures.sigma_arcmin,
        capture=captures.capture,
        motion=None,
        orders=np.zeros((0, 5), np.int64),
    )
    samples = Samples(readings, np.unique(captures.capture, return_inverse=True)[1])
    layers = RayLayers(units, readings.box, captures.eye_box.centre, _DIOPTRES)
    field = trained(samples, layers, seconds, trend_degree=1, first_rows=_FIRST_ROWS, rounding=_ROUNDING_PX)
    backward = joined(captures.pixel, captures.viewpoint)
    box, orders = Box.around(backward), total_degree(5, _START_DEGREE)
    start = Polynomial(orders, box, least_squares(basis(backward, orders, box), captures.tangents))
    return DistortionFieldDisplay(captures.panel, captures.eye_box, field, start)
