import numpy as np
import pytest

from benchmarks.simulated_lab import exact_views
from wlr_render.geometry.transforms import OPENXR_FROM_OPENCV, apply, inverse, rigid, rotate, rotation_about
from wlr_render.lenses.lens_camera import LensCamera
from wlr_render.optics.device import EyeOptics
from wlr_render.optics.device_file import load_device
from wlr_render.optics.traced_mappings import TracedDisplay

CAMERA = LensCamera((640, 480), np.array([700.0, 690.0]), np.array([322.0, 236.0]), np.array([-0.1, 0.02, 1e-3, 0, 0]))
POSE = rigid(OPENXR_FROM_OPENCV @ rotation_about("x", 0.05), np.array([0.001, -0.002, 0.001]))


def optics(name: str) -> EyeOptics:
    return load_device(name).eyes["right"]


@pytest.mark.parametrize("lead", [(), (1,), (3, 1, 2)])
def test_without_optics_a_camera_sees_straight(lead: tuple[int, ...]) -> None:
    rng = np.random.default_rng(3)
    point = np.concatenate([rng.uniform(-0.1, 0.1, (*lead, 2)), rng.uniform(-0.6, -0.5, (*lead, 1))], axis=-1)
    pixel = exact_views.pixel_of_real_point(optics("no_optics"), CAMERA, POSE, point)
    np.testing.assert_allclose(pixel, CAMERA.pixel_of_point(apply(inverse(POSE), point)), atol=1e-8)

    # The bare panel: 0.25 mm pixels 500 mm ahead, v down.
    on_panel = np.concatenate([rng.uniform(-0.08, 0.08, (*lead, 2)), np.full((*lead, 1), -0.5)], axis=-1)
    seen = exact_views.panel_position(
        optics("no_optics"), CAMERA, POSE, CAMERA.pixel_of_point(apply(inverse(POSE), on_panel))
    )
    np.testing.assert_allclose(seen.value, on_panel[..., :2] / [0.00025, -0.00025] + [640, 360], atol=1e-6)


@pytest.mark.parametrize("name", ["flat_mirror", "freeform40"])
def test_panel_positions_are_the_inverse_of_view_directions(name: str) -> None:
    position = optics(name).panel.pixels.grid(5, 4)
    view_dir = TracedDisplay(optics(name), 0.55).view_dir_of_pixel(position, POSE[:3, 3]).value
    pixel = CAMERA.pixel_of_point(rotate(inverse(POSE), view_dir))
    assert np.isfinite(pixel).all()
    np.testing.assert_allclose(exact_views.panel_position(optics(name), CAMERA, POSE, pixel).value, position, atol=1e-6)
