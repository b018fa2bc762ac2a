from dataclasses import replace

import gl_scenes
import numpy as np
import pytest
from gl_scenes import at, cube, quad, unlit, view
from hardware import allowed, snap_of

from wlr_render.draw.gl_raster import GlRaster
from wlr_render.geometry import directions, transforms
from wlr_render.geometry.pinhole import Pinhole
from wlr_render.gl.context import GlContext
from wlr_render.numerics.arrays import FloatArray
from wlr_render.warp.view import GeometryImage

pytestmark = pytest.mark.gl

CAMERA = gl_scenes.OFF_CENTRE


def srgb(linear: FloatArray | float) -> FloatArray | float:
    linear = np.asarray(linear, float)
    return np.where(linear <= 0.0031308, 12.92 * linear, 1.055 * linear ** (1 / 2.4) - 0.055) * 255


def positions(image: GeometryImage) -> FloatArray:
    """The points that a picture of `CAMERA` from the origin shows, (height, width, 3)."""
    tangents = CAMERA.pixel_centre_tangents()
    return np.concatenate([tangents, -np.ones((*tangents.shape[:2], 1))], axis=-1) / image.inverse_depth[..., None]


def test_a_rectangle_lands_on_its_analytic_pixels_right_way_up(gl_context: GlContext) -> None:
    # Edges at pixel borders: columns 10..29, rows 5..19, in a plane 2 m away, red in green.
    corners = CAMERA.tangents_of_pixel(np.array([[10.0, 20.0], [30.0, 5.0]])) * 2.0
    red = quad(*corners, base_colour=np.array([1, 0, 0], np.float32))
    image = GlRaster(gl_context, unlit((red, at(0, 0, -2)), background=(0, 0.25, 0))).draw(view())
    expected = np.zeros((48, 64), bool)
    expected[5:20, 10:30] = True
    np.testing.assert_array_equal(image.inverse_depth > 0, expected)
    np.testing.assert_array_equal(image.colour[expected], [[255, 0, 0]] * expected.sum())
    np.testing.assert_array_equal(image.colour[~expected], [[0, round(float(srgb(0.25))), 0]] * (~expected).sum())


@pytest.mark.parametrize("viewpoint", [(0.0, 0.0, 0.0), (0.03, -0.02, 0.01)])
def test_inverse_depth_of_a_tilted_plane_is_the_closed_form(
    gl_context: GlContext, viewpoint: tuple[float, float, float]
) -> None:
    turn = transforms.rotation_about("y", 0.7) @ transforms.rotation_about("x", -0.4)
    head = transforms.rigid(transforms.rotation_about("y", 0.2), np.array([100.0, 1.6, -250.0]))
    wall = head @ at(0.1, 0.2, -1.5, turn)
    image = GlRaster(gl_context, unlit((quad((-4, -4), (4, 4)), wall))).draw(view(CAMERA, viewpoint, head))
    # In the camera frame: normal . (tx, ty, -1) / w = normal . point.
    normal, point = turn[:, 2], np.array([0.1, 0.2, -1.5]) - viewpoint
    tangents = CAMERA.pixel_centre_tangents()
    expected = (tangents @ normal[:2] - normal[2]) / (normal @ point)
    most = 1e-6 * expected + allowed(gl_context, 0.0, snap_of(expected))
    assert (np.abs(image.inverse_depth - expected) <= most).all()


def test_instances_of_a_shared_mesh_lie_each_in_its_place(gl_context: GlContext) -> None:
    tile = quad((-0.1, -0.1), (0.1, 0.1))
    scene = unlit((tile, at(-0.6, 0, -2)), (tile, at(0.3, 0, -4)))
    seen = GlRaster(gl_context, scene).draw(view()).inverse_depth
    tangents = CAMERA.pixel_centre_tangents()
    assert set(np.unique(seen)) == {0, 0.25, 0.5}
    assert (np.abs(2 * tangents[seen == 0.5] - [-0.6, 0]) < 0.1).all()
    assert (np.abs(4 * tangents[seen == 0.25] - [0.3, 0]) < 0.1).all()


def test_the_nearer_cube_hides_the_farther_whichever_is_drawn_first(gl_context: GlContext) -> None:
    near, far = (cube(0.4), at(-0.1, 0, -1.5)), (cube(1.2), at(-0.3, 0, -3))
    frames = [GlRaster(gl_context, unlit(*pair)).draw(view()) for pair in ((near, far), (far, near))]
    np.testing.assert_array_equal(frames[0].colour, frames[1].colour)
    np.testing.assert_array_equal(frames[0].inverse_depth, frames[1].inverse_depth)
    centre = CAMERA.pixel_of_tangents(np.array([-0.1 / 1.5, 0.0])).astype(int)
    np.testing.assert_allclose(frames[0].inverse_depth[centre[1], centre[0]], 1 / 1.3, rtol=1e-6)


@pytest.mark.parametrize("side", [0.0, np.pi])
def test_lights_follow_the_stated_law_on_both_sides(gl_context: GlContext, side: float) -> None:
    turn = transforms.rotation_about("y", side)
    albedo = np.array([0.5, 0.6, 0.7], np.float32)
    scene = gl_scenes.lit((quad((-9, -9), (9, 9), base_colour=albedo), at(0, 0, -2, turn)))
    image = GlRaster(gl_context, scene).draw(view())
    to_lamp = scene.lights[0].vector - positions(image)
    squared = np.sum(to_lamp**2, axis=-1, keepdims=True)
    lambert = to_lamp[..., 2:] / np.sqrt(squared)
    light = scene.ambient + scene.lights[0].colour * lambert / squared + scene.lights[1].colour * 0.8
    expected = np.asarray(srgb(np.clip(albedo * light, 0, 1)))
    assert (np.abs(image.colour - expected) <= allowed(gl_context, 0.51, snap_of(expected))).all()


def test_a_moved_viewpoint_and_a_new_size_redraw_everything(gl_context: GlContext) -> None:
    scene = unlit((cube(), at(0, 0, -2)))
    raster = GlRaster(gl_context, scene)
    first = raster.draw(view())
    raster.draw(view(Pinhole(20, 30, np.array([-0.3, -0.4]), np.array([0.4, 0.4])), (0.1, 0, 0)))
    again = raster.draw(view())
    np.testing.assert_array_equal(first.colour, again.colour)
    np.testing.assert_array_equal(first.inverse_depth, again.inverse_depth)
    on_gpu = raster.draw_on_gpu(view()).read()
    np.testing.assert_array_equal(first.colour, on_gpu.colour)
    np.testing.assert_array_equal(first.inverse_depth, on_gpu.inverse_depth)


def test_normals_under_a_non_uniform_scale_stay_perpendicular(gl_context: GlContext) -> None:
    pose = at(0, 0, -2, transforms.rotation_about("y", 0.6)) @ np.diag([3.0, 3.0, 0.2, 1.0])
    tilted = transforms.rotation_about("x", 0.8)
    mesh = quad((-2, -2), (2, 2))
    mesh = type(mesh)(
        "tilted", mesh.position @ tilted.T.astype("f4"), mesh.normal @ tilted.T.astype("f4"), mesh.triangles
    )
    scene = gl_scenes.lit((mesh, pose))
    image = GlRaster(gl_context, replace(scene, lights=scene.lights[1:])).draw(view())
    point = positions(image)
    normal = directions.normalised(np.cross(point[:-1, 1:] - point[:-1, :-1], point[1:, :-1] - point[:-1, :-1]))
    light = 0.1 + scene.lights[1].colour * np.abs(normal @ scene.lights[1].vector)[..., None]
    np.testing.assert_allclose(image.colour[:-1, :-1], srgb(np.asarray(light)), atol=1)


def test_pictures_of_two_names_do_not_overwrite_each_other(gl_context: GlContext) -> None:
    raster = GlRaster(gl_context, unlit((cube(0.6), at(0, 0, -2))))
    left, right = view(viewpoint=(-0.03, 0.0, 0.0)), view(viewpoint=(0.03, 0.0, 0.0))
    pictures = [raster.draw_on_gpu(left, "left"), raster.draw_on_gpu(right, "right")]
    for picture, eye in zip(pictures, (left, right), strict=True):
        np.testing.assert_array_equal(picture.read().colour, raster.draw(eye).colour)
