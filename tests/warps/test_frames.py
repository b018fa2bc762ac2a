"""The order of a frame's calls, faulty poses and viewpoints, and many frames."""

import gc
import itertools
import tracemalloc
from collections.abc import Callable, Mapping
from dataclasses import replace
from typing import Any, NoReturn

import numpy as np
import pytest
from gl_caller import Caller, open_other
from gl_scenes import at
from warps.composing import CONTEXTS, HEAD, SMALL, Make, draw, planar, scene, viewpoint

from benchmarks.scene_source import SceneSource
from wlr_render.errors import BadInputError, MissingGlError
from wlr_render.gl import gl
from wlr_render.gl.context import GlContext
from wlr_render.mappings import Eye
from wlr_render.numerics.arrays import FloatArray
from wlr_render.warp.compositor import Compositor

TINY = 24, 20


def scaled(pose: FloatArray, factor: float) -> FloatArray:
    return pose @ np.diag([factor] * 3 + [1.0])


@pytest.mark.parametrize("context", CONTEXTS)
def test_calls_out_of_order_are_told_in_a_sentence(compositor: Make, pair: Mapping[str, Eye], context: str) -> None:
    made = compositor(pair, context=context)
    source, seen = SceneSource(made, scene()), dict.fromkeys(pair, pair["left"].eye_box.centre)
    expected, first = None, True
    for call, words in ((made.submit, "call begin_frame"), (made.compose, "call begin_frame")):
        with pytest.raises(BadInputError, match=words):
            call(None) if call == made.submit else call()
    for _ in range(2):
        cameras = made.begin_frame(HEAD, seen)
        if first:
            with pytest.raises(BadInputError, match="left eye has not been submitted"):
                made.compose()
        source.submit(cameras["left"])
        with pytest.raises(BadInputError, match="left eye was submitted already"):
            source.submit(cameras["left"])
        if first:
            with pytest.raises(BadInputError, match="right eye has not been submitted"):
                made.compose()
        first = False
        for eye in (None, "middle", 1, ["left"]):
            with pytest.raises(BadInputError, match=r"(name one of|choose from) left, right"):
                made.submit(None, eye=eye)
        source.submit(cameras["right"])
        frame = made.compose()
        for call in (frame.read, frame.texture, frame.source):
            with pytest.raises(BadInputError, match="there are two eyes; name one of left, right"):
                call()
        pictures = [frame.read(eye) for eye in pair]
        expected = expected or pictures
        np.testing.assert_array_equal(pictures, expected)


@pytest.mark.gl
def test_faulty_poses_and_viewpoints_leave_the_frame_as_it_was(made: Compositor, seen: FloatArray) -> None:
    draw(made, SceneSource(made, scene()), HEAD, seen)
    expected = made.compose().read()
    away, unfinite = seen + [0.0, 0.02, 0.0], np.where(np.eye(4) > 0, np.nan, HEAD)
    poses = (unfinite, np.full((4, 4), np.inf), scaled(HEAD, 1.01), scaled(HEAD, -1.0), HEAD.T, HEAD[:3], HEAD[None])
    viewpoints = (away, seen * np.nan, seen[:2], {"left": seen}, np.stack([seen, seen]))
    faults: tuple[Callable[[], object], ...] = (
        *(lambda pose=pose: made.begin_frame(pose, seen) for pose in poses),
        *(lambda pose=pose: made.compose(pose=pose) for pose in poses),
        *(lambda pose=pose: made.compose(pose_at_last_row=pose) for pose in poses),
        *(lambda given=given: made.begin_frame(HEAD, given) for given in viewpoints),
        *(lambda given=given: made.compose(viewpoint=given) for given in viewpoints),
        lambda: made.within_reach("left", seen),
        lambda: made.plan("left"),
    )
    for fault in faults:
        with pytest.raises(BadInputError) as told:
            fault()
        assert str(told.value).count("\n") == 0
        np.testing.assert_array_equal(made.compose().read(), expected)
    reached = made.within_reach("right", away)
    assert made.compose(viewpoint=reached).read().any()


@pytest.mark.parametrize("context", CONTEXTS)
def test_a_released_compositor_says_so(flat_image_headset: Eye, compositor: Make, context: str) -> None:
    seen = viewpoint(flat_image_headset)
    made = compositor(flat_image_headset, context=context)
    with made:
        draw(made, SceneSource(made, scene()), HEAD, seen)
        frame = made.compose(with_source=True)
        assert frame.unsolved() == {"right": {}}
    made.release()
    for call in (
        frame.read,
        frame.texture,
        frame.source,
        frame.unsolved,
        lambda: made.begin_frame(HEAD, seen),
        lambda: made.submit(np.zeros(3)),
        made.compose,
        made.__enter__,
        made.finish,
    ):
        with pytest.raises(BadInputError, match="has been released; make another one"):
            call()
    assert made.renderer
    for call in (frame.eyes["right"].read_colour, frame.eyes["right"].read_ray_maps):
        with pytest.raises(BadInputError, match="context has been released with all its pictures"):
            call()


@pytest.mark.gl
def test_choices_that_are_none_are_told_in_a_sentence(compositor: Make, flat_image_headset: Eye) -> None:
    compositor(flat_image_headset)
    given: dict[str, Any] = {"models": flat_image_headset, "size": SMALL, "context": "auto"}
    for options, words in (
        ({"size": (0, 60)}, "size"),
        ({"resolution": 0.0}, "resolution"),
        ({"raster_camera": "pupil"}, "raster_camera is 'pupil'; choose from nearest, viewpoint"),
        ({"raster_camera": np.array(["nearest", "viewpoint"])}, "raster_camera"),
        ({"resolution": "1"}, "resolution is '1'"),
        ({"resolution": True}, "resolution is True"),
        ({"late_margin_deg": None}, "late_margin_deg is None"),
        ({"size": (10**6, 20)}, "and OpenGL takes"),
        ({"size": (20, 10**6)}, "and OpenGL takes"),
        ({"size": (40000, 25000)}, "pixels, 134217728 of them at most"),
        ({"size": ("72", "60")}, "size is .'72', '60'.; give .width, height. in whole pixels"),
        ({"size": (9000, 9000), "resolution": 4}, "the right eye's camera would have .* make size, resolution"),
        ({"models": {"right": None}}, "NoneType is not a model"),
        ({"models": {"left": flat_image_headset, "right": flat_image_headset}}, "model of the right eye"),
        ({"late_margin_deg": -1.0}, "late_margin_deg"),
        ({"background": (0, 0, 300)}, "background"),
        ({"host_state": "dirty"}, "host_state is 'dirty'; choose from kept, clean"),
        ({"context": "vulkan"}, "choose from auto, egl, osmesa, current"),
    ):
        with pytest.raises(BadInputError, match=words):
            Compositor(**given | options)


@pytest.mark.parametrize("size", [(1, 1), (1, 9), (7, 2), (300, 5)])
@pytest.mark.gl
def test_pictures_of_any_size_and_shape(compositor: Make, flat_image_headset: Eye, size: tuple[int, int]) -> None:
    made, seen = compositor(flat_image_headset, size), viewpoint(flat_image_headset)
    draw(made, SceneSource(made, scene()), HEAD, seen)
    composed = made.compose(pose_at_last_row=HEAD).read()
    assert composed.shape == (size[1], size[0], 3)
    assert composed.any(axis=-1).all()


def moved(frame: float) -> tuple[FloatArray, tuple[float, float, int]]:
    """A head that shakes and a pupil that wanders, and returns every 20 frames."""
    phase = 2 * np.pi * frame / 20
    return HEAD @ at(0.003 * np.sin(phase), 0.002 * np.cos(phase), 0), (0.7 * np.sin(phase), 0.6 * np.cos(phase), 0)


def grown_bytes(run: Callable[..., Any], first: int, middle: int, last: int) -> int:
    """By how much Python's memory grows over as many frames as from the middle one to the last, at the least.

    Of two such spans: what leaks grows in both, and the libraries' own stores fill in one. numpy fills its before.
    """
    tracemalloc.start()
    run(range(first, middle))
    sizes = []
    for span in (range(0), range(middle, last), range(last, 2 * last - middle)):
        run(span)
        gc.collect()
        sizes.append(tracemalloc.get_traced_memory()[0])
    tracemalloc.stop()
    return min(later - earlier for earlier, later in itertools.pairwise(sizes))


@pytest.mark.gl
@pytest.mark.slow
def test_frames_leave_nothing_behind(compositor: Make, gl_context: GlContext) -> None:
    if gl_context.backend != "egl":
        pytest.skip("EGL does not open here, so that there is no other context to adopt.")
    headset, caller = planar(device="birdbath28"), Caller()  # its warp grid is the coarsest
    made = compositor(headset, TINY, context=caller.ctx)
    source, screen = SceneSource(made, scene()), caller.ctx.simple_framebuffer(TINY)
    image = source.read(made.begin_frame(HEAD, viewpoint(headset))["right"].view)

    def run(frames: range) -> None:
        for frame in frames:
            pose, unit = moved(frame)
            (camera,) = made.begin_frame(pose, viewpoint(headset, *unit)).values()
            with pytest.raises(BadInputError):
                made.submit(image.colour)
            if frame % 2:
                source.submit(camera)
            else:
                made.submit(image.colour, image.inverse_depth)
            late, last = moved(frame + 0.3)[0], moved(frame + 0.5)[0] if frame % 3 else None
            with pytest.raises(BadInputError):
                made.compose(4321)
            made.compose(screen.glo, pose=late, pose_at_last_row=last)
            made.compose(with_source=frame % 5 == 0).unsolved()

    run(range(60))  # all ways of drawing have been met
    objects = [*map(len, caller.objects())]
    assert grown_bytes(run, 60, 210, 360) < 150 * 112  # less than an array a frame
    assert [*map(len, caller.objects())] == objects
    made.release()
    caller.ctx.release()


def test_the_context_that_is_asked_for_is_used(
    compositor: Make, flat_image_headset: Eye, gl_context: GlContext
) -> None:
    assert compositor(flat_image_headset, context="auto").renderer == gl_context.renderer
    theirs = open_other(backend=gl_context.backend)
    current = compositor(flat_image_headset, context="current")
    assert current.renderer == theirs.info["GL_RENDERER"]
    current.release()
    theirs.release()


def test_without_opengl_there_is_no_compositor(flat_image_headset: Eye, monkeypatch: pytest.MonkeyPatch) -> None:
    def refuse() -> NoReturn:
        raise ValueError("no driver")

    with pytest.raises(BadInputError, match=r"A compositor needs OpenGL; .* or draw ray-traced frames"):
        Compositor(flat_image_headset, SMALL, context="cpu")
    monkeypatch.setattr(gl, "_OPENERS", {"egl": refuse, "osmesa": refuse})
    for context in ("auto", "egl"):
        with pytest.raises(MissingGlError, match=r"no driver.*install libegl1 .* or draw ray-traced frames"):
            Compositor(flat_image_headset, SMALL, context=context)


@pytest.mark.parametrize("adopted", [False, True])
def test_after_a_lost_context_a_new_compositor_draws_the_same(
    compositor: Make, flat_image_headset: Eye, adopted: bool
) -> None:
    def made_anew() -> Compositor:
        own = open_other(410) if adopted else "egl"
        made: Compositor = compositor(flat_image_headset, context=own)
        return made

    lost, seen = made_anew(), viewpoint(flat_image_headset)
    draw(lost, SceneSource(lost, scene()), HEAD, seen)
    before = lost.compose().read()
    lost.context._errors._get_error = lambda: 0x0507  # GL_CONTEXT_LOST, for ever
    with pytest.raises(gl.GlError, match="the context is lost"):
        lost.compose()
    lost.release()
    with pytest.raises(BadInputError, match="has been released"):
        lost.compose()
    again = made_anew()
    draw(again, SceneSource(again, scene()), HEAD, seen)
    np.testing.assert_array_equal(again.compose().read(), before)


def test_a_frame_is_itself_alone_and_may_be_a_key(compositor: Make, flat_image_headset: Eye) -> None:
    made, seen = compositor(flat_image_headset), flat_image_headset.eye_box.centre
    first, second = (made.begin_frame(HEAD, seen) for _ in range(2))
    pending = {first: "first", second: "second"}
    assert (pending[first], pending[second]) == ("first", "second")
    assert first != second
    camera = first["right"].view.camera
    assert camera != replace(camera)
    assert {camera: "its renderer"}[second["right"].view.camera] == "its renderer"
