"""Offline raster frames: a scene's intermediate image, warped by a compositor and read back."""

from collections.abc import Sequence

from wlr_render.draw.painters import Frame, channels_of, ray_maps_of, with_inverse_depth
from wlr_render.draw.scene_raster import SceneRaster
from wlr_render.mappings import Eye
from wlr_render.numerics.arrays import FloatArray
from wlr_render.numerics.srgb import encode_srgb
from wlr_render.warp.compositor import Compositor
from wlr_render.warp.raster_camera import RasterPlace, ray_map_plans
from wlr_render.warp.ray_map import RayMap
from wlr_render.warp.view import View


class WarpedPainter:
    """Frames of a compositor that are read back; `paint` does not depend on the frames before.

    The colours of an eye share the intermediate image: its jagged edges must not fall differently in each.
    """

    def __init__(
        self,
        mappings: Eye | Sequence[Eye],
        raster: SceneRaster,
        resolution: float = 1.0,
        raster_camera: RasterPlace = "nearest",
    ) -> None:
        """Prepare.

        Args:
            mappings: one pair for all colours, or one each for red, green and blue.
            raster: the scene, in a context of this library's own.
            resolution: 1 gives the intermediate image about as many pixels as the display has, 2 four times as many.
            raster_camera: position of the camera of the intermediate image: "viewpoint", as in the paper, or "nearest"
                to the bent rays (`raster_camera.py`), from where fewer pixels are disoccluded.
        """
        self._channels = channels_of(mappings)
        panel, eye = self._channels[0].display.panel, self._channels[0].eye
        red, green, blue = (int(code) for code in encode_srgb(raster.scene.background))
        self._compositor = Compositor(
            {eye: self._channels},
            (panel.width_px, panel.height_px),
            context=raster.context,
            resolution=resolution,
            raster_camera=raster_camera,
            late_margin_deg=0.0,
            background=(red, green, blue),
        )
        self._plan, self._raster = self._compositor.plan(eye), raster

    def view(self, viewpoint: FloatArray, world_from_device: FloatArray) -> View:
        """Return the view of the intermediate image; its camera is the same for all viewpoints in the eye box."""
        return self._plan.view(viewpoint, world_from_device)

    def paint(self, viewpoint: FloatArray, world_from_device: FloatArray, with_geometry: bool = False) -> Frame:
        """Return a warped frame, which is read from the GPU when its colour is first asked for; see `Painter`."""
        (camera,) = self._compositor.begin_frame(world_from_device, viewpoint).values()
        image = self._raster.draw_on_gpu(camera.view, camera.eye)
        self._compositor.submit(image)
        composed = self._compositor.compose(with_source=with_geometry)
        colour = composed.read_async()

        def ray_maps() -> tuple[RayMap, ...]:
            plans = ray_map_plans(self._channels, self._plan.device_from_camera)
            return ray_maps_of(self._channels, plans, viewpoint)

        if not with_geometry:
            return Frame(colour.result, ray_maps)
        intermediate = image.read()
        sources = tuple(
            with_inverse_depth(intermediate, composed.source(channel=channel)) for channel in range(len(self._channels))
        )
        return Frame(colour.result, ray_maps, sources=sources, view=camera.view, intermediate=intermediate)


def traced_instead(raster: SceneRaster | None, backend: str) -> list[str]:
    """Return a sentence if frames are ray traced because OpenGL is missing or `backend` is "cpu"."""
    if raster is not None:
        return []
    if backend == "cpu":
        return ["--backend cpu: frames are ray traced; choose auto, egl or osmesa for rasterised ones."]
    return [
        "No OpenGL 4.1 context opens here, so that frames are ray traced; install libegl1 and libgl1, or libosmesa6, "
        "for rasterised ones."
    ]
