from collections.abc import Sequence
from typing import Any

import numpy as np
import pytest
from gl_scenes import at, cube, quad, unlit
from numpy.typing import ArrayLike, NDArray
from present import present

from wlr_render.draw.ray_intersections import SceneTracer
from wlr_render.draw.shading import Shaded, Surfaces, shade
from wlr_render.geometry import transforms
from wlr_render.numerics.arrays import Float32Array, FloatArray
from wlr_render.numerics.srgb import decode_srgb
from wlr_render.scene.scene import Instance, LightSource, Mesh, Scene, world_positions

FORWARDS = (0.0, 0.0, -1.0)
WALL = (quad((-9, -9), (9, 9)), at(0, 0, -2))


def scene_of(*placed: tuple[Mesh, FloatArray], lights: Sequence[LightSource] = (), ambient: float = 0.0) -> Scene:
    bare = unlit(*placed)
    return Scene("test", bare.meshes, bare.instances, tuple(lights), np.full(3, ambient, np.float32))


def shine(kind: str, vector: ArrayLike, colour: tuple[float, float, float] = (1.0, 1.0, 1.0)) -> LightSource:
    return LightSource(kind, np.array(vector, float), np.array(colour, np.float32))


def shaded(
    scene: Scene, direction: ArrayLike, origin: tuple[float, float, float] = (0.0, 0.0, 0.0), shadows: bool = False
) -> Shaded:
    """Shading of rays (n, 3)."""
    direction = np.atleast_2d(np.asarray(direction, np.float32))
    origins = np.broadcast_to(np.asarray(origin, np.float32), direction.shape)
    tracer = SceneTracer(scene)
    hits = tracer.intersect(origins, direction)
    return shade(scene, Surfaces.of(scene), hits, origins, direction, tracer if shadows else None)


def colour_seen(scene: Scene, direction: ArrayLike = FORWARDS, **how: Any) -> Float32Array:
    return shaded(scene, direction, **how).colour.T


def towards(point: ArrayLike) -> FloatArray:
    return np.asarray(np.asarray(point, float) / np.linalg.norm(point))


@pytest.mark.parametrize("angle", [0.0, 0.5, 1.2, 2.0])
def test_lambert_cosine_of_a_directional_light(angle: float) -> None:
    travels = [0.0, -np.sin(angle), -np.cos(angle)]
    scene = scene_of(WALL, lights=[shine("directional", travels, (1.0, 0.5, 0.25))], ambient=0.125)
    expected = 0.125 + np.array([1.0, 0.5, 0.25]) * max(0.0, np.cos(angle))
    np.testing.assert_allclose(colour_seen(scene), [expected], atol=1e-6)


def test_point_light_falls_with_the_square_of_the_distance_and_with_the_cosine() -> None:
    scene = scene_of(WALL, lights=[shine("point", (3.0, 0.0, 2.0), (50.0, 50.0, 50.0))])
    # 5 m away, 4 of them along the normal.
    np.testing.assert_allclose(colour_seen(scene), 50 / 25 * 4 / 5, rtol=1e-6)


def test_both_sides_are_lit_as_the_viewer_sees_them() -> None:
    lights = [shine("directional", (0, 0, -1))]
    front = scene_of(WALL, lights=lights)
    turned = scene_of((WALL[0], at(0, 0, -2, transforms.rotation_about("y", np.pi))), lights=lights)
    np.testing.assert_allclose(colour_seen(front), colour_seen(turned), atol=1e-6)
    # From behind, the light is on the other side.
    np.testing.assert_allclose(colour_seen(front, (0, 0, 1), origin=(0, 0, -5)), 0, atol=1e-6)


def test_normals_of_a_squashed_mesh_go_by_the_inverse_transpose() -> None:
    squash = at(0, 0, -3)
    squash[:3, :3] = np.diag([1.0, 0.25, 1.0])
    slope = quad((-1, -1), (1, 1))
    slope = Mesh(
        "slope",
        slope.position @ transforms.rotation_about("x", -np.pi / 4).T.astype(np.float32),
        slope.normal @ transforms.rotation_about("x", -np.pi / 4).T.astype(np.float32),
        slope.triangles,
    )
    result = shaded(scene_of((slope, squash)), FORWARDS)
    corners = world_positions(slope, Instance("", 0, squash))
    across = np.cross(corners[1] - corners[0], corners[3] - corners[0])
    assert abs(towards(across) @ result.normal[:, 0]) == pytest.approx(1, abs=1e-6)
    assert result.normal[2, 0] > 0


def test_interpolated_normals_are_unit_and_smooth() -> None:
    bent = quad((-1, -1), (1, 1))
    normal = np.array([[-1, 0, 1], [1, 0, 1], [1, 0, 1], [-1, 0, 1]], np.float32) / np.sqrt(2)
    bent = Mesh("bent", bent.position, normal.astype(np.float32), bent.triangles)
    x = np.linspace(-0.9, 0.9, 7)
    rays = np.stack([x, 0.3 + 0 * x, -2 + 0 * x], axis=1)
    result = shaded(scene_of((bent, at(0, 0, -2))), rays)
    expected = np.stack([x, 0 * x, 1 + 0 * x]) / np.hypot(x, 1)
    np.testing.assert_allclose(result.normal, expected, atol=1e-6)
    np.testing.assert_allclose(result.position.T, rays, atol=1e-6)


def picture(height: int = 4, width: int = 8, seed: int = 0) -> NDArray[np.uint8]:
    return np.random.default_rng(seed).integers(0, 256, (height, width, 3)).astype(np.uint8)


def bilinear_texture(texture: NDArray[np.uint8], uv: FloatArray) -> FloatArray:
    """Plain bilinear lookup of a repeated texture in linear light."""
    height, width = texture.shape[:2]
    linear = decode_srgb(texture).astype(float)
    x, y = uv[0] * width - 0.5, uv[1] * height - 0.5
    column, row = int(np.floor(x)), int(np.floor(y))
    total = np.zeros(3)
    for i, down in ((row, row + 1 - y), (row + 1, y - row)):
        for j, across in ((column, column + 1 - x), (column + 1, x - column)):
            total += down * across * linear[i % height, j % width]
    return total


def test_texture_repeats_and_is_mixed_in_linear_light() -> None:
    texture = picture()
    wall = quad((-1, -1), (1, 1))
    uv_3_times = (present(wall.uv) * 3 - 1.3).astype(np.float32)
    wall = Mesh("wall", wall.position, wall.normal, wall.triangles, uv=uv_3_times, texture=texture)
    xy = np.random.default_rng(5).uniform(-0.99, 0.99, (200, 2))
    seen = colour_seen(scene_of((wall, at(0, 0, -1)), ambient=1.0), np.column_stack([xy, -np.ones(200)]))
    uv = np.stack([(xy[:, 0] + 1) / 2, (1 - xy[:, 1]) / 2], axis=1) * 3 - 1.3
    np.testing.assert_allclose(seen, [bilinear_texture(texture, place) for place in uv], atol=2e-5)


def test_each_instance_has_the_material_of_its_mesh() -> None:
    textured = quad(
        (-1, -1), (1, 1), texture=np.full((2, 2, 3), 188, np.uint8), base_colour=np.array([1, 0.5, 1], np.float32)
    )
    other = quad((-1, -1), (1, 1), texture=np.full((5, 3, 3), 99, np.uint8))
    plain = quad((-1, -1), (1, 1), base_colour=np.array([0.1, 0.2, 0.3], np.float32))
    coloured = quad((-1, -1), (1, 1), vertex_colour=np.array([[1, 0, 0]] * 4, np.float32))
    row = (textured, other, plain, coloured, textured)
    scene = scene_of(*[(mesh, at(3.0 * k, 0, -2)) for k, mesh in enumerate(row)], ambient=1.0)
    seen = colour_seen(scene, [[3.0 * k + 0.2, 0.1, -2] for k in range(5)])
    light, dark = decode_srgb(np.array([188, 99], np.uint8))
    first = light * np.array([1, 0.5, 1])
    np.testing.assert_allclose(seen, [first, [dark] * 3, [0.1, 0.2, 0.3], [1, 0, 0], first], atol=1e-6)


def test_vertex_colours_are_interpolated() -> None:
    colours = np.array([[1, 0, 0], [0, 1, 0], [0, 0, 1], [0, 0, 0]], np.float32)
    wall = quad((-1, -1), (1, 1), vertex_colour=colours)
    seen = colour_seen(scene_of((wall, at(0, 0, -1)), ambient=1.0), [[0.0, 0.5, -1.0]])
    # (0, 0.5) is half the upper left corner, a quarter of the upper right and a quarter of the lower right one.
    np.testing.assert_allclose(seen, [[0.5, 0.25, 0.25]], atol=1e-6)


BLOCKER = (quad((-0.5, -0.5), (0.5, 0.5)), at(1.0, 0, -1))


@pytest.mark.parametrize(
    ("light", "is_dark"),
    [
        (shine("directional", towards((-1.0, 0.0, -1.0))), True),
        (shine("directional", towards((1.0, 0.0, -1.0))), False),
        (shine("point", (2.0, 0.0, 0.0)), True),
        (shine("point", (0.5, 0.0, -1.5)), False),
    ],
    ids=["behind the blocker", "beside it", "point behind", "point before"],
)
def test_shadows(light: LightSource, is_dark: bool) -> None:
    scene = scene_of(WALL, BLOCKER, lights=[light], ambient=0.01)
    without = colour_seen(scene)[0, 0]
    assert without > 0.02
    assert colour_seen(scene, shadows=True)[0, 0] == pytest.approx(0.01 if is_dark else without)


def test_a_convex_body_casts_no_shadow_on_its_lit_faces() -> None:
    turn = transforms.rotation_about("y", 0.5) @ transforms.rotation_about("x", 0.6)
    scene = scene_of((cube(), at(0, 0, -3, turn)), lights=[shine("directional", towards((-0.3, -0.4, -1)))])
    x, y = np.meshgrid(np.linspace(-0.2, 0.2, 40), np.linspace(-0.2, 0.2, 40))
    rays = np.stack([x, y, -1 + 0 * x], axis=-1).reshape(-1, 3)
    np.testing.assert_array_equal(colour_seen(scene, rays, shadows=True), colour_seen(scene, rays))


def test_rays_that_miss_are_left_out() -> None:
    result = shaded(scene_of((quad((-1, -1), (1, 1)), at(0, 0, -2))), [FORWARDS, (0, 0, 1), (0.1, 0, -1)])
    assert result.index.tolist() == [0, 2]
    assert result.colour.shape == result.normal.shape == result.position.shape == (3, 2)
