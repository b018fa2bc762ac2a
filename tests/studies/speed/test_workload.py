"""What is timed: a scene that is there, a headset that stays the same in other pixels."""

import numpy as np

from wlr_render.evaluation.lateral_colour import lateral_colour
from wlr_render.files import resource
from wlr_render.mappings import Panel
from wlr_render.rendering.painters import TracedPainter
from wlr_render.rendering.ray_render import RayRenderer
from wlr_render.studies.headset import open_channels
from wlr_render.studies.speed.workload import HEAD_POSE, bench_model, bench_scene, fit_channels


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


def test_models_of_three_colours_have_the_headsets_colour(tmp_path):
    """A prism whose plastic has dispersion: calibrated colour by colour, noise and all, its colour is found."""
    text = resource("devices", "prism5701202.toml").read_text(encoding="utf-8")
    prism = tmp_path / "prism.toml"
    prism.write_text(text.replace("index = 1.492", 'formula = "pmma_sultanova_2009"'), encoding="utf-8")
    pixel = np.stack(np.meshgrid([100.0, 640.0, 1180.0], [80.0, 480.0, 880.0]), axis=-1).reshape(-1, 2)
    true, found = (
        lateral_colour(green, blue, green.eye_box.centre, pixel).display
        for _, green, blue in (open_channels([prism]), fit_channels(str(prism)))
    )
    assert true.max() > 1
    assert np.abs(found - true).max() < 0.15
