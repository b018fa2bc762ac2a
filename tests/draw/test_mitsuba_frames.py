"""Path-traced frames: Mitsuba's hits are Embree's, its direct light is our shading, its bounces are those of theory."""

import ctypes.util
import os
import sys
from collections.abc import Iterator, Sequence
from dataclasses import replace
from pathlib import Path
from types import ModuleType
from typing import Any

import numpy as np
import pytest
from gl_scenes import at, quad, shipped_scene, unlit
from present import narrowed, present
from toy_headsets import LateralOffset

from wlr_render.draw import mitsuba_frames
from wlr_render.draw.mitsuba_frames import PathTracedPainter, PathTracer
from wlr_render.draw.painters import TracedPainter
from wlr_render.draw.ray_intersections import SceneTracer
from wlr_render.draw.ray_tracing import RayRenderer
from wlr_render.extras import MissingExtraError
from wlr_render.mappings import Eye
from wlr_render.numerics.arrays import Float32Array
from wlr_render.numerics.srgb import decode_srgb, encode_srgb
from wlr_render.scene.scene import LightSource, Mesh, Scene
from wlr_render.scene.shapes import construction

BLACK = np.zeros(3, np.float32)
UP = np.array([0.0, 0.0, 1.0])


def fan_of_rays(height: int = 100, width: int = 90) -> tuple[Float32Array, Float32Array]:
    """(height, width, 3) directions and (3,) origin: a view of the shipped scenes, and beyond their edges."""
    x, y = np.meshgrid(np.linspace(-0.75, 0.75, width), np.linspace(0.6, -0.9, height))
    direction = np.stack([x, y, -np.ones_like(x)], axis=-1)
    direction /= np.linalg.norm(direction, axis=-1, keepdims=True)
    return np.array([0.01, 0.02, 0.03], np.float32), direction.astype(np.float32)


def with_one_light(scene: Scene, light: LightSource) -> Scene:
    return replace(scene, ambient=BLACK, lights=(light,))


@pytest.mark.parametrize("name", ["sculpture", "desk"])
def test_hits_are_those_of_embree(mitsuba: ModuleType, name: str) -> None:
    scene = shipped_scene(name)
    origin, direction = fan_of_rays()
    flat = direction.reshape(-1, 3).copy()
    flat[7] = np.nan
    found, expected = (tracer(scene).intersect(origin, flat) for tracer in (PathTracer, SceneTracer))
    assert np.isfinite(expected.distance).mean() > 0.2
    np.testing.assert_allclose(found.distance, expected.distance, rtol=0, atol=1e-6)
    np.testing.assert_array_equal(found.instance, expected.instance)
    same = found.triangle == expected.triangle  # at an edge either of its two triangles
    assert same.mean() > 0.999
    np.testing.assert_allclose(found.barycentric_u[same], expected.barycentric_u[same], atol=1e-6)
    np.testing.assert_allclose(found.barycentric_v[same], expected.barycentric_v[same], atol=1e-6)


@pytest.mark.parametrize("name", ["sculpture", "desk"])
@pytest.mark.slow
def test_under_one_light_the_picture_is_ours_with_shadows_but_for_their_edges(mitsuba: ModuleType, name: str) -> None:
    """Textures, vertex colours, their product, smooth normals, turned placements, both kinds of light."""
    origin, direction = fan_of_rays()
    for light in shipped_scene(name).lights:
        scene = with_one_light(shipped_scene(name), light)
        ours = RayRenderer(scene).render_rays(origin, direction, shadows=True).colour.astype(int)
        path = encode_srgb(PathTracer(scene, bounces=0).light(origin, direction.reshape(-1, 3), 1))
        difference = np.abs(path.reshape(ours.shape) - ours).max(axis=-1)
        assert (ours.max(axis=-1) > 30).mean() > 0.05
        assert (difference > 1).mean() < 0.003


def test_a_plane_under_the_sky_reflects_all_of_the_ambient_light(mitsuba: ModuleType) -> None:
    albedo, background = np.array([0.2, 0.5, 0.8], np.float32), (0.3, 0.1, 0.6)
    scene = unlit((quad((-1, -1), (1, 1), base_colour=albedo), at(0, 0, -2)), background=background)
    direction = np.tile(np.array([[0, 0, -1], [0, 0, 1], [0, np.nan, -1]], np.float32), (20_000, 1))
    light = PathTracer(scene).light(np.zeros(3, np.float32), direction, 5).reshape(-1, 3, 3)
    np.testing.assert_allclose(light[:, 0].mean(axis=0), albedo, rtol=0.01)
    np.testing.assert_array_equal(light[:, 1:], np.broadcast_to(np.array(background, np.float32), (20_000, 2, 3)))


def bright(**material: Any) -> Mesh:
    """A square whose base colour is 3."""
    return quad((-1, -1), (1, 1), base_colour=np.full(3, 3.0, np.float32), **material)


def test_albedo_is_the_product_of_all_three_colours_and_at_most_one(mitsuba: ModuleType) -> None:
    code, colour = 118, 0.6
    texture, vertex = {"texture": np.full((2, 2, 3), code, np.uint8)}, {"vertex_colour": np.full((4, 3), colour, "f4")}
    texel, light = decode_srgb(texture["texture"]).max(), LightSource("directional", -UP, np.full(3, 0.4, np.float32))
    for material, product in (({}, 1), (texture, texel), (vertex, colour), (texture | vertex, texel * colour)):
        scene = with_one_light(unlit((bright(**material), at(0, 0, -2))), light)
        found = PathTracer(scene, bounces=0).light(np.zeros(3, np.float32), np.array([-UP], np.float32), 0)
        np.testing.assert_allclose(found, 0.4 * min(1.0, 3 * product), rtol=1e-5)


@pytest.mark.parametrize("bounces", [0, 3])
def test_light_in_a_closed_sphere_is_that_of_an_integrating_sphere(mitsuba: ModuleType, bounces: int) -> None:
    """Every reflection adds the albedo's share of the one before, evenly over the sphere."""
    albedo, radius = 0.7, 2.0
    sphere = construction.sphere(radius, (albedo,) * 3, segments=96)
    scene = with_one_light(unlit((sphere, np.eye(4))), LightSource("point", np.zeros(3), np.full(3, 0.5, np.float32)))
    direction = np.random.default_rng(2).normal(size=(20_000, 3)).astype(np.float32)
    direction /= np.linalg.norm(direction, axis=1, keepdims=True)
    light = PathTracer(scene, bounces).light(np.full(3, 0.1, np.float32), direction, 3)
    expected = albedo * 0.5 / radius**2 * sum(albedo**k for k in range(bounces + 1))
    np.testing.assert_allclose(light.mean(), expected, rtol=0.01)


@pytest.mark.slow
def test_the_same_seed_gives_the_same_bits_with_any_number_of_threads(mitsuba: ModuleType) -> None:
    import drjit

    tracer, (origin, direction) = PathTracer(shipped_scene("desk")), fan_of_rays(24, 20)
    rays = origin, direction.reshape(-1, 3)
    first, threads = tracer.light(*rays, 11), drjit.thread_count()
    try:
        drjit.set_thread_count(0)
        again = tracer.light(*rays, 11)
    finally:
        drjit.set_thread_count(threads)
    np.testing.assert_array_equal(again, first)
    assert (tracer.light(*rays, 12) != first).any(axis=1).mean() > 0.5


def scene_with_a_ball() -> Scene:
    light = LightSource("directional", np.array([0.48, -0.6, -0.64]), np.full(3, 0.9, np.float32))
    wall, ball = construction.plane(9, 7, (0.3, 0.4, 0.5)), construction.ball(0.12)
    return with_one_light(unlit((wall, at(0, 0, -3)), (ball, at(0.05, 0, -0.8)), background=(0.1, 0.2, 0.3)), light)


def test_one_path_through_the_centre_of_each_pixel_is_the_ray_traced_frame(
    mitsuba: ModuleType, toy_headset_with_hole: Eye
) -> None:
    eye, scene = toy_headset_with_hole, scene_with_a_ball()
    viewpoint, pose = eye.eye_box.centre + [0.001, -0.002, 0.001], at(0.01, 0.02, 0.03)
    painters = TracedPainter(eye, RayRenderer(scene), shadows=True), PathTracedPainter(eye, PathTracer(scene, 0), 1)
    ours, path = (painter.paint(viewpoint, pose, with_geometry=True) for painter in painters)
    assert path.position is not None
    np.testing.assert_allclose(path.position, present(ours.position), atol=1e-5)
    assert np.isnan(path.position).any()
    assert (np.abs(path.colour.astype(int) - ours.colour).max(axis=-1) > 1).mean() < 0.01


@pytest.mark.slow
def test_many_paths_supersample_edges_and_converge(mitsuba: ModuleType, toy_headset: Eye) -> None:
    """Direct light from one source has no noise: what is left is where in the pixel the paths begin."""
    scene, viewpoint = scene_with_a_ball(), toy_headset.eye_box.centre
    traced = TracedPainter(toy_headset, RayRenderer(scene), supersample=8, shadows=True).paint(viewpoint, np.eye(4))
    tracer = PathTracer(scene, 0)
    errors = []
    for samples in (1, 64):
        frame = PathTracedPainter(toy_headset, tracer, samples).paint(viewpoint, np.eye(4))
        errors.append(np.abs(frame.colour.astype(int) - traced.colour).mean())
    assert errors[1] < 0.2
    assert errors[1] < 0.2 * errors[0]


def test_each_colour_has_rays_of_its_own_and_frames_repeat(mitsuba: ModuleType, toy_headset: Eye) -> None:
    scene, viewpoint = scene_with_a_ball(), toy_headset.eye_box.centre
    moved = replace(toy_headset, see_through=replace(narrowed(toy_headset.see_through, LateralOffset), prism=0.02))
    tracer = PathTracer(scene)
    eyes: dict[str, Eye | Sequence[Eye]] = {
        "own": (toy_headset, toy_headset, moved),
        "first": toy_headset,
        "moved": moved,
    }
    frames = {
        name: PathTracedPainter(headsets, tracer, 2, (7, 1)).paint(viewpoint, np.eye(4), with_geometry=True)
        for name, headsets in eyes.items()
    }
    np.testing.assert_array_equal(frames["own"].colour[..., :2], frames["first"].colour[..., :2])
    np.testing.assert_array_equal(frames["own"].colour[..., 2], frames["moved"].colour[..., 2])
    assert len(frames["own"].traced) == 3


@pytest.fixture
def llvm_not_chosen() -> Iterator[None]:
    mitsuba_frames._choose_llvm.cache_clear()
    yield
    mitsuba_frames._choose_llvm.cache_clear()


def test_without_mitsuba_a_sentence_has_the_command(monkeypatch: pytest.MonkeyPatch, llvm_not_chosen: None) -> None:
    monkeypatch.setitem(sys.modules, "mitsuba", None)
    with pytest.raises(MissingExtraError, match=r"^Path tracing: mitsuba is not installed.*'mitsuba>="):
        PathTracer(scene_with_a_ball())


@pytest.mark.parametrize(
    ("library", "fault"),
    [("there.is.none.so", "cannot be loaded"), (ctypes.util.find_library("c"), "is older")],
    ids=["missing", "no version"],
)
def test_an_llvm_that_mitsuba_cannot_use_is_refused_by_name(
    monkeypatch: pytest.MonkeyPatch, llvm_not_chosen: None, library: str, fault: str
) -> None:
    monkeypatch.setenv("DRJIT_LIBLLVM_PATH", library)
    with pytest.raises(MissingExtraError, match=f"needs LLVM 19 or newer, and {library} {fault}; install it"):
        mitsuba_frames._choose_llvm()


def test_the_newest_llvm_is_chosen(monkeypatch: pytest.MonkeyPatch, tmp_path: Path, llvm_not_chosen: None) -> None:
    monkeypatch.delenv("DRJIT_LIBLLVM_PATH", raising=False)
    monkeypatch.setattr(mitsuba_frames, "_LLVM_FILES", {})
    monkeypatch.setattr(sys, "prefix", str(tmp_path))
    with pytest.raises(MissingExtraError, match="and none is installed; install it"):
        mitsuba_frames._choose_llvm()
    (tmp_path / "lib").mkdir()
    for name in ("libLLVM-9.so", "libLLVM.so.19.1", "libLLVM-14.0.6.so.1"):
        (tmp_path / "lib" / name).write_bytes(b"")
    with pytest.raises(MissingExtraError, match=r"libLLVM\.so\.19\.1 cannot be loaded"):
        mitsuba_frames._choose_llvm()


def test_homebrews_folders_tell_the_version_and_a_library_that_does_not_load_is_passed_over(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path, llvm_not_chosen: None
) -> None:
    """All of Homebrew's libraries have one name; opt/llvm is a link to its newest version."""
    monkeypatch.setenv("DRJIT_LIBLLVM_PATH", "")
    paths = {version: tmp_path / "opt" / f"llvm@{version}" / "lib" / "libLLVM.dylib" for version in (16, 9, 19)}
    paths[21] = tmp_path / "Cellar" / "llvm" / "21.1.0" / "lib" / "libLLVM.dylib"
    for path in paths.values():
        path.parent.mkdir(parents=True)
        path.touch()
    (tmp_path / "opt" / "llvm").symlink_to(paths[21].parents[1], target_is_directory=True)
    monkeypatch.setattr(sys, "prefix", str(tmp_path))
    monkeypatch.setattr(mitsuba_frames, "_LLVM_FILES", {sys.platform: (f"{tmp_path}/opt/llvm*/lib/libLLVM*.dylib",)})
    asked = []

    def version_of(path: Path) -> int | None:
        asked.append(path)
        return {paths[19]: 19, paths[16]: 16}.get(path)  # the newest does not load

    monkeypatch.setattr(mitsuba_frames, "_llvm_version", version_of)
    mitsuba_frames._choose_llvm()
    assert os.environ["DRJIT_LIBLLVM_PATH"] == str(paths[19])
    assert asked == [tmp_path / "opt" / "llvm" / "lib" / "libLLVM.dylib", paths[19]]
