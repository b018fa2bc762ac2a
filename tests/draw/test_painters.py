"""Frames against the rays that they stand for: whatever a pixel shows lies on that pixel's bent world ray."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import partial
from typing import Any, cast

import numpy as np
import pytest
from _pytest.mark.structures import MarkDecorator
from gl_scenes import at, lit, quad, unlit
from hardware import allowed, snap_arcmin
from present import narrowed, present
from toy_headsets import CurvedImage, LateralOffset

from benchmarks.raster.disocclusion import disoccluded
from wlr_render.draw import raster_painter
from wlr_render.draw.painters import (
    Frame,
    TracedPainter,
    inverse_depth_at,
    position_of_source,
    ray_maps_between_pixels,
    ray_maps_of,
)
from wlr_render.draw.raster_painter import WarpedPainter
from wlr_render.draw.ray_tracing import RayRenderer
from wlr_render.draw.sampling import remap
from wlr_render.draw.scene_raster import SceneRaster
from wlr_render.geometry import directions, rays, transforms
from wlr_render.geometry.pinhole import Pinhole
from wlr_render.gl.context import GlContext
from wlr_render.mappings import DisplayMapping, Eye, Panel, QueryResult, Status
from wlr_render.numerics.arrays import BoolArray, Float32Array, FloatArray
from wlr_render.numerics.srgb import decode_srgb, encode_srgb
from wlr_render.scene.scene import Scene
from wlr_render.scene.shapes import construction
from wlr_render.warp.ray_map import NEAREST_M, choose_plan, ray_map
from wlr_render.warp.view import View

OFF_CENTRE = np.array([0.7, -0.9, 0.8])
HEAD_POSE = at(0.1, 1.5, 0.3, transforms.rotation_about("y", 0.5) @ transforms.rotation_about("x", -0.1))
GREEN = (0.0, 1.0, 0.0)


def ball_before_wall(world_from_scene: FloatArray = HEAD_POSE) -> Scene:
    """A beach ball 0.8 m and a wall 3 m before the device that fill its whole field."""
    wall = construction.plane(9, 7, (0.3, 0.4, 0.5))
    return lit((wall, world_from_scene @ at(0, 0, -3)), (construction.ball(0.12), world_from_scene @ at(0.05, 0, -0.8)))


@pytest.fixture
def painter_of(
    request: pytest.FixtureRequest,
) -> Callable[[str, Eye | Sequence[Eye], Scene], TracedPainter | WarpedPainter]:
    """Makes painters; those that rasterise need OpenGL."""

    def make(way: str, headset: Eye | Sequence[Eye], scene: Scene) -> TracedPainter | WarpedPainter:
        renderer = RayRenderer(scene)
        if way == "traced":
            return TracedPainter(headset, renderer)
        raster = SceneRaster(request.getfixturevalue("gl_context"), scene)
        return WarpedPainter(headset, raster, resolution=2.0 if way == "double" else 1.0)

    return make


def raster_ways(*ways: str) -> MarkDecorator:
    """Ways to draw, those that need OpenGL marked."""
    return pytest.mark.parametrize(
        "way", [pytest.param(way, marks=[] if way == "traced" else [pytest.mark.gl]) for way in ways]
    )


def off_edges(position: Float32Array) -> BoolArray:
    """Pixels whose neighbours, two steps to every side, are all at a similar distance."""
    distance = np.pad(np.linalg.norm(position - HEAD_POSE[:3, 3], axis=-1), 2, mode="edge")
    windows = np.lib.stride_tricks.sliding_window_view(distance, (5, 5))
    return np.asarray(windows.max(axis=(-2, -1)) < 1.2 * windows.min(axis=(-2, -1)))


@raster_ways("traced", "plain", "double")
def test_the_point_that_a_pixel_shows_lies_on_its_world_ray(
    toy_headset: Eye, way: str, painter_of: Callable[..., Any], request: pytest.FixtureRequest
) -> None:
    viewpoint, scene = toy_headset.eye_box.at(OFF_CENTRE), ball_before_wall()
    frame = painter_of(way, toy_headset, scene).paint(viewpoint, HEAD_POSE, with_geometry=True)
    pixel = toy_headset.display.panel.pixel_centres()
    view_dir = toy_headset.display.view_dir_of_pixel(pixel, viewpoint).value
    world_ray = rays.transformed(HEAD_POSE, toy_headset.see_through.real_ray_of_view_dir(view_dir, viewpoint).value)
    truth = RayRenderer(scene).render_rays(*rays.split(world_ray), with_position=True)
    settled = off_edges(present(truth.position))
    assert settled.mean() > 0.8
    most_m, most_arcmin = 1e-4, 0.05
    if way != "traced":
        context: GlContext = request.getfixturevalue("gl_context")
        snapped = snap_arcmin(rays.split(world_ray)[1])
        farthest = np.linalg.norm(present(truth.position) - HEAD_POSE[:3, 3], axis=-1)[settled].max()
        most_m = allowed(context, most_m, snapped * directions.ARCMIN * float(farthest))
        most_arcmin = allowed(context, most_arcmin, snapped)
    assert rays.distance_to_point(world_ray, frame.position)[settled].max() < most_m
    eye = transforms.apply(HEAD_POSE, viewpoint)
    shown, expected = (directions.normalised(present(p).astype(float) - eye) for p in (frame.position, truth.position))
    assert directions.arcmin_between(shown, expected)[settled].max() < most_arcmin
    difference = np.abs(frame.colour.astype(int) - truth.colour)[settled]
    assert difference.mean() < (0.01 if way == "traced" else 0.5)


def test_the_position_of_a_source_is_the_closed_form_and_keeps_nan() -> None:
    camera = Pinhole(120, 90, np.array([-0.6, -0.3]), np.array([0.4, 0.5]))
    turn = transforms.rotation_about("y", -0.4) @ transforms.rotation_about("x", 0.2)
    view = View(camera, np.array([0.03, 0.01, -0.02]), HEAD_POSE, turn)
    rng = np.random.default_rng(2)
    inverse_depth = rng.uniform(0.2, 4.0, (7, 5, 1))
    source = np.concatenate([rng.uniform(0, [120, 90], (7, 5, 2)), inverse_depth], axis=-1).astype(np.float32)
    source[3, 2] = np.nan
    position = position_of_source(view, source)
    assert np.isnan(position[3, 2]).all()
    # One of them in closed form, through the chain device <- camera and world <- device.
    tangents = camera.tangents_of_pixel(source[0, 0, :2].astype(float))
    in_device = view.position_in_device + turn @ [*tangents, -1.0] / float(source[0, 0, 2])
    np.testing.assert_allclose(position[0, 0], transforms.apply(HEAD_POSE, in_device), atol=1e-5)


def test_background_has_no_position() -> None:
    view = View(Pinhole(4, 4, -np.ones(2), np.ones(2)), np.zeros(3), np.eye(4))
    at_infinity = np.array([[[2.0, 2.0, 0.0], [1.0, 1.0, 0.5]]], np.float32)
    np.testing.assert_array_equal(np.isnan(position_of_source(view, at_infinity)).all(axis=-1), [[True, False]])


def test_inverse_depth_is_bilinear_and_not_mixed_across_an_edge() -> None:
    tangents = Pinhole(200, 160, np.array([-0.55, -0.4]), np.array([0.45, 0.4])).pixel_centre_tangents()[..., 0]
    step = np.where(np.indices(tangents.shape)[1] < 100, 2.0, 0.5).astype(np.float32)
    at_edge = np.stack([np.linspace(98, 102, 41), np.full(41, 30.2)], axis=1)
    expected = np.where(at_edge[:, 0].astype(np.float32) < 100, 2.0, 0.5)
    np.testing.assert_array_equal(inverse_depth_at(step, at_edge), expected)
    places = np.random.default_rng(1).uniform(1, 150, (100, 2))
    slope = (0.2 * tangents + 1).astype(np.float32)
    expected = 0.2 * (places[:, 0] / 200 - 0.55) + 1
    np.testing.assert_allclose(inverse_depth_at(slope, places.astype(np.float32)).astype(float), expected, atol=1e-6)


@pytest.mark.gl
@pytest.mark.parametrize("depth", [NEAREST_M, 3.0])
def test_one_camera_covers_every_viewpoint_of_the_eye_box(
    toy_headset: Eye, gl_context: GlContext, depth: float
) -> None:
    # Pixels so small that the box's corners look several of them beyond what its centre sees.
    headset = replace(toy_headset, display=replace(narrowed(toy_headset.display, CurvedImage), panel=Panel(384, 320)))
    painter = WarpedPainter(headset, SceneRaster(gl_context, unlit((quad((-9, -9), (9, 9)), at(0, 0, -depth)))))
    corners = np.array(np.meshgrid(*[[-1, 1]] * 3)).reshape(3, 8).T
    inside = np.random.default_rng(4).uniform(-1, 1, (3, 3))
    for viewpoint in headset.eye_box.at(np.concatenate([corners, inside])):
        assert np.isfinite(present(painter.paint(viewpoint, np.eye(4), with_geometry=True).source)).all()


@pytest.mark.gl
def test_the_raster_camera_reduces_disocclusion(toy_headset: Eye, gl_context: GlContext) -> None:
    headset = replace(toy_headset, display=replace(narrowed(toy_headset.display, CurvedImage), panel=Panel(384, 320)))
    scene, viewpoint = ball_before_wall(), headset.eye_box.at(OFF_CENTRE)
    renderer = RayRenderer(scene)
    traced = TracedPainter(headset, renderer).paint(viewpoint, HEAD_POSE, with_geometry=True)
    hidden = []
    for place in ("viewpoint", "nearest"):
        painter = WarpedPainter(headset, SceneRaster(gl_context, scene), raster_camera=place)
        drawn_from = painter.view(viewpoint, HEAD_POSE).position_in_world
        hidden.append(
            disoccluded(renderer.tracer, drawn_from, traced.ray_map, HEAD_POSE, present(traced.position)).sum()
        )
    # The plate offsets rays in proportion to their tangents, which is a shift of the eye but for its small prism.
    assert hidden[0] > 20
    assert hidden[1] <= 0.2 * hidden[0]


@pytest.fixture
def dispersive_headset(toy_headset: Eye) -> list[Eye]:
    """Three colours of the toy, whose prism rays blue 4.6 degrees farther than red."""
    see_through = narrowed(toy_headset.see_through, LateralOffset)
    return [replace(toy_headset, see_through=replace(see_through, prism=prism)) for prism in (0.0, 0.03, 0.08)]


@pytest.mark.gl
def test_the_colours_of_an_eye_share_an_intermediate_image_that_covers_all(
    dispersive_headset: Sequence[Eye], gl_context: GlContext
) -> None:
    raster, viewpoint = SceneRaster(gl_context, ball_before_wall()), dispersive_headset[0].eye_box.at(OFF_CENTRE)
    all_three, red = WarpedPainter(dispersive_headset, raster), WarpedPainter(dispersive_headset[0], raster)
    frame = all_three.paint(viewpoint, HEAD_POSE, with_geometry=True)
    assert np.isfinite(frame.sources).all()
    wanted = all_three.view(viewpoint, HEAD_POSE).camera.tangents_of_pixel(frame.sources[2][..., :2].astype(float))
    assert (wanted > red.view(viewpoint, HEAD_POSE).camera.tangent_max).any()


@dataclass(frozen=True)
class Shifted:
    """A display whose picture lies some pixels beside that of another."""

    inner: DisplayMapping
    shift_px: float

    @property
    def panel(self) -> Panel:
        return self.inner.panel

    def view_dir_of_pixel(self, pixel: FloatArray, viewpoint: FloatArray, warm_start: object = None) -> QueryResult:
        return self.inner.view_dir_of_pixel(pixel + np.array([self.shift_px, 0.0]), viewpoint)


def shifted(display: DisplayMapping, shift_px: float) -> DisplayMapping:
    return cast(DisplayMapping, Shifted(display, shift_px))  # a warp asks for view directions only


@pytest.mark.gl
def test_each_colour_is_warped_with_its_own_rays(dispersive_headset: Sequence[Eye], gl_context: GlContext) -> None:
    raster, viewpoint = SceneRaster(gl_context, ball_before_wall()), dispersive_headset[0].eye_box.at(OFF_CENTRE)
    colours = [replace(each, display=shifted(each.display, 2.0 * k)) for k, each in enumerate(dispersive_headset)]
    painter = WarpedPainter(colours, raster)
    frame, full = (painter.paint(viewpoint, HEAD_POSE, with_geometry=flag) for flag in (False, True))
    np.testing.assert_array_equal(frame.colour, full.colour)
    np.testing.assert_array_equal(full.source, full.sources[1])
    assert not frame.sources
    for channel, mappings in enumerate(colours):
        truth = painter_of_truth(mappings, viewpoint)
        settled = off_edges(present(truth.position))
        shown = position_of_source(present(full.view), full.sources[channel])
        eye = transforms.apply(HEAD_POSE, viewpoint)
        there, expected = (directions.normalised(present(p).astype(float) - eye) for p in (shown, truth.position))
        snapped = snap_arcmin(expected)
        assert directions.arcmin_between(there, expected)[settled].max() < allowed(gl_context, 0.05, snapped)
        pulled, _ = remap(present(full.intermediate).colour, full.sources[channel][..., :2])
        apart = np.abs(frame.colour[..., channel].astype(int) - pulled[..., channel])
        assert apart[settled].mean() < 0.5


def painter_of_truth(mappings: Eye, viewpoint: FloatArray) -> Frame:
    return TracedPainter(mappings, RayRenderer(ball_before_wall())).paint(viewpoint, HEAD_POSE, with_geometry=True)


@pytest.mark.gl
def test_a_frame_does_not_depend_on_the_one_before_and_solves_no_ray_map_unasked(
    toy_headset: Eye, gl_context: GlContext, monkeypatch: pytest.MonkeyPatch
) -> None:
    raster, seen = SceneRaster(gl_context, ball_before_wall()), toy_headset.eye_box.at(OFF_CENTRE)
    asked = []

    def counted(*given: Any) -> Any:
        asked.append(given)
        return ray_maps_of(*given)

    monkeypatch.setattr(raster_painter, "ray_maps_of", counted)
    warm, cold = WarpedPainter(toy_headset, raster), WarpedPainter(toy_headset, raster)
    warm.paint(toy_headset.eye_box.centre, HEAD_POSE @ at(0.1, 0, 0))
    frames = [painter.paint(seen, HEAD_POSE) for painter in (warm, cold)]
    np.testing.assert_array_equal(frames[0].colour, frames[1].colour)
    assert not asked
    exact = ray_map(toy_headset, seen, choose_plan(toy_headset))
    np.testing.assert_allclose(frames[0].ray_map.slope_offset, exact.slope_offset, atol=1e-6)
    assert len(asked) == 1


def test_each_colour_is_that_of_a_frame_of_its_own(
    dispersive_headset: Sequence[Eye], painter_of: Callable[..., Any]
) -> None:
    """Ray-traced positions and colours know nothing of the other channels."""
    scene, viewpoint = ball_before_wall(), dispersive_headset[0].eye_box.centre
    frame = painter_of("traced", dispersive_headset, scene).paint(viewpoint, HEAD_POSE, with_geometry=True)
    for channel, mappings in enumerate(dispersive_headset):
        alone = painter_of("traced", mappings, scene).paint(viewpoint, HEAD_POSE, with_geometry=True)
        np.testing.assert_array_equal(frame.traced[channel], alone.position)
        np.testing.assert_array_equal(frame.colour[..., channel], alone.colour[..., channel])
        assert (frame.colour != alone.colour).any()


@pytest.mark.gl
@pytest.mark.parametrize("resolution", [1.0, 2.0])
def test_the_camera_has_square_pixels_as_many_as_asked_for(
    toy_headset: Eye, gl_context: GlContext, resolution: float
) -> None:
    painter = WarpedPainter(toy_headset, SceneRaster(gl_context, ball_before_wall()), resolution)
    camera = painter.view(toy_headset.eye_box.centre, np.eye(4)).camera
    assert camera.focal_px[0] == pytest.approx(camera.focal_px[1])
    # Two pixels of margin to each side.
    inner = (camera.width_px - 4) * (camera.height_px - 4)
    assert inner == pytest.approx(resolution**2 * 96 * 80, rel=0.02)


def test_pixels_without_a_ray_show_the_background_and_nothing_else(
    toy_headset_with_hole: Eye, painter_of: Callable[..., Any]
) -> None:
    scene = unlit((quad((-9, -9), (9, 9)), at(0, 0, -2)), background=GREEN)
    headset = toy_headset_with_hole
    frame = painter_of("traced", headset, scene).paint(headset.eye_box.centre, np.eye(4), with_geometry=True)
    hole = frame.ray_map.status == Status.MISS
    assert 60 < hole.sum() < 100  # a disc of radius 5 px
    np.testing.assert_array_equal(np.isnan(frame.position).any(axis=-1), hole)
    np.testing.assert_array_equal((frame.colour == encode_srgb(np.array(GREEN, np.float32))).all(axis=-1), hole)


def test_an_edge_is_supersampled_in_linear_light_and_geometry_stays_the_centres(toy_headset: Eye) -> None:
    renderer = RayRenderer(unlit((quad((-9, -9), (0.02, 9)), at(0, 0, -2))))
    viewpoint = toy_headset.eye_box.centre
    plain, fine = (
        TracedPainter(toy_headset, renderer, supersample=n).paint(viewpoint, np.eye(4), with_geometry=True)
        for n in (1, 3)
    )
    assert set(np.unique(plain.colour)) == {0, 255}
    mixed = np.unique(fine.colour)
    assert mixed.size > 2
    # Nine samples, each black or white.
    np.testing.assert_allclose(9 * decode_srgb(mixed), np.rint(9 * decode_srgb(mixed)), atol=0.05)
    np.testing.assert_array_equal(fine.position, plain.position)


def test_rays_are_added_where_they_matter(dispersive_headset: Sequence[Eye]) -> None:
    """Against the means of as many exact rays in every pixel."""
    scene, viewpoint = ball_before_wall(), dispersive_headset[0].eye_box.at(OFF_CENTRE)
    renderer, steps = RayRenderer(scene), (np.arange(4) - 1.5) / 4
    exact = []
    for channel, mappings in enumerate(dispersive_headset):
        plan = choose_plan(mappings)
        moved = ray_maps_between_pixels(
            mappings, plan, ray_map(mappings, viewpoint, plan), (np.array([u, v]) for u in steps for v in steps)
        )
        frames = [renderer.render_blocks(each.shape, partial(each.world_rays, HEAD_POSE)).colour for each in moved]
        exact.append(np.mean([decode_srgb(frame[..., channel]) for frame in frames], axis=0))
    wanted = encode_srgb(np.stack(exact, axis=-1).astype(np.float32)).astype(int)
    one, many = (
        TracedPainter(dispersive_headset, renderer, n).paint(viewpoint, HEAD_POSE).colour.astype(int) for n in (1, 4)
    )
    off = [float(np.sqrt(np.square(frame - wanted).mean())) for frame in (one, many)]
    assert off[1] < 0.1 * off[0]


@pytest.mark.parametrize("supersample", [1, 2])
def test_shadows_only_darken(toy_headset: Eye, supersample: int) -> None:
    renderer, viewpoint = RayRenderer(ball_before_wall(np.eye(4))), toy_headset.eye_box.centre
    open_sky, shaded = (
        TracedPainter(toy_headset, renderer, supersample, shadows).paint(viewpoint, np.eye(4)).colour.astype(int)
        for shadows in (False, True)
    )
    assert (shaded <= open_sky).all()
    assert (shaded < open_sky - 10).any(axis=-1).sum() > 10
