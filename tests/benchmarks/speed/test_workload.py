"""What is timed: a scene that is there, a headset that stays the same in other pixels."""

import numpy as np

from benchmarks.speed.workload import HEAD_POSE, bench_model, bench_scene
from wlr_render.mappings import Panel
from wlr_render.rendering.painters import TracedPainter
from wlr_render.rendering.ray_tracing import RayRenderer


def test_the_workload_is_a_hundred_thousand_triangles_large_in_the_field(small_panel_model):
    scene = bench_scene()
    assert 95_000 < scene.triangle_count < 105_000
    frame = TracedPainter(small_panel_model, RayRenderer(scene)).paint(
        small_panel_model.eye_box.centre, HEAD_POSE, with_geometry=True
    )
    assert 0.15 < np.isfinite(frame.position[..., 0]).mean() < 0.9


def test_another_number_of_pixels_is_the_same_panel(small_panel_model):
    other = bench_model(Panel(180, 50))
    viewpoint = small_panel_model.eye_box.at(np.array([0.5, -0.5, 0.5]))
    place = np.random.default_rng(7).uniform(0.1, 0.9, (20, 2))
    first, second = (
        eye.display.view_dir_of_pixel(place * eye.display.panel.size_px, viewpoint).value
        for eye in (small_panel_model, other)
    )
    assert np.linalg.norm(first - second, axis=-1).max() < 1e-9
