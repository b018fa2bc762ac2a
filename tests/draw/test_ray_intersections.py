import numpy as np
import pytest
from gl_scenes import at, cube, quad, unlit

from wlr_render.draw import ray_intersections
from wlr_render.draw.ray_intersections import SceneTracer
from wlr_render.geometry import directions, transforms
from wlr_render.numerics.arrays import Float32Array, FloatArray
from wlr_render.scene.scene import Mesh, Scene, world_positions


def squashed(x: float, y: float, z: float) -> FloatArray:
    """A pose that turns, and scales each axis differently."""
    matrix = at(x, y, z, transforms.rotation_about("y", 0.4))
    matrix[:3, :3] = matrix[:3, :3] @ np.diag([0.5, 1.5, 0.8])
    return matrix


def some_rays(count: int = 2000, seed: int = 1) -> tuple[Float32Array, Float32Array]:
    """Rays from a small box around the origin that look forwards; float32 values, so that nothing is rounded."""
    rng = np.random.default_rng(seed)
    origin = rng.uniform(-0.1, 0.1, (count, 3)).astype(np.float32)
    tangents = rng.uniform(-0.6, 0.6, (count, 2))
    return origin, directions.dir_of_tangents(tangents).astype(np.float32)


BOX = cube()
SCENE = unlit(
    (BOX, at(0.3, 0.2, -2.0, transforms.rotation_about("x", 0.3))),
    (BOX, squashed(-0.7, -0.1, -2.5)),
    (quad((-5, -5), (5, 5)), at(0, 0, -4)),
)


def brute_force(scene: Scene, origin: FloatArray, direction: FloatArray) -> FloatArray:
    """Every ray against every triangle in float64 (Moller and Trumbore 1997): distance, instance, triangle, u, v."""
    best = np.full((5, len(direction)), -1.0)
    best[0] = np.inf
    for number, instance in enumerate(scene.instances):
        mesh = scene.mesh_of(instance)
        for index, (a, b, c) in enumerate(world_positions(mesh, instance)[mesh.triangles]):
            p = np.cross(direction, c - a)
            determinant = p @ (b - a)
            from_a = origin - a
            u = np.sum(from_a * p, axis=1) / determinant
            q = np.cross(from_a, b - a)
            v = np.sum(direction * q, axis=1) / determinant
            distance = q @ (c - a) / determinant
            nearer = (u >= 0) & (v >= 0) & (u + v <= 1) & (distance > 0) & (distance < best[0])
            best[:, nearer] = np.stack([distance, 0 * u + number, 0 * u + index, u, v])[:, nearer]
    return best


def test_hits_are_those_of_every_triangle_tried() -> None:
    origin, direction = some_rays()
    hits = SceneTracer(SCENE).intersect(origin, direction)
    distance, instance, triangle, u, v = brute_force(SCENE, origin.astype(float), direction.astype(float))
    assert (instance == 0).sum() > 50
    assert (instance == 1).sum() > 50
    # A ray within float32 of an edge may go to either side of it.
    clear = (np.minimum(np.minimum(u, v), 1 - u - v) > 1e-5) | (instance < 0)
    assert clear.mean() > 0.99
    np.testing.assert_array_equal(hits.instance[clear], instance[clear])
    np.testing.assert_array_equal(hits.triangle[clear], triangle[clear])
    np.testing.assert_allclose(hits.distance[clear], distance[clear], rtol=2e-5)
    np.testing.assert_allclose(hits.barycentric_u[clear], u[clear], atol=2e-5)
    np.testing.assert_allclose(hits.barycentric_v[clear], v[clear], atol=2e-5)


def test_distance_is_in_lengths_of_the_direction() -> None:
    tracer = SceneTracer(unlit((quad((-9, -9), (9, 9)), at(0, 0, -3))))
    hits = tracer.intersect(np.zeros(3), [[0.2, 0.1, -1.0], [0.4, 0.2, -2.0]])
    np.testing.assert_allclose(hits.distance, [3.0, 1.5], rtol=1e-6)


@pytest.mark.parametrize("shape", [(), (1,), (3, 1, 2)])
def test_any_leading_shape(shape: tuple[int, ...]) -> None:
    origin, direction = some_rays(max(1, int(np.prod(shape))))
    tracer = SceneTracer(SCENE)
    flat = tracer.intersect(origin, direction)
    origin, direction = origin.reshape(*shape, 3), direction.reshape(*shape, 3)
    hits = tracer.intersect(origin, direction)
    assert hits.distance.shape == hits.triangle.shape == shape
    np.testing.assert_array_equal(hits.instance, flat.instance.reshape(shape))
    assert tracer.occluded(origin, direction, 9.0).shape == shape


def test_one_origin_serves_all_directions() -> None:
    _, direction = some_rays(50)
    tracer = SceneTracer(SCENE)
    origin = np.array([0.05, 0.0, 0.0], np.float32)
    shared = tracer.intersect(origin, direction)
    repeated = tracer.intersect(np.tile(origin, (50, 1)), direction)
    np.testing.assert_array_equal(shared.distance, repeated.distance)


@pytest.mark.parametrize("bad", [np.nan, np.inf, -np.inf])
def test_rays_that_are_not_finite_miss_and_leave_the_others_alone(bad: float) -> None:
    origin, direction = some_rays(300)
    tracer = SceneTracer(SCENE)
    clean = tracer.intersect(origin, direction)
    blocked = tracer.occluded(origin, direction, np.inf)
    origin[::3, 1] = bad
    direction[1::3, 2] = bad
    hits = tracer.intersect(origin, direction)
    np.testing.assert_array_equal(hits.instance[2::3], clean.instance[2::3])
    np.testing.assert_array_equal(hits.distance[2::3], clean.distance[2::3])
    for start in (0, 1):
        assert (hits.instance[start::3] == -1).all()
        assert (hits.triangle[start::3] == -1).all()
        assert np.isinf(hits.distance[start::3]).all()
    still = tracer.occluded(origin, direction, np.inf)
    np.testing.assert_array_equal(still[2::3], blocked[2::3])
    assert not still[0::3].any()
    assert not still[1::3].any()


def test_the_last_hit_of_a_ray_occludes_what_lies_beyond_it_only() -> None:
    origin, direction = some_rays()
    tracer = SceneTracer(SCENE)
    distance = tracer.intersect(origin, direction).distance
    hit = np.isfinite(distance)
    np.testing.assert_array_equal(tracer.occluded(origin, direction, np.inf), hit)
    assert tracer.occluded(origin, direction, distance * 1.001)[hit].all()
    assert not tracer.occluded(origin, direction, np.where(hit, distance * 0.999, 1.0)).any()


def test_no_ray_slips_through_an_edge() -> None:
    # A closed tent around the origin with many edges, and rays from within aimed at the middles of those.
    angle = np.linspace(0, 2 * np.pi, 400, endpoint=False)
    ring = np.stack([np.cos(angle), np.sin(angle), 0 * angle], axis=1)
    position = np.concatenate([ring, [[0.1, 0.2, 0.9], [0.0, -0.1, -0.8]]]).astype(np.float32)
    here, there = np.arange(400), (np.arange(400) + 1) % 400
    sides = [np.stack([here, there, np.full(400, tip)], axis=1) for tip in (400, 401)]
    normal = directions.normalised(position.astype(float)).astype(np.float32)
    tent = Mesh("tent", position, normal, np.concatenate(sides).astype(np.uint32))
    aim = [position[here] + position[there]] + [position[here] + position[tip] for tip in (400, 401)]
    hits = SceneTracer(unlit((tent, np.eye(4)))).intersect(np.zeros(3), np.concatenate(aim))
    assert (hits.instance == 0).all()


def test_blocks_and_threads_change_nothing(monkeypatch: pytest.MonkeyPatch) -> None:
    origin, direction = some_rays(3000)
    direction[::50] = np.nan
    tracer = SceneTracer(SCENE)
    whole = tracer.intersect(origin, direction)
    monkeypatch.setattr(ray_intersections, "_RAYS_PER_BLOCK", 37)
    cut = tracer.intersect(origin, direction)
    for name in ("distance", "instance", "triangle", "barycentric_u", "barycentric_v"):
        np.testing.assert_array_equal(getattr(cut, name), getattr(whole, name))


def test_no_rays_and_no_instances() -> None:
    assert SceneTracer(SCENE).intersect(np.zeros((0, 3)), np.zeros((0, 3))).distance.shape == (0,)
    assert SceneTracer(unlit()).intersect(np.zeros(3), [[0.0, 0.0, -1.0]]).instance.tolist() == [-1]
