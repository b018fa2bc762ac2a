"""A closed-form headset that answers all four questions, for tests that must not depend on the tracer."""

from dataclasses import dataclass, replace

import numpy as np

from wlr_render.geometry import directions, rays, transforms
from wlr_render.mappings import DisplayMapping, Eye, EyeBox, Panel, QueryResult, Status
from wlr_render.numerics.arrays import FloatArray


def mapped(value: FloatArray) -> QueryResult:
    status = np.where(np.isfinite(value).all(axis=-1), Status.OK, Status.MISS)
    return QueryResult(value, status.astype(np.uint8))


@dataclass(frozen=True)
class FlatImage:
    """The panel appears as a flat picture 2 m away, 1.4 m x 1.0 m."""

    panel: Panel
    distance_m: float = 2.0

    def view_dir_of_pixel(self, pixel: FloatArray, viewpoint: FloatArray, warm_start: object = None) -> QueryResult:
        xy = (np.asarray(pixel) / self.panel.size_px - 0.5) * [1.4, -1.0]
        point = np.concatenate([xy, np.full((*xy.shape[:-1], 1), -self.distance_m)], axis=-1)
        return mapped(directions.normalised(point - viewpoint))

    def pixel_of_view_dir(self, view_dir: FloatArray, viewpoint: FloatArray, warm_start: object = None) -> QueryResult:
        depth = np.asarray(viewpoint)[..., 2:] + self.distance_m
        xy = np.asarray(viewpoint)[..., :2] + depth * directions.tangents_of_dir(np.asarray(view_dir))
        return mapped((xy / [1.4, -1.0] + 0.5) * self.panel.size_px)


@dataclass(frozen=True)
class PrismPlate:
    """At a plane in front of the eye, rays are offset in proportion to their tangents and bent by a constant."""

    offset_m: float = 0.002
    prism: float = 0.003
    z_m: float = -0.02

    def real_ray_of_view_dir(
        self, view_dir: FloatArray, viewpoint: FloatArray, warm_start: object = None
    ) -> QueryResult:
        tangents = directions.tangents_of_dir(np.asarray(view_dir))
        lateral = viewpoint[..., :2] + (viewpoint[..., 2:] - self.z_m + self.offset_m) * tangents
        origin = np.concatenate([lateral, np.full((*lateral.shape[:-1], 1), self.z_m)], axis=-1)
        return mapped(rays.pack(origin, directions.dir_of_tangents(tangents + [self.prism, 0.0])))

    def view_dir_of_real_point(
        self, point: FloatArray, viewpoint: FloatArray, warm_start: object = None
    ) -> QueryResult:
        point, viewpoint = np.asarray(point), np.asarray(viewpoint)
        bent = (self.z_m - point[..., 2:]) * [self.prism, 0.0]
        depth = viewpoint[..., 2:] - point[..., 2:] + self.offset_m
        return mapped(directions.dir_of_tangents((point[..., :2] - viewpoint[..., :2] - bent) / depth))


@dataclass(frozen=True)
class TurnedDisplay:
    """A display that shows each pixel turned by a rotation about the viewpoint."""

    display: DisplayMapping
    rotation: FloatArray

    @property
    def panel(self) -> Panel:
        return self.display.panel

    def view_dir_of_pixel(self, pixel: FloatArray, viewpoint: FloatArray, warm_start: object = None) -> QueryResult:
        seen = self.display.view_dir_of_pixel(pixel, viewpoint)
        return replace(seen, value=transforms.rotate(self.rotation, seen.value))

    def pixel_of_view_dir(self, view_dir: FloatArray, viewpoint: FloatArray, warm_start: object = None) -> QueryResult:
        return self.display.pixel_of_view_dir(transforms.rotate(self.rotation.T, view_dir), viewpoint)


def flat_image_eye() -> Eye:
    """Return a right eye behind a prism plate."""
    box = EyeBox(np.array([0.001, -0.002, 0.01]), np.array([0.010, 0.008, 0.006]))
    return Eye("flat image", "right", FlatImage(Panel(140, 100)), PrismPlate(), box)
