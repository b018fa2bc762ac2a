"""The intermediate image drawn by pyrender: glTF's metallic-roughness materials instead of our Lambert shading.

Geometry agrees with `raster.GlRaster`; colours differ by design (gloss, and a gamma of 2.2 for sRGB). pyrender has
neither window nor context of its own here: its renderer draws inside ours, and `gl.GlContext.drawing` clears up the
switches that it leaves on.
"""

import contextlib
import os
from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from wlr_render.errors import BadInputError
from wlr_render.geometry import transforms
from wlr_render.rendering import gl
from wlr_render.rendering.gpu_image import GpuImage
from wlr_render.rendering.raster import NEAR_M
from wlr_render.rendering.scene import Light, Mesh, Scene
from wlr_render.rendering.srgb import encode_srgb
from wlr_render.rendering.view import GeometryImage, View

_FAR_M = 1e9  # in float32 the same as infinity
_BRDF_NORMALISATION = np.pi  # pyrender divides albedo by pi, our shading model does not


@dataclass(frozen=True, eq=False)
class _Targets:
    """pyrender's picture as textures, then the same turned over, with inverse depth."""

    upward: gl.Framebuffer
    upward_colour: gl.Texture
    upward_depth: gl.Texture
    result: gl.Framebuffer
    colour: gl.Texture
    inverse_depth: gl.Texture


class PyrenderView:
    """Draws one scene from any view with pyrender; what it loads is freed with the context.

    Raises:
        BadInputError: PyOpenGL already serves another kind of context in this process.
    """

    def __init__(self, context: gl.GlContext, scene: Scene) -> None:
        self._context = context
        self._scene = scene
        self._pyrender = _import_pyrender(context.backend)
        self._renderer = _renderer(self._pyrender)
        self._targets: _Targets | None = None
        self._graph = self._pyrender.Scene(
            bg_color=encode_srgb(scene.background) / 255, ambient_light=np.array(scene.ambient, np.float64)
        )
        self._camera = self._pyrender.IntrinsicsCamera(1, 1, 0, 0, znear=NEAR_M, zfar=_FAR_M)
        self._graph.add(self._camera)
        meshes = [_mesh(self._pyrender, mesh) for mesh in scene.meshes]
        self._instance_nodes = [self._graph.add(meshes[instance.mesh]) for instance in scene.instances]
        self._light_nodes = [self._graph.add(_light(self._pyrender, light)) for light in scene.lights]
        with context.drawing():
            self._import = context.full_screen("import_picture.frag")

    def draw(self, view: View) -> GeometryImage:
        """Draw and fetch colour and inverse depth."""
        return self.draw_on_gpu(view).read()

    def draw_on_gpu(self, view: View) -> GpuImage:
        """Draw and leave the picture on the GPU; the next drawing of this object overwrites it."""
        self._place(view)
        flags = self._pyrender.RenderFlags
        with self._context.drawing(), _without_multisampling(self._pyrender.renderer):
            self._renderer.render(self._graph, flags.OFFSCREEN | flags.SKIP_CULL_FACES)
        with self._context.drawing():
            targets = self._targets_for(view)
            self._context.copy_foreign_framebuffer(int(self._renderer._main_fb_ms), targets.upward)
            targets.result.use()
            gl.bind_textures(
                self._import.program, upward_colour=targets.upward_colour, upward_depth=targets.upward_depth
            )
            gl.set_uniforms(self._import.program, near=NEAR_M)
            self._import.render(vertices=3)
        return GpuImage(self._context, view.camera, targets.colour, targets.inverse_depth)

    def _place(self, view: View) -> None:
        """Put the camera at the origin and the scene before it, in float64: pyrender computes in float32."""
        pinhole = view.camera
        self._renderer.viewport_width, self._renderer.viewport_height = pinhole.width_px, pinhole.height_px
        self._camera.fx, self._camera.fy = pinhole.focal_px
        self._camera.cx, self._camera.cy = pinhole.centre_px
        camera_from_world = transforms.inverse(view.world_from_camera)
        for node, instance in zip(self._instance_nodes, self._scene.instances, strict=True):
            self._graph.set_pose(node, camera_from_world @ instance.world_from_mesh)
        for node, light in zip(self._light_nodes, self._scene.lights, strict=True):
            self._graph.set_pose(node, camera_from_world @ _world_from_light(light))

    def _targets_for(self, view: View) -> _Targets:
        size = view.camera.width_px, view.camera.height_px
        if self._targets is None or self._targets.colour.size != size:
            context = self._context
            upward_colour, upward_depth = context.target(size, 4, "f1"), context.depth_target(size)
            colour, inverse_depth = context.target(size, 4, "f1"), context.target(size, 1, "f4")
            self._targets = _Targets(
                context.framebuffer([upward_colour], upward_depth),
                upward_colour,
                upward_depth,
                context.framebuffer([colour, inverse_depth]),
                colour,
                inverse_depth,
            )
        return self._targets


def _import_pyrender(backend: str) -> Any:
    # pyrender imports its window, which wants X11 unless told otherwise; PyOpenGL chooses its library at import.
    if os.environ.setdefault("PYOPENGL_PLATFORM", backend) != backend:
        raise BadInputError(
            f"PyOpenGL is set to {os.environ['PYOPENGL_PLATFORM']}, the OpenGL context is {backend}: "
            f"set the environment variable PYOPENGL_PLATFORM={backend}."
        )
    import pyglet

    pyglet.options["headless"] = True
    import pyrender

    return pyrender


def _renderer(pyrender: Any) -> Any:
    renderer = pyrender.Renderer(1, 1)
    # The picture stays on the GPU; pyrender would read it back, and depth in two passes over the image.
    renderer._read_main_framebuffer = lambda scene, flags: None
    # Python's garbage collection would delete objects of these numbers in whichever context is current then.
    renderer.delete = lambda: None
    return renderer


@contextlib.contextmanager
def _without_multisampling(module: Any) -> Iterator[None]:
    """Make pyrender's renderer allocate its framebuffers with one sample, at the pixel's centre.

    It asks for four and keeps the depth of the first, which lies (-1/8, +3/8) pixels beside the centre.
    """
    original = module.glRenderbufferStorageMultisample
    module.glRenderbufferStorageMultisample = lambda target, samples, *rest: original(target, 0, *rest)
    try:
        yield
    finally:
        module.glRenderbufferStorageMultisample = original


def _mesh(pyrender: Any, mesh: Mesh) -> Any:
    texture = None
    if mesh.texture is not None:
        texture = pyrender.Texture(source=mesh.texture, source_channels="RGB")
    material = pyrender.MetallicRoughnessMaterial(
        baseColorFactor=[*map(float, mesh.base_colour), 1.0],
        baseColorTexture=texture,
        metallicFactor=0.0,
        roughnessFactor=1.0,
        doubleSided=True,
    )
    # pyrender stores textures upwards.
    uv = None if mesh.uv is None else mesh.uv * [1, -1] + [0, 1]
    return pyrender.Mesh(
        [
            pyrender.Primitive(
                mesh.position,
                normals=mesh.normal,
                texcoord_0=uv,
                color_0=mesh.vertex_colour,
                indices=mesh.triangles,
                material=material,
            )
        ],
        name=mesh.name,
    )


def _light(pyrender: Any, light: Light) -> Any:
    strength = max(float(light.colour.max()), 1e-12)
    kind = pyrender.PointLight if light.kind == "point" else pyrender.DirectionalLight
    return kind(color=light.colour / strength, intensity=strength * _BRDF_NORMALISATION)


def _world_from_light(light: Light) -> NDArray[np.float64]:
    """A pose at a point light, or one whose -z axis a directional light follows."""
    if light.kind == "point":
        return transforms.rigid(np.eye(3), light.vector)
    backwards = -light.vector / np.linalg.norm(light.vector)
    sideways = np.cross(np.eye(3)[np.argmin(np.abs(backwards))], backwards)
    sideways /= np.linalg.norm(sideways)
    return transforms.rigid(np.stack([sideways, np.cross(backwards, sideways), backwards], axis=1), np.zeros(3))
