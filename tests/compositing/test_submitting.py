"""However a picture is handed over, the same frame comes out."""

from dataclasses import replace

import numpy as np
import pytest
from composing import CONTEXTS, HEAD, draw, scene, viewpoint
from gl_scenes import at

from benchmarks.scene_source import SceneSource
from wlr_render.errors import BadInputError
from wlr_render.geometry.pinhole import Pinhole
from wlr_render.rendering.gl_raster import GlRaster
from wlr_render.rendering.stored_picture import DepthKind, Rows, StoredDepth

INVERSE = StoredDepth(DepthKind.INVERSE)
WINDOW, REVERSED = StoredDepth(DepthKind.WINDOW, 0.1, 5.0), StoredDepth(DepthKind.WINDOW, np.inf, 0.1)
TURNED = HEAD @ at(0.02, 0, 0)  # so that depth tells where things go


def buffered(inverse, stored):
    """What a depth buffer holds; the far plane's value for nothing."""
    at_0, at_1 = stored.inverse_of_0_and_1
    return np.where(inverse > 0, (inverse - at_0) / (at_1 - at_0), 0 if at_0 < at_1 else 1).astype(np.float32)


def arrays(image):
    """Forms of two arrays: what `submit` is called with."""
    with np.errstate(divide="ignore"):
        infinite = 1 / image.inverse_depth
    metres = np.where(np.isinf(infinite), np.float32(0), infinite)
    transparent = np.dstack([image.colour, np.zeros_like(image.colour[..., :1])])
    return {
        "metres": ((image.colour, metres), {}),
        "metres, nothing infinite": ((image.colour, infinite), {}),
        "inverse": ((image.colour, image.inverse_depth), {"stored": INVERSE}),
        "window": ((image.colour, buffered(image.inverse_depth, WINDOW)), {"stored": WINDOW}),
        "reversed": ((image.colour, buffered(image.inverse_depth, REVERSED)), {"stored": REVERSED}),
        "with alpha": ((transparent, metres), {}),
        "bottom row first": ((image.colour[::-1], metres[::-1]), {"rows": Rows.BOTTOM_FIRST}),
        "read only": (tuple(np.broadcast_to(each, each.shape) for each in (image.colour, metres)), {}),
    }


@pytest.mark.parametrize("context", CONTEXTS)
def test_arrays_of_all_kinds(compositor, flat_image_headset, context):
    made = compositor(flat_image_headset, context=context)
    source, seen = SceneSource(made, scene(wall=False)), viewpoint(flat_image_headset)
    (camera,) = draw(made, source, HEAD, seen).values()
    expected, image = made.compose(pose=TURNED, with_source=True).source(), source.read(camera.view)
    for name, (given, how) in arrays(image).items():
        made.begin_frame(HEAD, seen)
        made.submit(*given, **how)
        moved = np.linalg.norm(made.compose(pose=TURNED, with_source=True).source() - expected, axis=-1)
        # Depths are rounded otherwise: at an edge a pixel may change sides.
        assert (moved > 0.01).mean() < 0.01, name


@pytest.mark.gl
def test_everything_that_lies_on_the_gpu(compositor, flat_image_headset):
    made = compositor(flat_image_headset, context="egl")
    raster, seen = GlRaster(made.context, scene()), viewpoint(flat_image_headset)
    (camera,) = made.begin_frame(HEAD, seen).values()
    image = raster.draw_on_gpu(camera.view)
    made.submit(image)
    expected, picture = made.compose().read(), image.read()
    window = ((picture.inverse_depth - 10) / (1 / 5.0 - 10)).astype(np.float32)[::-1]
    upward = np.ascontiguousarray(picture.colour[::-1])
    with made.context.drawing() as ctx:
        colour = ctx.texture(camera.size_px, 3, upward, alignment=1)
        depth = ctx.depth_texture(camera.size_px, np.ascontiguousarray(window))
        framebuffer = ctx.framebuffer([colour], depth)
    for given, how in (
        ((image.colour, image.inverse_depth), {"stored": INVERSE, "rows": Rows.TOP_FIRST}),
        ((colour, depth), {"stored": WINDOW}),
        ((framebuffer,), {"stored": WINDOW}),
        ((framebuffer.glo,), {"stored": WINDOW}),
        ((np.uint32(framebuffer.glo),), {"stored": WINDOW}),
    ):
        made.begin_frame(HEAD, seen)
        made.submit(*given, **how)
        difference = np.abs(made.compose().read().astype(int) - expected)
        assert (difference > 1).mean() < 0.002


def bad_arrays(size):
    width, height = size
    colour, depth = np.zeros((height, width, 3), np.uint8), np.ones((height, width), np.float32)
    holed, below = depth.copy(), depth.copy()
    holed[3, 4], below[2, 1] = np.nan, -1.0
    return (
        ((colour[1:], depth), "camera"),
        ((colour, depth[:, 1:]), "camera"),
        ((colour.transpose(1, 0, 2), depth), "camera"),
        ((colour / 255, depth), "uint8"),
        ((colour[..., 0], depth), "uint8"),
        ((colour, depth.astype(np.float64)), "float32"),
        ((colour, depth[..., None]), "float32"),
        ((colour, holed), "row 3, column 4"),
        ((colour, below), "row 2, column 1"),
        ((colour,), "ndarray and a NoneType"),
        ((colour, 1.0), "ndarray and a float"),
        ((None,), "NoneType"),
        (([1, 2], depth), "list"),
    )


@pytest.mark.parametrize("context", CONTEXTS)
def test_a_picture_that_is_none_is_told_in_a_sentence_and_the_right_one_is_taken_then(
    compositor, flat_image_headset, context
):
    made = compositor(flat_image_headset, context=context)
    source, seen = SceneSource(made, scene()), viewpoint(flat_image_headset)
    (camera,) = draw(made, source, HEAD, seen).values()
    expected = made.compose().read()
    (camera,) = made.begin_frame(HEAD, seen).values()
    for given, words in bad_arrays(camera.size_px):
        with pytest.raises(BadInputError, match=words):
            made.submit(*given)
    with pytest.raises(BadInputError, match="submit every eye"):
        made.compose()
    source.submit(camera)
    np.testing.assert_array_equal(made.compose().read(), expected)


@pytest.mark.gl
def test_a_gpu_picture_of_elsewhere_is_told_in_a_sentence(compositor, flat_image_headset, gl_context):
    made, on_cpu = (compositor(flat_image_headset, context=context) for context in ("egl", "cpu"))
    seen, raster = viewpoint(flat_image_headset), GlRaster(made.context, scene())
    (camera,) = made.begin_frame(HEAD, seen).values()
    elsewhere = GlRaster(gl_context, scene()).draw_on_gpu(camera.view)
    with gl_context.drawing() as ctx:
        foreign = ctx.simple_framebuffer(camera.size_px)
    image = raster.draw_on_gpu(camera.view)
    alike = Pinhole(*camera.size_px, camera.view.camera.tangent_min, camera.view.camera.tangent_max * 1.01)
    for given, words in (
        ((elsewhere,), "another context"),
        ((raster.draw_on_gpu(type(camera.view)(alike, seen, HEAD), "other"),), "another camera"),
        ((foreign,), "another ModernGL context"),
        ((image.colour,), "Texture and a NoneType"),
        ((image.colour, np.ones(camera.size_px[::-1], np.float32)), "Texture and a ndarray"),
        ((image.colour, elsewhere.inverse_depth), "another ModernGL context"),
        ((0,), "not a framebuffer object"),
        ((4321,), "not a framebuffer object"),
    ):
        with pytest.raises(BadInputError, match=words):
            made.submit(*given)
    made.submit(image)
    assert made.compose().read().std() > 5
    on_cpu.begin_frame(HEAD, seen)
    with pytest.raises(BadInputError, match=r"GpuImage .* without OpenGL"):
        on_cpu.submit(image)


@pytest.mark.gl
def test_a_picture_that_overwrote_the_other_eyes_is_refused(compositor, flat_image_headset):
    models = {"left": replace(flat_image_headset, eye="left"), "right": flat_image_headset}
    made, seen = compositor(models, context="egl"), viewpoint(flat_image_headset)
    raster = GlRaster(made.context, scene())
    cameras = made.begin_frame(HEAD, dict.fromkeys(models, seen))
    made.submit(raster.draw_on_gpu(cameras["left"].view), eye="left")
    with pytest.raises(BadInputError, match="has overwritten the other eye's"):
        made.submit(raster.draw_on_gpu(cameras["right"].view), eye="right")
    made.submit(raster.draw_on_gpu(cameras["right"].view, "right"), eye="right")
    assert made.compose().read("right").std() > 5


@pytest.mark.parametrize("context", CONTEXTS)
def test_an_engine_may_write_over_what_it_has_submitted(compositor, flat_image_headset, context):
    made, seen = compositor(flat_image_headset, context=context), viewpoint(flat_image_headset)
    (camera,) = made.begin_frame(HEAD, seen).values()
    shape = camera.size_px[::-1]
    color, depth = np.full((*shape, 3), 90, np.uint8), np.full(shape, 2.0, np.float32)
    made.submit(color, depth)
    color[:], depth[:] = 0, 0.5
    assert np.median(made.compose().read()) == 90


@pytest.mark.parametrize("context", CONTEXTS)
def test_words_do_not_stand_for_kinds_and_rows(compositor, flat_image_headset, context):
    made, seen = compositor(flat_image_headset, context=context), viewpoint(flat_image_headset)
    (camera,) = made.begin_frame(HEAD, seen).values()
    shape = camera.size_px[::-1]
    given = np.zeros((*shape, 3), np.uint8), np.ones(shape, np.float32)
    for wrong in ({"rows": "TOP_FIRST"}, {"stored": "metres"}, {"stored": DepthKind.WINDOW}):
        with pytest.raises(BadInputError, match="must be a StoredDepth, and rows one of Rows"):
            made.submit(*given, **wrong)
    with pytest.raises(BadInputError, match="'WINDOW' is not a kind of depth"):
        StoredDepth("WINDOW", 0.05, np.inf)


@pytest.mark.gl
def test_pictures_larger_than_opengl_takes_are_refused_at_once(compositor, flat_image_headset):
    for size in ((10**6, 20), (20, 10**6)):
        with pytest.raises(BadInputError, match="and OpenGL takes"):
            compositor(flat_image_headset, size=size, context="egl")
