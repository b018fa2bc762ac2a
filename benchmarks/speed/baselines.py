"""Baselines: raw Embree, and a bare OpenGL pass with a fixed warp map.

They call their libraries directly, because a baseline through our own layers would measure these layers. The shaded
pass has our shaders' text, so that both sides compute the same colours.
"""

from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from dataclasses import replace
from typing import Any

import moderngl
import numpy as np
from numpy.typing import NDArray

from wlr_render.draw.gl_raster import NEAR_M
from wlr_render.geometry import transforms
from wlr_render.gl.programs import shader_source
from wlr_render.io import atomic_files
from wlr_render.numerics.arrays import Float32Array
from wlr_render.scene.scene import Mesh, Scene, world_normals, world_positions
from wlr_render.warp.gpu_image import shader_intrinsics
from wlr_render.warp.view import View
from wlr_render.work.workers import usable_cores

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
_WARP = """
#version 410
uniform sampler2D picture;
uniform sampler2D source;
out vec4 colour;
void main() {
    colour = texture(picture, texelFetch(source, ivec2(gl_FragCoord.xy), 0).xy);
}
"""
_LINEAR_WARP = _WARP.replace("uniform sampler2D picture", '#include "srgb.glsl"\nuniform sampler2D picture').replace(
    "texture(picture, texelFetch(source, ivec2(gl_FragCoord.xy), 0).xy)",
    "vec4(srgb_of_linear(texture(picture, texelFetch(source, ivec2(gl_FragCoord.xy), 0).xy).rgb), 1.0)",
)
_SRGB8, _SRGB8_ALPHA8 = 0x8C41, 0x8C43


def raw_embree(scene: Scene, origin: Float32Array, direction: Float32Array) -> Callable[[], object]:
    """Return Embree's own query of rays (n, 3), in one contiguous share per processor, as a function."""
    from embreex.mesh_construction import TriangleMesh
    from embreex.rtcore_scene import EmbreeScene

    embree = EmbreeScene()
    for instance in scene.instances:
        mesh = scene.mesh_of(instance)
        TriangleMesh(embree, world_positions(mesh, instance).astype(np.float32), mesh.triangles.astype(np.int32))
    pool = ThreadPoolExecutor(usable_cores())
    shares = np.array_split(np.arange(len(direction)), usable_cores())
    blocks = [slice(share[0], share[-1] + 1) for share in shares]
    embree.run(origin[:1], direction[:1])

    def run() -> object:
        return list(pool.map(lambda block: embree.run(origin[block], direction[block], output=True), blocks))

    return run


def bare_gl_frame(scene: Scene, view: View, source_uv: NDArray[np.float32]) -> Callable[[], object]:
    """Draw a plain textured pass of a view, warped by a map (height, width, 2) uploaded once; read it back.

    It keeps no depth, and neither head nor eye moves: the least work per frame for a fixed distortion correction.
    Colours are filtered as stored.
    """
    context = own_context()
    mesh = in_world(scene)
    scene_pass = context.program(vertex_shader=_VERTEX, fragment_shader=_FRAGMENT)
    uv = np.zeros((len(mesh.position), 2), np.float32) if mesh.uv is None else mesh.uv
    vertices = context.buffer(np.hstack([mesh.position, mesh.normal, uv]).astype(np.float32))
    triangles = context.buffer(mesh.triangles.astype(np.uint32))
    drawn = context.vertex_array(scene_pass, [(vertices, "3f 3f 2f", "position", "normal", "uv")], triangles)
    texture = np.full((1, 1, 3), 255, np.uint8) if mesh.texture is None else mesh.texture
    surface = context.texture(texture.shape[1::-1], 3, np.ascontiguousarray(texture), alignment=1)
    scene_pass["clip_from_world"].write(np.ascontiguousarray(_clip_from_world(view).T, np.float32))
    scene_pass["towards_light"].value = (0.36, 0.8, 0.48)
    warp_pass = context.program(vertex_shader=shader_source("full_screen.vert", {}), fragment_shader=_WARP)
    picture = context.texture(view.camera.size_px, 4)

    def draw() -> None:
        surface.use(0)
        drawn.render()

    return _frame(context, draw, picture, warp_pass, source_uv)


def shaded_gl_frame(scene: Scene, view: View, source_uv: NDArray[np.float32]) -> Callable[[], object]:
    """Draw the same pass with our shaders' lights and colours, filtered in linear light and encoded once.

    The scene must be one textured mesh under directional lights.
    """
    context = own_context()
    for path in atomic_files.resource("shaders").glob("*.glsl"):
        context.includes[path.name] = path.read_text(encoding="utf-8")
    (instance,), suns = scene.instances, [light for light in scene.lights if light.kind == "directional"]
    mesh = scene.mesh_of(instance)
    constants: dict[str, float] = {"POINT_LIGHTS": 0, "DIRECTIONAL_LIGHTS": len(suns)}
    scene_pass = context.program(
        vertex_shader=shader_source("scene.vert", constants), fragment_shader=shader_source("scene.frag", constants)
    )
    colour = np.ones((len(mesh.position), 3)) if mesh.vertex_colour is None else mesh.vertex_colour
    assert mesh.texture is not None
    assert mesh.uv is not None
    values = {"position": mesh.position, "normal": mesh.normal, "uv": mesh.uv, "vertex_colour": colour}
    content = [(context.buffer(each.astype(np.float32)), f"{each.shape[1]}f", name) for name, each in values.items()]
    pixels = np.ascontiguousarray(mesh.texture)
    surface = context.texture(pixels.shape[1::-1], 3, pixels, alignment=1, internal_format=_SRGB8)
    drawn = context.vertex_array(scene_pass, content, context.buffer(mesh.triangles.astype(np.uint32)))
    camera_from_world = transforms.inverse(view.world_from_camera)
    camera_from_mesh = camera_from_world @ instance.world_from_mesh
    numbers = {
        "camera_from_mesh": camera_from_mesh.T,
        "camera_from_mesh_normal": np.linalg.inv(camera_from_mesh[:3, :3]),
        "lens": shader_intrinsics(view.camera),
        "size_px": (view.camera.width_px, view.camera.height_px),
        "near": NEAR_M,
        "base_colour": mesh.base_colour,
        "ambient": scene.ambient,
        "towards_directional_light": [-transforms.rotate(camera_from_world, light.vector) for light in suns],
        "directional_light_colour": [light.colour for light in suns],
    }
    for name, each in numbers.items():
        scene_pass[name].write(np.array(each, np.float32).tobytes())
    scene_pass["has_texture"].value, scene_pass["base_texture"].value = True, 0
    warp_pass = context.program(vertex_shader=shader_source("full_screen.vert", {}), fragment_shader=_LINEAR_WARP)
    picture = context.texture(view.camera.size_px, 4, internal_format=_SRGB8_ALPHA8)

    def draw() -> None:
        surface.use(0)
        drawn.render()

    return _frame(context, draw, picture, warp_pass, source_uv)


def in_world(scene: Scene) -> Mesh:
    """Return the scene's only mesh in world coordinates."""
    (instance,) = scene.instances
    mesh = scene.mesh_of(instance)
    return replace(
        mesh,
        position=world_positions(mesh, instance).astype(np.float32),
        normal=world_normals(mesh, instance).astype(np.float32),
    )


def own_context() -> Any:
    """Return a new OpenGL context of ModernGL."""
    settings: Any = {"standalone": True, "backend": "egl", "require": 430}
    return moderngl.create_context(**settings)


def _frame(
    context: Any, draw: Callable[[], None], picture: Any, warp_pass: Any, source_uv: NDArray[np.float32]
) -> Callable[[], object]:
    """Return a function that draws into the picture, warps it by the map and reads the result."""
    height, width = source_uv.shape[:2]
    full_screen = context.vertex_array(warp_pass, [])
    source = context.texture((width, height), 2, np.ascontiguousarray(source_uv), dtype="f4")
    intermediate = context.framebuffer([picture], context.depth_renderbuffer(picture.size))
    display = context.framebuffer([context.texture((width, height), 4)])
    warp_pass["picture"].value, warp_pass["source"].value = 0, 1
    result = bytearray(width * height * 4)

    def run() -> object:
        context.__enter__()
        intermediate.use()
        intermediate.clear(depth=1.0)
        context.enable_only(moderngl.DEPTH_TEST)
        draw()
        display.use()
        context.enable_only(moderngl.NOTHING)
        picture.use(0)
        source.use(1)
        full_screen.render(vertices=3)
        display.read_into(result, components=4)
        return result

    return run


def _clip_from_world(view: View) -> NDArray[np.float64]:
    near = 0.05
    (left, bottom), (right, top) = view.camera.tangent_min, view.camera.tangent_max
    projection = np.zeros((4, 4))
    projection[0, 0], projection[0, 2] = 2 / (right - left), (right + left) / (right - left)
    # Flipped, so that the top row comes first, as in the map.
    projection[1, 1], projection[1, 2] = -2 / (top - bottom), -(top + bottom) / (top - bottom)
    projection[2, 2], projection[2, 3], projection[3, 2] = -1.0, -2 * near, -1.0
    return np.asarray(projection @ np.linalg.inv(view.world_from_camera))
