"""From photographs to numbers: decode a panel's code, find a printed board's dots. The photographs are simulated."""

from dataclasses import replace

import numpy as np

from wlr_render.captures.patterns.gray_fringes import GrayFringes
from wlr_render.captures.targets.find_board import find_board
from wlr_render.geometry import transforms
from wlr_render.optics.device_file import load_device
from wlr_render.simulation.photographs import camera_view
from wlr_render.simulation.photographs.board_light import BoardLight
from wlr_render.simulation.photographs.camera_view import CameraView
from wlr_render.simulation.photographs.photo_bench import PhotoBenchOptions, design_photo_bench

# A camera in the place of the eye looks through the true optics; yours would be read by captures.photographs.
bench = design_photo_bench(load_device("birdbath28"), "right", PhotoBenchOptions(camera_px=(640, 512)))
device_from_camera = bench.camera_at(np.zeros(3))
sight = CameraView.through_optics(bench.optics, bench.eyeball, device_from_camera)
rng = np.random.default_rng(1)

# The panel shows the code one picture after the other; each camera pixel tells which place on the panel it sees.
code = GrayFringes(bench.optics.panel.pixels)
photographs = (bench.eyeball_sensor.expose(sight.panel_light(code.image(n)), rng) for n in range(len(code.names())))
decoded = code.decode(photographs)
print({reason.name: count for reason, count in decoded.counts().items()})
row, column = np.argwhere(decoded.accepted)[::97].T
pixel = np.stack([column, row], axis=-1) + 0.5
true = camera_view.panel_position(bench.optics, bench.eyeball.camera, device_from_camera, pixel).value
error = decoded.pixel[row, column] - true
print(f"decoded to {np.nanmedian(np.abs(error)):.3f} panel pixels (median), {len(code.names())} photographs")

# The printed board as seen through the optics: any patch of it tells which dots it shows.
photograph = bench.eyeball_sensor.expose(sight.world_light(BoardLight(bench.board, bench.device_from_target[0])), rng)
found = find_board(photograph, bench.board)
point = transforms.apply(bench.device_from_target[0], bench.board.point_of(found.index))
true = camera_view.pixel_of_real_point(bench.optics, bench.eyeball.camera, device_from_camera, point)
print(f"{len(found)} dots found to {np.nanmedian(np.abs(found.pixel - true)):.3f} camera pixels (median)")
print("the same photograph of another board:", end=" ")
try:
    find_board(photograph, replace(bench.board, large=~bench.board.large))
except ValueError as error_message:
    print(error_message)
