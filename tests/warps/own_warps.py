"""Warps by the shipped shaders, and what judges them: a scene of two planes, in closed form."""

from dataclasses import dataclass
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


class OpenGl:
    """The few calls that draw a mesh with `own_warp.glsl`."""

    def __init__(self, context: GlContext) -> None:
        self._context = context
        text = resource("shaders", "own_warp.glsl").read_text(encoding="utf-8")
        self._vertex = "#version 420\n#define VERTEX_STAGE\n" + text
        fragment = "#version 420\n#define FRAGMENT_STAGE\n" + text
        source = "void main() { colour = vec4(source_of_ray(), 1); }"
        self._shaders = {"fragment": fragment, "only_source": fragment.replace("void main()", "void none()") + source}

    def drawn(
        self, entry: str, warp: Warp, size: tuple[int, int], mesh: WarpMesh, rays: Float32Array, rows_up: bool = False
    ) -> Float32Array:
        """(height, width, 3) of what a shader writes, for a picture with its top or its bottom row first."""
        (height, width), rows = warp.depth.shape, slice(None, None, -1 if rows_up else 1)
        block = np.zeros(32, np.float32)  # std140
        block[:12] = warp.image_from_ray.ravel()
        block[12:16] = 2, 2, -1, -1  # the top row first in memory
        block[16:20] = (1 / width, -1 / height, 0, 1) if rows_up else (1 / width, 1 / height, 0, 0)
        block[20:23] = *warp.stored.inverse_of_0_and_1, warp.nearest
        block[23:24].view(np.int32)[:] = warp.samples_per_axis
        codes, depth = (np.ascontiguousarray(each[rows]).tobytes() for each in (warp.codes, warp.depth))
        with self._context.drawing() as ctx:
            picture = ctx.texture((width, height), 3, codes, alignment=1, internal_format=_GL_SRGB8)
            depths = ctx.texture((width, height), 1, depth, dtype="f4")
            depths.filter = ctx.NEAREST, ctx.NEAREST
            for texture, unit in ((picture, 1), (depths, 2)):
                texture.repeat_x = texture.repeat_y = False
                texture.use(unit)
            uniforms = ctx.buffer(block.tobytes())
            uniforms.bind_to_uniform_block(0)
            buffers = [ctx.buffer(each.tobytes()) for each in (mesh.panel_position, rays, mesh.triangles)]
            target = self._context.target(size, 4, "f4")
            framebuffer = self._context.framebuffer([target])
            program = ctx.program(self._vertex, self._shaders[entry])
            inputs = [(buffers[0], "2f", 0), (buffers[1], "4f", 1)]
            vertices = ctx.vertex_array(program, inputs, index_buffer=buffers[2])
            framebuffer.use()
            framebuffer.clear()
            vertices.render()
            answer = gl.read(target, np.float32)[..., :3]
            owned: list[moderngl.VertexArray | moderngl.Program | moderngl.Texture | moderngl.Buffer]
            owned = [vertices, program, picture, depths, uniforms, *buffers]
            for made in owned:
                made.release()
        return answer


WGSL_SOURCE = """
@fragment
fn only_source(corner: Corner) -> @location(0) vec4f { return vec4f(source_of(corner), 1.0); }
"""


class WebGpu:
    """The few calls that draw a mesh with `own_warp.wgsl`."""

    def __init__(self, wgpu: ModuleType) -> None:
        self.wgpu, self.device = wgpu, wgpu.gpu.request_adapter_sync().request_device_sync()
        text = resource("shaders", "own_warp.wgsl").read_text(encoding="utf-8")
        self.module = self.device.create_shader_module(code=text + WGSL_SOURCE)

    def texture(self, values: Float32Array | NDArray[np.uint8], kind: str) -> Any:
        """Of an array (height, width) or (height, width, 4)."""
        size = (values.shape[1], values.shape[0], 1)
        texture = self.device.create_texture(size=size, format=kind, usage="TEXTURE_BINDING | COPY_DST")
        layout = {"bytes_per_row": values.strides[0], "rows_per_image": size[1]}
        self.device.queue.write_texture({"texture": texture}, np.ascontiguousarray(values), layout, size)
        return texture.create_view()

    def drawn(self, entry: str, warp: Warp, size: tuple[int, int], mesh: WarpMesh, rays: Float32Array) -> Float32Array:
        """(height, width, 3) of what an entry point writes."""
        codes = np.dstack([warp.codes, np.full_like(warp.codes[..., :1], 255)])
        picture, depth = self.texture(codes, "rgba8unorm-srgb"), self.texture(warp.depth, "r32float")
        block = np.zeros(24, np.float32)
        block[:12] = warp.image_from_ray.ravel()
        block[12:16] = 2, -2, -1, 1
        block[16:19] = *warp.stored.inverse_of_0_and_1, warp.nearest
        block[19:20].view(np.uint32)[:] = warp.samples_per_axis
        device, buffer = self.device, self.device.create_buffer_with_data
        attributes = [{"format": f"float32x{k}", "offset": 0, "shader_location": i} for i, k in enumerate((2, 4))]
        target = device.create_texture(size=(*size, 1), format="rgba32float", usage="RENDER_ATTACHMENT | COPY_SRC")
        pipeline = device.create_render_pipeline(
            layout="auto",
            vertex={
                "module": self.module,
                "buffers": [
                    {"array_stride": 4 * k, "attributes": [each]} for k, each in zip((2, 4), attributes, strict=True)
                ],
            },
            fragment={"module": self.module, "entry_point": entry, "targets": [{"format": "rgba32float"}]},
        )
        sampler = device.create_sampler(mag_filter="linear", min_filter="linear")
        resources = [{"buffer": buffer(data=block, usage="UNIFORM")}, picture, sampler, depth]
        used = range(4) if entry == "fragment" else (0, 1, 3)
        group = device.create_bind_group(
            layout=pipeline.get_bind_group_layout(0),
            entries=[{"binding": k, "resource": resources[k]} for k in used],
        )
        encoder = device.create_command_encoder()
        attachment = {"view": target.create_view(), "load_op": "clear", "store_op": "store"}
        draw = encoder.begin_render_pass(color_attachments=[attachment])
        draw.set_pipeline(pipeline)
        draw.set_bind_group(0, group)
        draw.set_vertex_buffer(0, buffer(data=mesh.panel_position, usage="VERTEX"))
        draw.set_vertex_buffer(1, buffer(data=rays, usage="VERTEX"))
        draw.set_index_buffer(buffer(data=mesh.triangles, usage="INDEX"), "uint32")
        draw.draw_indexed(mesh.triangles.size)
        draw.end()
        device.queue.submit([encoder.finish()])
        layout = {"bytes_per_row": 16 * size[0], "rows_per_image": size[1]}
        read = device.queue.read_texture({"texture": target}, layout, (*size, 1))
        return np.frombuffer(read, np.float32).reshape(size[1], size[0], 4)[..., :3]
