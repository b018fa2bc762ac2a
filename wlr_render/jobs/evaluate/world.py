"""What trials share within one process: traced devices, exact captures and true test sightings.

Exact tracing costs far more than a fit, so each is traced once per process.
"""

from dataclasses import dataclass, replace
from functools import lru_cache

import numpy as np

from wlr_render.captures.correspondences import DisplayCaptures, SeeThroughCaptures
from wlr_render.evaluation import mapping_error
from wlr_render.jobs.designs import camera_positions
from wlr_render.mappings import EyeBox, EyeMappings
from wlr_render.optics.device_file import load_device
from wlr_render.optics.traced_mappings import traced_eye
from wlr_render.simulation import viewpoints
from wlr_render.simulation.simulate_captures import CaptureSetup, simulate_display, simulate_see_through

BoxSize = tuple[float, float, float]

EYE_BOX_MM: BoxSize = (10.0, 8.0, 6.0)
TEST_VIEWPOINTS = 128
TEST_RAYS = 64  # from each viewpoint
NEAREST_M, FARTHEST_M = 0.3, 5.0


@dataclass(frozen=True)
class Setting:
    """What captures and tests have in common.

    Attributes:
        device: a shipped device's name, or the path of its file.
        eye_box_mm: edge lengths of the eye box.
        whole_panel: all that the panel shows is captured and judged, not only the nominal field.
    """

    device: str
    eye_box_mm: BoxSize = EYE_BOX_MM
    whole_panel: bool = False


@lru_cache
def truth(setting: Setting) -> EyeMappings:
    """The right eye of a device, traced, with an eye box of the given size about its own centre."""
    described = load_device(setting.device)
    eye = traced_eye(described)
    box = EyeBox(eye.eye_box.centre, np.array(setting.eye_box_mm) * 1e-3)
    return replace(eye, name=described.name, eye_box=box, field=None if setting.whole_panel else eye.field)


@lru_cache
def capture_setup(setting: Setting) -> CaptureSetup:
    """Exact captures of the device; the camera sees the nominal field, if there is one."""
    on = truth(setting)
    return CaptureSetup(on, camera_field=on.field)


@lru_cache(maxsize=16)
def exact_display(setting: Setting, kind: str, count: int) -> DisplayCaptures:
    """Noise-free captures of the panel."""
    on = capture_setup(setting)
    return simulate_display(on, camera_positions(on, kind, count), np.random.default_rng(0))


@lru_cache(maxsize=16)
def exact_see_through(setting: Setting, kind: str, count: int) -> SeeThroughCaptures:
    """Noise-free captures of the targets."""
    on = capture_setup(setting)
    return simulate_see_through(on, camera_positions(on, kind, count), np.random.default_rng(0))


@lru_cache
def display_sightings(setting: Setting, seed: int) -> mapping_error.DisplaySightings:
    """Directions of the field, or pixels of the whole panel, seen from random viewpoints, mostly off the plane."""
    on = capture_setup(setting)
    rng = np.random.default_rng(seed)
    viewpoint = viewpoints.random_in_eye_box(on.truth.eye_box, TEST_VIEWPOINTS, rng)[:, None]
    if on.truth.field is None:
        pixel = rng.uniform(0.0, 1.0, (TEST_VIEWPOINTS, TEST_RAYS, 2)) * on.truth.display.panel.size_px
        return mapping_error.sightings_of_pixels(on.truth.display, viewpoint, pixel)
    view_dir = on.camera_dirs()[rng.integers(0, len(on.camera_dirs()), (TEST_VIEWPOINTS, TEST_RAYS))]
    return mapping_error.sightings_of_dirs(on.truth.display, viewpoint, view_dir)


@lru_cache
def see_through_sightings(setting: Setting, seed: int) -> mapping_error.SeeThroughSightings:
    """Real points in those directions, at depths uniform in dioptres."""
    seen = display_sightings(setting, seed)
    dioptres = np.random.default_rng(seed + 1).uniform(1.0 / FARTHEST_M, 1.0 / NEAREST_M, len(seen.pixel))
    see_through = truth(setting).see_through
    return mapping_error.see_through_sightings(see_through, seen.viewpoint, seen.view_dir, 1.0 / dioptres)
