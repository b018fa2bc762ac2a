"""Long paths through images with thin or very near things: the ray meets the first thing that it comes past."""

import numpy as np
import pytest
from present import present
from warping import uploaded, uploaded_field, warped

from wlr_render.geometry.pinhole import Pinhole
from wlr_render.gl.context import GlContext
from wlr_render.mappings import Panel
from wlr_render.numerics.arrays import BoolArray, Float32Array, FloatArray
from wlr_render.numerics.srgb import decode_srgb
from wlr_render.warp.gl_warp import GlWarp
from wlr_render.warp.grid import WarpGrid
from wlr_render.warp.view import GeometryImage
from wlr_render.warp.warp import WarpStatus

pytestmark = pytest.mark.gl

CAMERA = Pinhole(240, 40, np.array([-0.6, -0.1]), np.array([0.6, 0.1]))
NEAR, FAR = 2.0, 0.5


def columns(inverse_depth: FloatArray) -> GeometryImage:
    """A picture whose columns have these inverse depths (width,), and colours that tell the columns."""
    shape = (CAMERA.height_px, CAMERA.width_px)
    colour = np.zeros((*shape, 3), np.uint8)
    colour[..., 0] = np.arange(CAMERA.width_px)
    return GeometryImage(colour, np.broadcast_to(inverse_depth, shape).astype(np.float32).copy())


def rays(at_infinity: FloatArray, shift_px: float) -> Float32Array:
    """Rays (4, 1, n) in a middle row: where they appear at infinity, and how far they move until NEAR."""
    pixel = np.stack([at_infinity, np.full_like(at_infinity, 20.3)], axis=-1)
    tangents = CAMERA.tangents_of_pixel(pixel)
    offset = np.full_like(at_infinity, shift_px / CAMERA.focal_px[0] / NEAR)
    return np.stack([*tangents.T, offset, 0 * offset])[:, None].astype(np.float32)


def first_met(at_infinity: FloatArray, shift_px: float, inverse_depth: FloatArray) -> FloatArray:
    """Closed form for frontal columns: the largest w whose place shows w; NaN if there is none. And its place."""
    u = at_infinity[:, None] + shift_px * inverse_depth / NEAR
    shows = np.floor(u) == np.arange(CAMERA.width_px)
    met = np.where(shows, inverse_depth, -np.inf).max(axis=1)
    return np.where(np.isfinite(met), at_infinity + shift_px * met / NEAR, np.nan)


def near_a_border(at_infinity: FloatArray, shift_px: float, inverse_depth: FloatArray) -> BoolArray:
    """Whether any depth's place lies so close to a column's border that rounding decides."""
    u = at_infinity[:, None] + shift_px * np.unique(inverse_depth) / NEAR
    is_near: BoolArray = np.any(np.abs(u - np.round(u)) < 2e-3, axis=1)
    return is_near


@pytest.mark.parametrize("width_px", [1, 2, 3])
@pytest.mark.parametrize("shift_px", [20.0, -20.0, 37.0])
def test_a_thin_pole_before_a_wall_is_never_skipped(gl_context: GlContext, width_px: int, shift_px: float) -> None:
    depth = np.full(CAMERA.width_px, FAR)
    depth[120 : 120 + width_px] = NEAR
    at_infinity = np.arange(60.0, 180.0, 0.0331)
    result = warped(gl_context, columns(depth), CAMERA, [rays(at_infinity, shift_px)])
    expected = first_met(at_infinity, shift_px, depth)
    clear = ~near_a_border(at_infinity, shift_px, depth)
    at_pole = at_infinity + shift_px
    on_pole = clear & (at_pole >= 120) & (at_pole < 120 + width_px)
    hidden = clear & np.isnan(expected)
    assert on_pole.sum() > 20
    assert hidden.sum() > 20
    np.testing.assert_array_equal(result.status[0, clear] == WarpStatus.DISOCCLUDED, np.isnan(expected[clear]))
    seen = clear & ~hidden
    assert result.source is not None
    np.testing.assert_allclose(result.source[0, seen, 0], expected[seen], atol=2e-3)
    np.testing.assert_allclose(result.source[0, on_pole, 0], at_pole[on_pole], atol=2e-3)
    # What is behind the pole is filled from where the ray passed it, beside its edge.
    np.testing.assert_allclose(result.source[0, hidden, 0], at_pole[hidden], atol=2e-3)


@pytest.mark.parametrize("depth_m", [0.1, 0.3, 3.0])
@pytest.mark.parametrize("lean", [0.0, 0.7, -3.0])
def test_a_wire_of_one_pixel_is_whole_from_20_mm_aside(gl_context: GlContext, depth_m: float, lean: float) -> None:
    """A wire before a wall at 5 m, upright or across rows and columns: rays through its pixels' centres meet it."""
    camera = Pinhole(240, 200, np.array([-0.6, -0.5]), np.array([0.6, 0.5]))
    place = np.stack(np.meshgrid(np.arange(240) + 0.5, np.arange(200) + 0.5), axis=-1)
    across = (place[..., 0] - 120.0) - lean * (place[..., 1] - 100.0)
    wire = (across > -0.5 * max(1.0, abs(lean))) & (across <= 0.5 * max(1.0, abs(lean)))
    inverse_depth = np.where(wire, 1 / depth_m, 0.2).astype(np.float32)
    image = GeometryImage(np.zeros((*wire.shape, 3), np.uint8), inverse_depth)
    tangents = camera.tangents_of_pixel(place - [0.02 * camera.focal_px[0] / depth_m, 0.0])
    rays_aside = np.concatenate([tangents, np.broadcast_to([0.02, 0.0], tangents.shape)], axis=-1)
    result = warped(gl_context, image, camera, [np.moveaxis(rays_aside, -1, 0).astype(np.float32)])
    assert wire.sum() >= 200
    assert (result.status[wire] == WarpStatus.SEEN).all()
    np.testing.assert_allclose(present(result.source)[wire], place[wire], atol=2e-3)


@pytest.mark.parametrize("nearest_m", [1e-2, 1e-4])
def test_a_spot_at_the_lens_changes_nothing_that_rays_beside_it_meet(gl_context: GlContext, nearest_m: float) -> None:
    """Paths begin up to 100,000 px outside the picture; what they meet in it is what they meet without the spot."""
    depth = np.full(CAMERA.width_px, FAR)
    depth[120:122] = NEAR
    image, plain = columns(depth), columns(depth)
    image.inverse_depth[16:18, 100:102] = 1 / nearest_m
    slope_offset = rays(np.arange(60.0, 180.0, 0.0731), 20.0)
    found, expected = (warped(gl_context, each, CAMERA, [slope_offset]) for each in (image, plain))
    np.testing.assert_array_equal(found.status, expected.status)
    np.testing.assert_allclose(present(found.source), present(expected.source), atol=2e-3)


@pytest.mark.parametrize("shift_px", [3.0, -11.0, 25.0, -50.0])
def test_the_nearest_of_many_surfaces_is_hit(gl_context: GlContext, shift_px: float) -> None:
    rng = np.random.default_rng(int(abs(shift_px)))
    widths = rng.integers(2, 9, 120)
    depth = np.repeat(rng.choice([0.0, 0.4, 0.55, 0.9, 1.3, NEAR], 120), widths)[: CAMERA.width_px]
    at_infinity = np.arange(55.0, 185.0, 0.0379)
    result = warped(gl_context, columns(depth), CAMERA, [rays(at_infinity, shift_px)])
    expected = first_met(at_infinity, shift_px, depth)
    clear = ~near_a_border(at_infinity, shift_px, depth)
    right = np.where(
        np.isnan(expected),
        result.status[0] == WarpStatus.DISOCCLUDED,
        (result.status[0] == WarpStatus.SEEN) & (np.abs(present(result.source)[0, :, 0] - expected) < 2e-3),
    )
    assert np.isnan(expected[clear]).any()
    assert right[clear].all()


@pytest.mark.parametrize("slope", [-3.0, -0.8, 0.8, 3.0])
def test_a_plane_at_any_tilt_is_met_where_it_is(gl_context: GlContext, slope: float) -> None:
    # n . p = 1 has the inverse depth n . (tx, ty, -1) in every direction.
    normal = np.array([slope, 0.6, -2.2])
    tangents = CAMERA.pixel_centre_tangents()
    image = columns(np.zeros(CAMERA.width_px))
    image.inverse_depth[:] = tangents @ normal[:2] - normal[2]
    at_infinity = np.arange(70.0, 170.0, 0.173)
    slope_offset = rays(at_infinity, 24.0)
    result = warped(gl_context, image, CAMERA, [slope_offset])
    a, b, c, d = slope_offset.astype(float)
    met = (normal[0] * a + normal[1] * b - normal[2]) / (1 - normal[0] * c - normal[1] * d)
    expected = CAMERA.pixel_of_tangents(np.stack([a + c * met, b + d * met], axis=-1))
    inside = (expected[..., 0] > 1) & (expected[..., 0] < CAMERA.width_px - 1)
    assert inside.mean() > 0.6
    assert (result.status[inside] == WarpStatus.SEEN).all()
    # A search ends when it moves by less than 0.01 px; on the steepest of these each step leaves a third of the last.
    np.testing.assert_allclose(present(result.source)[inside], expected[inside], atol=5e-3)


@pytest.mark.parametrize("first", [-40.0, 190.0])
@pytest.mark.parametrize("shift_px", [30.0, -30.0])
def test_a_ray_that_leaves_the_picture_in_front_of_all_is_outside(
    gl_context: GlContext, first: float, shift_px: float
) -> None:
    """A wall, and a corner that begins all paths near: the wall is met where its place lies in the picture."""
    image = columns(np.full(CAMERA.width_px, FAR))
    image.inverse_depth[18:20, ::8] = NEAR  # above the rays' row: it is met by none of them
    at_infinity = np.arange(first, first + 90.0, 0.731)
    result = warped(gl_context, image, CAMERA, [rays(at_infinity, shift_px)])
    place = at_infinity + shift_px * FAR / NEAR
    clear = np.minimum(np.abs(place), np.abs(place - CAMERA.width_px)) > 0.01
    inside = (place > 0.0) & (place < CAMERA.width_px)
    assert min(inside.sum(), (~inside).sum()) > 20
    expected = np.where(inside, WarpStatus.SEEN, WarpStatus.OUTSIDE)
    np.testing.assert_array_equal(result.status[0, clear], expected[clear])


WALL, POLE = 40, 200


@pytest.mark.parametrize("shift_px", [7.3, -20.0])
@pytest.mark.parametrize("samples_per_axis", [1, 2])
def test_no_texel_of_another_surface_is_mixed_into_a_colour(
    gl_context: GlContext, shift_px: float, samples_per_axis: int
) -> None:
    """A pole that has moved aside by pixels leaves nothing of its colour on the wall, nor takes any of the wall's."""
    depth = np.full(CAMERA.width_px, FAR)
    depth[120:124] = NEAR
    image = columns(depth)
    image.colour[:] = np.where(depth == NEAR, POLE, WALL)[:, None]
    at_infinity = np.arange(90.0, 150.0, 0.0731) if samples_per_axis == 1 else np.arange(60.0, 180.0, 1.37)
    result = warped(gl_context, image, CAMERA, [rays(at_infinity, shift_px)], samples_per_axis=samples_per_axis)
    on_pole = np.abs(present(result.source)[0, :, 0] - 122.0) < 2.0
    on_pole &= result.status[0] == WarpStatus.SEEN
    clear = ~near_a_border(at_infinity, shift_px, depth)
    assert min((on_pole & clear).sum(), (~on_pole & clear).sum()) > 0
    assert (result.status[0] == WarpStatus.DISOCCLUDED).any()
    np.testing.assert_array_equal(result.colour[0, clear, 0], np.where(on_pole, POLE, WALL)[clear])


def test_a_silhouette_that_has_moved_by_less_than_half_a_pixel_stays_smooth(gl_context: GlContext) -> None:
    depth = np.full(CAMERA.width_px, FAR)
    depth[120:] = NEAR
    image = columns(depth)
    image.colour[:] = np.where(depth == NEAR, POLE, WALL)[:, None]
    result = warped(gl_context, image, CAMERA, [rays(np.arange(119.0, 121.0, 0.0331), 0.4)])
    wall, pole = decode_srgb(np.array([WALL, POLE], np.uint8)).astype(float)
    share = (decode_srgb(result.colour[0, :, 0]).astype(float) - wall) / (pole - wall)
    assert ((share > 0.1) & (share < 0.9)).sum() > 8
    np.testing.assert_allclose(share, np.clip(present(result.source)[0, :, 0] - 119.5, 0.0, 1.0), atol=0.02)


WIDTH, HEIGHT = 400, 320
WIDE = Pinhole(WIDTH, HEIGHT, np.array([-0.5, -0.4]), np.array([0.5, 0.4]))


@pytest.fixture
def image() -> GeometryImage:
    """A hand at 0.1 m with a slit between its fingers, before thin poles at 0.3 and 0.5 m and a wall."""
    tangents = WIDE.pixel_centre_tangents()
    inverse_depth = np.full((HEIGHT, WIDTH), 0.6)
    for column, value in ((60, 2.0), (95, 3.3), (110, 2.0), (300, 3.3), (345, 2.0)):
        inverse_depth[:, column : column + 2] = value
    inverse_depth[90:230, 120:280] = 10.0
    inverse_depth[90:180, 200:203] = 0.6
    waves = np.stack([tangents @ np.array(k) for k in ([9, 4], [-5, 11], [12, -7])], axis=-1)
    return GeometryImage(np.rint(127 + 120 * np.sin(waves)).astype(np.uint8), inverse_depth.astype(np.float32))


def first_frontal_met(inverse_depth: Float32Array, offset: tuple[float, float]) -> FloatArray:
    """Where straight rays beside the camera meet the first frontal surface that shows itself there; NaN if none does.

    (height, width, 2), in closed form: a surface of inverse depth w shows itself at the place of the ray's point there.
    """
    tangents, met = WIDE.pixel_centre_tangents(), np.full((HEIGHT, WIDTH, 2), np.nan)
    for w in np.unique(inverse_depth):  # the nearest last
        place = WIDE.pixel_of_tangents(tangents + w * np.array(offset))
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
    tangents = WIDE.tangents_of_pixel(grid.panel_pixel())
    rays = np.concatenate([tangents, np.broadcast_to(offset, tangents.shape)], axis=-1)
    field = uploaded_field(gl_context, np.moveaxis(rays, -1, 0), grid)
    picture = uploaded(gl_context, image, WIDE)
    found = GlWarp(gl_context).draw(picture, [field], np.eye(4), (WIDTH, HEIGHT), with_source=True).read()
    expected = first_frontal_met(image.inverse_depth, offset)
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
