"""Decode photographs of a panel code: the panel position that each camera pixel sees. The photographs are simulated."""

import cv2
import numpy as np

import wlr_render as wlr
from wlr_render.files import GrayFringes
from wlr_render.geometry import Pinhole, dir_of_tangents

# A camera looks through the exact optics. wlr_render.files.read_photograph reads your own photographs.
eye, rng = wlr.open_eye("birdbath28", "right"), np.random.default_rng(1)
camera = Pinhole(320, 256, np.array([-0.4, -0.32]), np.array([0.4, 0.32]))
view_dir = dir_of_tangents(camera.pixel_centre_tangents())
seen = eye.display.pixel_of_view_dir(view_dir, eye.eye_box.centre).value.astype(np.float32)  # NaN outside the panel


def photograph(picture):
    """Photograph the panel while it shows a picture: darker, with noise, and in 8 bits."""
    light = 0.8 * cv2.remap(picture.astype(np.float32), *np.moveaxis(seen - 0.5, -1, 0), cv2.INTER_LINEAR)
    return np.clip(np.nan_to_num(light) + 8 + rng.normal(0.0, 1.0, light.shape), 0, 255).astype(np.uint8)


# The panel shows the pictures of the code in turn.
code = GrayFringes(eye.display.panel)
decoded = code.decode(photograph(code.image(number)) for number in range(len(code.names())))
print({reason.name: count for reason, count in decoded.counts().items()})
error = np.abs(decoded.pixel - seen)[decoded.accepted]
print(f"median decoding error {np.nanmedian(error):.3f} panel pixels, {len(code.names())} photographs")
