"""A large near object while the head moves: paths of many pixels, of which the GPU searches only parts."""

import numpy as np
import pytest
from present import present
from warping import uploaded, uploaded_field

from wlr_render.geometry.pinhole import Pinhole
from wlr_render.gl.context import GlContext
from wlr_render.mappings import Panel
from wlr_render.numerics.arrays import BoolArray, Float32Array, FloatArray
from wlr_render.warp.gl_warp import GlWarp
from wlr_render.warp.grid import WarpGrid
from wlr_render.warp.view import GeometryImage
from wlr_render.warp.warp import WarpStatus

pytestmark = pytest.mark.gl

WIDTH, HEIGHT = 400, 320
CAMERA = Pinhole(WIDTH, HEIGHT, np.array([-0.5, -0.4]), np.array([0.5, 0.4]))


@pytest.fixture
def image() -> GeometryImage:
    """A hand at 0.1 m with a slit between its fingers, before thin poles at 0.3 and 0.5 m and a wall."""
    tangents = CAMERA.pixel_centre_tangents()
    inverse_depth = np.full((HEIGHT, WIDTH), 0.6)
    for column, value in ((60, 2.0), (95, 3.3), (110, 2.0), (300, 3.3), (345, 2.0)):
        inverse_depth[:, column : column + 2] = value
    inverse_depth[90:230, 120:280] = 10.0
    inverse_depth[90:180, 200:203] = 0.6
    waves = np.stack([tangents @ np.array(k) for k in ([9, 4], [-5, 11], [12, -7])], axis=-1)
    return GeometryImage(np.rint(127 + 120 * np.sin(waves)).astype(np.uint8), inverse_depth.astype(np.float32))


def first_met(inverse_depth: Float32Array, offset: tuple[float, float]) -> FloatArray:
    """Where straight rays beside the camera meet the first frontal surface that shows itself there; NaN if none does.

    (height, width, 2), in closed form: a surface of inverse depth w shows itself at the place of the ray's point there.
    """
    tangents, met = CAMERA.pixel_centre_tangents(), np.full((HEIGHT, WIDTH, 2), np.nan)
    for w in np.unique(inverse_depth):  # the nearest last
        place = CAMERA.pixel_of_tangents(tangents + w * np.array(offset))
        within: BoolArray = np.all((place >= 0) & (place < [WIDTH, HEIGHT]), axis=-1)
        column, row = np.moveaxis(np.where(within[..., None], place, 0).astype(int), -1, 0)
        shows = within & (inverse_depth[row, column] == w)
        met[shows] = place[shows]
    return met


@pytest.mark.parametrize("offset", [(0.02, 0.0), (-0.014, 0.014)])
@pytest.mark.parametrize("cells", [(9, 9), (21, 17)])
def test_a_search_in_parts_finds_what_the_whole_path_shows(
    gl_context: GlContext, image: GeometryImage, offset: tuple[float, float], cells: tuple[int, int]
) -> None:
    grid = WarpGrid.edge_to_edge(Panel(WIDTH, HEIGHT), *cells)
    tangents = CAMERA.tangents_of_pixel(grid.panel_pixel())
    rays = np.concatenate([tangents, np.broadcast_to(offset, tangents.shape)], axis=-1)
    field = uploaded_field(gl_context, np.moveaxis(rays, -1, 0), grid)
    picture = uploaded(gl_context, image, CAMERA)
    found = GlWarp(gl_context).draw(picture, [field], np.eye(4), (WIDTH, HEIGHT), with_source=True).read()
    expected = first_met(image.inverse_depth, offset)
    inside = found.status != WarpStatus.OUTSIDE
    assert inside.mean() > 0.8
    hidden = inside & np.isnan(expected[..., 0])
    assert hidden.sum() > 5000
    assert (found.status == WarpStatus.DISOCCLUDED)[hidden].mean() > 0.98
    assert ((found.status == WarpStatus.DISOCCLUDED) == hidden)[inside].mean() > 0.995
    seen = (found.status == WarpStatus.SEEN) & ~hidden
    close = np.abs(present(found.source) - expected)[seen].max(axis=-1) < 0.05
    print(f"hidden {hidden.sum()}, farther {(~close).sum()}")
    assert close.mean() > 0.998
