"""Baselines: raw Embree, and a bare OpenGL pass with a fixed warp map.

They call their libraries directly, because a baseline that went through our own layers would
measure those.
"""

from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from typing import Any

import numpy as np
from numpy.typing import NDArray

from wlr_render.numerics.arrays import Float32Array
from wlr_render.rendering.scene import Mesh, Scene, world_positions
from wlr_render.rendering.thread_pool import worker_count
from wlr_render.rendering.view import View

_VERTEX = """
#version 430
uniform mat4 clip_from_world;
in vec3 position;
in vec3 normal;
in vec2 uv;
out vec3 world_normal;
out vec2 texture_uv;
void main() {
    world_normal = normal;
    texture_uv = uv;
    gl_Position = clip_from_world * vec4(position, 1.0);
}
"""
_FRAGMENT = """
#version 430
uniform sampler2D surface;
uniform vec3 towards_light;
in vec3 world_normal;
in vec2 texture_uv;
out vec4 colour;
void main() {
    float light = 0.3 + 0.7 * max(0.0, dot(normalize(world_normal), towards_light));
    colour = vec4(texture(surface, texture_uv).rgb * light, 1.0);
}
"""
_FULL_SCREEN = """
#version 430
void main() {
    gl_Position = vec4(gl_VertexID == 1 ? 3.0 : -1.0, gl_VertexID == 2 ? 3.0 : -1.0, 0.0, 1.0);
}
"""
_WARP = """
#version 430
uniform sampler2D picture;
uniform sampler2D source;
out vec4 colour;
void main() {
    colour = texture(picture, texelFetch(source, ivec2(gl_FragCoord.xy), 0).xy);
}
"""


def raw_embree(scene: Scene, origin: Float32Array, direction: Float32Array) -> Callable[[], object]:
    """Embree's own query of (n, 3) rays, one contiguous share per processor; call the result to run it."""
    from embreex.mesh_construction import TriangleMesh
    from embreex.rtcore_scene import EmbreeScene

    embree = EmbreeScene()
    for instance in scene.instances:
        mesh = scene.mesh_of(instance)
        TriangleMesh(embree, world_positions(mesh, instance).astype(np.float32), mesh.triangles.astype(np.int32))
    pool = ThreadPoolExecutor(worker_count())
    shares = np.array_split(np.arange(len(direction)), worker_count())
    blocks = [slice(share[0], share[-1] + 1) for share in shares]
    embree.run(origin[:1], direction[:1])

    def run() -> object:
        return list(pool.map(lambda block: embree.run(origin[block], direction[block], output=True), blocks))

    return run


def bare_gl_frame(mesh: Mesh, view: View, source_uv: NDArray[np.float32]) -> Callable[[], object]:
    """A plain textured pass at the display's size, warped by a map (height, width, 2) uploaded once, and read back.

    No depth is kept, no head or eye moves: the least that a fixed distortion correction does per frame.
    """
    import moderngl

    settings: Any = {"standalone": True, "backend": "egl", "require": 430}
    context: Any = moderngl.create_context(**settings)
    height, width = source_uv.shape[:2]
    scene_pass = context.program(vertex_shader=_VERTEX, fragment_shader=_FRAGMENT)
    warp_pass = context.program(vertex_shader=_FULL_SCREEN, fragment_shader=_WARP)
    uv = np.zeros((len(mesh.position), 2), np.float32) if mesh.uv is None else mesh.uv
    vertices = context.buffer(np.hstack([mesh.position, mesh.normal, uv]).astype(np.float32))
    triangles = context.buffer(mesh.triangles.astype(np.uint32))
    drawn = context.vertex_array(scene_pass, [(vertices, "3f 3f 2f", "position", "normal", "uv")], triangles)
    full_screen = context.vertex_array(warp_pass, [])
    texture = np.full((1, 1, 3), 255, np.uint8) if mesh.texture is None else mesh.texture
    surface = context.texture(texture.shape[1::-1], 3, np.ascontiguousarray(texture), alignment=1)
    picture = context.texture((width, height), 4)
    source = context.texture((width, height), 2, np.ascontiguousarray(source_uv), dtype="f4")
    intermediate = context.framebuffer([picture], context.depth_renderbuffer((width, height)))
    display = context.framebuffer([context.texture((width, height), 4)])
    scene_pass["clip_from_world"].write(np.ascontiguousarray(_clip_from_world(view).T, np.float32))
    scene_pass["towards_light"].value = (0.36, 0.8, 0.48)
    result = bytearray(width * height * 4)

    def run() -> object:
        context.__enter__()
        intermediate.use()
        intermediate.clear(depth=1.0)
        context.enable_only(moderngl.DEPTH_TEST)
        surface.use(0)
        drawn.render()
        display.use()
        context.enable_only(moderngl.NOTHING)
        picture.use(0)
        source.use(1)
        warp_pass["picture"].value = 0
        warp_pass["source"].value = 1
        full_screen.render(vertices=3)
        display.read_into(result, components=4)
        return result

    return run


def _clip_from_world(view: View) -> NDArray[np.float64]:
    near = 0.05
    (left, bottom), (right, top) = view.camera.tangent_min, view.camera.tangent_max
    projection = np.zeros((4, 4))
    projection[0, 0], projection[0, 2] = 2 / (right - left), (right + left) / (right - left)
    # Turned over: the top row comes first, as in the map.
    projection[1, 1], projection[1, 2] = -2 / (top - bottom), -(top + bottom) / (top - bottom)
    projection[2, 2], projection[2, 3], projection[3, 2] = -1.0, -2 * near, -1.0
    return np.asarray(projection @ np.linalg.inv(view.world_from_camera))
