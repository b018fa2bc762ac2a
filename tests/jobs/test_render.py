import json
import os
import shutil
import sys
import threading
from collections.abc import Callable, Iterable, Iterator, Sequence
from contextlib import AbstractContextManager
from dataclasses import replace
from pathlib import Path
from types import ModuleType
from typing import Any, Literal, NoReturn, cast

import numpy as np
import pytest
from numpy.typing import NDArray
from present import as_number, narrowed

from wlr_render.budget.registration_budget import registration_covariance
from wlr_render.draw.painters import Frame
from wlr_render.draw.raster_painter import WarpedPainter
from wlr_render.errors import BadInputError, MissingGlError
from wlr_render.geometry import transforms
from wlr_render.gl import gl
from wlr_render.gl.context import GlContext
from wlr_render.io import kept
from wlr_render.io.input_files import LIMITS
from wlr_render.jobs import frame_drawing
from wlr_render.jobs.budget import opened_with_sizes
from wlr_render.jobs.budget_options import BudgetOptions
from wlr_render.jobs.demo import DemoOptions, demo
from wlr_render.jobs.frame_plan import motion_of, planned_frames
from wlr_render.jobs.headset import open_eye
from wlr_render.jobs.options import Backend
from wlr_render.jobs.render import render
from wlr_render.jobs.render_options import RenderOptions
from wlr_render.mappings import Eye, EyeBox
from wlr_render.models.display_model import DisplayModel
from wlr_render.models.model_file import load_eye_model, save_eye_models
from wlr_render.models.see_through_model import SeeThroughModel
from wlr_render.numerics.arrays import FloatArray
from wlr_render.report.blocks import Report
from wlr_render.scene.image_files import read_map, read_png, write_png
from wlr_render.tracking.eye_trajectory_file import write_eye_trajectory
from wlr_render.tracking.head_trajectory_file import write_head_trajectory_tum
from wlr_render.tracking.trajectory import EyeTrajectory, HeadTrajectory, ViewpointTrack
from wlr_render.work.progress import Item, Progress


def still_head(path: Path, times: FloatArray | Sequence[Any], turn_rate: float = 0.05) -> Path:
    """A head at the origin that turns slowly about the vertical."""
    angle = turn_rate * np.asarray(times)
    xyzw = np.stack([0 * angle, np.sin(angle / 2), 0 * angle, np.cos(angle / 2)], axis=-1)
    return write_head_trajectory_tum(path, HeadTrajectory(np.asarray(times), np.zeros((len(times), 3)), xyzw))


def moving_pupil(
    path: Path,
    eye: str,
    times: FloatArray | Sequence[Any],
    centre: FloatArray,
    step_m: tuple[float, float, float] = (0.001, 0.0005, 0.0),
) -> Path:
    """A pupil that leaves `centre` at so many metres per second."""
    track = ViewpointTrack(np.asarray(times), centre + np.outer(np.asarray(times) - times[0], step_m))
    return write_eye_trajectory(path, EyeTrajectory({eye: track}))


class PassedOn(Progress):
    """Progress by a function of the items."""

    def __init__(self, passed_on: Callable[[Iterable[Any]], Iterator[Any]]) -> None:
        self.passed_on = passed_on

    def __call__(self, items: Iterable[Item], total: int, label: str) -> Iterator[Item]:
        return self.passed_on(items)


def counts(report: Report) -> tuple[Any, Any]:
    """Frames drawn and kept."""
    return report.record["frames_drawn"], report.record["frames_kept"]


def metadata(folder: Path) -> list[Any]:
    """Facts of each frame."""
    return [json.loads(line) for line in (Path(folder) / "metadata.jsonl").read_text().splitlines()]


def pictures(folder: Path) -> dict[Any, Any]:
    return {path.name: path.read_bytes() for path in sorted(Path(folder).glob("*.png"))}


@pytest.fixture
def options(tmp_path: Path, straight_device: str, scene_file: str, gl_context: GlContext) -> RenderOptions:
    return RenderOptions(straight_device, scene_file, out=tmp_path / "frames")


def moving_wearer(folder: Path, headset: str, scene: str) -> RenderOptions:
    """Five frames of a headset whose wearer moves head and eyes."""
    centre = open_eye(headset).eye_box.centre
    return RenderOptions(
        headset,
        scene,
        head=still_head(folder / "head.tum", [0.0, 0.3, 0.6]),
        eye_track=moving_pupil(folder / "eyes.txt", "right", [0.1, 0.5], centre),
        frames_per_second=10.0,
        out=folder / "whole",
    )


@pytest.fixture
def moving(tmp_path: Path, straight_device: str, scene_file: str, gl_context: GlContext) -> RenderOptions:
    return moving_wearer(tmp_path, straight_device, scene_file)


@pytest.fixture
def fitted(tmp_path: Path, model_file: str, scene_file: str, gl_context: GlContext) -> RenderOptions:
    """The same of a fitted headset."""
    return moving_wearer(tmp_path, model_file, scene_file)


@pytest.mark.slow
def test_frames_cover_what_both_tracks_cover_and_the_record_says_from_where(moving: RenderOptions) -> None:
    assert counts(render(moving)) == (5, 0)
    frames = metadata(moving.out)
    assert [frame["file_name"] for frame in frames] == [f"right-{k:06d}.png" for k in range(5)]
    assert sorted(pictures(moving.out)) == [frame["file_name"] for frame in frames]
    times = np.array([frame["time_s"] for frame in frames])
    np.testing.assert_allclose(times, [0.1, 0.2, 0.3, 0.4, 0.5])
    centre = open_eye(moving.headset).eye_box.centre
    viewpoint = np.array([frame["viewpoint_in_device_m"] for frame in frames])
    np.testing.assert_allclose(viewpoint, centre + np.outer(times - 0.1, [0.001, 0.0005, 0.0]), atol=1e-12)
    turned = transforms.rigid(transforms.rotation_about("y", 0.05 * times[3]), np.zeros(3))
    np.testing.assert_allclose(frames[3]["world_from_device"], turned, atol=1e-9)
    recipe = json.loads((moving.out / "finished.jsonl").read_text().splitlines()[0])["recipe"]
    assert (recipe["job"], recipe["--scene"]["file"]) == ("render", moving.scene)


@pytest.mark.slow
def test_an_interrupted_sequence_resumes_with_what_is_missing_and_ends_up_the_same(
    fitted: RenderOptions, tmp_path: Path
) -> None:
    render(fitted)
    again = replace(fitted, out=tmp_path / "resumed")
    assert counts(render(replace(again, frame_limit=2))) == (2, 0)
    (again.out / "right-000000.png").unlink()
    untouched = (again.out / "right-000001.png").stat().st_mtime_ns
    report = render(again)
    assert counts(report) == (4, 1)
    assert report.verdict == f"4 frames drawn, 1 kept from an earlier run: 5 PNG in {again.out}."
    assert (again.out / "right-000001.png").stat().st_mtime_ns == untouched
    assert pictures(again.out) == pictures(fitted.out)
    assert (again.out / "metadata.jsonl").read_bytes() == (fitted.out / "metadata.jsonl").read_bytes()
    assert len(set(pictures(fitted.out).values())) == 5


def test_a_sequence_that_filled_the_disk_ends_up_the_same_when_there_is_space_again(
    moving: RenderOptions, tmp_path: Path
) -> None:
    """The first run stops at a frame that is larger than the system lets files be."""
    resource = pytest.importorskip("resource")
    render(moving)
    again = replace(moving, out=tmp_path / "resumed")
    before, most = resource.getrlimit(resource.RLIMIT_FSIZE)

    def disk_fills_up(items: Iterable[Any]) -> Iterator[Any]:
        resource.setrlimit(resource.RLIMIT_FSIZE, (min(map(len, pictures(moving.out).values())) - 1, most))
        yield from items

    try:
        with pytest.raises(BadInputError, match=r"right-000000\.png: cannot be written \(File too large\)"):
            render(again, progress=PassedOn(disk_fills_up))
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, (before, most))
    render(again)
    assert pictures(again.out) == pictures(moving.out)


def test_files_are_written_while_later_frames_are_drawn_and_a_listed_frame_has_all_of_them(
    moving: RenderOptions, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    job = replace(moving, maps="tiff")
    render(job)
    again, third_is_drawn, drawn = replace(job, out=tmp_path / "again"), threading.Event(), list[object]()
    paint, listed = WarpedPainter.paint, list[str]()

    def painted(*given: Any, **options: Any) -> Frame:
        drawn.append(given)
        if len(drawn) == 3:
            third_is_drawn.set()
        return paint(*given, **options)

    def written(path: Path, colour: NDArray[np.uint8]) -> Path:
        assert third_is_drawn.wait(60), "no frame is drawn before the files of the first one are written"
        return write_png(path, colour)

    def watched(items: Iterable[Any]) -> Iterator[Any]:
        for frame in items:
            listed.append(list(frame.files)[-1].name)
            assert [path for path in frame.files if not path.exists()] == []
            yield frame

    monkeypatch.setattr(WarpedPainter, "paint", painted)
    monkeypatch.setattr(frame_drawing, "write_png", written)
    render(again, progress=PassedOn(watched))
    assert listed == [f"right-{number:06}.png" for number in range(5)]
    names = ["metadata.jsonl", *(path.name for path in job.out.glob("right-*"))]
    assert len(names) == 16
    for name in names:
        assert (again.out / name).read_bytes() == (job.out / name).read_bytes(), name


@pytest.mark.gl
@pytest.mark.usefixtures("gl_context")
def test_no_frame_depends_on_the_frames_before_it(
    options: RenderOptions, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    painted = []
    paint = WarpedPainter.paint

    def spy(painter: WarpedPainter, *given: Any, **options: Any) -> Frame:
        painted.append(painter)
        return paint(painter, *given, **options)

    monkeypatch.setattr(WarpedPainter, "paint", spy)
    head = still_head(tmp_path / "head.tum", [0.0, 0.2])
    both = replace(options, head=head, eye="both", frames_per_second=10.0, backend="auto")
    render(both)
    assert (len(painted), len(set(painted))) == (6, 2)
    whole = pictures(both.out)
    for name in list(whole)[1::2]:
        (both.out / name).unlink()
    render(both)
    assert pictures(both.out) == whole


def test_an_interruption_leaves_whole_frames_only(options: RenderOptions, monkeypatch: pytest.MonkeyPatch) -> None:
    def interrupt(items: Iterable[Any]) -> Iterator[Any]:
        for number, item in enumerate(items):
            if number == 1:
                raise KeyboardInterrupt
            yield item

    both = replace(options, eye="both")
    with pytest.raises(KeyboardInterrupt):
        render(both, progress=PassedOn(interrupt))
    assert {path.name for path in both.out.iterdir()} == {
        "finished.jsonl",
        "left-000000.png",
        "right-000000.png",
    }
    assert read_png(both.out / "left-000000.png").shape == (36, 64, 3)


@pytest.mark.parametrize(("ball_z_m", "crossed_px"), [(-0.5, 0.0), (-0.3, 64e-3 * (0.5 / 0.3 - 1) / 5e-3)])
def test_both_eyes_see_the_scene_from_their_own_side(
    options: RenderOptions, tmp_path: Path, ball_z_m: float, crossed_px: float
) -> None:
    """Both panels lie in the plane z = -0.5 m, 5 mm to a pixel: what is nearer is seen crossed there."""
    device = tmp_path / "apart.toml"
    text = Path(options.headset).read_text(encoding="utf-8")
    device.write_text(text.replace("centre_mm = [0.0, 0.0, 0.0]", "centre_mm = [32.0, 0.0, 0.0]"), encoding="utf-8")
    scene = tmp_path / "scene.toml"
    ball = Path(options.scene).read_text(encoding="utf-8")
    # The silhouette of a larger ball is not symmetric about its centre.
    small = ball.replace("[0.03, 0.01, -0.5]", f"[0.0, 0.0, {ball_z_m}]").replace("radius_m = 0.06", "radius_m = 0.02")
    scene.write_text(small, encoding="utf-8")
    job = replace(options, headset=str(device), scene=str(scene), eye="both", maps="tiff")
    assert counts(render(job)) == (2, 0)
    column = {}
    for eye in ("left", "right"):
        inverse_depth = read_map(options.out / f"{eye}-000000.tiff")[..., 2]
        column[eye] = np.nonzero(inverse_depth > 1.0)[1].mean()
    assert column["left"] - column["right"] == pytest.approx(crossed_px, abs=0.3)


def test_frames_that_show_nothing_of_the_scene_are_named(options: RenderOptions, tmp_path: Path) -> None:
    assert not [each for each in render(options).warnings if "nothing of the scene" in each]
    ball = Path(options.scene).read_text(encoding="utf-8").split("[[object]]")
    scene = tmp_path / "behind.toml"
    scene.write_text(ball[0] + "[[object]]" + ball[1].replace("-0.5]", "0.5]"), encoding="utf-8")
    behind = replace(options, scene=str(scene), out=tmp_path / "behind")
    for drawn in (1, 0):  # the second run keeps the frame
        report = render(behind)
        (warning,) = report.warnings
        assert warning.startswith("right-000000.png shows nothing of the scene")
        assert "The headset is at (0.00, 0.00, 0.00) m;" in warning
        assert report.record["frames_drawn"] == drawn


def test_burnt_out_frames_and_columns_that_are_not_read_are_named(options: RenderOptions, tmp_path: Path) -> None:
    place = ",".join(f"{1e3 * each:.6f}" for each in open_eye(options.headset).eye_box.centre)
    track = tmp_path / "pupils.csv"
    names = "time_s,right_x_mm,right_y_mm,right_z_mm,confidence"
    track.write_text(f"{names}\n0,{place},1\n1,{place},1\n", encoding="utf-8")
    scene = tmp_path / "bright.toml"
    light = '[[light]]\nkind = "directional"\ndirection = [0, 0, -1]\ncolour = [1, 1, 1]\n'
    scene.write_text(f"exposure = 683\n{Path(options.scene).read_text(encoding='utf-8')}\n{light}", encoding="utf-8")
    report = render(replace(options, scene=str(scene), eye_track=track, frame_limit=1))
    columns, burnt = report.warnings
    assert columns.startswith(f"{track}: not read: 'confidence'")
    share = np.mean((read_png(options.out / "right-000000.png") == 255).any(axis=-1))
    assert share > 0.01
    assert burnt.startswith(f"{share:.0%} of the pixels of a frame are saturated.")
    assert "[[light]] number 2' (683 times)" in burnt


def test_more_frames_than_a_disk_holds_are_refused(moving: RenderOptions, tmp_path: Path) -> None:
    long = still_head(tmp_path / "long.tum", [0.0, 1e6])
    with pytest.raises(BadInputError, match=r"--fps 10 over 1e\+06 s are 10000001 frames; draw at most 1000000"):
        render(replace(moving, head=long, eye_track=None))
    assert not moving.out.exists()


def test_a_sequence_whose_record_could_not_be_read_again_is_refused_before_it_is_drawn(
    moving: RenderOptions, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(kept, "LIMITS", replace(LIMITS, record_bytes=2000))
    with pytest.raises(BadInputError, match=r"finished\.jsonl of 5 files would have 0 MB.*; cut the job into several"):
        render(moving)
    assert not moving.out.exists()
    monkeypatch.setattr(kept, "LIMITS", replace(LIMITS, record_bytes=10_000))
    with pytest.raises(BadInputError, match=r"finished\.jsonl of .* files would have 0 MB"):
        render(replace(moving, predicted_error=1.0))
    assert not moving.out.exists()


@pytest.mark.parametrize(
    ("change", "reason"),
    [
        ({"method": "raytrace", "backend": "auto"}, "--method was raster and is raytrace"),
        ({"frames_per_second": 5.0}, "--fps was 10.0 and is 5.0"),
        ({"maps": "tiff"}, "--maps was None and is tiff"),
        ({"per_colour": True}, "--per-colour was False and is True"),
    ],
    ids=lambda change: next(iter(change)),
)
def test_a_folder_of_another_job_is_refused_and_left_as_it_is(
    options: RenderOptions, tmp_path: Path, change: dict[str, Any], reason: str
) -> None:
    head = still_head(tmp_path / "head.tum", [0.0, 0.2])
    job = replace(options, head=head, frames_per_second=10.0)
    render(job)
    refuses(replace(job, **change), reason)


def refuses(job: RenderOptions, reason: str) -> None:
    """The folder of a job is refused for a reason, and left as it is."""
    before = {path.name: path.read_bytes() for path in job.out.iterdir()}
    with pytest.raises(BadInputError, match=r"frames: belongs to other options: .*; choose another") as got:
        render(job)
    assert reason in str(got.value)
    assert {path.name: path.read_bytes() for path in job.out.iterdir()} == before


@pytest.mark.parametrize("name", ["device.toml", "scene.toml", "square.obj", "square.mtl", "square.png", "head.tum"])
def test_a_file_that_has_changed_under_its_old_name_is_named(options: RenderOptions, tmp_path: Path, name: str) -> None:
    shutil.copy(options.headset, tmp_path / "device.toml")
    scene = Path(options.scene).read_text(encoding="utf-8")
    (tmp_path / "scene.toml").write_text(scene + '\n[[object]]\nmesh = "square.obj"\nposition_m = [0.0, 0.0, -1.0]\n')
    corners = "v 0 0 0\nv 1 0 0\nv 1 1 0\nvt 0 0\nvt 1 0\nvt 1 1\n"
    (tmp_path / "square.obj").write_text(f"mtllib square.mtl\n{corners}usemtl m\nf 1/1 2/2 3/3\n")
    (tmp_path / "square.mtl").write_text("newmtl m\nKd 1 1 1\nmap_Kd square.png\n")
    write_png(tmp_path / "square.png", np.full((4, 4, 3), 200, np.uint8))
    head = still_head(tmp_path / "head.tum", [0.0, 0.2])
    files: dict[str, Any] = {
        "headset": str(tmp_path / "device.toml"),
        "scene": str(tmp_path / "scene.toml"),
        "head": head,
    }
    job = replace(options, **files, frames_per_second=10.0)
    assert counts(render(job)) == (3, 0)
    assert counts(render(job)) == (0, 3)
    changed = tmp_path / name
    if name == "head.tum":
        still_head(changed, [0.0, 0.2], turn_rate=1.0)
    elif name == "square.png":
        write_png(changed, np.full((4, 4, 3), 201, np.uint8))
    else:
        changed.write_text(changed.read_text(encoding="utf-8") + "\n# the same, but another file\n")
    refuses(job, f"{changed} has changed")


@pytest.mark.parametrize(
    ("ledger", "sentence"),
    [
        ('{"recipe": 3}\n[]', r"right-000000\.png: was written by another program or job"),
        ('{"recipe": {}}', "belongs to other options: job was None and is render"),
    ],
)
def test_frames_of_unknown_origin_are_refused(options: RenderOptions, ledger: str, sentence: str) -> None:
    """tests/test_kept.py has damaged and hostile ledgers."""
    options.out.mkdir()
    (options.out / "right-000000.png").write_bytes(b"a picture")
    (options.out / "finished.jsonl").write_text(ledger)
    with pytest.raises(BadInputError, match=rf"{sentence}.*; choose another folder or empty it"):
        render(options)
    assert (options.out / "right-000000.png").read_bytes() == b"a picture"


def test_a_disk_that_is_full_when_a_frame_is_listed_ends_the_run_and_the_next_one_goes_on(
    moving: RenderOptions, file_size_limit: Callable[[int], AbstractContextManager[None]]
) -> None:
    render(moving)
    whole = pictures(moving.out)
    listed = moving.out / "finished.jsonl"
    second = listed.read_text().splitlines(keepends=True)[:3]
    listed.write_text("".join(second) + "\n" * 100_000)
    with (
        file_size_limit(listed.stat().st_size + 50),
        pytest.raises(BadInputError, match=r"finished\.jsonl: cannot be written .*; free space"),
    ):
        render(moving)
    assert counts(render(moving)) == (3, 2)
    assert pictures(moving.out) == whole


@pytest.mark.gl
def test_backend_and_video_may_change_between_runs(options: RenderOptions, gl_context: GlContext) -> None:
    options = replace(options, backend="auto")
    render(options)
    assert counts(render(replace(options, backend=cast(Backend, gl_context.backend), video=False))) == (0, 1)
    with pytest.raises(BadInputError, match="--method was raster and is raytrace"):
        render(replace(options, backend="cpu"))


@pytest.mark.slow
@pytest.mark.usefixtures("known_warp_grid")
def test_predicted_errors_are_written_beside_the_frames_and_in_the_table(
    fitted: RenderOptions, monkeypatch: pytest.MonkeyPatch
) -> None:
    job = replace(fitted, predicted_error=0.5)
    report = render(job)
    maps = [read_map(job.out / f"right-{number:06d}-error.tiff") for number in range(5)]
    record = report.record["predicted_error"]
    assert [each["file"] for each in record] == [f"right-{number:06d}.png" for number in range(5)]
    for found, stated in zip(maps, record, strict=True):
        assert found.shape == (16, 18, 3)
        assert np.sqrt(np.mean(found[..., 2].astype(float) ** 2)) == pytest.approx(stated["rms_arcmin"], rel=1e-5)
    mappings, sizes = opened_with_sizes(BudgetOptions(job.headset), "right")
    viewpoint = metadata(job.out)[4]["viewpoint_in_device_m"]
    covariance = registration_covariance(mappings, mappings.display.panel.grid(18, 16), viewpoint, 0.5, sizes).total
    np.testing.assert_allclose(maps[4][..., 2], np.sqrt(np.trace(covariance, axis1=-2, axis2=-1)), rtol=0.01)
    assert "EYE-NNNNNN-error.tiff has the map of each frame" in report.tables[0].notes[0]
    sources = {each["name"] for frame in record for each in frame["sources"]}
    assert {"model: noise and stage", "model: truncation", "eye tracker: bias", "head tracker: noise"} <= sources
    rows = report.tables[1].rows
    assert {row[1] for row in rows} == sources | {"all"}
    of_frames = [each["rms_arcmin"] for frame in record for each in frame["sources"] if each["name"] == rows[0][1]]
    assert rows[0][2] == pytest.approx(np.sqrt(np.mean(np.square(of_frames))))
    assert np.linalg.norm([as_number(row[2]) for row in rows[:-1]]) == pytest.approx(rows[-1][2])
    worst = [max(each[name] for each in record) for name in ("rms_arcmin", "radius_arcmin")]
    assert report.tables[0].rows[0][4:] == worst
    (job.out / "right-000002-error.tiff").write_bytes(b"")
    assert counts(render(job)) == (1, 4)
    np.testing.assert_array_equal(read_map(job.out / "right-000002-error.tiff"), maps[2])
    # Kept frames have their errors in the ledger: nothing is computed again.
    monkeypatch.setattr(frame_drawing, "ErrorMap", None)
    assert render(job).record == {**report.record, "frames_drawn": 0, "frames_kept": 5}


@pytest.mark.usefixtures("known_warp_grid")
def test_a_model_without_covariance_has_no_predicted_error_and_writes_no_frame(
    fitted: RenderOptions, tmp_path: Path
) -> None:
    model = load_eye_model(fitted.headset)
    display = replace(narrowed(model.mappings.display, DisplayModel), spread=None)
    see_through = replace(narrowed(model.mappings.see_through, SeeThroughModel), spread=None)
    mappings = replace(model.mappings, display=display, see_through=see_through)
    old = save_eye_models(tmp_path / "old.json", [replace(model, mappings=mappings)])
    with pytest.raises(BadInputError, match=r"old\.json.*has no covariance"):
        render(replace(fitted, headset=str(old), predicted_error=0.5))
    assert not fitted.out.exists()


def test_a_sequence_is_continued_whatever_the_spelling_of_its_paths(
    options: RenderOptions, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    (tmp_path / "folder").mkdir()
    for name, path in (("device.toml", options.headset), ("scene.toml", options.scene)):
        shutil.copy(path, tmp_path / name)
    still_head(tmp_path / "head.tum", [0.0, 0.2])
    names: dict[str, Any] = {
        "headset": "device.toml",
        "scene": "scene.toml",
        "head": Path("head.tum"),
        "misalignment": "device.toml",
    }
    job = replace(options, **names, frames_per_second=10.0)
    assert counts(render(job)) == (3, 0)
    moved: dict[str, Any] = {
        "headset": f"{tmp_path}/device.toml",
        "scene": "./scene.toml",
        "head": tmp_path / "head.tum",
        "misalignment": "folder/../device.toml",
    }
    assert counts(render(replace(job, **moved))) == (0, 3)
    still_head(tmp_path / "longer.tum", [0.0, 0.2, 0.3])
    assert counts(render(replace(job, head=Path("longer.tum")))) == (1, 3)
    refuses(replace(job, head=None), "--head was head.tum and is None")
    shutil.copy(options.headset, tmp_path / "other.toml")
    (tmp_path / "other.toml").write_text((tmp_path / "other.toml").read_text() + "\n# another\n")
    refuses(replace(job, headset="other.toml"), "--headset was device.toml and is other.toml")


def test_exchanged_models_are_another_job(
    options: RenderOptions, model_file: str, tmp_path: Path, small_panel_model: Eye
) -> None:
    """Both jobs read the same files."""
    other = tmp_path / "other.json"
    other.write_text(Path(model_file).read_text().replace('"fitted"', '"other"'))
    given: dict[str, Any] = {"headset": model_file, "red_model": Path(model_file), "blue_model": other}
    job = replace(options, **given)
    render(job)
    refuses(replace(job, red_model=other, blue_model=Path(model_file)), f"--red-model was {model_file} and is {other}")


def test_a_frame_that_is_not_as_it_was_drawn_is_drawn_again_and_named(moving: RenderOptions) -> None:
    job = replace(moving, maps="tiff")
    render(job)
    whole = {path.name: path.read_bytes() for path in job.out.glob("right-*")}
    assert len(whole) == 15
    cut, flipped, map_of = (job.out / name for name in ("right-000001.png", "right-000002.png", "right-000003.tiff"))
    cut.write_bytes(cut.read_bytes()[:-100])
    flipped.write_bytes(flipped.read_bytes()[:-20] + b"x" + flipped.read_bytes()[-19:])
    map_of.write_bytes(b"")
    (job.out / "right-000004.json").unlink()
    finished = job.out / "finished.jsonl"
    lines = finished.read_text().splitlines(keepends=True)
    assert len(lines) == 16
    finished.write_text(
        "".join([lines[0], *lines[2:]]) + '{"file": "right-0000'
    )  # as of a killed run, and one line lost
    report = render(job)
    assert counts(report) == (5, 0)
    (sentence,) = report.warnings
    names = "right-000001.png, right-000002.png, right-000003.png"
    assert sentence == f"{job.out}: frames had changed since they were drawn, and were drawn again: {names}."
    assert {path.name: path.read_bytes() for path in job.out.glob("right-*")} == whole
    assert (counts(render(job)), render(job).warnings) == ((0, 5), [])


def test_a_second_job_in_the_same_folder_is_refused_at_once(options: RenderOptions) -> None:
    def second(items: Iterable[Any]) -> Iterator[Any]:
        with pytest.raises(
            BadInputError, match=rf"frames: render \(process {os.getpid()}\) is writing into this folder"
        ):
            demo(DemoOptions(out=options.out))
        yield from items

    assert counts(render(options, progress=PassedOn(second))) == (1, 0)
    assert not [path for path in options.out.iterdir() if path.name.startswith(".")]


@pytest.mark.parametrize(
    ("change", "sentence"),
    [
        ({"method": "raytrace", "maps": "pfm"}, "--maps is used with --method raster only"),
        ({"method": "raytrace", "materials": "gltf"}, "--materials is used with --method raster only"),
        ({"method": "raytrace", "resolution": 2.0}, "--resolution is used with --method raster only"),
        ({"method": "raytrace", "backend": "cpu"}, "--backend is used with --method raster only"),
        ({"supersample": 3}, "--supersample is used with --method raytrace only"),
        ({"shadows": True}, "--shadows is used with --method raytrace only"),
        ({"samples": 2}, "--samples is used with --method pathtrace only"),
        ({"bounces": 0}, "--bounces is used with --method pathtrace only"),
        ({"seed": 1}, "--seed is used with --method pathtrace only"),
        ({"method": "pathtrace", "shadows": True}, "--shadows is used with --method raytrace only"),
        ({"method": "pathtrace", "backend": "cpu"}, "--backend is used with --method raster only"),
        ({"headset": "a.json", "per_colour": True}, "a.json: is a model of one colour; give --red-model and --blue-m"),
        ({"red_model": Path("r.json")}, "--red-model is used with --blue-model only; leave it out, or give"),
        ({"blue_model": Path("b.json")}, "--blue-model is used with --red-model only; leave it out, or give"),
        ({"red_model": Path("r.json"), "blue_model": Path("b.json")}, "is a device, which is traced in all colours"),
        ({"frame_limit": 3}, "--frames is used with --head or --eye-track only"),
        ({"headset": "norhtstar"}, "Did you mean northstar"),
        ({"scene": "dosts"}, "Did you mean dots"),
        ({"eye": "both", "headset": "no_optics"}, "no left eye"),
        ({"materials": "gltf", "backend": "cpu"}, "glTF materials need OpenGL"),
        ({"maps": "tiff", "backend": "cpu"}, "--maps has no effect with --backend cpu"),
    ],
    ids=str,
)
def test_contradictions_and_unknown_names_are_refused_before_anything_is_written(
    options: RenderOptions, change: dict[str, Any], sentence: str
) -> None:
    with pytest.raises(BadInputError, match=sentence):
        render(replace(options, **change))
    assert not options.out.exists() or not list(options.out.iterdir())


def test_an_eye_that_the_model_does_not_hold_is_refused_with_the_remedy(
    options: RenderOptions, model_file: str
) -> None:
    with pytest.raises(
        BadInputError, match="is a model of the right eye; the left eye was asked for: calibrate it into"
    ):
        render(replace(options, headset=model_file, eye="both"))
    assert not options.out.exists()


def test_missing_opengl_leaves_nothing_behind(options: RenderOptions, monkeypatch: pytest.MonkeyPatch) -> None:
    def refuse(backend: object = "auto") -> NoReturn:
        raise MissingGlError("No OpenGL.")

    monkeypatch.setattr(gl, "open_context", refuse)
    with pytest.raises(MissingGlError):
        render(replace(options, backend="egl"))
    with pytest.raises(BadInputError, match="--maps needs OpenGL, because ray-traced frames have no warp map"):
        render(replace(options, backend="auto", maps="tiff"))
    assert not options.out.exists()


def test_path_traced_frames_resume_and_are_those_of_one_seed(
    mitsuba: ModuleType, options: RenderOptions, tmp_path: Path
) -> None:
    options = replace(options, method="pathtrace", samples=3, eye_track=None)
    render(options)
    first = pictures(options.out)
    assert counts(render(options)) == (0, 1)
    with pytest.raises(BadInputError, match="--seed was 0 and is 1"):
        render(replace(options, seed=1))
    changes: list[tuple[dict[str, Any], bool]] = [({}, True), ({"seed": 1}, False), ({"bounces": 0}, False)]
    for change, is_same in changes:
        render(replace(options, out=tmp_path / f"again{change}", **change))
        assert (pictures(tmp_path / f"again{change}") == first) == is_same


def test_missing_mitsuba_leaves_nothing_behind(options: RenderOptions, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "mitsuba", None)
    with pytest.raises(BadInputError, match=r"pip install 'mitsuba>="):
        render(replace(options, method="pathtrace"))
    assert not options.out.exists()


@pytest.mark.parametrize(("backend", "sentence"), [("cpu", "--backend cpu: frames are"), ("auto", "No OpenGL 4.1")])
def test_without_opengl_frames_are_ray_traced_and_the_report_says_so(
    options: RenderOptions, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, backend: Backend, sentence: str
) -> None:
    def refuse(backend: object = "auto") -> NoReturn:
        raise MissingGlError("No OpenGL.")

    monkeypatch.setattr(gl, "open_context", refuse)
    report = render(replace(options, backend=backend))
    assert [warning.startswith(sentence) and "ray traced" in warning for warning in report.warnings] == [True]
    traced = render(replace(options, method="raytrace", backend="auto", out=tmp_path / "traced"))
    assert not traced.warnings
    assert pictures(options.out) == pictures(tmp_path / "traced")


def test_a_pupil_outside_the_eye_box_is_held_marked_and_counted(options: RenderOptions, tmp_path: Path) -> None:
    # 20 mm/s enter the box, 10 mm wide, at 0.25 s and leave it after 0.75 s.
    track = moving_pupil(tmp_path / "eyes.txt", "right", [0.0, 1.0], np.array([-0.01, 0, 0]), step_m=(0.02, 0.0, 0.0))
    job = replace(options, eye_track=track, frames_per_second=10.0)
    report = render(job)
    assert counts(report) == (11, 0)
    frames = metadata(job.out)
    at_mm = [1e3 * frame["viewpoint_in_device_m"][0] for frame in frames]
    np.testing.assert_allclose(at_mm, [-5, -5, -5, -4, -2, 0, 2, 4, 4, 4, 4], atol=1e-9)
    assert [frame["held"] for frame in frames] == [True] * 3 + [False] * 5 + [True] * 3
    (sentence,) = report.warnings
    assert f"{track}: the right pupil is outside the eye box in 6 of 11 frames, first at 0.0000 s" in sentence


def test_frames_in_a_gap_of_a_track_are_held_marked_and_counted(options: RenderOptions, tmp_path: Path) -> None:
    times = [0.0, 0.1, 0.5, 0.6, 0.7]  # a blink of 0.4 s
    centre = open_eye(options.headset).eye_box.centre
    track = moving_pupil(tmp_path / "eyes.txt", "right", times, centre, step_m=(0.001, 0.0, 0.0))
    head = still_head(tmp_path / "head.tum", [0.0, 0.1, 0.2, 0.5, 0.6, 0.7])
    job = replace(options, head=head, eye_track=track, frames_per_second=10.0)
    report = render(job)
    frames = metadata(job.out)
    at_mm = [1e3 * (frame["viewpoint_in_device_m"][0] - centre[0]) for frame in frames]
    np.testing.assert_allclose(at_mm, [0, 0.1, 0.1, 0.1, 0.1, 0.5, 0.6, 0.7], atol=1e-9)
    assert [frame["held"] for frame in frames] == [False] * 2 + [True] * 3 + [False] * 3
    assert [frame["head_lost"] for frame in frames] == [False] * 3 + [True] * 2 + [False] * 3
    lost = "first at 0.2000 s", "first at 0.3000 s"
    assert [sentence.partition(";")[0] for sentence in report.warnings] == [
        f"{track}: the right pupil was not tracked or recorded in 3 of 8 frames, {lost[0]}, in gaps of up to 0.4 s",
        f"{head}: the head was not tracked or recorded in 2 of 8 frames, {lost[1]}, in gaps of up to 0.3 s",
    ]


def test_a_head_that_its_runtime_loses_is_marked_and_counted(options: RenderOptions, tmp_path: Path) -> None:
    """Not valid, valid but inferred, and not valid at either end; the frames show where the headset was."""
    flags = [0, 15, 15, 0, 15, 3, 15, 0, 0]
    recording = tmp_path / "head.jsonl"
    lines: list[dict[str, Any]] = [{"format": "wlr-openxr-recording", "version": 1}]
    for k, each in enumerate(flags):
        pose = {"orientation": {"x": 0, "y": 0, "z": 0, "w": 1}, "position": {"x": 0, "y": 30, "z": 0}}
        lines.append({"time": k * 10**8, "space": "view", "base_space": "stage", "locationFlags": each, "pose": pose})
    recording.write_text("".join(f"{json.dumps(each)}\n" for each in lines), encoding="utf-8")
    job = replace(options, head=recording, frames_per_second=10.0)
    warnings = render(job).warnings
    assert [frame["head_lost"] for frame in metadata(job.out)] == [False, False, True, False, True, False]
    lost = "first at 0.3000 s"
    assert [sentence.partition(";")[0] for sentence in warnings[:-1]] == [
        f"{recording}: 3 samples before 0.1000 s or after 0.6000 s are not valid",
        f"{recording}: the head was not tracked or recorded in 1 of 6 frames, {lost}, in gaps of up to 0.2 s",
        f"{recording}: the runtime did not track the head in 1 of 6 frames, first at 0.5000 s",
    ]
    assert "nothing of the scene" in warnings[-1]
    assert "The headset is at (0.00, 30.00, 0.00) m;" in warnings[-1]


def test_pupils_that_are_all_outside_the_eye_box_are_refused(options: RenderOptions, tmp_path: Path) -> None:
    track = moving_pupil(tmp_path / "eyes.txt", "right", [0.0, 1.0], np.array([0.006, 0.0, 0.0]))
    with pytest.raises(
        BadInputError, match=r"eyes\.txt at 0\.0000 s, right eye: the viewpoint \(6\.00, 0\.00, 0\.00\)"
    ):
        render(replace(options, eye_track=track, frames_per_second=10.0))
    assert not options.out.exists()


def test_tracks_that_do_not_overlap_are_refused(options: RenderOptions, tmp_path: Path) -> None:
    head = still_head(tmp_path / "head.tum", [0.0, 1.0])
    eyes = moving_pupil(tmp_path / "eyes.txt", "right", [2.0, 3.0], np.zeros(3))
    with pytest.raises(BadInputError, match=r"head\.tum and .*eyes\.txt do not overlap in time"):
        render(replace(options, head=head, eye_track=eyes))
    assert not options.out.exists()


def test_the_last_frame_is_not_rounded_beyond_the_track(options: RenderOptions, tmp_path: Path) -> None:
    # 0.1 + 1 / 20 is more than 0.15 by one bit.
    head = still_head(tmp_path / "head.tum", [0.1, 0.15])
    job = replace(options, head=head, frames_per_second=20.0)
    plan = planned_frames(motion_of(job), {"right": open_eye(options.headset)})
    assert [planned.time_s for planned in plan] == [0.1, 0.15]


@pytest.mark.parametrize("suffix", ["tiff", "pfm"])
def test_maps_lead_from_the_panel_into_the_intermediate_image(
    options: RenderOptions, suffix: Literal["tiff", "pfm"]
) -> None:
    assert counts(render(replace(options, maps=suffix))) == (1, 0)
    source = read_map(options.out / f"right-000000.{suffix}")
    assert source.shape == (36, 64, 3)
    assert source.dtype == np.float32
    # Without optics the map is affine in the pixel, and its third channel the inverse depth: ball and wall.
    across = np.diff(source[..., 0], axis=1)
    np.testing.assert_allclose(across, across.mean(), atol=1e-3)
    assert np.abs(np.diff(source[..., 0], axis=0)).max() < 1e-3
    np.testing.assert_allclose(source[0, 0, 2], 1 / 1.5, rtol=1e-4)
    assert source[..., 2].max() == pytest.approx(1 / 0.44, rel=1e-2)
    # With the file beside it the map says where in the world each pixel's point is: ball and wall, by hand.
    view = json.loads((options.out / "right-000000.json").read_text())
    tangents = (source[..., :2] - view["centre_px"]) / view["focal_px"] * [1, -1]
    in_camera = np.concatenate([tangents, -np.ones((36, 64, 1))], axis=-1) / source[..., 2:]
    world_from_camera = np.array(view["world_from_camera"])
    point = in_camera @ world_from_camera[:3, :3].T + world_from_camera[:3, 3]
    on_wall = source[..., 2] < 1
    np.testing.assert_allclose(point[on_wall][:, 2], point[on_wall][0, 2], atol=1e-4)
    np.testing.assert_allclose(view["position_in_device_m"], open_eye(options.headset).eye_box.centre, atol=1e-9)
    # A frame whose map, or the file beside it, is missing is drawn again.
    for lost in (f"right-000000.{suffix}", "right-000000.json"):
        (options.out / lost).unlink()
        assert counts(render(replace(options, maps=suffix))) == (1, 0)


def test_one_model_file_of_both_eyes_draws_both(options: RenderOptions, model_file: str, tmp_path: Path) -> None:
    right = load_eye_model(model_file)
    box = right.mappings.eye_box
    moved = replace(right.mappings, eye="left", eye_box=EyeBox(box.centre + [0.001, 0.002, 0.0], box.size))
    both = save_eye_models(tmp_path / "both.json", [right, replace(right, mappings=moved)])
    assert counts(render(replace(options, headset=str(both), eye="both"))) == (2, 0)
    frames = metadata(options.out)
    assert [frame["file_name"] for frame in frames] == ["left-000000.png", "right-000000.png"]
    left_viewpoint, right_viewpoint = (np.array(frame["viewpoint_in_device_m"]) for frame in frames)
    np.testing.assert_allclose(left_viewpoint - right_viewpoint, [0.001, 0.002, 0.0], atol=1e-12)
    assert len(set(pictures(options.out).values())) == 2


def test_a_head_trajectory_in_milliseconds_is_asked_about(options: RenderOptions, tmp_path: Path) -> None:
    times = np.arange(20) / 90
    job = replace(options, head=still_head(tmp_path / "head.tum", times), frame_limit=1)
    assert render(job).warnings == []
    head = still_head(tmp_path / "milliseconds.tum", 1e3 * times, turn_rate=5e-5)
    with pytest.raises(BadInputError, match=r"milliseconds\.tum: has a row every 11.1 s, .* times in milliseconds\?"):
        render(replace(job, head=head, out=tmp_path / "refused"))
    head = still_head(tmp_path / "gap.tum", np.append(times[:10], times[10:] + 11.0), turn_rate=5e-5)
    eyes = moving_pupil(tmp_path / "eyes.txt", "right", 10 * times, open_eye(options.headset).eye_box.centre)
    report = render(replace(job, head=head, eye_track=eyes, out=tmp_path / "slow"))
    (sentence,) = report.warnings
    assert sentence.startswith(f"{head}: neighbouring samples are up to 11 s apart")
    assert sentence.endswith("are the times in seconds?")
    assert sentence in (tmp_path / "slow" / "report.md").read_text()


def test_the_report_lists_frames_inputs_and_files(moving: RenderOptions) -> None:
    report = render(moving)
    assert report.tables[0].rows == [["right", 5, 0.1, 0.5]]
    written = ["finished.jsonl", "metadata.jsonl", "report.html", "report.md", "report.json"]
    assert list(report.files) == [moving.out / name for name in written]
    inputs = json.loads((moving.out / "report.json").read_text())["provenance"]["inputs"]
    assert [file["name"] for file in inputs] == [moving.headset, moving.scene, str(moving.head), str(moving.eye_track)]
    assert (moving.out / "report.html").read_text().count("data:image/png;base64,") == 1


def test_a_file_of_two_options_is_one_input(options: RenderOptions, straight_device: str) -> None:
    render(replace(options, method="raytrace", misalignment=straight_device))
    inputs = json.loads((options.out / "report.json").read_text())["provenance"]["inputs"]
    assert [file["name"] for file in inputs] == [options.headset, options.scene]


def test_one_frame_may_be_asked_for_without_a_trajectory(options: RenderOptions) -> None:
    report = render(replace(options, frame_limit=1))
    assert counts(report) == (1, 0)
    assert report.verdict.startswith("1 frame drawn, 0 kept from an earlier run: 1 PNG in ")


def test_the_verdict_counts_pictures_and_maps(options: RenderOptions, tmp_path: Path) -> None:
    job = replace(options, head=still_head(tmp_path / "head.tum", [0.0, 0.1]), frames_per_second=10.0, frame_limit=2)
    for change, counted in (
        ({"maps": "pfm"}, "2 PNG, 2 PFM"),
        ({"maps": "tiff", "eye": "both", "per_colour": True}, "2 of each eye, 4 PNG, 12 TIFF"),
    ):
        out = tmp_path / str(len(counted))
        assert render(replace(job, **change, out=out)).verdict.endswith(f": {counted} in {out}.")
        written = f"{len([*out.glob('*.png')])} PNG, {len([*out.glob('*.pfm'), *out.glob('*.tiff')])}"
        assert written in counted


def test_three_models_alike_draw_what_one_draws(options: RenderOptions, model_file: str, tmp_path: Path) -> None:
    one = replace(options, headset=model_file)
    three = replace(one, red_model=Path(model_file), blue_model=Path(model_file), out=tmp_path / "three")
    for job in (one, three):
        render(job)
    assert pictures(one.out) == pictures(three.out)


def test_a_video_shows_the_frames(options: RenderOptions, tmp_path: Path) -> None:
    head = still_head(tmp_path / "head.tum", [0.0, 0.2], turn_rate=0.3)
    job = replace(options, head=head, frames_per_second=10.0, video=True)
    try:
        report = render(job)
    except BadInputError as error:
        pytest.skip(str(error))
    import cv2

    reader = cv2.VideoCapture(str(options.out / "right.mp4"))
    assert options.out / "right.mp4" in report.files
    for number in range(3):
        there, frame = reader.read()
        assert there
        drawn = read_png(options.out / f"right-{number:06d}.png")
        assert np.abs(frame[..., ::-1].astype(int) - drawn).mean() < 8
    assert not reader.read()[0]


@pytest.mark.gl
@pytest.mark.usefixtures("gl_context")
def test_ray_traced_frames_agree_with_rasterised_ones_and_can_be_refined(
    options: RenderOptions, tmp_path: Path
) -> None:
    jobs = {
        "raster": replace(options, backend="auto"),
        "raytrace": replace(options, method="raytrace", backend="auto", out=tmp_path / "traced"),
        "fine": replace(options, method="raytrace", backend="auto", supersample=3, shadows=True, out=tmp_path / "fine"),
    }
    drawn = {}
    for name, job in jobs.items():
        render(job)
        drawn[name] = read_png(job.out / "right-000000.png").astype(int)
    difference = np.abs(drawn["raster"] - drawn["raytrace"])
    assert (np.median(difference), difference.mean() < 2) == (0, True)
    assert 0 < np.abs(drawn["fine"] - drawn["raytrace"]).mean() < 12
