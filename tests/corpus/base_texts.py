"""Texts of the valid files that need no writer."""

from small_headsets import SCENE

DEVICES = ("northstar", "prism5701202", "birdbath28", "freeform40", "tilted_plate")

PHOTO_SESSION = """
format = "photo-session"
version = 1
unit = "mm"
frame = "opencv"
device = "a headset"
eye = "right"
board = "board.toml"

[panel]
width_px = 64
height_px = 48

[code]
pattern = "gray-fringes"

[eye_box]
centre_mm = [0.0, 0.0, 0.0]
size_mm = [10.0, 8.0, 6.0]

[eyeball_camera]
width_px = 64
height_px = 48
bits = 8
focal_px = [60.0, 60.0]
opencv_centre_px = [31.5, 23.5]
distortion = [0.1, 0.0, 0.0, 0.0, 0.0]

[tracking_camera]
width_px = 64
height_px = 48
bits = 8
focal_px = [60.0, 60.0]
opencv_centre_px = [31.5, 23.5]
rotation = [[1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0]]
translation_mm = [10.0, 40.0, 50.0]

[[bare]]
photograph = "bare.png"
target_pose = 0
stage_mm = [0.0, 0.0, 0.0]

[[tracking]]
photograph = "tracking.png"
target_pose = 0

[[see_through]]
photograph = "through.png"
target_pose = 0
stage_mm = [0.0, 0.0, 0.0]

[[display]]
photographs = "shown"
stage_mm = [0.0, 0.0, 0.0]
"""

LENS_YAML = """%YAML:1.0
---
image_width: 64
image_height: 48
camera_matrix: !!opencv-matrix
   rows: 3
   cols: 3
   dt: d
   data: [ 60., 0., 31.5, 0., 60., 23.5, 0., 0., 1. ]
distortion_coefficients: !!opencv-matrix
   rows: 1
   cols: 5
   dt: d
   data: [ 0.1, 0., 0., 0., 0. ]
"""
LENS_XML = """<?xml version="1.0"?>
<opencv_storage>
<image_width>64</image_width>
<image_height>48</image_height>
<camera_matrix type_id="opencv-matrix"><rows>3</rows><cols>3</cols><dt>d</dt>
<data>60. 0. 31.5 0. 60. 23.5 0. 0. 1.</data></camera_matrix>
<distortion_coefficients type_id="opencv-matrix"><rows>1</rows><cols>5</cols><dt>d</dt>
<data>0.1 0. 0. 0. 0.</data></distortion_coefficients>
</opencv_storage>
"""
LENS_MRCAL = """{
    'lensmodel': 'LENSMODEL_OPENCV5',
    'intrinsics': [60.0, 60.0, 31.5, 23.5, 0.1, 0.0, 0.0, 0.0, 0.0],
    'extrinsics': [0, 0, 0, 0, 0, 0],
    'imagersize': [64, 48],
}
"""
POINT_LIGHT_AND_MESH = """
[[light]]
kind = "point"
position_m = [0, 1, 0]
colour = [0.1, 0.1, 0.1]

[[object]]
name = "box"
mesh = "box.obj"
position_m = [0.1, 0.1, -0.8]
quaternion_xyzw = [0, 0, 0, 1]
scale = 0.5
"""
SCENE_WITH_MESH = SCENE + POINT_LIGHT_AND_MESH
STATION = {
    "format": "wlr-station",
    "version": 2,
    "frame": "openxr",
    "units": {"length": "m", "angle": "rad", "pixel": "px"},
    "eyeball_camera": {
        "size_px": [640, 480],
        "kind": "brown",
        "focal_px": [600.0, 600.0],
        "centre_px": [320.0, 240.0],
        "distortion": [0.0, 0.0, 0.0, 0.0, 0.0],
    },
    "board": None,
}
HEAD = "".join(f"{0.1 * step:.1f} 0 0 0 0 0 0 1\n" for step in range(5))
HEAD_CSV = "".join(f"{10**8 * step},0,0,0,1,0,0,0\n" for step in range(5))
EYES = """# format: wlr-eye-trajectory 1
# kind: viewpoint
# frame: openxr-device
# units: s m
0.0 right 0 0 0
0.2 right 0.001 0 0
0.4 right 0.002 0 0
"""
GAZE = """# format: wlr-eye-trajectory 1
# kind: gaze
# frame: openxr-device
# units: s m
# rotation_centre_right_m: 0 0 0.0105
# pupil_distance_m: 0.0105
0.0 right 0 0 -1
0.4 right 0 0 -1
"""
_POSE = '"pose": {"orientation": {"x": 0, "y": 0, "z": 0, "w": 1}, "position": {"x": 0, "y": 0, "z": 0}}'
RECORDING = '{"format": "wlr-openxr-recording", "version": 1}\n' + "".join(
    f'{{"time": {10**8 * step}, "space": "{space}", "base_space": "{base}", "locationFlags": 3, {_POSE}}}\n'
    for step in range(5)
    for space, base in (("view", "local"), ("right_view", "view"), ("gaze", "view"))
)
CAUSES = '''"""A cause of the user's own."""

import numpy as np
from dataclasses import replace

from wlr_render.diagnosis.cause import Cause, Parameter, Role

CAUSES = ()
'''
