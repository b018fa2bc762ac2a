"""Warps by the shipped shaders, and what judges them: a scene of two planes, in closed form."""

import re
from collections.abc import Callable
from dataclasses import dataclass, replace
from types import ModuleType
from typing import Any

import moderngl
import numpy as np
from numpy.typing import NDArray
from warps.composing import HEAD

from wlr_render.geometry import transforms
from wlr_render.geometry.directions import dir_of_tangents
from wlr_render.gl import gl
from wlr_render.gl.context import GlContext
from wlr_render.io.atomic_files import resource
from wlr_render.mappings import Eye, Panel
from wlr_render.numerics.arrays import BoolArray, Float32Array, FloatArray
from wlr_render.warp.eye_camera import EyeCamera
from wlr_render.warp.grid import WarpGrid
from wlr_render.warp.ray_map import solve_pixels
from wlr_render.warp.stored_picture import StoredDepth
from wlr_render.warp.warp_mesh import WarpMesh

NEAR_M = 0.05
WALL_M, CARD_M = 2.0, 0.6
CARD = np.array([[-0.08, 0.06], [0.05, 0.15]])  # x from, to; y from, to
_GL_SRGB8 = 0x8C41
_HEAD_FROM_WORLD = transforms.inverse(HEAD)


def hit(origin: FloatArray, direction: FloatArray) -> tuple[FloatArray, BoolArray]:
    """Points (..., 3) in the world and whether the card is met, of rays there; the planes face HEAD."""
    origin, direction = transforms.apply(_HEAD_FROM_WORLD, origin), transforms.rotate(_HEAD_FROM_WORLD, direction)
    on_card = origin - direction * ((origin[..., 2:] + CARD_M) / direction[..., 2:])
    on_wall = origin - direction * ((origin[..., 2:] + WALL_M) / direction[..., 2:])
    is_card: BoolArray = np.all((on_card[..., :2] > CARD[:, 0]) & (on_card[..., :2] < CARD[:, 1]), axis=-1)
    return transforms.apply(HEAD, np.where(is_card[..., None], on_card, on_wall)), is_card


def light(point: FloatArray, is_card: BoolArray) -> FloatArray:
    """Linear (..., 3): waves that are some twenty pixels long."""
    point = transforms.apply(_HEAD_FROM_WORLD, point)
    wave = 0.5 + 0.4 * np.sin(point * [20.0, 17.0, 0.0] * np.where(is_card, 3.0, 1.0)[..., None] + [0.0, 1.0, 0.5])
    return np.stack([wave[..., 0], wave[..., 1], 0.25 + 0.5 * is_card], axis=-1)


def seen_by(camera: EyeCamera, pixel: FloatArray) -> tuple[FloatArray, BoolArray]:
    """`hit` of positions (..., 2) in the picture of an EyeCamera."""
    in_camera = dir_of_tangents(camera.view.camera.tangents_of_pixel(pixel))
    direction = transforms.rotate(camera.world_from_camera, in_camera)
    return hit(np.broadcast_to(camera.view.position_in_world, direction.shape), direction)


def drawn(camera: EyeCamera) -> tuple[FloatArray, Float32Array]:
    """(linear colour (h, w, 3), depth buffer (h, w) float32 with 0 at NEAR_M and 1 at infinity) of an EyeCamera."""
    point, is_card = seen_by(camera, WarpGrid.of_pixels(Panel(*camera.size_px)).panel_pixel())
    depth_m = -transforms.apply(camera.camera_from_world, point)[..., 2]
    return light(point, is_card), (1 - NEAR_M / depth_m).astype(np.float32)


def expected_source(
    mappings: Eye,
    axes: FloatArray,
    size_px: tuple[int, int],
    camera: EyeCamera,
    viewpoint: FloatArray,
    pose: FloatArray,
) -> FloatArray:
    """Positions (h, w, 2) in the picture, by the exact rays; NaN where the picture does not show the point.

    A point within two pixels of a silhouette, in the picture or on the display, counts as not shown.
    """
    pixel = WarpGrid.of_pixels(mappings.display.panel, size_px).panel_pixel()
    rays = solve_pixels(mappings, axes, pixel, viewpoint).slope_offset
    world_from_rays = pose @ transforms.rigid(axes, viewpoint)
    start = np.concatenate([rays[..., 2:], np.zeros_like(rays[..., :1])], axis=-1)
    point, is_card = hit(
        transforms.apply(world_from_rays, start), transforms.rotate(world_from_rays, dir_of_tangents(rays[..., :2]))
    )
    in_camera = transforms.apply(camera.camera_from_world, point)
    source = camera.view.camera.pixel_of_tangents(in_camera[..., :2] / -in_camera[..., 2:])
    width, height = camera.size_px
    _, shows_card = seen_by(camera, WarpGrid.of_pixels(Panel(width, height)).panel_pixel())
    known: BoolArray = np.all((source > 2) & (source < [width - 2, height - 2]), axis=-1)
    column, row = (
        np.where(known[..., None], source, 2).astype(int)[..., 0],
        np.where(known, source[..., 1], 2).astype(int),
    )
    for y in range(-2, 3):
        for x in range(-2, 3):
            known &= shows_card[row + y, column + x] == is_card
            known &= np.roll(is_card, (y, x), axis=(0, 1)) == is_card
    return np.where(known[..., None], source, np.nan)


@dataclass(frozen=True)
class Warp:
    """What the shaders are given besides the mesh; `codes` (h, w, 3) uint8 sRGB, the top row first."""

    codes: np.ndarray
    depth: np.ndarray
    image_from_ray: np.ndarray
    stored: StoredDepth
    nearest: float
    samples_per_axis: int

    def block(self, clip_from_panel: tuple[float, float, float, float]) -> bytes:
        """Return the shader's uniforms, black behind a picture without alpha."""
        given = *self.image_from_ray.ravel(), *clip_from_panel, *self.stored.inverse_of_0_and_1, self.stored.nothing
        return np.array([*given, self.nearest, 0, 0, 0, 1, self.samples_per_axis, 0, 0, 0], np.float32).tobytes()

    def rows_up(self) -> "Warp":
        """Return the same picture with its bottom row first, as OpenGL draws."""
        row_u, row_v, row_depth = self.image_from_ray
        rows = np.stack([row_u, len(self.depth) * row_depth - row_v, row_depth])
        return replace(self, codes=self.codes[::-1], depth=self.depth[::-1], image_from_ray=rows)


def stage(name: str, version: str, only_source: bool = False) -> str:
    """Return the shipped shader's text for a stage and a version of GLSL.

    With only_source it writes (u, v, 1 where the picture shows something) in place of colour.
    """
    text = resource("shaders", "own_warp.glsl").read_text(encoding="utf-8")
    if only_source:
        colour = "colour = vec4(light, alpha);"
        assert text.count(colour) == 1
        text = text.replace(colour, "colour = vec4(seen_at, float(worst <= DISOCCLUDED), 1.0);")
    return f"#version {version}\n#define {name}_STAGE\n{text}"


class OpenGl:
    """The few calls that draw a mesh with `own_warp.glsl`, of any version of GLSL that the context compiles."""

    def __init__(self, context: GlContext, version: str) -> None:
        self._context, self._version = context, version

    def _program(self, ctx: moderngl.Context, name: str, only_source: bool = False) -> moderngl.Program:
        vertex = stage(f"{name}VERTEX", self._version)
        fragment = stage(f"{name}FRAGMENT", self._version, only_source=only_source)
        program = ctx.program(vertex, fragment)
        for texture, unit in (("picture", 1), ("depth", 2), ("inverse_depth", 2), ("tiles", 3), ("Warp", 0)):
            # WebGL 2 numbers nothing in the text.
            member = program.get(texture, None)
            if isinstance(member, moderngl.UniformBlock):
                member.binding = unit
            elif isinstance(member, moderngl.Uniform):
                member.value = unit
        return program

    def drawn(
        self, warp: Warp, size: tuple[int, int], mesh: WarpMesh, rays: Float32Array, only_source: bool = False
    ) -> Float32Array:
        """(height, width, 3) of what the shader writes, the top row first."""
        height, width = warp.depth.shape
        with self._context.drawing() as ctx:
            picture = ctx.texture((width, height), 3, warp.codes.tobytes(), alignment=1, internal_format=_GL_SRGB8)
            depths = ctx.texture((width, height), 1, warp.depth.tobytes(), dtype="f4")
            tiles = self._context.target((-(-width // 8), -(-height // 8)), 2, "f4")
            for unit, texture in enumerate((picture, depths, tiles), start=1):
                texture.filter = (ctx.LINEAR if texture is picture else ctx.NEAREST,) * 2
                texture.repeat_x = texture.repeat_y = False
                texture.use(unit)
            uniforms = ctx.buffer(warp.block((2, 2, -1, -1)))  # the top row first in memory
            uniforms.bind_to_uniform_block(0)
            of_tiles = ctx.vertex_array(self._program(ctx, "TILES_"), [])
            self._context.framebuffer([tiles]).use()
            of_tiles.render(vertices=3)
            buffers = [ctx.buffer(each.tobytes()) for each in (mesh.panel_position, rays, mesh.triangles)]
            target = self._context.target(size, 4, "f4")
            program = self._program(ctx, "", only_source)
            inputs = [(buffers[0], "2f", 0), (buffers[1], "4f", 1)]
            vertices = ctx.vertex_array(program, inputs, index_buffer=buffers[2])
            framebuffer = self._context.framebuffer([target])
            framebuffer.use()
            framebuffer.clear()
            vertices.render()
            answer = gl.read(target, np.float32)[..., :3]
            owned: list[moderngl.VertexArray | moderngl.Program | moderngl.Texture | moderngl.Buffer]
            owned = [vertices, program, of_tiles, of_tiles.program, picture, depths, uniforms, *buffers]
            for made in owned:
                made.release()
        return answer


def wgsl(name: str, only_source: bool) -> tuple[str, str]:
    """Return the shipped WGSL and the entry point of a stage; `only_source` as in `stage`."""
    text = resource("shaders", "own_warp.wgsl").read_text(encoding="utf-8")
    if only_source:
        text, count = re.subn(
            r"fragment_colour = .*;", "fragment_colour = vec4f(fragment_seen_at, f32(fragment_worst <= 1), 1);", text
        )
        assert count == 1
    return text, name.lower()


class WebGpu:
    """The few calls that draw a mesh with `own_warp.glsl` in WebGPU.

    Args:
        wgpu: the module.
        code: returns the code, SPIR-V or WGSL, and the entry point of a stage, as `wgsl` does.
    """

    def __init__(self, wgpu: ModuleType, code: Callable[[str, bool], tuple[bytes | str, str]]) -> None:
        self.device, self._code = wgpu.gpu.request_adapter_sync().request_device_sync(), code
        unfiltered: dict[str, Any] = {"texture": {"sample_type": "unfilterable-float"}}
        resources: list[dict[str, Any]] = [{"buffer": {}}, {"texture": {}}, unfiltered, unfiltered]
        resources += [{"sampler": {}}, {"sampler": {"type": "non-filtering"}}]
        both = wgpu.ShaderStage.VERTEX | wgpu.ShaderStage.FRAGMENT
        entries = [{"binding": k, "visibility": both, **each} for k, each in enumerate(resources)]
        self._bindings = self.device.create_bind_group_layout(entries=entries)

    def texture(self, values: Float32Array | NDArray[np.uint8], kind: str) -> Any:
        """Of an array (height, width) or (height, width, 4)."""
        size = (values.shape[1], values.shape[0], 1)
        texture = self.device.create_texture(size=size, format=kind, usage="TEXTURE_BINDING | COPY_DST")
        layout = {"bytes_per_row": values.strides[0], "rows_per_image": size[1]}
        self.device.queue.write_texture({"texture": texture}, np.ascontiguousarray(values), layout, size)
        return texture

    def _target(self, size: tuple[int, int], kind: str) -> Any:
        usage = "RENDER_ATTACHMENT | TEXTURE_BINDING | COPY_SRC"
        return self.device.create_texture(size=(*size, 1), format=kind, usage=usage)

    def _pass(
        self, encoder: Any, target: Any, name: str, resources: list[Any], buffers: list[Any], only_source: bool
    ) -> Any:
        """Begin a pass of a stage's programs."""
        device = self.device
        codes = (self._code(f"{name}{kind}", only_source) for kind in ("VERTEX", "FRAGMENT"))
        vertex, fragment = (
            {"module": device.create_shader_module(code=code), "entry_point": entry} for code, entry in codes
        )
        pipeline = device.create_render_pipeline(
            layout=device.create_pipeline_layout(bind_group_layouts=[self._bindings]),
            vertex={**vertex, "buffers": buffers},
            fragment={**fragment, "targets": [{"format": target.format}]},
        )
        attachment = {"view": target.create_view(), "load_op": "clear", "store_op": "store"}
        entries = [{"binding": k, "resource": each} for k, each in enumerate(resources)]
        draw = encoder.begin_render_pass(color_attachments=[attachment])
        draw.set_pipeline(pipeline)
        draw.set_bind_group(0, device.create_bind_group(layout=self._bindings, entries=entries))
        return draw

    def drawn(
        self, warp: Warp, size: tuple[int, int], mesh: WarpMesh, rays: Float32Array, only_source: bool = False
    ) -> Float32Array:
        """(height, width, 3) of what the shader writes, the top row first."""
        device, buffer = self.device, self.device.create_buffer_with_data
        codes = np.dstack([warp.codes, np.full_like(warp.codes[..., :1], 255)])
        picture, depth = self.texture(codes, "rgba8unorm-srgb"), self.texture(warp.depth, "r32float")
        height, width = warp.depth.shape
        tiles, target = self._target((-(-width // 8), -(-height // 8)), "rg32float"), self._target(size, "rgba32float")
        block = {"buffer": buffer(data=warp.block((2, -2, -1, 1)), usage="UNIFORM")}
        between = device.create_sampler(mag_filter="linear", min_filter="linear")
        views = [each.create_view() for each in (picture, depth, depth)]
        resources = [block, *views, between, device.create_sampler()]
        encoder = device.create_command_encoder()
        draw = self._pass(encoder, tiles, "TILES_", resources, [], False)
        draw.draw(3)
        draw.end()
        resources[3] = tiles.create_view()
        layouts = [
            {"array_stride": 4 * k, "attributes": [{"format": f"float32x{k}", "offset": 0, "shader_location": i}]}
            for i, k in enumerate((2, 4))
        ]
        draw = self._pass(encoder, target, "", resources, layouts, only_source)
        draw.set_vertex_buffer(0, buffer(data=mesh.panel_position, usage="VERTEX"))
        draw.set_vertex_buffer(1, buffer(data=rays, usage="VERTEX"))
        draw.set_index_buffer(buffer(data=mesh.triangles, usage="INDEX"), "uint32")
        draw.draw_indexed(mesh.triangles.size)
        draw.end()
        device.queue.submit([encoder.finish()])
        layout = {"bytes_per_row": 16 * size[0], "rows_per_image": size[1]}
        read = device.queue.read_texture({"texture": target}, layout, (*size, 1))
        return np.frombuffer(read, np.float32).reshape(size[1], size[0], 4)[..., :3]
