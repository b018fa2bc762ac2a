"""Simulate a session of photographs, as a lab would deliver it."""

from dataclasses import KW_ONLY, dataclass
from pathlib import Path
from typing import Annotated, Literal

from wlr_render.jobs.options import Eye, Options, ProgressArgument, Range, Seed, Workers, described, described_size
from wlr_render.jobs.targets import Code
from wlr_render.progress import SILENT
from wlr_render.report.blocks import Report
from wlr_render.simulation.photographs.photo_bench import PhotoBenchOptions
from wlr_render.simulation.photographs.recipe import SimulationRecipe
from wlr_render.simulation.photographs.simulate_photo_session import simulate_photo_session


@dataclass(frozen=True)
class SimulateOptions(Options):
    """Options of `simulate`."""

    session: Annotated[Path, described("Folder of the session; an interrupted simulation continues there.")]
    _: KW_ONLY
    device: Annotated[str, described("A shipped device or a device file (.toml).")] = "freeform40"
    eye: Annotated[Eye, described("Eye to photograph: a session is of one eye.")] = "right"
    viewpoints: Annotated[int, described("Number of camera positions."), Range(at_least=1)] = 25
    pattern: Annotated[Code, described("Code that the panel shows.")] = "gray-fringes"
    camera: Annotated[tuple[int, int], described_size("Pixels of the eyeball camera."), Range(at_least=1)] = (
        1280,
        1024,
    )
    bits: Annotated[Literal[8, 10, 12], described("Bits of the eyeball camera.")] = 8
    pupil_mm: Annotated[float, described("Diameter of its entrance pupil in mm."), Range(at_least=0)] = 0.5
    focus_m: Annotated[float, described("Distance at which it is focused, in m."), Range(at_least=0)] = 1.0
    snr: Annotated[float, described("Signal-to-noise ratio of a white panel."), Range(at_least=0)] = 50.0
    depths_m: Annotated[
        tuple[float, ...], described("Distances of the target in m, two or more.", many=True), Range(at_least=0)
    ] = (0.4, 1.0)
    stage_error_um: Annotated[
        float, described("Error of each camera position in um, standard deviation per axis."), Range(at_least=0)
    ] = 2.0
    seed: Seed = 1
    workers: Workers = None

    @property
    def recipe(self) -> SimulationRecipe:
        """The device and the bench."""
        bench = PhotoBenchOptions(
            self.camera,
            self.bits,
            self.pupil_mm,
            self.focus_m,
            self.snr,
            self.depths_m,
            self.stage_error_um,
            self.seed,
        )
        return SimulationRecipe(self.device, self.eye, self.viewpoints, self.pattern, bench)


def simulate(options: SimulateOptions, *, progress: ProgressArgument = SILENT) -> Report:
    """Take the photographs; writes them, session.toml, the board and simulation.toml into `options.session`.

    Raises:
        BadInputError: an unknown device or eye, or the folder holds a session made in another way.
    """
    taken, kept = simulate_photo_session(options.session, options.recipe, options.workers, progress)
    return Report(
        f"Simulated session {options.session.name}",
        verdict=f"{taken} photographs taken, {kept} kept from an earlier run: {options.session}",
        advice=[f"Calibrate with: wlr-render calibrate photos {options.session}"],
    )
