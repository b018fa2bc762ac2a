import numpy as np
import pytest
from cpu_raster import raster_on_cpu
from gl_scenes import OFF_CENTRE, at, cube, lit, quad, unlit, view

from wlr_render.geometry import directions, transforms
from wlr_render.rendering.gl_raster import GlRaster
from wlr_render.rendering.ray_tracing import RayRenderer


def test_a_rectangle_lands_on_its_analytic_pixels_right_way_up():
    corners = OFF_CENTRE.tangents_of_pixel(np.array([[10.0, 20.0], [30.0, 5.0]])) * 2.0
    red = quad(*corners, base_colour=np.array([1, 0, 0], np.float32))
    image = raster_on_cpu(unlit((red, at(0, 0, -2)), background=(0, 1, 0)), view())
    expected = np.zeros((48, 64), bool)
    expected[5:20, 10:30] = True
    np.testing.assert_array_equal(image.inverse_depth > 0, expected)
    np.testing.assert_array_equal(image.colour, np.where(expected[..., None], [255, 0, 0], [0, 255, 0]))


@pytest.mark.parametrize("viewpoint", [(0.0, 0.0, 0.0), (0.03, -0.02, 0.01)])
def test_inverse_depth_of_a_tilted_plane_is_the_closed_form(viewpoint):
    turn = transforms.rotation_about("y", 0.7) @ transforms.rotation_about("x", -0.4)
    head = transforms.rigid(transforms.rotation_about("y", 0.2), np.array([1.0, 1.6, -2.5]))
    wall = head @ at(0.1, 0.2, -1.5, turn)
    image = raster_on_cpu(unlit((quad((-4, -4), (4, 4)), wall)), view(OFF_CENTRE, viewpoint, head))
    # In the camera frame: normal . (tx, ty, -1) / w = normal . point.
    normal, point = turn[:, 2], np.array([0.1, 0.2, -1.5]) - viewpoint
    expected = (OFF_CENTRE.pixel_centre_tangents() @ normal[:2] - normal[2]) / (normal @ point)
    np.testing.assert_allclose(image.inverse_depth, expected, rtol=1e-5)


def two_cubes():
    box = cube()
    return lit(
        (box, at(-0.3, 0.1, -2.0, transforms.rotation_about("y", 0.6))),
        (box, at(0.4, -0.2, -2.6, transforms.rotation_about("x", 0.4))),
    )


def test_the_image_agrees_with_ray_tracing_its_pixels():
    head = transforms.rigid(transforms.rotation_about("x", 0.1), np.array([0.0, 0.1, 0.2]))
    frame = view(OFF_CENTRE, (0.01, 0.0, 0.02), head)
    image = raster_on_cpu(two_cubes(), frame)
    in_camera = directions.dir_of_tangents(OFF_CENTRE.pixel_centre_tangents())
    direction = transforms.rotate(frame.world_from_camera, in_camera)
    traced = RayRenderer(two_cubes()).render_rays(frame.position_in_world, direction, with_position=True)
    seen = np.isfinite(traced.distance)
    assert np.abs(image.colour.astype(int) - traced.colour).max() <= 1
    in_camera = transforms.apply(np.linalg.inv(frame.world_from_camera), traced.position[seen].astype(float))
    np.testing.assert_allclose(image.inverse_depth[seen], -1 / in_camera[:, 2], rtol=1e-5)
    assert (image.inverse_depth[~seen] == 0).all()


@pytest.mark.gl
def test_it_draws_what_opengl_draws(gl_context):
    frame = view(OFF_CENTRE, (0.01, 0.0, 0.02))
    ours, theirs = raster_on_cpu(two_cubes(), frame), GlRaster(gl_context, two_cubes()).draw(frame)
    # Pixel centres within rounding of a silhouette may fall to either side.
    assert np.isclose(ours.inverse_depth, theirs.inverse_depth, rtol=2e-5).mean() > 0.998
    assert (np.abs(ours.colour.astype(int) - theirs.colour).max(axis=-1) <= 1).mean() > 0.998


def test_a_wide_view_has_depth_along_the_axis_not_along_the_ray():
    image = raster_on_cpu(unlit((quad((-9, -9), (9, 9)), at(0, 0, -2))), view())
    np.testing.assert_allclose(image.inverse_depth, 0.5, rtol=1e-6)
    slant = directions.dir_of_tangents(OFF_CENTRE.pixel_centre_tangents())[..., 2].max()
    assert slant > -0.95
