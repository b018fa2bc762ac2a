import dataclasses
from typing import cast

import numpy as np
import pytest
from fitted_eyes import fitted_eye
from present import narrowed
from toy_headsets import CurvedImage, LateralOffset

from wlr_render.geometry import directions
from wlr_render.mappings import DisplayMapping, Eye, Panel, QueryResult
from wlr_render.numerics.arrays import FloatArray
from wlr_render.warp.choose_grid import (
    TOLERANCE_ARCMIN,
    choose_mesh_grid,
    choose_warp_grid,
    warp_grid_error_arcmin,
)
from wlr_render.warp.grid import WarpGrid
from wlr_render.warp.ray_map import NEAREST_M, middle_axes

PANEL = Panel(600, 400)


@dataclasses.dataclass(frozen=True)
class CubicImage:
    """Tangents rise linearly with the pixel, plus `bent` times the cube of u."""

    bent: float
    panel: Panel = PANEL

    def view_dir_of_pixel(self, pixel: FloatArray, viewpoint: object, warm_start: object = None) -> QueryResult:
        u, v = np.moveaxis((pixel - 0.5 * self.panel.size_px) * 1e-3, -1, 0)
        tangents = np.stack([u + self.bent * u**3, -v], axis=-1)
        return QueryResult(directions.dir_of_tangents(tangents), np.zeros(tangents.shape[:-1], np.uint8))


def cubic_eye(toy_headset: Eye, bent: float) -> Eye:
    return Eye("cubic", "right", cast(DisplayMapping, CubicImage(bent)), toy_headset.see_through, toy_headset.eye_box)


def test_the_error_of_a_cubic_field_is_its_third_difference(toy_headset: Eye) -> None:
    eye, cell = cubic_eye(toy_headset, 3.0), 20.0
    warp_grid = WarpGrid.edge_to_edge(PANEL, 31, 21)
    near_axis = 0.5 * PANEL.size_px + [[5.0, 0.0], [0.0, 0.0], [10.0, 0.0]]  # quarter of an edge, point, middle
    error = warp_grid_error_arcmin(eye, np.eye(3), warp_grid, eye.eye_box.centre, near_axis)
    # x (1 - x) (2 x - 1) / 6 of the third difference, which is 6 times the coefficient.
    tangent = 0.25 * 0.75 * 0.5 / 6 * 6 * 3.0 * (cell * 1e-3) ** 3
    offset_m = narrowed(eye.see_through, LateralOffset).offset_m
    straight = 0.125 * 6 * 0.01 * offset_m * 3.0 * (cell * 1e-3) ** 2  # of the offset, not corrected
    expected = np.array([tangent, 0, 0]) / directions.ARCMIN
    np.testing.assert_allclose(error, expected, atol=0.1 * expected[0] + straight / NEAREST_M / directions.ARCMIN)
    assert error[0] > 0.9 * expected[0]


def test_a_stronger_curvature_needs_a_denser_grid(toy_headset: Eye) -> None:
    mild, strong = (choose_warp_grid(cubic_eye(toy_headset, k), np.eye(3)) for k in (1.0, 27.0))
    np.testing.assert_allclose(mild.cell_px / strong.cell_px, 3, rtol=0.2)
    assert 0.4 * TOLERANCE_ARCMIN < strong.bound_arcmin <= TOLERANCE_ARCMIN


@pytest.mark.parametrize("bent", [1.0, 9.0])
def test_triangles_are_as_large_as_the_second_difference_allows(toy_headset: Eye, bent: float) -> None:
    tolerance = 0.5
    grid = choose_mesh_grid(cubic_eye(toy_headset, bent), np.eye(3), (600, 400), tolerance)
    # An eighth of the second difference, largest at the panel's sides, where rays turn less than their tangents grow.
    u = 0.5 * PANEL.width_px * 1e-3
    turn = 1 / (1 + (u + bent * u**3) ** 2)
    largest_px = 1e3 * np.sqrt(8 * tolerance * directions.ARCMIN / (6 * bent * u * turn))
    assert 0.8 * largest_px < grid.step_px[0] < 1.02 * largest_px


def test_the_bound_holds_at_other_pixels_and_viewpoints() -> None:
    eye = fitted_eye("birdbath28", 3)
    axes, rng = middle_axes(eye), np.random.default_rng(8)
    chosen = choose_warp_grid(eye, axes)
    worst = max(
        warp_grid_error_arcmin(
            eye,
            axes,
            chosen.grid,
            eye.eye_box.at(unit),
            rng.uniform(0.5, eye.display.panel.size_px - 0.5, (200, 2)),
        ).max()
        for unit in rng.uniform(-1, 1, (10, 3))
    )
    print(f"cells of {chosen.cell_px} px, bound {chosen.bound_arcmin:.4f}', at 2,000 others {worst:.4f}'")
    assert chosen.bound_arcmin <= TOLERANCE_ARCMIN
    assert 0.2 * chosen.bound_arcmin < worst <= 1.1 * chosen.bound_arcmin


def test_an_unreachable_tolerance_gives_the_densest_grid(toy_headset: Eye) -> None:
    chosen = choose_warp_grid(toy_headset, np.eye(3), tolerance_arcmin=1e-9)
    assert max(chosen.grid.size) == 257
    assert 1e-9 < chosen.bound_arcmin < 0.01
    assert chosen.hole_share == 0


def test_unsolved_points_are_reported_and_not_in_the_error(toy_headset: Eye, toy_headset_with_hole: Eye) -> None:
    whole, holed = (choose_warp_grid(eye, np.eye(3)) for eye in (toy_headset, toy_headset_with_hole))
    assert whole.hole_share == 0
    assert 0 < holed.hole_share < 0.3
    assert holed.bound_arcmin <= TOLERANCE_ARCMIN
    in_hole = 0.5 * toy_headset.display.panel.size_px[None]
    viewpoint = toy_headset.eye_box.centre
    assert np.isnan(warp_grid_error_arcmin(toy_headset_with_hole, np.eye(3), holed.grid, viewpoint, in_hole)).all()


def test_a_panel_that_is_not_seen_at_all_is_known_nowhere(toy_headset: Eye) -> None:
    hidden = dataclasses.replace(narrowed(toy_headset.display, CurvedImage), hole_px=1e4)
    chosen = choose_warp_grid(dataclasses.replace(toy_headset, display=hidden), np.eye(3))
    assert chosen.hole_share == 1
    assert chosen.bound_arcmin == np.inf
