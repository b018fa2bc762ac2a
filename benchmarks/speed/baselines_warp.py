"""Baseline warps by a fixed map, as in today's runtimes: Monado's two schemes in OpenGL, and cv2.remap.

For the benchmark only, directly on their libraries, like `baselines.py`. Both schemes read red, green and blue at
separate positions. Monado (src/xrt/compositor/shaders: mesh.vert and mesh.frag; distortion_timewarp.comp) stores them
as three texture coordinates of a mesh's vertices, or as three small textures, which are read with linear filtering
between texel centres and then rotated by the head's newer rotation. `frozen_map.py` computes a scheme's map. The 8-bit
picture is filtered as stored, without decoding and encoding, which makes these schemes a little cheaper than a runtime.
"""

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from benchmarks.speed.baselines import own_context
from wlr_render.geometry.pinhole import Pinhole
from wlr_render.numerics.arrays import Float32Array

Uint8Array = NDArray[np.uint8]

_WORKGROUP = 8
_MESH_VERTEX = """
#version 430
in vec2 place;
in vec2 red_uv;
in vec2 green_uv;
in vec2 blue_uv;
out vec2 uv[3];
void main() {
    uv[0] = red_uv;
    uv[1] = green_uv;
    uv[2] = blue_uv;
    gl_Position = vec4(2.0 * place - 1.0, 0.0, 1.0);
}
"""
_MESH_FRAGMENT = """
#version 430
uniform sampler2D picture;
in vec2 uv[3];
out vec4 colour;
void main() {
    colour = vec4(texture(picture, uv[0]).r, texture(picture, uv[1]).g, texture(picture, uv[2]).b, 1.0);
}
"""
_IMAGE_MAPS = f"""
#version 430
layout(local_size_x = {_WORKGROUP}, local_size_y = {_WORKGROUP}) in;
layout(binding = 0) uniform sampler2D picture;
layout(binding = 1) uniform sampler2D maps[3];
layout(binding = 0, rgba8) uniform writeonly image2D display;
uniform mat3 drawn_from_newer;
vec2 source(sampler2D map, vec2 at) {{
    vec3 turned = drawn_from_newer * vec3(texture(map, at).xy, 1.0);
    return turned.xy / turned.z;
}}
void main() {{
    ivec2 pixel = ivec2(gl_GlobalInvocationID.xy);
    ivec2 size = imageSize(display);
    if (any(greaterThanEqual(pixel, size))) {{
        return;
    }}
    vec2 texels = vec2(textureSize(maps[0], 0));
    vec2 at = ((vec2(pixel) + 0.5) / vec2(size) * (texels - 1.0) + 0.5) / texels;
    float red = texture(picture, source(maps[0], at)).r;
    float green = texture(picture, source(maps[1], at)).g;
    float blue = texture(picture, source(maps[2], at)).b;
    imageStore(display, pixel, vec4(red, green, blue, 1.0));
}}
"""


@dataclass(frozen=True, eq=False)
class GlWarpBaseline:
    """One warp in its own OpenGL context.

    Attributes:
        context: ModernGL's context; used as a context manager, it is current.
        draw: draws one frame into the target; returns before the GPU has finished.
        read: reads the target, (height, width, 4) uint8, top row first.
        release: destroys the context and all its objects.
    """

    context: Any
    draw: Callable[[], None]
    read: Callable[[], Uint8Array]
    release: Callable[[], None]


def mesh_warp(picture: Uint8Array, channel_uv: Float32Array, size: tuple[int, int]) -> GlWarpBaseline:
    """Return scheme 1: a mesh over the display, with three texture coordinates per vertex.

    Args:
        picture: (height, width, 3) intermediate image, uploaded once.
        channel_uv: (3, rows, columns, 2) texture coordinates for red, green and blue at the mesh's points, which lie
            from edge to edge of the display, top row first.
        size: (width, height) of the display.
    """
    context = own_context()
    rows, columns = channel_uv.shape[1:3]
    x, y = np.meshgrid(np.linspace(0, 1, columns), np.linspace(0, 1, rows))
    vertices = np.concatenate([x[None, ..., None], y[None, ..., None]], axis=-1)
    vertices = np.concatenate([vertices, channel_uv]).transpose(1, 2, 0, 3).astype(np.float32)
    program = context.program(vertex_shader=_MESH_VERTEX, fragment_shader=_MESH_FRAGMENT)
    layout = (context.buffer(vertices.tobytes()), "2f 2f 2f 2f", "place", "red_uv", "green_uv", "blue_uv")
    mesh = context.vertex_array(program, [layout], context.buffer(_triangles(rows, columns)))
    source, target = _texture(context, picture), context.texture(size, 4)
    display = context.framebuffer([target])

    def draw() -> None:
        context.__enter__()
        display.use()
        source.use(0)
        mesh.render()

    return _baseline(context, target, draw)


def _triangles(rows: int, columns: int) -> NDArray[np.uint32]:
    """Return two triangles per cell, cut from its upper right to its lower left corner."""
    point = np.arange(rows * columns, dtype=np.uint32).reshape(rows, columns)
    first, right, lower, last = point[:-1, :-1], point[:-1, 1:], point[1:, :-1], point[1:, 1:]
    return np.stack([first, right, lower, last, lower, right], axis=-1)


def image_maps_warp(
    picture: Uint8Array, channel_uv: Float32Array, size: tuple[int, int], drawn_from_newer: NDArray[np.float64]
) -> GlWarpBaseline:
    """Return scheme 2: a compute shader reads three small maps and rotates their coordinates with the head.

    Args:
        picture: (height, width, 3) intermediate image, uploaded once.
        channel_uv: (3, rows, columns, 2), see `mesh_warp`; the outermost texel centres lie on the display's edges.
        size: (width, height) of the display.
        drawn_from_newer: (3, 3) matrix on texture coordinates (u, v, 1), from `timewarp`; set in every frame.
    """
    context = own_context()
    shader = context.compute_shader(_IMAGE_MAPS)
    maps = [_texture(context, each) for each in channel_uv]
    source, target = _texture(context, picture), context.texture(size, 4)
    groups = [-(-pixels // _WORKGROUP) for pixels in size]
    matrix = np.ascontiguousarray(drawn_from_newer.T, np.float32).tobytes()

    def draw() -> None:
        context.__enter__()
        shader["drawn_from_newer"].write(matrix)
        for unit, texture in enumerate([source, *maps]):
            texture.use(unit)
        target.bind_to_image(0, read=False, write=True)
        shader.run(*groups)
        context.memory_barrier()

    return _baseline(context, target, draw)


def timewarp(camera: Pinhole, drawn_from_newer: NDArray[np.float64]) -> NDArray[np.float64]:
    """Convert a rotation (3, 3) between the frames of two cameras to a matrix (3, 3) on texture coordinates (u, v, 1).

    The matrix converts texture coordinates in the newer frame to texture coordinates of the picture drawn in the older
    frame.
    """
    scale, offset = camera.focal_px * [1, -1], camera.centre_px
    size = np.array([camera.width_px, camera.height_px])
    uv_of_tangents = np.eye(3)
    uv_of_tangents[[0, 1], [0, 1]], uv_of_tangents[:2, 2] = scale / size, offset / size
    # Tangents represent the direction (tx, ty, -1).
    forward = np.diag([1.0, 1.0, -1.0])
    return np.asarray(uv_of_tangents @ forward @ drawn_from_newer @ forward @ np.linalg.inv(uv_of_tangents))


def remap_warp(picture: Uint8Array, source_px: Float32Array) -> Callable[[], Uint8Array]:
    """Return cv2.remap with a fixed map: each call returns a frame (height, width, 3), which the next call overwrites.

    Args:
        picture: (height, width, 3) intermediate image.
        source_px: (height, width, 2) pull map, (0, 0) is the outer corner of the picture.
    """
    in_opencv = np.ascontiguousarray(source_px - np.float32(0.5))
    result = np.empty((*source_px.shape[:2], 3), np.uint8)
    return lambda: np.asarray(cv2.remap(picture, in_opencv, None, cv2.INTER_LINEAR, dst=result), np.uint8)


def _texture(context: Any, content: Uint8Array | Float32Array) -> Any:
    """Create a linearly filtered texture that repeats its border: a map or a picture, padded to 4 bytes per texel."""
    height, width, components = content.shape
    if content.dtype == np.uint8:
        padded = np.concatenate([content, np.full((height, width, 1), 255, np.uint8)], axis=-1)
        texture = context.texture((width, height), 4, padded.tobytes())
    else:
        texture = context.texture((width, height), components, np.ascontiguousarray(content).tobytes(), dtype="f4")
    texture.repeat_x = texture.repeat_y = False
    return texture


def _baseline(context: Any, target: Any, draw: Callable[[], None]) -> GlWarpBaseline:
    def read() -> Uint8Array:
        context.__enter__()
        return np.frombuffer(target.read(), np.uint8).reshape(target.height, target.width, 4)

    return GlWarpBaseline(context, draw, read, context.release)
