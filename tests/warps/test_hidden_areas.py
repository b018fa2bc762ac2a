"""Areas that an edge hides from the newest picture, filled from the picture before it."""

from collections.abc import Callable
from dataclasses import replace
from functools import partial

import numpy as np
import pytest
from numpy.typing import NDArray
from present import present
from warping import uploaded, uploaded_field
from warps.composing import HEAD, Make, planar, viewpoint
from warps.test_insets import inset_of

from wlr_render.geometry import transforms
from wlr_render.geometry.pinhole import Pinhole
from wlr_render.gl.context import GlContext
from wlr_render.mappings import Panel
from wlr_render.numerics.arrays import BoolArray, FloatArray
from wlr_render.warp.compositor import Compositor
from wlr_render.warp.eye_camera import EyeCamera
from wlr_render.warp.gl_warp import Backdrop, GlWarp, WarpedPicture
from wlr_render.warp.gpu_image import GpuImage
from wlr_render.warp.grid import WarpGrid
from wlr_render.warp.stored_picture import DepthKind, StoredColour, StoredDepth
from wlr_render.warp.view import GeometryImage
from wlr_render.warp.warp import WarpedImage, WarpStatus

pytestmark = pytest.mark.gl

WIDTH, HEIGHT = 160, 120
SIZE = 90, 75  # of the composed frames
CAMERA = Pinhole(WIDTH, HEIGHT, np.array([-0.4, -0.3]), np.array([0.4, 0.3]))
WALL, HAND = 0.5, 5.0
"""Inverse depths of a wall that fills the field, and of a square in front of it, in 1/m."""
HAND_COLOUR = 230, 180, 20


def moved(x: float, y: float = 0.0) -> FloatArray:
    return transforms.rigid(np.eye(3), np.array([x, y, 0.0]))


NEWEST, OLDER, SEEN_FROM = moved(0), moved(0.03, 0.004), moved(0.02)


def is_hand(camera: Pinhole, scene_from_camera: FloatArray, hand_m: tuple[float, float]) -> BoolArray:
    """Where a camera sees the square, whose middle is at `hand_m`."""
    at, _ = where_rays_meet(camera, scene_from_camera, HAND)
    return np.asarray(np.all(np.abs(at - hand_m) < 0.025, axis=-1))


def where_rays_meet(camera: Pinhole, scene_from_camera: FloatArray, inverse: float) -> tuple[FloatArray, FloatArray]:
    """Places (..., 2) on the plane z = -1 / inverse, and depths, for the centres of the camera's pixels."""
    tangents = camera.pixel_centre_tangents()
    toward = transforms.rotate(scene_from_camera, np.concatenate([tangents, -np.ones_like(tangents[..., :1])], axis=-1))
    depth = (-1 / inverse - scene_from_camera[2, 3]) / toward[..., 2]
    return scene_from_camera[:2, 3] + toward[..., :2] * depth[..., None], depth


def seen(
    scene_from_camera: FloatArray, hand_m: tuple[float, float] = (0.0, 0.0), camera: Pinhole = CAMERA
) -> GeometryImage:
    """What a camera draws, in closed form."""
    (_, to_hand), (on_wall, to_wall) = (where_rays_meet(camera, scene_from_camera, each) for each in (HAND, WALL))
    hand = is_hand(camera, scene_from_camera, hand_m)
    waves = np.stack([on_wall @ np.array(k) for k in ([19, 6], [-9, 21], [15, -12])], axis=-1)
    colour = np.where(hand[..., None], HAND_COLOUR, 127 + 100 * np.sin(waves))
    return GeometryImage(np.rint(colour).astype(np.uint8), (1 / np.where(hand, to_hand, to_wall)).astype(np.float32))


def composed(
    context: GlContext, older: GeometryImage | None, cells: int | None = None, older_at: FloatArray = OLDER
) -> WarpedImage:
    """The newest picture as it is seen from SEEN_FROM, over an older one, through a warp grid of cells x cells."""
    grid = WarpGrid.edge_to_edge(Panel(WIDTH, HEIGHT), *((cells + 1,) * 2 if cells else (WIDTH + 1, HEIGHT + 1)))
    tangents = CAMERA.tangents_of_pixel(grid.panel_pixel())
    rays = np.concatenate([tangents, np.broadcast_to(SEEN_FROM[:2, 3], tangents.shape)], axis=-1)
    field = uploaded_field(context, np.moveaxis(rays, -1, 0), grid)
    backdrop = None
    if older is not None:
        backdrop = Backdrop(WarpedPicture(uploaded(context, older, CAMERA)), transforms.inverse(older_at))
    newest, size = uploaded(context, seen(NEWEST), CAMERA), (WIDTH, HEIGHT)
    return GlWarp(context).draw(newest, [field], np.eye(4), size, with_source=True, backdrop=backdrop).read()


def codes_off(found: NDArray[np.uint8], expected: NDArray[np.uint8]) -> NDArray[np.int64]:
    return np.asarray(np.abs(found.astype(int) - expected).max(axis=-1))


@pytest.mark.parametrize("cells", [20, None])
@pytest.mark.parametrize("computes", [False, True])
def test_what_the_older_picture_sees_is_shown(gl_context: GlContext, cells: int | None, computes: bool) -> None:
    usual = gl_context.computes
    try:
        gl_context.computes = computes
        alone, filled = (composed(gl_context, older, cells) for older in (None, seen(OLDER)))
    finally:
        gl_context.computes = usual
    truth, gap = seen(SEEN_FROM).colour, alone.status == WarpStatus.DISOCCLUDED
    assert gap.sum() > 750
    np.testing.assert_array_equal(filled.status, alone.status)
    np.testing.assert_array_equal(filled.colour[~gap], alone.colour[~gap])
    np.testing.assert_array_equal(present(filled.source), present(alone.source))
    assert (codes_off(alone.colour, truth)[gap] > 30).mean() > 0.95  # the wall beside the gap once more
    assert (codes_off(filled.colour, truth)[gap] > 2).mean() < 0.01


def test_a_hand_that_was_in_the_gap_does_not_appear_there(gl_context: GlContext) -> None:
    then = 0.02, 0.035
    alone, filled = composed(gl_context, None), composed(gl_context, seen(OLDER, then))
    gap = alone.status == WarpStatus.DISOCCLUDED
    assert (gap & is_hand(CAMERA, OLDER, then)).sum() > 125
    assert not (gap & np.all(filled.colour == HAND_COLOUR, axis=-1)).any()
    is_filled = (filled.colour != alone.colour).any(axis=-1)
    assert is_filled[gap].mean() > 0.5
    assert (codes_off(filled.colour, seen(SEEN_FROM).colour)[is_filled] > 2).mean() < 0.01


def test_what_neither_picture_sees_is_filled_as_without(gl_context: GlContext) -> None:
    image = seen(NEWEST)
    other = GeometryImage(image.colour[..., ::-1], image.inverse_depth)
    alone, filled = composed(gl_context, None), composed(gl_context, other, older_at=NEWEST)
    assert (alone.status == WarpStatus.DISOCCLUDED).sum() > 750
    differ = (filled.colour != alone.colour).any(axis=-1)
    assert differ.sum() <= 2 * HEIGHT  # along the edges of the gap


def drawn(camera: EyeCamera) -> GeometryImage:
    """The same scene, before a head at HEAD."""
    return seen(transforms.inverse(HEAD) @ camera.world_from_camera, camera=camera.view.camera)


def by_arrays(made: Compositor, camera: EyeCamera) -> None:
    image = drawn(camera)
    made.submit(image.colour, image.inverse_depth, stored=StoredDepth(DepthKind.INVERSE))


def by_textures(made: Compositor, camera: EyeCamera) -> None:
    made.submit(uploaded(made.context, drawn(camera), camera.view.camera))


def with_inset(made: Compositor, camera: EyeCamera) -> None:
    by_textures(made, camera)
    image = drawn(inset := inset_of(camera, 0.8))
    made.submit(image.colour, image.inverse_depth, stored=StoredDepth(DepthKind.INVERSE), camera=inset)


@pytest.mark.parametrize("submit", [by_arrays, by_textures, with_inset])
def test_a_head_that_turns_back_sees_the_last_picture(
    compositor: Make, submit: Callable[[Compositor, EyeCamera], None]
) -> None:
    aside, shown = HEAD @ OLDER, []
    for hidden_areas in ("repeated", "last picture"):
        made = compositor(planar(), SIZE, hidden_areas=hidden_areas)
        for pose in (HEAD, aside, HEAD):
            (camera,) = made.begin_frame(pose, viewpoint(planar())).values()
            submit(made, camera)
        shown.append((made.compose(pose=HEAD @ SEEN_FROM).read(), made.compose(pose=HEAD @ SEEN_FROM).status()))
        submit(made, *made.begin_frame(HEAD @ SEEN_FROM, viewpoint(planar())).values())
    truth = made.compose().read()
    (alone, status), (filled, _) = shown
    gap = status == WarpStatus.DISOCCLUDED
    assert gap.sum() > 175
    assert (codes_off(alone, truth)[gap] > 30).mean() > 0.95
    assert (codes_off(filled, truth)[gap] > 8).mean() < 0.1


@pytest.fixture
def shaken(compositor: Make) -> Callable[..., Compositor]:
    """Makes a compositor that has the pictures from OLDER and from HEAD, with the last picture or repeated areas."""

    def make(hidden_areas: str, submit: Callable[[Compositor, EyeCamera], None] = by_arrays) -> Compositor:
        made: Compositor = compositor(planar(), SIZE, hidden_areas=hidden_areas)
        for pose in (HEAD @ OLDER, HEAD):
            submit(made, *made.begin_frame(pose, viewpoint(planar())).values())
        return made

    return make


@pytest.mark.parametrize("samples", [0, 4])
def test_a_framebuffer_shows_the_last_picture_too(shaken: Callable[..., Compositor], samples: int) -> None:
    made = shaken("last picture")
    with made.context.drawing() as ctx:
        theirs, resolved = (ctx.simple_framebuffer(SIZE, samples=each) for each in (samples, 0))
    made.compose(theirs, pose=HEAD @ SEEN_FROM)
    with made.context.drawing() as ctx:
        ctx.copy_framebuffer(resolved, theirs)
        shown = np.frombuffer(resolved.read(components=3, alignment=1), np.uint8).reshape(*SIZE[::-1], 3)[::-1]
    np.testing.assert_array_equal(shown, made.compose(pose=HEAD @ SEEN_FROM).read())
    assert (shown != shaken("repeated").compose(pose=HEAD @ SEEN_FROM).read()).any()


def test_overlays_cover_what_the_last_picture_fills(shaken: Callable[..., Compositor]) -> None:
    made = shaken("last picture")
    at_quad = transforms.rigid(np.eye(3), np.array([0.0, 0.0, -0.6]))
    white = np.full((4, 4, 4), 255, np.uint8)
    for of_device, of_world in ((at_quad, None), (None, HEAD @ at_quad)):
        made.submit_overlay(white, (3.0, 3.0), device_from_quad=of_device, world_from_quad=of_world)
        frame = made.compose(pose=HEAD @ SEEN_FROM)
        assert (frame.status() == WarpStatus.DISOCCLUDED).sum() > 175
        assert (frame.read() == 255).all()


def test_each_row_has_its_own_pose_in_the_last_picture(shaken: Callable[..., Compositor]) -> None:
    made, first = shaken("last picture"), HEAD @ SEEN_FROM
    last = first @ transforms.rigid(transforms.rotation_about("y", 0.02), np.zeros(3))
    by_rows = made.compose(pose=first, pose_at_last_row=last)
    rows, gap = by_rows.read(), by_rows.status() == WarpStatus.DISOCCLUDED
    number = 20 + int(gap[20:].sum(axis=1).argmax())
    at_row = made.compose(pose=transforms.between(first, last, np.array([number / (SIZE[1] - 1)]))[0]).read()[number]
    at_first, hidden = made.compose(pose=first).read()[number], gap[number]
    assert hidden.sum() > 4
    assert np.median(codes_off(rows[number], at_row)[hidden]) <= 3
    assert np.median(codes_off(rows[number], at_first)[hidden]) > 10


def test_pictures_of_two_kinds_of_alpha_do_not_mix(shaken: Callable[..., Compositor]) -> None:
    with_alpha = iter([True, False] * 2)

    def submit(made: Compositor, camera: EyeCamera) -> None:
        image, alpha = drawn(camera), next(with_alpha)
        colour = np.concatenate([image.colour, np.full_like(image.colour[..., :1], 255)], axis=-1)
        stored = StoredDepth(DepthKind.INVERSE)
        made.submit(colour, image.inverse_depth, stored=stored, stored_colour=StoredColour(alpha=alpha))

    filled, repeated = (shaken(each, submit).compose(pose=HEAD @ SEEN_FROM) for each in ("last picture", "repeated"))
    np.testing.assert_array_equal(filled.read(), repeated.read())


@pytest.mark.parametrize("is_prepared", [True, False])
def test_depth_bounds_stay_those_of_their_picture(compositor: Make, is_prepared: bool) -> None:
    poses = HEAD @ moved(0.01), HEAD @ OLDER, HEAD

    def shown(made: Compositor, pose: FloatArray, again: GpuImage | None = None) -> GpuImage:
        (camera,) = made.begin_frame(pose, viewpoint(planar())).values()
        image = again or uploaded(made.context, drawn(camera), camera.view.camera)
        made.submit(image)
        return image

    made, expected = (compositor(planar(), SIZE, hidden_areas="last picture") for _ in range(2))
    if is_prepared:
        for pose in poses:
            shown(made, pose)
            made.compose(pose=HEAD @ SEEN_FROM)
        made.prepare()
        shown(expected, poses[1])
        shown(expected, poses[2])
    else:
        images = []
        for pose in (poses[1], poses[2], poses[1]):
            images.append(shown(made, pose))
            made.compose(pose=HEAD @ SEEN_FROM)
        shown(made, poses[0])
        shown(made, poses[2], images[1])
        shown(expected, poses[0])
        shown(expected, poses[2])
    found = made.compose(pose=HEAD @ SEEN_FROM).read()
    np.testing.assert_array_equal(found, expected.compose(pose=HEAD @ SEEN_FROM).read())


def test_a_last_picture_that_was_drawn_over_is_not_shown(compositor: Make) -> None:
    made, drawn_over = compositor(planar(), hidden_areas="last picture"), set[str]()
    for pose, name in ((HEAD @ OLDER, "last"), (HEAD, "newest")):
        (camera,) = made.begin_frame(pose, viewpoint(planar())).values()
        image = uploaded(made.context, drawn(camera), camera.view.camera)
        made.submit(replace(image, is_overwritten=partial(drawn_over.__contains__, name)))
    filled = made.compose(pose=HEAD @ SEEN_FROM).read()
    drawn_over.add("last")
    alone = compositor(planar())
    by_textures(alone, *alone.begin_frame(HEAD, viewpoint(planar())).values())
    repeated = alone.compose(pose=HEAD @ SEEN_FROM).read()
    np.testing.assert_array_equal(made.compose(pose=HEAD @ SEEN_FROM).read(), repeated)
    assert (filled != repeated).any()
