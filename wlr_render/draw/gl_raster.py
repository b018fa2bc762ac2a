"""Rasterisation of a scene by our own OpenGL pass: colour and inverse depth.

Vertices are transformed to the camera frame with a matrix composed in float64, so that a viewpoint far from the world's
origin costs no precision. Both sides of every triangle are drawn, without multisampling: a pixel shows what its
centre sees.
"""

import ctypes

import numpy as np
from numpy.typing import NDArray

from wlr_render.geometry import transforms
from wlr_render.gl import gl
from wlr_render.numerics.arrays import FloatArray
from wlr_render.numerics.srgb import encode_srgb
from wlr_render.scene.scene import Mesh, Scene
from wlr_render.warp.gpu_image import GpuImage, LatestViews, shader_intrinsics
from wlr_render.warp.view import GeometryImage, View

NEAR_M = 0.05
"""Distance of the near plane from the viewpoint."""

_COLOR = 0x1800
_AT_INFINITY = (ctypes.c_float * 4)()


class GlRaster:
    """Draws one scene from any view; a mesh is uploaded once for all its instances."""

    def __init__(self, context: gl.GlContext, scene: Scene) -> None:
        self._context = context
        self._scene = scene
        self._world_from_normal = [np.linalg.inv(each.world_from_mesh[:3, :3]).T for each in scene.instances]
        self._lamps = [light for light in scene.lights if light.kind == "point"]
        self._suns = [light for light in scene.lights if light.kind == "directional"]
        self._targets, self._latest = gl.RenderTargets(context), LatestViews()
        with context.drawing():
            self._textures = [None if m.texture is None else context.srgb_texture(m.texture) for m in scene.meshes]
            self._program = context.program(
                "scene.vert", "scene.frag", POINT_LIGHTS=len(self._lamps), DIRECTIONAL_LIGHTS=len(self._suns)
            )
            self._meshes = [_upload(context, self._program, mesh) for mesh in scene.meshes]
            self._clear_buffer = context.function("glClearBufferfv", ctypes.c_uint, ctypes.c_int, ctypes.c_void_p)
        self._background = _triple(encode_srgb(scene.background) / 255)

    def draw(self, view: View) -> GeometryImage:
        """Draw and fetch colour and inverse depth."""
        return self.draw_on_gpu(view).read()

    def draw_on_gpu(self, view: View, name: str = "") -> GpuImage:
        """Draw and leave the picture on the GPU; the next drawing of the same name overwrites it."""
        with self._context.drawing():
            size = view.camera.width_px, view.camera.height_px
            target = self._targets.get(name, size, (4, "srgb"), (1, "f4"), with_depth=True)
            target.framebuffer.use()
            red, green, blue = self._background
            target.framebuffer.clear(red, green, blue, 1.0, 1.0)
            self._clear_buffer(_COLOR, 1, _AT_INFINITY)  # ModernGL would clear all colour buffers to one value
            self._context.depth_test()
            camera_from_world = transforms.inverse(view.world_from_camera)
            self._set_view(view, camera_from_world)
            for index, instance in enumerate(self._scene.instances):
                self._set_instance(camera_from_world, index)
                texture = self._textures[instance.mesh]
                if texture is not None:
                    gl.bind_textures(self._program, base_texture=texture)
                self._meshes[instance.mesh].render()
        colour, inverse_depth = target.textures
        return GpuImage(self._context, view.camera, colour, inverse_depth, view, self._latest.drawn(name, view))

    def _set_view(self, view: View, camera_from_world: FloatArray) -> None:
        program, camera = self._program, view.camera
        lamps = [transforms.apply(camera_from_world, light.vector) for light in self._lamps]
        suns = [-transforms.rotate(camera_from_world, light.vector) for light in self._suns]
        gl.set_uniforms(
            program,
            lens=shader_intrinsics(camera),
            size_px=(camera.width_px, camera.height_px),
            near=NEAR_M,
            ambient=_triple(self._scene.ambient),
            point_light_position=gl.floats(np.array(lamps)),
            point_light_colour=gl.floats(np.array([light.colour for light in self._lamps])),
            towards_directional_light=gl.floats(np.array(suns)),
            directional_light_colour=gl.floats(np.array([light.colour for light in self._suns])),
        )

    def _set_instance(self, camera_from_world: FloatArray, index: int) -> None:
        program, instance = self._program, self._scene.instances[index]
        mesh = self._scene.mesh_of(instance)
        gl.set_matrix(program, "camera_from_mesh", camera_from_world @ instance.world_from_mesh)
        # A rotation is its own inverse transpose.
        gl.set_matrix(program, "camera_from_mesh_normal", camera_from_world[:3, :3] @ self._world_from_normal[index])
        gl.set_uniforms(program, base_colour=_triple(mesh.base_colour), has_texture=mesh.texture is not None)


def _upload(context: gl.GlContext, program: gl.Program, mesh: Mesh) -> gl.VertexArray:
    count = len(mesh.position)
    attributes = {
        "position": mesh.position,
        "normal": mesh.normal,
        "uv": np.zeros((count, 2)) if mesh.uv is None else mesh.uv,
        "vertex_colour": np.ones((count, 3)) if mesh.vertex_colour is None else mesh.vertex_colour,
    }
    return context.triangles(program, attributes, mesh.triangles)


def _triple(vector: NDArray[np.floating]) -> tuple[float, ...]:
    return tuple(float(x) for x in vector)
