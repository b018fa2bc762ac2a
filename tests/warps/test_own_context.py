"""A compositor in a context of its own: the caller's context stays current, and any one thread at a time may call."""

import ctypes
import threading
from collections.abc import Callable, Iterator
from typing import Any

import moderngl
import numpy as np
import pytest
from gl_caller import make_current, open_other
from numpy.typing import NDArray
from warps.composing import HEAD, SMALL, Make, scene, viewpoint

from benchmarks.scene_source import SceneSource
from wlr_render.errors import BadInputError
from wlr_render.gl import ownership
from wlr_render.gl.context import GlContext
from wlr_render.mappings import Eye
from wlr_render.warp.compositor import Compositor

pytestmark = pytest.mark.gl


class Engine:
    """Another program's EGL context with a texture to clear, called without making the context current."""

    def __init__(self) -> None:
        self.ctx = open_other()
        self.texture = self.ctx.texture((8, 8), 4, bytes(256))
        self.framebuffer = self.ctx.framebuffer([self.texture])

    def cleared(self, value: int) -> list[int]:
        self.framebuffer.clear(value / 255, 0.0, 0.0, 1.0)
        texel: list[int] = np.frombuffer(self.texture.read(), np.uint8)[:4].tolist()
        return texel


def current_egl_context() -> int | None:
    egl = ctypes.CDLL("libEGL.so.1")
    egl.eglGetCurrentContext.restype = ctypes.c_void_p
    current: int | None = egl.eglGetCurrentContext()
    return current


@pytest.fixture
def engine(gl_context: GlContext) -> Iterator[Engine]:
    if gl_context.backend != "egl":
        pytest.skip("EGL does not open here, so that there is no other context to keep.")
    made = Engine()
    yield made
    make_current(made.ctx)
    made.ctx.release()


@pytest.fixture
def made(gl_context: GlContext, compositor: Make, flat_image_headset: Eye) -> Compositor:
    """A compositor in a context of its own."""
    own: Compositor = compositor(flat_image_headset, context=gl_context.backend)
    return own


def grey_frame(compositor: Compositor, mappings: Eye) -> NDArray[np.uint8]:
    """One frame of a grey picture at 1 m; (height, width, 3)."""
    (camera,) = compositor.begin_frame(HEAD, viewpoint(mappings)).values()
    width, height = camera.size_px
    compositor.submit(np.full((height, width, 3), 128, np.uint8), np.ones((height, width), np.float32))
    return compositor.compose().read()


def test_the_callers_context_stays_current(engine: Engine, flat_image_headset: Eye) -> None:
    current = current_egl_context()
    with Compositor(flat_image_headset, SMALL, context="auto") as made:
        assert current_egl_context() == current
        assert engine.cleared(51) == [51, 0, 0, 255]
        first = grey_frame(made, flat_image_headset)
        assert (first == 128).all()
        assert current_egl_context() == current
        assert engine.cleared(102) == [102, 0, 0, 255]
        np.testing.assert_array_equal(grey_frame(made, flat_image_headset), first)
        with pytest.raises(BadInputError):
            made.submit(first)
        assert current_egl_context() == current
        assert moderngl.get_context() is engine.ctx
    assert current_egl_context() == current
    assert engine.cleared(153) == [153, 0, 0, 255]


def test_no_context_stays_current_where_none_was(engine: Engine, flat_image_headset: Eye) -> None:
    with engine.ctx:
        pass
    assert current_egl_context() is None
    with Compositor(flat_image_headset, SMALL, context="egl") as made:
        grey_frame(made, flat_image_headset)
        assert current_egl_context() is None
    assert current_egl_context() is None


def in_thread(work: Callable[..., Any]) -> BadInputError | NDArray[np.uint8]:
    """What a call on another thread returns or raises."""
    told: list[BadInputError | NDArray[np.uint8]] = []

    def run() -> None:
        try:
            told.append(work())
        except BadInputError as error:
            told.append(error)

    thread = threading.Thread(target=run)
    thread.start()
    thread.join()
    return told[0]


def test_another_thread_composes_the_same_picture(made: Compositor, flat_image_headset: Eye) -> None:
    source, seen = SceneSource(made, scene()), viewpoint(flat_image_headset)

    def frame() -> NDArray[np.uint8]:
        for camera in made.begin_frame(HEAD, seen).values():
            source.submit(camera)
        return np.asarray(made.compose().read())

    expected = frame()
    assert len(np.unique(expected)) > 10
    np.testing.assert_array_equal(in_thread(frame), expected)
    np.testing.assert_array_equal(frame(), expected)


def test_a_thread_that_does_not_end_its_block_is_told_in_a_sentence(
    made: Compositor, flat_image_headset: Eye, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(ownership, "_WAIT_S", 0.05)
    with made.context.drawing():
        error = in_thread(lambda: grey_frame(made, flat_image_headset))
    assert isinstance(error, BadInputError)
    assert "Another thread has drawn in this OpenGL context for 0.05 s: end its call" in str(error)
    assert (grey_frame(made, flat_image_headset) == 128).all()


def test_a_thread_reads_its_own_frames_or_is_told(made: Compositor, flat_image_headset: Eye) -> None:
    """While another thread composes for another pose."""
    source, seen = SceneSource(made, scene()), viewpoint(flat_image_headset)
    for camera in made.begin_frame(HEAD, seen).values():
        source.submit(camera)
    aside = HEAD.copy()
    aside[:3, 3] += [0.02, 0.0, 0.0]
    expected, others = made.compose(pose=aside).read(), made.compose().read()
    assert (expected != others).mean() > 0.05
    ended, told = threading.Event(), list[str]()
    thread = threading.Thread(target=lambda: [made.compose() for _ in iter(ended.is_set, True)])
    thread.start()
    try:
        for _ in range(60):
            frame = made.compose(pose=aside)
            try:
                np.testing.assert_array_equal(frame.read(), expected)
            except BadInputError as error:
                told.append(str(error))
    finally:
        ended.set()
        thread.join()
    assert len(told) < 60
    assert all("a later compose has overwritten this picture" in each for each in told)


def test_a_context_held_by_another_thread_is_refused_in_a_sentence(
    engine: Engine, compositor: Make, flat_image_headset: Eye
) -> None:
    made = compositor(flat_image_headset, context="egl")
    vars(made.context)["_ctx"].__enter__()
    error = in_thread(lambda: grey_frame(made, flat_image_headset))
    assert isinstance(error, BadInputError)
    assert "cannot be made current on this thread" in str(error)
    make_current(engine.ctx)
    assert (grey_frame(made, flat_image_headset) == 128).all()
