"""Every backend draws the same frame; what happens where one is missing."""

import numpy as np
import pytest
from gl_scenes import at, cube, lit, quad, view

from wlr_render.errors import BadInputError, MissingGlError
from wlr_render.geometry import transforms
from wlr_render.geometry.pinhole import Pinhole
from wlr_render.rendering import gl
from wlr_render.rendering.raster_backends import open_raster_backend
from wlr_render.rendering.ray_map import RayMap

CAMERA = Pinhole(200, 160, np.array([-0.55, -0.4]), np.array([0.45, 0.4]))
TEXTURE = np.random.default_rng(2).integers(0, 256, (16, 16, 3)).astype(np.uint8)


@pytest.fixture
def scene():
    turn = transforms.rotation_about("y", 0.6) @ transforms.rotation_about("x", 0.4)
    wall = quad((-3, -3), (3, 3), texture=TEXTURE)
    return lit((wall, at(0, 0, -3)), (cube(0.5), at(0.1, 0.0, -1.5, turn)))


@pytest.fixture
def field():
    """Rays beside the viewpoint by 15 mm, some of them missing."""
    tangents = 0.9 * Pinhole(90, 70, CAMERA.tangent_min, CAMERA.tangent_max).pixel_centre_tangents()
    slope_offset = np.stack([tangents[..., 0], tangents[..., 1], np.full((70, 90), 0.015), np.full((70, 90), -0.008)])
    slope_offset[:, 10:14, 30:50] = np.nan
    return RayMap(np.zeros(3), np.eye(3), slope_offset.astype(np.float32), np.zeros((70, 90), np.uint8))


@pytest.fixture
def no_gl(monkeypatch):
    def refuse(backend="auto"):
        raise MissingGlError(f"No OpenGL ({backend}).")

    monkeypatch.setattr(gl, "open_context", refuse)


@pytest.mark.gl
@pytest.mark.parametrize("backend", ["egl", "osmesa"])
def test_opengl_and_the_cpu_warp_the_same_frame(scene, field, backend):
    try:
        theirs = open_raster_backend(scene, backend)
    except MissingGlError as error:
        pytest.skip(str(error))
    assert theirs.backend == backend
    drawn, ours = (
        r.draw_warped(view(CAMERA), [field], with_geometry=True) for r in (theirs, open_raster_backend(scene, "cpu"))
    )
    difference = np.abs(drawn.image.colour.astype(int) - ours.image.colour).max(axis=-1)
    # The texture unit mixes texels with 8-bit weights; a silhouette may fall on either side of a pixel's centre.
    assert (difference > 3).mean() < 0.005
    assert difference.mean() < 0.5
    assert (drawn.image.status == ours.image.status).mean() > 0.995
    np.testing.assert_allclose(np.median(drawn.intermediate.inverse_depth / ours.intermediate.inverse_depth), 1, 1e-5)


@pytest.mark.gl
@pytest.mark.parametrize("backend", ["egl", "cpu"])
def test_asking_for_geometry_does_not_change_the_picture(scene, field, backend):
    try:
        raster_backend = open_raster_backend(scene, backend)
    except MissingGlError as error:
        pytest.skip(str(error))
    bare, full = (raster_backend.draw_warped(view(CAMERA), [field], with_geometry=flag) for flag in (False, True))
    np.testing.assert_array_equal(bare.image.colour, full.image.colour)
    assert bare.intermediate is None
    np.testing.assert_array_equal(full.intermediate.colour, raster_backend.draw(view(CAMERA)).colour)


def test_auto_draws_on_the_cpu_where_there_is_no_opengl(scene, field, no_gl):
    fallback = open_raster_backend(scene)
    assert fallback.backend == "cpu"
    chosen = open_raster_backend(scene, "cpu").draw_warped(view(CAMERA), [field])
    np.testing.assert_array_equal(fallback.draw_warped(view(CAMERA), [field]).image.colour, chosen.image.colour)


@pytest.mark.parametrize(("backend", "materials"), [("egl", "own"), ("osmesa", "own"), ("auto", "gltf")])
def test_opengl_that_was_asked_for_is_not_replaced(scene, no_gl, backend, materials):
    with pytest.raises(MissingGlError, match=backend):
        open_raster_backend(scene, backend, materials)


def test_gltf_materials_on_the_cpu_are_refused(scene):
    with pytest.raises(BadInputError, match="glTF materials need OpenGL: choose the backend egl or osmesa"):
        open_raster_backend(scene, "cpu", "gltf")


@pytest.mark.parametrize(("backend", "materials"), [("vulkan", "own"), ("cpu", "toon")])
def test_unknown_names_are_refused_with_the_known_ones(scene, backend, materials):
    with pytest.raises(BadInputError, match=r"choose from .*egl.*gltf"):
        open_raster_backend(scene, backend, materials)
