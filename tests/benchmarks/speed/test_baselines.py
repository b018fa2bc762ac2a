"""Baselines that do the same work as ours."""

from collections.abc import Callable
from typing import Any

import numpy as np
import pytest
from present import narrowed

from benchmarks.speed import offline
from benchmarks.speed.baselines import bare_gl_frame, raw_embree, shaded_gl_frame
from benchmarks.speed.workload import HEAD_POSE, bench_scene
from wlr_render.draw.gl_raster import GlRaster
from wlr_render.draw.ray_tracing import RayRenderer
from wlr_render.errors import MissingGlError
from wlr_render.gl import gl
from wlr_render.mappings import Eye
from wlr_render.scene.scene import Scene
from wlr_render.warp.raster_camera import EyePlan
from wlr_render.warp.ray_map import choose_plan, ray_map
from wlr_render.warp.view import GeometryImage, View


@pytest.fixture(scope="module")
def scene() -> Scene:
    return bench_scene()


def test_raw_embree_finds_what_our_tracer_finds(scene: Scene, small_panel_model: Eye) -> None:
    field = ray_map(small_panel_model, small_panel_model.eye_box.centre, choose_plan(small_panel_model))
    origin, direction = field.world_rays(HEAD_POSE)
    shares = narrowed(raw_embree(scene, origin, direction)(), list)
    raw = {key: np.concatenate([share[key] for share in shares]) for key in ("tfar", "primID")}
    ours = RayRenderer(scene).tracer.intersect(origin, direction)
    hit = np.isfinite(ours.distance)
    assert 0.15 < hit.mean() < 0.9
    # Ours asks Embree not to let rays slip through edges, which may decide a silhouette otherwise.
    assert (hit != (raw["primID"] >= 0)).sum() <= 2
    both = hit & (raw["primID"] >= 0)
    np.testing.assert_allclose(raw["tfar"][both], ours.distance[both], rtol=1e-5)
    assert (raw["primID"] == ours.triangle)[both].mean() > 0.999


@pytest.fixture(scope="module")
def ours(scene: Scene, small_panel_model: Eye) -> tuple[View, GeometryImage]:
    """Our picture from a view at the display's size, and that view."""
    try:
        context = gl.open_context("egl")
    except MissingGlError as error:
        pytest.skip(str(error))
    panel = small_panel_model.display.panel
    camera = EyePlan.of((small_panel_model,), (panel.width_px, panel.height_px), 1.0).camera
    axes = choose_plan(small_panel_model).device_from_camera
    view = View(offline._at_display_size(camera, panel), small_panel_model.eye_box.centre, HEAD_POSE, axes)
    with context:
        return view, GlRaster(context, scene).draw(view)


@pytest.mark.gl
@pytest.mark.parametrize("mirrored", [False, True])
@pytest.mark.parametrize("make", [bare_gl_frame, shaded_gl_frame])
def test_bare_opengl_frames_draw_our_silhouette_where_the_map_leads(
    scene: Scene, ours: tuple[View, GeometryImage], make: Callable[..., Any], mirrored: bool
) -> None:
    view, picture = ours
    shown = picture.inverse_depth > 0
    assert 0.1 < shown.mean() < 0.9
    own = np.stack(np.meshgrid((np.arange(90) + 0.5) / 90, (np.arange(100) + 0.5) / 100), axis=-1)
    run = make(scene, view, (1 - own if mirrored else own).astype(np.float32))
    drawn = np.frombuffer(run(), np.uint8).reshape(100, 90, 4)[..., :3].max(axis=-1) > 0
    assert (drawn != (shown[::-1, ::-1] if mirrored else shown)).mean() < 0.005
