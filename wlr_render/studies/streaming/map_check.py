"""Whether a frame's map is that of its own viewpoint: against a start from nothing, and against the map before."""

from collections.abc import Mapping, Sequence

import numpy as np

from wlr_render.compositing.composed_frame import ComposedFrame
from wlr_render.compositing.compositor import Compositor
from wlr_render.geometry.directions import arcmin_between, dir_of_tangents
from wlr_render.mappings import FloatArray
from wlr_render.rendering.ray_field import NEAREST_M, RayField
from wlr_render.studies.streaming.records import MapCheck, Moment

Fields = Mapping[str, Sequence[RayField]]


def check_maps(
    compositor: Compositor, composed: ComposedFrame, moment: Moment, viewpoints_before: Mapping[str, FloatArray]
) -> list[MapCheck]:
    """Judge the maps of the frame just composed, one check per eye; it is composed again, and stays as it was."""
    own = _fields(composed)
    compositor.forget()
    kept = _fields(compositor.compose(pose=moment.at_scan_out, viewpoint=viewpoints_before))
    compositor.forget()
    cold = _fields(compositor.compose(pose=moment.at_scan_out))
    return [_checked(moment, eye, own[eye], kept[eye], cold[eye]) for eye in own]


def _fields(composed: ComposedFrame) -> Fields:
    return {name: eye.read_fields() for name, eye in composed.eyes.items()}


def _checked(
    moment: Moment, eye: str, own: Sequence[RayField], kept: Sequence[RayField], cold: Sequence[RayField]
) -> MapCheck:
    at = moment.eyes[eye]
    one_sided = sum(int((np.isnan(a.bend[0]) != np.isnan(b.bend[0])).sum()) for a, b in zip(own, cold, strict=True))
    kept_arcmin, own_arcmin = (max(map(arcmin_apart, fields, cold)) for fields in (kept, own))
    return MapCheck(moment.time_s, eye, at.moved_mm, kept_arcmin, own_arcmin, one_sided)


def arcmin_apart(field: RayField, truth: RayField) -> float:
    """The largest angle between a field's rays and those of the truth, as the truth's viewpoint sees it.

    Between the nearest depth and infinity: the difference in tangents is linear in 1/depth, hence largest at an end.
    NaN where no point has both rays.
    """
    seen, true = (_tangents(_from_viewpoint(each, truth)) for each in (field, truth))
    apart = arcmin_between(dir_of_tangents(seen), dir_of_tangents(true))
    return float(np.nanmax(apart)) if np.isfinite(apart).any() else float("nan")


def _from_viewpoint(field: RayField, other: RayField) -> FloatArray:
    """(4, height, width) `bend` of the same rays with the other field's viewpoint as the origin."""
    a, b, c, d = field.bend.astype(np.float64)
    x, y, z = field.device_from_camera.T @ (field.viewpoint_in_device - other.viewpoint_in_device)
    return np.stack([a, b, c + x + z * a, d + y + z * b])


def _tangents(bend: FloatArray) -> FloatArray:
    """(2, height, width, 2): under which tangents the rays' points at infinity and at the nearest depth are seen."""
    at_infinity = np.moveaxis(bend[:2], 0, -1)
    return np.stack([at_infinity, at_infinity + np.moveaxis(bend[2:], 0, -1) / NEAREST_M])
