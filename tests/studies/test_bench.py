"""The measuring, not the measurements: baselines that do the same work, an error that is one, a scene that is there."""

import multiprocessing
from concurrent.futures import ProcessPoolExecutor

import numpy as np
import pytest

from wlr_render.errors import MissingGlError
from wlr_render.mappings import Panel
from wlr_render.rendering import gl
from wlr_render.rendering.painters import TracedPainter, WarpedPainter
from wlr_render.rendering.raster import GlRaster
from wlr_render.rendering.rasteriser import open_rasteriser
from wlr_render.rendering.ray_field import NEAREST_M, choose_plan, ray_field
from wlr_render.rendering.ray_render import RayRenderer
from wlr_render.rendering.view import View
from wlr_render.studies import bench
from wlr_render.studies.bench_baselines import bare_gl_frame, raw_embree


@pytest.fixture(scope="module")
def scene():
    return bench.bench_scene()


def test_the_workload_is_a_hundred_thousand_triangles_large_in_the_field(scene, small_panel_model):
    assert 95_000 < scene.triangle_count < 105_000
    frame = TracedPainter(small_panel_model, RayRenderer(scene)).paint(
        small_panel_model.eye_box.centre, bench.HEAD_POSE, with_geometry=True
    )
    assert 0.15 < np.isfinite(frame.position[..., 0]).mean() < 0.9


def test_another_number_of_pixels_is_the_same_panel(small_panel_model):
    other = bench.bench_model(Panel(180, 50))
    viewpoint = small_panel_model.eye_box.at(np.array([0.5, -0.5, 0.5]))
    place = np.random.default_rng(7).uniform(0.1, 0.9, (20, 2))
    first, second = (
        eye.display.view_dir_of_pixel(place * eye.display.panel.size_px, viewpoint).value
        for eye in (small_panel_model, other)
    )
    assert np.linalg.norm(first - second, axis=-1).max() < 1e-9


def test_the_fast_map_is_exact_to_a_fiftieth_of_a_pixel(small_panel_model):
    viewpoint = small_panel_model.eye_box.at(np.array([0.9, 0.9, -0.9]))
    assert 0 < bench.map_error_px(small_panel_model, viewpoint) < 0.02


@pytest.mark.parametrize("component", [0, 3])
def test_the_maps_error_is_that_of_its_worst_pixel(small_panel_model, monkeypatch, component):
    """One pixel is moved by a third of a pixel, at infinity by its tangent or at 0.25 m by its offset."""

    def with_a_fault(mappings, viewpoint, plan):
        field = ray_field(mappings, viewpoint, plan)
        a, b = field.bend[0, 40, 30:32], field.bend[1, 40:42, 30]
        pixel_size = min(abs(np.diff(a)[0]), abs(np.diff(b)[0]))
        field.bend[component, 40, 30] += pixel_size / 3 * (1.0 if component == 0 else NEAREST_M)
        return field

    monkeypatch.setattr(bench, "ray_field", with_a_fault)
    error = bench.map_error_px(small_panel_model, small_panel_model.eye_box.centre)
    assert error == pytest.approx(1 / 3, rel=0.1)


def test_raw_embree_finds_what_our_tracer_finds(scene, small_panel_model):
    field = ray_field(small_panel_model, small_panel_model.eye_box.centre, choose_plan(small_panel_model))
    origin, direction = field.world_rays(bench.HEAD_POSE)
    shares = raw_embree(scene, origin, direction)()
    raw = {key: np.concatenate([share[key] for share in shares]) for key in ("tfar", "primID")}
    ours = RayRenderer(scene).tracer.intersect(origin, direction)
    hit = np.isfinite(ours.distance)
    assert 0.15 < hit.mean() < 0.9
    # Ours asks Embree not to let rays slip through edges, which may decide a silhouette otherwise.
    assert (hit != (raw["primID"] >= 0)).sum() <= 2
    both = hit & (raw["primID"] >= 0)
    np.testing.assert_allclose(raw["tfar"][both], ours.distance[both], rtol=1e-5)
    assert (raw["primID"] == ours.triangle)[both].mean() > 0.999


@pytest.mark.gl
def test_the_bare_opengl_frame_draws_our_silhouette(scene, small_panel_model):
    eye, centre = small_panel_model, small_panel_model.eye_box.centre
    try:
        context = gl.open_context("egl")
    except MissingGlError as error:
        pytest.skip(str(error))
    camera = WarpedPainter(eye, open_rasteriser(scene, "cpu")).camera
    axes = choose_plan(eye).device_from_camera
    view = View(bench._at_display_size(camera, eye.display.panel), centre, bench.HEAD_POSE, axes)
    with context:
        ours = GlRaster(context, scene).draw(view).inverse_depth > 0
    assert 0.1 < ours.mean() < 0.9
    # A map that leads to each pixel's own place, and one that leads to the place that is mirrored about both axes.
    centres = np.stack(np.meshgrid((np.arange(90) + 0.5) / 90, (np.arange(100) + 0.5) / 100), axis=-1)
    for source_uv, expected in ((centres, ours), (1 - centres, ours[::-1, ::-1])):
        run = bare_gl_frame(bench._in_world(scene), view, source_uv.astype(np.float32))
        drawn = np.frombuffer(run(), np.uint8).reshape(100, 90, 4)[..., :3].max(axis=-1) > 0
        assert (drawn != expected).mean() < 0.005


def test_memory_is_that_of_one_frame():
    with ProcessPoolExecutor(1, multiprocessing.get_context("spawn")) as pool:
        peak = pool.submit(bench.peak_memory_gb, "raytrace", "cpu").result()
    assert 0.1 < peak < 1.5


def test_runs_are_timed_in_turn_and_the_first_round_is_dropped():
    calls = []
    first, second = bench._alternately(lambda turn: calls.append(("a", turn)), lambda turn: calls.append(("b", turn)))
    assert calls[:4] == [("a", 0), ("b", 0), ("a", 1), ("b", 1)]
    assert len(calls) == 2 * (bench._ROUNDS + 1)
    assert min(first, second) >= 0
