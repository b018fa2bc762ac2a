"""Compute the world ray of every display pixel, for your own renderer: origin, direction, status."""

import wlr_render as wlr

eye = wlr.open_eye("northstar", "right")  # a shipped device, your device file, or your model.json
origin, direction, status = wlr.world_rays(eye, eye.eye_box.centre + [0.002, -0.001, 0.0])
print(f"{len(direction)} rays, {(status == wlr.Status.OK).mean():.1%} of them OK; first {origin[0]} {direction[0]}")
