"""Texts of the valid files that need no writer."""

import math
from typing import Any

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

LENS_ROS = """header:
  frame_id: camera
height: 48
width: 64
distortion_model: plumb_bob
d:
- 0.01
- 0.0
- 0.0
- 0.0
- 0.0
k: [60.0, 0.0, 31.5, 0.0, 60.0, 23.5, 0.0, 0.0, 1.0]
binning_x: 0
binning_y: 0
roi:
  x_offset: 0
  y_offset: 0
  height: 0
  width: 0
  do_rectify: false
---
"""

LENS_KALIBR = """cam0:
  cam_overlaps: []
  camera_model: pinhole
  distortion_coeffs: [0.01, 0.0, 0.0, 0.0]
  distortion_model: radtan
  intrinsics: [60.0, 60.0, 31.5, 23.5]
  resolution: [64, 48]
  rostopic: /cam0/image_raw
"""

TARGET_KALIBR = """target_type: 'aprilgrid'
tagCols: 6
tagRows: 6
tagSize: 0.088
tagSpacing: 0.3
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
REPORT = {
    "format": "wlr-report",
    "version": 1,
    "provenance": {
        "date": "2026-01-01T12:00:00+00:00",
        "version": "0.2.0",
        "command": "wlr-render import-lens lens.zmx",
        "verb": "import-lens",
        "options": {"--panel": [64, 48]},
        "inputs": [{"name": "lens.zmx", "sha256": "0" * 64}],
    },
    "title": "Import of lens.zmx",
    "sentence": "lens: 2 surfaces.",
    "advice": [],
    "warnings": [],
    "tables": [
        {
            "section": "",
            "title": "Surfaces of the file",
            "rows": [{"surface": 1, "index": 1.5, "size": {"value": 1.0, "error": 0.1, "unit": "mm"}}],
            "notes": [],
        }
    ],
    "plots": [],
}
STATION = {
    "format": "wlr-station",
    "version": 3,
    "frame": "openxr",
    "units": {"length": "m", "angle": "rad", "pixel": "px"},
    "eyeball_camera": {
        "size_px": [320, 240],
        "kind": "brown",
        "focal_px": [300.0, 300.0],
        "centre_px": [160.0, 120.0],
        "distortion": [0.0, 0.0, 0.0, 0.0, 0.0],
    },
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

LENS_ZMX = """UNIT MM
GCAT CORPUS
SURF 0
  DISZ INFINITY
SURF 1
  STOP
  DISZ 20
SURF 2
  TYPE EVENASPH
  CURV 0.02
  CONI -0.5
  PARM 2 1e-6
  DISZ 5
  GLAS CORPUS 0 0 1.5 40
SURF 3
  TYPE COORDBRK
  PARM 1 0.5
  DISZ 0
SURF 4
  TYPE XASPHERE
  CURV -0.02
  XDAT 1 1
  XDAT 2 10
  XDAT 3 1e-4
  DISZ 45
  DIAM 20 1
  CLAP 0 18 0
SURF 5
  CURV 0.0
  DISZ 0
"""
LENS_SEQ = """RDM;LEN "VERSION: 11.2"
TITLE 'lens'
DIM M
PRV
  PWL 656.3 587.6 486.1
  'MINE' 1.61 1.62 &
   1.63
END
SO 0.0 0.1e14
S 0.0 20.0
  STO
S 50.0 5.0 CORPUS_MAKER
  ASP; K -0.5
  A 1e-6; B 0.0
  XDE 0.5; ADE 1.0; DAR
S -50.0 2.0 'MINE'
  SPS XYP 10
  SCO C4 1e-4
S 0.0 45.0 ! flat
  CIR 18
  THI HMY 0.0
SI 0.0 0.0
GO
"""
GLASSES = """CC Glasses
NM CORPUS 2 0 1.5168 64.17 0 1
CD 1.039612120E+00 6.000698670E-03 2.317923440E-01 2.001791440E-02 1.010469450E+00 1.035606530E+02 0 0 0 0
NM OTHER 1 0 0 0 0 1
CD 2.545002000E+00 -1.337396000E-03 2.801151000E-02 -5.417021000E-04 1.501754000E-04 -3.617071000E-06 0 0 0 0
"""


def _optiland_surface(z: float, radius: float, material: dict[str, Any], **others: Any) -> dict[str, Any]:
    frame = {"x": 0.0, "y": 0.0, "z": z, "rx": 0.0, "ry": 0.0, "rz": 0.0}
    geometry = {"type": "StandardGeometry", "cs": frame, "radius": radius, "conic": 0.0}
    return {"geometry": geometry, "material_post": material, **others}


_OPTILAND_AIR = {"type": "IdealMaterial", "index": 1.0}
OPTILAND = {
    "surface_group": {
        "surfaces": [
            _optiland_surface(-math.inf, math.inf, _OPTILAND_AIR),
            _optiland_surface(0.0, math.inf, _OPTILAND_AIR, is_stop=True),
            _optiland_surface(20.0, 50.0, {"type": "Material", "name": "CORPUS"}),
            _optiland_surface(25.0, -50.0, _OPTILAND_AIR),
            _optiland_surface(70.0, math.inf, _OPTILAND_AIR),
        ]
    }
}
"""A file of Optiland, with the keys that are read."""
_CURVED = OPTILAND["surface_group"]["surfaces"][2]
_CURVED["geometry"] |= {"type": "EvenAsphere", "coefficients": [0.0, 1e-6]}
_CURVED["interaction_model"] = {"type": "RefractiveReflectiveModel", "is_reflective": False}
_CURVED["aperture"] = {"type": "RadialAperture", "r_max": 18.0, "r_min": 0.0}
_TOROID = {"type": "ToroidalGeometry", "radius_x": -50.0, "radius_y": -50.0, "conic_yz": 0.0, "coeffs_poly_y": [0.0]}
OPTILAND["surface_group"]["surfaces"][3]["geometry"] |= _TOROID


def _rayoptics(kind: str, **attributes: Any) -> dict[str, Any]:
    return {"__instance_type__": [kind], "attributes": attributes}


def _rayoptics_surface(profile: dict[str, Any], **others: Any) -> dict[str, Any]:
    return _rayoptics("Surface", interact_mode="transmit", profile=profile, **others)


_PLANE = _rayoptics("Spherical", cv=0.0)
_CIRCLE = _rayoptics("Circular", radius=18.0, x_offset=0.0, y_offset=0.0)
_DECENTRE = {"attributes": {"_dtype": "decenter", "dec": [0.5, 0.0, 0.0], "euler": [0.0, 0.0, 0.0]}}
_GLASS = _rayoptics(
    "SchottGlass", gname="CORPUS", coefs=[1.03961212, 0.23179, 1.01046945, 0.0060007, 0.0200179, 103.56]
)
_ASPHERE = _rayoptics("EvenPolynomial", cv=0.02, cc=-0.5, coefs=[0.0, 1e-6])
RAYOPTICS = {
    "optical_model": {
        "attributes": {
            "system_spec": {"attributes": {"_dimensions": "mm"}},
            "seq_model": {
                "attributes": {
                    "stop_surface": 1,
                    "ifcs": [
                        _rayoptics_surface(_PLANE),
                        _rayoptics_surface(_PLANE),
                        _rayoptics_surface(_ASPHERE, max_aperture=20.0, clear_apertures=[_CIRCLE], decenter=_DECENTRE),
                        _rayoptics_surface(_rayoptics("Conic", cv=-0.02, cc=0.0)),
                        _rayoptics_surface(_PLANE),
                    ],
                    "gaps": [
                        {"attributes": {"thi": thickness, "medium": medium}}
                        for thickness, medium in (
                            (1e10, _rayoptics("Air")),
                            (20.0, _rayoptics("Air")),
                            (5.0, _GLASS),
                            (45.0, _rayoptics("Air")),
                        )
                    ],
                }
            },
        }
    }
}
"""A file of rayoptics, with the keys that are read."""
