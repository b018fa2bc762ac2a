"""Modes of a host's context that our draws would disturb, or that would disturb them."""

import ctypes
import warnings
from collections.abc import Iterator
from typing import Any

import gl_scenes
import numpy as np
import pytest
from gl_caller import Caller, Number, assert_same, make_current, open_other

from wlr_render.draw.gl_raster import GlRaster
from wlr_render.errors import BadInputError
from wlr_render.gl import gl
from wlr_render.gl.host_checks import PendingGlErrorWarning
from wlr_render.gl.native_contexts import CurrentContext

pytestmark = pytest.mark.gl

SCENE = gl_scenes.lit((gl_scenes.cube(), gl_scenes.at(0, 0, -2)))
SAMPLES_PASSED, ANY_SAMPLES, CONSERVATIVE, PRIMITIVES, TIME = 0x8914, 0x8C2F, 0x8D6A, 0x8C87, 0x88BF
QUERY_RESULT, INVALID_ENUM, CONTEXT_LOST = 0x8866, 0x0500, 0x0507


@pytest.fixture
def adopted(caller: Caller) -> Iterator[Any]:
    with gl.adopt_context(caller.ctx) as adopted:
        yield adopted


@pytest.fixture
def raster(adopted: Any) -> GlRaster:
    return GlRaster(adopted, SCENE)


def name_of(caller: Caller, kind: str) -> int:
    name = (ctypes.c_uint * 1)()
    caller.gl(f"glGen{kind}", 1, ctypes.addressof(name), types=[ctypes.c_int, ctypes.c_void_p])
    return name[0]


def result_of(caller: Caller, query: int) -> int:
    number = (ctypes.c_uint * 1)()
    types: list[Number] = [ctypes.c_uint, ctypes.c_uint, ctypes.c_void_p]
    caller.gl("glGetQueryObjectuiv", query, QUERY_RESULT, ctypes.addressof(number), types=types)
    return number[0]


@pytest.mark.parametrize("target", [SAMPLES_PASSED, ANY_SAMPLES, CONSERVATIVE, PRIMITIVES], ids=hex)
def test_queries_that_would_count_our_draws_are_refused(caller: Caller, raster: GlRaster, target: int) -> None:
    good = raster.draw(gl_scenes.view())
    query = name_of(caller, "Queries")
    before = caller.state()
    caller.gl("glBeginQuery", target, query)
    with pytest.raises(BadInputError, match="query is active in the OpenGL context and would count our draws: end it"):
        raster.draw(gl_scenes.view())
    with pytest.raises(BadInputError, match="query is active"):
        gl.adopt_context(caller.ctx)
    caller.gl("glEndQuery", target)
    assert_same(caller.state(), before)
    assert result_of(caller, query) == 0
    np.testing.assert_array_equal(raster.draw(gl_scenes.view()).colour, good.colour)


def test_a_query_of_time_may_run(caller: Caller, raster: GlRaster) -> None:
    query = name_of(caller, "Queries")
    caller.gl("glBeginQuery", TIME, query)
    raster.draw(gl_scenes.view())
    caller.gl("glEndQuery", TIME)
    assert result_of(caller, query) > 0


def test_conditional_rendering_is_refused(caller: Caller, raster: GlRaster) -> None:
    good = raster.draw(gl_scenes.view())
    query = name_of(caller, "Queries")
    caller.gl("glBeginQuery", SAMPLES_PASSED, query)
    caller.gl("glEndQuery", SAMPLES_PASSED)
    caller.gl("glBeginConditionalRender", query, 0x8E13)  # GL_QUERY_WAIT
    before = caller.state()
    with pytest.raises(BadInputError, match=r"Conditional rendering is active .* glEndConditionalRender"):
        raster.draw(gl_scenes.view())
    assert_same(caller.state(), before)
    caller.gl("glEndConditionalRender")
    assert caller.ctx.error == "GL_NO_ERROR"  # it was still active
    np.testing.assert_array_equal(raster.draw(gl_scenes.view()).colour, good.colour)


def test_transform_feedback_is_paused_and_goes_on(caller: Caller, raster: GlRaster) -> None:
    good = raster.draw(gl_scenes.view())
    program = caller.ctx.program(
        vertex_shader="#version 410\nin vec2 at; out vec2 kept; void main() { kept = at; gl_Position = vec4(0); }",
        varyings=("kept",),
    )
    points = caller.ctx.vertex_array(program, [(caller.ctx.buffer(np.array([1, 2, 3, 4], np.float32)), "2f4", "at")])
    buffer = caller.ctx.buffer(reserve=64)
    caller.framebuffer.use()
    caller.gl("glUseProgram", program.glo)
    caller.gl("glBindVertexArray", points.glo)
    caller.gl("glBindBufferBase", 0x8C8E, 0, buffer.glo)
    caller.gl("glBeginTransformFeedback", 0)  # GL_POINTS
    caller.gl("glDrawArrays", 0, 0, 1)
    picture = raster.draw(gl_scenes.view())
    caller.gl("glDrawArrays", 0, 1, 1)
    caller.gl("glEndTransformFeedback")
    assert caller.ctx.error == "GL_NO_ERROR"
    np.testing.assert_array_equal(np.frombuffer(buffer.read(), np.float32)[:5], [1, 2, 3, 4, 0])
    np.testing.assert_array_equal(picture.colour, good.colour)


def test_a_pending_error_is_reported_once(caller: Caller, raster: GlRaster) -> None:
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        raster.draw(gl_scenes.view())
    caller.gl("glEnable", 0x1234)
    with pytest.warns(PendingGlErrorWarning, match="OpenGL held GL_INVALID_ENUM before the call"):
        raster.draw(gl_scenes.view())
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        raster.draw(gl_scenes.view())
    caller.gl("glEnable", 0x1234)
    with pytest.warns(PendingGlErrorWarning):
        gl.adopt_context(caller.ctx).release()


def test_a_new_context_at_the_address_of_the_old_one_is_refused(caller: Caller, adopted: Any, raster: GlRaster) -> None:
    other = open_other(410)
    current = vars(adopted)["_current"]
    address = current._native
    try:
        current._native = CurrentContext()._native  # as if the old context were gone
        with pytest.raises(BadInputError, match="a new context lies at the address of the old one"):
            raster.draw(gl_scenes.view())
        samplers = [other.sampler() for _ in range(20)]  # one of them has the number of ours
        with pytest.raises(BadInputError, match="a new context lies at the address of the old one"):
            raster.draw(gl_scenes.view())
        assert len(samplers) == 20
        texture = other.texture((4, 4), 4)
        adopted.release()  # deletes nothing of the new context
        assert other.error == "GL_NO_ERROR"
        assert len(texture.read()) == 64
    finally:
        current._native = address
        other.release()
        make_current(caller.ctx)
