"""Disoccluded pixels against the closed form."""

import numpy as np
from gl_scenes import at, quad, unlit

from benchmarks.raster.disocclusion import disoccluded, hit_positions
from wlr_render.draw.ray_intersections import SceneTracer
from wlr_render.geometry import directions, transforms
from wlr_render.warp.ray_map import RayMap

HEAD = transforms.rigid(transforms.rotation_about("y", 0.7), np.array([1.0, 1.6, -0.2]))
EYE = np.array([0.03, 0.0, -0.02])


def test_disocclusion_behind_an_edge_is_the_closed_form() -> None:
    # A sheet 1 m away reaches from the left to the middle; the wall behind it is 4 m away, and ends at x = 2 m.
    eye_from_scene = transforms.rigid(np.eye(3), EYE)
    sheet = (quad((-9, -9), (0, 9)), HEAD @ eye_from_scene @ at(0, 0, -1))
    wall = (quad((-9, -9), (2, 9)), HEAD @ eye_from_scene @ at(0, 0, -4))
    tracer = SceneTracer(unlit(sheet, wall))
    tangents = np.linspace(-0.7, 0.7, 281)[None] + 1e-4
    zero = np.zeros_like(tangents)
    field = RayMap(EYE, np.eye(3), np.stack([tangents, zero, zero, zero]).astype(np.float32), zero.astype(np.uint8))
    hits = tracer.intersect(*(rays.reshape(1, 281, 3) for rays in field.world_rays(HEAD)))
    position = hit_positions(tracer, hits, *(rays.reshape(1, 281, 3) for rays in field.world_rays(HEAD)))
    for aside in (-0.05, 0.05):
        camera = transforms.apply(HEAD, EYE + [aside, 0, 0])
        # Rays that pass right of the sheet meet the wall at 4 t, or nothing beyond 2 m; from the camera the sheet
        # covers the wall up to x = aside + 4 (0 - aside), and nothing in directions up to t = -aside.
        t = tangents[0]
        on_wall = (t > 0) & (4 * t < 2)
        expected = on_wall & (4 * t < -3 * aside)
        np.testing.assert_array_equal(disoccluded(tracer, camera, field, HEAD, position)[0][t < 0.5], expected[t < 0.5])
        # Where nothing is met, the wall itself hides it from a camera to the right, which sees it end at a larger t.
        np.testing.assert_array_equal(
            disoccluded(tracer, camera, field, HEAD, position)[0][t > 0.5], (t < (2 - aside) / 4)[t > 0.5]
        )


def test_hit_positions_lie_on_the_plane_and_on_the_ray_in_float64() -> None:
    rng = np.random.default_rng(3)
    origin = rng.uniform(-0.1, 0.1, (500, 3))
    direction = directions.dir_of_tangents(rng.uniform(-0.6, 0.6, (500, 2)))
    normal = transforms.rotation_about("y", 0.6)[:, 2]
    tracer = SceneTracer(unlit((quad((-9, -9), (9, 9)), at(0.1, 0.2, -3, transforms.rotation_about("y", 0.6)))))
    hits = tracer.intersect(origin, direction)
    position = hit_positions(tracer, hits, origin, direction)
    distance = (([0.1, 0.2, -3] - origin) @ normal) / (direction @ normal)
    np.testing.assert_allclose(position, origin + distance[:, None] * direction, atol=1e-12)
    # What float32 alone gives is far from that.
    assert np.abs(hits.distance - distance).max() > 1e-8


def test_a_ray_that_misses_has_no_hit_position() -> None:
    tracer = SceneTracer(unlit((quad((-1, -1), (1, 1)), at(0, 0, -2))))
    direction = np.array([[[0.1, 0.2, -1.0], [3.0, 0.0, -1.0]]])
    position = hit_positions(tracer, tracer.intersect(np.zeros(3), direction), np.zeros(3), direction)
    np.testing.assert_allclose(position, [[[0.2, 0.4, -2.0], [np.nan] * 3]], atol=1e-12)
