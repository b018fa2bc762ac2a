"""Workload of the speed benchmark: a fitted headset, about 100,000 triangles, a new viewpoint every round."""

from collections.abc import Mapping
from dataclasses import dataclass, replace

import numpy as np

from benchmarks.speed.timing import ROUNDS
from wlr_render.calibration.fit_eye import calibrate
from wlr_render.captures.correspondences import Captures
from wlr_render.jobs.demo import simulated_captures
from wlr_render.mappings import Eye, Panel
from wlr_render.numerics.arrays import FloatArray
from wlr_render.optics.device_file import load_device
from wlr_render.optics.traced_mappings import traced_eye
from wlr_render.scene.scene import Instance, LightSource, Scene
from wlr_render.scene.shapes.objects import sculpture

HEAD_POSE = np.eye(4)
DEVICE = "northstar"
PANEL = Panel(1440, 1600)
TRIANGLES = 100_000
_SEED = 1
_AROUND = 64
_Degrees = tuple[int | None, int | None]


@dataclass(frozen=True, eq=False)
class Workload:
    """A headset, a scene and, for every round of a timing, a position in the eye box.

    Attributes:
        eyes: mappings by eye; "right" is always present.
        scene: the scene, in the world frame.
        places: (rounds + 1, 3) positions in the eye box, in -1..1.
    """

    eyes: Mapping[str, Eye]
    scene: Scene
    places: FloatArray

    @property
    def mappings(self) -> Eye:
        """Mappings of the right eye."""
        return self.eyes["right"]

    @property
    def rounds(self) -> int:
        """Number of rounds that count."""
        return len(self.places) - 1

    @property
    def viewpoints(self) -> FloatArray:
        """Viewpoints (rounds + 1, 3) of the right eye, device frame."""
        return self.mappings.eye_box.at(self.places)

    @property
    def one_eye(self) -> "Workload":
        """The same workload for the right eye alone."""
        return replace(self, eyes={"right": self.mappings})

    def with_rounds(self, rounds: int) -> "Workload":
        """Return this workload with another number of rounds."""
        return replace(self, places=_places(rounds))

    def viewpoint_of_eyes(self, turn: int) -> dict[str, FloatArray]:
        """Return the viewpoints (3,) of a round, by eye."""
        return {eye: mappings.eye_box.at(self.places[turn]) for eye, mappings in self.eyes.items()}


def workload(panel: Panel = PANEL, rounds: int = ROUNDS) -> Workload:
    """Return the usual workload, for both eyes."""
    eyes = {eye: bench_model(panel, eye) for eye in ("left", "right")}
    return Workload(eyes, bench_scene(), _places(rounds))


def _places(rounds: int) -> FloatArray:
    return np.random.default_rng(3).uniform(-1, 1, (rounds + 1, 3))


def bench_model(
    panel: Panel | None = None, eye: str = "right", device: str = DEVICE, degrees: _Degrees = (None, None)
) -> Eye:
    """Return a planar model of a shipped device, optionally with another number of panel pixels.

    It is fitted as by `calibrate`, with the degrees of the display and see-through mappings limited if given.
    """
    truth = traced_eye(load_device(device), eye)
    return _planar(truth, panel or truth.display.panel, _SEED, degrees)


def _planar(truth: Eye, panel: Panel, seed: int, degrees: _Degrees) -> Eye:
    """Fit an eye to a simulated calibration with camera noise, with its panel resampled to other pixels."""
    captures = simulated_captures(truth, seed)
    display, see_through = captures.both
    pixel = display.pixel / display.panel.size_px * panel.size_px
    scaled = Captures(replace(display, panel=panel, pixel=pixel), see_through)
    return calibrate(scaled, "planar", *degrees).mappings


def bench_scene(triangles: int = TRIANGLES) -> Scene:
    """Return the sculpture alone, close to the eyes, with about `triangles` triangles and one directional light."""
    mesh = sculpture(height_m=0.5, around=_AROUND, along=max(8, round(triangles / (2 * _AROUND))))
    placed = np.eye(4)
    placed[:3, 3] = [0.03, -0.45, -0.8]
    light = LightSource("directional", np.array([-0.36, -0.8, -0.48]), np.full(3, 0.9, np.float32))
    return Scene("bench", (mesh,), (Instance("sculpture", 0, placed),), (light,))
