import json
import runpy
import shutil
import subprocess
from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from browser import driven_page, needs_browser
from flat_image import PrismPlate
from present import narrowed
from warps.composing import HEAD, planar
from warps.own_warps import NEAR_M, OpenGl, Warp, WebGpu, drawn, expected_source, light, seen_by, stage, wgsl

from wlr_render import StoredDepth
from wlr_render.engine import DepthKind
from wlr_render.errors import BadInputError
from wlr_render.geometry import transforms
from wlr_render.geometry.directions import ARCMIN
from wlr_render.gl.context import GlContext
from wlr_render.io.atomic_files import resource
from wlr_render.mappings import DisplayMapping, Eye, QueryResult, Status
from wlr_render.numerics.arrays import Float32Array, FloatArray, IntArray
from wlr_render.numerics.srgb import encode_srgb
from wlr_render.warp.choose_grid import ray_error_arcmin
from wlr_render.warp.eye_camera import EyeCamera
from wlr_render.warp.grid import WarpGrid
from wlr_render.warp.ray_map import solve_pixels
from wlr_render.warp.warp_mesh import WarpMesh

SIZE = 180, 200
KINDS = {"TILES_VERTEX": "vert", "TILES_FRAGMENT": "frag", "VERTEX": "vert", "FRAGMENT": "frag"}
STORED = StoredDepth(DepthKind.WINDOW, NEAR_M, np.inf)
TURNED = HEAD @ transforms.rigid(transforms.rotation_about("y", np.deg2rad(0.5)), np.array([0.008, -0.004, 0.003]))
MOVED = HEAD @ transforms.rigid(np.eye(3), np.array([0.06, -0.02, 0.05]))


@pytest.fixture(scope="module")
def eye() -> Eye:
    return planar()


@pytest.fixture(scope="module")
def mesh(eye: Eye) -> WarpMesh:
    return WarpMesh(eye, SIZE, tolerance_arcmin=0.05)


def pupil(eye: Eye) -> FloatArray:
    return eye.eye_box.at(np.array([0.6, -0.5, 0.4]))


def triangles_around(mesh: WarpMesh, place: FloatArray) -> tuple[FloatArray, IntArray]:
    """(m, 3) barycentric coordinates of a panel place (2,) in each triangle, and which contain it."""
    corner = mesh.panel_position[mesh.triangles].astype(float)
    side = (corner[:, [1, 2]] - corner[:, [0]]).swapaxes(1, 2)
    weight = np.linalg.solve(side, (place - corner[:, 0])[..., None])[..., 0]
    weight = np.concatenate([1 - weight.sum(axis=1, keepdims=True), weight], axis=1)
    return weight, np.flatnonzero((weight > -1e-6).all(axis=1))


def interpolated(mesh: WarpMesh, rays: Float32Array, places: FloatArray) -> FloatArray:
    """Rays (n, 4) at panel places (n, 2), 0..1, as a rasteriser interpolates them."""
    weights = [(weight[around[0]], around[0]) for weight, around in (triangles_around(mesh, each) for each in places)]
    return np.stack([weight @ rays[mesh.triangles[around]] for weight, around in weights])


def test_rays_inside_triangles_are_within_the_bound(eye: Eye, mesh: WarpMesh) -> None:
    place = np.random.default_rng(5).uniform(0, 1, (60, 2))
    axes = mesh.camera(np.eye(4), pupil(eye)).view.device_from_camera
    exact = solve_pixels(eye, axes, place * eye.display.panel.size_px, pupil(eye)).slope_offset
    read = interpolated(mesh, mesh.rays(pupil(eye))[0], place)
    worst = ray_error_arcmin(read, exact).max()
    print(f"{len(mesh.panel_position)} vertices, bound {mesh.bound_arcmin:.3f}, worst of 60 {worst:.3f} arcmin")
    assert 0.2 * mesh.bound_arcmin < worst < mesh.bound_arcmin <= 0.05


def test_triangles_cover_the_panel_once(mesh: WarpMesh) -> None:
    places = np.random.default_rng(7).uniform(0, 1, (30, 2))
    assert {triangles_around(mesh, each)[1].size for each in places} == {1}


def test_a_finer_tolerance_makes_a_finer_mesh(eye: Eye, mesh: WarpMesh) -> None:
    finer = WarpMesh(eye, (1440, 1600), tolerance_arcmin=0.0125)
    assert 3 < len(finer.triangles) / len(mesh.triangles) < 6
    assert finer.bound_arcmin <= 0.0125


def test_a_mesh_is_no_finer_than_the_picture(eye: Eye) -> None:
    assert len(WarpMesh(eye, (18, 20), tolerance_arcmin=0.001).panel_position) <= 20 * 22


def exact_at_vertices(mappings: Eye, mesh: WarpMesh, viewpoint: FloatArray) -> FloatArray:
    axes = mesh.camera(np.eye(4), viewpoint).view.device_from_camera
    pixel = mesh.panel_position * mappings.display.panel.size_px
    return solve_pixels(mappings, axes, pixel, viewpoint).slope_offset


def test_each_colour_has_the_rays_of_its_own_model(flat_image_headset: Eye) -> None:
    see_through, at = narrowed(flat_image_headset.see_through, PrismPlate), pupil(flat_image_headset)
    colours = [
        replace(flat_image_headset, see_through=replace(see_through, prism=prism)) for prism in (-0.01, 0.0, 0.02)
    ]
    mesh = WarpMesh(colours, SIZE)
    for rays, mappings in zip(mesh.rays(at), colours, strict=True):
        assert ray_error_arcmin(rays, exact_at_vertices(mappings, mesh, at)).max() < 0.005


@dataclass(frozen=True)
class HalfDisplay:
    """A display without rays to the left of a column."""

    whole: DisplayMapping
    column: float

    def __getattr__(self, name: str) -> Any:
        return getattr(self.whole, name)

    def view_dir_of_pixel(self, pixel: FloatArray, viewpoint: FloatArray, warm_start: object = None) -> QueryResult:
        seen = self.whole.view_dir_of_pixel(pixel, viewpoint)
        lost = np.asarray(pixel)[..., 0] < self.column
        value, status = np.where(lost[..., None], np.nan, seen.value), np.where(lost, Status.MISS, seen.status)
        return QueryResult(value, status.astype(np.uint8))


def test_vertices_without_rays_are_nan_and_the_others_exact(flat_image_headset: Eye) -> None:
    half = replace(flat_image_headset, display=HalfDisplay(flat_image_headset.display, 50.0))
    mesh, at = WarpMesh(half, SIZE), pupil(flat_image_headset)
    rays, lost = mesh.rays(at)[0], mesh.panel_position[:, 0] * 140 < 50
    np.testing.assert_array_equal(np.isnan(rays).any(axis=1), lost)
    assert ray_error_arcmin(rays, exact_at_vertices(flat_image_headset, mesh, at))[~lost].max() < 0.005


def meshed(models: Any, **options: Any) -> WarpMesh:
    """Of what a caller gives in place of an eye and of options."""
    return WarpMesh(models, SIZE, **options)


@pytest.mark.parametrize(
    ("wrong", "words"),
    [
        (lambda eye, mesh: meshed({"left": planar("left"), "right": eye}), "one mesh for each eye"),
        (lambda eye, mesh: WarpMesh(eye, (0, 4)), r"size is \(0, 4\)"),
        (lambda eye, mesh: WarpMesh(eye, SIZE, tolerance_arcmin=0), "tolerance_arcmin is 0"),
        (lambda eye, mesh: meshed(eye, raster_camera="pupil"), "raster_camera is 'pupil'"),
        (lambda eye, mesh: mesh.rays([0, 0, np.nan]), "three finite numbers"),
        (lambda eye, mesh: mesh.rays([0, 0, 1.0]), "eye box's centre in z"),
        (lambda eye, mesh: mesh.camera(np.ones((4, 4)), pupil(eye)), "not a rotation"),
        (
            lambda eye, mesh: mesh.image_from_ray(
                WarpMesh(eye, (18, 20), tolerance_arcmin=1).camera(HEAD, pupil(eye)), pupil(eye), HEAD
            ),
            "not one of this mesh",
        ),
    ],
)
def test_wrong_input_is_named(eye: Eye, mesh: WarpMesh, wrong: Callable[..., Any], words: str) -> None:
    with pytest.raises(BadInputError, match=words):
        wrong(eye, mesh)


def judged(
    eye: Eye, mesh: WarpMesh, camera: EyeCamera, newest: FloatArray, source: Float32Array, colour: Float32Array
) -> None:
    """Prints and checks what a shader made: positions (h, w, 3) and linear light (h, w, 3), top row first."""
    expected = expected_source(eye, camera.view.device_from_camera, SIZE, camera, pupil(eye), newest)
    known = np.isfinite(expected[..., 0])
    assert known.mean() > 0.85
    assert (source[known, 2] == 1).all()
    error_px = np.linalg.norm(source[known, :2] - expected[known], axis=-1)
    bound_px = mesh.bound_arcmin * ARCMIN * max(camera.focal_px) * 1.5  # tangents stretch to the borders
    light_error = np.abs(colour[known] - light(*seen_by(camera, expected[known]))).max(axis=-1)
    print(
        f"source: median {np.median(error_px):.4f}, largest {error_px.max():.4f} px, mesh {bound_px:.4f} px; "
        f"light: median {np.median(light_error):.4f}, largest {light_error.max():.4f}"
    )
    assert error_px.max() < bound_px + 0.02
    assert np.median(light_error) < 0.006
    assert light_error.max() < 0.02


def check(gpu: OpenGl | WebGpu, eye: Eye, mesh: WarpMesh, newest: FloatArray, rows_up: bool = False) -> None:
    """The picture is of an older head pose and an older pupil."""
    camera = mesh.camera(HEAD, eye.eye_box.centre)
    colour, depth = drawn(camera)
    rows = mesh.image_from_ray(camera, pupil(eye), newest)
    warp = Warp(encode_srgb(colour.astype(np.float32)), depth, rows, STORED, 1 / 0.5, mesh.samples_per_axis)
    warp = warp.rows_up() if rows_up else warp
    rays = mesh.rays(pupil(eye))[0]
    source, light = (gpu.drawn(warp, SIZE, mesh, rays, only_source=each) for each in (True, False))
    source = np.where([False, rows_up, False], camera.size_px[1] - source, source)
    judged(eye, mesh, camera, newest, source, light)
    rays = np.where(mesh.panel_position[:, :1] < 0.5, np.float32(np.nan), rays)
    is_shown = gpu.drawn(warp, SIZE, mesh, rays, only_source=True)[..., 2]
    assert (is_shown[:, : SIZE[0] // 2 - 2] == 0).all()
    assert (is_shown[20:-20, SIZE[0] // 2 + 2 : -20] == 1).all()


def exact_paths(eye: Eye, camera: EyeCamera, rows: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Positions in a picture of the panel's rays at infinity, and how they move per 1/m: (h, w, 2) in pixels each."""
    pixel = WarpGrid.of_pixels(eye.display.panel, SIZE).panel_pixel()
    axes, at = camera.view.device_from_camera, eye.eye_box.centre
    a, b, c, d = np.moveaxis(solve_pixels(eye, axes, pixel, at).slope_offset, -1, 0)
    forwards = np.stack([a, b, np.full_like(a, -1), 0 * a], axis=-1) @ rows.T
    start = np.stack([c, d, 0 * a, np.ones_like(a)], axis=-1) @ rows.T
    at_infinity = forwards[..., :2] / forwards[..., 2:]
    return at_infinity, start[..., :2] - start[..., 2:] * at_infinity


ASIDE = HEAD @ transforms.rigid(np.eye(3), np.array([0.02, 0.0, 0.0]))


def check_wire(gpu: OpenGl | WebGpu, eye: Eye, mesh: WarpMesh, wire_m: float) -> None:
    """Check a wire of one pixel that is seen from 20 mm aside: it covers all rays that meet it, and no others."""
    camera, at = mesh.camera(HEAD, eye.eye_box.centre), eye.eye_box.centre
    width, height = camera.size_px
    column = width // 2 + round(0.02 / wire_m * camera.focal_px[0]) // 2
    wall_m = 6.0
    depth_m = np.full((height, width), wall_m)
    depth_m[:, column] = wire_m
    codes = np.zeros((height, width, 3), np.uint8)
    codes[:, column] = 255
    rows = mesh.image_from_ray(camera, at, ASIDE)
    depth = (1 - NEAR_M / depth_m).astype(np.float32)
    light = gpu.drawn(Warp(codes, depth, rows, STORED, 1 / NEAR_M, 1), SIZE, mesh, mesh.rays(at)[0])[..., 0]

    at_infinity, shift = exact_paths(eye, camera, rows.astype(float))
    on_wall, seen = at_infinity + shift / wall_m, at_infinity + shift / wire_m
    inside = (seen[..., 1] > 1) & (seen[..., 1] < height - 1)
    beside_px = np.abs(seen[..., 0] - column - 0.5)
    on_wire, off_wire = inside & (beside_px < 0.48), inside & (beside_px > 1)
    off_wire &= np.abs(on_wall[..., 0] - column - 0.5) > 1
    lowest, highest = light[on_wire].min(), light[off_wire].max()
    print(f"{wire_m} m: {on_wire.sum()} pixels on the wire, of {lowest:.3f} or more; beside it {highest:.3f} or less")
    assert on_wire.sum() > 0.5 * SIZE[1]
    assert lowest > 0.49
    assert highest == 0


@pytest.mark.gl
@pytest.mark.parametrize(("version", "newest"), [("420", TURNED), ("310 es", MOVED), ("300 es", MOVED)])
def test_the_warp_shows_what_the_exact_rays_meet(
    gl_context: GlContext, eye: Eye, mesh: WarpMesh, version: str, newest: FloatArray
) -> None:
    check(OpenGl(gl_context, version), eye, mesh, newest, rows_up=newest is MOVED)


@pytest.mark.gl
@pytest.mark.parametrize(("wire_m", "version"), [(0.1, "420"), (3.0, "300 es")])
def test_a_wire_of_one_pixel_is_whole_from_aside(
    gl_context: GlContext, eye: Eye, mesh: WarpMesh, wire_m: float, version: str
) -> None:
    check_wire(OpenGl(gl_context, version), eye, mesh, wire_m)


@pytest.mark.gl
@pytest.mark.parametrize("reversed_depth", [False, True])
def test_the_background_is_at_infinity_whatever_the_far_plane(
    gl_context: GlContext, eye: Eye, mesh: WarpMesh, reversed_depth: bool
) -> None:
    stored = StoredDepth(DepthKind.WINDOW, *((5.0, NEAR_M) if reversed_depth else (NEAR_M, 5.0)))
    camera, at = mesh.camera(HEAD, eye.eye_box.centre), eye.eye_box.centre
    shape = camera.size_px[::-1]
    rows = mesh.image_from_ray(camera, at, ASIDE)
    depth = np.full(shape, stored.nothing, np.float32)
    warp = Warp(np.zeros((*shape, 3), np.uint8), depth, rows, stored, 1 / NEAR_M, 1)
    source = OpenGl(gl_context, "420").drawn(warp, SIZE, mesh, mesh.rays(at)[0], only_source=True)
    expected, _ = exact_paths(eye, camera, rows.astype(float))
    shown = source[..., 2] == 1
    assert shown.mean() > 0.9
    assert np.abs(source[shown, :2] - expected[shown]).max() < 0.02


def spirv_of(name: str, folder: Path, only_source: bool = False) -> Path:
    """Compile a stage for Vulkan; skips the test without a compiler."""
    compiler = shutil.which("glslangValidator")
    if compiler is None:
        pytest.skip("glslangValidator is not installed (glslang-tools).")
    source, compiled = folder / f"450.{KINDS[name]}", folder / f"{name}.spv"
    source.write_text(stage(name, "450", only_source), encoding="utf-8")
    result = subprocess.run([compiler, "-V", source, "-o", compiled], capture_output=True, text=True)
    assert result.returncode == 0, result.stdout
    return compiled


@pytest.mark.slow
@pytest.mark.parametrize("given", ["SPIR-V", "WGSL"])
def test_the_warp_in_webgpu_shows_what_the_exact_rays_meet(
    eye: Eye, mesh: WarpMesh, given: str, tmp_path: Path
) -> None:
    wgpu = pytest.importorskip("wgpu", reason="wgpu is not installed; pip install '.[wgpu]'.")

    def spirv(name: str, only_source: bool) -> tuple[bytes, str]:
        return spirv_of(name, tmp_path, only_source).read_bytes(), "main"

    try:
        gpu = WebGpu(wgpu, wgsl if given == "WGSL" else spirv)
    except RuntimeError as error:
        pytest.skip(f"WebGPU finds no device; lavapipe of mesa-vulkan-drivers is one ({error}).")
    check(gpu, eye, mesh, MOVED)
    check_wire(gpu, eye, mesh, 0.1)


@needs_browser
@pytest.mark.slow
def test_a_browser_accepts_the_wgsl(tmp_path: Path) -> None:
    code, page = json.dumps(wgsl("", False)[0]), tmp_path / "empty.html"
    page.write_text("", encoding="utf-8")
    with driven_page(tmp_path, "--enable-unsafe-webgpu") as browser:
        browser.open(page, "document.readyState == 'complete'")
        messages = browser.value(f"""(async () => {{
            const adapter = await navigator.gpu.requestAdapter();
            if (!adapter)
                return null;
            const device = await adapter.requestDevice();
            const module = device.createShaderModule({{code: {code}}});
            const attribute = k => ({{format: `float32x${{2 * k + 2}}`, offset: 0, shaderLocation: k}});
            const buffers = [0, 1].map(k => ({{arrayStride: 8 * k + 8, attributes: [attribute(k)]}}));
            for (const [stage, format, buffer] of [["tiles_", "rg32float", []], ["", "rgba8unorm-srgb", buffers]])
                await device.createRenderPipelineAsync({{
                    layout: "auto", vertex: {{module, entryPoint: stage + "vertex", buffers: buffer}},
                    fragment: {{module, entryPoint: stage + "fragment", targets: [{{format}}]}}}});
            return (await module.getCompilationInfo()).messages.map(each => each.message);
        }})()""")
    if messages is None:
        pytest.skip("The browser finds no WebGPU device; Debian's package chromium brings SwiftShader.")
    assert messages == []


@pytest.mark.parametrize("name", KINDS)
def test_the_warp_compiles_for_each_language(name: str, tmp_path: Path) -> None:
    for version in ("420", "310 es", "300 es"):
        source = tmp_path / f"{version}.{KINDS[name]}"
        source.write_text(stage(name, version), encoding="utf-8")
        compiled = spirv_of(name, tmp_path)
        result = subprocess.run(["glslangValidator", source], capture_output=True, text=True)
        assert result.returncode == 0, result.stdout
    if shutil.which("spirv-cross") is None:
        pytest.skip("spirv-cross is not installed.")
    for language in (["--msl"], ["--hlsl", "--shader-model", "50"], ["--es", "--version", "310"], ["--version", "410"]):
        translated = subprocess.run(["spirv-cross", compiled, *language], capture_output=True, text=True)
        assert translated.returncode == 0, translated.stderr


@pytest.fixture(scope="module")
def writer() -> dict[str, Any]:
    """Names of the script that writes the shaders for others."""
    return runpy.run_path(str(Path(__file__).parents[2] / "release" / "own_warp.py"))


def shipped(language: str) -> str:
    return resource("shaders", f"own_warp.{language}").read_text(encoding="utf-8")


def test_the_warp_for_others_is_the_kernel(writer: dict[str, Any]) -> None:
    assert shipped("glsl") == writer["own_warp"]()


def test_the_wgsl_is_of_todays_glsl(writer: dict[str, Any]) -> None:
    assert writer["is_of"](shipped("wgsl"), shipped("glsl")), "Install naga-cli and run release/own_warp.py."


def test_the_wgsl_is_what_naga_writes(writer: dict[str, Any]) -> None:
    naga = shutil.which("naga")
    if naga is None:
        pytest.skip("naga is not installed; cargo install naga-cli.")
    written, kept = writer["wgsl_of"](shipped("glsl"), naga), shipped("wgsl")
    if written.splitlines()[1] != kept.splitlines()[1]:
        pytest.skip("naga is not installed in the version that wrote own_warp.wgsl; other versions write other text.")
    assert written == kept
