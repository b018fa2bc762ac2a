"""Speed and accuracy offline and in real time, compared to baselines."""

import os
import platform
from dataclasses import KW_ONLY, dataclass
from functools import cache
from pathlib import Path
from typing import Annotated

from cyclopts import Parameter

from benchmarks.speed import accuracy_tables, eye_tracking, fixed_maps, host, pictures, stages
from benchmarks.speed.figures import Measurement, Part, summary_table
from benchmarks.speed.frozen_map import frozen_map_table
from benchmarks.speed.offline import map_rows, memory_rows, raster_part, ray_rows, written_rows
from benchmarks.speed.record import record
from benchmarks.speed.timing import GPU_ROUNDS, ROUNDS
from benchmarks.speed.workload import PANEL, Workload, bench_model, workload
from wlr_render.errors import BadInputError, MissingGlError
from wlr_render.gl import gl
from wlr_render.io.atomic_files import output_folder
from wlr_render.jobs.options import Backend, Options, ProgressArgument, described
from wlr_render.mappings import Panel
from wlr_render.report.blocks import Report, ReportTable
from wlr_render.report.save import save_report
from wlr_render.work.progress import SILENT
from wlr_render.work.workers import usable_cores

_RAY_NOTE = "Baseline of the rays: embreex's own query of the same rays, shared out over the same threads."


@dataclass(frozen=True)
class StudyPlan:
    """Extent of the measurements.

    Attributes:
        panel: panel of one eye.
        large_px: (width, height) of the larger real-time display, per eye.
        rounds: rounds of a timing.
        gpu_rounds: rounds of a real-time timing on a GPU.
        submissions: number of frames whose CPU time is measured.
        devices, scenes: devices and scenes whose accuracy is measured.
        judged_panel: panel of those devices; their own if None.
    """

    panel: Panel = PANEL
    large_px: tuple[int, int] = stages.LARGE_PX
    rounds: int = ROUNDS
    gpu_rounds: int = GPU_ROUNDS
    submissions: int = host.FRAMES
    devices: tuple[str, ...] = accuracy_tables.DEVICES
    scenes: tuple[str, ...] = accuracy_tables.SCENES
    judged_panel: Panel | None = None


@dataclass(frozen=True)
class SpeedOptions(Options):
    """Options of `speed`."""

    _: KW_ONLY
    backend: Backend = "auto"
    record: Annotated[Path | None, described("Folder that also keeps the tables, as RENDERER.md.")] = None
    out: Annotated[Path, described("Output folder.")] = Path("out/benchmarks/speed")


_DEFAULTS = SpeedOptions()
_FULL = StudyPlan()


def run(
    options: SpeedOptions = _DEFAULTS,
    *,
    progress: ProgressArgument = SILENT,
    plan: Annotated[StudyPlan, Parameter(parse=False)] = _FULL,
) -> Report:
    """Measure, and write speed.html, .md and .json into `options.out`.

    Raises:
        BadInputError: a folder cannot be written, or `record` is given without OpenGL.
        MissingGlError: the OpenGL backend was requested by name, and does not open.
    """
    folder = output_folder(options.out)
    renderer = _renderer(options.backend)
    if options.record is not None:
        if renderer is None:
            raise BadInputError(
                "--record names its file after the OpenGL renderer, and OpenGL does not open here; leave --record out."
            )
        output_folder(options.record)  # minutes of work must not end at a folder that cannot be written
    machine = _machine(renderer)
    work = workload(plan.panel, plan.rounds)
    measurements = _offline(work, options.backend)
    if renderer is not None:
        rounds = plan.rounds if renderer.is_software else plan.gpu_rounds
        in_real_time = _in_real_time(work.with_rounds(rounds), options.backend, plan)
        measurements = [*in_real_time, *measurements, *_accuracy(options.backend, plan)]
    parts = [measure() for measure in progress(measurements, len(measurements), "benchmarks")]
    figures = [figure for part in parts for figure in part.figures]
    load = f"Its load was {_load()} when the run ended; who else uses it is not known."
    tables = [summary_table(figures, (*machine, load)), *(table for part in parts for table in part.tables)]
    if options.record is not None and renderer is not None:
        record(tables, options.record, renderer.name)
    return save_report(Report("Speed and accuracy", blocks=tables), folder, "speed")


@dataclass(frozen=True)
class Renderer:
    """OpenGL's name of the renderer, and whether it is a software renderer."""

    name: str
    is_software: bool


def _renderer(backend: str) -> Renderer | None:
    """Return the renderer; None without OpenGL, or if the CPU backend is requested."""
    if backend == "cpu":
        return None
    try:
        with gl.open_context(backend) as context:
            return Renderer(context.renderer, context.is_software)
    except MissingGlError:
        if backend != "auto":
            raise
        return None


def _load() -> str:
    return f"{os.getloadavg()[0]:.1f}" if hasattr(os, "getloadavg") else "unknown"


def _machine(renderer: Renderer | None) -> tuple[str, str]:
    return (
        f"{renderer.name if renderer else 'no OpenGL'}; {usable_cores()} processors, {platform.machine()}, Python "
        f"{platform.python_version()}.",
        "Times are medians of runs that take turns in one process; ratios are medians over the turns, with their "
        f"standard errors. The machine's load when the run began: {_load()}.",
    )


def _offline(work: Workload, backend: str) -> list[Measurement]:
    panel = work.mappings.display.panel

    def rays() -> Part:
        rows = [*ray_rows(work), *written_rows(work, backend), *map_rows(work), *memory_rows(backend)]
        title = f"Offline, {panel.width_px} x {panel.height_px}, {work.scene.triangle_count} triangles"
        return Part(tables=[ReportTable(title, ("what", "ours", "baseline", "ratio", "goal"), rows, (_RAY_NOTE,))])

    return [rays]


def _in_real_time(work: Workload, backend: str, plan: StudyPlan) -> list[Measurement]:
    return [
        lambda: host.submission(work, plan.submissions),
        lambda: pictures.near_object(work, backend),
        lambda: raster_part(work, backend),
        lambda: fixed_maps.warps(work, backend),
        lambda: eye_tracking.price(work, backend),
        lambda: host.memory(work, backend),
        lambda: pictures.linear_light(work, backend),
        lambda: stages.both_eyes(work, backend, plan.large_px),
        lambda: stages.one_eye(work, backend),
        lambda: Part(tables=[frozen_map_table(work.mappings)]),
    ]


def _accuracy(backend: str, plan: StudyPlan) -> list[Measurement]:
    models = cache(lambda: {device: bench_model(plan.judged_panel, device=device) for device in plan.devices})
    first, scene = plan.devices[0], plan.scenes[0]
    return [
        lambda: accuracy_tables.landing_part(models(), plan.scenes, backend),
        lambda: Part(tables=[accuracy_tables.late_table(first, models()[first], scene, backend)]),
        lambda: Part(tables=[accuracy_tables.ray_map_table(models(), backend)]),
    ]
