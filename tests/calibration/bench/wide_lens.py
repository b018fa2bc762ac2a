"""Views of a board by a lens of 120 or 180 degrees with an equisolid projection, which no kind of lens model is."""

from typing import Any

import numpy as np
from calibration.bench.imperfect_bench import turned
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from wlr_render.calibration.bench.board_views import EYEBALL, BoardView
from wlr_render.geometry import transforms
from wlr_render.numerics.arrays import FloatArray

SIZE = (1280, 1024)
CENTRE, ASPECT = np.array([645.3, 508.2]), np.array([1.0, 1.001])


class WideLens:
    """radius = 2 f sin(angle / 2), to `field_deg` across the width of the picture."""

    def __init__(self, field_deg: int) -> None:
        self.half = np.radians(field_deg / 2)
        self.focal = 0.5 * SIZE[0] / (2 * np.sin(self.half / 2))

    def pixel(self, point: FloatArray) -> FloatArray:
        across = np.linalg.norm(point[:, :2], axis=1)
        radius = 2 * self.focal * np.sin(0.5 * np.arctan2(across, point[:, 2]))
        return np.asarray(point[:, :2] * (radius / np.maximum(across, 1e-15))[:, None] * ASPECT + CENTRE)

    def direction(self, pixel: FloatArray) -> NDArray[Any]:
        away = (pixel - CENTRE) / ASPECT
        radius = np.linalg.norm(away, axis=1, keepdims=True)
        angle = 2 * np.arcsin(radius / (2 * self.focal))
        return np.concatenate([away / radius * np.sin(angle), np.cos(angle)], axis=1)

    def views(
        self, seed: int = 0, count: int = 14, noise_px: float = 0.02, dot_m: float = 1e-5, bow_m: float = 2e-4
    ) -> list[BoardView]:
        """A saddle of a board with dots off their places, from the middle of the picture to its edge."""
        rng = np.random.default_rng([seed, 8])
        column, row = np.meshgrid(np.arange(18), np.arange(14))
        feature = np.stack([column, row], axis=-1).reshape(-1, 2)
        nominal = np.concatenate([(feature - [8.5, 6.5]) * 0.02, np.zeros((len(feature), 1))], axis=1)
        x, y = (nominal[:, :2] / nominal[:, :2].max(axis=0)).T
        true = nominal + dot_m * rng.normal(size=nominal.shape)
        true[:, 2] += bow_m * (x**2 - y**2)
        views = []
        for i in range(count):
            off, around = 0.0 if i < 2 else self.half * rng.uniform(0.2, 0.85), 2.4 * i
            ahead = np.array([np.sin(off) * np.cos(around), np.sin(off) * np.sin(around), np.cos(off)])
            look = Rotation.align_vectors([ahead], [[0, 0, 1.0]])[0].as_matrix()
            tilt = turned(25 * np.cos(2.1 * i), 25 * np.sin(2.1 * i), 20 * i)
            point = transforms.apply(transforms.rigid(look @ tilt, 0.25 * (1 + 0.3 * (i % 3)) * ahead), true)
            pixel = self.pixel(point)
            inside = np.all((pixel > 5) & (pixel < np.array(SIZE) - 5), axis=1) & (feature.sum(axis=1) % 2 == 0)
            seen = pixel[inside] + noise_px * rng.normal(size=(inside.sum(), 2))
            sigma = np.full(len(seen), 0.02)
            views.append(BoardView(f"{i:02d}.png", EYEBALL, feature[inside], nominal[inside], seen, sigma))
        return views
