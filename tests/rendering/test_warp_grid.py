import numpy as np
import pytest

from wlr_render.mappings import Panel
from wlr_render.rendering.warp_grid import WarpGrid

PANEL = Panel(100, 80)


def test_a_picture_of_the_panels_own_size_has_its_pixel_centres():
    np.testing.assert_array_equal(WarpGrid.of_pixels(PANEL).panel_pixel(), PANEL.pixel_centres())


def test_a_picture_of_its_own_size_covers_the_panel():
    centres = WarpGrid.of_pixels(PANEL, (10, 4)).panel_pixel()
    np.testing.assert_allclose(centres[0, 0], [5, 10])
    np.testing.assert_allclose(centres[-1, -1], [95, 70])
    np.testing.assert_allclose(np.diff(centres[1, :, 0]), 10)


def test_edge_to_edge_ends_at_the_outer_corners():
    warp_grid = WarpGrid.edge_to_edge(PANEL, 11, 5)
    points = warp_grid.panel_pixel()
    assert points.shape == (5, 11, 2)
    np.testing.assert_allclose(points[0, 0], [0, 0])
    np.testing.assert_allclose(points[-1, -1], [100, 80])
    np.testing.assert_allclose(points[1, 3], [30, 20])


@pytest.mark.parametrize("warp_grid", [WarpGrid.edge_to_edge(PANEL, 11, 5), WarpGrid.of_pixels(PANEL, (30, 40))])
@pytest.mark.parametrize("size_px", [(100, 80), (50, 160)])
def test_where_a_picture_reads_is_where_the_point_lies(warp_grid, size_px):
    scale, offset = warp_grid.texture_from_picture(size_px)
    at = warp_grid.panel_pixel() * size_px / PANEL.size_px * scale + offset
    columns, rows = warp_grid.size
    texel_centres = np.stack(np.meshgrid((np.arange(columns) + 0.5) / columns, (np.arange(rows) + 0.5) / rows), -1)
    np.testing.assert_allclose(at, texel_centres, atol=1e-12)
