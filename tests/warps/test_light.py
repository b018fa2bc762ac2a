"""Light of pictures and panels, against closed forms."""

from collections.abc import Callable, Iterator, Mapping
from typing import Any, Literal

import moderngl
import numpy as np
import pytest
from gl_scenes import at
from hardware import HALF_FLOAT, allowed, filter_of
from numpy import floating, number
from numpy.typing import ArrayLike, NDArray
from warps.composing import HEAD, SMALL, Make, draw, planar, scene, viewpoint

from benchmarks.scene_source import SceneSource
from wlr_render.errors import BadInputError
from wlr_render.geometry import transforms
from wlr_render.gl.framebuffers import TextureLayer
from wlr_render.gl.gl import GlContext
from wlr_render.mappings import Eye
from wlr_render.numerics.arrays import Float32Array, FloatArray
from wlr_render.numerics.srgb import decode_srgb
from wlr_render.warp.compositor import Compositor
from wlr_render.warp.panel_light import PanelLight
from wlr_render.warp.stored_picture import StoredColour

pytestmark = pytest.mark.gl

INSIDE = slice(4, -4), slice(4, -4)
LINEAR, DEEP = StoredColour("linear"), StoredColour(bits=10)
SRGB8_ALPHA8, RGB10_A2 = 0x8C43, 0x8059
HALF_LIGHT = 188  # the sRGB code of linear 0.5
AWAY = HEAD @ at(0, 0, 0, transforms.rotation_about("y", 0.1))  # a part of the panel sees nothing of the picture


def shown(made: Compositor, picture: Callable[..., Any], pose: FloatArray = HEAD, **stored: Any) -> NDArray[Any]:
    """RGBA of a composed picture that is 1 m away, from what `picture(size)` returns."""
    (camera,) = made.begin_frame(HEAD, viewpoint(made.plan("right").channels[0])).values()
    colour = picture(camera.size_px)
    far = np.ones(camera.size_px[::-1], np.float32)
    depth: NDArray[np.float32] | moderngl.Texture | TextureLayer = far
    if not isinstance(colour, np.ndarray):
        with made.context.drawing() as ctx:
            texture = ctx.texture(camera.size_px, 1, far, dtype="f4")
        depth = TextureLayer(texture) if isinstance(colour, TextureLayer) else texture
    made.submit(colour, depth, stored_colour=StoredColour(**stored))
    frame = made.compose(pose=pose)
    frame.texture()
    width, height = made.size_px
    pixels = np.empty((height, width, 4), frame.read().dtype)
    frame.read_into(pixels)
    np.testing.assert_array_equal(pixels[..., :3], frame.read())
    np.testing.assert_array_equal(pixels[..., :3], frame.read_async().result())
    return pixels


def grey(value: float, dtype: type[number]) -> Callable[..., Any]:
    return lambda size: np.full((*size[::-1], 3), value, dtype)


@pytest.mark.parametrize("dtype", [np.float32, np.float16])
def test_linear_arrays_are_encoded_on_output(made: Compositor, dtype: type[floating]) -> None:
    assert (shown(made, grey(0.5, dtype), encoding="linear")[INSIDE][..., :3] == HALF_LIGHT).all()
    codes = shown(made, grey(HALF_LIGHT / 255, dtype))[INSIDE][..., :3]
    assert (codes == HALF_LIGHT).all()


def textures(
    made: Compositor, value: float, dtype: str, internal_format: int | None = None
) -> Iterator[Callable[..., Any]]:
    """A texture of one grey, given as a texture, as a layer that is copied, and of several samples."""

    def make(size: tuple[int, int], samples: int = 0) -> moderngl.Texture:
        more = {} if internal_format is None else {"internal_format": internal_format}
        with made.context.drawing() as ctx:
            texture = ctx.texture(size, 4, dtype=dtype, samples=samples, **more)
            framebuffer = ctx.framebuffer([texture])
            framebuffer.clear(value, value, value, 1.0)
        return texture

    yield make
    yield lambda size: TextureLayer(make(size))
    yield lambda size: TextureLayer(make(size, samples=4))


@pytest.mark.parametrize("dtype", ["f1", "f2", "f4"])
def test_linear_textures(made: Compositor, dtype: str) -> None:
    for picture in textures(made, 0.5, dtype):
        pixels = shown(made, picture, encoding="linear")[INSIDE]
        assert (pixels == [HALF_LIGHT] * 3 + [255]).all()


@pytest.mark.parametrize("encoding", ["srgb", "linear"])
def test_textures_of_an_srgb_format_hold_codes(made: Compositor, encoding: str) -> None:
    for picture in textures(made, 100 / 255, "f1", SRGB8_ALPHA8):
        assert (shown(made, picture, encoding=encoding)[INSIDE][..., :3] == 100).all()


def test_codes_that_a_driver_decodes_in_any_case_are_taken_as_light(
    compositor: Make, flat_image_headset: Eye, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(GlContext, "reads_srgb_codes", False)  # as without GL_EXT_texture_sRGB_decode
    made = compositor(flat_image_headset, context="egl")
    for internal_format in (None, SRGB8_ALPHA8):
        for picture in textures(made, 100 / 255, "f1", internal_format):
            assert (shown(made, picture)[INSIDE][..., :3] == 100).all()


@pytest.mark.parametrize("bits", [10, 12, 16])
def test_deep_codes_come_out_as_deep_codes(compositor: Make, flat_image_headset: Eye, bits: int) -> None:
    made = compositor(flat_image_headset, panel=PanelLight(bits=10))
    for code in (1, 37, 500, 813, 1023):
        stored = round(code * ((1 << bits) - 1) / 1023)
        pixels = shown(made, grey(stored, np.uint16), bits=bits)[INSIDE][..., :3]
        assert pixels.dtype == np.uint16
        assert (np.rint(pixels / 65535 * 1023) == code).all()
    for picture in textures(made, 37 / 1023, "f1", RGB10_A2):
        pixels = shown(made, picture, bits=bits)[INSIDE][..., :3]
        assert (np.rint(pixels / 65535 * 1023) == 37).all()


def stripes(size: tuple[int, int]) -> Float32Array:
    """Light of 0 and 1.2 in turns of a pixel."""
    return np.broadcast_to((1.2 * (np.arange(size[0]) % 2))[:, None], (size[1], size[0], 3)).astype(np.float32)


def test_light_is_clipped_on_output_only(compositor: Make, flat_image_headset: Eye) -> None:
    made = compositor(flat_image_headset, resolution=2.0)
    pixels = shown(made, stripes, encoding="linear")[INSIDE][..., :3]
    assert decode_srgb(pixels).mean() == pytest.approx(0.6, abs=0.01)


def table() -> FloatArray:
    """A panel whose three primaries have three curves, black levels and ends."""
    code = np.linspace(0, 1, 256)
    return np.stack([code**2.2, 0.01 + 0.9 * code**1.8, 0.5 * code + 0.5 * code**3], axis=-1)


def inverse_of_table(light: float) -> ArrayLike:
    return [np.interp(light, column, np.linspace(0, 1, 256)) for column in table().T]


@pytest.mark.parametrize(
    ("encoding", "codes_of"),
    [
        ("linear", lambda light: light),
        (2.2, lambda light: light ** (1 / 2.2)),
        (1, lambda light: light),
        (table(), inverse_of_table),
    ],
)
def test_codes_of_every_encoding_give_the_light(
    compositor: Make, flat_image_headset: Eye, encoding: Any, codes_of: Callable[[float], ArrayLike]
) -> None:
    made = compositor(flat_image_headset, panel=PanelLight(encoding, bits=16))
    for light in (0.0, 0.003, 0.02, 0.2, 0.5, 0.95, 1.0):
        pixels = shown(made, grey(light, np.float32), encoding="linear")[INSIDE][..., :3]
        # Light is stored in half floats, which a texture filter may round down; codes grow no faster than light.
        of_filter = allowed(made.context, 0.0, 2 * HALF_FLOAT)
        np.testing.assert_allclose(pixels, np.broadcast_to(codes_of(light), pixels.shape), of_filter, 2**-11 + 1e-4)


def test_linear_half_floats_keep_more_than_white(compositor: Make, flat_image_headset: Eye) -> None:
    made = compositor(flat_image_headset, panel=PanelLight("linear", bits=16))
    pixels = shown(made, grey(3.5, np.float32), encoding="linear")[INSIDE][..., :3]
    assert pixels.dtype == np.float16
    assert (pixels == 3.5).all()


@pytest.mark.parametrize(("encoding", "per_primary"), [("linear", True), (table(), False)])
def test_uniformity_multiplies_the_light(
    compositor: Make, flat_image_headset: Eye, per_primary: bool, encoding: FloatArray | Literal["linear"]
) -> None:
    shape = (*SMALL[::-1], 3) if per_primary else SMALL[::-1]
    factors = np.random.default_rng(0).uniform(0.2, 1, shape)
    made = compositor(flat_image_headset, panel=PanelLight(encoding, factors, bits=16))
    light = 0.8 * np.broadcast_to(np.atleast_3d(factors), (*SMALL[::-1], 3))
    if not isinstance(encoding, str):
        codes = np.linspace(0, 1, 256)
        light = np.stack([np.interp(light[..., k], encoding[:, k], codes) for k in range(3)], axis=-1)
    pixels = shown(made, grey(0.8, np.float32), encoding="linear")[..., :3]
    # The factors are a texture, read at a place between the vertices of the warp grid.
    filtered = filter_of(light)[INSIDE]
    assert (np.abs(pixels[INSIDE] - light[INSIDE]) <= allowed(made.context, 1e-3, filtered)).all()
    with made.context.drawing() as ctx:
        upright = ctx.simple_framebuffer(SMALL)
    made.compose(upright)
    with made.context.drawing():
        shown_there = np.frombuffer(upright.read(components=3), np.uint8).reshape(*SMALL[::-1], 3)[::-1]
    most = allowed(made.context, 1.5 / 255, filtered)
    assert (np.abs(shown_there[INSIDE] / 255 - light[INSIDE]) <= most).all()


def test_a_texture_made_between_frames_does_not_take_the_maps_place(
    compositor: Make, flat_image_headset: Eye, theirs: moderngl.Context
) -> None:
    factors = np.random.default_rng(0).uniform(0.2, 1, SMALL[::-1])
    made = compositor(flat_image_headset, context=theirs, panel=PanelLight(table(), factors))
    expected = shown(made, grey(99, np.uint8))[..., :3]
    with made.context.drawing():
        made.compose()
        other = made.context.target(SMALL, 4, "f1")
        again = made.compose().read()
    np.testing.assert_array_equal(again, expected)
    other.release()


@pytest.mark.parametrize("kind", ["planar", "flat image"])
def test_each_primary_shows_what_its_sub_pixel_sees(compositor: Make, flat_image_headset: Eye, kind: str) -> None:
    model = planar() if kind == "planar" else flat_image_headset
    offsets = np.array([[-1.0, 0.0], [0.0, 0.0], [0.0, 1.0]])
    plain, shifted = (compositor(model, panel=panel) for panel in (PanelLight(), PanelLight(sub_pixel_px=offsets)))
    alone, together = (composed(each, model).astype(int) for each in (plain, shifted))
    inner = together[2:-2, 2:-2]
    cut = slice(2, -2)
    for channel, rows, columns in ((0, cut, slice(1, -3)), (1, cut, cut), (2, slice(3, -1), cut)):
        difference = np.abs(inner[..., channel] - alone[rows, columns, channel])
        assert (difference <= 2).mean() > 0.99
        assert alone[..., channel].std() > 5
    assert (np.abs(inner[..., 0] - alone[2:-2, 2:-2, 0]) > 5).mean() > 0.02
    # The outermost sub-pixels lie up to a pixel beyond the panel, where the models still answer.
    assert (together[:, 0, 0] > 0).all()


def composed(made: Compositor, model: Eye) -> NDArray[np.uint8]:
    draw(made, SceneSource(made, scene()), HEAD, viewpoint(model))
    return made.compose().read()


def premultiplied(size: tuple[int, int]) -> Float32Array:
    """Light of 0.25 at an alpha of 0.25."""
    return np.full((size[1], size[0], 4), 0.25, np.float32)


def test_alpha_comes_out_filtered_and_0_beside_the_picture(compositor: Make, flat_image_headset: Eye) -> None:
    made = compositor(flat_image_headset, panel=PanelLight("linear"))
    pixels = shown(made, premultiplied, encoding="linear", alpha=True)
    assert (pixels[INSIDE] == 64).all()
    half = shown(
        made,
        lambda size: premultiplied(size) * (np.arange(size[0], dtype=np.float32) % 2)[:, None],
        encoding="linear",
        alpha=True,
    )
    np.testing.assert_array_equal(half[..., 3], half[..., 0])
    assert (half[INSIDE][..., 3] < 60).mean() > 0.3
    away = shown(made, premultiplied, AWAY, encoding="linear", alpha=True)
    assert {0, 64} <= set(np.unique(away[..., 3]))
    opaque = shown(made, premultiplied, AWAY, encoding="linear")
    assert (opaque[..., 3] == 255).all()


def test_alpha_of_bytes(compositor: Make, flat_image_headset: Eye) -> None:
    made = compositor([flat_image_headset] * 3)
    picture = np.array([10, 20, 30, 77], np.uint8)
    for alpha, expected in ((True, 77), (False, 255)):
        pixels = shown(made, lambda size: np.tile(picture, (*size[::-1], 1)), alpha=alpha)
        assert (pixels[INSIDE] == [10, 20, 30, expected]).all()


def test_eyes_have_their_own_panels(compositor: Make, flat_image_headset: Eye) -> None:
    dim = PanelLight(uniformity=np.full(SMALL[::-1], 0.5))
    made = compositor({"right": flat_image_headset}, panel={"right": dim, "left": PanelLight()})
    assert (shown(made, grey(255, np.uint8))[INSIDE][..., :3] == HALF_LIGHT).all()


NOT_FINITE = np.full((4, 3), np.nan)


@pytest.mark.parametrize(
    ("settings", "words"),
    [
        ({"encoding": "gamma"}, "encoding is 'gamma'"),
        ({"encoding": 0.0}, "encoding is 0"),
        ({"encoding": True}, "encoding is True"),
        ({"encoding": np.zeros((4, 2))}, "give 'srgb', 'linear'"),
        ({"encoding": NOT_FINITE}, "give 'srgb', 'linear'"),
        ({"encoding": table()[::-1]}, "for red in row 1: the light must rise"),
        ({"encoding": table() - 0.005}, "must rise from row to row, from 0"),
        ({"uniformity": np.full((4, 4), 1.5)}, "runs from 1.5 to 1.5"),
        ({"uniformity": np.full((4, 4), np.nan)}, "factors from 0 to 1"),
        ({"uniformity": np.ones((4, 4, 2))}, r"shape \(4, 4, 2\)"),
        ({"uniformity": 0.5}, "factors from 0 to 1"),
        ({"sub_pixel_px": np.zeros((3, 3))}, "display pixels from -1 to 1"),
        ({"sub_pixel_px": np.full((3, 2), 2.0)}, "display pixels from -1 to 1"),
        ({"bits": 12}, "bits is 12"),
    ],
)
def test_panels_that_cannot_be_are_refused(settings: dict[str, Any], words: str) -> None:
    with pytest.raises(BadInputError, match=words) as told:
        PanelLight(**settings)
    assert "\n" not in str(told.value)


def test_panels_of_another_size_are_refused(compositor: Make, flat_image_headset: Eye) -> None:
    for panel, words in (
        (PanelLight(uniformity=np.ones(SMALL)), "has 60 x 72 pixels, and its picture 72 x 60"),
        ("srgb", "panel of the right eye is 'srgb'; give a PanelLight"),
        ({"left": PanelLight()}, "panel of the right eye is None"),
    ):
        with pytest.raises(BadInputError, match=words):
            compositor(flat_image_headset, panel=panel)


@pytest.mark.parametrize(
    ("settings", "words"),
    [({"encoding": "gamma"}, "choose from srgb, linear"), ({"bits": 9}, "8, 10, 12, 16"), ({"alpha": 1}, "alpha is 1")],
)
def test_colours_that_cannot_be_are_refused(settings: Mapping[str, Any], words: str) -> None:
    with pytest.raises(BadInputError, match=words):
        StoredColour(**settings)


@pytest.mark.parametrize(
    ("colour", "stored", "words"),
    [
        (np.zeros((1, 1, 3), np.float64), LINEAR, "float32, not .* of float64"),
        (np.zeros((1, 1, 3), np.uint16), StoredColour(), "colours are uint16, and StoredColour has bits=8"),
        (np.zeros((1, 1, 3), np.uint8), DEEP, "colours are uint8, and StoredColour has bits=10"),
        (np.full((1, 1, 3), 1024, np.uint16), DEEP, "colours reach 1024, and codes of 10 bits 1023"),
        (np.full((1, 1, 3), np.nan, np.float32), LINEAR, "row 0, column 0 is not finite"),
        (np.zeros((1, 1, 3), np.float32), StoredColour(alpha=True), "no alpha"),
    ],
)
def test_pictures_of_other_colours_are_refused_and_change_nothing(
    made: Compositor, seen: FloatArray, colour: NDArray[Any], stored: StoredColour, words: str
) -> None:
    before = shown(made, grey(99, np.uint8))
    (camera,) = made.begin_frame(HEAD, seen).values()
    given = np.broadcast_to(colour, (*camera.size_px[::-1], 3))
    with pytest.raises(BadInputError, match=words):
        made.submit(given, np.ones(camera.size_px[::-1], np.float32), stored_colour=stored)
    np.testing.assert_array_equal(made.compose().read(), before[..., :3])
