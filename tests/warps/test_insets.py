"""Insets: sharp pictures of a part of an eye's field over a wide one, without a seam."""

from collections.abc import Mapping
from typing import Any

import moderngl
import numpy as np
import pytest
from gl_scenes import at
from present import narrowed
from warps.composing import HEAD, Make, clear_of_edges, planar, programs_compiled, scene, traced, viewpoint

from wlr_render.draw.gl_raster import GlRaster
from wlr_render.draw.ray_tracing import RayRenderer
from wlr_render.errors import BadInputError
from wlr_render.geometry import transforms
from wlr_render.mappings import Eye
from wlr_render.numerics.arrays import Float32Array, FloatArray
from wlr_render.numerics.srgb import encode_srgb
from wlr_render.warp.composed_frame import ComposedFrame
from wlr_render.warp.compositor import Compositor
from wlr_render.warp.eye_camera import EyeCamera
from wlr_render.warp.panel_light import PanelLight
from wlr_render.warp.picture_import import BORDER
from wlr_render.warp.stored_picture import DepthKind, Rows, StoredColour, StoredDepth

pytestmark = pytest.mark.gl

SIZE = 120, 100
LINEAR, INVERSE = StoredColour("linear"), StoredDepth(DepthKind.INVERSE)
FLOATS = PanelLight("linear", bits=16)
LATER = HEAD @ at(0.02, -0.01, 0.01, transforms.rotation_about("y", 0.01))
RESOLUTION, SHARPER = 0.5, 4  # of the wide picture; pixels of the inset for each of its
CLOSE_PX = 0.1  # the depths of both pictures, and where their rays meet them, are not the same to the last bit


def begun(
    compositor: Make, model: Eye | Mapping[str, list[Eye]], resolution: float = RESOLUTION, **options: Any
) -> tuple[Compositor, EyeCamera]:
    """A compositor and the camera of its first frame; its pictures are wide, or as sharp as the insets."""
    made = compositor(model, SIZE, resolution=resolution, **options)
    return made, made.begin_frame(HEAD, viewpoint(planar()))["right"]


def inset_of(camera: EyeCamera, share: float = 0.4, sharper: int = SHARPER) -> EyeCamera:
    """An inset beside the middle that covers this share of a picture's width and height."""
    left, right, up, down = np.tan(camera.fov_rad)
    x, y = 0.55 * left + 0.45 * right, 0.45 * up + 0.55 * down
    half = 0.5 * share * np.array([right - left, up - down])
    fov_rad = np.arctan([x - half[0], x + half[0], y + half[1], y - half[1]])
    size = (sharper * np.tan(fov_rad)[[1, 2]] - sharper * np.tan(fov_rad)[[0, 3]]) * camera.focal_px
    return camera.inset(tuple(fov_rad), tuple(np.ceil(size).astype(int)))


def picture(camera: EyeCamera) -> tuple[Float32Array, Float32Array]:
    """Light of fine waves, (height, width, 3) float32, and the inverse depth of a slanted wall."""
    x, y = np.moveaxis(camera.view.camera.pixel_centre_tangents(), -1, 0)
    waves = [0.5 + 0.3 * np.sin(90 * x + k) * np.cos(70 * y - k) for k in range(3)]
    return np.stack(waves, axis=-1).astype(np.float32), (0.8 + 0.5 * x - 0.3 * y).astype(np.float32)


def submit(made: Compositor, camera: EyeCamera, inset: EyeCamera | None = None, **given: Any) -> None:
    made.submit(*picture(inset or camera), stored=INVERSE, stored_colour=LINEAR, camera=inset, **given)


def share_of_inset(frame: ComposedFrame, camera: EyeCamera, inset: EyeCamera) -> FloatArray:
    """(height, width): how much of the inset each pixel of a frame should show, from 0 outside it to 1."""
    source = camera.view.camera.tangents_of_pixel(frame.source().astype(np.float64))
    pixel, size = inset.view.camera.pixel_of_tangents(source), np.array(inset.size_px)
    to_edge = (np.minimum(pixel, size - pixel) - 0.5).min(axis=-1)
    part = np.clip(to_edge / (BORDER * min(inset.size_px)), 0, 1)
    return np.where(to_edge < -CLOSE_PX, -1.0, part * part * (3 - 2 * part))


@pytest.mark.slow
@pytest.mark.parametrize("kind", ["one", "three", "rolling"])
def test_inside_it_is_sharp_outside_wide_and_between_there_is_no_seam(compositor: Make, kind: str) -> None:
    models = {"right": [planar()] * 3} if kind == "three" else planar()
    (wide, camera), (sharp, sharp_camera) = (
        begun(compositor, models, each * RESOLUTION, panel=FLOATS) for each in (1, SHARPER)
    )
    newest: dict[str, Any] = {"pose": LATER} | (
        {"pose_at_last_row": LATER @ at(0.004, 0, 0)} if kind == "rolling" else {}
    )
    submit(sharp, sharp_camera)
    as_sharp = sharp.compose(**newest).read().astype(np.float64)
    submit(wide, camera)
    frame = wide.compose(**newest, with_source=True)
    as_wide, inset = frame.read().astype(np.float64), inset_of(camera)
    share = share_of_inset(frame, camera, inset)[..., None]
    submit(wide, camera, inset)
    frame = wide.compose(**newest, with_source=True)
    shown = frame.read().astype(np.float64)

    blur = np.abs(as_sharp - as_wide)
    assert np.percentile(blur, 90) > 0.02
    np.testing.assert_array_equal(shown[share[..., 0] < 0], as_wide[share[..., 0] < 0])
    inside = share[..., 0] == 1
    assert inside.mean() > 0.05
    # As sharp as the sharp picture, whose pixels lie elsewhere: each is linear between its pixels.
    light, _ = picture(inset)
    bends = sum(np.abs(np.diff(light, 2, axis=axis)).max() for axis in (0, 1)) / 8
    assert bends < 0.25 * np.percentile(blur, 90)
    assert np.abs(shown - as_sharp)[inside].max() < 2 * bends + 2**-10
    # Between, what both show, in the share that the place has; the wide picture's bends are resampled with finer steps.
    between = (share[..., 0] >= 0) & ~inside
    assert between.mean() > 0.03
    mixed = (1 - share) * as_wide + share * as_sharp
    kinks = sum(np.abs(np.diff(picture(camera)[0], 2, axis=axis)).max() for axis in (0, 1)) / (4 * SHARPER)
    assert np.abs(shown - mixed)[between].max() < kinks + 2 * bends + 2**-10
    # So a step across the inset's border is a step of the wide picture, but for the share at one pixel within it.
    for axis in (0, 1):
        crosses = np.diff(share[..., 0] < 0, axis=axis)
        assert crosses.sum() > 20
        extra = np.abs(np.diff(shown - as_wide, axis=axis))[crosses]
        nearest = np.maximum(*(np.take(share[..., 0], range(k, share.shape[axis] - 1 + k), axis) for k in (0, 1)))
        assert extra.max() < nearest[crosses].max() * blur.max() + kinks
    assert not np.isnan(frame.source()).any()
    assert np.abs(share_of_inset(frame, camera, inset) - share[..., 0])[share[..., 0] >= 0].max() < 0.02


def test_edges_are_as_sharp_as_the_insets_depth(compositor: Make) -> None:
    model, renderer = planar(), RayRenderer(scene())
    truth = traced(model, SIZE, viewpoint(model), LATER, renderer)
    (wide, camera), (sharp, sharp_camera) = (begun(compositor, model, each * RESOLUTION) for each in (1, SHARPER))
    inset, rasters = inset_of(camera, 0.6), [GlRaster(made.context, scene()) for made in (wide, sharp)]
    sharp.submit(rasters[1].draw_on_gpu(sharp_camera.view))
    wide.submit(rasters[0].draw_on_gpu(camera.view, "wide"))
    frame = wide.compose(pose=LATER, with_source=True)
    inside = share_of_inset(frame, camera, inset) == 1
    shown = {"wide": frame.read(), "sharp": sharp.compose(pose=LATER).read()}
    wide.submit(rasters[0].draw_on_gpu(inset.view, "inset"), camera=inset)
    shown["inset"] = wide.compose(pose=LATER).read()
    wrong = {
        name: (np.abs(each.astype(int) - truth.colour).max(axis=-1) > 12)[inside].mean() for name, each in shown.items()
    }
    assert inside.mean() > 0.1
    assert wrong["wide"] > 0.015
    assert wrong["inset"] < 0.5 * wrong["wide"]
    assert wrong["inset"] < 1.25 * wrong["sharp"] + 0.001
    eye = transforms.apply(LATER, viewpoint(model))
    clear = clear_of_edges(truth, renderer, eye, camera.view.position_in_world, LATER, 3) & inside
    assert clear.mean() > 0.05
    assert np.abs(shown["inset"].astype(int) - truth.colour)[clear].max() <= 3


def test_an_inset_in_an_inset_and_frames_without(compositor: Make) -> None:
    made, camera = begun(compositor, planar(), panel=FLOATS)
    middle = inset_of(camera, 0.6, 2)
    fovea = inset_of(middle, 0.5, 2)
    submit(made, camera)
    alone = made.compose(pose=LATER).read()
    submit(made, camera, middle)
    with_middle = made.compose(pose=LATER).read()
    submit(made, camera, fovea)
    frame = made.compose(pose=LATER, with_source=True)
    both, within = frame.read(), share_of_inset(frame, camera, fovea)
    np.testing.assert_array_equal(both[within < 0], with_middle[within < 0])
    assert (both != with_middle)[within > 0.5].mean() > 0.9
    assert (with_middle != alone).any()
    made.begin_frame(HEAD, viewpoint(planar()))
    np.testing.assert_array_equal(made.compose(pose=LATER).read(), both)  # a missed frame is shown again
    again = made.begin_frame(HEAD, viewpoint(planar()))["right"]
    submit(made, again)
    np.testing.assert_array_equal(made.compose(pose=LATER).read(), alone)
    submit(made, again, inset_of(again, 0.6, 2))
    np.testing.assert_array_equal(made.compose(pose=LATER).read(), with_middle)


def test_an_inset_without_depth_has_that_of_the_picture_around_it(compositor: Make) -> None:
    made, camera = begun(compositor, planar(), panel=FLOATS)
    inset = inset_of(camera)
    submit(made, camera)
    submit(made, camera, inset)
    expected = made.compose(pose=LATER).read().astype(np.float64)
    again = made.begin_frame(HEAD, viewpoint(planar()))["right"]
    submit(made, again)
    made.submit(picture(inset)[0], camera=inset_of(again), stored_colour=LINEAR)
    shared = made.compose(pose=LATER).read()
    assert (shared != expected).any()
    # The depth is off by half a pixel of the wide picture at most, which moves the wall's light by so much.
    shift_px = inset.focal_px[0] * 0.03 * 0.5 * (0.5 + 0.3) / camera.focal_px[0]
    slope = np.abs(np.diff(picture(inset)[0], axis=1)).max()
    assert np.abs(shared - expected).max() < 2 * shift_px * slope + 2**-9


def test_an_inset_texture_without_depth_has_no_border(compositor: Make) -> None:
    """The picture around it is linear light, which no sampler for codes may read."""
    made, camera = begun(compositor, planar(), context="egl")
    inset = inset_of(camera)
    with made.context.drawing() as ctx:
        grey = [
            ctx.texture(each.size_px, 4, np.full((*each.size_px[::-1], 4), 70, np.uint8)) for each in (camera, inset)
        ]
        depth = ctx.texture(camera.size_px, 1, np.ones(camera.size_px[::-1], np.float32), dtype="f4")
    made.submit(grey[0], depth)
    made.submit(grey[1], camera=inset)
    shown = made.compose().read()
    assert set(np.unique(shown[20:-20, 20:-20])) == {70}


def test_insets_of_all_kinds_of_pictures(compositor: Make) -> None:
    made, camera = begun(compositor, planar())
    light, inverse = picture(inset_of(camera))
    codes = encode_srgb(light)
    upwards = [np.ascontiguousarray(each[::-1]) for each in (codes, inverse)]
    with made.context.drawing() as ctx:
        size = codes.shape[1::-1]
        colour, depth = ctx.texture(size, 3, upwards[0], alignment=1), ctx.texture(size, 1, upwards[1], dtype="f4")
        srgb = ctx.texture(size, 3, upwards[0], alignment=1, internal_format=0x8C41)
        framebuffer = ctx.framebuffer([ctx.texture(size, 4)], ctx.depth_texture(size))
        rgba = np.concatenate([upwards[0], np.full((*size[::-1], 1), 255, np.uint8)], axis=-1)
        narrowed(framebuffer.color_attachments[0], moderngl.Texture).write(rgba)
        narrowed(framebuffer.depth_attachment, moderngl.Texture).write(upwards[1])
    window = StoredDepth(DepthKind.WINDOW, np.inf, 1.0)
    shown = {}
    for name, given, stored in (
        ("arrays", (codes, inverse), {}),
        ("bottom first", upwards, {"rows": Rows.BOTTOM_FIRST}),
        ("textures", (colour, depth), {}),
        ("names", (colour.glo, depth.glo), {}),
        ("an sRGB format", (srgb, depth), {}),
        ("framebuffer", (framebuffer,), {"stored": window}),
    ):
        frame = made.begin_frame(HEAD, viewpoint(planar()))["right"]
        submit(made, frame)
        made.submit(*given, camera=inset_of(frame), **{"stored": INVERSE} | stored)
        shown[name] = made.compose(pose=LATER).read().astype(int)
    for name, each in shown.items():
        assert np.abs(each - shown["arrays"]).max() <= 1, name


def test_alpha_runs_from_one_picture_to_the_other(compositor: Make) -> None:
    made, camera = begun(compositor, planar(), panel=FLOATS)
    inset, alpha = inset_of(camera), StoredColour("linear", alpha=True)
    for each, value in ((camera, 0.25), (inset, 0.75)):
        light, inverse = picture(each)
        rgba = np.concatenate([0.2 * light, np.full_like(light[..., :1], value)], axis=-1)
        made.submit(rgba, inverse, stored=INVERSE, stored_colour=alpha, camera=None if each is camera else inset)
    frame, shown = made.compose(with_source=True), np.empty((*SIZE[::-1], 4), np.float16)
    frame.read_into(shown)
    share = share_of_inset(frame, camera, inset)
    np.testing.assert_allclose(shown[..., 3], 0.25 + 0.5 * np.clip(share, 0, 1), atol=0.02)
    again = made.begin_frame(HEAD, viewpoint(planar()))["right"]
    submit(made, again)
    with pytest.raises(BadInputError, match="has alpha if and only if the picture around it has"):
        made.submit(rgba, inverse, stored=INVERSE, stored_colour=alpha, camera=inset_of(again))


def test_insets_that_cannot_be_are_refused_and_the_frame_stays(compositor: Make, flat_image_headset: Eye) -> None:
    made, camera = begun(compositor, planar())
    inset = inset_of(camera)
    with pytest.raises(BadInputError, match="does not show this frame; submit its picture before its insets"):
        submit(made, camera, inset)
    submit(made, camera)
    expected = made.compose().read()
    left, right, up, down = camera.fov_rad
    small = 64, 64
    wrong_angles: tuple[tuple[Any, tuple[int, int], str], ...] = (
        ((left - 0.01, 0, up, 0), small, "keep it within"),
        ((0, right, up, down - 0.01), small, "keep it within"),
        ((left, right, up, down), camera.size_px, "pixels per unit tangent, and the picture around it"),
        ((0, right, up, 0), (0, 64), r"the size is \(0, 64\)"),
        ((0.1, 0.05, up, 0), small, "left < right and down < up"),
        ((0, 2.0, up, 0), small, "left < right"),
        ((0, right, up), small, r"give the angles \(left, right, up, down\)"),
        ("wide", small, "give the angles"),
    )
    for fov_rad, size, words in wrong_angles:
        with pytest.raises(BadInputError, match=words):
            camera.inset(fov_rad, size)
    other = made.begin_frame(LATER, viewpoint(planar()))
    light, inverse = picture(inset)
    newer = inset_of(other["right"])
    for unlike in (newer, inset):
        with pytest.raises(BadInputError, match="does not show this frame"):
            made.submit(light, inverse, stored=INVERSE, stored_colour=LINEAR, camera=unlike)
    submit(made, other["right"])
    expected = made.compose().read()
    theirs = EyeCamera("left", newer.view, newer.viewpoint)
    raster = GlRaster(made.context, scene())
    faults: tuple[tuple[tuple[Any, ...], dict[str, Any], str], ...] = (
        ((light, inverse), {"camera": inset}, "not of the right eye in this frame"),
        ((light, inverse), {"camera": theirs, "eye": "right"}, "of the left eye, and the picture of the right eye"),
        ((light, inverse), {"camera": "fovea"}, "give what begin_frame, locate_views or EyeCamera.inset"),
        ((light, inverse), {"camera": other["right"]}, "submitted already in this frame"),
        ((light[:-1], inverse), {"camera": newer}, "the camera"),
        ((light, inverse[:, :-1]), {"camera": newer}, "the camera"),
        ((None,), {"camera": newer}, "cannot be taken from a NoneType"),
        ((raster.draw_on_gpu(other["right"].view),), {"camera": newer}, "another camera"),
    )
    for given, named, words in faults:
        with pytest.raises(BadInputError, match=words):
            made.submit(*given, stored=INVERSE, stored_colour=LINEAR, **named)
    np.testing.assert_array_equal(made.compose().read(), expected)
    made.submit(light, inverse, stored=INVERSE, stored_colour=LINEAR, camera=newer)
    with pytest.raises(BadInputError, match="submit each inset once"):
        made.submit(light, inverse, stored=INVERSE, stored_colour=LINEAR, camera=newer)


def test_a_wide_picture_that_its_inset_has_overwritten_is_refused(compositor: Make) -> None:
    made, camera = begun(compositor, planar())
    left, right, up, down = camera.fov_rad
    inset, raster = camera.inset((0.5 * left, 0.5 * right, 0.5 * up, 0.5 * down), camera.size_px), None
    raster = GlRaster(made.context, scene())
    made.submit(raster.draw_on_gpu(camera.view, "same"))
    with pytest.raises(BadInputError, match="has been drawn over since it was submitted"):
        made.submit(raster.draw_on_gpu(inset.view, "same"), camera=inset)


def test_prepared_compositors_compile_nothing_for_insets(compositor: Make, monkeypatch: pytest.MonkeyPatch) -> None:
    made, camera = begun(compositor, planar(), context="egl")
    made.prepare(overlays=0, insets=True)
    with made.context.drawing() as ctx:
        target = ctx.simple_framebuffer(SIZE)
    submit(made, camera)
    submit(made, camera, inset_of(camera, 0.6, 2))
    compiled = programs_compiled(monkeypatch)
    for into in (None, target):
        for last in (None, LATER):
            made.compose(into, pose_at_last_row=last)
    assert not compiled
    with made.context.drawing():
        drawn = np.frombuffer(target.read(components=3), np.uint8).reshape(*SIZE[::-1], 3)
    assert np.abs(drawn[::-1].astype(int) - made.compose(pose_at_last_row=LATER).read()).max() <= 1
