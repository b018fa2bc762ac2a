"""Compute the world ray of every display pixel, for your own renderer: origin, direction, status."""

import numpy as np

from wlr_render.mappings import Status
from wlr_render.optics.device_file import load_device
from wlr_render.optics.traced_mappings import traced_eye
from wlr_render.rendering.ray_map import choose_plan, ray_map

eye = traced_eye(load_device("northstar"), "right")  # or models.model_file.load_eye_model("model.json").mappings
plan = choose_plan(eye)  # once per headset

viewpoint = eye.eye_box.centre + [0.002, -0.001, 0.0]  # entrance pupil, device frame, metres
world_from_device = np.eye(4)
rays = ray_map(eye, viewpoint, plan)
origin, direction = rays.world_rays(world_from_device)  # (height * width, 3) float32, row by row

print(f"{len(direction)} rays, {np.mean(rays.status == Status.OK):.1%} of them OK")
print("first ray:", origin[0], direction[0])
