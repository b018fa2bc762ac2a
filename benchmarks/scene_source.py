"""Our own rasteriser as the engine that feeds a compositor."""

from wlr_render.draw.scene_raster import SceneRaster
from wlr_render.scene.scene import Scene
from wlr_render.warp.compositor import Compositor
from wlr_render.warp.eye_camera import EyeCamera
from wlr_render.warp.gpu_image import GpuImage
from wlr_render.warp.view import GeometryImage, View


class SceneSource:
    """Draws one scene for a compositor, in its context."""

    def __init__(self, compositor: Compositor, scene: Scene | SceneRaster) -> None:
        """Prepare the drawing; a `SceneRaster` must use the compositor's context."""
        self._compositor = compositor
        self._raster = scene if isinstance(scene, SceneRaster) else SceneRaster(compositor.context, scene)

    def submit(self, camera: EyeCamera) -> GpuImage:
        """Draw the picture of an eye, submit it and return it."""
        image = self._raster.draw_on_gpu(camera.view, camera.eye)
        self._compositor.submit(image, eye=camera.eye)
        return image

    def read(self, view: View) -> GeometryImage:
        """Draw from any view and fetch the picture into CPU memory."""
        return self._raster.draw(view)
