"""What is timed: one fitted headset, one scene of about 100,000 triangles, viewpoints that differ in every round."""

from dataclasses import dataclass, replace

import numpy as np

from wlr_render.calibration.fit_eye import fit_eye
from wlr_render.captures.correspondences import EyeCaptures
from wlr_render.mappings import EyeMappings, FloatArray, Panel
from wlr_render.optics.device_file import load_device
from wlr_render.optics.traced_mappings import traced_eye
from wlr_render.rendering.scene import Instance, Light, Scene
from wlr_render.rendering.shapes.sculpture import sculpture
from wlr_render.studies.alignment_demo import simulated_captures
from wlr_render.studies.headset import Channels, open_channels
from wlr_render.studies.speed.timing import ROUNDS

HEAD_POSE = np.eye(4)
DISPLAY_DEGREE, SEE_THROUGH_DEGREE = 5, 3
_SEED = 1


@dataclass(frozen=True, eq=False)
class Workload:
    """A headset, a scene and, for every round of a timing, a viewpoint in the eye box, (rounds + 1, 3)."""

    mappings: EyeMappings
    scene: Scene
    viewpoints: FloatArray


def workload() -> Workload:
    """The usual one: 1440 x 1600 pixels."""
    mappings = bench_model(Panel(1440, 1600))
    rng = np.random.default_rng(3)
    return Workload(mappings, bench_scene(), mappings.eye_box.at(rng.uniform(-1, 1, (ROUNDS + 1, 3))))


def bench_model(panel: Panel) -> EyeMappings:
    """A planar model of northstar whose panel has been given another number of pixels."""
    return _planar(traced_eye(load_device("northstar"), "right"), panel, _SEED)


def fit_channels(device: str, eye: str = "right", panel: Panel | None = None) -> Channels:
    """Planar models of one eye in red, green and blue light, each from a simulated calibration with noise of its own.

    Args:
        device: a shipped device or a device file.
        eye: "left" or "right".
        panel: another number of pixels for its panel; its own if None.

    Raises:
        BadInputError: as `headset.open_channels`.
    """
    truths = open_channels([device], eye)
    red, green, blue = (
        _planar(truth, panel or truth.display.panel, _SEED + number) for number, truth in enumerate(truths)
    )
    return red, green, blue


def _planar(truth: EyeMappings, panel: Panel, seed: int) -> EyeMappings:
    """What a simulated calibration with camera noise makes of an eye, its panel in other pixels."""
    captures = simulated_captures(truth, seed)
    pixel = captures.display.pixel / captures.display.panel.size_px * panel.size_px
    scaled = EyeCaptures(replace(captures.display, panel=panel, pixel=pixel), captures.see_through)
    return fit_eye(scaled, "planar", DISPLAY_DEGREE, SEE_THROUGH_DEGREE).mappings


def bench_scene() -> Scene:
    """The sculpture alone, large in the field, one directional light."""
    mesh = sculpture(height_m=0.5, around=64, along=782)
    placed = np.eye(4)
    placed[:3, 3] = [0.03, -0.45, -0.8]
    light = Light("directional", np.array([-0.36, -0.8, -0.48]), np.full(3, 0.9, np.float32))
    return Scene("bench", (mesh,), (Instance("sculpture", 0, placed),), (light,))
