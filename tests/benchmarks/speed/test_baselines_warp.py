"""The fixed warps put the picture where their maps say, each colour by its own."""

from collections.abc import Callable

import numpy as np
import pytest
from numpy.typing import ArrayLike, NDArray

from benchmarks.speed.baselines_warp import GlWarpBaseline, mesh_warp, remap_warp, timewarp
from benchmarks.speed.frozen_map import bilinear, on_triangles
from wlr_render.geometry import directions, transforms
from wlr_render.geometry.pinhole import Pinhole
from wlr_render.numerics.arrays import Float32Array, FloatArray

SIZE = (72, 56)
POINTS = 5
LEVELS = 2  # of 255: the picture and the result are rounded


@pytest.fixture(scope="module")
def picture() -> NDArray[np.uint8]:
    """Its colour is its texture coordinate: red u, green v, blue their mean."""
    u, v = np.meshgrid((np.arange(256) + 0.5) / 256, (np.arange(200) + 0.5) / 200)
    return np.round(np.stack([u, v, 0.5 * (u + v)], axis=-1) * 255).astype(np.uint8)


@pytest.fixture(scope="module")
def channel_uv() -> Float32Array:
    """Maps of three colours so coarse and so curved that it shows how they are interpolated."""
    x, y = np.meshgrid(np.linspace(0, 1, POINTS), np.linspace(0, 1, POINTS))
    bent = np.stack([0.1 + 0.7 * x + 0.15 * np.sin(5 * x * y), 0.15 + 0.6 * y + 0.15 * np.cos(9 * x * y)], axis=-1)
    return np.stack([bent, bent[:, ::-1], bent[::-1]]).astype(np.float32)


def place_of_pixels() -> FloatArray:
    """Display pixel centres in cells of the map, (height, width, 2)."""
    x, y = ((np.arange(count) + 0.5) / count * (POINTS - 1) for count in SIZE)
    return np.stack(np.meshgrid(x, y), axis=-1)


def colour_at(uv: FloatArray) -> FloatArray:
    """What the picture shows at texture coordinates (3, height, width, 2), 0..255."""
    return np.stack([uv[0, ..., 0], uv[1, ..., 1], uv[2].mean(axis=-1)], axis=-1) * 255


def drawn_by(baseline: GlWarpBaseline) -> FloatArray:
    baseline.draw()
    try:
        return baseline.read()[..., :3].astype(float)
    finally:
        baseline.release()


def opened(make: Callable[..., GlWarpBaseline], *args: ArrayLike) -> GlWarpBaseline:
    try:
        return make(*args)
    except Exception as error:  # glcontext raises bare Exception where there is no EGL
        pytest.skip(f"no OpenGL 4.3 by EGL: {error}")


@pytest.mark.gl
def test_a_mesh_interpolates_each_colour_over_its_triangles(
    picture: NDArray[np.uint8], channel_uv: Float32Array
) -> None:
    place = place_of_pixels()
    expected, other = (
        colour_at(np.stack([between(uv.astype(float), place) for uv in channel_uv]))
        for between in (on_triangles, bilinear)
    )
    drawn = drawn_by(opened(mesh_warp, picture, channel_uv, SIZE))
    assert drawn.shape == (56, 72, 3)
    assert np.abs(drawn - expected).max() <= LEVELS
    assert np.abs(drawn - other).max() > 3 * LEVELS


def test_timewarp_turns_directions() -> None:
    """A direction of the newer camera, turned into the older one's frame, lies where the matrix puts it."""
    camera = Pinhole(640, 480, np.array([-0.7, -0.4]), np.array([0.5, 0.6]))
    drawn_from_newer = transforms.rotation_about("y", 0.05) @ transforms.rotation_about("x", -0.03)
    tangents = np.random.default_rng(4).uniform(-0.4, 0.4, (20, 2))
    turned = directions.tangents_of_dir(transforms.rotate(drawn_from_newer, directions.dir_of_tangents(tangents)))
    newer, drawn = (camera.pixel_of_tangents(each) / [640, 480] for each in (tangents, turned))
    found = np.concatenate([newer, np.ones((20, 1))], axis=-1) @ timewarp(camera, drawn_from_newer).T
    np.testing.assert_allclose(found[:, :2] / found[:, 2:], drawn, atol=1e-12)


def test_remap_counts_from_the_pictures_outer_corner(picture: NDArray[np.uint8]) -> None:
    """A map to each pixel's own centre gives the picture back; one half a pixel aside, the mean of two."""
    height, width = picture.shape[:2]
    own = np.stack(np.meshgrid(np.arange(width) + 0.5, np.arange(height) + 0.5), axis=-1).astype(np.float32)
    np.testing.assert_array_equal(remap_warp(picture, own)(), picture)
    aside = remap_warp(picture, own + np.array([0.5, 0], np.float32))()[:, :-1].astype(float)
    mean = 0.5 * (picture[:, :-1].astype(float) + picture[:, 1:])
    assert np.abs(aside - mean).max() <= 0.51
