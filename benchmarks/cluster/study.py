"""Speed of a Dask cluster with two local workers beside one, and what a frame and a fit cost."""

import contextlib
import logging
import os
import shutil
import statistics
import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from dataclasses import KW_ONLY, dataclass
from pathlib import Path
from typing import Annotated, Any

from benchmarks.accuracy.study import AccuracyOptions
from benchmarks.accuracy.study import run as accuracy
from wlr_render.atomic_files import output_folder
from wlr_render.cluster import LIBRARY_THREADS, OPENGL_THREADS
from wlr_render.errors import BadInputError
from wlr_render.extras import installed_by
from wlr_render.jobs.options import Options, ProgressArgument, Range, described
from wlr_render.jobs.render import render
from wlr_render.jobs.render_options import RenderOptions
from wlr_render.progress import SILENT
from wlr_render.report.blocks import Cell, Report, ReportTable
from wlr_render.report.save import save_report

WANTED = 1.7
"""Wall time with one worker over that with two."""
_MILLION = 1_000_000
_REHEARSED_FRAMES = 16


@dataclass(frozen=True)
class ClusterOptions(Options):
    """Options of `cluster`."""

    _: KW_ONLY
    frames: Annotated[int, described("Frames of a sequence."), Range(at_least=8, at_most=10_000)] = 64
    repeats: Annotated[int, described("Repetitions of each trial of the fits."), Range(2, 1000)] = 10
    rounds: Annotated[int, described("Runs with one and with two workers, in turn."), Range(1, 100)] = 3
    out: Annotated[Path, described("Output folder.")] = Path("out/benchmarks/cluster")


@dataclass(frozen=True)
class _Run:
    wall_s: float
    cpu_s: float
    tasks: int
    disk_bytes: int


_Job = Callable[[str, Path], int]
"""Does the work on the cluster of an address, into a folder; returns the number of frames or fits."""


def run(options: ClusterOptions = ClusterOptions(), *, progress: ProgressArgument = SILENT) -> Report:
    """Run each job on one and on two workers in turn; writes cluster.html, .md and .json.

    Raises:
        MissingExtraError: Dask is not installed.
    """
    folder = output_folder(options.out)
    jobs = _jobs(folder, options.frames, options.repeats)
    rehearsals = _jobs(folder, _REHEARSED_FRAMES, 2)  # in which the workers import the program, and open what they keep
    rounds = [(name, number) for name in jobs for number in range(-1, options.rounds)]
    runs: dict[str, list[tuple[_Run, _Run]]] = {name: [] for name in jobs}
    with _workers(1) as one, _workers(2) as two:
        for name, number in progress(rounds, len(rounds), "pairs of runs"):
            order = (one, two) if number % 2 else (two, one)
            job = (jobs if number >= 0 else rehearsals)[name]
            pair = {id(client): _measured(client, job, folder / "work") for client in order}
            if number >= 0:
                runs[name].append((pair[id(one)], pair[id(two)]))
    without_dask = [_without_dask(folder, options.frames, method) for method in ("raster", "raytrace")]
    ratios = {name: statistics.median(a.wall_s / b.wall_s for a, b in pairs) for name, pairs in runs.items()}
    met = min(ratios.values()) >= WANTED
    words = ", ".join(f"{name} {ratio:.2f}" for name, ratio in ratios.items())
    load = os.getloadavg()[0]
    return save_report(
        Report(
            "Two workers beside one",
            verdict=f"Two local Dask workers are this many times as fast as one, median of {options.rounds} pairs: "
            f"{words}. Wanted: at least {WANTED:g}, which is {'met' if met else 'not met by all'}. The load of the "
            f"machine, with {os.cpu_count()} processors, was {load:.1f} at the end.",
            blocks=[_speed(runs, ratios, without_dask), _costs(runs)],
            record={name: [[vars(each) for each in pair] for pair in pairs] for name, pairs in runs.items()},
        ),
        folder,
        "cluster",
    )


def _jobs(folder: Path, frames: int, repeats: int) -> dict[str, _Job]:
    head = _head(folder / f"head-{frames}.tum", frames)
    return {
        "frames, raster": _frames(head, frames, "raster"),
        "frames, ray traced": _frames(head, frames, "raytrace"),
        "fits of a display model": _fits(repeats),
    }


def _without_dask(folder: Path, frames: int, method: str) -> list[Cell]:
    """Row of two processes that draw a sequence each: one after the other, and side by side.

    They share nothing but the machine: its memory and caches may allow no more.
    """
    head = _head(folder / f"head-{frames}.tum", frames)
    environment = os.environ | dict.fromkeys((*LIBRARY_THREADS, OPENGL_THREADS), "1")

    def started(name: str) -> subprocess.Popen[bytes]:
        out = folder / "work" / name
        shutil.rmtree(out, ignore_errors=True)
        command = [sys.executable, "-m", "wlr_render", "render", "northstar", "desk", "--method", method, "--workers=1"]
        return subprocess.Popen(
            [*command, "--head", str(head), "--out", str(out)], env=environment, stdout=subprocess.DEVNULL
        )

    begun = time.perf_counter()
    status = [started(name).wait() for name in ("first", "second")]
    after_s = time.perf_counter() - begun
    status += [process.wait() for process in [started("left"), started("right")]]
    beside_s = time.perf_counter() - begun - after_s
    if any(status):
        raise BadInputError(f"{folder}: a process that draws frames without Dask has failed; see what it printed.")
    ratio = after_s / beside_s
    return [f"two processes without Dask, {method}", 2 * frames, after_s, beside_s, ratio, ratio]


def _speed(
    runs: dict[str, list[tuple[_Run, _Run]]], ratios: dict[str, float], without_dask: list[list[Cell]]
) -> ReportTable:
    rows: list[list[Cell]] = [
        [
            name,
            pairs[0][0].tasks,
            statistics.median(one.wall_s for one, _ in pairs),
            statistics.median(two.wall_s for _, two in pairs),
            ratios[name],
            min(one.wall_s / two.wall_s for one, two in pairs),
        ]
        for name, pairs in runs.items()
    ]
    columns = ["job", "frames or fits", "one worker (s)", "two workers (s)", "ratio, median", "ratio, least"]
    note = "Without Dask: one process after the other, and both side by side; this is what the machine allows."
    return ReportTable("Wall time", columns, [*rows, *without_dask], (note,))


def _costs(runs: dict[str, list[tuple[_Run, _Run]]]) -> ReportTable:
    rows: list[list[Cell]] = []
    for name, pairs in runs.items():
        all_runs = [each for pair in pairs for each in pair]
        cpu_s = statistics.median(each.cpu_s / each.tasks for each in all_runs)
        size = statistics.median(each.disk_bytes / each.tasks for each in all_runs)
        rows.append([name, cpu_s, size / 1e6, cpu_s * _MILLION / 3600, size * _MILLION / 1e9])
    columns = ["job", "CPU time of one (s)", "size of one (MB)", "core hours of a million", "disk of a million (GB)"]
    note = (
        "CPU time of the workers, without the headset and the scene, which they have opened in a rehearsal. The last "
        "two columns are extrapolated."
    )
    return ReportTable("Cost", columns, rows, (note,))


def _measured(client: Any, job: _Job, folder: Path) -> _Run:
    shutil.rmtree(folder, ignore_errors=True)
    cpu_s = sum(client.run(time.process_time).values())
    started = time.perf_counter()
    tasks = job(client.scheduler.address, folder)
    wall_s = time.perf_counter() - started
    cpu_s = sum(client.run(time.process_time).values()) - cpu_s
    return _Run(wall_s, cpu_s, tasks, sum(path.stat().st_size for path in folder.rglob("*") if path.is_file()))


@contextlib.contextmanager
def _workers(count: int) -> Iterator[Any]:
    """Context manager for a client of a local cluster."""
    with installed_by("dask", "The benchmark"):
        from distributed import Client, LocalCluster
    with (
        LocalCluster(
            n_workers=count, threads_per_worker=1, dashboard_address=":0", silence_logs=logging.CRITICAL
        ) as cluster,
        Client(cluster, set_as_default=False) as client,
    ):
        yield client


def _head(path: Path, frames: int) -> Path:
    """Trajectory of a head that turns by 0.3 rad, with one sample for each frame at 30 Hz."""
    import numpy as np

    from wlr_render.tracking.head_trajectory_file import write_head_trajectory_tum
    from wlr_render.tracking.trajectory import HeadTrajectory

    times = np.arange(frames) / 30.0
    half = 0.15 * times / times[-1]
    xyzw = np.stack([0 * half, np.sin(half), 0 * half, np.cos(half)], axis=-1)
    return write_head_trajectory_tum(path, HeadTrajectory(times, np.zeros((frames, 3)), xyzw))


def _frames(head: Path, count: int, method: Any) -> _Job:
    def draw(address: str, folder: Path) -> int:
        report = render(RenderOptions("northstar", "desk", head=head, method=method, scheduler=address, out=folder))
        drawn = dict(report.record)["frames_drawn"] if isinstance(report.record, dict) else 0
        if drawn != count:
            raise BadInputError(f"{folder}: {drawn} frames were drawn, and {count} expected.")
        return count

    return draw


def _fits(repeats: int) -> _Job:
    def fit(address: str, folder: Path) -> int:
        accuracy(AccuracyOptions(("northstar",), part=("stage",), draws=repeats, scheduler=address, out=folder))
        return len(list((folder / "trials").rglob("*.json")))

    return fit
