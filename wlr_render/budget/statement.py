"""Figures of a population of registration errors: 95 % radius, share of each source, and the gain of halving it."""

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from wlr_render.mappings import Panel
from wlr_render.numerics.arrays import FloatArray, IntArray

_ANGLES = 16  # number of quadrature angles of a normal vector; more do not change four digits
_SHARE = 0.95  # share of the errors within the radius
_HALVINGS = 30  # bisection steps for a radius


@dataclass(frozen=True)
class SourceShare:
    """Contribution of one source, or of all sources of one owner.

    Attributes:
        name: name of the source or owner.
        rms_arcmin: rms length of its error over the population.
        worst_arcmin: largest rms length in the population.
        share: share of the total variance, 0..1.
        radius_if_halved_arcmin: 95 % radius of the total if the standard deviation of this source were halved.
    """

    name: str
    rms_arcmin: float
    worst_arcmin: float
    share: float
    radius_if_halved_arcmin: float


def radius_within(covariance: FloatArray) -> FloatArray:
    """Return the radius (...) that contains 95 % of the normal errors of populations with covariances (..., n, 2, 2).

    All members of a population have equal weight; NaN members are ignored.
    """
    (xx, xy), (_, yy) = np.moveaxis(covariance, (-2, -1), (0, 1))
    mean, half = 0.5 * (xx + yy), np.hypot(0.5 * (xx - yy), xy)
    angle = np.pi * (np.arange(_ANGLES) + 0.5) / _ANGLES
    # A unit normal vector of length rho (Rayleigh) and angle a gives the squared length rho^2 (mean + half cos 2a).
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
_CENTRAL = 0.6  # half width and half height of the centre, as a share of the panel's


def region_of(panel: Panel, pixel: FloatArray) -> IntArray:
    """Return the region (...) of pixels (..., 2): index into `REGIONS`, the number of coordinates in the outer 40 %."""
    outer = np.abs(2.0 * pixel / panel.size_px - 1.0) > _CENTRAL
    return np.asarray(np.count_nonzero(outer, axis=-1))


def variance(covariance: FloatArray) -> FloatArray:
    """Return the mean square length (...) of errors with covariances (..., 2, 2)."""
    return np.asarray(np.trace(covariance, axis1=-2, axis2=-1))


def shares(by_source: Mapping[str, FloatArray]) -> list[SourceShare]:
    """Return the contribution of each source to a population (n, 2, 2), largest first."""
    total = sum(by_source.values())
    whole = float(np.nanmean(variance(np.asarray(total))))
    rows = []
    for name, covariance in by_source.items():
        square = variance(covariance)
        mean = max(float(np.nanmean(square)), 0.0)  # interpolated covariances of small sources may be negative
        halved = float(radius_within(total - 0.75 * covariance)) if mean else float(radius_within(np.asarray(total)))
        share = mean / whole if whole else 0.0
        rows.append(SourceShare(name, mean**0.5, max(float(np.nanmax(square)), 0.0) ** 0.5, share, halved))
    return sorted(rows, key=lambda row: -row.share)


def by_owner(by_source: Mapping[str, FloatArray]) -> dict[str, FloatArray]:
    """Return the sum over the sources of each owner."""
    owned: dict[str, FloatArray] = {}
    for name, covariance in by_source.items():
        owner = name.partition(":")[0]
        owned[owner] = owned[owner] + covariance if owner in owned else covariance
    return owned
