import sys
from types import SimpleNamespace
from typing import Any

import gl_scenes
import numpy as np
import pytest
from gl_scenes import at, cube, lit, quad, unlit, view

from wlr_render.draw.gl_raster import GlRaster
from wlr_render.draw.pyrender_drawing import PyrenderDrawing, PyrenderView
from wlr_render.errors import BadInputError
from wlr_render.geometry import transforms
from wlr_render.geometry.pinhole import Pinhole
from wlr_render.gl.context import GlContext
from wlr_render.numerics.srgb import decode_srgb
from wlr_render.scene.scene import Scene

pytestmark = pytest.mark.gl

HEAD = transforms.rigid(transforms.rotation_about("y", 0.3), np.array([40.0, 1.6, -30.0]))
FRAME = view(gl_scenes.OFF_CENTRE, (0.02, -0.01, 0.01), HEAD)


@pytest.fixture
def scene() -> Scene:
    turn = transforms.rotation_about("y", 0.5) @ transforms.rotation_about("x", 0.3)
    box = cube(0.5)
    return lit((box, HEAD @ at(-0.3, 0, -1.5, turn)), (box, HEAD @ at(0.1, 0.1, -2.5)))


def test_geometry_agrees_with_our_own_pass(gl_context: GlContext, scene: Scene) -> None:
    own = GlRaster(gl_context, scene).draw(FRAME)
    other = PyrenderView(gl_context, scene).draw(FRAME)
    both = (own.inverse_depth > 0) & (other.inverse_depth > 0)
    assert both.sum() > 500
    np.testing.assert_allclose(other.inverse_depth[both], own.inverse_depth[both], rtol=1e-4)
    assert ((own.inverse_depth > 0) != (other.inverse_depth > 0)).sum() <= 2
    assert ((other.inverse_depth == 0) == (other.colour == 0).all(-1)).all()


def test_drawing_with_one_leaves_the_other_unchanged(gl_context: GlContext, scene: Scene) -> None:
    own, other = GlRaster(gl_context, scene), PyrenderView(gl_context, scene)
    alone, small = own.draw(FRAME), view(Pinhole(30, 20, np.array([-0.4, -0.3]), np.array([0.4, 0.3])))
    first = other.draw(FRAME)
    between = own.draw(FRAME)
    other.draw(small)
    second = other.draw(FRAME)
    np.testing.assert_array_equal(alone.colour, between.colour)
    np.testing.assert_array_equal(alone.inverse_depth, between.inverse_depth)
    np.testing.assert_array_equal(first.colour, second.colour)
    np.testing.assert_array_equal(first.inverse_depth, second.inverse_depth)


def test_dropping_a_view_deletes_nothing_of_another(gl_context: GlContext, scene: Scene) -> None:
    own = GlRaster(gl_context, scene)
    before = own.draw(FRAME)
    for _ in range(2):
        PyrenderView(gl_context, scene).draw(FRAME)
    np.testing.assert_array_equal(own.draw(FRAME).colour, before.colour)


def test_textures_are_upright_and_lit_as_ours_where_gloss_is_absent(gl_context: GlContext) -> None:
    texture = np.zeros((2, 2, 3), np.uint8)
    texture[0, 0], texture[0, 1], texture[1, 0] = [255, 0, 0], [0, 255, 0], [0, 0, 255]
    camera = Pinhole(2, 2, np.array([-0.5, -0.5]), np.array([0.5, 0.5]))
    scene = unlit((quad((-0.5, -0.5), (0.5, 0.5), texture=texture), at(0, 0, -1)))
    np.testing.assert_array_equal(PyrenderView(gl_context, scene).draw(view(camera)).colour, texture)


def test_minified_textures_of_odd_sides_show_their_mean_light_at_their_place(gl_context: GlContext) -> None:
    texture = np.zeros((9, 31, 3), np.uint8)
    texture[-1], texture[:, -1] = 255, 255  # what a driver's own levels may leave out
    camera = Pinhole(1, 1, np.array([-0.5, -0.5]), np.array([0.5, 0.5]))
    scene = unlit((quad((-0.5, -0.5), (0.5, 0.5), texture=texture), at(0, 0, -1)))
    drawn = PyrenderView(gl_context, scene).draw(view(camera)).colour
    mean = decode_srgb(texture).mean(axis=(0, 1))
    np.testing.assert_allclose(decode_srgb(drawn)[0, 0], mean, atol=0.02)


def test_light_comes_from_the_same_side_with_about_the_same_strength(gl_context: GlContext) -> None:
    grey = quad((-9, -9), (9, 9), base_colour=np.full(3, 0.5, np.float32))
    scene = lit((grey, at(0, 0, -2)))
    own, other = (kind(gl_context, scene).draw(view()).colour.astype(float) for kind in (GlRaster, PyrenderView))
    # The glTF material keeps 4 % for a gloss that a rough surface spreads, and its gamma is not quite sRGB's.
    assert np.abs(own - other).max() < 12
    assert np.corrcoef(own.sum(-1).ravel(), other.sum(-1).ravel())[0, 1] > 0.98


def test_a_platform_that_pyopengl_has_already_chosen_is_refused_in_a_sentence(
    gl_context: GlContext, scene: Scene, monkeypatch: pytest.MonkeyPatch
) -> None:
    class GLXPlatform:
        """PyOpenGL's own name for the platform that it takes where an earlier import, of pyopenxr, told it nothing."""

    monkeypatch.setitem(sys.modules, "OpenGL.platform", SimpleNamespace(PLATFORM=GLXPlatform()))
    with pytest.raises(BadInputError, match=f"set the environment variable PYOPENGL_PLATFORM={gl_context.backend}"):
        PyrenderView(gl_context, scene)


@pytest.fixture
def graph(gl_context: GlContext) -> Any:
    """A caller's pyrender scene, with a camera of another kind under a node."""
    PyrenderView(gl_context, unlit())  # pyrender is imported in its own way
    import pyrender

    graph = pyrender.Scene(bg_color=[0.0, 0.0, 0.0, 1.0], ambient_light=[0.5] * 3)
    box = cube(0.5)
    mesh = pyrender.Mesh([pyrender.Primitive(box.position, normals=box.normal, indices=box.triangles)])
    graph.add(mesh, pose=at(0.1, 0.1, -2.5, transforms.rotation_about("y", 0.5)))
    stand = pyrender.Node(matrix=at(1, 2, 3, transforms.rotation_about("x", 0.4)))
    graph.add_node(stand)
    graph.add(pyrender.PerspectiveCamera(1.0, znear=0.1), parent_node=stand, name="eye")
    return graph


def camera_node(graph: Any) -> Any:
    return next(node for node in graph.camera_nodes if node.name == "eye")


STEP = view(gl_scenes.OFF_CENTRE, (0.02, -0.01, 0.01), at(0.1, 0.05, 0.2, transforms.rotation_about("y", 0.1)))


def test_a_callers_scene_is_seen_from_the_view(gl_context: GlContext, graph: Any) -> None:
    placed = at(0.1, 0.1, -2.5, transforms.rotation_about("y", 0.5))
    own = GlRaster(gl_context, lit((cube(0.5), placed))).draw(STEP)
    other = PyrenderDrawing(gl_context, graph, camera_node(graph)).draw_on_gpu(STEP).read()
    both = (own.inverse_depth > 0) & (other.inverse_depth > 0)
    assert both.sum() > 100
    np.testing.assert_allclose(other.inverse_depth[both], own.inverse_depth[both], rtol=1e-4)
    assert ((own.inverse_depth > 0) != (other.inverse_depth > 0)).sum() <= 2


def test_a_callers_scene_gets_its_camera_back(gl_context: GlContext, graph: Any) -> None:
    node = camera_node(graph)
    camera, pose, in_world, main = node.camera, node.matrix.copy(), graph.get_pose(node).copy(), graph.main_camera_node
    drawing = PyrenderDrawing(gl_context, graph, node)
    drawing.draw_on_gpu(STEP)
    assert node.camera is camera
    assert graph.main_camera_node is main
    np.testing.assert_array_equal(node.matrix, pose)
    np.testing.assert_array_equal(graph.get_pose(node), in_world)


def test_a_picture_stays_until_the_next_one_of_its_name(gl_context: GlContext, graph: Any) -> None:
    drawing = PyrenderDrawing(gl_context, graph, camera_node(graph))
    left = drawing.draw_on_gpu(STEP, "left")
    before = left.read()
    right = drawing.draw_on_gpu(FRAME, "right").read()
    np.testing.assert_array_equal(left.read().colour, before.colour)
    assert (right.colour != before.colour).any()


def test_a_node_that_is_no_camera_of_the_scene_is_refused(gl_context: GlContext, graph: Any) -> None:
    with pytest.raises(BadInputError, match="not a camera of the pyrender scene"):
        PyrenderDrawing(gl_context, graph, next(iter(graph.mesh_nodes)))
