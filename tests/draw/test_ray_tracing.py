import numpy as np
import pytest
from gl_scenes import at, cube, lit, quad, unlit

from wlr_render.draw import ray_tracing
from wlr_render.draw.ray_tracing import RayRenderer
from wlr_render.errors import BadInputError
from wlr_render.geometry import directions, transforms
from wlr_render.numerics.arrays import Float32Array
from wlr_render.numerics.srgb import encode_srgb

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


def test_rays_are_requested_row_by_row() -> None:
    renderer = RayRenderer(SCENE)
    origin, direction = pinhole_rays()

    def rays_of_rows(rows: slice) -> tuple[Float32Array, Float32Array]:
        return origin[rows].reshape(-1, 3), direction[rows].reshape(-1, 3)

    asked = renderer.render_blocks(direction.shape[:2], rays_of_rows)
    np.testing.assert_array_equal(asked.colour, renderer.render_rays(origin, direction).colour)


def test_supersampling_is_the_mean_in_linear_light() -> None:
    white = quad((-9, -9), (0, 9), base_colour=np.ones(3, np.float32))
    renderer = RayRenderer(unlit((white, at(0, 0, -2)), background=(0.1, 0.2, 0.4)))
    left, right = np.array([[-0.3, 0.0, -1.0]], np.float32), np.array([[0.3, 0.0, -1.0]], np.float32)
    origin = np.zeros(3, np.float32)
    samples = ((lambda rows, d=d: (origin, d)) for d in (left, right, right, right))
    colour = renderer.render_supersampled((1, 1), samples)
    mean = 0.25 * np.ones(3) + 0.75 * np.array([0.1, 0.2, 0.4])
    np.testing.assert_array_equal(colour[0, 0], encode_srgb(mean.astype(np.float32)))
    assert (renderer.render_supersampled((1, 1), [lambda rows: (origin, left)]) == 255).all()
    with pytest.raises(BadInputError, match="at least one"):
        renderer.render_supersampled((1, 1), [])
