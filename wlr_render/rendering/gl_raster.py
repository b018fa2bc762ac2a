"""Rasterisation of a scene by our own OpenGL pass: colour and inverse depth, and on demand position, normal and ids.

Vertices are carried into the camera frame with a matrix composed in float64, so that a viewpoint far from the world's
origin costs no precision. Both sides of every triangle are drawn, without multisampling: a pixel shows what its
centre sees.
"""

from collections.abc import Collection
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from wlr_render.errors import BadInputError
from wlr_render.geometry import transforms
from wlr_render.numerics.arrays import FloatArray
from wlr_render.rendering import gl
from wlr_render.rendering.gpu_image import GpuImage, LatestViews, rgb_of_rgba, shader_intrinsics
from wlr_render.rendering.scene import Mesh, Scene
from wlr_render.rendering.srgb import encode_srgb
from wlr_render.rendering.view import GeometryImage, View

NEAR_M = 0.05
"""Nothing nearer to the viewpoint than this is drawn."""

_FORMATS = {"colour": (4, "srgb"), "inverse_depth": (1, "f4")}
_EXTRA = {"position": (3, "f4"), "normal": (3, "f4"), "ids": (2, "i4")}


@dataclass(frozen=True, eq=False)
class _Pass:
    """A program, the scene's meshes bound to it, and what fills the rest."""

    program: gl.Program
    meshes: list[gl.VertexArray]
    background: gl.VertexArray


class GlRaster:
    """Draws one scene from any view; the meshes are uploaded once, instances of a mesh share them."""

    def __init__(self, context: gl.GlContext, scene: Scene) -> None:
        self._context = context
        self._scene = scene
        self._world_from_normal = [np.linalg.inv(each.world_from_mesh[:3, :3]).T for each in scene.instances]
        self._lamps = [light for light in scene.lights if light.kind == "point"]
        self._suns = [light for light in scene.lights if light.kind == "directional"]
        self._targets, self._latest = gl.RenderTargets(context), LatestViews()
        self._passes: dict[bool, _Pass] = {}
        with context.drawing():
            self._textures = [None if m.texture is None else context.srgb_texture(m.texture) for m in scene.meshes]
            self._pass_for(with_extra=False)

    def draw(self, view: View, buffers: Collection[str] = ()) -> GeometryImage:
        """Draw and fetch colour and inverse depth, and of "position", "normal", "ids" those named in `buffers`."""
        for name in buffers:
            if name not in _EXTRA:
                raise BadInputError(f"There is no buffer '{name}'; ask for some of {', '.join(_EXTRA)}.")
        with self._context.drawing():
            textures = self._draw(view, with_extra=bool(buffers))
            self._latest.drawn("", view)
            extra = {name: gl.read(textures[name], _EXTRA[name][1]) for name in buffers}
            ids = extra.get("ids")
            return GeometryImage(
                colour=rgb_of_rgba(gl.read(textures["colour"], np.uint8)),
                inverse_depth=gl.read(textures["inverse_depth"], np.float32),
                position=extra.get("position"),
                normal=extra.get("normal"),
                instance=None if ids is None else np.ascontiguousarray(ids[..., 0]),
                triangle=None if ids is None else np.ascontiguousarray(ids[..., 1]),
            )

    def draw_on_gpu(self, view: View, name: str = "") -> GpuImage:
        """Draw and leave the picture on the GPU; the next drawing of the same name overwrites it."""
        with self._context.drawing():
            textures = self._draw(view, with_extra=False, name=name)
        colour, inverse_depth = textures["colour"], textures["inverse_depth"]
        return GpuImage(self._context, view.camera, colour, inverse_depth, view, self._latest.drawn(name, view))

    def _draw(self, view: View, with_extra: bool, name: str = "") -> dict[str, gl.Texture]:
        size = view.camera.width_px, view.camera.height_px
        formats = _FORMATS | (_EXTRA if with_extra else {})
        target = self._targets.get(f"{name}/{with_extra}", size, *formats.values(), with_depth=True)
        target.framebuffer.use()
        # Only the depth matters here: the background is drawn last, at infinity, over what nothing has covered.
        target.framebuffer.clear(depth=1.0)
        self._context.depth_test()
        drawing = self._pass_for(with_extra)
        camera_from_world = transforms.inverse(view.world_from_camera)
        self._set_view(drawing.program, view, camera_from_world)
        for index, instance in enumerate(self._scene.instances):
            self._set_instance(drawing.program, camera_from_world, index)
            texture = self._textures[instance.mesh]
            if texture is not None:
                gl.bind_textures(drawing.program, base_texture=texture)
            drawing.meshes[instance.mesh].render()
        gl.set_uniforms(drawing.background.program, background=_triple(encode_srgb(self._scene.background) / 255))
        drawing.background.render(vertices=3)
        return dict(zip(formats, target.textures, strict=True))

    def _pass_for(self, with_extra: bool) -> _Pass:
        """Software renderers compute every output of a shader, whether or not anything takes it: hence two programs."""
        if with_extra not in self._passes:
            program = self._context.program(
                "scene.vert",
                "scene.frag",
                POINT_LIGHTS=len(self._lamps),
                DIRECTIONAL_LIGHTS=len(self._suns),
                WITH_EXTRA=int(with_extra),
            )
            meshes = [_upload(self._context, program, mesh) for mesh in self._scene.meshes]
            background = self._context.full_screen("background.frag", WITH_EXTRA=int(with_extra))
            self._passes[with_extra] = _Pass(program, meshes, background)
        return self._passes[with_extra]

    def _set_view(self, program: gl.Program, view: View, camera_from_world: FloatArray) -> None:
        scene, camera = self._scene, view.camera
        lamps = [transforms.apply(camera_from_world, light.vector) for light in self._lamps]
        suns = [-transforms.rotate(camera_from_world, light.vector) for light in self._suns]
        gl.set_array(program, "point_light_position", lamps)
        gl.set_array(program, "point_light_colour", [light.colour for light in self._lamps])
        gl.set_array(program, "towards_directional_light", suns)
        gl.set_array(program, "directional_light_colour", [light.colour for light in self._suns])
        gl.set_uniforms(
            program,
            lens=shader_intrinsics(camera),
            size_px=(camera.width_px, camera.height_px),
            near=NEAR_M,
            camera_in_world=_triple(view.position_in_world),
            ambient=_triple(scene.ambient),
        )
        gl.set_matrix(program, "world_from_camera", view.world_from_camera[:3, :3])

    def _set_instance(self, program: gl.Program, camera_from_world: FloatArray, index: int) -> None:
        instance = self._scene.instances[index]
        mesh = self._scene.mesh_of(instance)
        gl.set_matrix(program, "camera_from_mesh", camera_from_world @ instance.world_from_mesh)
        # A rotation is its own inverse transpose.
        gl.set_matrix(program, "camera_from_mesh_normal", camera_from_world[:3, :3] @ self._world_from_normal[index])
        gl.set_uniforms(
            program,
            base_colour=_triple(mesh.base_colour),
            has_texture=mesh.texture is not None,
            instance=index,
        )


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
