"""Frames that are late, older pictures, single eyes, predictions, and read-back without waiting."""

import ctypes
import gc
import warnings
from collections.abc import Callable, Mapping
from functools import partial
from typing import Any

import moderngl
import numpy as np
import pytest
from gl_caller import Caller, assert_same
from gl_scenes import at
from warps.composing import HEAD, SMALL, Make, draw, planar, programs_compiled, scene, viewpoint

from benchmarks.scene_source import SceneSource
from wlr_render import Compositor
from wlr_render.draw.gl_raster import GlRaster
from wlr_render.draw.scene_raster import SceneRaster
from wlr_render.engine import FrameHandle
from wlr_render.errors import BadInputError
from wlr_render.geometry import transforms
from wlr_render.gl.context import GlContext
from wlr_render.mappings import Eye
from wlr_render.numerics.arrays import FloatArray

pytestmark = pytest.mark.gl
MOVED = HEAD @ at(0.004, -0.002, 0.003, transforms.rotation_about("y", 0.01))


Both = tuple[Compositor, SceneSource, dict[str, FloatArray]]
"""A compositor of two eyes, what draws for it, and viewpoints."""


@pytest.fixture
def both(compositor: Make, pair: Mapping[str, Eye]) -> Both:
    made = compositor(pair)
    return made, SceneSource(made, scene()), dict.fromkeys(pair, viewpoint(pair["right"]))


def test_a_missed_frame_is_shown_again_at_the_newest_pose(made: Compositor, seen: FloatArray) -> None:
    source = SceneSource(made, scene())
    draw(made, source, HEAD, seen)
    late = made.compose(pose=MOVED).read()
    still = made.compose().read()
    made.begin_frame(MOVED, seen)  # and nothing is submitted
    np.testing.assert_array_equal(made.compose().read(), late)
    assert (late != still).any()


def test_a_frame_says_which_viewpoints_and_pose_it_was_composed_for(both: Both) -> None:
    made, source, pupils = both
    draw(made, source, HEAD, pupils)
    newer = pupils["right"] + 1e-3
    frame = made.compose(pose=MOVED, viewpoint={"right": newer})
    assert [*frame.viewpoints] == ["left", "right"]
    np.testing.assert_array_equal(frame.viewpoints["left"], pupils["left"])
    np.testing.assert_array_equal(frame.viewpoints["right"], newer)
    np.testing.assert_array_equal(frame.world_from_device, MOVED)
    assert [*made.compose(eyes=("left",)).viewpoints] == ["left"]


def test_frames_may_be_submitted_late_but_not_out_of_order(
    made: Any, seen: FloatArray, compositor: Make, flat_image_headset: Eye
) -> None:
    source = SceneSource(made, scene())
    frames = [made.begin_frame(pose, seen) for pose in (HEAD, HEAD, MOVED, HEAD)]
    assert all(isinstance(frame, FrameHandle) and [*frame] == ["right"] for frame in frames)
    raster = GlRaster(made.context, scene())

    def submit(number: int) -> None:
        camera = frames[number]["right"]
        made.submit(raster.draw_on_gpu(camera.view), frame=frames[number])

    with pytest.raises(BadInputError, match="not one of the last 3 of this compositor; drop its picture"):
        submit(0)
    submit(2)
    with pytest.raises(BadInputError, match="frame 2 is older than frame 3, which the right eye shows already; drop"):
        submit(1)
    with pytest.raises(BadInputError, match="submitted already in this frame"):
        submit(2)
    other = compositor(flat_image_headset)
    theirs = other.begin_frame(HEAD, seen)
    for wrong in (theirs, "newest", 3):
        with pytest.raises(BadInputError, match="not one of the last 3"):
            made.submit(None, frame=wrong)
    shown = made.compose(pose=MOVED).read()
    draw(made, source, MOVED, seen)
    np.testing.assert_array_equal(made.compose().read(), shown)


def test_a_gpu_picture_of_another_pose_is_refused(made: Compositor, seen: FloatArray) -> None:
    raster = GlRaster(made.context, scene())
    old = raster.draw_on_gpu(made.begin_frame(HEAD, seen)["right"].view)
    made.begin_frame(MOVED, seen)
    with pytest.raises(BadInputError, match="drawn for another pose; draw it with the camera of its frame"):
        made.submit(old)
    with pytest.raises(BadInputError, match="has not been submitted"):
        made.compose()


@pytest.mark.parametrize("materials", ["own", "gltf"])
def test_a_gpu_picture_that_was_drawn_over_is_not_shown_for_the_old_pose(
    made: Compositor, seen: FloatArray, materials: str
) -> None:
    raster, first = SceneRaster(made.context, scene(), materials), made.begin_frame(HEAD, seen)
    made.submit(raster.draw_on_gpu(first["right"].view, "even"))
    shown = made.compose(pose=MOVED).read()
    second = made.begin_frame(MOVED, seen)
    raster.draw_on_gpu(second["right"].view, "odd")  # and is not submitted
    np.testing.assert_array_equal(made.compose().read(), shown)
    gone = raster.draw_on_gpu(second["right"].view, "even")
    with pytest.raises(BadInputError, match="right eye's picture has been drawn over since it was submitted"):
        made.compose()
    raster.draw_on_gpu(first["right"].view, "even")
    with pytest.raises(BadInputError, match="the picture has been drawn over; submit it before"):
        made.submit(gone)
    made.submit(raster.draw_on_gpu(second["right"].view, "even"))
    assert (made.compose(pose=HEAD).read() != shown).any()


def test_one_eye_may_be_begun_submitted_and_composed_alone(both: Both) -> None:
    made, source, seen = both
    (left,) = made.begin_frame(HEAD, {"left": seen["left"]}).values()
    with pytest.raises(BadInputError, match="right eye has no camera in this frame; name its viewpoint"):
        made.submit(None, eye="right")
    source.submit(left)
    with pytest.raises(BadInputError, match=r"right eye has not been submitted; .* or name the other in eyes"):
        made.compose()
    alone = made.compose(eyes=("left",))
    with pytest.raises(BadInputError, match="the right eye was not composed in this frame"):
        alone.read("right")
    assert [*alone.eyes] == ["left"]
    picture = alone.read()
    draw(made, source, HEAD, seen)
    np.testing.assert_array_equal(made.compose().read("left"), picture)
    wrong: tuple[Any, ...] = ((), "left", ("middle",), 5)
    for eyes in wrong:
        with pytest.raises(BadInputError, match=r"give some of left, right|choose from left, right"):
            made.compose(eyes=eyes)


def test_eyes_at_different_rates_each_show_their_newest_picture(both: Both) -> None:
    made, source, seen = both
    draw(made, source, HEAD, seen)
    expected = made.compose(pose=MOVED).read("left")
    right = made.begin_frame(MOVED, {"right": seen["right"]})["right"]
    source.submit(right)
    shown = made.compose()
    np.testing.assert_array_equal(shown.read("left"), expected)
    right_alone = shown.read("right")
    draw(made, source, MOVED, seen)
    np.testing.assert_array_equal(made.compose().read("right"), right_alone)


def test_an_overwritten_frame_is_refused_and_the_newest_is_not(both: Both) -> None:
    made, source, seen = both
    draw(made, source, HEAD, seen)
    old = made.compose(with_source=True)
    old_right = old.read("right")
    made.compose(eyes=("left",), pose=MOVED)
    np.testing.assert_array_equal(old.read("right"), old_right)
    for call in (old.read, old.status, old.source, old.texture, old.read_async):
        with pytest.raises(BadInputError, match="a later compose has overwritten this picture of the left eye"):
            call("left")
    read_into = partial(old.read_into, np.zeros((SMALL[1], SMALL[0], 4), np.uint8), "left")
    for refused in (old.unsolved, read_into):
        with pytest.raises(BadInputError, match="has overwritten"):
            refused()


def test_a_compositor_that_is_not_released_warns(flat_image_headset: Eye, caller: Caller) -> None:
    made = Compositor(flat_image_headset, SMALL, context=caller.ctx)
    with pytest.warns(ResourceWarning, match="Compositor was not released"):
        del made
    gc.collect()
    for context in (caller.ctx, "auto"):
        with warnings.catch_warnings():
            warnings.simplefilter("error")
            with Compositor(flat_image_headset, SMALL, context=context):
                pass
            with pytest.raises(BadInputError):
                Compositor(flat_image_headset, (0, 1), context=context)
            gc.collect()


@pytest.mark.slow
@pytest.mark.parametrize(("channels", "hidden_areas"), [(3, "repeated"), (1, "last picture")])
def test_prepared_compositors_compile_nothing_later(
    compositor: Make, monkeypatch: pytest.MonkeyPatch, channels: int, hidden_areas: str
) -> None:
    made = compositor({"right": [planar()] * channels}, context="egl", hidden_areas=hidden_areas)
    made.prepare()
    raster = SceneRaster(made.context, scene())
    for pose in (MOVED, HEAD):
        frame = made.begin_frame(pose, viewpoint(planar()))
        made.submit(raster.draw_on_gpu(frame["right"].view, str(frame.number)))
    with made.context.drawing() as ctx:
        target = ctx.simple_framebuffer(SMALL)
    compiled = programs_compiled(monkeypatch)
    for into in (None, target):
        for last in (None, MOVED):
            made.compose(into, pose_at_last_row=last)
    made.submit_overlay(np.zeros((4, 4, 4), np.uint8), device_from_quad=at(0, 0, -1))
    for into in (None, target):
        made.compose(into)
    made.compose(with_source=True).source()
    assert not compiled
    with made.context.drawing() as ctx:
        ctx.program(vertex_shader="#version 410\nvoid main() { gl_Position = vec4(0.0); }")
    assert compiled


@pytest.mark.parametrize(("channels", "is_software"), [(3, True), (1, False)], ids=["drawn", "computed"])
def test_layers_insets_and_kinds_of_frames_share_their_programs(
    compositor: Make, monkeypatch: pytest.MonkeyPatch, channels: int, is_software: bool
) -> None:
    monkeypatch.setattr(GlContext, "is_software", is_software)
    compiled = programs_compiled(monkeypatch)
    made = compositor({"right": [planar()] * channels}, context="egl")
    made.prepare(overlays=4, insets=True)
    assert any("compute_shader" in each for each in compiled) != is_software
    assert 4 < len(compiled) <= 12
    draw(made, SceneSource(made, scene()), HEAD, viewpoint(planar()))
    count = len(compiled)
    made.compose(with_source=True).source(channel=channels - 1)
    assert len(compiled) == count


def test_pictures_are_read_without_waiting_and_stay_as_they_were(made: Compositor, seen: FloatArray) -> None:
    draw(made, SceneSource(made, scene()), HEAD, seen)
    first = made.compose()
    expected, reading = first.read(), first.read_async()
    second = made.compose(pose=MOVED)
    made.finish()
    assert reading.is_ready()
    np.testing.assert_array_equal(reading.result(), expected)
    assert reading.is_ready()
    assert (second.read_async().result() != expected).any()
    rgba = np.zeros((SMALL[1], SMALL[0], 4), np.uint8)
    second.read_into(rgba)
    np.testing.assert_array_equal(rgba[..., :3], second.read())
    with made.context.drawing() as ctx:
        buffer, small = ctx.buffer(reserve=rgba.nbytes), ctx.buffer(reserve=rgba.nbytes - 4)
    second.read_into(buffer)
    with made.context.drawing():
        assert buffer.read() == rgba.tobytes()
    for target, words in (
        (small, "bytes, and"),
        (rgba[..., :3], "give a writeable array"),
        (rgba[::-1], "give a writeable array"),
        (rgba.astype(np.float32), "give a writeable array"),
        (None, "NoneType; give a writeable array"),
    ):
        with pytest.raises(BadInputError, match=words):
            second.read_into(target)
    into = made.compose(_framebuffer(made))
    for call in (into.read, into.read_async, into.status):
        with pytest.raises(BadInputError, match="composed into your framebuffer"):
            call()
    made.release()
    with pytest.raises(BadInputError, match="released"):
        made.compose()


def test_reading_back_leaves_an_adopted_context_and_no_fences_behind(
    seen: FloatArray, caller: Caller, compositor: Make, flat_image_headset: Eye
) -> None:
    made = compositor(flat_image_headset, context=caller.ctx)
    draw(made, SceneSource(made, scene()), HEAD, seen)
    frame = made.compose()
    caller.set_odd_values()
    before, expected = caller.state(), frame.read()
    fence = frame.read_async()._fence._number  # and the reading is dropped

    def is_alive(number: int) -> bool:
        return bool(caller.gl("glIsSync", number, types=[ctypes.c_void_p]))

    assert is_alive(fence)
    frame.status()
    assert not is_alive(fence)
    reading = frame.read_async()
    fence = reading._fence._number
    np.testing.assert_array_equal(reading.result(), expected)
    assert not is_alive(fence)
    unread = frame.read_async()
    fence = unread._fence._number
    assert_same(caller.state(), before)
    made.release()
    assert not is_alive(fence)


def test_pictures_on_their_way_share_three_buffers_and_stay_as_they_were(
    made: Compositor, seen: FloatArray, monkeypatch: pytest.MonkeyPatch
) -> None:
    draw(made, SceneSource(made, scene()), HEAD, seen)
    made.compose()  # makes what all frames share
    sizes, buffer = list[int](), moderngl.Context.buffer

    def spy(*given: Any, **options: Any) -> moderngl.Buffer:
        made_buffer = buffer(*given, **options)
        sizes.append(made_buffer.size)
        return made_buffer

    monkeypatch.setattr(moderngl.Context, "buffer", spy)
    expected, readings = [], []
    for k in range(8):
        frame = made.compose(pose=HEAD @ at(0.01 * k, 0, 0, np.eye(3)))
        expected.append(frame.read())
        readings.append(frame.read_async())
    for reading, picture in zip(readings, expected, strict=True):
        np.testing.assert_array_equal(reading.result(), picture)
    assert (expected[0] != expected[-1]).any()
    assert sizes == [4 * SMALL[0] * SMALL[1]] * 3


def _framebuffer(made: Compositor) -> moderngl.Framebuffer:
    with made.context.drawing() as ctx:
        return ctx.simple_framebuffer(SMALL)


def test_a_scan_from_the_bottom_turns_the_poses_of_the_rows_round(made: Any, seen: FloatArray) -> None:
    draw(made, SceneSource(made, scene()), HEAD, seen)
    upwards = made.compose(pose=HEAD, pose_at_last_row=MOVED, scan="up").read()
    np.testing.assert_array_equal(made.compose(pose=MOVED, pose_at_last_row=HEAD).read(), upwards)
    assert (made.compose(pose=HEAD, pose_at_last_row=MOVED).read() != upwards).any()
    with pytest.raises(BadInputError, match="scan is 'left'; choose from down, up"):
        made.compose(pose_at_last_row=MOVED, scan="left")


def moving(time_s: float) -> tuple[FloatArray, FloatArray]:
    """Head and pupil at a constant velocity."""
    return HEAD @ at(0.4 * time_s, 0, 0, np.eye(3)), np.array([0.05 * time_s, 0.0, 0.0])


@pytest.mark.parametrize("late_s", [0.004, 0.008, 0.015])
def test_a_pipelined_engine_is_predicted(compositor: Make, flat_image_headset: Eye, late_s: float) -> None:
    made, box = compositor(flat_image_headset), flat_image_headset.eye_box
    source, period_s = SceneSource(made, scene()), 0.011
    for k in range(4):
        time_s = period_s * k  # from the second frame on before the last frame's late pose, or after it
        head, pupil = moving(time_s)
        frame = made.begin_frame(head, box.centre + pupil, time_s=time_s, predict_s=0.02)
        due_head, due_pupil = moving(time_s + (0.02 if k else 0.0))
        np.testing.assert_allclose(frame.world_from_device, due_head, atol=1e-9)
        np.testing.assert_allclose(frame.viewpoints["right"], box.centre + due_pupil, atol=1e-9)
        source.submit(frame["right"])
        late = made.compose(pose=moving(time_s + late_s)[0], time_s=time_s + late_s, predict_s=0.005)
        np.testing.assert_allclose(late.world_from_device, moving(time_s + late_s + 0.005)[0], atol=1e-9)


def test_poses_and_pupils_are_predicted_from_the_last_two(compositor: Make, flat_image_headset: Eye) -> None:
    made, seen = compositor(flat_image_headset), flat_image_headset.eye_box.centre
    step = np.array([0.0005, 0.0, 0.0])
    half, whole = (HEAD @ at(x, 0, 0, transforms.rotation_about("y", x)) for x in (0.004, 0.008))
    first = made.begin_frame(HEAD, seen, time_s=1.0, predict_s=0.01)
    np.testing.assert_array_equal(first.world_from_device, HEAD)  # there is nothing to predict from
    second = made.begin_frame(half, seen + step, time_s=1.01, predict_s=0.01)
    np.testing.assert_allclose(second.world_from_device, whole, atol=1e-5)
    np.testing.assert_allclose(second.viewpoints["right"], seen + 2 * step, atol=1e-12)
    SceneSource(made, scene()).submit(second["right"])
    predicted = made.compose(pose=half, viewpoint=seen + step, time_s=1.01, predict_s=0.01).read()
    plain = made.compose(pose=second.world_from_device, viewpoint=second.viewpoints["right"]).read()
    np.testing.assert_array_equal(predicted, plain)
    stale = made.begin_frame(HEAD, seen, time_s=2.0, predict_s=0.1)
    np.testing.assert_array_equal(stale.world_from_device, HEAD)
    faults: tuple[tuple[Callable[[], object], str], ...] = (
        (lambda: made.begin_frame(HEAD, seen, predict_s=0.01), "predict_s needs time_s"),
        (lambda: made.begin_frame(HEAD, seen, time_s=3.0, predict_s=0.2), "^predict_s is 0.2; give a number"),
        (lambda: made.begin_frame(HEAD, seen, time_s=1.5), "time_s is 1.5 s, and that of the pose before was 2 s"),
        (lambda: made.begin_frame(HEAD, seen, time_s=np.nan), "time_s"),
        (lambda: made.compose(time_s=3.0, predict_s=0.01), "give pose as well"),
    )
    for call, words in faults:
        with pytest.raises(BadInputError, match=words):
            call()
    np.testing.assert_array_equal(made.begin_frame(HEAD, seen, time_s=1.9).world_from_device, HEAD)  # 100 ms late
    far = made.begin_frame(HEAD, seen + 8 * step, time_s=2.01, predict_s=0.1)
    np.testing.assert_allclose(far.viewpoints["right"], made.within_reach("right", seen + 88 * step), atol=1e-12)
