"""The intermediate image drawn by pyrender: glTF's metallic-roughness materials instead of our Lambert shading.

Geometry agrees with `gl_raster.GlRaster`; colours differ by design (gloss, and a gamma of 2.2 for sRGB). pyrender opens
neither a window nor a context here: its renderer draws in our context, and `gl.GlContext.drawing` resets the
state that it leaves behind.
"""

import contextlib
import ctypes
import os
import sys
import weakref
from collections import defaultdict
from collections.abc import Callable, Iterator
from dataclasses import replace
from typing import Any, ClassVar

import numpy as np
from numpy.typing import NDArray

from wlr_render.draw.gl_raster import NEAR_M
from wlr_render.errors import BadInputError
from wlr_render.geometry import transforms
from wlr_render.gl import gl
from wlr_render.gl.mips import MipLevels
from wlr_render.numerics.srgb import encode_srgb
from wlr_render.scene.scene import LightSource, Mesh, Scene
from wlr_render.warp.gpu_image import GpuImage, LatestViews
from wlr_render.warp.picture_import import PictureImport
from wlr_render.warp.stored_picture import DepthKind, StoredDepth
from wlr_render.warp.view import GeometryImage, View

_FAR_M = 1e9  # has the same effect as infinity in float32
_PLATFORMS = {"egl", "osmesa"}  # platforms that must be set in PyOpenGL
_TEXTURE_2D, _UNPACK_ALIGNMENT = 0x0DE1, 0x0CF5
_IN_CODES = "baseColorTexture", "emissiveTexture"  # textures that pyrender's shader decodes from sRGB after filtering
_BRDF_NORMALISATION = np.pi  # pyrender divides albedo by pi; our shading model does not


class PyrenderDrawing:
    """Draws a caller's pyrender scene from any view.

    The loaded meshes and textures are freed with the context. A pyrender mesh lives in one context: a caller who also
    draws the scene with another renderer must make the scene twice.

    Raises:
        BadInputError: the node has no camera or is not in the scene, or PyOpenGL already serves another kind of context
            in this process; or, on drawing, a mesh was loaded in another context.
    """

    def __init__(self, context: gl.GlContext, graph: Any, camera_node: Any) -> None:
        """Prepare to draw `graph` (pyrender.Scene, in the world frame) with one of its camera nodes (pyrender.Node)."""
        self._context, self._graph, self._node = context, graph, camera_node
        self._pyrender = _import_pyrender(context.backend)
        if camera_node not in graph.camera_nodes:
            raise BadInputError("The node is not a camera of the pyrender scene: add it with scene.add(camera).")
        self._renderer = _renderer(self._pyrender, _Loader(context), self._bind_target)
        self._targets, self._latest = gl.RenderTargets(context), LatestViews()
        self._imports: defaultdict[str, PictureImport] = defaultdict(lambda: PictureImport(context))

    def draw_on_gpu(self, view: View, name: str = "") -> GpuImage:
        """Draw and leave the picture on the GPU; the next drawing of the same name overwrites it.

        The node keeps its pose and its camera, which gives the near and far planes. pyrender computes in float32: far
        from the world's origin a picture is less exact.
        """
        with _standing_at(self._pyrender, self._graph, self._node, view) as planes:
            size = self._renderer.viewport_width, self._renderer.viewport_height = view.camera.size_px
            with self._context.drawing():
                self._target = self._targets.get("", size, (4, "f1"), with_depth=True)
            with self._context.drawing(third_party=True):
                self._renderer.render(self._graph, self._pyrender.RenderFlags.NONE)
        (colour,), depth = self._target.textures, self._target.framebuffer.depth_attachment
        image = self._imports[name].from_textures(view.camera, colour, depth, planes)
        return replace(image, view=view, is_overwritten=self._latest.drawn(name, view))

    def _bind_target(self) -> None:
        self._context.draw_to(self._target.framebuffer)


class PyrenderView:
    """Draws one scene from any view with pyrender; its meshes and textures are freed with the context.

    Raises:
        BadInputError: PyOpenGL already serves another kind of context in this process.
    """

    def __init__(self, context: gl.GlContext, scene: Scene) -> None:
        self._scene = scene
        pyrender = _import_pyrender(context.backend)
        self._graph = pyrender.Scene(
            bg_color=encode_srgb(scene.background) / 255, ambient_light=np.array(scene.ambient, np.float64)
        )
        camera = self._graph.add(pyrender.IntrinsicsCamera(1, 1, 0, 0, znear=NEAR_M, zfar=_FAR_M))
        meshes = [_mesh(pyrender, mesh) for mesh in scene.meshes]
        self._instance_nodes = [self._graph.add(meshes[instance.mesh]) for instance in scene.instances]
        self._light_nodes = [self._graph.add(_light(pyrender, light)) for light in scene.lights]
        self._drawing, self._latest = PyrenderDrawing(context, self._graph, camera), LatestViews()

    def draw(self, view: View) -> GeometryImage:
        """Draw and fetch colour and inverse depth."""
        return self.draw_on_gpu(view).read()

    def draw_on_gpu(self, view: View, name: str = "") -> GpuImage:
        """Draw and leave the picture on the GPU; the next drawing of the same name overwrites it."""
        # The scene is moved in front of a camera at the origin, in float64: pyrender computes in float32.
        camera_from_world = transforms.inverse(view.world_from_camera)
        for node, instance in zip(self._instance_nodes, self._scene.instances, strict=True):
            self._graph.set_pose(node, camera_from_world @ instance.world_from_mesh)
        for node, light in zip(self._light_nodes, self._scene.lights, strict=True):
            self._graph.set_pose(node, camera_from_world @ _world_from_light(light))
        image = self._drawing.draw_on_gpu(View(view.camera, np.zeros(3), np.eye(4)), name)
        return replace(image, view=view, is_overwritten=self._latest.drawn(name, view))


@contextlib.contextmanager
def _standing_at(pyrender: Any, graph: Any, node: Any, view: View) -> Iterator[StoredDepth]:
    """Give a camera node a view's pose and intrinsics in a block; yield the encoding of its depth buffer."""
    camera, pose, main = node.camera, node.matrix.copy(), graph.main_camera_node
    (focal_u, focal_v), (centre_u, centre_v) = view.camera.focal_px, view.camera.centre_px
    far = _FAR_M if camera.zfar is None else camera.zfar
    try:
        node.camera = pyrender.IntrinsicsCamera(focal_u, focal_v, centre_u, centre_v, znear=camera.znear, zfar=far)
        parent_from_world = pose @ np.linalg.inv(graph.get_pose(node))
        graph.set_pose(node, parent_from_world @ view.world_from_camera)
        graph.main_camera_node = node
        yield StoredDepth(DepthKind.WINDOW, camera.znear, far)
    finally:
        node.camera = camera
        graph.set_pose(node, pose)
        graph.main_camera_node = main


def _import_pyrender(backend: str) -> Any:
    if backend not in _PLATFORMS:  # a window's platform, which PyOpenGL finds without help
        import pyrender

        return pyrender
    # pyrender imports its window, which needs X11 unless it is headless; PyOpenGL chooses its library at import.
    chosen = _platform_of_pyopengl() or os.environ.setdefault("PYOPENGL_PLATFORM", backend)
    if chosen != backend:
        raise BadInputError(
            f"PyOpenGL is set to {chosen}, the OpenGL context is {backend}: "
            f"set the environment variable PYOPENGL_PLATFORM={backend}."
        )
    if "pyrender" not in sys.modules:
        import pyglet

        pyglet.options["headless"] = True
    import pyrender

    return pyrender


def _platform_of_pyopengl() -> str:
    """Return the platform that PyOpenGL has chosen in this process; empty before it is imported."""
    platform = sys.modules.get("OpenGL.platform")
    return "" if platform is None else type(platform.PLATFORM).__name__.removesuffix("Platform").lower()


def _renderer(pyrender: Any, loader: "_Loader", bind_target: Callable[[], None]) -> Any:
    """Return a pyrender renderer that draws one sample at each pixel's centre into the bound target.

    With `RenderFlags.OFFSCREEN` pyrender would draw four samples, keep the depth of the first, which is (-1/8, +3/8)
    pixels from the centre, and read the picture back.
    """

    def configure(renderer: Any, flags: int) -> None:
        pyrender.Renderer._configure_forward_pass_viewport(renderer, flags)  # binds the window's framebuffer
        bind_target()

    methods = {
        "_configure_forward_pass_viewport": configure,
        "_update_context": lambda renderer, graph, flags: loader(graph),
        # On garbage collection, `delete` would delete objects with these numbers in whichever context is current.
        "delete": lambda renderer: None,
    }
    return type("Renderer", (pyrender.Renderer,), methods)(1, 1)


class _Loader:
    """Loads a scene's meshes and textures into the context."""

    _in_contexts: ClassVar[weakref.WeakKeyDictionary[gl.GlContext, weakref.WeakSet[Any]]] = weakref.WeakKeyDictionary()

    def __init__(self, context: gl.GlContext) -> None:
        self._context, self._levels = context, MipLevels(context)
        self._loaded: set[Any] = set()
        self._in_context = self._in_contexts.setdefault(context, weakref.WeakSet())
        context.tracked(self)

    def __call__(self, graph: Any) -> None:
        primitives = {primitive for mesh in graph.meshes for primitive in mesh.primitives}
        wanted = primitives.union(*(primitive.material.textures for primitive in primitives))
        for thing in self._loaded - wanted:
            thing.delete()
        missing = {thing for thing in wanted if not thing._in_context()}
        if not self._context.host_is_clean and wanted - missing - set(self._in_context):
            raise BadInputError(
                "A mesh of the pyrender scene has been loaded by another renderer, and pyrender binds meshes to "
                "contexts: make the scene a second time for PyrenderDrawing."
            )
        self._in_context.update(missing)
        # pyrender uploads rows of any length without setting their alignment.
        self._context.function("glPixelStorei", ctypes.c_uint, ctypes.c_int)(_UNPACK_ALIGNMENT, 1)
        for thing in missing:
            thing._add_to_context()
        in_codes = {getattr(primitive.material, name, None) for primitive in primitives for name in _IN_CODES}
        for texture in missing - primitives:
            if texture.source is not None and texture.tex_type == _TEXTURE_2D:
                self._refill(texture, texture in in_codes)
        self._loaded = (self._loaded & wanted) | missing

    def release(self) -> None:
        """Delete the meshes and textures: a host that shares textures with the context would keep their memory."""
        for thing in self._loaded:
            thing.delete()
        self._loaded = set()

    def _refill(self, texture: Any, holds_codes: bool) -> None:
        """Replace the driver's mip levels by means over all texels."""
        height, width = texture.source.shape[:2]
        self._levels.refill(self._context.third_party_texture(texture._texid, (width, height)), holds_codes)


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
    # pyrender stores textures bottom row first.
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


def _light(pyrender: Any, light: LightSource) -> Any:
    strength = max(float(light.colour.max()), 1e-12)
    kind = pyrender.PointLight if light.kind == "point" else pyrender.DirectionalLight
    return kind(color=light.colour / strength, intensity=strength * _BRDF_NORMALISATION)


def _world_from_light(light: LightSource) -> NDArray[np.float64]:
    """Return a pose at a point light, or with -z along a directional light."""
    if light.kind == "point":
        return transforms.rigid(np.eye(3), light.vector)
    backwards = -light.vector / np.linalg.norm(light.vector)
    sideways = np.cross(np.eye(3)[np.argmin(np.abs(backwards))], backwards)
    sideways /= np.linalg.norm(sideways)
    return transforms.rigid(np.stack([sideways, np.cross(backwards, sideways), backwards], axis=1), np.zeros(3))
