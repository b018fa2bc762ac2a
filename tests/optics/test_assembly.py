"""Assembly errors: what moves, by how much, about what point."""

import numpy as np
import pytest

from wlr_render.geometry.directions import dir_of_tangents
from wlr_render.numerics.arrays import FloatArray
from wlr_render.optics.assembly import ASSEMBLY_NAMES, ASSEMBLY_SIZES, assembled, combiner_middle
from wlr_render.optics.device import EyeOptics
from wlr_render.optics.device_file import load_device
from wlr_render.optics.traced_mappings import TracedDisplay
from wlr_render.optics.tracer import trace


@pytest.fixture(scope="module")
def optics() -> EyeOptics:
    return load_device("northstar").eyes["right"]


def values(**errors: float) -> FloatArray:
    return np.array([errors.get(name, 0.0) for name in ASSEMBLY_NAMES])


def traced(optics: EyeOptics) -> tuple[FloatArray, FloatArray]:
    """Pixels and world rays of some directions from the middle of the eye box."""
    rng = np.random.default_rng(0)
    view_dir, eye = dir_of_tangents(rng.uniform([-0.3, -0.6], [0.3, 0.15], (50, 2))), optics.eye_box.centre
    pixel, _ = TracedDisplay(optics, 0.55).plane_pixel(view_dir, eye)
    world = trace(optics.see_through, eye, view_dir, 0.55)
    return pixel, np.concatenate([world.origin, world.direction], axis=1)


def test_no_errors_leave_the_optics_as_they_are(optics: EyeOptics) -> None:
    for before, after in zip(traced(optics), traced(assembled(optics, np.zeros(12))), strict=True):
        np.testing.assert_array_equal(after, before)


def test_a_shift_of_the_panel_in_its_plane_shifts_every_pixel_alike(optics: EyeOptics) -> None:
    pixel, world = traced(optics)
    moved, same_world = traced(assembled(optics, values(panel_shift_u_mm=1.0, panel_shift_v_mm=-0.5)))
    per_mm = 1e-3 * optics.panel.pixels.size_px / optics.panel.size
    np.testing.assert_allclose(moved - pixel, np.tile(per_mm * [-1.0, 0.5], (50, 1)), atol=1e-8)
    np.testing.assert_array_equal(same_world, world)


def test_the_panel_turns_about_its_centre(optics: EyeOptics) -> None:
    turned = assembled(optics, values(panel_rotation_roll_deg=90.0)).panel
    centre = 0.5 * optics.panel.pixels.size_px
    np.testing.assert_allclose(turned.point_of_pixel(centre), optics.panel.point_of_pixel(centre), atol=1e-15)
    np.testing.assert_allclose(turned.device_from_panel[:3, 0], optics.panel.device_from_panel[:3, 1], atol=1e-12)


def test_all_surfaces_move_together(optics: EyeOptics) -> None:
    moved = assembled(optics, values(combiner_shift_x_mm=1.0, combiner_tilt_y_deg=2.0))
    motions = [
        after.device_from_surface @ np.linalg.inv(before.device_from_surface)
        for before, after in zip(optics.surfaces(), moved.surfaces(), strict=True)
    ]
    np.testing.assert_allclose(motions[1], motions[0], atol=1e-12)
    middle = combiner_middle(optics)
    np.testing.assert_allclose(
        motions[0] @ np.append(middle, 1.0), np.append(middle + [1e-3, 0.0, 0.0], 1.0), atol=1e-12
    )
    np.testing.assert_array_equal(moved.panel.device_from_panel, optics.panel.device_from_panel)


def test_every_error_changes_what_is_seen(optics: EyeOptics) -> None:
    pixel, _ = traced(optics)
    for name, size in zip(ASSEMBLY_NAMES, ASSEMBLY_SIZES, strict=True):
        moved, _ = traced(assembled(optics, values(**{name: size})))
        assert np.abs(moved - pixel).max() > 1.0, name
