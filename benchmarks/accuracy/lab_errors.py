"""Errors of a workshop that only captures show: bumped visits, and noise that is heavy-tailed and correlated."""

from dataclasses import dataclass, field
from typing import ClassVar

import numpy as np
from scipy.spatial import cKDTree

from wlr_render.numerics.arrays import FloatArray
from wlr_render.simulation.workshop import PICTURE, SWITCHES, TAIL_DEGREES, Workshop, radius_of, rms, student

OF_NOISE = ("tails", "vignetting", "neighbours", "gross")
"""Names of the imperfections of the readings' noise."""
LAB_SWITCHES = (*SWITCHES, "bumped", *OF_NOISE)
"""Names of all imperfections."""
# Assumptions about noise
_CORRELATED = 0.5  # share of the noise variance that neighbouring readings have in common
_KERNEL_SPACINGS = 2.5  # radius of the kernel over the distance of neighbouring readings
_GROSS, _GROSS_CLUSTER, _GROSS_SIGMAS = 0.01, 5, (5.0, 20.0)
_RIM_STEEPNESS = 6  # power of the radius in the density of clusters of gross errors, which crowd at the rim


@dataclass(frozen=True)
class LabWorkshop(Workshop):
    """The imperfections of one bench, and the noise of its readings, which comes from the caller's generator.

    Attributes:
        switches: names of the imperfections that are on, some of `LAB_SWITCHES`.
        bump_um: smallest and largest displacement of a bumped visit at level 1.
    """

    switches: frozenset[str] = field(default_factory=lambda: frozenset(LAB_SWITCHES))
    bump_um: tuple[float, float] = (20.0, 50.0)
    KNOWN: ClassVar[tuple[str, ...]] = LAB_SWITCHES

    def bumps(self, count: int) -> FloatArray:
        """Return displacements (count, 3) of one or two bumped visits, metres; 0 for other visits."""
        rng = self._rng("bumped")
        shift, bumped = np.zeros((count, 3)), rng.permutation(count)[: rng.integers(1, 3)]
        direction = rng.standard_normal((len(bumped), 3))
        size = 1e-6 * self._factor("bumped") * rng.uniform(*self.bump_um, (len(bumped), 1))
        shift[bumped] = size * direction / np.linalg.norm(direction, axis=1, keepdims=True)
        return shift

    def noise(self, unit: FloatArray, rng: np.random.Generator) -> FloatArray:
        """Return the noise (n, 2) of the readings of one photograph, relative to its rms over the picture.

        Args:
            unit: (n, 2) image positions in half diagonals of the picture.
            rng: source of the noise.
        """
        tails, count = self._factor("tails"), len(unit)
        degrees = TAIL_DEGREES / tails if tails else np.inf
        noise = student(rng, (count, 2), degrees)
        shared = _CORRELATED * min(self._factor("neighbours"), 1.0)
        if shared and count > 1:
            noise = np.sqrt(1.0 - shared) * noise + np.sqrt(shared) * _neighbour_field(unit, rng, degrees)
        rim = self._factor("vignetting")
        size = 1.0 + rim * (1.0 / _light(unit) - 1.0)
        noise *= (size / rms(1.0 + rim * (1.0 / _light(PICTURE) - 1.0)))[:, None]
        for _ in range(rng.poisson(_GROSS * self._factor("gross") * count / _GROSS_CLUSTER)):
            weight = radius_of(unit) ** _RIM_STEEPNESS
            centre = unit[rng.choice(count, p=weight / weight.sum())]
            cluster = np.argsort(radius_of(unit - centre))[:_GROSS_CLUSTER]
            angle = rng.uniform(0.0, 2.0 * np.pi)
            noise[cluster] += rng.uniform(*_GROSS_SIGMAS) * np.array([np.cos(angle), np.sin(angle)])
        return noise


def _neighbour_field(unit: FloatArray, rng: np.random.Generator, degrees: float) -> FloatArray:
    """Return a random field (n, 2) of rms 1 at image positions (n, 2): white noise smoothed by a compact kernel."""
    low, high = unit.min(axis=0), unit.max(axis=0)
    spacing = max(float(np.sqrt(np.prod(high - low) / len(unit))), 1e-3)
    reach = _KERNEL_SPACINGS * spacing
    axes = [np.arange(a - reach, b + reach, spacing) for a, b in zip(low, high, strict=True)]
    node = np.stack(np.meshgrid(*axes), axis=-1).reshape(-1, 2)
    near = cKDTree(unit).sparse_distance_matrix(cKDTree(node), reach, output_type="coo_matrix").tocsr()
    near.data = 1.0 - (near.data / reach) ** 2
    return np.asarray(near @ student(rng, node.shape, degrees) / np.sqrt(near.multiply(near).sum(axis=1)))


def _light(unit: FloatArray) -> FloatArray:
    """Return the light (...) at image positions (..., 2): the fourth power of the cosine, and a shadow at the rim."""
    radius = radius_of(unit)
    return np.asarray((1.0 + 0.36 * radius**2) ** -2 * (1.0 - 0.35 / (1.0 + np.exp((0.8 - radius) / 0.07))))
