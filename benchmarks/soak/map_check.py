"""Check that a frame's map belongs to its viewpoint: against an exact solve, and against the previous map.

Some frames of a stream are drawn again for the check, each after its predecessor. In the stream itself, fetching maps
would cost time and memory that a real-time program does not spend.
"""

from collections.abc import Iterator, Mapping, Sequence

import numpy as np

from benchmarks.scene_source import SceneSource
from benchmarks.soak.records import MapCheck, StreamFrame
from wlr_render.geometry.directions import arcmin_between, dir_of_tangents
from wlr_render.numerics.arrays import FloatArray
from wlr_render.warp.compositor import Compositor
from wlr_render.warp.raster_camera import EyePlan
from wlr_render.warp.ray_map import NEAREST_M, RayMap, solve_pixels

CHECKED = 5
"""Number of checked frames with the farthest jumps, and approximate number without a jump."""

Fields = Mapping[str, Sequence[RayMap]]


def frames_to_check(moments: Sequence[StreamFrame]) -> list[int]:
    """Return the numbers of the frames with the farthest jumps and of about as many others, evenly spread; never 0."""
    jumps = [number for number, moment in enumerate(moments) if number and moment.jumped]
    rest = [number for number, moment in enumerate(moments) if number and not moment.jumped]
    jumps.sort(key=lambda number: -max(eye.moved_mm for eye in moments[number].eyes.values()))
    every = max(1, -(-len(rest) // CHECKED))
    return sorted([*jumps[:CHECKED], *rest[::every]])


def check_maps(
    compositor: Compositor, source: SceneSource, moments: Sequence[StreamFrame], numbers: Sequence[int]
) -> Iterator[list[MapCheck]]:
    """Draw the numbered frames and their predecessors again; yield a check per eye for each frame."""
    for number in numbers:
        kept = _maps(compositor, source, moments[number - 1])
        own = _maps(compositor, source, moments[number])
        moment = moments[number]
        yield [
            _checked(moment, eye, own[eye], kept[eye], _exact(compositor.plan(eye), moment.viewpoints[eye]))
            for eye in own
        ]


def _exact(plan: EyePlan, viewpoint: FloatArray) -> list[RayMap]:
    """Solve every point of the warp grid on the CPU, in float64."""
    axes, pixel = plan.device_from_camera, plan.warp_grid.grid.panel_pixel()
    solved = [solve_pixels(mappings, axes, pixel, viewpoint) for mappings in plan.channels]
    return [
        RayMap(viewpoint, axes, np.moveaxis(each.slope_offset, -1, 0).astype(np.float32), each.status)
        for each in solved
    ]


def _maps(compositor: Compositor, source: SceneSource, moment: StreamFrame) -> Fields:
    for camera in compositor.begin_frame(moment.world_from_device, moment.viewpoints).values():
        source.submit(camera)
    composed = compositor.compose(pose=moment.at_scan_out)
    return {name: eye.read_ray_maps() for name, eye in composed.eyes.items()}


def _checked(
    moment: StreamFrame, eye: str, own: Sequence[RayMap], kept: Sequence[RayMap], exact: Sequence[RayMap]
) -> MapCheck:
    one_sided = sum(
        int((np.isnan(a.slope_offset[0]) != np.isnan(b.slope_offset[0])).sum()) for a, b in zip(own, exact, strict=True)
    )
    kept_arcmin, own_arcmin = (max(map(arcmin_apart, fields, exact)) for fields in (kept, own))
    return MapCheck(moment.time_s, eye, moment.eyes[eye].moved_mm, kept_arcmin, own_arcmin, one_sided)


def arcmin_apart(field: RayMap, truth: RayMap) -> float:
    """Return the largest angle between the rays of a field and the true rays, seen from the true viewpoint.

    It covers distances from the nearest depth to infinity: the difference in tangents is linear in 1/depth, hence
    largest at an end. NaN if no point has both rays.
    """
    seen, true = (_tangents(_from_viewpoint(each, truth)) for each in (field, truth))
    apart = arcmin_between(dir_of_tangents(seen), dir_of_tangents(true))
    return float(np.nanmax(apart)) if np.isfinite(apart).any() else float("nan")


def _from_viewpoint(field: RayMap, other: RayMap) -> FloatArray:
    """Return `slope_offset` (4, height, width) of the same rays with the other field's viewpoint as the origin."""
    a, b, c, d = field.slope_offset.astype(np.float64)
    x, y, z = field.device_from_camera.T @ (field.viewpoint_in_device - other.viewpoint_in_device)
    return np.stack([a, b, c + x + z * a, d + y + z * b])


def _tangents(slope_offset: FloatArray) -> FloatArray:
    """Return the tangents (2, height, width, 2) of the rays' points at infinity and at the nearest depth."""
    at_infinity = np.moveaxis(slope_offset[:2], 0, -1)
    return np.stack([at_infinity, at_infinity + np.moveaxis(slope_offset[2:], 0, -1) / NEAREST_M])
