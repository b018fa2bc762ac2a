import dataclasses

import numpy as np
import pytest
from fitted_eyes import fitted_eye

from wlr_render.geometry import directions
from wlr_render.mappings import EyeMappings, Panel, QueryResult
from wlr_render.rendering.choose_warp_grid import (
    TOLERANCE_ARCMIN,
    choose_warp_grid,
    judged_pixels,
    warp_grid_error_arcmin,
)
from wlr_render.rendering.ray_map import NEAREST_M, middle_axes
from wlr_render.rendering.warp_grid import WarpGrid

PANEL = Panel(600, 400)


@dataclasses.dataclass(frozen=True)
class QuadraticImage:
    """Tangents rise linearly with the pixel, plus `bent` times the square of u."""

    bent: float
    panel: Panel = PANEL

    def view_dir_of_pixel(self, pixel, viewpoint, warm_start=None):
        u, v = np.moveaxis((pixel - 0.5 * self.panel.size_px) * 1e-3, -1, 0)
        tangents = np.stack([u + self.bent * u * u, -v], axis=-1)
        return QueryResult(directions.dir_of_tangents(tangents), np.zeros(tangents.shape[:-1], np.uint8))


def quadratic_eye(toy_headset, bent):
    return EyeMappings("quadratic", "right", QuadraticImage(bent), toy_headset.see_through, toy_headset.eye_box)


def size_of(eye):
    return eye.display.panel.width_px, eye.display.panel.height_px


def test_the_error_of_a_quadratic_field_is_an_eighth_of_its_second_difference(toy_headset):
    eye, cell = quadratic_eye(toy_headset, 0.3), 20.0
    warp_grid = WarpGrid.edge_to_edge(PANEL, 31, 21)
    near_axis = 0.5 * PANEL.size_px + [[10.0, 10.0], [0.0, 0.0], [5.0, 0.0]]  # middle, point, quarter of an edge
    error = warp_grid_error_arcmin(eye, np.eye(3), warp_grid, eye.eye_box.centre, near_axis)
    tangent = 0.25 * 0.3 * (cell * 1e-3) ** 2
    offset = tangent * eye.see_through.offset_m / NEAREST_M
    np.testing.assert_allclose(
        error, np.array([1, 0, 0.75]) * (tangent + offset) / directions.ARCMIN, rtol=2e-3, atol=1e-9
    )


def test_a_stronger_curvature_needs_a_denser_grid(toy_headset):
    mild, strong = (choose_warp_grid(quadratic_eye(toy_headset, k), np.eye(3), (600, 400)) for k in (0.05, 0.8))
    np.testing.assert_allclose(mild.cell_px / strong.cell_px, 4, rtol=0.15)
    assert 0.7 * TOLERANCE_ARCMIN < strong.bound_arcmin <= TOLERANCE_ARCMIN


@pytest.mark.parametrize("device", ["northstar", "freeform40"])
def test_the_bound_holds_at_other_pixels_and_viewpoints(device):
    eye = fitted_eye(device, 5)
    axes, rng = middle_axes(eye), np.random.default_rng(8)
    chosen = choose_warp_grid(eye, axes, size_of(eye))
    worst = max(
        warp_grid_error_arcmin(
            eye,
            axes,
            chosen.grid,
            eye.eye_box.at(unit),
            rng.uniform(0.5, eye.display.panel.size_px - 0.5, (200, 2)),
        ).max()
        for unit in rng.uniform(-1, 1, (25, 3))
    )
    print(f"{device}: cells of {chosen.cell_px} px, bound {chosen.bound_arcmin:.4f}', at 5,000 others {worst:.4f}'")
    assert chosen.bound_arcmin <= TOLERANCE_ARCMIN
    assert 0.2 * chosen.bound_arcmin < worst <= 1.5 * chosen.bound_arcmin


def test_half_the_cell_makes_a_quarter_of_the_error():
    eye = fitted_eye("northstar", 5)
    axes, viewpoint = middle_axes(eye), eye.eye_box.at(np.array([0.5, -0.5, 1]))
    errors = []
    for cells in (40, 80):
        warp_grid = WarpGrid.edge_to_edge(eye.display.panel, cells + 1, cells + 1)
        # The same cells' corners, so that the middles compared are those of the same neighbourhood.
        middle = warp_grid.step_px * (np.array([[3, 3], [20, 20], [36, 10]]) * cells // 40 + 0.5)
        errors.append(warp_grid_error_arcmin(eye, axes, warp_grid, viewpoint, middle))
    np.testing.assert_allclose(errors[0] / errors[1], 4, rtol=0.1)


def test_an_unreachable_tolerance_gives_one_grid_point_per_pixel(toy_headset):
    chosen = choose_warp_grid(toy_headset, np.eye(3), (48, 40), tolerance_arcmin=1e-9)
    assert chosen.grid.size == (48, 40)
    np.testing.assert_allclose(chosen.grid.first_px, [1, 1])
    assert chosen.bound_arcmin < 1e-9
    assert chosen.hole_share == 0


def test_unsolved_points_are_reported_and_not_in_the_error(toy_headset, toy_headset_with_hole):
    whole, holed = (choose_warp_grid(eye, np.eye(3), size_of(eye)) for eye in (toy_headset, toy_headset_with_hole))
    assert whole.hole_share == 0
    assert 0 < holed.hole_share < 0.3
    assert holed.bound_arcmin <= TOLERANCE_ARCMIN
    in_hole = 0.5 * toy_headset.display.panel.size_px[None]
    viewpoint = toy_headset.eye_box.centre
    assert np.isnan(warp_grid_error_arcmin(toy_headset_with_hole, np.eye(3), holed.grid, viewpoint, in_hole)).all()


def test_a_panel_that_is_not_seen_at_all_is_known_nowhere(toy_headset):
    hidden = dataclasses.replace(toy_headset.display, hole_px=1e4)
    chosen = choose_warp_grid(dataclasses.replace(toy_headset, display=hidden), np.eye(3), (96, 80))
    assert chosen.hole_share == 1
    assert chosen.bound_arcmin == np.inf
    assert chosen.grid.size == (96, 80)


def test_the_corner_cells_are_judged():
    warp_grid = WarpGrid.edge_to_edge(PANEL, 61, 41)
    pixel = judged_pixels(warp_grid)
    for corner in ([5, 5], [595, 5], [5, 395], [595, 395]):
        assert np.linalg.norm(pixel - corner, axis=1).min() < 1e-9
    assert (pixel > 0).all()
    assert (pixel < PANEL.size_px).all()
