"""A closed-form headset with pupil swim and bent see-through rays, for tests of drawing that must not know optics."""

from dataclasses import dataclass
from typing import NoReturn

import numpy as np
import pytest

from wlr_render.geometry import directions, rays
from wlr_render.mappings import Eye, EyeBox, Panel, QueryResult, Status
from wlr_render.numerics.arrays import FloatArray


@dataclass(frozen=True)
class CurvedImage:
    """Pixels lie on a curved virtual surface half a metre away; a hole can be punched into the panel."""

    panel: Panel
    hole_px: float = 0.0

    def view_dir_of_pixel(self, pixel: FloatArray, viewpoint: FloatArray, warm_start: object = None) -> QueryResult:
        pixel, viewpoint = np.broadcast_arrays(pixel / 1.0, np.zeros(2))[0], np.asarray(viewpoint)
        x, y = np.moveaxis((pixel / self.panel.size_px - 0.5) * [0.5, -0.4], -1, 0)
        point = np.stack([x * (1 + 2 * y * y), y * (1 + x), -0.5 + 0.6 * (x * x + y * y)], axis=-1)
        view_dir = directions.normalised(point - viewpoint)
        status = np.where(np.linalg.norm(pixel - self.panel.size_px / 2, axis=-1) < self.hole_px, Status.MISS, 0)
        return QueryResult(np.where(status[..., None], np.nan, view_dir), status.astype(np.uint8))

    def pixel_of_view_dir(self, view_dir: object, viewpoint: object, warm_start: object = None) -> NoReturn:
        raise NotImplementedError


@dataclass(frozen=True)
class LateralOffset:
    """A thick plate's effect: parallel rays, offset in proportion to the tangents, plus a small prism."""

    offset_m: float = 0.002
    prism: float = 0.003

    def real_ray_of_view_dir(
        self, view_dir: FloatArray, viewpoint: FloatArray, warm_start: object = None
    ) -> QueryResult:
        tangents = directions.tangents_of_dir(view_dir)
        offset = np.concatenate([self.offset_m * tangents, 0 * tangents[..., :1]], axis=-1)
        bent = directions.dir_of_tangents(tangents + [self.prism, 0.0])
        status = np.where(np.isfinite(tangents).all(-1), Status.OK, Status.MISS).astype(np.uint8)
        return QueryResult(rays.pack(viewpoint + offset, bent), status)

    def view_dir_of_real_point(self, point: object, viewpoint: object, warm_start: object = None) -> NoReturn:
        raise NotImplementedError


def make_headset(width: int = 96, height: int = 80, hole_px: float = 0.0) -> Eye:
    box = EyeBox(np.array([0.0, 0.0, 0.01]), np.array([0.010, 0.008, 0.006]))
    return Eye("toy", "right", CurvedImage(Panel(width, height), hole_px), LateralOffset(), box)


@pytest.fixture
def toy_headset() -> Eye:
    return make_headset()


@pytest.fixture
def toy_headset_with_hole() -> Eye:
    return make_headset(hole_px=5.0)
