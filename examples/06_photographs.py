"""Decode photographs of a panel code, and find the dots of a printed board. The photographs are simulated."""

from dataclasses import replace

import numpy as np

from wlr_render.captures.patterns.gray_fringes import GrayFringes
from wlr_render.geometry import transforms
from wlr_render.optics.device_file import load_device
from wlr_render.simulation.photographs import camera_view
from wlr_render.simulation.photographs.board_light import BoardLight
from wlr_render.simulation.photographs.camera_view import CameraView
from wlr_render.simulation.photographs.photo_bench import PhotoBenchOptions, design_photo_bench

# An eyeball camera looks through the exact optics. captures.photographs reads your own photographs.
bench = design_photo_bench(load_device("birdbath28"), "right", PhotoBenchOptions(camera_px=(640, 512)))
device_from_camera = bench.camera_at(np.zeros(3))
sight = CameraView.through_optics(bench.optics, bench.eyeball, device_from_camera)
rng = np.random.default_rng(1)

# The panel shows the pictures of the code in turn. Decoding gives the panel position that each camera pixel sees.
code = GrayFringes(bench.optics.panel.pixels)
photographs = (bench.eyeball_sensor.expose(sight.panel_light(code.image(n)), rng) for n in range(len(code.names())))
decoded = code.decode(photographs)
print({reason.name: count for reason, count in decoded.counts().items()})
row, column = np.argwhere(decoded.accepted)[::97].T
pixel = np.stack([column, row], axis=-1) + 0.5
true = camera_view.panel_position(bench.optics, bench.eyeball.camera, device_from_camera, pixel).value
error = decoded.pixel[row, column] - true
print(f"median decoding error {np.nanmedian(np.abs(error)):.3f} panel pixels, {len(code.names())} photographs")

# The printed board through the optics. Every 5 x 5 window of dots is unique, so each dot is identified.
photograph = bench.eyeball_sensor.expose(sight.world_light(BoardLight(bench.board, bench.device_from_target[0])), rng)
found = bench.board.find(photograph)
point = transforms.apply(bench.device_from_target[0], bench.board.point_of(found.index))
true = camera_view.pixel_of_real_point(bench.optics, bench.eyeball.camera, device_from_camera, point)
print(f"{len(found)} dots found, median error {np.nanmedian(np.abs(found.pixel - true)):.3f} camera pixels")
print("the same photograph, with the wrong board given:", end=" ")
try:
    replace(bench.board, large=~bench.board.large).find(photograph)
except ValueError as error_message:
    print(error_message)
