"""A host that promises OpenGL's default state: the same pictures, and nothing of its state is read or restored."""

from collections.abc import Mapping
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from gl_caller import Caller, make_current
from warps.composing import HEAD, SMALL, Make, draw, scene, viewpoint

from benchmarks.scene_source import SceneSource
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
def clean(caller: Caller, compositor: Make, models: Mapping[str, Eye]) -> Compositor:
    made: Compositor = compositor(models, context=caller.ctx, host_state="clean")
    return made


def seen(models: Mapping[str, Eye]) -> dict[str, FloatArray]:
    return {eye: viewpoint(each) for eye, each in models.items()}


def switches(caller: Caller) -> dict[str, Any]:
    state = caller.state()
    names = [name for name in state if name.startswith(("switch", "colour mask", "depth mask", "polygon", "clip"))]
    return {name: state[name] for name in names}


def test_the_pictures_are_those_of_an_own_context_and_no_switch_changes(
    caller: Caller, compositor: Make, models: Mapping[str, Eye]
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


def test_pictures_by_number_and_layer(caller: Caller, clean: Compositor, models: Mapping[str, Eye]) -> None:
    """A picture that is drawn into their objects later is shown."""
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
def test_a_number_is_asked_about_in_each_frame_and_a_layer_once(
    caller: Caller, compositor: Make, models: Mapping[str, Eye], host_state: str
) -> None:
    """Another object may have a number in the next frame; who makes a new one makes a new `TextureLayer`."""
    ctx, size = caller.ctx, (2 * SMALL[0], SMALL[1])
    made = compositor(models, context=ctx, host_state=host_state)
    screen, other = ctx.simple_framebuffer(size), ctx.texture(size, 4, bytes(4 * size[0] * size[1]))
    draw(made, SceneSource(made, scene()), HEAD, seen(models))
    made.compose(screen.glo)
    caller.gl("glBindFramebuffer", 0x8D40, screen.glo)
    caller.gl("glFramebufferTexture", 0x8D40, 0x8CE0, other.glo, 0)
    made.compose(screen.glo)
    assert any(other.read())
    layer = TextureLayer(other.glo)
    made.compose(layer)
    asked = spied(made, "size")
    made.compose(layer)
    assert not asked
    made.compose(TextureLayer(other.glo))
    assert asked


def spied(made: Compositor, name: str) -> list[object]:
    """The calls of a query of the compositor's targets from now on."""
    ask = vars(vars(vars(made)["_backend"])["_framebuffers"])["_ask"]
    before = getattr(ask, name)
    calls: list[object] = []

    def counted(*arguments: object) -> object:
        calls.append(arguments)
        return before(*arguments)

    setattr(ask, name, counted)
    return calls
