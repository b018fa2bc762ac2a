"""Work on a Dask cluster: what local processes give, workers that are killed, and clusters that cannot do it."""

import contextlib
import importlib
import importlib.metadata
import logging
import os
import platform
import re
import resource
import signal
import socket
import subprocess
import sys
import tempfile
from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Any, Literal, NoReturn

import numpy as np
import pytest
from jobs.test_render import still_head
from small_photo_session import far_panel_device, small_plan

from benchmarks.accuracy.study import AccuracyOptions
from benchmarks.accuracy.study import run as accuracy
from wlr_render.errors import BadInputError
from wlr_render.extras import MissingExtraError
from wlr_render.io import atomic_files
from wlr_render.io.kept import LEDGER
from wlr_render.jobs.render import render
from wlr_render.jobs.render_options import RenderOptions
from wlr_render.jobs.simulate import SimulateOptions, simulate
from wlr_render.report.blocks import Report
from wlr_render.simulation.photographs import simulate_photo_session
from wlr_render.work import cluster, workers
from wlr_render.work.progress import Item, Progress
from wlr_render.work.workers import WorkerPool, as_finished

distributed = pytest.importorskip("distributed", reason="Dask is not installed; install it: pip install '.[dask]'")


@pytest.fixture(scope="module")
def dask_cluster() -> Iterator[Any]:
    with distributed.LocalCluster(
        n_workers=2, threads_per_worker=1, dashboard_address=":0", silence_logs=logging.CRITICAL
    ) as started:
        yield started


@pytest.fixture
def address(dask_cluster: Any) -> str:
    return str(dask_cluster.scheduler_address)


def done(address: str, run: Callable[..., Any], tasks: Sequence[Any] | range, folder: Path | None = None) -> list[Any]:
    return list(as_finished(run, tasks, WorkerPool(scheduler=address), folder))


def square_in_a_worker_that_is_killed_once(folder: Path, number: int) -> tuple[int, int]:
    """The first worker that has the number 3 is killed, before it answers."""
    mark = folder / "killed"
    if number == 3 and not mark.exists():
        mark.write_text(str(os.getpid()))
        os.kill(os.getpid(), signal.SIGKILL)
    return number * number, os.getpid()


@pytest.mark.slow
def test_the_tasks_of_a_killed_worker_are_done_by_another(address: str, tmp_path: Path) -> None:
    answers = done(address, partial(square_in_a_worker_that_is_killed_once, tmp_path), range(12), tmp_path)
    assert sorted(answer for answer, _ in answers) == [number * number for number in range(12)]
    killed = int((tmp_path / "killed").read_text())
    assert killed not in {process for answer, process in answers if answer == 9}
    assert [path.name for path in tmp_path.iterdir()] == ["killed"], "the mark of the folder is left"


def kill_this_worker(_: object) -> None:
    os.kill(os.getpid(), signal.SIGKILL)


@pytest.mark.slow
def test_a_task_that_kills_its_workers_is_refused_in_one_sentence(
    dask_cluster: Any, address: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(dask_cluster.scheduler, "allowed_failures", 0)  # 3 by default: minutes on a slow machine
    with pytest.raises(BadInputError, match=r"one task has ended 1 workers, the last at tcp://.*--memory-limit"):
        done(address, kill_this_worker, [0])


def where_it_runs(_: object) -> tuple[str, str]:
    return os.getcwd(), os.environ["OPENBLAS_NUM_THREADS"]


def test_a_task_runs_in_the_current_folder_with_one_thread(
    address: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    assert done(address, where_it_runs, [0]) == [(str(tmp_path), "1")]


def test_the_temporary_files_of_other_machines_are_left(address: str, tmp_path: Path) -> None:
    (tmp_path / ".wlr-part-of-another.png").touch()
    done(address, atomic_files.output_folder, [tmp_path], tmp_path)
    assert len(list(tmp_path.iterdir())) == 1
    atomic_files.remove_abandoned_once.cache_clear()
    atomic_files.output_folder(tmp_path)
    assert not list(tmp_path.iterdir())


def fail(_: object) -> NoReturn:
    raise BadInputError("a.toml: has no such key.")


def test_workers_that_cannot_load_the_program(address: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    (tmp_path / "only_here.py").write_text("def answer(_):\n    return 42\n")
    monkeypatch.syspath_prepend(tmp_path)
    with pytest.raises(
        BadInputError, match=r"cannot load the program \(No module named 'only_here'\); install the same"
    ):
        done(address, importlib.import_module("only_here").answer, [1])


def test_the_sentence_of_a_task_comes_back(address: str) -> None:
    with pytest.raises(BadInputError, match=r"^a\.toml: has no such key\.$"):
        done(address, fail, [0])


def test_a_file_that_a_task_does_not_find_ends_the_job_with_its_error(address: str, tmp_path: Path) -> None:
    with pytest.raises(FileNotFoundError):
        done(address, open, [str(tmp_path / "absent.txt")], tmp_path)
    assert not list(tmp_path.iterdir())


STUDY = AccuracyOptions(("no_optics",), part=("camera-positions",), counts=(2, 5))
"""Of rays that nothing bends: four trials, whose fits take a second each."""


@pytest.fixture(scope="module")
def here(tmp_path_factory: pytest.TempPathFactory) -> tuple[Report, Path]:
    """The study by local processes: its report, and its folder."""
    folder = tmp_path_factory.mktemp("here")
    return accuracy(replace(STUDY, workers=1, out=folder)), folder


@pytest.mark.slow
def test_a_study_is_that_of_local_processes_and_is_resumed(
    address: str, tmp_path: Path, here: tuple[Report, Path]
) -> None:
    options = replace(STUDY, scheduler=address, out=tmp_path / "there")
    assert accuracy(options).blocks == here[0].blocks
    first, *others = sorted((tmp_path / "there" / "trials").glob("*/*.json"))
    written = [path.stat().st_mtime_ns for path in (first, *others)]
    first.unlink()
    assert accuracy(replace(options, resume=True)).blocks == here[0].blocks
    again = [path.stat().st_mtime_ns for path in (first, *others)]
    assert again[0] != written[0]
    assert again[1:] == written[1:]


def whole(folder: Path) -> dict[Any, Any]:
    """All files of a folder by name but reports, which have dates; the list of finished files in any order."""
    files = {str(path.relative_to(folder)): path.read_bytes() for path in Path(folder).rglob("*") if path.is_file()}
    kept = {name: content for name, content in files.items() if not name.startswith(("report.", "diagnosis."))}
    return {name: sorted(each.splitlines()) if name == LEDGER else each for name, each in kept.items()}


@pytest.fixture
def sequence(tmp_path: Path, small_northstar: str, scene_file: str) -> RenderOptions:
    """Twenty frames of 180 x 200 pixels."""
    head = still_head(tmp_path / "head.tum", [0.0, 1.9])
    given: dict[str, Any] = {"head": head, "frames_per_second": 10.0, "method": "raytrace"}
    return RenderOptions(small_northstar, scene_file, out=tmp_path / "here", **given)


@pytest.mark.slow
@pytest.mark.parametrize("method", ["raytrace", pytest.param("raster", marks=pytest.mark.gl)])
def test_frames_are_those_of_one_process(
    address: str,
    tmp_path: Path,
    sequence: RenderOptions,
    method: Literal["raster", "raytrace"],
    request: pytest.FixtureRequest,
) -> None:
    if method == "raster":
        request.getfixturevalue("gl_context")
    options = replace(sequence, method=method)
    render(options)
    assert render(replace(options, scheduler=address, out=tmp_path / "there")).record["frames_drawn"] == 20
    assert whole(tmp_path / "there") == whole(tmp_path / "here")


@pytest.fixture
def kill_a_worker_at_work(dask_cluster: Any) -> tuple[Progress, list[int]]:
    """Progress of a job that kills a worker with tasks when the first outcome is there, and the killed ones."""
    killed: list[int] = []

    class Killing(Progress):
        def __call__(self, items: Iterable[Item], total: int, label: str) -> Iterator[Item]:
            for item in items:
                if not killed:
                    busy = [each.name for each in dask_cluster.scheduler.workers.values() if each.processing]
                    killed.append(dask_cluster.workers[busy[0]].pid)
                    os.kill(killed[0], signal.SIGKILL)
                yield item

    return Killing(), killed


@pytest.mark.slow
def test_frames_are_those_of_one_process_when_a_worker_is_killed(
    address: str, tmp_path: Path, sequence: RenderOptions, kill_a_worker_at_work: tuple[Progress, list[int]]
) -> None:
    render(sequence)
    progress, killed = kill_a_worker_at_work
    report = render(replace(sequence, scheduler=address, out=tmp_path / "there"), progress=progress)
    assert (len(killed), report.record["frames_drawn"]) == (1, 20)
    assert whole(tmp_path / "there") == whole(tmp_path / "here")


@pytest.mark.slow
def test_a_simulated_session_is_that_of_local_processes(
    address: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Of the last two camera poses, with the six photographs of a bare lens each: panels take minutes."""
    poses = simulate_photo_session.camera_poses
    monkeypatch.setattr(simulate_photo_session, "camera_poses", lambda *given: [*poses(*given)][-2:])
    monkeypatch.setattr(simulate_photo_session, "plan_photographs", small_plan)
    small: dict[str, Any] = {"viewpoints": 2, "camera": (160, 128), "tracking_camera": (160, 120)}
    options = SimulateOptions(far_panel_device(tmp_path), **small, workers=1, out=tmp_path / "here")
    simulate(options)
    simulate(replace(options, out=tmp_path / "there", workers=None, scheduler=address))
    photographs = whole(tmp_path / "here")
    assert len(photographs) > 8
    assert whole(tmp_path / "there") == photographs


MALFORMED = (
    "host",
    "tcp://",
    "tcp://host",
    "tcp://:8786",
    "fax://host:1",
    "tcp://host:70000",
)


@pytest.mark.parametrize("given", MALFORMED)
def test_a_malformed_address(given: str) -> None:
    with pytest.raises(BadInputError, match=rf"^--scheduler {given}: is not the address of a Dask scheduler; st"):
        done(given, abs, [1])


@pytest.mark.slow
@pytest.mark.parametrize("given", ["ws://127.0.0.1:{free}", "tcp://no.such.host.invalid:8786"])
def test_an_address_where_nobody_answers_is_refused_in_one_line(given: str) -> None:
    """In a process of its own: Dask's client prints a traceback when it is deleted, and needs 20 s."""
    with socket.socket() as taken:
        taken.bind(("127.0.0.1", 0))  # nobody listens
        given = given.format(free=taken.getsockname()[1])
        error = refusal_of_a_render(given)
    assert re.fullmatch(
        rf"wlr-render: --scheduler {given}: no Dask scheduler answers there \(.*\); start one.*\n", error
    )


def test_a_server_that_is_no_scheduler(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(cluster, "_CONNECT_S", 0.5)
    with socket.create_server(("127.0.0.1", 0)) as server:
        address = f"tcp://127.0.0.1:{server.getsockname()[1]}"
        with pytest.raises(BadInputError, match=r"no Dask scheduler answers there .another program may listen there.;"):
            done(address, abs, [1])


def refusal_of_a_render(address: str) -> str:
    """What a refused `render` prints to stderr; it leaves nothing."""
    with tempfile.TemporaryDirectory() as folder:
        command = [sys.executable, "-m", "wlr_render", "render", "no_optics", "dots", "--method", "raytrace"]
        finished = subprocess.run(
            [*command, "--scheduler", address, "--out", f"{folder}/out"],
            capture_output=True,
            text=True,
            timeout=60,
            check=False,
        )
        assert (finished.returncode, os.listdir(folder)) == (2, [])
    return finished.stderr


@pytest.mark.parametrize(
    ("change", "sentence"),
    [
        ({"wlr_render": "0.0.1"}, r"has wlr_render \S+ installed, and this machine 0\.0\.1; install the same version"),
        ({"left_out": "1.0"}, "has left_out not installed, and this machine 1.0"),
    ],
)
def test_workers_with_other_versions(
    address: str, monkeypatch: pytest.MonkeyPatch, change: dict[str, str], sentence: str
) -> None:
    own = cluster._versions()
    monkeypatch.setattr(cluster, "_versions", lambda: own | change)
    with pytest.raises(BadInputError, match=sentence):
        done(address, abs, [1])


def test_a_worker_that_does_not_see_the_folder(address: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Another machine's folder of that name is one without the mark."""
    monkeypatch.setattr(cluster, "_marked", lambda folder: contextlib.nullcontext(str(folder / "mark")))
    with pytest.raises(BadInputError, match=rf"does not see the output folder {tmp_path} of this machine"):
        done(address, abs, [1], tmp_path)


def test_a_cluster_without_workers_is_not_waited_for_forever(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(workers, "_NO_WORKER_S", 0.2)
    with (
        distributed.SpecCluster({}, {"cls": distributed.Scheduler, "options": {"dashboard_address": ":0"}}) as empty,
        pytest.raises(BadInputError, match="it has had no worker for 0 s; start some with 'dask worker"),
    ):
        done(empty.scheduler_address, abs, [1])


def test_a_worker_with_several_threads(tmp_path: Path) -> None:
    with (
        distributed.LocalCluster(
            n_workers=1,
            threads_per_worker=2,
            processes=False,
            protocol="tcp://",
            dashboard_address=":0",
            silence_logs=logging.CRITICAL,
        ) as threaded,
        pytest.raises(BadInputError, match="has 2 threads, and each task needs a separate process"),
    ):
        done(threaded.scheduler_address, abs, [1])


def test_without_dask_the_sentence_says_how_to_install_it(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "distributed", None)
    with pytest.raises(MissingExtraError, match=r"pip install 'distributed"):
        done("tcp://127.0.0.1:8786", abs, [1])


def test_workers_and_scheduler_exclude_each_other() -> None:
    with pytest.raises(BadInputError, match="--workers has no effect with --scheduler"):
        AccuracyOptions(workers=2, scheduler="tcp://host:8786")


def test_results_are_taken_at_once_and_the_scheduler_is_seldom_asked_for_workers(
    address: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    asked, before = [], distributed.Client.scheduler_info

    def noted(*given: Any, **named: Any) -> Any:
        asked.append(1)
        return before(*given)

    monkeypatch.setattr(distributed.Client, "scheduler_info", noted)
    monkeypatch.setattr(workers, "_WORKERS_EVERY_S", 1000.0)  # longer than the time limit of the test run
    assert sorted(done(address, abs, range(20))) == list(range(20))
    assert not asked


def test_between_results_the_log_and_the_settings_of_dask_are_those_of_the_caller(address: str) -> None:
    import dask

    dask_log, setting = logging.getLogger("distributed"), "distributed.admin.large-graph-warning-threshold"
    before = dask.config.get(setting)
    results = as_finished(abs, [1, 2], WorkerPool(scheduler=address))
    for _ in results:
        assert (dask_log.disabled, dask.config.get(setting)) == (False, before)


def test_libraries_that_draw_are_compared() -> None:
    installed = {each.metadata["Name"].lower() for each in importlib.metadata.distributions()}
    drawing = {"moderngl", "trimesh", "pyrender-maintained", "embreex", "mitsuba", "drjit"} & installed
    assert drawing
    assert drawing <= cluster._versions().keys()


def pages_of_ten_arrays(_: object) -> int:
    """Pages that the system gives to this process while it makes and drops ten arrays of 8 MB."""
    before = resource.getrusage(resource.RUSAGE_SELF).ru_minflt
    for _ in range(10):
        np.ones(1_000_000)
    return resource.getrusage(resource.RUSAGE_SELF).ru_minflt - before


@pytest.mark.slow
@pytest.mark.skipif(platform.libc_ver()[0] != "glibc", reason="other C libraries manage memory by other rules")
def test_a_worker_keeps_the_memory_of_an_array_for_the_next_one(address: str) -> None:
    one_array = 8_000_000 / resource.getpagesize()
    done(address, pages_of_ten_arrays, [0])
    assert done(address, pages_of_ten_arrays, [0, 1])[-1] < 3 * one_array


def miss_a_library(_: object) -> None:
    importlib.import_module("a_library_of_the_task")


def test_a_library_that_a_task_misses_is_not_the_program(address: str) -> None:
    with pytest.raises(ModuleNotFoundError, match="a_library_of_the_task"):
        done(address, miss_a_library, [0])
