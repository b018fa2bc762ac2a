import numpy as np
import pytest

from wlr_render.mappings import Panel
from wlr_render.numerics.arrays import FloatArray
from wlr_render.warp.grid import WarpGrid

PANEL = Panel(100, 80)


def test_a_picture_of_the_panels_own_size_has_its_pixel_centres() -> None:
    np.testing.assert_array_equal(WarpGrid.of_pixels(PANEL).panel_pixel(), PANEL.pixel_centres())


def test_a_picture_of_its_own_size_covers_the_panel() -> None:
    centres = WarpGrid.of_pixels(PANEL, (10, 4)).panel_pixel()
    np.testing.assert_allclose(centres[0, 0], [5, 10])
    np.testing.assert_allclose(centres[-1, -1], [95, 70])
    np.testing.assert_allclose(np.diff(centres[1, :, 0]), 10)


def test_edge_to_edge_ends_at_the_outer_corners() -> None:
    warp_grid = WarpGrid.edge_to_edge(PANEL, 11, 5)
    points = warp_grid.panel_pixel()
    assert points.shape == (5, 11, 2)
    np.testing.assert_allclose(points[0, 0], [0, 0])
    np.testing.assert_allclose(points[-1, -1], [100, 80])
    np.testing.assert_allclose(points[1, 3], [30, 20])


@pytest.mark.parametrize("power", [(0, 0), (1, 0), (0, 1), (2, 0), (1, 1), (0, 2)])
def test_quadratic_tangents_are_interpolated_exactly(power: tuple[int, int]) -> None:
    warp_grid = WarpGrid.edge_to_edge(PANEL, 7, 6)
    pixel = np.random.default_rng(1).uniform(0, PANEL.size_px, (500, 2))

    def rays(at: FloatArray) -> FloatArray:
        value = np.prod((at / PANEL.size_px) ** power, axis=-1)
        return np.stack([value, -value, at[..., 0], at[..., 1]], axis=-1)

    interpolated = warp_grid.interpolated(np.moveaxis(rays(warp_grid.panel_pixel()), -1, 0), pixel)
    np.testing.assert_allclose(interpolated, rays(pixel), atol=1e-10)


def test_a_missing_point_is_missing_in_its_triangles_alone() -> None:
    warp_grid = WarpGrid.edge_to_edge(PANEL, 6, 5)  # cells of 20 x 20
    slope_offset = np.ones((4, 5, 6))
    slope_offset[:, 2, 3] = np.nan  # at (60, 40)
    pixel = np.array([[63.0, 43], [43, 57], [77, 23], [43, 23], [77, 57]])
    found = np.isfinite(warp_grid.interpolated(slope_offset, pixel)).all(axis=-1)
    np.testing.assert_array_equal(found, [False, False, False, True, True])
    np.testing.assert_array_equal(warp_grid.interpolated(slope_offset, pixel)[found], 1.0)
