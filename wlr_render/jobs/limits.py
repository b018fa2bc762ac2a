"""Limits of numbers that several verbs take.

A value beyond them is a slip, a wrong unit, or more than memory, disk or a day of computing allows.
"""

from wlr_render.io.input_files import LIMITS
from wlr_render.jobs.options import Range

PIXELS = Range(at_least=1, at_most=LIMITS.picture_side, product=LIMITS.picture_pixels)
"""Width and height of a panel or camera."""
CAMERA_PIXELS = Range(at_least=64, at_most=LIMITS.picture_side, product=LIMITS.picture_pixels)
"""Width and height of a camera that is simulated: fewer pixels show no dots."""
PLACES = Range(at_least=1, at_most=1000)
"""Camera positions or viewpoints: a thousand take about a day."""
FRAMES = 1_000_000
"""Frames of one run: more than four hours at 60 a second."""
DISTANCE_M = Range(at_least=0.01, at_most=100)
"""Distance of a target in metres."""
DEPTH_M = Range(at_least=0.1, at_most=100, unit="metres")
"""Depth of real points in metres: 500 is most likely in millimetres."""
DEPTHS = 20
"""Distances of a target: each takes photographs at every camera position."""
POSITION_MM = Range(at_least=0, at_most=100)
"""Position error in mm: a stage travels no farther."""
REPEATABILITY_UM = Range(at_least=0, at_most=10_000)
"""Repeatability of a stage in um: up to a centimetre."""
ROTATION_URAD = Range(at_least=0, at_most=100_000)
"""Rotation error of a stage in microradians: up to 5.7 degrees."""
ANGLE_ARCMIN = Range(at_least=0, at_most=600)
"""Angular error in arcmin: up to 10 degrees."""
NOISE_PX = Range(above=0, at_most=100)
"""Noise of a position in a photograph, in pixels."""
TRACKING_MM = Range(at_least=0, at_most=100, least_size=1e-3, unit="millimetres")
"""Error of a tracked position in mm: no tracker is better than a micrometre."""
TRACKING_DEG = Range(at_least=0, at_most=30, least_size=1e-3, unit="degrees")
"""Error of a tracked rotation in degrees: no tracker is better than a thousandth."""
LATENCY_MS = Range(at_least=0, at_most=1000, least_size=0.1, unit="milliseconds")
"""Latency of a tracker in ms: up to a second."""
HEAD_M_S = Range(at_least=0, at_most=10, least_size=1e-3, unit="metres per second")
"""Speed of a head, up to a runner's."""
PUPIL_MM_S = Range(at_least=0, at_most=200, least_size=0.01, unit="millimetres per second")
"""Speed of a pupil in the device frame, in mm/s: saccades reach some 150."""
HEAD_DEG_S = Range(at_least=0, at_most=1000, least_size=0.1, unit="degrees per second")
"""Angular speed of a head in degrees/s."""
WAIT_S = Range(above=0, at_most=86_400)
"""A wait in seconds: up to a day."""
