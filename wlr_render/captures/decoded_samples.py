"""A decoded picture thinned out to what a fit needs: panel positions at some camera pixels, averaged over windows.

A million neighbouring pixels say little more than a thousand windows of them, each with the noise of its mean.
"""

from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from wlr_render.captures.decoded import Decoded
from wlr_render.numerics.arrays import FloatArray

_CLIP = 4.0  # a pixel further than this from its window's plane, in the window's own robust scale, is left out
_RIM_PX = 2  # camera pixels beside a rejected one that are not used
_ROUNDS = 5  # strays bend the plane that they are judged by: the worst go first
_MAD = 1.4826  # median absolute deviation to standard deviation


@dataclass(frozen=True, eq=False)
class DecodedSamples:
    """Panel positions at camera pixels.

    Attributes:
        camera_pixel: (n, 2) middles of camera pixels.
        panel_pixel: (n, 2) what they show.
        sigma_px: (n,) standard deviation of `panel_pixel` per axis, panel pixels.
        scale: (n,) panel pixels per camera pixel.
    """

    camera_pixel: FloatArray
    panel_pixel: FloatArray
    sigma_px: FloatArray
    scale: FloatArray

    def __len__(self) -> int:
        return len(self.camera_pixel)


def sample(decoded: Decoded, count: int = 1500, reach_px: int = 4, filled: float = 0.6) -> DecodedSamples:
    """Take about `count` samples over the accepted part of a picture, each from a plane fitted to its window.

    Args:
        decoded: the picture.
        count: how many samples, about.
        reach_px: the window is 2 reach + 1 camera pixels wide.
        filled: share of a window's pixels that must be accepted.
    """
    height, width = decoded.rejection.shape
    every = max(1, int(np.sqrt(np.count_nonzero(decoded.accepted) / count)))
    steps = np.arange(-reach_px, reach_px + 1)
    v, u = np.mgrid[reach_px : height - reach_px : every, reach_px : width - reach_px : every].reshape(2, -1)
    # Beside rejected pixels, the panel's edge above all, blur has mixed in what is not seen whole.
    inner = cv2.erode(decoded.accepted.astype(np.uint8), np.ones((2 * _RIM_PX + 1,) * 2, np.uint8)).astype(bool)
    wanted = np.asarray(inner[v, u])
    v, u = v[wanted], u[wanted]
    dv, du = (offset.ravel() for offset in np.meshgrid(steps, steps, indexing="ij"))
    panel = decoded.pixel[v[:, None] + dv, u[:, None] + du].astype(np.float64)
    good = np.asarray(inner[v[:, None] + dv, u[:, None] + du])
    enough = np.asarray(good.mean(axis=1) >= filled)
    u, v, panel, good = u[enough], v[enough], panel[enough], good[enough]
    kept = good
    planes, residual = _planes(panel, kept, du, dv)
    for _ in range(_ROUNDS):
        away = np.abs(residual).max(axis=-1)
        scatter = _MAD * np.nanmedian(np.where(kept, away, np.nan), axis=1)
        kept = good & (away <= _CLIP * np.maximum(scatter, 1e-9)[:, None])
        planes, residual = _planes(panel, kept, du, dv)
    number = kept.sum(axis=1)
    variance = np.sum(np.where(kept[..., None], residual, 0.0) ** 2, axis=(1, 2)) / (2 * (number - 3))
    return DecodedSamples(
        camera_pixel=np.stack([u, v], axis=-1) + 0.5,
        panel_pixel=planes[:, 0],
        sigma_px=np.sqrt(variance / number),
        scale=np.sqrt(np.abs(np.linalg.det(planes[:, 1:]))),
    )


def _planes(
    panel: FloatArray, kept: NDArray[np.bool_], du: NDArray[np.int64], dv: NDArray[np.int64]
) -> tuple[FloatArray, FloatArray]:
    """Least-squares planes (n, 3, 2), constant first, of windows (n, m, 2), and what they leave (n, m, 2)."""
    basis = np.stack([np.ones(len(du)), du, dv], axis=-1)
    weight = kept.astype(np.float64)
    values = np.where(kept[..., None], panel, 0.0)
    normal = np.einsum("nm,mi,mj->nij", weight, basis, basis)
    planes = np.linalg.solve(normal, np.einsum("mi,nmk->nik", basis, values))
    return planes, panel - basis @ planes
