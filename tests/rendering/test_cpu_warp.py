import cpu_warp
import numpy as np
import pytest
from cpu_raster import raster_on_cpu
from cpu_warp import warp_on_cpu
from gl_scenes import at, cube, lit, quad, unlit, view
from warping import warp_pixels

from wlr_render.geometry import transforms
from wlr_render.geometry.pinhole import Pinhole
from wlr_render.rendering.gl_raster import GlRaster
from wlr_render.rendering.painters import inverse_depth_at
from wlr_render.rendering.ray_tracing import RayRenderer
from wlr_render.rendering.view import GeometryImage
from wlr_render.rendering.warp import DIRECT_PX, WarpStatus

CAMERA = Pinhole(200, 160, np.array([-0.55, -0.4]), np.array([0.45, 0.4]))
TEXTURE = np.random.default_rng(2).integers(0, 256, (16, 16, 3)).astype(np.uint8)
OFFSET = 0.02


def bend_over(height=60, width=80, offset=(OFFSET, -0.5 * OFFSET), half_tangents=(0.35, 0.3)):
    """Rays with tangents on a grid, beside the viewpoint by an offset that changes slowly."""
    ty, tx = np.meshgrid(
        np.linspace(half_tangents[1], -half_tangents[1], height),
        np.linspace(-half_tangents[0], half_tangents[0], width),
        indexing="ij",
    )
    return np.stack([tx, ty, offset[0] * (1 + tx), offset[1] * (1 - ty)]).astype(np.float32)


def flat_image(inverse_depth, colour=None):
    shape = (CAMERA.height_px, CAMERA.width_px)
    depth = np.broadcast_to(np.asarray(inverse_depth, np.float32), shape).copy()
    return GeometryImage(np.zeros((*shape, 3), np.uint8) if colour is None else colour, depth)


def source_at(slope_offset, inverse_depth):
    """Where points of the rays at known inverse depths appear, (height, width, 2), in float64."""
    a, b, c, d = slope_offset.astype(float)
    return CAMERA.pixel_of_tangents(np.stack([a + c * inverse_depth, b + d * inverse_depth], axis=-1))


@pytest.mark.parametrize("depth", [0.3, 2.0])
def test_a_frontal_plane_at_known_depth(depth):
    slope_offset = bend_over()
    warped = warp_on_cpu(flat_image(1 / depth), CAMERA, [slope_offset])
    assert (warped.status == WarpStatus.SEEN).all()
    np.testing.assert_allclose(warped.source, source_at(slope_offset, 1 / depth), atol=1e-4)


def test_a_tilted_plane_at_known_depth():
    # In front of the viewpoint the plane n . p = 1 has inverse depth n . (tx, ty, -1) in every direction.
    normal = np.array([0.5, -0.3, -0.8])
    slope_offset = bend_over()
    warped = warp_on_cpu(flat_image(CAMERA.pixel_centre_tangents() @ normal[:2] - normal[2]), CAMERA, [slope_offset])
    a, b, c, d = slope_offset.astype(float)
    expected = (normal[0] * a + normal[1] * b - normal[2]) / (1 - normal[0] * c - normal[1] * d)
    assert (warped.status == WarpStatus.SEEN).all()
    np.testing.assert_allclose(warped.source, source_at(slope_offset, expected), atol=1e-3)


def test_straight_rays_through_pixel_centres_change_no_bit():
    colour = np.random.default_rng(0).integers(0, 256, (CAMERA.height_px, CAMERA.width_px, 3)).astype(np.uint8)
    tangents = CAMERA.pixel_centre_tangents()
    slope_offset = np.concatenate([tangents, 0 * tangents], axis=-1).transpose(2, 0, 1).astype(np.float32)
    warped = warp_on_cpu(flat_image(0.7, colour), CAMERA, [slope_offset])
    # Float32 puts centres off by 1e-5 px, worth no code but at a tie.
    assert np.abs(warped.colour.astype(int) - colour).max() <= 1
    assert (warped.colour == colour).mean() > 0.99


def test_the_background_is_met_where_the_tangents_point():
    slope_offset = bend_over()
    warped = warp_on_cpu(flat_image(0.0), CAMERA, [slope_offset])
    np.testing.assert_allclose(warped.source, source_at(slope_offset, 0.0), atol=1e-4)


def test_pixels_without_a_ray_and_rays_that_lead_outside():
    slope_offset = bend_over()
    slope_offset[:, 4:8, 5:9] = np.nan
    slope_offset[0, 20:25] = 3.0
    warped = warp_on_cpu(flat_image(1.0), CAMERA, [slope_offset], background=(9, 8, 7))
    expected = np.full(slope_offset.shape[1:], WarpStatus.SEEN)
    expected[4:8, 5:9] = WarpStatus.NO_RAY
    expected[20:25] = WarpStatus.OUTSIDE
    np.testing.assert_array_equal(warped.status, expected)
    np.testing.assert_array_equal(np.isnan(warped.source).any(axis=-1), expected > 0)
    np.testing.assert_array_equal(warped.colour[expected > 0], [[9, 8, 7]] * int((expected > 0).sum()))


def step_image():
    """A near half, 0.5 m away, left of column 100, before a wall at 2 m."""
    near = np.arange(CAMERA.width_px)[None, :] < 100
    colour = np.where(near[..., None], [200, 0, 0], [0, 0, 200]) + np.zeros((CAMERA.height_px, 1, 1))
    return flat_image(np.where(near, 2.0, 0.5), colour.astype(np.uint8))


def test_at_an_edge_the_near_surface_hides_and_the_uncovered_shows_the_far_one():
    slope_offset = bend_over(offset=(-OFFSET, 0.0))
    warped = warp_on_cpu(step_image(), CAMERA, [slope_offset])
    on_near, on_far = source_at(slope_offset, 2.0)[..., 0] < 100, source_at(slope_offset, 0.5)[..., 0] > 100
    both = on_near & on_far
    assert both.any()
    expected = np.where(on_near[..., None], source_at(slope_offset, 2.0), source_at(slope_offset, 0.5))
    np.testing.assert_allclose(warped.source, expected, atol=1e-3)
    assert (warped.status == WarpStatus.SEEN).all()
    # From the other side the rays pass the near edge, and meet what the image does not show.
    slope_offset = bend_over(offset=(OFFSET, 0.0))
    warped = warp_on_cpu(step_image(), CAMERA, [slope_offset])
    hidden = (source_at(slope_offset, 2.0)[..., 0] > 100.01) & (source_at(slope_offset, 0.5)[..., 0] < 99.99)
    assert hidden.any()
    np.testing.assert_array_equal(warped.status == WarpStatus.DISOCCLUDED, hidden)
    # What stands in is the far surface.
    np.testing.assert_allclose(warped.source[hidden], source_at(slope_offset, 2.0)[hidden], atol=1e-3)
    assert (warped.colour[hidden][:, 2] > warped.colour[hidden][:, 0]).all()


def test_inverse_depth_is_not_mixed_across_an_edge():
    depth = step_image().inverse_depth
    at_edge = np.stack([np.linspace(98, 102, 41), np.full(41, 30.2)], axis=1)
    seen = inverse_depth_at(depth, at_edge)
    np.testing.assert_array_equal(seen, np.where(at_edge[:, 0].astype(np.float32) < 100, 2.0, 0.5))
    slope = CAMERA.pixel_centre_tangents()[..., 0].astype(np.float32) * 0.2 + 1
    places = np.random.default_rng(1).uniform(1, 150, (100, 2))
    expected = CAMERA.tangents_of_pixel(places)[:, 0] * 0.2 + 1
    np.testing.assert_allclose(inverse_depth_at(slope, places), expected, atol=1e-6)


def test_blocks_and_threads_change_no_bit(monkeypatch):
    slope_offset = bend_over()
    slope_offset[:, 3, 5] = np.nan
    whole = warp_on_cpu(step_image(), CAMERA, [slope_offset])
    monkeypatch.setattr(cpu_warp, "_PIXELS_PER_BLOCK", 100)
    cut = warp_on_cpu(step_image(), CAMERA, [slope_offset])
    for name in ("colour", "status", "source"):
        np.testing.assert_array_equal(getattr(cut, name), getattr(whole, name), err_msg=name)


@pytest.mark.gl
def test_it_warps_as_opengl_does(gl_context):
    wall = quad((-3, -3), (3, 3), texture=TEXTURE)
    box = at(0.1, 0.0, -1.5, transforms.rotation_about("y", 0.6) @ transforms.rotation_about("x", 0.4))
    scene = lit((wall, at(0, 0, -3)), (cube(0.5), box))
    slope_offset = bend_over()
    slope_offset[:, 10:14, 30:50] = np.nan
    image = GlRaster(gl_context, scene).draw_on_gpu(view(CAMERA))
    theirs = warp_pixels(gl_context, image, [slope_offset])
    ours = warp_on_cpu(image.read(), CAMERA, [slope_offset])
    beside_hole = np.zeros(ours.status.shape, bool)
    beside_hole[9:15, 29:51] = True  # OpenGL's hole has its border between pixels
    beside_hole[10:14, 30:50] = False
    same = (ours.status == theirs.status) & ~beside_hole
    assert same[~beside_hole].mean() > 0.999
    assert {int(WarpStatus.SEEN), int(WarpStatus.DISOCCLUDED), int(WarpStatus.NO_RAY)} <= set(ours.status[same])
    found = same & (ours.status <= WarpStatus.DISOCCLUDED)
    apart = np.abs(ours.source[found] - theirs.source[found]).max(axis=-1)
    # A search that ends within rounding of an edge may end on its other side.
    seen = ours.status[found] == WarpStatus.SEEN
    assert (apart[seen] < 1e-3).mean() > 0.999
    # What stands in for a hidden point is read within a step of its edge, and the two divide the path differently: the
    # depth of a surface changes in a step by what moves a point by some DIRECT_PX, which the warp takes for nothing.
    assert (apart[~seen] < DIRECT_PX).mean() > 0.98
    alike = np.abs(ours.colour[found].astype(int) - theirs.colour[found])[apart < 1e-3]
    assert alike.max() <= 1


def test_raster_and_warp_give_the_traced_picture_of_a_plane():
    scene = unlit((quad((-3, -3), (3, 3), texture=TEXTURE), at(0, 0, -2)))
    slope_offset = bend_over()
    warped = warp_on_cpu(raster_on_cpu(scene, view(CAMERA)), CAMERA, [slope_offset])
    a, b, c, d = slope_offset
    origin = np.stack([c, d, 0 * c], axis=-1)
    direction = np.stack([a, b, -np.ones_like(a)], axis=-1)
    traced = RayRenderer(scene).render_rays(origin, direction)
    error = np.abs(warped.colour.astype(int) - traced.colour)
    # Two pixels of the intermediate image per display pixel: what is left is its sampling.
    assert error.mean() < 2.0
