from collections.abc import Callable
from typing import NoReturn

import numpy as np
import pytest
from gl_caller import Caller

from wlr_render.errors import MissingGlError
from wlr_render.gl import gl
from wlr_render.gl.context import GlContext

LOST_LIBRARIES = {"GLCONTEXT_LINUX_LIBEGL": "libNowhereEGL.so", "GLCONTEXT_LINUX_LIBGL": "libNowhereGL.so"}


@pytest.mark.parametrize("backend", ["auto", "egl"])
def test_missing_gl_is_one_sentence_with_the_remedy(backend: str, monkeypatch: pytest.MonkeyPatch) -> None:
    for name, value in LOST_LIBRARIES.items():
        monkeypatch.setenv(name, value)
    monkeypatch.setattr("ctypes.util.find_library", lambda name: None)
    monkeypatch.setattr("ctypes.CDLL", lambda name: (_ for _ in ()).throw(OSError(f"{name}: not found")))
    with pytest.raises(MissingGlError, match=r"install libegl1 and libgl1, or libosmesa6, or draw ray-traced"):
        gl.open_context(backend)


@pytest.mark.gl
def test_a_failed_call_raises_at_the_end_of_the_block(gl_context: GlContext) -> None:
    with pytest.raises(gl.GlError, match="GL_INVALID"), gl_context.drawing() as ctx:
        ctx.texture((4, 4), 4, internal_format=0x1234)
    with gl_context.drawing() as ctx:
        assert ctx.error == "GL_NO_ERROR"


@pytest.mark.gl
def test_every_block_makes_its_own_context_current(gl_context: GlContext) -> None:
    with gl_context.drawing():
        mine = gl_context.target((4, 3), 4, "f1")
        gl_context.framebuffer([mine]).clear(1.0, 0.0, 0.0, 1.0)
    with gl.open_context("egl" if gl_context.backend == "egl" else "osmesa") as other, other.drawing():
        theirs = other.target((4, 3), 4, "f1")
        other.framebuffer([theirs]).clear(0.0, 1.0, 0.0, 1.0)
        with gl_context.drawing():
            assert (gl.read(mine, np.uint8) == [255, 0, 0, 255]).all()


@pytest.mark.gl
def test_a_context_destroyed_while_current_does_not_leave_ours_current(caller: Caller, gl_context: GlContext) -> None:
    """EGL keeps a destroyed context current until another one is, and cannot make it current again."""
    caller.ctx.release()
    with gl_context.drawing():
        pass
    with pytest.raises(MissingGlError, match="No OpenGL context is current"):
        gl.adopt_context()


@pytest.mark.parametrize(("told", "first"), [("osmesa", "osmesa"), ("egl", "egl"), (None, "egl")])
def test_auto_first_opens_the_platform_that_pyopengl_uses(
    monkeypatch: pytest.MonkeyPatch, told: str | None, first: str
) -> None:
    tried = []

    def refusing(name: str) -> Callable[[], NoReturn]:
        def refuse() -> NoReturn:
            tried.append(name)
            raise OSError("not here")

        return refuse

    monkeypatch.setattr(gl, "_OPENERS", {name: refusing(name) for name in ("egl", "osmesa")})
    if told is None:
        monkeypatch.delenv("PYOPENGL_PLATFORM", raising=False)
    else:
        monkeypatch.setenv("PYOPENGL_PLATFORM", told)
    with pytest.raises(MissingGlError):
        gl.open_context()
    assert sorted(tried) == ["egl", "osmesa"]
    assert tried[0] == first
