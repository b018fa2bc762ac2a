"""A scene in an OpenGL context, drawn from any view, with our shading or with glTF materials."""

from functools import cached_property
from typing import Protocol

from wlr_render.draw.gl_raster import GlRaster
from wlr_render.errors import BadInputError, MissingGlError
from wlr_render.gl import gl
from wlr_render.scene.scene import Scene
from wlr_render.warp.gpu_image import GpuImage
from wlr_render.warp.view import GeometryImage, View

BACKENDS = ("auto", "egl", "osmesa", "cpu")
MATERIALS = ("own", "gltf")


class _Drawing(Protocol):
    def draw_on_gpu(self, view: View, name: str = "") -> GpuImage:
        """Draw and leave the picture on the GPU; the next drawing of the same name overwrites it."""


class SceneRaster:
    """Draws one scene; the scene is uploaded when it is first drawn.

    Attributes:
        context: OpenGL context of the pictures.
        scene: the scene that is drawn.
    """

    def __init__(self, context: gl.GlContext, scene: Scene, materials: str = "own") -> None:
        """Prepare; for `materials` see `open_scene_raster`."""
        self.context, self.scene, self._materials = context, scene, materials

    @property
    def backend(self) -> str:
        """Name of the backend, "egl" or "osmesa"; the platform of an adopted context."""
        return self.context.backend

    def draw(self, view: View) -> GeometryImage:
        """Draw `view` and fetch colour and inverse depth."""
        return self.draw_on_gpu(view).read()

    def draw_on_gpu(self, view: View, name: str = "") -> GpuImage:
        """Draw and leave the picture on the GPU; the next drawing of the same name overwrites it."""
        return self._drawing.draw_on_gpu(view, name)

    @cached_property
    def _drawing(self) -> _Drawing:
        if self._materials == "own":
            return GlRaster(self.context, self.scene)
        from wlr_render.draw.pyrender_drawing import PyrenderView

        return PyrenderView(self.context, self.scene)


def open_scene_raster(scene: Scene, backend: str = "auto", materials: str = "own") -> SceneRaster | None:
    """Open an OpenGL context for one scene.

    Args:
        scene: scene to draw.
        backend: "egl", "osmesa", "auto" for the first that works, or "cpu" for none.
        materials: "own" for the shading model of docs/conventions.md, "gltf" for pyrender's physically based one,
            which needs OpenGL.

    Returns:
        None for "cpu", and for "auto" if no OpenGL opens: draw ray-traced frames (`painters.TracedPainter`).

    Raises:
        BadInputError: an unknown choice, or "gltf" materials without OpenGL.
        MissingGlError: OpenGL was requested by name, or by "gltf" materials, and does not open.
    """
    if backend not in BACKENDS or materials not in MATERIALS:
        raise BadInputError(f"'{backend}' with '{materials}' materials: choose from {BACKENDS} and {MATERIALS}.")
    if backend == "cpu":
        if materials == "gltf":
            raise BadInputError("glTF materials need OpenGL: choose the backend egl or osmesa, or our own materials.")
        return None
    try:
        return SceneRaster(gl.open_context(backend), scene, materials)
    except MissingGlError:
        if backend != "auto" or materials == "gltf":
            raise
        return None
