"""Overlays lie where the exact rays meet their quad, and are composited in linear light."""

from typing import Any

import moderngl
import numpy as np
import pytest
from gl_scenes import at
from numpy.typing import NDArray
from warps.composing import HEAD, SMALL, Make, planar, scene, traced, viewpoint

from wlr_render.draw.ray_tracing import RayRenderer
from wlr_render.errors import BadInputError
from wlr_render.geometry import transforms
from wlr_render.gl.framebuffers import TextureLayer
from wlr_render.mappings import Eye
from wlr_render.numerics.arrays import Float32Array, FloatArray
from wlr_render.warp.compositor import Compositor
from wlr_render.warp.panel_light import PanelLight
from wlr_render.warp.stored_picture import Rows, StoredColour

pytestmark = pytest.mark.gl

LINEAR = StoredColour("linear", alpha=True)
FLOATS = PanelLight("linear", bits=16)
LATER = HEAD @ at(0.08, 0.005, 0, transforms.rotation_about("y", 0.08))
QUAD = at(0.02, -0.01, -0.8, transforms.rotation_about("y", 0.7) @ transforms.rotation_about("x", -0.2))
SIZE_M = 0.3, 0.2
INSIDE = slice(3, -3), slice(3, -3)


@pytest.fixture
def made(compositor: Make, flat_image_headset: Eye) -> Compositor:
    """A compositor whose frames are light."""
    of_light: Compositor = compositor(flat_image_headset, panel=FLOATS)
    return of_light


def behind(made: Compositor, light: float = 0.0) -> None:
    """Submit a picture of one light at 1 m."""
    (camera,) = made.begin_frame(HEAD, viewpoint(made.plan("right").channels[0])).values()
    shape = camera.size_px[::-1]
    made.submit(
        np.full((*shape, 3), light, np.float32), np.ones(shape, np.float32), stored_colour=StoredColour("linear")
    )


def places(size: tuple[int, int] = (300, 200)) -> Float32Array:
    """A picture whose red and green are the place in it, and whose blue is 1."""
    x, y = np.meshgrid(*((np.arange(side) + 0.5) / side for side in size))
    return np.stack([x, y, np.ones_like(x), np.ones_like(x)], axis=-1).astype(np.float32)


def exact_places(model: Eye, pose: FloatArray, world_from_quad: FloatArray) -> FloatArray:
    """(height, width, 2) where the ray-traced rays of the pixels meet the quad, from (0, 0) to (1, 1) in it."""
    rays = traced(model, SMALL, viewpoint(model), pose, RayRenderer(scene())).ray_map
    start, direction = (each.reshape(*SMALL[::-1], 3).astype(np.float64) for each in rays.world_rays(pose))
    quad_from_world = transforms.inverse(world_from_quad)
    start, direction = transforms.apply(quad_from_world, start), direction @ quad_from_world[:3, :3].T
    met = start - start[..., 2:] / direction[..., 2:] * direction
    return np.stack([0.5 + met[..., 0] / SIZE_M[0], 0.5 - met[..., 1] / SIZE_M[1]], axis=-1)


def test_an_overlay_takes_no_memory_for_a_depth(made: Compositor, monkeypatch: pytest.MonkeyPatch) -> None:
    formats, make = [], moderngl.Context.texture
    picture = np.full((30, 50, 4), 99, np.uint8)

    def counted(context: moderngl.Context, size: tuple[int, int], components: int, *args: Any, **more: Any) -> Any:
        formats.append((size, components))
        return make(context, size, components, *args, **more)

    with made.context.drawing() as ctx:
        texture = ctx.texture((50, 30), 4, picture)
    monkeypatch.setattr(moderngl.Context, "texture", counted)
    for each in (picture, texture):
        made.submit_overlay(each, device_from_quad=at(0, 0, -1))
    assert ((50, 30), 4) in formats
    assert ((50, 30), 1) not in formats


@pytest.mark.parametrize(("kind", "is_head_locked"), [("planar", False), ("flat image", True), ("three", False)])
def test_a_quad_lies_where_the_traced_rays_meet_it(
    compositor: Make, flat_image_headset: Eye, kind: str, is_head_locked: bool
) -> None:
    model = planar() if kind == "planar" else flat_image_headset
    made = compositor({"right": [model] * 3} if kind == "three" else model, panel=FLOATS)
    behind(made)
    given = {"device_from_quad": QUAD} if is_head_locked else {"world_from_quad": HEAD @ QUAD}
    made.submit_overlay(places(), SIZE_M, stored_colour=LINEAR, **given)
    shown = made.compose(pose=LATER).read().astype(np.float64)
    exact = exact_places(model, LATER, (LATER if is_head_locked else HEAD) @ QUAD)
    per_pixel = np.abs(np.gradient(exact, axis=(0, 1))).max(axis=(0, 1, 2))
    to_edge = np.minimum(exact, 1 - exact)
    inside, outside = (to_edge > per_pixel).all(axis=-1), (to_edge < -per_pixel).any(axis=-1)
    assert inside.sum() > 60
    assert outside.mean() > 0.1
    assert (shown[outside] == 0).all()
    assert (shown[inside][:, 2] > 0.999).all()
    assert np.abs(shown[inside][:, :2] - exact[inside]).max() < 0.05 * per_pixel.max() + 2**-11


def composited(
    made: Compositor, light: float, picture: Float32Array | NDArray[np.uint8], **given: Any
) -> NDArray[np.float16]:
    behind(made, light)
    made.submit_overlay(picture, (5.0, 5.0), device_from_quad=at(0, 0, -1), **given)
    return light_inside(made)


def light_inside(made: Compositor) -> NDArray[np.float16]:
    pixels = np.empty((*SMALL[::-1], 4), np.float16)
    made.compose().read_into(pixels)
    return pixels[INSIDE]


def test_light_is_added_over_what_alpha_lets_through(made: Compositor) -> None:
    over = np.full((9, 9, 4), (0.5, 0.25, 0.0, 0.25), np.float32)
    expected = [0.5 + 0.75 * 0.4, 0.25 + 0.75 * 0.4, 0.75 * 0.4, 1.0]
    shown = composited(made, 0.4, over, stored_colour=LINEAR)
    np.testing.assert_allclose(shown, np.broadcast_to(expected, shown.shape), atol=1e-3)
    codes = np.full((9, 9, 4), (188, 0, 255, 128), np.uint8)
    shown = composited(made, 0.4, codes)
    rest = 0.4 * (1 - 128 / 255)
    np.testing.assert_allclose(shown, np.broadcast_to([0.5029 + rest, rest, 1 + rest, 1], shown.shape), atol=2e-3)


def test_overlays_are_composited_in_the_order_of_their_layers(made: Compositor) -> None:
    behind(made, 0.4)
    colours = np.array([[0.2, 0.0, 0.1, 0.3], [0.0, 0.3, 0.1, 0.6], [0.1, 0.1, 0.0, 0.25], [0.05, 0.0, 0.2, 0.5]])
    quad: dict[str, Any] = {"device_from_quad": at(0, 0, -1), "stored_colour": LINEAR}
    for layer in (2, 0, 3, 1):
        made.submit_overlay(np.full((9, 9, 4), colours[layer], np.float32), (5.0, 5.0), layer=layer, **quad)
    for taken_away, left in (((), [0, 1, 2, 3]), ((3, 1), [0, 2])):
        for layer in taken_away:
            made.submit_overlay(None, layer=layer)
        expected = np.array([0.4, 0.4, 0.4, 1.0])
        for colour in colours[left]:
            expected = colour + (1 - colour[3]) * expected
        shown = light_inside(made).astype(np.float64)
        np.testing.assert_allclose(shown, np.broadcast_to(expected, shown.shape), atol=1e-3)


def test_layers_lie_at_their_own_places(made: Compositor) -> None:
    behind(made)
    other = at(-0.03, 0.01, -0.6, transforms.rotation_about("y", -0.3))
    alone = []
    for layer, quad in ((0, QUAD), (2, other)):
        made.submit_overlay(places(), SIZE_M, device_from_quad=quad, stored_colour=LINEAR, layer=layer)
        alone.append(made.compose(pose=LATER).read().astype(np.float64))
        made.submit_overlay(None, layer=layer)
    for layer, quad in ((0, QUAD), (2, other)):
        made.submit_overlay(places(), SIZE_M, device_from_quad=quad, stored_colour=LINEAR, layer=layer)
    both = made.compose(pose=LATER).read().astype(np.float64)
    covers = alone[1][..., 2:]  # its blue is its alpha
    assert 0.05 < covers.mean() < 0.9
    np.testing.assert_allclose(both, alone[1] + (1 - covers) * alone[0], atol=2e-3)


def test_fine_stripes_keep_their_light(made: Compositor) -> None:
    stripes = np.ones((512, 4096, 4), np.float32)
    stripes[:, ::2, :3] = 0
    shown = composited(made, 0.0, stripes, stored_colour=LINEAR)
    np.testing.assert_allclose(shown[..., :3], 0.5, atol=0.01)


def test_textures_arrays_and_rows(made: Any) -> None:
    behind(made)
    made.submit_overlay(places(), SIZE_M, device_from_quad=QUAD, stored_colour=LINEAR)
    expected = made.compose().read()
    with made.context.drawing() as ctx:
        texture = ctx.texture((300, 200), 4, np.ascontiguousarray(places()[::-1]), dtype="f4")
    for given, rows in ((texture, None), (np.ascontiguousarray(places()[::-1]), Rows.BOTTOM_FIRST)):
        made.submit_overlay(given, SIZE_M, device_from_quad=QUAD, stored_colour=LINEAR, rows=rows)
        np.testing.assert_array_equal(made.compose().read(), expected)
    with made.context.drawing() as ctx:
        ours = ctx.texture_array((300, 200, 2), 4, np.stack([np.ones_like(places()), places()[::-1]]), dtype="f4")
    for given in (texture.glo, TextureLayer(ours, 1), TextureLayer(ours.glo, 1), TextureLayer(texture)):
        made.submit_overlay(given, SIZE_M, device_from_quad=QUAD, stored_colour=LINEAR)
        # Copied floats are half floats.
        np.testing.assert_allclose(made.compose().read().astype(float), expected.astype(float), atol=2**-10)
    made.submit_overlay(ours, SIZE_M, device_from_quad=QUAD, stored_colour=LINEAR)
    assert made.compose().read()[..., 0].max() == 1
    made.submit_overlay(None)
    assert not made.compose().read().any()


def test_a_quad_that_is_seen_from_behind_is_not_shown(made: Compositor) -> None:
    behind(made)
    for pose in (at(0, 0, -1, transforms.rotation_about("y", np.pi)), at(0, 0, 1)):
        made.submit_overlay(places(), SIZE_M, device_from_quad=pose, stored_colour=LINEAR)
        assert not made.compose().read().any()


def test_overlays_that_cannot_be_are_refused_and_the_last_stays(made: Any) -> None:
    menu = np.zeros((4, 4, 4), np.uint8)
    behind(made)
    made.submit_overlay(places(), SIZE_M, device_from_quad=QUAD, stored_colour=LINEAR)
    expected = made.compose().read()
    wrong: tuple[tuple[Any, dict[str, Any], str], ...] = (
        (menu, {}, "one pose; give either world_from_quad or device_from_quad"),
        (menu, {"world_from_quad": HEAD, "device_from_quad": HEAD}, "one pose"),
        (menu, {"world_from_quad": 2 * np.eye(4)}, "it scales by 2"),
        (menu, {"world_from_quad": np.tri(4)}, "give world_from_quad with the last row"),
        (menu, {"world_from_quad": HEAD, "size_m": (0, 1)}, "both positive"),
        (menu, {"world_from_quad": HEAD, "eyes": ("left",)}, "choose from right"),
        (menu, {"world_from_quad": HEAD, "stored_colour": "srgb"}, "a StoredColour"),
        (np.zeros((4, 4, 3), np.uint8), {"world_from_quad": HEAD}, "no alpha"),
        (np.zeros((4, 4), np.uint8), {"world_from_quad": HEAD}, r"shape \(4, 4\)"),
        (np.zeros((0, 4, 4), np.uint8), {"world_from_quad": HEAD}, r"shape \(0, 4, 4\)"),
        (np.zeros((4, 4, 4)), {"world_from_quad": HEAD}, "float64"),
        ("menu.png", {"world_from_quad": HEAD}, "cannot be taken from a str"),
        (menu, {"world_from_quad": HEAD, "layer": 4}, "layer is 4; give a whole number from 0 to 3"),
        (menu, {"world_from_quad": HEAD, "layer": "top"}, "give a whole number from 0 to 3"),
        (99999, {"world_from_quad": HEAD}, "number 99999 is not a texture of the OpenGL context"),
    )
    for picture, given, words in wrong:
        with pytest.raises(BadInputError, match=words):
            made.submit_overlay(picture, **given)
        np.testing.assert_array_equal(made.compose().read(), expected)
    for overlays in (1.5, 5, -1, True):
        with pytest.raises(BadInputError, match=r"overlays is .*; give a whole number from 0 to 4"):
            made.prepare(overlays)
