"""A compositor in somebody else's OpenGL program: it finds everything as it left it.

A host that promises OpenGL's default state gets the same pictures; nothing of its state is read or restored.
"""

import ctypes
import threading
import time
import warnings
from collections.abc import Callable, Mapping
from functools import partial
from typing import Any

import moderngl
import numpy as np
import pytest
from gl_caller import Caller, assert_same, make_current, open_other, run
from numpy.typing import NDArray
from warps.composing import HEAD, SMALL, Make, draw, scene, viewpoint

from benchmarks.scene_source import SceneSource
from wlr_render.errors import BadInputError, MissingGlError
from wlr_render.gl.framebuffers import TextureLayer
from wlr_render.mappings import Eye
from wlr_render.numerics.arrays import FloatArray
from wlr_render.warp.compositor import Compositor
from wlr_render.warp.stored_picture import DepthKind, StoredDepth

pytestmark = pytest.mark.gl


def own_frame(
    compositor: Make, models: Eye | Mapping[str, Eye], seen: FloatArray | Mapping[str, FloatArray]
) -> list[NDArray[np.uint8]]:
    """What a compositor in a context of its own composes."""
    made = compositor(models, context="egl")
    draw(made, SceneSource(made, scene()), HEAD, seen)
    frame = made.compose()
    return [frame.read(eye) for eye in made.eyes]


def switches(caller: Caller) -> dict[str, Any]:
    state = caller.state()
    names = [name for name in state if name.startswith(("switch", "colour mask", "depth mask", "polygon", "clip"))]
    return {name: state[name] for name in names}


@pytest.mark.parametrize("host_state", ["kept", "clean"])
def test_two_eyes_are_those_of_an_own_context_and_leave_the_state(
    caller: Caller, compositor: Make, pair: Mapping[str, Eye], host_state: str
) -> None:
    """All of an odd state, or the switches of one that the host promises to be OpenGL's own."""
    seen = {"left": viewpoint(pair["left"], -0.7, 0, 0), "right": viewpoint(pair["right"], 0.7, 0, 0)}
    expected = own_frame(compositor, pair, seen)
    make_current(caller.ctx)
    screen = caller.ctx.simple_framebuffer((2 * SMALL[0], SMALL[1]))
    if host_state == "kept":
        caller.set_odd_values()
    look = caller.state if host_state == "kept" else partial(switches, caller)
    before = look()
    made = compositor(pair, context=caller.ctx, host_state=host_state)
    assert_same(look(), before)
    source = SceneSource(made, scene())
    for frame in range(3):
        for camera in made.begin_frame(HEAD, seen).values():
            source.submit(camera)
            assert_same(look(), before)
        composed = made.compose()
        assert_same(look(), before)
        for eye, picture in zip(made.eyes, expected, strict=True):
            np.testing.assert_array_equal(composed.read(eye), picture, err_msg=str(frame))
        made.compose(screen)
        assert_same(look(), before)
    made.release()
    assert_same(look(), before)
    assert caller.ctx.error == "GL_NO_ERROR"


def test_faults_leave_the_state_and_the_next_frame_is_right(
    caller: Caller, compositor: Make, flat_image_headset: Eye
) -> None:
    seen, wrong = viewpoint(flat_image_headset), caller.ctx.simple_framebuffer((3, 4))
    (expected,) = own_frame(compositor, flat_image_headset, seen)
    make_current(caller.ctx)
    made = compositor(flat_image_headset, context=caller.ctx)
    source = SceneSource(made, scene())
    caller.set_odd_values()
    before = caller.state()
    draw(made, source, HEAD, seen)
    for fault in (
        lambda: made.begin_frame(HEAD * np.nan, seen),
        lambda: made.begin_frame(HEAD, seen + 1.0),
        lambda: made.submit(wrong),
        lambda: made.compose(wrong),
        lambda: made.compose(pose=HEAD.T),
        lambda: Compositor(flat_image_headset, SMALL, context=caller.ctx, resolution=9),
    ):
        with pytest.raises(BadInputError):
            fault()
        assert_same(caller.state(), before)
    made.begin_frame(HEAD, seen)
    with pytest.raises(BadInputError, match="pixels"):
        made.submit(wrong)
    assert_same(caller.state(), before)
    draw(made, source, HEAD, seen)
    np.testing.assert_array_equal(made.compose().read(), expected)
    assert_same(caller.state(), before)


@pytest.mark.parametrize("host_state", ["kept", "clean"])
def test_where_the_context_is_not_current_only_a_clean_hosts_work_stops(
    caller: Caller, compositor: Make, flat_image_headset: Eye, host_state: str
) -> None:
    third = open_other()
    make_current(caller.ctx)
    made = compositor(flat_image_headset, context=caller.ctx, host_state=host_state)
    source, seen = SceneSource(made, scene()), viewpoint(flat_image_headset)
    (camera,) = draw(made, source, HEAD, seen).values()
    expected, image = made.compose().read(), source.read(camera.view)
    arrays = image.colour, np.where(image.inverse_depth > 0, 1 / image.inverse_depth, 0)
    screen = caller.ctx.simple_framebuffer(SMALL).glo
    made.begin_frame(HEAD, seen)
    make_current(third)
    for call in (
        (lambda: made.submit(*arrays), made.compose, made.finish)
        if host_state == "clean"
        else (lambda: made.submit(screen), lambda: made.compose(screen), lambda: made.compose(0))
    ):
        with pytest.raises(BadInputError, match="is not current on this thread"):
            call()
    if host_state == "clean":
        make_current(caller.ctx)
    made.submit(*arrays)
    difference = np.abs(made.compose().read().astype(int) - expected)
    assert (difference > 1).mean() < 0.002
    make_current(caller.ctx)
    third.release()


def let_go(context: moderngl.Context) -> None:
    leave: Callable[..., object] = context.__exit__  # without types in ModernGL's stubs
    leave(None, None, None)


def test_a_thread_without_a_chosen_api_makes_a_compositor(caller: Caller, flat_image_headset: Eye) -> None:
    """EGL's threads begin with OpenGL ES."""
    made: list[Any] = []

    def make() -> None:
        make_current(caller.ctx)
        with Compositor(flat_image_headset, SMALL, context="current") as compositor:
            made.append(compositor.renderer)
        let_go(caller.ctx)

    let_go(caller.ctx)
    thread = threading.Thread(target=make)
    thread.start()
    thread.join()
    make_current(caller.ctx)
    assert made


def test_a_compositor_that_another_thread_uses_is_released_after_its_call(
    seen: FloatArray, caller: Caller, compositor: Make, flat_image_headset: Eye
) -> None:
    before = caller.objects()
    made = compositor(flat_image_headset, context=caller.ctx)
    draw(made, SceneSource(made, scene()), HEAD, seen)
    inside, told = threading.Event(), []

    def work() -> None:
        with made.context.drawing():
            inside.set()
            time.sleep(0.2)
            told.append(made.compose().read().std() > 5)

    thread = threading.Thread(target=work)
    thread.start()
    inside.wait()
    made.release()
    thread.join()
    assert told == [True]
    assert caller.objects() == before


def test_another_thread_composes_while_the_host_draws_on_its_own(
    caller: Caller, compositor: Make, flat_image_headset: Eye
) -> None:
    """Asynchronous reprojection: the newest picture is warped to the newest pose, whatever its frame is doing."""
    made = compositor(flat_image_headset, context=caller.ctx)
    source, seen, late = SceneSource(made, scene()), viewpoint(flat_image_headset), HEAD.copy()
    late[:3, 3] += [0.01, 0.0, 0.0]
    draw(made, source, HEAD, seen)
    expected, shown = made.compose(pose=late).read(), caller.ctx.texture(SMALL, 4)
    into, composed = TextureLayer(shown), 0

    def reproject() -> None:
        nonlocal composed
        while composed < 5:
            made.compose(into, pose=late)
            composed += 1

    thread = threading.Thread(target=reproject)
    thread.start()
    frames = 0
    while thread.is_alive() or not frames:
        draw(made, source, HEAD, seen)
        frames += 1
    thread.join()
    assert composed == 5
    pixels = np.frombuffer(shown.read(), np.uint8).reshape(*SMALL[::-1], 4)[::-1, :, :3]
    np.testing.assert_array_equal(pixels, expected)


def test_the_current_context_takes_its_own_programs_objects_and_no_others(
    seen: FloatArray, caller: Caller, compositor: Make, flat_image_headset: Eye
) -> None:
    elsewhere = open_other(410)
    make_current(caller.ctx)
    made = compositor(flat_image_headset, context="current")
    (camera,) = made.begin_frame(HEAD, seen).values()
    width, height = camera.size_px
    with elsewhere:
        foreign = elsewhere.texture(camera.size_px, 4)
    make_current(caller.ctx)
    grey, near = (np.full((height, width, n), value, kind) for n, value, kind in ((4, 128, "u1"), (1, 1, "f4")))
    colour, depth = caller.ctx.texture(camera.size_px, 4, grey), caller.ctx.texture(camera.size_px, 1, near, dtype="f4")
    before = caller.state()
    with pytest.raises(BadInputError, match="belongs to another ModernGL context"):
        made.submit(foreign, depth)
    made.submit(colour, depth)
    assert_same(caller.state(), before)
    screen = caller.ctx.simple_framebuffer(SMALL)
    made.compose(screen)
    shown = np.frombuffer(screen.read(), np.uint8)
    assert (shown == 128).mean() > 0.9
    elsewhere.release()
    make_current(caller.ctx)
    made.begin_frame(HEAD, seen)
    with pytest.raises(BadInputError, match="belongs to another ModernGL context"):
        made.submit(foreign, depth)


@pytest.mark.parametrize("host_state", ["kept", "clean"])
def test_adopting_while_samples_or_a_layer_are_bound(
    caller: Caller, compositor: Make, flat_image_headset: Eye, host_state: str
) -> None:
    """ModernGL's start makes errors with such a framebuffer, which are no fault of the host."""
    ctx = caller.ctx
    several = ctx.framebuffer([ctx.texture((8, 8), 4, samples=4)], ctx.depth_texture((8, 8), samples=4))
    layered, array = ctx.framebuffer([ctx.texture((8, 8), 4)]), ctx.texture_array((8, 8, 2), 4)
    layered.use()
    attach = [ctypes.c_uint] * 3 + [ctypes.c_int] * 2
    caller.gl("glFramebufferTextureLayer", 0x8D40, 0x8CE0, array.glo, 0, 1, types=attach)
    for framebuffer in (several, layered):
        framebuffer.use()
        with warnings.catch_warnings():
            warnings.simplefilter("error")
            compositor(flat_image_headset, context=ctx, host_state=host_state).release()
        if host_state == "kept":
            assert caller.state()["draw framebuffer"][0] == framebuffer.glo
        assert ctx.error == "GL_NO_ERROR"


def test_release_where_a_clean_hosts_context_is_not_current_warns_and_can_be_repeated(
    seen: FloatArray, caller: Caller, compositor: Make, flat_image_headset: Eye
) -> None:
    make_current(caller.ctx)
    before = caller.objects()
    made = compositor(flat_image_headset, context=caller.ctx, host_state="clean")
    made.begin_frame(HEAD, seen)
    third = open_other(410)
    with pytest.warns(RuntimeWarning, match="not current on this thread, so that nothing was released") as told:
        made.release()
    assert told[0].filename == __file__
    third.release()
    make_current(caller.ctx)
    made.begin_frame(HEAD, seen)
    made.release()
    assert caller.objects() == before
    with pytest.raises(BadInputError, match="has been released"):
        made.begin_frame(HEAD, seen)


def test_what_is_no_context_is_told_in_a_sentence(caller: Caller, flat_image_headset: Eye) -> None:
    for context in (None, 5):
        with pytest.raises(BadInputError, match=r"is not an OpenGL context; give .* auto, egl, osmesa, current"):
            Compositor(flat_image_headset, SMALL, context=context)
    with pytest.raises(BadInputError, match="host_state='clean' is of an adopted context, and context='egl' opens one"):
        Compositor(flat_image_headset, SMALL, context="egl", host_state="clean")
    caller.ctx.release()
    with pytest.raises(MissingGlError, match="has been released"):
        Compositor(flat_image_headset, SMALL, context=caller.ctx)


def test_an_old_context_is_refused_in_a_sentence_and_stays_usable(caller: Caller) -> None:
    told = run(
        """
        import moderngl
        from flat_image import flat_image_eye
        from wlr_render.warp.compositor import Compositor
        from wlr_render.errors import BadInputError
        ctx = moderngl.create_context(standalone=True, require=330, backend="egl")
        frame = ctx.simple_framebuffer((4, 4))
        frame.use()
        for context in (ctx, "current"):
            try:
                Compositor(flat_image_eye(), (20, 16), context=context)
            except BadInputError as error:
                print(error)
        assert ctx.fbo is frame
        assert ctx.error == "GL_NO_ERROR"
        ctx.clear(0.2, 0.4, 0.6, 1.0)
        assert frame.read() == bytes([51, 102, 153]) * 16
        """,
        MESA_GL_VERSION_OVERRIDE="3.3",
    )
    assert told.count("yours of version 3.3 (EGL refuses an OpenGL 4.1 context that shares") == 2
    assert told.count("\n") == 2


@pytest.mark.slow
def test_in_a_plain_pyrender_program(caller: Caller) -> None:
    told = run(
        """
        import pyglet
        pyglet.options["headless"] = True  # pyrender imports its window, which wants libXrender beside libX11
        import gl_scenes, numpy as np, pyrender, trimesh
        from flat_image import flat_image_eye
        from wlr_render.warp.compositor import Compositor
        from wlr_render.errors import BadInputError
        from wlr_render.draw.pyrender_drawing import PyrenderDrawing
        from wlr_render.warp.stored_picture import DepthKind, StoredDepth

        def made():
            scene = pyrender.Scene(ambient_light=[0.3] * 3, bg_color=[0.1, 0.2, 0.5])
            scene.add(pyrender.Mesh.from_trimesh(trimesh.creation.icosphere(2, 0.2)), pose=gl_scenes.at(0.1, 0, -1.0))
            scene.add(pyrender.DirectionalLight(intensity=3.0))
            return scene, scene.add(pyrender.PerspectiveCamera(1.0))

        scene, own = made()
        viewer = pyrender.OffscreenRenderer(64, 48)
        before = viewer.render(scene)
        eye = flat_image_eye()
        compositor = Compositor(eye, (72, 60), context="current")
        (camera,) = compositor.begin_frame(np.eye(4), eye.eye_box.centre).values()

        def rendered():
            lens = pyrender.IntrinsicsCamera(*camera.focal_px, *camera.centre_px, znear=0.05, zfar=50.0)
            scene.main_camera_node = scene.add(lens, pose=camera.world_from_camera)
            viewer.viewport_width, viewer.viewport_height = camera.size_px
            pictures = viewer.render(scene)
            scene.remove_node(scene.main_camera_node)
            scene.main_camera_node = own
            viewer.viewport_width, viewer.viewport_height = 64, 48
            return pictures

        compositor.submit(*rendered())
        from_arrays = compositor.compose().read()
        compositor.begin_frame(np.eye(4), eye.eye_box.centre)
        rendered()
        compositor.submit(viewer._renderer._main_fb, stored=StoredDepth(DepthKind.WINDOW, 0.05, 50.0))
        assert (compositor.compose().read() == from_arrays).mean() > 0.999
        assert from_arrays.std() > 10
        try:
            compositor.submit(*rendered())
        except BadInputError as error:
            print(error)
        try:
            PyrenderDrawing(compositor.context, scene, own).draw_on_gpu(gl_scenes.view())
        except BadInputError as error:
            print(error)
        bent = PyrenderDrawing(compositor.context, *made()).draw_on_gpu(gl_scenes.view()).read()
        assert (bent.inverse_depth > 1.0).sum() > 100
        for _ in range(2):
            after = viewer.render(scene)
            assert (after[0] == before[0]).all() and (after[1] == before[1]).all()
            compositor.release()
        print("same")
        """,
        PYOPENGL_PLATFORM="egl",
    )
    assert "the right eye was submitted already in this frame; call begin_frame for the next." in told
    assert "has been loaded by another renderer" in told
    assert told.endswith("same\n")


WINDOW = StoredDepth(DepthKind.WINDOW, 0.5, 4.0)


@pytest.fixture
def clean(caller: Caller, compositor: Make, pair: Mapping[str, Eye]) -> Compositor:
    made: Compositor = compositor(pair, context=caller.ctx, host_state="clean")
    return made


def viewpoints(pair: Mapping[str, Eye]) -> dict[str, FloatArray]:
    return {eye: viewpoint(each) for eye, each in pair.items()}


def test_no_state_is_restored(caller: Caller, clean: Compositor, pair: Mapping[str, Eye]) -> None:
    """The mode would be worthless if it restored the state after all."""
    caller.framebuffer.use()
    source = SceneSource(clean, scene())
    bound = caller.state()["draw framebuffer"]
    draw(clean, source, HEAD, viewpoints(pair))
    clean.compose()
    assert caller.state()["draw framebuffer"] != bound


def test_pictures_by_number_and_layer(caller: Caller, clean: Compositor, pair: Mapping[str, Eye]) -> None:
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
            clean.begin_frame(HEAD, viewpoints(pair))
            for eye, picture in given.items():
                clean.submit(*picture, eye=eye, stored=WINDOW)
            clean.compose(screen.glo)
            shown = np.frombuffer(screen.read(components=4), np.uint8)
            assert set(np.unique(shown)) <= {0, grey, 255}
            assert (shown == grey).mean() > 0.5


@pytest.mark.parametrize("host_state", ["kept", "clean"])
def test_a_number_is_asked_about_in_each_frame_and_a_layer_once(
    caller: Caller, compositor: Make, pair: Mapping[str, Eye], host_state: str
) -> None:
    """Another object may have a number in the next frame; who makes a new one makes a new `TextureLayer`."""
    ctx, size = caller.ctx, (2 * SMALL[0], SMALL[1])
    made = compositor(pair, context=ctx, host_state=host_state)
    screen, other = ctx.simple_framebuffer(size), ctx.texture(size, 4, bytes(4 * size[0] * size[1]))
    draw(made, SceneSource(made, scene()), HEAD, viewpoints(pair))
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
