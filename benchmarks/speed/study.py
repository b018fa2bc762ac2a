"""Speed and accuracy offline and in real time, against baselines."""

import os
import platform
from collections.abc import Callable, Sequence
from dataclasses import KW_ONLY, dataclass, field
from functools import cache, partial
from pathlib import Path
from typing import Annotated

from cyclopts import Parameter

from benchmarks.speed import accuracy_tables, eye_tracking, fixed_maps, growth, stages
from benchmarks.speed.frozen_map import frozen_map_table
from benchmarks.speed.offline import map_rows, memory_rows, raster_rows, ray_rows
from benchmarks.speed.record import record
from benchmarks.speed.timing import GPU_ROUNDS, ROUNDS
from benchmarks.speed.workload import PANEL, Workload, bench_model, workload
from wlr_render.errors import BadInputError, MissingGlError
from wlr_render.files import output_folder
from wlr_render.jobs.options import Backend, Options, ProgressArgument, described
from wlr_render.mappings import Panel
from wlr_render.progress import SILENT
from wlr_render.rendering import gl
from wlr_render.rendering.thread_pool import worker_count
from wlr_render.report.blocks import Report, ReportTable
from wlr_render.report.save import save_report

_NOTES = (
    "Ray path baseline: embreex's own query of the same rays, shared out over the same threads.",
    "Raster path baseline: a bare ModernGL pass of the same mesh, warped by a map uploaded once, read back.",
)

Tables = Callable[[], Sequence[ReportTable]]


@dataclass(frozen=True)
class StudyPlan:
    """How much is measured.

    Attributes:
        panel: pixels of one eye.
        large_px: of the larger display in real time.
        rounds: of a timing; `gpu_rounds` of one in real time on a GPU.
        sizes: over which growth is measured.
        devices, scenes: of which accuracy is measured.
        judged_panel: pixels of those devices; their own if None.
    """

    panel: Panel = PANEL
    large_px: tuple[int, int] = stages.LARGE_PX
    rounds: int = ROUNDS
    gpu_rounds: int = GPU_ROUNDS
    sizes: growth.Sizes = field(default_factory=growth.Sizes)
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
    """Measure; writes speed.html, .md and .json into `options.out`.

    Raises:
        BadInputError: a folder that cannot be written, or `record` without OpenGL.
        MissingGlError: OpenGL was asked for by name, and does not open.
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
    parts: list[Tables] = [partial(_offline, work, options.backend, machine)]
    if renderer is not None:
        rounds = plan.rounds if renderer.is_software else plan.gpu_rounds
        parts += _in_real_time(work.with_rounds(rounds), options.backend, plan)
    parts += _accuracy(options.backend, plan, with_gl=renderer is not None)
    tables = [table for part in progress(iter(parts), len(parts), "benchmarks") for table in part()]
    if options.record is not None and renderer is not None:
        record(tables, options.record, renderer.name)
    return save_report(Report("Speed and accuracy", blocks=tables), folder, "speed")


@dataclass(frozen=True)
class Renderer:
    """What draws, by OpenGL's name, and whether it is a program on the CPU."""

    name: str
    is_software: bool


def _renderer(backend: str) -> Renderer | None:
    """None where there is no OpenGL, or none is asked for."""
    if backend == "cpu":
        return None
    try:
        with gl.open_context(backend) as context:
            return Renderer(context.renderer, context.is_software)
    except MissingGlError:
        if backend != "auto":
            raise
        return None


def _machine(renderer: Renderer | None) -> tuple[str, str]:
    load = f"{os.getloadavg()[0]:.1f}" if hasattr(os, "getloadavg") else "unknown"
    return (
        f"{renderer.name if renderer else 'no OpenGL'}; {worker_count()} processors, {platform.machine()}, Python "
        f"{platform.python_version()}.",
        f"Medians of runs that take turns. The machine's load when it began: {load}; who else uses it is not known.",
    )


def _offline(work: Workload, backend: str, machine: Sequence[str]) -> list[ReportTable]:
    rows = [*ray_rows(work), *raster_rows(work, backend), *map_rows(work), *memory_rows(backend)]
    panel = work.mappings.display.panel
    title = f"Offline, {panel.width_px} x {panel.height_px}, {work.scene.triangle_count} triangles"
    columns = "what", "ours", "baseline", "ours / baseline", "goal"
    return [ReportTable(title, columns, rows, (*machine, *_NOTES))]


def _in_real_time(work: Workload, backend: str, plan: StudyPlan) -> list[Tables]:
    return [
        lambda: stages.stage_tables(work, backend, plan.large_px),
        lambda: [eye_tracking.price_table(work, backend)],
        lambda: [eye_tracking.warm_start_table(work, backend)],
        lambda: [fixed_maps.warp_table(work, backend)],
        lambda: [frozen_map_table(work.mappings)],
        lambda: [growth.growth_table(work, backend, plan.sizes)],
    ]


def _accuracy(backend: str, plan: StudyPlan, with_gl: bool) -> list[Tables]:
    models = cache(lambda: {device: bench_model(plan.judged_panel, device=device) for device in plan.devices})
    first, scene = plan.devices[0], plan.scenes[0]
    fields: list[Tables] = [lambda: [accuracy_tables.field_table(models(), backend)]]
    return [
        *(fields if with_gl else []),
        lambda: [accuracy_tables.landing_table(models(), plan.scenes, backend)],
        lambda: [accuracy_tables.late_table(first, models()[first], scene, backend)],
    ]
