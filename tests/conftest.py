"""Options of the test run, and fixtures that several rooms share."""

import contextlib
import os
import re

# Before numpy is imported, as the command line does: BLAS threads only slow down the thin matrix products here.
os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

from collections.abc import Callable, Generator, Iterator
from pathlib import Path
from types import ModuleType
from typing import TypeVar

import pytest
from _pytest.terminal import TerminalReporter
from flat_image import flat_image_eye
from gl_caller import Caller
from memo import memoised, shared_folder
from present import narrowed
from small_photo_session import SmallSession

from wlr_render.calibration.calibrate_session import SessionCalibration
from wlr_render.draw.mitsuba_frames import PathTracer
from wlr_render.errors import MissingGlError
from wlr_render.extras import MissingExtraError
from wlr_render.gl import gl
from wlr_render.gl.context import GlContext
from wlr_render.mappings import Eye
from wlr_render.report.blocks import Report
from wlr_render.scene.scene import Scene
from wlr_render.warp import gl_backend, gl_ray_maps, raster_camera

pytest_plugins = ["small_headsets", "toy_headsets"]

DATA_BESIDE_CHECKOUT = Path(__file__).resolve().parents[2] / "shared" / "data"

SLOW_S = 5.0
"""Seconds of a test that `--fast` complains of: the limit of the marker, 1 s, and room for a machine that is busy."""

AnyReport = TypeVar("AnyReport", pytest.TestReport, pytest.CollectReport)

LEFT_TO_THE_USER = re.compile(
    "measured s|Optiland|(open3d|warp|warp-lang|newton|datasets|pyopenxr|monado-service|bpy|Blender|naga) is not "
    "installed|rattler-build|opencv-contrib-python only|root may|user namespaces"
)
"""Reasons of skips that `./wlr readers` does not remove: large libraries, data of others, rights of the user."""


CHEAP = {"opened_gl_context", "bases"}
"""Shared fixtures that take a second or two: the OpenGL context, and the valid files of the corpus."""


def pytest_addoption(parser: pytest.Parser) -> None:
    parser.addoption(
        "--readers", action="store_true", help="fail tests that are skipped although ./wlr readers installs their needs"
    )
    parser.addoption(
        "--fast",
        action="store_true",
        help="run the first quick test of each file: it has no slow mark and no shared fixture",
    )


def room_of(item: pytest.Item) -> str:
    """The folder of tests/ in which a test is."""
    return item.path.relative_to(Path(__file__).parent).parent.as_posix().split("/")[0]


def is_quick(item: pytest.Item) -> bool:
    """Whether a test is not marked slow, and uses no fixture of ours that tests share because it is expensive."""
    info = narrowed(item, pytest.Function)._fixtureinfo
    definitions = (each[-1] for name, each in info.name2fixturedefs.items() if name not in CHEAP)
    shared = any(each.scope in ("module", "session") and each.baseid for each in definitions)
    return not shared and item.get_closest_marker("slow") is None


def pytest_collection_modifyitems(config: pytest.Config, items: list[pytest.Item]) -> None:
    if not config.getoption("--fast"):
        return
    first: dict[Path, pytest.Item] = {}
    for item in items:
        if is_quick(item):
            first.setdefault(item.path, item)
    chosen = set(first.values())
    if rooms := {room_of(item) for item in items} - {room_of(item) for item in chosen}:
        raise pytest.UsageError(f"--fast runs nothing of {', '.join(sorted(rooms))}: all of it is marked slow")
    config.hook.pytest_deselected(items=[item for item in items if item not in chosen])
    items[:] = [item for item in items if item in chosen]


def pytest_terminal_summary(terminalreporter: TerminalReporter, config: pytest.Config) -> None:
    reports = [report for kind in ("passed", "failed") for report in terminalreporter.stats.get(kind, ())]
    for report in reports if config.getoption("--fast") else ():
        if report.duration > SLOW_S:
            terminalreporter.line(f"{report.nodeid} took {report.duration:.0f} s: mark it slow")


@pytest.hookimpl(wrapper=True)
def pytest_runtest_makereport(item: pytest.Item) -> Generator[None, pytest.TestReport, pytest.TestReport]:
    return failed_if_skipped((yield), item.config)


@pytest.hookimpl(wrapper=True)
def pytest_make_collect_report(
    collector: pytest.Collector,
) -> Generator[None, pytest.CollectReport, pytest.CollectReport]:
    return failed_if_skipped((yield), collector.config)


def failed_if_skipped(report: AnyReport, config: pytest.Config) -> AnyReport:
    if (
        report.skipped
        and config.getoption("--readers")
        and not LEFT_TO_THE_USER.search(reason := narrowed(report.longrepr, tuple)[-1])
    ):
        report.outcome, report.longrepr = "failed", f"{reason}\nNo test may be skipped for this after `./wlr readers`."
    return report


@pytest.fixture
def flat_image_headset() -> Eye:
    return flat_image_eye()


@pytest.fixture
def measured_data() -> Callable[[str], Path]:
    """Folder of a measured set of others, by name; the test is skipped where the set is not at hand."""

    def folder_of(name: str) -> Path:
        folder = Path(os.environ.get("WLR_DATA", DATA_BESIDE_CHECKOUT)) / name
        if not folder.is_dir():
            pytest.skip(f"the measured set {name} is not here; docs/measured-data.md says where to get it")
        return folder

    return folder_of


@pytest.fixture(scope="session")
def calibrated_session(tmp_path_factory: pytest.TempPathFactory) -> tuple[SmallSession, SessionCalibration, Report]:
    """A small session of photographs, simulated, its calibration and the report of it; nobody writes there."""
    from small_photo_session import made_session

    shared = shared_folder(tmp_path_factory)
    return memoised(made_session, shared)(shared / "photographs")


@pytest.fixture
def photo_session(
    calibrated_session: tuple[SmallSession, SessionCalibration, Report], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> SmallSession:
    """A copy of it to spoil; whatever is simulated or read meanwhile is small and in this process."""
    from small_photo_session import copied, make_small

    make_small(monkeypatch)
    return copied(calibrated_session[0], tmp_path)


@pytest.fixture(scope="session")
def mitsuba() -> ModuleType:
    """The library, which few machines have; tests that need it are skipped elsewhere."""
    library: ModuleType = pytest.importorskip("mitsuba", reason="Mitsuba is not installed: pip install '.[mitsuba]'.")
    try:
        PathTracer(Scene("empty", (), (), ()))
    except MissingExtraError as error:
        pytest.skip(str(error))
    return library


@pytest.fixture(scope="session")
def opened_gl_context() -> Iterator[GlContext]:
    with gl.open_context() as context:
        yield context


@pytest.fixture
def gl_context(request: pytest.FixtureRequest) -> Iterator[GlContext]:
    """The one OpenGL context of the test run, checked for errors before and after."""
    try:
        context = request.getfixturevalue("opened_gl_context")
    except MissingGlError as error:
        pytest.skip(str(error))
    with context.drawing() as ctx:
        assert ctx.error == "GL_NO_ERROR"
    yield context
    with vars(context)["_owner"].entered():
        assert ctx.error == "GL_NO_ERROR"


CHOICES = (
    (raster_camera, "choose_warp_grid"),
    (raster_camera, "minification_over_eye_box"),
    (gl_backend, "choose_plan"),
    (gl_ray_maps, "planar_terms"),
)
"""Functions of a model alone, which solve thousands of its rays: the most part of a compositor's start."""


@pytest.fixture
def choices_made_once(monkeypatch: pytest.MonkeyPatch, tmp_path_factory: pytest.TempPathFactory) -> None:
    """Choose for each model once in a run; tests/warps hold the choices to their laws."""
    for module, name in CHOICES:
        monkeypatch.setattr(module, name, memoised(getattr(module, name), shared_folder(tmp_path_factory)))


@pytest.fixture
def caller(gl_context: GlContext) -> Iterator[Caller]:
    """Another program's context, by EGL; `gl_context` skips the test where there is no OpenGL."""
    if gl_context.backend != "egl":
        pytest.skip("EGL does not open here, so that there is no other context to adopt.")
    made = Caller()
    yield made
    made.ctx.release()


@pytest.fixture
def file_size_limit() -> Callable[[int], contextlib.AbstractContextManager[None]]:
    """A context manager in which no file can grow beyond so many bytes: a full disk, as the system can imitate one."""
    resource = pytest.importorskip("resource")

    @contextlib.contextmanager
    def limited(size: int) -> Iterator[None]:
        before = resource.getrlimit(resource.RLIMIT_FSIZE)
        resource.setrlimit(resource.RLIMIT_FSIZE, (size, before[1]))
        try:
            with pytest.MonkeyPatch.context() as patch:
                patch.setattr("sys.dont_write_bytecode", True)  # Python 3.11 keeps a cache that was cut short
                yield
        finally:
            resource.setrlimit(resource.RLIMIT_FSIZE, before)

    return limited
