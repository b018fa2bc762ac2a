"""A context that shares another program's textures and changes nothing of its state."""

import ctypes
import shutil
import subprocess
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import gl_scenes
import moderngl
import numpy as np
import pytest
from gl_caller import Caller, Number, assert_same, make_current, open_other, run
from present import present

from wlr_render.draw.gl_raster import GlRaster
from wlr_render.errors import MissingGlError
from wlr_render.gl import gl
from wlr_render.gl.context import GlContext

pytestmark = pytest.mark.gl

SAMPLES_PASSED, PRIMITIVES, QUERY_RESULT = 0x8914, 0x8C87, 0x8866
SCENE = gl_scenes.lit((gl_scenes.cube(), gl_scenes.at(0, 0, -2)))


def name_of(caller: Caller, kind: str) -> int:
    name = (ctypes.c_uint * 1)()
    caller.gl(f"glGen{kind}", 1, ctypes.addressof(name), types=[ctypes.c_int, ctypes.c_void_p])
    return name[0]


def result_of(caller: Caller, query: int) -> int:
    number = (ctypes.c_uint * 1)()
    types: list[Number] = [ctypes.c_uint, ctypes.c_uint, ctypes.c_void_p]
    caller.gl("glGetQueryObjectuiv", query, QUERY_RESULT, ctypes.addressof(number), types=types)
    return number[0]


@pytest.fixture
def adopted(caller: Caller) -> Iterator[Any]:
    with gl.adopt_context(caller.ctx) as adopted:
        yield adopted


def test_all_state_is_found_again_after_each_kind_of_block(caller: Caller) -> None:
    caller.set_odd_values()
    before = caller.state()
    context = gl.adopt_context(caller.ctx)
    assert_same(caller.state(), before)
    picture = GlRaster(context, SCENE).draw_on_gpu(gl_scenes.view())
    assert_same(caller.state(), before)
    picture.read()
    assert_same(caller.state(), before)
    with context.drawing(third_party=True) as ctx, context.drawing():
        ctx.enable(moderngl.BLEND)
        ctx.front_face, ctx.cull_face, ctx.point_size, ctx.depth_func = "ccw", "back", 2.0, "<"
    assert_same(caller.state(), before)
    with context.drawing(), context.host():  # as for a framebuffer's number, or the window
        caller.gl("glBindFramebuffer", 0x8D40, 0)
        assert not caller.gl("glIsEnabled", 0x0C11)  # GL_SCISSOR_TEST
        assert not caller.gl("glIsEnabled", 0x8DB9)  # GL_FRAMEBUFFER_SRGB
        with context.drawing() as ctx:
            assert ctx.error == "GL_NO_ERROR"
            assert not caller.gl("glIsEnabled", 0x0BE2)  # ours: blending is on in the host
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


@pytest.mark.parametrize("target", [SAMPLES_PASSED, PRIMITIVES], ids=hex)
def test_what_runs_in_the_host_neither_counts_nor_drops_our_draws(caller: Caller, adopted: Any, target: int) -> None:
    raster = GlRaster(adopted, SCENE)
    good = raster.draw(gl_scenes.view())
    query, empty = name_of(caller, "Queries"), name_of(caller, "Queries")
    caller.gl("glBeginQuery", SAMPLES_PASSED, empty)
    caller.gl("glEndQuery", SAMPLES_PASSED)
    caller.gl("glBeginQuery", target, query)
    caller.gl("glBeginConditionalRender", empty, 0x8E13)  # GL_QUERY_WAIT: nothing is drawn in the host
    caller.gl("glEnable", 0x1234)
    np.testing.assert_array_equal(raster.draw(gl_scenes.view()).colour, good.colour)
    assert caller.ctx.error == "GL_INVALID_ENUM"  # the host's own error is left to it
    caller.gl("glEndConditionalRender")
    caller.gl("glEndQuery", target)
    assert caller.ctx.error == "GL_NO_ERROR"
    assert result_of(caller, query) == 0


def test_the_context_outlives_its_host(caller: Caller, adopted: Any) -> None:
    raster = GlRaster(adopted, SCENE)
    good = raster.draw(gl_scenes.view())
    caller.ctx.release()
    np.testing.assert_array_equal(raster.draw(gl_scenes.view()).colour, good.colour)


def test_another_context_at_the_address_of_the_host_is_an_error(caller: Caller, adopted: Any) -> None:
    other = open_other(410)
    host = vars(vars(adopted)["_owner"])["_host"]
    host.is_current = lambda: True  # as if the host's context were gone
    try:
        with pytest.raises(gl.GlError, match="GL_INVALID_VALUE"), adopted.drawing():
            pass
    finally:
        other.release()
        make_current(caller.ctx)


def test_a_driver_that_does_not_share_is_told_in_a_sentence(caller: Caller, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(gl, "BINDINGS", {})
    before = caller.state()
    with pytest.raises(MissingGlError, match=r"no sharing with EGL\): promise OpenGL's default state with host_state="):
        gl.adopt_context(caller.ctx)
    assert_same(caller.state(), before)


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


def test_a_refusal_of_glx_is_told_in_a_sentence(display: Any) -> None:
    """The error of X would end the program."""
    script = """
        import moderngl
        from wlr_render.errors import MissingGlError
        from wlr_render.gl import gl
        theirs = moderngl.create_context(standalone=True, require=330)
        try:
            gl.adopt_context()
        except MissingGlError as error:
            print(error)
        print(theirs.error)
    """
    told, after = run(script, DISPLAY=f":{display}", MESA_GL_VERSION_OVERRIDE="3.3").splitlines()
    assert "yours of version 3.3 (GLX refuses an OpenGL 4.1 context that shares" in told
    assert after == "GL_NO_ERROR"


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
