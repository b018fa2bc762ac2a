"""Errors of a fixed map: from interpolation between its points, and from another pupil position.

Runtimes such as Monado (src/xrt/auxiliary/util/u_distortion_mesh.c, src/xrt/compositor/shaders) compute a distortion
map once: for points on the panel, where in the picture each colour is read. Between the points, it is interpolated. The
map depends on neither depth nor pupil, and the picture is drawn from the eye position for which the map was computed.

The error is as follows. Let v0 be that position and R the picture's axes; at tangents t, the picture shows the points
X(t, Z) = v0 + R (Z tx, Z ty, -Z). At pixel p the interpolated map has tangents m(p): the panel's pixel p shows the
point X(m(p), Z) if there is a surface at it. An eye at v sees the light of pixel p in the direction d(p, v) of the
display mapping, and the real X in the direction s(X, v) of the see-through mapping. The error is the angle between the
directions d(p, v) and s(X(m(p), Z), v): the misalignment of `evaluation.misalignment`, for the world at depth Z.

With v = v0, and at the map's points, the error is zero if m is where the exact ray (a, b, c, d) of `RayMap` passes
the depth Z, m = (a + c / Z, b + d / Z): only the interpolation error remains. A runtime's map is the one for
Z = infinity, and is thus wrong for nearer points by the rays' offset (c, d), even at v0.
"""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from wlr_render.errors import BadInputError
from wlr_render.evaluation.metrics import summary
from wlr_render.evaluation.misalignment import misalignment_arcmin
from wlr_render.geometry import transforms
from wlr_render.geometry.pinhole import Pinhole
from wlr_render.mappings import Eye
from wlr_render.numerics.arrays import FloatArray
from wlr_render.report.blocks import Cell, ReportTable
from wlr_render.warp.choose_grid import choose_warp_grid
from wlr_render.warp.grid import WarpGrid
from wlr_render.warp.ray_map import middle_axes, solve_pixels

Interpolation = Callable[[FloatArray, FloatArray], FloatArray]
"""Function of values (rows, columns, k) and positions (..., 2), in cells from the first point; returns (..., k)."""

DEPTHS_M = (0.5, 2.0, np.inf)
_FAR_M = 1e6  # distance used for infinity: a centimetre off the line of sight is 3e-5 arcminutes there
_PIXELS, _VIEWPOINTS = 2000, 8


def on_triangles(values: FloatArray, place: FloatArray) -> FloatArray:
    """Interpolate like a mesh of triangles: each cell is cut from its upper right to its lower left corner."""
    (first, right, lower, last), (x, y) = _corners(values, place)
    upper = first + x * (right - first) + y * (lower - first)
    return np.where(x + y <= 1.0, upper, last + (1.0 - x) * (lower - last) + (1.0 - y) * (right - last))


def bilinear(values: FloatArray, place: FloatArray) -> FloatArray:
    """Interpolate like a texture filter, with exact weights."""
    (first, right, lower, last), (x, y) = _corners(values, place)
    return np.asarray((1 - y) * ((1 - x) * first + x * right) + y * ((1 - x) * lower + x * last))


def _corners(values: FloatArray, place: FloatArray) -> tuple[list[FloatArray], list[FloatArray]]:
    """Return the values around each position (first, right, lower, last) and its offsets right and down, (..., 1)."""
    rows, columns = values.shape[:2]
    cell = np.clip(np.floor(place).astype(int), 0, [columns - 2, rows - 2])
    column, row = cell[..., 0], cell[..., 1]
    corners = [values[row + down, column + right] for down in (0, 1) for right in (0, 1)]
    return corners, np.split(place - cell, 2, axis=-1)


@dataclass(frozen=True)
class Scheme:
    """A runtime's map scheme: the number of points along each side of its grid, and the interpolation between them."""

    name: str
    points: int
    between: Interpolation


MESH = Scheme("mesh of 64 x 64 cells", 65, on_triangles)
IMAGE_MAPS = Scheme("maps of 128 x 128 texels", 128, bilinear)


@dataclass(frozen=True, eq=False)
class FrozenMap:
    """A map computed for one viewpoint.

    Attributes:
        scheme: how the map is interpolated.
        viewpoint: (3,) position in the device frame for which the map was computed and from which its picture is drawn.
        device_from_camera: (3, 3) axes of the picture.
        warp_grid: the map's points on the panel.
        tangents: (points, points, 2) tangents at which the picture is read, for the warp grid's points.
    """

    scheme: Scheme
    viewpoint: FloatArray
    device_from_camera: FloatArray
    warp_grid: WarpGrid
    tangents: FloatArray

    def tangents_of_pixel(self, pixel: FloatArray) -> FloatArray:
        """Return the tangents (..., 2) at which the scheme reads the picture for pixels (..., 2)."""
        place = (pixel - self.warp_grid.first_px) / self.warp_grid.step_px
        return self.scheme.between(self.tangents, place)

    def texture_uv(self, camera: Pinhole) -> NDArray[np.float32]:
        """Return the points' texture coordinates in a picture of that camera, top row first: (points, points, 2)."""
        return (camera.pixel_of_tangents(self.tangents) / [camera.width_px, camera.height_px]).astype(np.float32)


def frozen_map(
    mappings: Eye,
    scheme: Scheme,
    viewpoint: FloatArray,
    device_from_camera: FloatArray,
    depth_m: float = np.inf,
) -> FrozenMap:
    """Return the map for a viewpoint (3,), exact at its points for objects at `depth_m` in front of it.

    Raises:
        BadInputError: the eye does not see the world through some point of the panel.
    """
    warp_grid = WarpGrid.edge_to_edge(mappings.display.panel, scheme.points, scheme.points)
    slope_offset = solve_pixels(mappings, device_from_camera, warp_grid.panel_pixel(), viewpoint).slope_offset
    if not np.isfinite(slope_offset).all():
        raise BadInputError(
            f"{mappings.name}: parts of the panel have no ray from {np.round(viewpoint * 1e3, 2)} mm, so that a map of "
            f"{scheme.points} x {scheme.points} points has holes; choose a headset whose whole panel is seen."
        )
    return FrozenMap(
        scheme, viewpoint, device_from_camera, warp_grid, slope_offset[..., :2] + slope_offset[..., 2:] / depth_m
    )


def frozen_map_error_arcmin(
    truth: Eye, shown: FrozenMap, viewpoint: FloatArray, pixel: FloatArray, depth_m: float
) -> FloatArray:
    """Return the angle between the apparent directions of a pixel's content and of the real point; see the module.

    Args:
        truth: the true mappings of the eye.
        shown: the map that is judged.
        viewpoint: (..., 3) position of the eye.
        pixel: (..., 2).
        depth_m: depth of the world along the picture's axis, from the viewpoint of the picture; may be infinite.

    Returns:
        Angles (...) in arcminutes; NaN if the eye does not see the pixel or the point.
    """
    tangents = shown.tangents_of_pixel(pixel)
    in_camera = np.concatenate([tangents, -np.ones((*tangents.shape[:-1], 1))], axis=-1) * min(depth_m, _FAR_M)
    point = transforms.apply(transforms.rigid(shown.device_from_camera, shown.viewpoint), in_camera)
    return misalignment_arcmin(truth, viewpoint, pixel, point)


def frozen_map_table(mappings: Eye) -> ReportTable:
    """Tabulate the errors of both schemes on a headset with exact `mappings`: rms and largest, in arcminutes."""
    rows = [row for scheme in (MESH, IMAGE_MAPS) for row in (_interpolation(mappings, scheme), _swim(mappings, scheme))]
    rows.append(_followed(mappings))
    columns = ("map", *(f"{what} at {depth:g} m" for depth in DEPTHS_M for what in ("rms", "max")))
    notes = (
        f"Arcminutes at {_PIXELS} pixels. At its own viewpoint: a map for each depth, seen from where it was computed.",
        f"Frozen: the map for infinity at the eye box's centre, seen from {_VIEWPOINTS} other places in the eye box.",
        "Ours: a field of rays for each of those places, interpolated between its points as the shader does it.",
    )
    return ReportTable(f"What a map computed once gets wrong: {mappings.name}", columns, rows, notes)


def _interpolation(mappings: Eye, scheme: Scheme) -> list[Cell]:
    centre, axes, pixel = mappings.eye_box.centre, middle_axes(mappings), _judged_pixels(mappings)
    maps = {depth: frozen_map(mappings, scheme, centre, axes, depth) for depth in DEPTHS_M}
    errors = [frozen_map_error_arcmin(mappings, shown, centre, pixel, depth) for depth, shown in maps.items()]
    return [f"{scheme.name}, at its own viewpoint", *_rms_and_max(errors)]


def _swim(mappings: Eye, scheme: Scheme) -> list[Cell]:
    pixel, viewpoint = _judged_pixels(mappings), _other_viewpoints(mappings)[:, None]
    shown = frozen_map(mappings, scheme, mappings.eye_box.centre, middle_axes(mappings))
    errors = [frozen_map_error_arcmin(mappings, shown, viewpoint, pixel, depth) for depth in DEPTHS_M]
    return [f"{scheme.name}, frozen", *_rms_and_max(errors)]


def _followed(mappings: Eye) -> list[Cell]:
    """Tabulate the error if the map follows the eye: the interpolation error of the compositor's warp grid."""
    axes, pixel = middle_axes(mappings), _judged_pixels(mappings)
    warp_grid = choose_warp_grid(mappings, axes).grid
    viewpoints = _other_viewpoints(mappings)
    at_points = [solve_pixels(mappings, axes, warp_grid.panel_pixel(), each).slope_offset for each in viewpoints]
    slope_offsets = [warp_grid.interpolated(np.moveaxis(each, -1, 0), pixel) for each in at_points]
    errors = []
    for depth in DEPTHS_M:
        points = [
            _on_rays(slope_offset, depth, axes, at) for slope_offset, at in zip(slope_offsets, viewpoints, strict=True)
        ]
        errors.append(misalignment_arcmin(mappings, viewpoints[:, None], pixel, np.stack(points)))
    return [f"ours, {warp_grid.columns} x {warp_grid.rows} points, for every viewpoint", *_rms_and_max(errors)]


def _on_rays(
    slope_offset: FloatArray, depth_m: float, device_from_camera: FloatArray, viewpoint: FloatArray
) -> FloatArray:
    """Return the points (n, 3), device frame, at which rays (n, 4) of a viewpoint pass a depth."""
    depth = min(depth_m, _FAR_M)
    xy = slope_offset[:, :2] * depth + slope_offset[:, 2:]
    in_camera = np.concatenate([xy, np.full((len(slope_offset), 1), -depth)], axis=-1)
    return transforms.apply(transforms.rigid(device_from_camera, viewpoint), in_camera)


def _other_viewpoints(mappings: Eye) -> FloatArray:
    """Return viewpoints (n, 3) all over the eye box."""
    return mappings.eye_box.at(np.random.default_rng(9).uniform(-1, 1, (_VIEWPOINTS, 3)))


def _judged_pixels(mappings: Eye) -> FloatArray:
    """Return the centres (n, 2) of pseudo-random pixels, so that they cannot align with the points of a map."""
    return np.floor(np.random.default_rng(8).uniform(0, mappings.display.panel.size_px, (_PIXELS, 2))) + 0.5


def _rms_and_max(errors: list[FloatArray]) -> list[Cell]:
    return [figure for each in map(summary, errors) for figure in (each.rms, each.maximum)]
