"""A session of photographs that is made and calibrated in seconds: small pictures of few things, one process.

The device is a tilted glass plate whose near face mirrors a flat panel, half a metre away: its display is of degree 1
in place and pixel, exactly.
"""

import os
import shutil
import tomllib
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
import pytest
from numpy.typing import NDArray

from wlr_render.calibration.calibrate_session import SessionCalibration
from wlr_render.captures import session_reading
from wlr_render.captures.photo_session import PhotoSession
from wlr_render.captures.photo_session_file import load_photo_session
from wlr_render.captures.photographs import read_photograph, write_photograph
from wlr_render.captures.session_reading import Reading
from wlr_render.errors import BadInputError
from wlr_render.io.atomic_files import resource
from wlr_render.io.toml_files import write_toml
from wlr_render.jobs.calibrate.calibrate_options import CalibrateOptions
from wlr_render.jobs.calibrate.photos import READ, calibrated, report_of
from wlr_render.numerics.arrays import FloatArray
from wlr_render.optics.device import Device, EyeOptics
from wlr_render.report.blocks import Report
from wlr_render.report.save import save_report
from wlr_render.simulation.photographs import recipe, simulate_photo_session, take_photographs
from wlr_render.simulation.photographs.camera import SimulatedLens
from wlr_render.simulation.photographs.camera_view import CameraView
from wlr_render.simulation.photographs.imperfections import BenchImperfections
from wlr_render.simulation.photographs.photo_bench import (
    PhotoBench,
    PhotoBenchOptions,
    design_photo_bench,
)
from wlr_render.simulation.photographs.photo_plan import PhotoPlan, plan_photographs
from wlr_render.simulation.photographs.recipe import SimulationRecipe
from wlr_render.simulation.photographs.take_photographs import CameraPose
from wlr_render.work.workers import WorkerPool

if TYPE_CHECKING:
    from benchmarks.test_kept_trials import NamedTrial

VIEWPOINTS = 4
CAMERA_PX = (400, 320)
TRACKING_PX = (400, 300)
SAMPLES = 4  # of each pixel
SIX = slice(2, 8)  # photographs of the board by which a lens is known, all over the picture
IMPERFECTIONS = replace(BenchImperfections(), extrinsics_mm=0.02, extrinsics_deg=0.005, lens="brown")
"""Those of ordinary equipment, but for the extrinsics, whose usual error would hide all others in the device frame, and
for the lens: near dots are a twelfth of these small pictures, and rational terms bend the dots themselves."""


def in_this_process(
    run: Callable[..., Any],
    tasks: "Sequence[CameraPose | NamedTrial | Sequence[Any]]",
    spread: WorkerPool,
    folder: object = None,
) -> Iterator[Any]:
    """As `workers.as_finished`, without the seconds that starting processes takes."""
    return map(run, tasks)


def small_bench(device: Device, eye: str, options: PhotoBenchOptions) -> PhotoBench:
    """The usual bench with a smaller tracking camera, which is what takes longest."""
    bench = design_photo_bench(device, eye, options)
    camera = bench.tracking.camera
    scale = TRACKING_PX[0] / camera.size_px[0]
    smaller = replace(camera, size_px=TRACKING_PX, focal_px=camera.focal_px * scale, centre_px=camera.centre_px * scale)
    return replace(bench, tracking=replace(bench.tracking, camera=smaller))


def small_plan(bench: PhotoBench, viewpoints: int) -> PhotoPlan:
    """The usual plan with six photographs of each lens, and three levels of each axis without the headset."""
    plan = plan_photographs(bench, viewpoints)
    return replace(
        plan,
        bare=plan.bare[:11],
        eyeball_boards=plan.eyeball_boards[SIX],
        tracking_boards=plan.tracking_boards[SIX],
    )


class CoarseView(CameraView):
    """The usual view, of fewer samples in each pixel."""

    @classmethod
    def without_headset(cls, lens: SimulatedLens, frame_from_camera: FloatArray, samples: int = SAMPLES) -> CameraView:
        return CameraView.without_headset(lens, frame_from_camera, samples)

    @classmethod
    def through_optics(
        cls, optics: EyeOptics, lens: SimulatedLens, device_from_camera: FloatArray, samples: int = SAMPLES
    ) -> CameraView:
        return CameraView.through_optics(optics, lens, device_from_camera, samples)


def make_small(patch: pytest.MonkeyPatch) -> None:
    """Have everything about simulated sessions small, by a `pytest.MonkeyPatch`."""
    patch.setattr(take_photographs, "CameraView", CoarseView)
    patch.setattr(recipe, "design_photo_bench", small_bench)
    patch.setattr(simulate_photo_session, "plan_photographs", small_plan)
    for module in (simulate_photo_session, session_reading):
        patch.setattr(module, "as_finished", in_this_process)


def far_panel_device(folder: Path) -> str:
    """Path of tilted_plate with its panel half a metre away and 320 x 180 pixels."""
    text = resource("devices", "tilted_plate.toml").read_text(encoding="utf-8")
    for old, new in (
        ("pixels = [1920, 1080]", "pixels = [320, 180]"),
        ("size_mm = [48.0, 27.0]", "size_mm = [320.0, 180.0]"),
        ("centre_mm = [0.0, -40.0, 40.0]", "centre_mm = [0.0, -460.0, 40.0]"),
    ):
        assert text.count(old) == 1
        text = text.replace(old, new)
    path = folder / "far_panel.toml"
    path.write_text(text, encoding="utf-8")
    return str(path)


@dataclass(frozen=True)
class SmallSession:
    """A session's folder, the folder of its results, and how it was made."""

    folder: Path
    out: Path
    recipe: SimulationRecipe

    @property
    def bench(self) -> PhotoBench:
        """The truth."""
        return small_bench_of(self.recipe)

    @property
    def options(self) -> CalibrateOptions:
        return CalibrateOptions(str(self.folder), out=self.out)

    def read(self) -> Reading:
        """What calibration reads first."""
        return session_reading.read_session(load_photo_session(self.folder), self.out / READ)

    def calibrate(self) -> SessionCalibration:
        return calibrated(self.options)

    def refusal(self) -> str:
        """The one sentence in which calibration says no."""
        with pytest.raises(BadInputError) as caught:
            self.calibrate()
        sentence = str(caught.value)
        assert "\n" not in sentence
        return sentence

    def edit(self, change: Callable[..., Any]) -> None:
        """Let `change` alter what session.toml says, a dictionary."""
        path = self.folder / "session.toml"
        content = tomllib.loads(path.read_text(encoding="utf-8"))
        change(content)
        path.unlink()
        write_toml(path, content)

    def repaint(self, name: str | Path, paint: Callable[[NDArray[Any]], NDArray[Any]]) -> None:
        """Replace a photograph by `paint` of it."""
        path = self.folder / name
        image = paint(read_photograph(path))
        path.unlink()
        write_photograph(path, image)

    def cut_short(self, name: str | Path) -> None:
        path = self.folder / name
        content = path.read_bytes()
        path.unlink()
        path.write_bytes(content[: len(content) // 3])

    def swap(self, first: str | Path, second: str | Path) -> None:
        """Exchange two photographs."""
        one, other, aside = self.folder / first, self.folder / second, self.folder / "aside"
        one.rename(aside)
        other.rename(one)
        aside.rename(other)


def small_bench_of(made: SimulationRecipe) -> PhotoBench:
    with pytest.MonkeyPatch.context() as patch:
        make_small(patch)
        return made.build()


CAMERAS = ("eyeball_camera", "tracking_camera")


def state_lenses(content: dict[str, Any]) -> None:
    """Choosing the kind of lens takes longer than the rest of a calibration."""
    for name in CAMERAS:
        content[name]["lens"] = IMPERFECTIONS.lens


def with_stated_lenses(session: PhotoSession) -> PhotoSession:
    """Return a session of the usual bench with the kind of its lenses stated, and six photographs of each."""
    cameras = {name: getattr(session, name) for name in CAMERAS}
    stated = {
        name: replace(camera, lens=BenchImperfections().lens, intrinsics=camera.intrinsics[SIX])
        for name, camera in cameras.items()
    }
    return replace(session, **stated)


def made_session(folder: Path) -> tuple[SmallSession, SessionCalibration, Report]:
    """Simulate the session, calibrate it and write the report; returns all three."""
    folder.mkdir()
    bench = PhotoBenchOptions(camera_px=CAMERA_PX, imperfections=IMPERFECTIONS)
    made = SimulationRecipe(far_panel_device(folder), viewpoints=VIEWPOINTS, bench=bench)
    session = SmallSession(folder / "session", folder / "out", made)
    with pytest.MonkeyPatch.context() as patch:
        make_small(patch)
        simulate_photo_session.simulate_photo_session(session.folder, made)
        session.edit(state_lenses)
        found = session.calibrate()
        return session, found, save_report(report_of(found, session.options), session.out)


def copied(session: SmallSession, folder: Path) -> SmallSession:
    """Its copy, with what was read already: linked, since no test writes into a photograph that is there."""
    for source, name in ((session.folder, "session"), (session.out, "out")):
        shutil.copytree(source, folder / name, copy_function=os.link)
    return replace(session, folder=folder / "session", out=folder / "out")


BLACK = np.zeros_like


def blown_out(image: NDArray[Any]) -> NDArray[Any]:
    return np.full_like(image, 255)
