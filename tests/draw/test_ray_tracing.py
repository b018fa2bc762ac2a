import numpy as np
import pytest
from gl_scenes import at, cube, lit, quad, unlit
from numpy.typing import NDArray

from wlr_render.draw import ray_tracing
from wlr_render.draw.ray_tracing import RayRenderer
from wlr_render.geometry import directions, transforms
from wlr_render.geometry.pinhole import Pinhole
from wlr_render.numerics.arrays import Float32Array, FloatArray
from wlr_render.numerics.srgb import decode_srgb, encode_srgb

TEXTURE = np.random.default_rng(4).integers(0, 256, (8, 8, 3)).astype(np.uint8)
SCENE = lit(
    (cube(), at(0.3, 0.2, -2.0, transforms.rotation_about("x", 0.5))),
    (quad((-2, -2), (2, 2), texture=TEXTURE), at(0, 0, -4)),
)


def pinhole_rays(height: int = 24, width: int = 32) -> tuple[Float32Array, Float32Array]:
    tx, ty = np.meshgrid(np.linspace(-0.7, 0.7, width), np.linspace(0.6, -0.6, height))
    direction = directions.dir_of_tangents(np.stack([tx, ty], axis=-1)).astype(np.float32)
    origin = np.zeros_like(direction) + np.linspace(0, 0.02, width, dtype=np.float32)[:, None] * [1, 0, 0]
    return origin.astype(np.float32), direction


def test_blocks_and_threads_change_no_bit(monkeypatch: pytest.MonkeyPatch) -> None:
    renderer = RayRenderer(SCENE)
    origin, direction = pinhole_rays()
    whole = renderer.render_rays(origin, direction, with_position=True, shadows=True)
    monkeypatch.setattr(ray_tracing, "_RAYS_PER_BLOCK", 32)
    cut = renderer.render_rays(origin, direction, with_position=True, shadows=True)
    for name in ("colour", "distance", "position"):
        np.testing.assert_array_equal(getattr(cut, name), getattr(whole, name), err_msg=name)


def test_rays_that_are_missing_show_the_background() -> None:
    renderer = RayRenderer(unlit((quad((-9, -9), (9, 9)), at(0, 0, -2)), background=(0.0, 0.25, 1.0)))
    _, direction = pinhole_rays()
    direction[5:9, 3:20] = np.nan
    image = renderer.render_rays(np.zeros(3), direction)
    assert (image.colour[5:9, 3:20] == encode_srgb(np.array([0, 0.25, 1], np.float32))).all()
    assert np.isinf(image.distance[5:9, 3:20]).all()
    assert (image.colour[:5] == 255).all()
    assert np.isfinite(image.distance[9:]).all()


def test_pixels_that_differ_become_means_in_linear_light() -> None:
    white = quad((-9, -9), (0, 9), base_colour=np.ones(3, np.float32))
    renderer = RayRenderer(unlit((white, at(0, 0, -2)), background=(0.1, 0.2, 0.4)))
    left, right = np.array([-0.3, 0.0, -1.0], np.float32), np.array([0.3, 0.0, -1.0], np.float32)
    asked: list[int] = []

    def rays_within(pixel: NDArray[np.intp]) -> tuple[Float32Array, Float32Array]:
        asked.extend(pixel)
        return np.zeros(3, np.float32), np.tile([left, right, right, right], (len(pixel), 1))

    colour = np.tile(encode_srgb(np.array([0.1, 0.2, 0.4], np.float32)), (3, 6, 1))
    colour[:, :2] = 255
    renderer.refine(colour, 4, rays_within)
    # Means differ from their neighbours in turn, so that in the end no pixel is as it was; none is drawn twice.
    assert sorted(asked) == list(range(18))
    mean = 0.25 * np.ones(3) + 0.75 * np.array([0.1, 0.2, 0.4])
    assert (colour == encode_srgb(mean.astype(np.float32))).all()


def test_pixels_like_their_neighbours_keep_their_single_ray() -> None:
    # Those on either side of a pixel differ by 16 codes.
    colour = np.tile(np.uint8(100) + 8 * np.arange(6, dtype=np.uint8)[:, None], (3, 1, 3))
    colour[1:] += 8
    before = colour.copy()
    RayRenderer(SCENE).refine(colour, 4, lambda pixel: pytest.fail(f"{pixel} are like their neighbours."))
    np.testing.assert_array_equal(colour, before)


def test_a_thin_line_is_whole_where_single_rays_miss_it() -> None:
    # A tenth of a pixel wide, and one column to the right after sixty rows.
    camera, count = Pinhole(40, 120, np.array([-0.2, -0.6]), np.array([0.2, 0.6])), 16
    turn = transforms.rotation_about("z", np.arctan(1 / 60))
    renderer = RayRenderer(unlit((quad((-0.001, -9), (0.001, 9)), at(0.013, 0, -2, turn))))
    steps = (np.arange(count) + 0.5) / count - 0.5
    offsets = np.stack(np.meshgrid(steps, steps), axis=-1).reshape(-1, 2)

    def towards(pixel: FloatArray) -> Float32Array:
        tangents = camera.tangents_of_pixel(pixel).reshape(-1, 2)
        return np.concatenate([tangents, -np.ones((len(tangents), 1))], axis=1).astype(np.float32)

    def rays_within(pixel: NDArray[np.intp]) -> tuple[Float32Array, Float32Array]:
        centre = np.stack([pixel % 40, pixel // 40], axis=-1) + 0.5
        return np.zeros(3, np.float32), towards(np.asarray(centre[:, None] + offsets, np.float64))

    centres = np.asarray(np.moveaxis(np.indices((120, 40))[::-1], 0, -1) + 0.5, np.float64)
    colour = renderer.render_rays(np.zeros(3), towards(centres).reshape(120, 40, 3)).colour
    assert 0 < (colour.max(axis=(1, 2)) > 0).sum() < 20
    renderer.refine(colour, count**2, rays_within)
    np.testing.assert_allclose(decode_srgb(colour[..., 1]).sum(axis=1), 0.1, atol=0.04)
