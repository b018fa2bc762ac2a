"""Whitening: transforms readings with correlated errors to readings with independent errors.

Errors of a group of readings have the covariance 1 + U U': white noise of unit size, and the effect of a few random
numbers of unit size on the whole group (a motion of the camera, noise that neighbours share). With U = Q S R' the
readings are multiplied by 1 - Q (1 - 1 / sqrt(1 + S^2)) Q', the inverse root of that covariance.
"""

from collections.abc import Iterable
from dataclasses import dataclass

import numpy as np

from wlr_render.diagnosis.noise import Noise
from wlr_render.diagnosis.observations import Observations
from wlr_render.diagnosis.residual_surfaces import image_basis, photographs
from wlr_render.numerics.arrays import FloatArray, IntArray

_NEGLIGIBLE = 1e-4  # variance relative to white noise


@dataclass(frozen=True, eq=False)
class _Group:
    """Readings that have common errors.

    Attributes:
        rows: (m,) of the readings.
        axes: (m, q) directions of errors that are equal but independent in both image axes, or (2 m, q) of joint
            errors.
        taken: (q,) share of each axis to subtract.
    """

    rows: IntArray
    axes: FloatArray
    taken: FloatArray


@dataclass(frozen=True, eq=False)
class Whitening:
    """Linear map that makes errors independent and of unit size.

    Attributes:
        scale: (n,) factor of each reading.
        groups: readings with common errors, which are taken off one after the other.
    """

    scale: FloatArray
    groups: tuple[_Group, ...] = ()

    def __call__(self, values: FloatArray) -> FloatArray:
        """Values (n, 2) or (n, 2, p) in units of sigma, with independent errors of unit size."""
        white = values * self.scale.reshape(-1, *(1,) * (values.ndim - 1))
        for group in self.groups:
            mine = white[group.rows]
            flat = mine.reshape(len(group.axes), mine.size // len(group.axes))
            common = group.axes @ (group.taken[:, None] * (group.axes.T @ flat))
            white[group.rows] -= common.reshape(mine.shape)
        return white

    def then(self, rows: Iterable[IntArray], effects: Iterable[FloatArray]) -> "Whitening":
        """Return the whitening with groups of readings that have further common errors.

        Args:
            rows: (m,) of each group.
            effects: (m, 2, q) of each group's random numbers of unit size, on white readings.
        """
        groups = [_group(mine, effect.reshape(2 * len(mine), -1)) for mine, effect in zip(rows, effects, strict=True)]
        return Whitening(self.scale, (*self.groups, *(each for each in groups if each is not None)))


def _group(rows: IntArray, effects: FloatArray) -> _Group | None:
    squares, turn = np.linalg.eigh(effects.T @ effects)
    kept = squares > _NEGLIGIBLE
    if not kept.any():
        return None
    axes = effects @ (turn[:, kept] / np.sqrt(squares[kept]))
    return _Group(rows, axes, 1.0 - 1.0 / np.sqrt(1.0 + squares[kept]))


def shared_noise_whitening(observations: Observations, noise: Noise) -> Whitening:
    """Return the whitening of the noise that neighbouring readings share: its part that varies slowly over the image.

    Noise that varies faster than the polynomials of a smooth surface counts as white.
    """
    scale, groups = np.ones(len(observations)), []
    share = {part: noise.floor(part).shared for part in np.unique(observations.part)}
    for rows in photographs(observations) if any(share.values()) else ():
        part = observations.part[rows[0]]
        design = image_basis(observations, rows) if share[part] else None
        if design is None:
            continue
        place, axes = observations.image_place[rows], np.linalg.qr(design)[0]
        slow = axes.T @ noise.floor(part).shared_correlation(place) @ axes
        size, turn = np.linalg.eigh(share[part] * slow)
        effects = axes @ turn * np.sqrt(size.clip(0.0))
        white = (1.0 - np.sum(effects**2, axis=1)).clip(0.05)
        scale[rows] = 1.0 / np.sqrt(white)
        group = _group(rows, effects * scale[rows][:, None])
        if group is not None:
            groups.append(group)
    return Whitening(scale, tuple(groups))
