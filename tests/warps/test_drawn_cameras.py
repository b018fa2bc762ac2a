"""Pictures with the cameras that drew them: located anew, of both eyes in one call."""

from collections.abc import Mapping
from typing import Any

import numpy as np
import pytest
from gl_scenes import at
from numpy.typing import NDArray
from warps.composing import HEAD, SMALL, Make, scene, viewpoint

from wlr_render.draw.gl_raster import GlRaster
from wlr_render.engine import TextureLayer
from wlr_render.errors import BadInputError
from wlr_render.geometry import transforms
from wlr_render.mappings import Eye
from wlr_render.numerics.arrays import FloatArray
from wlr_render.warp.compositor import Compositor
from wlr_render.warp.eye_camera import EyeCamera
from wlr_render.warp.stored_picture import DepthKind, StoredDepth

pytestmark = pytest.mark.gl

INVERSE = StoredDepth(DepthKind.INVERSE)
NEWER = HEAD @ at(0.01, -0.004, 0.006, transforms.rotation_about("y", 0.02))
Pictures = dict[str, NDArray[Any]]


def pictures(made: Compositor, cameras: Mapping[str, EyeCamera]) -> tuple[Pictures, Pictures]:
    """Colours and inverse depths by eye."""
    raster = GlRaster(made.context, scene())
    drawn = {eye: raster.draw_on_gpu(camera.view, eye).read() for eye, camera in cameras.items()}
    return {eye: each.colour for eye, each in drawn.items()}, {eye: each.inverse_depth for eye, each in drawn.items()}


def test_a_picture_may_be_drawn_for_newer_poses_than_its_frame_began_with(made: Compositor, seen: FloatArray) -> None:
    newest = seen + [1e-3, -5e-4, 0]
    frame = made.begin_frame(NEWER, newest)
    colour, inverse = pictures(made, frame)
    made.submit(colour["right"], inverse["right"], stored=INVERSE)
    expected = made.compose().read()

    made.begin_frame(HEAD, seen)
    (located,) = made.locate_views(NEWER, newest).values()
    made.submit(colour["right"], inverse["right"], stored=INVERSE, camera=located)
    np.testing.assert_array_equal(made.compose(pose=NEWER, viewpoint=newest).read(), expected)
    made.begin_frame(HEAD, seen)
    made.submit(colour["right"], inverse["right"], stored=INVERSE)
    assert (made.compose(pose=NEWER, viewpoint=newest).read() != expected).any()


def test_views_are_located_as_a_frame_has_them_and_begin_none(compositor: Make, pair: Mapping[str, Eye]) -> None:
    made, seen = compositor(pair), {eye: viewpoint(model) for eye, model in pair.items()}
    times = {"time_s": 2.0, "predict_s": 0.01}
    made.locate_views(HEAD, seen, time_s=1.99)
    with pytest.raises(BadInputError, match="there is no frame; call begin_frame first"):
        made.compose()
    frame = made.begin_frame(NEWER, seen, **times)
    for _ in range(4):
        located = made.locate_views(NEWER, seen, **times)
    assert list(located) == ["left", "right"]
    for eye, camera in located.items():
        np.testing.assert_array_equal(camera.world_from_camera, frame[eye].world_from_camera)
        assert camera.fov_rad == frame[eye].fov_rad
    assert (
        np.abs(located["left"].world_from_camera - made.locate_views(NEWER, seen)["left"].world_from_camera).max()
        > 1e-3
    )
    colour, inverse = pictures(made, frame)
    made.submit(colour, inverse, stored=INVERSE, frame=frame)  # of the last three frames: locating counts for none
    np.testing.assert_array_equal(made.compose().world_from_device, frame.world_from_device)


@pytest.mark.parametrize("kind", ["arrays", "textures", "images"])
def test_both_eyes_in_one_call_are_those_of_two(compositor: Make, pair: Mapping[str, Eye], kind: str) -> None:
    made = compositor(pair)
    seen = {"right": viewpoint(pair["right"], 0.7, 0, 0), "left": viewpoint(pair["left"], -0.7, 0, 0)}
    colour: dict[str, Any]
    depth: dict[str, Any] | None
    colour, depth = pictures(made, made.locate_views(HEAD, seen))
    if kind == "textures":
        layers = [np.stack([each[eye][::-1] for eye in ("left", "right")]) for each in (colour, depth)]
        with made.context.drawing() as ctx:
            size = *made.plan("left").camera.size_px, 2
            arrays = (
                ctx.texture_array(size, 3, layers[0], alignment=1),
                ctx.texture_array(size, 1, layers[1], dtype="f4"),
            )
        colour, depth = ({eye: TextureLayer(each, k) for k, eye in enumerate(made.eyes)} for each in arrays)
    raster = GlRaster(made.context, scene())
    shown = []
    for together in (True, False):
        frame = made.begin_frame(HEAD, seen)
        if kind == "images":
            colour, depth = {eye: raster.draw_on_gpu(camera.view, eye) for eye, camera in frame.items()}, None
        given = {"stored": INVERSE}
        if together:
            made.submit(colour, depth, camera=frame, **given)
        else:
            for eye in ("right", "left"):
                made.submit(colour[eye], depth and depth[eye], eye=eye, **given)
        composed = made.compose(pose=NEWER)
        shown.append(np.stack([composed.read(eye) for eye in made.eyes]))
    np.testing.assert_array_equal(shown[0], shown[1])
    assert (shown[0][0] != shown[0][1]).any()


def test_insets_belong_to_the_camera_that_drew_the_picture(compositor: Make, flat_image_headset: Eye) -> None:
    made, seen = compositor(flat_image_headset, resolution=0.5), viewpoint(flat_image_headset)
    frame = made.begin_frame(HEAD, seen)
    located = made.locate_views(NEWER, seen)
    colour, inverse = pictures(made, located)
    made.submit(colour, inverse, stored=INVERSE, camera=located)
    angles = tuple(0.5 * angle for angle in located["right"].fov_rad)
    old, new = (cameras["right"].inset(angles, SMALL) for cameras in (frame, located))
    sharp = np.full((*SMALL[::-1], 3), 200, np.uint8)
    with pytest.raises(BadInputError, match="make it with `inset` of the camera that drew the eye's picture"):
        made.submit(sharp, camera=old)
    before = made.compose().read()
    made.submit(sharp, camera=new)
    assert (made.compose().read() != before).any()


def test_pictures_and_cameras_that_do_not_belong_together_are_refused_in_a_sentence(
    compositor: Make, pair: Mapping[str, Eye]
) -> None:
    made, seen = compositor(pair), {eye: viewpoint(model) for eye, model in pair.items()}
    frame = made.begin_frame(HEAD, seen)
    colour, inverse = pictures(made, frame)
    one, beside = colour["left"], inverse["left"]
    faults: tuple[tuple[Any, Any, dict[str, Any], str], ...] = (
        (
            colour,
            inverse,
            {"eye": "left"},
            "eye is 'left', and the colours are given for left, right; give it by eye too",
        ),
        (colour, beside, {}, "depth is .* give it by eye too, or leave it out"),
        (colour, {"left": beside}, {}, "depth is .* give it by eye too"),
        (colour, inverse, {"camera": frame["left"]}, "camera is .* give it by eye too"),
        ({"middle": one}, {"middle": beside}, {}, "an eye of the pictures is 'middle'; choose from left, right"),
        ({}, {}, {}, "no picture"),
        (one, beside, {}, "there are two eyes; name one of left, right with eye="),
        (
            one,
            beside,
            {"camera": frame["left"], "eye": "right"},
            "the camera is of the left eye, and the picture of the",
        ),
        (one, beside, {"camera": HEAD, "eye": "left"}, "give what begin_frame, locate_views or EyeCamera.inset"),
        ({"left": one[1:], "right": one}, inverse, {}, "the camera"),
    )
    for given, depth, named, words in faults:
        with pytest.raises(BadInputError, match=words):
            made.submit(given, depth, stored=INVERSE, **named)
    with pytest.raises(BadInputError, match="the camera"):
        made.submit({"right": one[1:], "left": one}, inverse, stored=INVERSE)
    made.compose(eyes=("left",))
    with pytest.raises(BadInputError, match="the right eye has not been submitted"):
        made.compose()
    made.begin_frame(HEAD, {"left": seen["left"]})
    with pytest.raises(BadInputError, match="the right eye has no camera in this frame"):
        made.submit(colour, inverse, stored=INVERSE)
