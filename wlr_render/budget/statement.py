"""Statements about a population of registration errors: radii, shares, and what halving a source gives."""

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from wlr_render.mappings import Panel
from wlr_render.numerics.arrays import FloatArray, IntArray

_ANGLES = 16  # of a normal vector: more change nothing in four digits
_SHARE = 0.95  # of normal errors within the radius
_HALVINGS = 30  # of the interval in which a radius is sought


@dataclass(frozen=True)
class SourceShare:
    """What one source, or all sources of one owner, contribute.

    Attributes:
        name: of source or owner.
        rms_arcmin: of the length of its error over the population.
        worst_arcmin: rms length where it is largest.
        share: of the total variance, 0..1.
        radius_if_halved_arcmin: radius of 95 % if its standard deviation were half as large.
    """

    name: str
    rms_arcmin: float
    worst_arcmin: float
    share: float
    radius_if_halved_arcmin: float


def radius_within(covariance: FloatArray) -> FloatArray:
    """Radius (...) within which 95 % of normal errors lie, of populations (..., n) with covariances (..., n, 2, 2).

    The members of a population count alike; NaN ones do not count.
    """
    (xx, xy), (_, yy) = np.moveaxis(covariance, (-2, -1), (0, 1))
    mean, half = 0.5 * (xx + yy), np.hypot(0.5 * (xx - yy), xy)
    angle = np.pi * (np.arange(_ANGLES) + 0.5) / _ANGLES
    # A normal vector of length rho and angle a has the squared length rho^2 (mean + half cos 2a); rho is Rayleigh.
    squared = 2.0 * (mean[..., None] + half[..., None] * np.cos(2.0 * angle))
    squared = squared.reshape(*squared.shape[:-2], -1)
    low = np.zeros(squared.shape[:-1])
    high = np.sqrt(np.nanmax(squared, axis=-1) * -np.log(1.0 - _SHARE)) + 1e-12
    for _ in range(_HALVINGS):
        middle = 0.5 * (low + high)
        with np.errstate(divide="ignore"):
            outside = np.nanmean(np.exp(-(middle[..., None] ** 2) / np.maximum(squared, 1e-30)), axis=-1)
        too_small = outside > 1.0 - _SHARE
        low, high = np.where(too_small, middle, low), np.where(too_small, high, middle)
    return np.asarray(0.5 * (low + high))


REGIONS = ("centre", "edge", "corner")
"""Regions of a panel."""
_CENTRAL = 0.6  # of the half width and height


def region_of(panel: Panel, pixel: FloatArray) -> IntArray:
    """Region (...) of pixels (..., 2), an index into `REGIONS`: how many coordinates lie in the outer two fifths."""
    outer = np.abs(2.0 * pixel / panel.size_px - 1.0) > _CENTRAL
    return np.asarray(np.count_nonzero(outer, axis=-1))


def variance(covariance: FloatArray) -> FloatArray:
    """Mean square length (...) of errors with covariances (..., 2, 2)."""
    return np.asarray(np.trace(covariance, axis1=-2, axis2=-1))


def shares(by_source: Mapping[str, FloatArray]) -> list[SourceShare]:
    """Contribution of each source to a population (n, 2, 2), largest first."""
    total = sum(by_source.values())
    whole = float(np.nanmean(variance(np.asarray(total))))
    found = []
    for name, each in by_source.items():
        own = variance(each)
        mean = float(np.nanmean(own))
        halved = float(radius_within(total - 0.75 * each)) if mean else float(radius_within(np.asarray(total)))
        share = mean / whole if whole else 0.0
        found.append(SourceShare(name, mean**0.5, float(np.nanmax(own)) ** 0.5, share, halved))
    return sorted(found, key=lambda each: -each.share)


def by_owner(by_source: Mapping[str, FloatArray]) -> dict[str, FloatArray]:
    """Sums over the sources of each owner."""
    owned: dict[str, FloatArray] = {}
    for name, each in by_source.items():
        owner = name.partition(":")[0]
        owned[owner] = owned[owner] + each if owner in owned else each
    return owned
