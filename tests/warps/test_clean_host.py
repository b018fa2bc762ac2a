"""A host that promises OpenGL's default state: the same pictures, and nothing of its state is read or restored."""

from collections.abc import Callable, Mapping
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from gl_caller import Caller, assert_same, make_current
from warps.composing import HEAD, SMALL, draw, scene, viewpoint

from benchmarks.scene_source import SceneSource
from wlr_render.errors import BadInputError
from wlr_render.gl.framebuffers import TextureLayer
from wlr_render.mappings import Eye
from wlr_render.numerics.arrays import FloatArray
from wlr_render.warp.compositor import Compositor
from wlr_render.warp.stored_picture import DepthKind, StoredDepth

pytestmark = pytest.mark.gl

WINDOW = StoredDepth(DepthKind.WINDOW, 0.5, 4.0)


@pytest.fixture
def models(flat_image_headset: Eye) -> dict[str, Eye]:
    return {"right": flat_image_headset, "left": replace(flat_image_headset, eye="left")}


@pytest.fixture
def clean(caller: Caller, compositor: Callable[..., Any], models: Mapping[str, Eye]) -> Compositor:
    made: Compositor = compositor(models, context=caller.ctx, host_state="clean")
    return made


def seen(models: Mapping[str, Eye]) -> dict[str, FloatArray]:
    return {eye: viewpoint(each) for eye, each in models.items()}


def switches(caller: Caller) -> dict[str, Any]:
    state = caller.state()
    names = [name for name in state if name.startswith(("switch", "colour mask", "depth mask", "polygon", "clip"))]
    return {name: state[name] for name in names}


def test_the_pictures_are_those_of_an_own_context_and_no_switch_changes(
    caller: Caller, compositor: Callable[..., Any], models: Mapping[str, Eye]
) -> None:
    before = switches(caller)
    own = compositor(models, context="egl")
    draw(own, SceneSource(own, scene()), HEAD, seen(models))
    frame = own.compose()
    expected = [frame.read(eye) for eye in own.eyes]
    make_current(caller.ctx)
    clean = compositor(models, context=caller.ctx, host_state="clean")
    assert switches(caller) == before
    source = SceneSource(clean, scene())
    for _ in range(2):
        draw(clean, source, HEAD, seen(models))
        assert switches(caller) == before
        composed = clean.compose()
        assert switches(caller) == before
        for eye, picture in zip(clean.eyes, expected, strict=True):
            np.testing.assert_array_equal(composed.read(eye), picture)
    assert caller.ctx.error == "GL_NO_ERROR"


def test_no_state_is_restored(caller: Caller, clean: Compositor, models: Mapping[str, Eye]) -> None:
    """The mode would be worthless if it restored the state after all."""
    caller.framebuffer.use()
    source = SceneSource(clean, scene())
    bound = caller.state()["draw framebuffer"]
    draw(clean, source, HEAD, seen(models))
    clean.compose()
    assert caller.state()["draw framebuffer"] != bound


@pytest.mark.filterwarnings("error")
def test_a_released_compositor_leaves_no_program_that_another_one_cannot_restore(
    caller: Caller, clean: Compositor, compositor: Callable[..., Any], models: Mapping[str, Eye]
) -> None:
    kept = compositor(models, context=caller.ctx)
    draw(clean, SceneSource(clean, scene()), HEAD, seen(models))
    clean.compose()
    clean.release()
    source = SceneSource(kept, scene())
    for _ in range(2):
        draw(kept, source, HEAD, seen(models))
        kept.compose()
    assert caller.ctx.error == "GL_NO_ERROR"


def test_pictures_by_number_and_layer(caller: Caller, clean: Compositor, models: Mapping[str, Eye]) -> None:
    """Numbers are remembered: what is drawn into their objects later is shown all the same."""
    ctx = caller.ctx
    screen = ctx.simple_framebuffer((2 * SMALL[0], SMALL[1]))
    size = clean.plan("left").camera.width_px, clean.plan("left").camera.height_px
    colours = ctx.texture_array((*size, 2), 4), ctx.texture(size, 4)
    drawn, depth = ctx.simple_framebuffer(size), ctx.depth_texture(size, np.full(size[::-1], 0.5, np.float32))
    for grey in (50, 90):
        pixels = np.full((*size[::-1], 4), grey, np.uint8)
        drawn.clear(grey / 255, grey / 255, grey / 255, grey / 255, depth=0.5)
        colours[0].write(np.stack([0 * pixels, pixels]))
        colours[1].write(pixels)
        for given in (
            {"left": (drawn.glo, None), "right": (drawn, None)},
            {"left": (TextureLayer(colours[0].glo, 1), depth.glo), "right": (colours[1].glo, depth.glo)},
        ):
            clean.begin_frame(HEAD, seen(models))
            for eye, picture in given.items():
                clean.submit(*picture, eye=eye, stored=WINDOW)
            clean.compose(screen.glo)
            shown = np.frombuffer(screen.read(components=4), np.uint8)
            assert set(np.unique(shown)) <= {0, grey, 255}
            assert (shown == grey).mean() > 0.5


@pytest.mark.parametrize("host_state", ["kept", "clean"])
def test_a_number_whose_object_has_changed_is_looked_up_again(
    caller: Caller, compositor: Callable[..., Any], models: Mapping[str, Eye], host_state: str
) -> None:
    """At once, or where the host keeps its names, when they are forgotten."""
    ctx, size = caller.ctx, (2 * SMALL[0], SMALL[1])
    made = compositor(models, context=ctx, host_state=host_state)
    screen, other = ctx.simple_framebuffer(size), ctx.texture(size, 4, bytes(4 * size[0] * size[1]))
    draw(made, SceneSource(made, scene()), HEAD, seen(models))
    made.compose(screen.glo)
    caller.gl("glBindFramebuffer", 0x8D40, screen.glo)
    caller.gl("glFramebufferTexture", 0x8D40, 0x8CE0, other.glo, 0)
    made.compose(screen.glo)
    if host_state == "clean":
        assert not any(other.read())
        made.context.forget_names()
        made.compose(screen.glo)
    assert any(other.read())


def test_what_a_host_has_not_reset_is_named(caller: Caller, clean: Compositor) -> None:
    before = caller.state()
    clean.context.check_host_is_clean()
    assert_same(caller.state(), before)
    caller.ctx.depth_func = "<="  # a default of ModernGL, and of no interest
    caller.gl("glEnable", 0x0BE2)
    caller.gl("glPolygonMode", 0x0408, 0x1B01)
    caller.gl("glDepthMask", 0)
    caller.gl("glPixelStorei", 0x0CF2, 3)
    caller.samplers[0].use(3)
    before = caller.state()
    with pytest.raises(BadInputError) as told:
        clean.context.check_host_is_clean()
    assert (
        "not clean: glDepthMask(), glPolygonMode(GL_FRONT_AND_BACK), glPixelStorei(GL_UNPACK_ROW_LENGTH), "
        "glEnable(GL_BLEND), glBindSampler(3) set other" in str(told.value)
    )
    assert_same(caller.state(), before)
    caller.gl("glDepthMask", 1)


def test_a_host_whose_state_is_kept_can_be_checked_too(
    caller: Caller, compositor: Callable[..., Any], models: Mapping[str, Eye]
) -> None:
    """Before it promises to be clean."""
    kept = compositor(models, context=caller.ctx)
    kept.context.check_host_is_clean()
    caller.gl("glEnable", 0x0BE2)
    with pytest.raises(BadInputError, match=r"glEnable\(GL_BLEND\) set other"):
        kept.context.check_host_is_clean()
