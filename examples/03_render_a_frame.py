"""Draw a frame by rasterisation and warp, and by ray tracing, and measure the difference."""

import numpy as np

import wlr_render as wlr
from wlr_render.files import write_map
from wlr_render.geometry import arcmin_between, normalised, transforms

eye, scene = wlr.open_eye("freeform40"), wlr.load_scene("desk")
viewpoint, world_from_device = eye.eye_box.centre, np.eye(4)

warped = wlr.render(eye, scene, viewpoint, world_from_device, method="raster", with_geometry=True)  # EGL, else OSMesa
traced = wlr.render(eye, scene, viewpoint, world_from_device, with_geometry=True)
warped.save("raster.png")
traced.save("raytrace.png")
write_map("warp.tiff", warped.source)  # u, v and inverse depth in the intermediate image; float32, NaN for nothing

# Each pixel shows a world point: the angle between the two methods' points, seen from the eye.
eye_in_world = transforms.apply(world_from_device, viewpoint)
shown, true = (normalised(frame.position - eye_in_world) for frame in (warped, traced))
difference = arcmin_between(shown, true)[np.isfinite(shown + true).all(axis=-1)]
median, p95 = np.percentile(difference, [50, 95])
print(f"{len(difference)} pixels show a point in both: registration {median:.5f} arcmin median, {p95:.5f} at 95 %")
