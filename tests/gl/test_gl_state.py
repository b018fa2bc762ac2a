"""A context of somebody else's program: drawn in, and given back as it was."""

import shutil
import subprocess
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import gl_scenes
import moderngl
import numpy as np
import pytest
from fitted_eyes import fitted_eye
from gl_caller import Caller, assert_same, run
from present import present
from warping import field_of_pixels

from wlr_render.draw.gl_raster import GlRaster
from wlr_render.gl import gl
from wlr_render.gl.context import GlContext
from wlr_render.warp.gl_ray_maps import GlPlanarSolver
from wlr_render.warp.gl_warp import GlWarp
from wlr_render.warp.grid import WarpGrid

pytestmark = pytest.mark.gl

SCENE = gl_scenes.lit((gl_scenes.cube(), gl_scenes.at(0, 0, -2)))


@pytest.fixture
def adopted(caller: Caller) -> Iterator[Any]:
    with gl.adopt_context(caller.ctx) as adopted:
        yield adopted


@pytest.mark.parametrize("is_odd", [True, False])
def test_all_state_is_found_again_after_each_kind_of_block(caller: Caller, is_odd: bool) -> None:
    """From odd values, and from OpenGL's own, which need not be restored unless our drawing changes them."""
    if is_odd:
        caller.set_odd_values()
    before = caller.state()
    context = gl.adopt_context(caller.ctx)
    assert_same(caller.state(), before)
    raster = GlRaster(context, SCENE)
    assert_same(caller.state(), before)
    picture = raster.draw_on_gpu(gl_scenes.view())
    assert_same(caller.state(), before)
    picture.read()
    assert_same(caller.state(), before)
    rays = field_of_pixels(context, np.zeros((4, 6, 7), np.float32))
    assert_same(caller.state(), before)
    GlWarp(context).draw(picture, [rays], np.eye(4), (7, 6))
    assert_same(caller.state(), before)
    eye = fitted_eye("northstar", 3)
    field = GlPlanarSolver(context, eye, WarpGrid.of_pixels(eye.display.panel, (8, 9)), np.eye(3)).solve(
        eye.eye_box.centre
    )
    assert_same(caller.state(), before)
    field.read()
    assert_same(caller.state(), before)
    with context.drawing(third_party=True) as ctx, context.drawing():
        ctx.enable(moderngl.BLEND)
        largest: Any = moderngl.MAX  # ModernGL's stubs know pairs of equations only
        ctx.blend_func, ctx.blend_equation = (moderngl.ONE, moderngl.ONE), largest
        ctx.front_face, ctx.cull_face, ctx.point_size, ctx.depth_func = "ccw", "back", 2.0, "<"
    assert_same(caller.state(), before)
    context.release()
    assert_same(caller.state(), before)


def test_a_failed_block_leaves_the_state_and_the_next_is_right(caller: Caller, adopted: Any) -> None:
    raster = GlRaster(adopted, SCENE)
    good = raster.draw(gl_scenes.view())
    caller.set_odd_values()
    before = caller.state()
    with pytest.raises(gl.GlError, match="GL_INVALID"), adopted.drawing() as ctx:
        ctx.texture((4, 4), 4, internal_format=0x1234)
    assert_same(caller.state(), before)
    with pytest.raises(TypeError), adopted.drawing(), adopted.drawing() as ctx:
        ctx.enable("blending")
    assert_same(caller.state(), before)
    np.testing.assert_array_equal(raster.draw(gl_scenes.view()).colour, good.colour)


def test_a_program_that_the_caller_deleted_while_it_was_in_use_leaves_no_error(caller: Caller, adopted: Any) -> None:
    program = caller.ctx.program(
        "#version 410\nvoid main() { gl_Position = vec4(0); }",
        "#version 410\nout vec4 c; void main() { c = vec4(1); }",
    )
    caller.ctx.simple_framebuffer((4, 4)).use()
    points = caller.ctx.vertex_array(program, [])
    points.render(vertices=1)
    points.release()
    program.release()
    GlRaster(adopted, SCENE).draw_on_gpu(gl_scenes.view())
    assert caller.ctx.error == "GL_NO_ERROR"


@pytest.mark.slow
def test_a_context_of_version_4_1_is_adopted(caller: Caller) -> None:
    script = """
        import moderngl, gl_scenes, numpy as np
        from fitted_eyes import fitted_eye
        from wlr_render.warp.compositor import Compositor
        from wlr_render.draw.gl_raster import GlRaster
        from wlr_render.warp.stored_picture import DepthKind, StoredDepth
        ctx = moderngl.create_context(standalone=True, require=410, backend="egl")
        assert ctx.version_code == 410, ctx.version_code
        eye = fitted_eye("birdbath28", 3)
        with Compositor(eye, (72, 60), context=ctx) as compositor:
            (camera,) = compositor.begin_frame(np.eye(4), eye.eye_box.centre).values()
            frame = ctx.simple_framebuffer(camera.size_px)
            frame.clear(0.2, 0.4, 0.6, depth=0.5)
            compositor.submit(frame, stored=StoredDepth(DepthKind.WINDOW, 0.5, 4.0))
            assert (compositor.compose().read().max(axis=(0, 1)) == [51, 102, 153]).all()
            scene = gl_scenes.lit((gl_scenes.cube(), gl_scenes.at(0, 0, -2)))
            picture = GlRaster(compositor.context, scene).draw(gl_scenes.view())
            assert (picture.inverse_depth > 0).sum() > 100
        assert ctx.error == "GL_NO_ERROR"
        print("composed")
    """
    environment = {"MESA_GL_VERSION_OVERRIDE": "4.1", "MESA_GLSL_VERSION_OVERRIDE": "410"}
    assert run(script, **environment) == "composed\n"


@pytest.fixture
def display(tmp_path: Path) -> Iterator[Any]:
    """Number of an X display without a screen."""
    if shutil.which("Xvfb") is None:
        pytest.skip("Xvfb is not installed.")
    server = subprocess.Popen(["Xvfb", "-displayfd", "1"], stdout=subprocess.PIPE, stderr=subprocess.DEVNULL)
    yield present(server.stdout).readline().decode().strip()
    server.terminate()
    server.communicate(timeout=20)


def test_a_context_of_an_x_window_system_is_adopted_and_no_other_opens_beside_it(
    gl_context: GlContext, display: Any
) -> None:
    script = """
        import gl_scenes, moderngl
        from wlr_render.errors import BadInputError, MissingGlError
        from wlr_render.gl import gl
        from wlr_render.draw.gl_raster import GlRaster
        before = gl.open_context("egl")
        theirs = moderngl.create_context(standalone=True, require=410)
        scene = gl_scenes.lit((gl_scenes.cube(), gl_scenes.at(0, 0, -2)))
        for draw in (lambda: before.drawing().__enter__(), lambda: gl.open_context("egl")):
            try:
                draw()
            except (BadInputError, MissingGlError) as error:
                print(error)
        with gl.adopt_context() as context:
            picture = GlRaster(context, scene).draw(gl_scenes.view())
            print(context.backend, (picture.inverse_depth > 0).sum() > 100)
        theirs.release()
        print((GlRaster(before, scene).draw(gl_scenes.view()).colour == picture.colour).all())
    """
    first, second, *drawn = run(script, DISPLAY=f":{display}").splitlines()
    assert "release the context that is current there, or adopt it" in first
    assert "egl: another platform's context is current on this thread; release it, or adopt it" in second
    assert drawn == ["glx True", "True"]
