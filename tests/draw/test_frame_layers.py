"""Layers of a frame against closed forms, and against what the rasterised frame shows."""

from collections.abc import Mapping

import numpy as np
import pytest
from gl_scenes import at, cube, lit, quad, unlit
from hardware import allowed, snap_arcmin
from numpy.typing import NDArray
from present import present

from wlr_render.draw.frame_layers import INSTANCE, LAYERS, Layer, frame_layers
from wlr_render.draw.painters import TracedPainter
from wlr_render.draw.raster_painter import WarpedPainter
from wlr_render.draw.ray_tracing import RayRenderer
from wlr_render.draw.scene_raster import SceneRaster
from wlr_render.geometry import directions, rays, transforms
from wlr_render.gl.context import GlContext
from wlr_render.mappings import Eye
from wlr_render.numerics.arrays import Float32Array, FloatArray
from wlr_render.numerics.srgb import decode_srgb
from wlr_render.scene.scene import Scene
from wlr_render.scene.shapes import construction
from wlr_render.warp.ray_map import choose_plan, ray_map

OFF_CENTRE = np.array([0.7, -0.9, 0.8])
HEAD_POSE = at(0.1, 1.5, 0.3, transforms.rotation_about("y", 0.5) @ transforms.rotation_about("x", -0.1))


def vectors(channels: Mapping[str, Float32Array | NDArray[np.uint32]], name: str, axes: str = "XYZ") -> FloatArray:
    return np.stack([channels[f"{name}.{axis}"] for axis in axes], axis=-1).astype(float)


def layers_of(
    headset: Eye, scene: Scene, viewpoint: FloatArray, layers: tuple[Layer, ...] = LAYERS
) -> dict[str, Float32Array | NDArray[np.uint32]]:
    rays_of_pixels = ray_map(headset, viewpoint, choose_plan(headset))
    return frame_layers(RayRenderer(scene), rays_of_pixels, HEAD_POSE, layers)


def exact_rays(headset: Eye, viewpoint: FloatArray) -> tuple[FloatArray, FloatArray]:
    """World origins and unit directions of all pixels, from the mappings."""
    view_dir = headset.display.view_dir_of_pixel(headset.display.panel.pixel_centres(), viewpoint).value
    return rays.split(rays.transformed(HEAD_POSE, headset.see_through.real_ray_of_view_dir(view_dir, viewpoint).value))


def test_a_tilted_plane_has_the_depth_position_and_normal_of_the_closed_form(toy_headset: Eye) -> None:
    viewpoint, turn = toy_headset.eye_box.at(OFF_CENTRE), transforms.rotation_about("y", 0.4)
    world_from_wall = HEAD_POSE @ at(0.2, 0.1, -2.5, turn)
    channels = layers_of(toy_headset, unlit((quad((-9, -9), (9, 9)), world_from_wall)), viewpoint)
    origin, direction = exact_rays(toy_headset, viewpoint)
    normal, middle = world_from_wall[:3, 2], world_from_wall[:3, 3]
    along = ((middle - origin) @ normal) / (direction @ normal)
    point = origin + along[..., None] * direction
    np.testing.assert_allclose(vectors(channels, "position"), point, atol=1e-5)
    np.testing.assert_allclose(vectors(channels, "normal"), np.broadcast_to(normal, point.shape), atol=1e-6)
    in_device = transforms.apply(transforms.inverse(HEAD_POSE), point)
    np.testing.assert_allclose(channels["depth.Z"], viewpoint[2] - in_device[..., 2], atol=1e-5)
    np.testing.assert_allclose(channels["depth.distance"], np.linalg.norm(in_device - viewpoint, axis=-1), atol=1e-5)
    assert (channels[INSTANCE] == 1).all()
    # The ray passes beside the viewpoint, and looks in other directions than -z: the two depths are not the same.
    assert (channels["depth.distance"] - channels["depth.Z"]).max() > 0.1


def test_a_sphere_has_its_analytic_points_and_normals(toy_headset: Eye) -> None:
    viewpoint, radius = toy_headset.eye_box.centre, 0.3
    world_from_ball = HEAD_POSE @ at(0.05, 0.02, -1.2)
    channels = layers_of(toy_headset, unlit((construction.sphere(radius, segments=400), world_from_ball)), viewpoint)
    origin, direction = exact_rays(toy_headset, viewpoint)
    to_centre = world_from_ball[:3, 3] - origin
    along = np.sum(to_centre * direction, axis=-1)
    missed_by = np.linalg.norm(to_centre - along[..., None] * direction, axis=-1)
    inside, outside = missed_by < 0.95 * radius, missed_by > radius
    found = channels[INSTANCE] == 1
    assert found[inside].all()
    assert not found[outside].any()
    assert min(inside.sum(), outside.sum()) > 1000
    point = origin + (along - np.sqrt(np.maximum(radius**2 - missed_by**2, 0)))[..., None] * direction
    normal = (point - world_from_ball[:3, 3]) / radius
    # The mesh has flat triangles of 5 mm; its vertices, and the normals there, are those of the sphere.
    assert np.linalg.norm(vectors(channels, "position") - point, axis=-1)[inside].max() < 1e-4
    angle = directions.arcmin_between(directions.normalised(vectors(channels, "normal")[inside]), normal[inside])
    assert np.median(angle) < 0.2
    assert angle.max() < 2.0
    for name, values in channels.items():
        assert not values[outside].any(), name


def test_instances_are_numbered_as_in_the_scene_and_albedo_has_no_light(toy_headset: Eye) -> None:
    tile = quad((-0.2, -0.2), (0.2, 0.2), base_colour=np.array([0.5, 0.25, 0.125], np.float32))
    placed = [
        (tile, HEAD_POSE @ at(0.3, 0, -2)),
        (cube(0.3), HEAD_POSE @ at(0, 0, -2.2)),
        (tile, HEAD_POSE @ at(-0.3, 0, -2)),
    ]
    channels = layers_of(toy_headset, lit(*placed), toy_headset.eye_box.centre)
    assert set(np.unique(channels[INSTANCE])) == {0, 1, 2, 3}
    for number, (_, pose) in enumerate(placed, start=1):
        middle = vectors(channels, "position")[channels[INSTANCE] == number].mean(axis=0)
        assert np.linalg.norm(middle - pose[:3, 3]) < 0.2
    tiles = np.isin(channels[INSTANCE], (1, 3))
    np.testing.assert_allclose(vectors(channels, "albedo", "RGB")[tiles], [[0.5, 0.25, 0.125]] * tiles.sum())


@pytest.mark.gl
def test_rastered_and_ray_traced_frames_have_the_same_layers_and_show_them(
    toy_headset: Eye, gl_context: GlContext
) -> None:
    viewpoint = toy_headset.eye_box.at(OFF_CENTRE)
    wall = construction.plane(9, 7, (0.3, 0.4, 0.5))
    scene = unlit((wall, HEAD_POSE @ at(0, 0, -3)), (construction.ball(0.12), HEAD_POSE @ at(0.05, 0, -0.8)))
    renderer = RayRenderer(scene)
    drawn = WarpedPainter(toy_headset, SceneRaster(gl_context, scene)).paint(viewpoint, HEAD_POSE, with_geometry=True)
    traced = TracedPainter(toy_headset, renderer).paint(viewpoint, HEAD_POSE)
    of_drawn, of_traced = (frame_layers(renderer, each.ray_map, HEAD_POSE) for each in (drawn, traced))
    same = of_drawn[INSTANCE] == of_traced[INSTANCE]
    assert same.mean() > 0.9999  # rays of the two are solved in other axes
    for name in ("position", "normal"):
        assert np.abs(vectors(of_drawn, name) - vectors(of_traced, name))[same].max() < 2e-4
    # What the frames themselves show, off silhouettes, where the rastered frame has the filter of the warp.
    around = np.lib.stride_tricks.sliding_window_view(np.pad(of_drawn[INSTANCE], 2, mode="edge"), (5, 5))
    settled = around.max(axis=(-2, -1)) == around.min(axis=(-2, -1))
    assert settled.mean() > 0.8
    points = present(drawn.position).astype(float), vectors(of_drawn, "position")
    eye = transforms.apply(HEAD_POSE, viewpoint)
    snapped, distance = snap_arcmin(exact_rays(toy_headset, viewpoint)[1]), np.linalg.norm(points[1] - eye, axis=-1)
    most_m = allowed(gl_context, 1e-5, snapped * directions.ARCMIN * float(np.median(distance)))
    assert np.median(np.linalg.norm(points[0] - points[1], axis=-1)) < most_m
    seen = [directions.normalised(point[settled] - eye) for point in points]
    assert directions.arcmin_between(*seen).max() < allowed(gl_context, 0.05, snapped)
    difference = np.abs(decode_srgb(drawn.colour) - vectors(of_drawn, "albedo", "RGB"))[settled]
    assert np.median(difference) < 0.005
    assert np.abs(decode_srgb(traced.colour) - vectors(of_traced, "albedo", "RGB")).max() < 0.005


def test_only_what_is_asked_for_is_computed_and_pixels_without_a_ray_show_nothing(toy_headset: Eye) -> None:
    scene = unlit((quad((-9, -9), (9, 9)), HEAD_POSE @ at(0, 0, -2)))
    rays_of_pixels = ray_map(toy_headset, toy_headset.eye_box.centre, choose_plan(toy_headset))
    rays_of_pixels.slope_offset[:, 3, 5] = np.nan
    channels = frame_layers(RayRenderer(scene), rays_of_pixels, HEAD_POSE, ("instance", "depth"))
    assert set(channels) == {"depth.Z", "depth.distance", INSTANCE}
    assert [values[3, 5] for values in channels.values()] == [0, 0, 0]
    assert np.count_nonzero(channels[INSTANCE] == 0) == 1
