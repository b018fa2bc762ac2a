"""The warp as a compute shader, which software renderers do not choose, against the warp as fragment shaders.

The other tests of the warp compare the fragment shaders with closed forms and ray-traced frames.
"""

from collections.abc import Callable, Iterator
from typing import Any

import gl_scenes
import moderngl
import numpy as np
import pytest
from gl_caller import Caller, assert_same
from numpy.typing import NDArray
from present import present
from warps.composing import HEAD, SMALL, Make, draw, planar, scene, viewpoint
from warps.test_insets import inset_of

from benchmarks.scene_source import SceneSource
from wlr_render.geometry import transforms
from wlr_render.gl.context import GlContext
from wlr_render.warp.compositor import Compositor
from wlr_render.warp.panel_light import PanelLight
from wlr_render.warp.stored_picture import StoredColour
from wlr_render.warp.warp import WarpStatus

pytestmark = pytest.mark.gl

WIDTH, HEIGHT = SMALL
MOVED = HEAD @ gl_scenes.at(0.01, -0.01, 0.02, transforms.rotation_about("y", 0.02))
TABLE = np.linspace(0, 1, 256)[:, None] ** np.array([1.8, 2.0, 2.4])
UNEVEN = np.linspace(0.5, 1, WIDTH * HEIGHT).reshape(HEIGHT, WIDTH)
Compose = Callable[[Compositor], Any]


@pytest.fixture
def in_both(compositor: Make, gl_context: GlContext) -> Iterator[Callable[..., list[Any]]]:
    """Composes in both ways with compositors that share no texture; results of fragment shaders come first."""

    def compose(run: Compose, channels: int = 1, **options: Any) -> list[Any]:
        found = []
        for gl_context.computes in (False, True):
            made = compositor({"right": [planar()] * channels}, **options)
            draw(made, SceneSource(made, scene(wall=False)), HEAD, viewpoint(planar()))
            found.append(run(made))
        return found

    usual = gl_context.computes
    yield compose
    gl_context.computes = usual


def with_overlay(made: Compositor) -> None:
    picture = np.random.default_rng(1).integers(0, 255, (40, 30, 4), dtype=np.uint8)
    at = np.eye(4)
    at[:3, 3] = 0.05, 0.0, -0.8
    made.submit_overlay(picture, (0.3, 0.2), device_from_quad=at)


def with_inset(made: Compositor) -> None:
    (camera,) = made.begin_frame(HEAD, viewpoint(planar())).values()
    source = SceneSource(made, scene(wall=False))
    source.submit(camera)
    inset = inset_of(camera, 0.6, 2)
    colour = np.random.default_rng(2).integers(0, 255, (*inset.size_px[::-1], 3), dtype=np.uint8)
    made.submit(colour, None, camera=inset)


@pytest.mark.parametrize(
    ("options", "prepare", "last_row"),
    [
        ({}, None, None),
        ({"channels": 3, "resolution": 2.0}, with_inset, MOVED),
        ({"panel": PanelLight(bits=10, uniformity=UNEVEN)}, with_overlay, None),
        ({"panel": PanelLight(bits=16, encoding="linear")}, None, None),
        ({"panel": PanelLight(encoding=TABLE)}, None, None),
    ],
    ids=[
        "plain",
        "three colours, filtered, by rows, with an inset",
        "10 bits, uneven, with an overlay",
        "16 bits",
        "table",
    ],
)
def test_both_entries_show_the_same(
    in_both: Callable[..., list[Any]],
    options: dict[str, Any],
    prepare: Callable[[Compositor], None] | None,
    last_row: Any,
) -> None:
    def run(made: Compositor) -> tuple[NDArray[Any], ...]:
        if prepare is not None:
            prepare(made)
        frame = made.compose(pose=MOVED if last_row is None else HEAD, pose_at_last_row=last_row, with_source=True)
        return frame.read(), frame.status(), present(frame.source())

    (colour, status, source), (computed, computed_status, computed_source) = in_both(run, **options)
    assert colour.dtype == computed.dtype
    assert (status == computed_status).mean() > 0.999
    same = (status == computed_status) & (status <= WarpStatus.DISOCCLUDED)
    close = np.abs(source - computed_source)[same].max(axis=-1) < 0.01
    assert close.mean() > 0.999
    code = {np.uint8: 1.0, np.uint16: 65.1, np.float16: 1e-3}[colour.dtype.type]
    assert np.abs(colour[same].astype(float) - computed[same])[close].max() <= code
    assert colour[same].std() > 10 * code


@pytest.mark.parametrize("samples", [0, 4])
def test_a_picture_is_copied_into_a_target_upright(in_both: Callable[..., list[Any]], samples: int) -> None:
    def run(made: Compositor) -> tuple[NDArray[np.uint8], NDArray[np.uint8]]:
        return composed_into(made, samples)[..., :3], made.compose().read()

    (_, drawn), (shown, computed) = in_both(run)
    np.testing.assert_array_equal(shown, computed)
    assert np.abs(drawn.astype(int) - computed).max() <= 1
    assert computed.std() > 10


def test_alpha_reaches_a_target_with_its_levels(in_both: Callable[..., list[Any]]) -> None:
    def run(made: Compositor) -> NDArray[np.uint8]:
        (camera,) = made.begin_frame(HEAD, viewpoint(planar())).values()
        width, height = camera.size_px
        colour = np.full((height, width, 4), 60, np.uint8)
        colour[..., 3] = np.linspace(60, 255, width)
        made.submit(colour, np.ones((height, width), np.float32), stored_colour=StoredColour(alpha=True))
        return composed_into(made)

    drawn, computed = in_both(run, panel=PanelLight(bits=10))
    assert np.abs(drawn.astype(int) - computed).max() <= 1
    assert len(np.unique(computed[..., 3])) > 30


def composed_into(made: Compositor, samples: int = 0) -> NDArray[np.uint8]:
    """RGBA of a framebuffer into which a frame is composed, its top row first."""
    with made.context.drawing() as ctx:
        target, shown = ctx.simple_framebuffer(SMALL, samples=samples), ctx.simple_framebuffer(SMALL)
    made.compose(target)
    with made.context.drawing() as ctx:
        ctx.copy_framebuffer(shown, target)
        return np.frombuffer(shown.read(components=4), np.uint8).reshape(HEIGHT, WIDTH, 4)[::-1]


def test_a_program_finds_its_images_as_they_were(caller: Caller, compositor: Make) -> None:
    caller.set_odd_values()
    before = caller.state()
    made = compositor(planar(), context=caller.ctx)
    made.context.computes = True
    draw(made, SceneSource(made, scene()), HEAD, viewpoint(planar()))
    made.compose(with_source=True)
    assert_same(caller.state(), before)
    with made.context.drawing() as ctx:
        target = ctx.simple_framebuffer(SMALL)
    made.compose(target)
    assert_same(caller.state(), before)
    made.release()
    assert_same(caller.state(), before)


@pytest.fixture
def for_two_eyes(gl_context: GlContext) -> Iterator[GlContext]:
    """The context of the test run, with compute shaders for two eyes as on a GPU."""
    usual = gl_context.computes, gl_context.dispatches.eyes
    gl_context.computes, gl_context.dispatches.eyes = True, 2
    yield gl_context
    gl_context.computes, gl_context.dispatches.eyes = usual


def both_eyes(compositor: Make, channels: int = 1) -> Compositor:
    """A compositor of two eyes, of which the pictures have different sizes, with the pictures of a frame."""
    left, right = planar("left", "birdbath28"), planar()
    made: Compositor = compositor({"left": [left] * channels, "right": [right] * channels}, resolution=0.8)
    assert made.plan("left").camera.size_px != made.plan("right").camera.size_px
    viewpoints = {"left": viewpoint(left), "right": viewpoint(right)}
    draw(made, SceneSource(made, scene(wall=False)), HEAD, viewpoints)
    return made


@pytest.mark.parametrize(
    ("channels", "prepare", "at_once"),
    [(1, None, 2), (1, with_overlay, 2), (1, None, 1), pytest.param(3, None, 2, marks=pytest.mark.slow)],
    ids=["plain", "with an overlay", "few samplers", "three colours"],
)
def test_one_dispatch_for_both_eyes_shows_what_one_for_each_shows(
    compositor: Make,
    for_two_eyes: GlContext,
    monkeypatch: pytest.MonkeyPatch,
    channels: int,
    prepare: Callable[[Compositor], None] | None,
    at_once: int,
) -> None:
    """In the first frame both eyes' shaders run; in the second the right eye keeps picture and viewpoint."""
    dispatched: list[tuple[int, ...]] = []
    run = moderngl.ComputeShader.run

    def counted(shader: moderngl.ComputeShader, *groups: int) -> None:
        dispatched.append(groups)
        run(shader, *groups)

    monkeypatch.setattr(moderngl.ComputeShader, "run", counted)
    for_two_eyes.dispatches.eyes = at_once
    made = both_eyes(compositor, channels)
    if prepare is not None:
        prepare(made)
    for unit, eyes_of_each in (((), [2] * (channels + 5)), ((0.1, 0.2, 0.3), [1] * channels + [2] * 2)):
        moved = viewpoint(planar("left", "birdbath28"), *unit)
        given: Any = {"pose": HEAD, "pose_at_last_row": MOVED, "viewpoint": {"left": moved}, "with_source": True}
        dispatched.clear()
        frame = made.compose(**given)
        assert at_once == 1 or [eyes for _, _, eyes in dispatched] == eyes_of_each
        assert sum(eyes for _, _, eyes in dispatched) == sum(eyes_of_each)
        together = [(frame.read(eye), frame.status(eye), frame.source(eye)) for eye in made.eyes]
        for eye, shown in zip(made.eyes, together, strict=True):
            alone = made.compose(**given, eyes=[eye])
            for one, other in zip(shown, (alone.read(eye), alone.status(eye), alone.source(eye)), strict=True):
                np.testing.assert_array_equal(one, other)
            assert shown[0].std() > 10


@pytest.mark.parametrize("interrupted", [0, 3])
def test_the_frame_after_an_interrupted_one_is_right(
    compositor: Make, for_two_eyes: GlContext, monkeypatch: pytest.MonkeyPatch, interrupted: int
) -> None:
    def stopped(shader: moderngl.ComputeShader, *groups: int) -> None:
        remaining.pop()
        run(shader, *groups)

    run, remaining = moderngl.ComputeShader.run, [0] * interrupted
    expected = both_eyes(compositor).compose(pose=MOVED)
    made = both_eyes(compositor)
    with monkeypatch.context() as patch:
        patch.setattr(moderngl.ComputeShader, "run", stopped)
        with pytest.raises(IndexError):
            made.compose(pose=MOVED)
    shown = made.compose(pose=MOVED)
    for eye in made.eyes:
        np.testing.assert_array_equal(shown.read(eye), expected.read(eye))
        assert shown.read(eye).std() > 10
