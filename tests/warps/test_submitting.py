"""However a picture is handed over, the same frame comes out."""

from collections.abc import Callable
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from gl_scenes import at
from numpy.typing import NDArray
from warps.composing import HEAD, Make, draw, scene, viewpoint

from benchmarks.scene_source import SceneSource
from wlr_render.draw.gl_raster import GlRaster
from wlr_render.errors import BadInputError
from wlr_render.geometry.pinhole import Pinhole
from wlr_render.gl.context import GlContext
from wlr_render.mappings import Eye
from wlr_render.numerics.arrays import Float32Array, FloatArray
from wlr_render.warp.compositor import Compositor
from wlr_render.warp.stored_picture import DepthKind, Rows, StoredDepth

pytestmark = pytest.mark.gl

INVERSE = StoredDepth(DepthKind.INVERSE)
WINDOW, REVERSED = StoredDepth(DepthKind.WINDOW, 0.1, 5.0), StoredDepth(DepthKind.WINDOW, np.inf, 0.1)
TURNED = HEAD @ at(0.02, 0, 0)  # so that depth tells where things go


def buffered(inverse: Float32Array, stored: StoredDepth) -> Float32Array:
    """What a depth buffer holds; the far plane's value for nothing."""
    at_0, at_1 = stored.inverse_of_0_and_1
    return np.where(inverse > 0, (inverse - at_0) / (at_1 - at_0), 0 if at_0 < at_1 else 1).astype(np.float32)


def bad_arrays(size: tuple[int, int]) -> tuple[tuple[tuple[Any, ...], str], ...]:
    width, height = size
    colour, depth = np.zeros((height, width, 3), np.uint8), np.ones((height, width), np.float32)
    near, below = depth.copy(), depth.copy()
    near[3, 4], below[2, 1] = 1e-20, -1.0
    return (
        ((colour[1:], depth), "camera"),
        ((colour, depth[:, 1:]), "camera"),
        ((colour.transpose(1, 0, 2), depth), "camera"),
        ((colour / 255, depth), "uint8"),
        ((colour[..., 0], depth), "uint8"),
        ((colour, depth.astype(np.float64)), "float32"),
        ((colour, depth[..., None]), "float32"),
        ((colour, near), "row 3, column 4"),
        ((colour, below), "row 2, column 1"),
        ((colour,), "ndarray and a NoneType"),
        ((colour, 1.0), "ndarray and a float"),
        ((None,), "NoneType"),
        (([1, 2], depth), "list"),
        ((True,), "bool"),
    )


def test_a_picture_that_is_none_is_told_in_a_sentence_and_the_right_one_is_taken_then(
    made: Compositor, flat_image_headset: Eye
) -> None:
    source, seen = SceneSource(made, scene()), viewpoint(flat_image_headset)
    (camera,) = draw(made, source, HEAD, seen).values()
    expected = made.compose().read()
    (camera,) = made.begin_frame(HEAD, seen).values()
    for given, words in bad_arrays(camera.size_px):
        with pytest.raises(BadInputError, match=words):
            made.submit(*given)
    np.testing.assert_array_equal(made.compose().read(), expected)
    source.submit(camera)
    np.testing.assert_array_equal(made.compose().read(), expected)


def test_a_gpu_picture_of_elsewhere_is_told_in_a_sentence(
    compositor: Make, flat_image_headset: Eye, gl_context: GlContext
) -> None:
    made = compositor(flat_image_headset, context="egl")
    seen, raster = viewpoint(flat_image_headset), GlRaster(made.context, scene())
    (camera,) = made.begin_frame(HEAD, seen).values()
    elsewhere = GlRaster(gl_context, scene()).draw_on_gpu(camera.view)
    with gl_context.drawing() as ctx:
        foreign = ctx.simple_framebuffer(camera.size_px)
    image = raster.draw_on_gpu(camera.view)
    width, height = camera.size_px
    alike = Pinhole(width, height, camera.view.camera.tangent_min, camera.view.camera.tangent_max * 1.01)
    for given, words in (
        ((elsewhere,), "another context"),
        ((raster.draw_on_gpu(type(camera.view)(alike, seen, HEAD), "other"),), "another camera"),
        ((foreign,), "another ModernGL context"),
        ((image.colour,), "Texture and a NoneType"),
        ((image.colour, np.ones(camera.size_px[::-1], np.float32)), "Texture and a ndarray"),
        ((image.colour, elsewhere.inverse_depth), "another ModernGL context"),
        ((0,), "is not a framebuffer object"),
        ((4321,), "is not a framebuffer object"),
        ((2**32 + int(image.colour.glo),), "is not a framebuffer object"),
    ):
        with pytest.raises(BadInputError, match=words):
            made.submit(*given)
    made.submit(image)
    assert made.compose().read().std() > 5


def test_a_picture_that_overwrote_the_other_eyes_is_refused(compositor: Make, flat_image_headset: Eye) -> None:
    models = {"left": replace(flat_image_headset, eye="left"), "right": flat_image_headset}
    made, seen = compositor(models, context="egl"), viewpoint(flat_image_headset)
    raster = GlRaster(made.context, scene())
    cameras = made.begin_frame(HEAD, dict.fromkeys(models, seen))
    made.submit(raster.draw_on_gpu(cameras["left"].view), eye="left")
    with pytest.raises(BadInputError, match="has overwritten the other eye's"):
        made.submit(raster.draw_on_gpu(cameras["right"].view), eye="right")
    made.submit(raster.draw_on_gpu(cameras["right"].view, "right"), eye="right")
    assert made.compose().read("right").std() > 5


def test_an_engine_may_write_over_what_it_has_submitted(made: Compositor, seen: FloatArray) -> None:
    (camera,) = made.begin_frame(HEAD, seen).values()
    shape = camera.size_px[::-1]
    color, depth = np.full((*shape, 3), 90, np.uint8), np.full(shape, 2.0, np.float32)
    made.submit(color, depth)
    color[:], depth[:] = 0, 0.5
    assert np.median(made.compose().read()) == 90


def test_words_do_not_stand_for_kinds_and_rows(made: Compositor, seen: FloatArray) -> None:
    (camera,) = made.begin_frame(HEAD, seen).values()
    shape = camera.size_px[::-1]
    given = np.zeros((*shape, 3), np.uint8), np.ones(shape, np.float32)
    for wrong in (
        {"rows": "TOP_FIRST"},
        {"stored": "metres"},
        {"stored_colour": "linear"},
        {"stored": DepthKind.WINDOW},
    ):
        with pytest.raises(BadInputError, match="a StoredDepth, stored_colour a StoredColour, and rows one of"):
            made.submit(*given, **wrong)
    no_kind: Any = "WINDOW"
    with pytest.raises(BadInputError, match="'WINDOW' is not a kind of depth"):
        StoredDepth(no_kind, 0.05, np.inf)


@pytest.mark.parametrize("stored", [StoredDepth(), INVERSE, WINDOW, REVERSED], ids=lambda stored: stored.kind.name)
def test_a_depth_that_is_no_number_is_background_and_changes_only_its_neighbourhood(
    made: Compositor, seen: FloatArray, stored: StoredDepth
) -> None:
    source = SceneSource(made, scene())
    (camera,) = draw(made, source, HEAD, seen).values()
    image = source.read(camera.view)
    depths: dict[DepthKind, Callable[[], NDArray[Any]]] = {
        DepthKind.METRES: lambda: 1 / image.inverse_depth,
        DepthKind.INVERSE: image.inverse_depth.copy,
        DepthKind.WINDOW: lambda: buffered(image.inverse_depth, stored),
    }
    depth = depths[stored.kind]()
    row, column = depth.shape[0] // 2, depth.shape[1] // 2
    wrong = [np.nan] if stored.kind is DepthKind.WINDOW else [np.nan, np.inf]
    nothing = 0.0 if stored.kind is not DepthKind.WINDOW else stored.nothing

    def source_with(value: Float32Array | float, pixels: tuple[slice, slice]) -> Float32Array:
        spoilt = depth.copy()
        spoilt[pixels] = value
        made.begin_frame(HEAD, seen)
        made.submit(image.colour, spoilt, stored=stored)
        return np.asarray(made.compose(pose=TURNED, with_source=True).source())

    hole = np.s_[row : row + 3, column : column + 3]
    everywhere = np.s_[:, :]
    sound, expected = source_with(depth[hole], hole), source_with(nothing, hole)
    moved = np.linalg.norm(expected - sound, axis=-1) > 0.01
    assert 0 < moved.sum() < 60
    for value in wrong:
        np.testing.assert_array_equal(source_with(value, hole), expected)
        np.testing.assert_array_equal(source_with(value, everywhere), source_with(nothing, everywhere))


def test_depths_that_are_no_distance_are_refused(made: Compositor, seen: FloatArray) -> None:
    (camera,) = made.begin_frame(HEAD, seen).values()
    shape = camera.size_px[::-1]
    for stored, sound, values in (
        (StoredDepth(), 1.0, [-0.5, -np.inf, 9e-5, 1e-40]),
        (INVERSE, 1.0, [-0.5, -np.inf, 1.1e4, 1e38]),
        (WINDOW, 0.5, [-0.1, 1.001, np.inf, -np.inf, 2.0]),
    ):
        for value in values:
            depth = np.full(shape, sound, np.float32)
            depth[5, 7] = value
            with pytest.raises(BadInputError, match=f"row 5, column 7 is .* depths in {stored.kind.name} run from"):
                made.submit(np.zeros((*shape, 3), np.uint8), depth, stored=stored)
    for planes in ((1e-9, 5.0), ("0.1", 5.0), (0.1, None), (True, 5.0), (-np.inf, 1.0)):
        with pytest.raises(BadInputError, match="two different positive distances"):
            StoredDepth(DepthKind.WINDOW, *planes)
    for distances in ((0.1, 5.0), (0.0, np.inf, 0.0, 0.5)):
        with pytest.raises(BadInputError, match=r"with DepthKind.WINDOW only"):
            StoredDepth(DepthKind.METRES, *distances)
    for ends in ((0.5, 0.5), (1.0, 0.0), (-0.1, 1.0), (0.0, 1.1), (0.0, np.nan), (False, True)):
        with pytest.raises(BadInputError, match="the smaller and the larger end of the depth range"):
            StoredDepth(DepthKind.WINDOW, 0.1, 5.0, *ends)


def test_depths_in_textures_that_are_no_distance_are_background(compositor: Make, flat_image_headset: Eye) -> None:
    made, seen = compositor(flat_image_headset, context="egl"), viewpoint(flat_image_headset)
    source = SceneSource(made, scene())
    (camera,) = draw(made, source, HEAD, seen).values()
    image = source.read(camera.view)

    def composed(stored: StoredDepth, sound: float, value: float) -> Float32Array:
        depth = np.full(camera.size_px[::-1], sound, np.float32)
        depth[20:40, 30:60] = value
        with made.context.drawing() as ctx:
            textures = (
                ctx.texture(camera.size_px, 3, np.ascontiguousarray(image.colour), alignment=1),
                ctx.texture(camera.size_px, 1, depth, dtype="f4"),
            )
        made.begin_frame(HEAD, seen)
        made.submit(*textures, stored=stored, rows=Rows.TOP_FIRST)
        return np.asarray(made.compose(pose=TURNED, with_source=True).source())

    for stored, sound, nothing, values in (
        (StoredDepth(), 0.5, 0.0, [np.nan, np.inf, -1.0, 1e-20]),
        (INVERSE, 2.0, 0.0, [np.nan, np.inf, -1.0, 1e30]),
        (WINDOW, 0.8, 1.0, [np.nan, np.inf, -1.0, 1.5]),
    ):
        expected = composed(stored, sound, nothing)
        assert (expected != composed(stored, sound, sound)).any()
        for value in values:
            np.testing.assert_array_equal(composed(stored, sound, value), expected)


@pytest.mark.parametrize("on_gpu", [False, True])
def test_pull_maps_of_colours_are_those_of_their_own_picture(
    compositor: Make, flat_image_headset: Eye, on_gpu: bool
) -> None:
    made = compositor({"right": [flat_image_headset] * 3})
    source, seen = SceneSource(made, scene()), viewpoint(flat_image_headset)

    def submit(pose: FloatArray, depth_m: float) -> None:
        (camera,) = made.begin_frame(pose, seen).values()
        if on_gpu:
            source.submit(camera)
        else:
            size = camera.size_px[::-1]
            made.submit(np.zeros((*size, 3), np.uint8), np.full(size, depth_m, np.float32))

    submit(HEAD, 2.0)
    frame = made.compose(pose=TURNED, with_source=True)
    maps = [frame.source(channel=channel) for channel in (None, 0, 1, 2)]
    for each in maps[1:]:  # three equal models
        np.testing.assert_allclose(each, maps[0], atol=1e-3)
    submit(TURNED, 0.3)
    np.testing.assert_array_equal(frame.source(), maps[0])
    for channel in (0, 2):
        with pytest.raises(BadInputError, match=r"right eye's picture, .*; read them before the next submit"):
            frame.source(channel=channel)
    assert made.compose(with_source=True).source(channel=0).shape == maps[1].shape
