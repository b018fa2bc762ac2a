"""What is timed: a scene that is there."""

import numpy as np
from present import present

from benchmarks.speed.workload import HEAD_POSE, bench_scene
from wlr_render.draw.painters import TracedPainter
from wlr_render.draw.ray_tracing import RayRenderer
from wlr_render.mappings import Eye


def test_the_workload_is_a_hundred_thousand_triangles_large_in_the_field(small_panel_model: Eye) -> None:
    scene = bench_scene()
    assert 95_000 < scene.triangle_count < 105_000
    frame = TracedPainter(small_panel_model, RayRenderer(scene)).paint(
        small_panel_model.eye_box.centre, HEAD_POSE, with_geometry=True
    )
    assert 0.15 < np.isfinite(present(frame.position)[..., 0]).mean() < 0.9
