"""Which OpenGL a scene is drawn with, and what happens where there is none."""

from typing import NoReturn

import numpy as np
import pytest
from cpu_raster import raster_on_cpu
from gl_scenes import OFF_CENTRE, at, cube, lit, quad, view
from hardware import FILTER_WEIGHT, allowed, codes_of

from wlr_render.draw.scene_raster import SceneRaster, open_scene_raster
from wlr_render.errors import BadInputError, MissingGlError
from wlr_render.geometry import transforms
from wlr_render.gl import gl
from wlr_render.gl.context import GlContext
from wlr_render.numerics.srgb import decode_srgb
from wlr_render.scene.scene import Scene

TEXTURE = np.random.default_rng(2).integers(0, 256, (16, 16, 3)).astype(np.uint8)


@pytest.fixture
def scene() -> Scene:
    turn = transforms.rotation_about("y", 0.6) @ transforms.rotation_about("x", 0.4)
    wall = quad((-3, -3), (3, 3), texture=TEXTURE)
    return lit((wall, at(0, 0, -3)), (cube(0.5), at(0.1, 0.0, -1.5, turn)))


@pytest.fixture
def no_gl(monkeypatch: pytest.MonkeyPatch) -> None:
    def refuse(backend: str = "auto") -> NoReturn:
        raise MissingGlError(f"No OpenGL ({backend}).")

    monkeypatch.setattr(gl, "open_context", refuse)


@pytest.mark.gl
@pytest.mark.parametrize("backend", ["egl", "osmesa"])
def test_each_platform_draws_what_rays_meet(scene: Scene, backend: str) -> None:
    try:
        raster = open_scene_raster(scene, backend)
    except MissingGlError as error:
        pytest.skip(str(error))
    assert raster is not None
    assert raster.backend == backend
    with raster.context:
        drawn, traced = raster.draw(view(OFF_CENTRE)), raster_on_cpu(scene, view(OFF_CENTRE))
        # Texels of all colours are mixed along two axes.
        mixed = codes_of(decode_srgb(traced.colour).astype(float), 2 * FILTER_WEIGHT)
        most = allowed(raster.context, 3.0, mixed)
    difference = np.abs(drawn.colour.astype(int) - traced.colour)
    # A silhouette may fall on either side of a pixel's centre.
    assert (difference > most).any(axis=-1).mean() < 0.005
    np.testing.assert_allclose(np.median(drawn.inverse_depth / traced.inverse_depth), 1, 1e-5)


@pytest.mark.gl
def test_both_materials_take_the_name_of_a_picture(scene: Scene, gl_context: GlContext) -> None:
    for materials in ("own", "gltf"):
        raster = SceneRaster(gl_context, scene, materials)
        first, second = (raster.draw_on_gpu(view(OFF_CENTRE), name) for name in ("left", "right"))
        assert first.colour is not second.colour
        np.testing.assert_array_equal(first.read().colour, second.read().colour)


def test_there_is_no_raster_on_the_cpu_or_where_no_opengl_opens(scene: Scene, no_gl: None) -> None:
    assert open_scene_raster(scene, "cpu") is None
    assert open_scene_raster(scene) is None


@pytest.mark.parametrize(("backend", "materials"), [("egl", "own"), ("osmesa", "own"), ("auto", "gltf")])
def test_opengl_that_was_asked_for_is_not_replaced(scene: Scene, no_gl: None, backend: str, materials: str) -> None:
    with pytest.raises(MissingGlError, match=backend):
        open_scene_raster(scene, backend, materials)


def test_gltf_materials_on_the_cpu_are_refused(scene: Scene) -> None:
    with pytest.raises(BadInputError, match="glTF materials need OpenGL: choose the backend egl or osmesa"):
        open_scene_raster(scene, "cpu", "gltf")


@pytest.mark.parametrize(("backend", "materials"), [("vulkan", "own"), ("cpu", "toon")])
def test_unknown_names_are_refused_with_the_known_ones(scene: Scene, backend: str, materials: str) -> None:
    with pytest.raises(BadInputError, match=r"choose from .*egl.*gltf"):
        open_scene_raster(scene, backend, materials)
