"""How fast, as ratios against what a user would run otherwise, in one process; how exact the fast map is; how big."""

import platform
from collections.abc import Callable
from dataclasses import dataclass
from functools import partial
from pathlib import Path

from wlr_render.evaluation.report import Cell, ReportTable, tables_as_json
from wlr_render.files import output_folder, write_text
from wlr_render.rendering.workers import worker_count
from wlr_render.studies.progress import Progress, silent
from wlr_render.studies.speed.offline import map_rows, memory_rows, raster_rows, ray_rows
from wlr_render.studies.speed.workload import workload

_NOTES = (
    "Ray path baseline: embreex's own query of the same rays, shared out over the same threads.",
    "Raster path baseline: a bare ModernGL pass of the same mesh, warped by a map uploaded once, read back.",
)


@dataclass(frozen=True)
class Options:
    """What to measure: the backend of the raster path, and where the table goes."""

    backend: str = "auto"
    out: Path = Path("out/bench")


def run(options: Options, progress: Progress = silent) -> list[ReportTable]:
    """Measure; writes bench.md and bench.json into `options.out`."""
    folder = output_folder(options.out)
    work = workload()
    parts: list[Callable[[], list[list[Cell]]]] = [
        partial(ray_rows, work),
        partial(raster_rows, work, options.backend),
        partial(map_rows, work),
        partial(memory_rows, options.backend),
    ]
    rows = [row for part in progress(iter(parts), len(parts), "benchmarks") for row in part()]
    notes = (f"{worker_count()} processors, {platform.machine()}, Python {platform.python_version()}.", *_NOTES)
    title = f"Speed at 1440 x 1600, {work.scene.triangle_count} triangles"
    table = ReportTable(title, ("what", "ours", "baseline", "ours / baseline", "goal"), rows, notes)
    write_text(folder / "bench.md", table.markdown())
    write_text(folder / "bench.json", tables_as_json([table]))
    return [table]
