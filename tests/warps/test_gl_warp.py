from collections.abc import Iterable, Sequence
from typing import Any

import numpy as np
import pytest
from gl_scenes import at, cube, lit, quad, unlit, view
from hardware import SRGB_DECODE, VERTEX_SNAP_PX, allowed, codes_of, filter_of
from numpy.typing import NDArray
from present import present
from warping import field_of_pixels, uploaded, uploaded_field, warp_pixels

from wlr_render.draw.gl_raster import GlRaster
from wlr_render.errors import BadInputError
from wlr_render.geometry import transforms
from wlr_render.geometry.pinhole import Pinhole
from wlr_render.gl.context import GlContext
from wlr_render.mappings import Panel
from wlr_render.numerics.arrays import Float32Array, FloatArray
from wlr_render.numerics.srgb import decode_srgb
from wlr_render.warp.gl_warp import GlWarp
from wlr_render.warp.gpu_image import GpuImage
from wlr_render.warp.grid import WarpGrid
from wlr_render.warp.view import GeometryImage
from wlr_render.warp.warp import WarpedImage, WarpStatus

pytestmark = pytest.mark.gl

CAMERA = Pinhole(96, 80, np.array([-0.5, -0.35]), np.array([0.4, 0.4]))


def bend_field(tangents: FloatArray, offset: Iterable[float] = (0.0, 0.0)) -> Float32Array:
    """(4, height, width) of tangents (height, width, 2) with one offset (c, d) for all pixels."""
    c, d = (np.full(tangents.shape[:2], x) for x in offset)
    return np.stack([tangents[..., 0], tangents[..., 1], c, d]).astype(np.float32)


def straight(camera: Pinhole = CAMERA) -> Float32Array:
    return bend_field(camera.pixel_centre_tangents())


@pytest.fixture
def busy_picture(gl_context: GlContext) -> GpuImage:
    scene = lit(
        (cube(0.5), at(0.1, 0, -1.5, transforms.rotation_about("y", 0.5))), (quad((-9, -9), (9, 9)), at(0, 0, -4))
    )
    return GlRaster(gl_context, scene).draw_on_gpu(view(CAMERA))


def test_straight_rays_give_the_picture_back_bit_by_bit(gl_context: GlContext, busy_picture: GpuImage) -> None:
    warped = warp_pixels(gl_context, busy_picture, [straight()])
    np.testing.assert_array_equal(warped.colour, busy_picture.read().colour)
    assert (warped.status == WarpStatus.SEEN).all()
    centres = np.stack(np.meshgrid(np.arange(96) + 0.5, np.arange(80) + 0.5), axis=-1)
    np.testing.assert_allclose(present(warped.source), centres, atol=allowed(gl_context, 1e-4, VERTEX_SNAP_PX))


def test_pixels_without_a_ray_or_beyond_the_picture_show_the_background(
    gl_context: GlContext, busy_picture: GpuImage
) -> None:
    slope_offset = straight()
    slope_offset[2, 10:20, 30:40] = np.nan
    slope_offset[0, 50] += 2.0
    warped = warp_pixels(gl_context, busy_picture, [slope_offset], background=(1, 2, 3))
    expected = np.full((80, 96), WarpStatus.SEEN)
    expected[10:20, 30:40], expected[50] = WarpStatus.NO_RAY, WarpStatus.OUTSIDE
    sure = np.ones((80, 96), bool)
    sure[9:21, 29:41], sure[47:54] = False, False  # cells that share grid points with others
    sure[10:20, 30:40], sure[50] = True, True
    np.testing.assert_array_equal(warped.status[sure], expected[sure])
    nothing = warped.status != WarpStatus.SEEN
    np.testing.assert_array_equal(warped.colour[nothing], [[1, 2, 3]] * nothing.sum())
    np.testing.assert_array_equal(np.isnan(present(warped.source)[..., 0]), nothing)


def test_colour_between_pixels_is_bilinear_in_linear_light(gl_context: GlContext, busy_picture: GpuImage) -> None:
    light = decode_srgb(busy_picture.read().colour).astype(float)
    step = 1 / CAMERA.focal_px
    slope_offset = bend_field(CAMERA.pixel_centre_tangents() + [0.25 * step[0], -0.5 * step[1]])
    warped = warp_pixels(gl_context, busy_picture, [slope_offset])
    across = 0.75 * light[:, :-1] + 0.25 * light[:, 1:]
    mixed = 0.5 * across[:-1] + 0.5 * across[1:]
    # Half a code is rounding.
    most = 0.5 + SRGB_DECODE + allowed(gl_context, 0.0, codes_of(mixed, filter_of(light)[:-1, :-1]))
    assert (np.abs(warped.colour[:-1, :-1] - exact_code(mixed)) <= most).all()


def exact_code(light: FloatArray) -> FloatArray:
    """sRGB of linear light, 0 to 255, not rounded."""
    light = np.clip(light, 0, 1)
    return 255 * np.where(light <= 0.0031308, 12.92 * light, 1.055 * light ** (1 / 2.4) - 0.055)


def test_a_display_and_a_camera_of_new_sizes_are_followed(gl_context: GlContext, busy_picture: GpuImage) -> None:
    warp = GlWarp(gl_context)

    def drawn(image: GpuImage, camera: Pinhole) -> NDArray[np.uint8]:
        size = camera.width_px, camera.height_px
        return warp.draw(image, [field_of_pixels(gl_context, straight(camera))], np.eye(4), size).read().colour

    drawn(busy_picture, CAMERA)
    small = Pinhole(40, 30, CAMERA.tangent_min, CAMERA.tangent_max)
    image = GlRaster(gl_context, unlit((cube(), at(0, 0, -2)))).draw_on_gpu(view(small))
    np.testing.assert_array_equal(drawn(image, small), image.read().colour)
    np.testing.assert_array_equal(drawn(busy_picture, CAMERA), busy_picture.read().colour)


SHARPER = Pinhole(200, 160, np.array([-0.5, -0.4]), np.array([0.5, 0.4]))
HEIGHT, WIDTH = 60, 80


@pytest.fixture
def image() -> GeometryImage:
    """A near disc before a tilted wall, with smooth colours."""
    tangents = SHARPER.pixel_centre_tangents()
    depth = 0.7 + 0.4 * tangents[..., 0] - 0.2 * tangents[..., 1]
    depth[np.hypot(*np.moveaxis(tangents - [0.05, 0.0], -1, 0)) < 0.12] = 2.0
    waves = np.stack([tangents @ np.array(k) for k in ([9, 4], [-5, 11], [12, -7])], axis=-1)
    return GeometryImage(np.rint(127 + 120 * np.sin(waves)).astype(np.uint8), depth.astype(np.float32))


def smooth_bend(u: FloatArray, v: FloatArray, offset: float = 0.02) -> Float32Array:
    """Rays at display positions from 0 to 1, bent smoothly; (4, ...)."""
    x, y = u - 0.5, 0.5 - v
    a, b = 0.7 * x * (1 + 0.3 * y * y), 0.6 * y * (1 + 0.2 * x)
    return np.stack([a, b, offset * (1 + x), -0.4 * offset * (1 - y)]).astype(np.float32)


def motion(angle: float, by: tuple[float, float, float] = (0.01, -0.005, 0.02)) -> FloatArray:
    return transforms.rigid(transforms.rotation_about("y", angle), np.array(by))


def assert_alike(one: WarpedImage, other: WarpedImage, share: float = 0.999) -> None:
    """Same status, source to 1e-3 px, colour to one code; but where rounding decides on which side of an edge."""
    same = one.status == other.status
    assert same.mean() > share
    found = same & (one.status <= WarpStatus.DISOCCLUDED)
    close = np.abs(present(one.source)[found] - present(other.source)[found]).max(axis=-1) < 1e-3
    assert close.mean() > share
    assert np.abs(one.colour[found].astype(int) - other.colour[found])[close].max() <= 1


CELLS = WarpGrid.edge_to_edge(Panel(80, 60), 21, 16)
FINE_CELLS = WarpGrid.edge_to_edge(Panel(80, 60), 81, 61)
# Rows of the display at the rows of those grids; 0 is the centre of the first row.
ROW_OF_CELLS, ROW_OF_FINE_CELLS = (grid.axes_px()[1] - 0.5 for grid in (CELLS, FINE_CELLS))


def at_points(warp_grid: WarpGrid, offset: float = 0.02) -> Float32Array:
    """`smooth_bend` at the points of a warp grid."""
    u, v = np.moveaxis(warp_grid.panel_pixel() / warp_grid.panel.size_px, -1, 0)
    return smooth_bend(u, v, offset)


def by_opengl(
    context: GlContext,
    image: GeometryImage,
    offsets: Sequence[float],
    transform: FloatArray,
    hole: tuple[int, int] | None = None,
    **options: Any,
) -> WarpedImage:
    """Along `smooth_bend` rays of each channel; the first has no ray at the corners of a pixel (row, column)."""
    fields = [at_points(FINE_CELLS, offset) for offset in offsets]
    if hole is not None:
        fields[0][:, hole[0] : hole[0] + 2, hole[1] : hole[1] + 2] = np.nan
    textures = [uploaded_field(context, field, FINE_CELLS) for field in fields]
    warp, picture = GlWarp(context, len(offsets)), uploaded(context, image, SHARPER)
    return warp.draw(picture, textures, transform, (WIDTH, HEIGHT), with_source=True, **options).read()


def in_other_frame(slope_offset: Float32Array, transform: FloatArray) -> FloatArray:
    """Rays (4, ...) told in another camera frame: X = (c, d, 0) + l (a, b, -1), moved and slid along to z = 0."""
    a, b, c, d = slope_offset.astype(float)
    start = transforms.apply(transform, np.stack([c, d, 0 * c], axis=-1))
    direction = transforms.rotate(transform, np.stack([a, b, -np.ones_like(a)], axis=-1))
    tangents = direction[..., :2] / -direction[..., 2:]
    return np.moveaxis(np.concatenate([tangents, start[..., :2] + start[..., 2:] * tangents], axis=-1), -1, 0)


@pytest.mark.parametrize("samples_per_axis", [1, 2])
def test_rays_transformed_to_another_frame(gl_context: GlContext, image: GeometryImage, samples_per_axis: int) -> None:
    """The shader's transform is that of rays which are told in the picture's frame to begin with."""
    options: dict[str, Any] = {"samples_per_axis": samples_per_axis}
    transform = motion(0.15)
    carried = by_opengl(gl_context, image, [0.02], transform, **options)
    rays = uploaded_field(gl_context, in_other_frame(at_points(FINE_CELLS), transform), FINE_CELLS)
    picture = uploaded(gl_context, image, SHARPER)
    told = GlWarp(gl_context).draw(picture, [rays], np.eye(4), (WIDTH, HEIGHT), with_source=True, **options).read()
    assert_alike(carried, told)
    assert {WarpStatus.SEEN, WarpStatus.DISOCCLUDED, WarpStatus.OUTSIDE} <= set(carried.status.ravel())


def test_each_row_has_its_own_transform(gl_context: GlContext, image: GeometryImage) -> None:
    def of_row(k: float) -> FloatArray:
        return motion(0.1 * k / HEIGHT, (0.02 * k / HEIGHT, 0, 0))

    result = by_opengl(gl_context, image, [0.02], np.stack([of_row(k) for k in ROW_OF_FINE_CELLS]))
    for row in (0, 31, HEIGHT - 1):
        alone = by_opengl(gl_context, image, [0.02], of_row(row))
        shown, expected = (
            WarpedImage(each.colour[row], each.status[row], present(each.source)[row]) for each in (result, alone)
        )
        assert_alike(shown, expected)


def test_rows_between_coarse_grid_points_take_their_own_transform(gl_context: GlContext, image: GeometryImage) -> None:
    """A coarse grid of curved rays gives the sources of one with a point at every pixel's corners."""

    def by_row(rows: FloatArray) -> FloatArray:
        return np.stack([motion(0.02 * k / HEIGHT, (0.005 * k / HEIGHT, 0, 0)) for k in rows])

    field, picture = uploaded_field(gl_context, at_points(CELLS), CELLS), uploaded(gl_context, image, SHARPER)
    size = WIDTH, HEIGHT
    drawn = GlWarp(gl_context).draw(picture, [field], by_row(ROW_OF_CELLS), size, with_source=True).read()
    expected = by_opengl(gl_context, image, [0.02], by_row(ROW_OF_FINE_CELLS))
    same = (drawn.status == 0) & (expected.status == 0)
    assert same.mean() > 0.7
    assert np.percentile(np.abs(present(drawn.source) - present(expected.source))[same], 99) < 0.005


@pytest.mark.parametrize("samples_per_axis", [1, 2])
def test_each_colour_follows_its_own_rays(gl_context: GlContext, image: GeometryImage, samples_per_axis: int) -> None:
    offsets, hole = (0.018, 0.02, 0.025), (3, 4)
    options: dict[str, Any] = {"background": (9, 8, 7), "samples_per_axis": samples_per_axis}
    result = by_opengl(gl_context, image, offsets, motion(0.02), **options)
    for channel, offset in enumerate(offsets):
        alone = by_opengl(gl_context, image, [offset], motion(0.02), **options)
        assert (np.abs(result.colour[..., channel].astype(int) - alone.colour[..., channel]) <= 1).mean() > 0.999
        assert (result.status >= alone.status).mean() > 0.999
        if channel == 1:
            np.testing.assert_allclose(present(result.source), present(alone.source), atol=1e-3)
    holed = by_opengl(gl_context, image, offsets, motion(0.02), hole=hole, **options)
    assert holed.status[hole] == WarpStatus.NO_RAY
    assert holed.colour[hole][0] == 9
    assert (holed.colour[hole][1:] == result.colour[hole][1:]).all()


@pytest.mark.parametrize("times", [1, 2])
def test_between_grid_points_the_shader_interpolates_as_the_warp_grid_does(
    gl_context: GlContext, image: GeometryImage, times: int
) -> None:
    size = (80 * times, 60 * times)
    slope_offset = at_points(CELLS, offset=0.0)
    field = uploaded_field(gl_context, slope_offset, CELLS)
    drawn = GlWarp(gl_context).draw(uploaded(gl_context, image, SHARPER), [field], np.eye(4), size, with_source=True)
    pixel = (np.stack(np.meshgrid(*map(np.arange, size)), axis=-1) + 0.5) / times
    rays = CELLS.interpolated(slope_offset.astype(float), pixel.reshape(-1, 2)).reshape(*pixel.shape[:2], 4)
    np.testing.assert_allclose(present(drawn.read().source), SHARPER.pixel_of_tangents(rays[..., :2]), atol=1e-3)


def test_an_unsolved_grid_point_makes_a_hole_of_its_triangles(gl_context: GlContext, image: GeometryImage) -> None:
    slope_offset = at_points(CELLS, offset=0.0)
    slope_offset[:, 7, 9] = np.nan
    field = uploaded_field(gl_context, slope_offset, CELLS)
    picture = uploaded(gl_context, image, SHARPER)
    status = GlWarp(gl_context).draw(picture, [field], np.eye(4), (80, 60)).read().status
    v, u = np.indices((60, 80)) + 0.5 - np.array([28, 36])[:, None, None]
    within = (np.abs(u) < 4) & (np.abs(v) < 4) & (np.abs(u + v) < 4)
    on_border = np.abs(u + v) == 4
    np.testing.assert_array_equal(status[~on_border] == WarpStatus.NO_RAY, within[~on_border])
    assert (status[status != WarpStatus.NO_RAY] == WarpStatus.SEEN).all()


def test_mismatched_ray_maps_and_transforms_are_refused(gl_context: GlContext, image: GeometryImage) -> None:
    warp, picture = GlWarp(gl_context, 3), uploaded(gl_context, image, SHARPER)
    field = uploaded_field(gl_context, at_points(CELLS), CELLS)
    other = WarpGrid.edge_to_edge(CELLS.panel, 5, 6)
    for fields in ([field], [field, field, uploaded_field(gl_context, at_points(other), other)]):
        with pytest.raises(BadInputError, match="one ray map for each channel, all of one warp grid"):
            warp.draw(picture, fields, np.eye(4), (WIDTH, HEIGHT))
    with pytest.raises(BadInputError, match="one transform for each row"):
        warp.draw(picture, [field] * 3, np.zeros((HEIGHT, 4, 4)), (WIDTH, HEIGHT))
