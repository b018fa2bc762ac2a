"""Draw a frame by rasterisation and warp, and by ray tracing, and measure the difference."""

import numpy as np

from wlr_render.compositing.raster_painter import WarpedPainter
from wlr_render.evaluation.metrics import summary
from wlr_render.geometry import directions, transforms
from wlr_render.optics.device_file import load_device
from wlr_render.optics.traced_mappings import traced_eye
from wlr_render.rendering.gl import open_context
from wlr_render.rendering.image_files import write_map, write_png
from wlr_render.rendering.painters import TracedPainter
from wlr_render.rendering.ray_tracing import RayRenderer
from wlr_render.rendering.scene_file import load_scene
from wlr_render.rendering.scene_raster import SceneRaster

eye = traced_eye(load_device("freeform40"))
scene = load_scene("desk")
viewpoint, world_from_device = eye.eye_box.centre, np.eye(4)

raster = SceneRaster(open_context(), scene)  # EGL, else OSMesa
renderer = RayRenderer(scene)
warped = WarpedPainter(eye, raster).paint(viewpoint, world_from_device, with_geometry=True)
traced = TracedPainter(eye, renderer, shadows=True).paint(viewpoint, world_from_device, with_geometry=True)
write_png("raster.png", warped.colour)
write_png("raytrace.png", traced.colour)
write_map("warp.tiff", warped.source)  # u, v and inverse depth in the intermediate image; float32, NaN for nothing

eye_in_world = transforms.apply(world_from_device, viewpoint)
shown, met = (directions.normalised(frame.position.astype(float) - eye_in_world) for frame in (warped, traced))
seen = summary(directions.arcmin_between(shown, met))
print(f"drawn by {raster.backend}: registration {seen.median:.5f} arcmin median, {seen.p95:.5f} at 95 %")
