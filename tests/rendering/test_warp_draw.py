"""Rays told in another frame, coarser than pixels, per row and per colour; pictures into a caller's framebuffer."""

import numpy as np
import pytest
from warping import BACKENDS, uploaded, uploaded_field, warped

from wlr_render.errors import BadInputError
from wlr_render.geometry import transforms
from wlr_render.geometry.pinhole import Pinhole
from wlr_render.mappings import Panel
from wlr_render.rendering.gl_warp import GlWarp, WarpTarget
from wlr_render.rendering.view import GeometryImage
from wlr_render.rendering.warp import WarpStatus
from wlr_render.rendering.warp_grid import WarpGrid

pytestmark = pytest.mark.gl

CAMERA = Pinhole(200, 160, np.array([-0.5, -0.4]), np.array([0.5, 0.4]))
HEIGHT, WIDTH = 60, 80


@pytest.fixture
def image():
    """A near disc before a tilted wall, with smooth colours."""
    tangents = CAMERA.pixel_centre_tangents()
    depth = 0.7 + 0.4 * tangents[..., 0] - 0.2 * tangents[..., 1]
    depth[np.hypot(*np.moveaxis(tangents - [0.05, 0.0], -1, 0)) < 0.12] = 2.0
    waves = np.stack([tangents @ np.array(k) for k in ([9, 4], [-5, 11], [12, -7])], axis=-1)
    return GeometryImage(np.rint(127 + 120 * np.sin(waves)).astype(np.uint8), depth.astype(np.float32))


def smooth_bend(u, v, offset=0.02):
    """Rays at display positions from 0 to 1, bent smoothly; (4, ...)."""
    x, y = u - 0.5, 0.5 - v
    a, b = 0.7 * x * (1 + 0.3 * y * y), 0.6 * y * (1 + 0.2 * x)
    return np.stack([a, b, offset * (1 + x), -0.4 * offset * (1 - y)]).astype(np.float32)


def pixel_bend(offset=0.02):
    u, v = np.meshgrid((np.arange(WIDTH) + 0.5) / WIDTH, (np.arange(HEIGHT) + 0.5) / HEIGHT)
    return smooth_bend(u, v, offset)


def motion(angle, by=(0.01, -0.005, 0.02)):
    return transforms.rigid(transforms.rotation_about("y", angle), np.array(by))


def assert_alike(one, other, share=0.999):
    """Same status, source to 1e-3 px, colour to one code; but where rounding decides on which side of an edge."""
    same = one.status == other.status
    assert same.mean() > share
    found = same & (one.status <= WarpStatus.DISOCCLUDED)
    close = np.abs(one.source[found] - other.source[found]).max(axis=-1) < 1e-3
    assert close.mean() > share
    assert np.abs(one.colour[found].astype(int) - other.colour[found])[close].max() <= 1


def same_by_both(request, *args, **options):
    """The CPU's picture, after it was found to be that of OpenGL."""
    ours, theirs = (warped(backend, request, *args, **options) for backend in BACKENDS)
    assert_alike(ours, theirs)
    return ours


@pytest.mark.parametrize("samples_per_axis", [1, 2])
def test_rays_transformed_to_another_frame(request, image, samples_per_axis):
    result = same_by_both(request, image, CAMERA, [pixel_bend()], motion(0.15), samples_per_axis=samples_per_axis)
    assert {WarpStatus.SEEN, WarpStatus.DISOCCLUDED, WarpStatus.OUTSIDE} <= set(result.status.ravel())


def test_each_row_has_its_own_transform(request, image):
    slope_offset = pixel_bend()
    by_row = np.stack([motion(0.1 * k / HEIGHT, (0.02 * k / HEIGHT, 0, 0)) for k in range(HEIGHT)])
    result = same_by_both(request, image, CAMERA, [slope_offset], by_row)
    for row in (0, 31, HEIGHT - 1):
        alone = warped("cpu", request, image, CAMERA, [slope_offset], by_row[row])
        np.testing.assert_array_equal(result.source[row], alone.source[row])
        np.testing.assert_array_equal(result.colour[row], alone.colour[row])


@pytest.mark.parametrize("samples_per_axis", [1, 2])
def test_each_colour_follows_its_own_rays(request, image, samples_per_axis):
    slope_offsets = [pixel_bend(offset) for offset in (0.018, 0.02, 0.025)]
    slope_offsets[0][:, 3, 4] = np.nan
    result = same_by_both(
        request, image, CAMERA, slope_offsets, motion(0.02), background=(9, 8, 7), samples_per_axis=samples_per_axis
    )
    for channel, slope_offset in enumerate(slope_offsets):
        alone = warped(
            "gl",
            request,
            image,
            CAMERA,
            [slope_offset],
            motion(0.02),
            background=(9, 8, 7),
            samples_per_axis=samples_per_axis,
        )
        assert (np.abs(result.colour[..., channel].astype(int) - alone.colour[..., channel]) <= 1).mean() > 0.999
        assert (result.status >= alone.status).mean() > 0.999
    green = warped("cpu", request, image, CAMERA, [slope_offsets[1]], motion(0.02))
    np.testing.assert_array_equal(result.source, green.source)
    assert result.status[3, 4] == WarpStatus.NO_RAY
    assert result.colour[3, 4, 0] == 9
    assert green.status[3, 4] == WarpStatus.SEEN


def coarse(step_px, columns=21, rows=16):
    """A warp grid from edge to edge of a panel that it samples every `step_px` pixels."""
    panel = Panel((columns - 1) * step_px, (rows - 1) * step_px)
    warp_grid = WarpGrid.edge_to_edge(panel, columns, rows)
    u, v = np.moveaxis(warp_grid.panel_pixel() / panel.size_px, -1, 0)
    return warp_grid, smooth_bend(u, v, offset=0.0)


@pytest.mark.parametrize("as_many_pixels_as_points", [False, True])
@pytest.mark.parametrize("software", [True, False])
def test_all_backends_interpolate_linearly_between_grid_points(
    gl_context, image, software, as_many_pixels_as_points, monkeypatch
):
    # A GPU's filter has weights of 8 bits; there the shader weighs the points itself.
    monkeypatch.setattr(type(gl_context), "is_software", software)
    step_px = 4
    warp_grid, slope_offset = coarse(step_px)
    panel = warp_grid.panel
    size = warp_grid.size if as_many_pixels_as_points else (panel.width_px, panel.height_px)
    field = uploaded_field(gl_context, slope_offset, warp_grid)
    source = GlWarp(gl_context).draw(uploaded(gl_context, image, CAMERA), [field], np.eye(4), size, with_source=True)
    pixel = np.stack(np.meshgrid(np.arange(size[0]), np.arange(size[1])), axis=-1) + 0.5
    place = pixel * (panel.size_px / size) / step_px
    base = place.astype(int)
    weight = (place - base)[..., None, :]
    corner = [[np.moveaxis(slope_offset[:, base[..., 1] + j, base[..., 0] + i], 0, -1) for i in (0, 1)] for j in (0, 1)]
    upper, lower = (left + weight[..., 0] * (right - left) for left, right in corner)
    expected = CAMERA.pixel_of_tangents((upper + weight[..., 1] * (lower - upper))[..., :2])
    np.testing.assert_allclose(source.read().source, expected, atol=1e-3)


def test_an_unsolved_grid_point_makes_a_hole_around_it(gl_context, image):
    warp_grid, slope_offset = coarse(4)
    slope_offset[:, 7, 9] = np.nan
    size = (warp_grid.panel.width_px, warp_grid.panel.height_px)
    field = uploaded_field(gl_context, slope_offset, warp_grid)
    status = GlWarp(gl_context).draw(uploaded(gl_context, image, CAMERA), [field], np.eye(4), size).read().status
    expected = np.full(size[::-1], WarpStatus.SEEN)
    expected[24:32, 32:40] = WarpStatus.NO_RAY
    np.testing.assert_array_equal(status, expected)


@pytest.mark.parametrize("top_row_first", [True, False])
def test_into_a_part_of_a_callers_framebuffer(gl_context, image, top_row_first):
    with gl_context.drawing():
        canvas = gl_context.target((WIDTH + 30, HEIGHT + 20), 4, "f1")
        canvas.write(np.full((HEIGHT + 20, WIDTH + 30, 4), 77, np.uint8))
        framebuffer = gl_context.framebuffer([canvas])
    warp, picture, field = (
        GlWarp(gl_context),
        uploaded(gl_context, image, CAMERA),
        uploaded_field(gl_context, pixel_bend()),
    )
    viewport = framebuffer.viewport
    target = WarpTarget(framebuffer, (20, 5), (WIDTH, HEIGHT), top_row_first)
    by_row = np.stack([motion(0.1 * k / HEIGHT) for k in range(HEIGHT)])
    warp.draw_into(target, picture, [field], by_row, (1, 2, 3), samples_per_axis=2)
    assert framebuffer.viewport == viewport
    expected = warp.draw(picture, [field], by_row, (WIDTH, HEIGHT), (1, 2, 3), samples_per_axis=2).read().colour
    with gl_context.drawing():
        drawn = np.frombuffer(canvas.read(), np.uint8).reshape(HEIGHT + 20, WIDTH + 30, 4)
    part = drawn[5 : 5 + HEIGHT, 20 : 20 + WIDTH]
    upright = part if top_row_first else part[::-1]
    assert (np.abs(upright[..., :3].astype(int) - expected) <= 1).mean() > 0.999
    assert (part[..., 3] == 255).all()
    untouched = np.ones(drawn.shape[:2], bool)
    untouched[5 : 5 + HEIGHT, 20 : 20 + WIDTH] = False
    assert (drawn[untouched] == 77).all()


def test_mismatched_ray_maps_and_transforms_are_refused(gl_context, image):
    warp, picture, field = (
        GlWarp(gl_context, 3),
        uploaded(gl_context, image, CAMERA),
        uploaded_field(gl_context, pixel_bend()),
    )
    with pytest.raises(BadInputError, match="one ray map for each channel"):
        warp.draw(picture, [field], np.eye(4), (WIDTH, HEIGHT))
    with pytest.raises(BadInputError, match="one transform for each row"):
        warp.draw(picture, [field] * 3, np.zeros((HEIGHT - 1, 4, 4)), (WIDTH, HEIGHT))
