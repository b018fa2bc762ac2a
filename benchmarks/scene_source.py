"""Our own rasteriser as the engine that feeds a compositor."""

from wlr_render.compositing.compositor import Compositor
from wlr_render.compositing.eye_camera import EyeCamera
from wlr_render.rendering.scene import Scene
from wlr_render.rendering.stored_picture import DepthKind, StoredDepth
from wlr_render.rendering.view import GeometryImage, View


class SceneSource:
    """Draws one scene for a compositor, in its own context, or with the CPU where it has none."""

    def __init__(self, compositor: Compositor, scene: Scene) -> None:
        """Upload the scene."""
        self._compositor = compositor
        if compositor.context is None:
            from wlr_render.rendering.raster_backends import EmbreeRaster

            self._on_cpu: EmbreeRaster | None = EmbreeRaster(scene)
            return
        from wlr_render.rendering.gl_raster import GlRaster

        self._on_cpu, self._on_gpu = None, GlRaster(compositor.context, scene)

    def submit(self, camera: EyeCamera) -> None:
        """Draw for an eye and submit the picture."""
        if self._on_cpu is None:
            self._compositor.submit(self._on_gpu.draw_on_gpu(camera.view, camera.eye), eye=camera.eye)
            return
        image = self._on_cpu.draw(camera.view)
        self._compositor.submit(
            image.colour, image.inverse_depth, eye=camera.eye, stored=StoredDepth(DepthKind.INVERSE)
        )

    def read(self, view: View) -> GeometryImage:
        """Draw from any view and fetch the picture."""
        return self._on_gpu.draw(view) if self._on_cpu is None else self._on_cpu.draw(view)
