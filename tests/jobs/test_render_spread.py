"""Frames that several processes draw are those that one draws."""

import contextlib
from collections.abc import Callable, Mapping
from dataclasses import replace
from functools import cached_property
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import pytest
from jobs.test_render import moving_wearer, pictures

from wlr_render.draw.painters import Painter
from wlr_render.errors import BadInputError
from wlr_render.jobs import frame_drawing
from wlr_render.jobs.frame_drawing import FrameBlock, FrameDrawing, OpenedFiles, draw_block
from wlr_render.jobs.frame_plan import motion_of, planned_frames
from wlr_render.jobs.render import render
from wlr_render.jobs.render_options import RenderOptions


@pytest.fixture
def moving(tmp_path: Path, straight_device: str, scene_file: str) -> RenderOptions:
    return moving_wearer(tmp_path, straight_device, scene_file)


def whole(folder: Path) -> dict[Any, Any]:
    """All files of a folder of frames but the report, which has a date."""
    listed = {path.name: path.read_bytes() for path in Path(folder).iterdir() if not path.name.startswith("report.")}
    return listed | {"finished.jsonl": sorted(listed["finished.jsonl"].splitlines())}


def opened_blocks(monkeypatch: pytest.MonkeyPatch) -> list[FrameBlock]:
    """Blocks whose files a worker has opened, in a list that grows."""
    opened: list[FrameBlock] = []
    before = frame_drawing._open

    def counted(block: FrameBlock) -> tuple[FrameDrawing, contextlib.ExitStack]:
        opened.append(block)
        return before(block)

    monkeypatch.setattr(frame_drawing, "_open", counted)
    return opened


def block_of(options: RenderOptions) -> FrameBlock:
    opened = OpenedFiles.of(options)
    plan = planned_frames(motion_of(options), opened.middle())
    return FrameDrawing(options, opened, None).block(plan[:1])


@pytest.mark.slow
@pytest.mark.parametrize("way", [{"method": "raster"}, {"method": "raytrace", "predicted_error": 0.5}], ids=str)
def test_frames_are_the_same_to_the_last_bit_whatever_the_number_of_workers(
    moving: RenderOptions, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, way: Mapping[str, Any]
) -> None:
    """And so are the predicted errors of frames."""
    monkeypatch.setattr(frame_drawing, "_BLOCKS", 2)
    options = replace(moving, **way)
    here = render(options).record
    assert len(set(pictures(options.out).values())) == 5
    report = render(replace(options, workers=2, out=tmp_path / "spread"))
    assert report.record["frames_drawn"] == 5
    assert report.record.get("predicted_error") == here.get("predicted_error")
    assert ("predicted_error" in here) == ("predicted_error" in way)
    assert whole(tmp_path / "spread") == whole(options.out)
    (tmp_path / "spread" / "right-000003.png").unlink()
    assert render(replace(options, out=tmp_path / "spread")).record["frames_drawn"] == 1
    assert pictures(tmp_path / "spread") == pictures(options.out)


@pytest.mark.slow
def test_the_process_of_the_job_opens_what_draws_only_if_it_draws(
    moving: RenderOptions, monkeypatch: pytest.MonkeyPatch
) -> None:
    made = []
    before: Callable[[FrameDrawing], Mapping[str, Painter]] = vars(FrameDrawing)["_painters"].func

    def counted(drawing: FrameDrawing) -> Mapping[str, Painter]:
        made.append(drawing)
        return before(drawing)

    painters = cached_property(counted)
    painters.__set_name__(frame_drawing.FrameDrawing, "_painters")
    monkeypatch.setattr(frame_drawing.FrameDrawing, "_painters", painters)
    options = replace(moving, method="raytrace")
    render(replace(options, workers=1, out=moving.out.with_name("spread")))
    assert not made
    render(options)
    assert len(made) == 1


def test_a_worker_that_reads_another_file_is_refused(moving: RenderOptions) -> None:
    options = replace(moving, method="raytrace")
    block = block_of(options)
    exchanged = dict(zip(block.inputs, reversed(list(block.inputs.values())), strict=True))
    for inputs in ({path: "0" * 64 for path in block.inputs}, exchanged, {**block.inputs, "more.obj": "0"}):
        with pytest.raises(BadInputError, match=r"the worker on .* reads another file than the machine that started"):
            draw_block(replace(block, inputs=inputs))
    draw_block(replace(block, inputs={f"elsewhere/{path}": sha256 for path, sha256 in block.inputs.items()}))
    with pytest.raises(BadInputError, match=r"lacks OpenGL, and the machine that started the job has it"):
        draw_block(replace(block, has_opengl=True))


def test_a_worker_releases_the_opengl_that_it_refuses(moving: RenderOptions, monkeypatch: pytest.MonkeyPatch) -> None:
    released = []
    raster = SimpleNamespace(context=SimpleNamespace(release=lambda: released.append(True)))
    monkeypatch.setattr(frame_drawing, "open_raster", lambda *_: raster)
    with pytest.raises(BadInputError, match="has OpenGL, and the machine that started the job lacks it"):
        draw_block(block_of(moving))
    assert released == [True]


def test_a_worker_keeps_what_it_has_opened_for_the_frames_of_one_job(
    moving: RenderOptions, monkeypatch: pytest.MonkeyPatch
) -> None:
    opened = opened_blocks(monkeypatch)
    moving.out.mkdir()
    block = block_of(replace(moving, method="raytrace"))
    draw_block(block)
    draw_block(block)
    assert len(opened) == 1
    draw_block(replace(block, options=replace(block.options, supersample=3)))
    draw_block(block)
    assert len(opened) == 3
    elsewhere = replace(block.options, head=None, eye_track=None, out=moving.out.with_name("elsewhere"))
    draw_block(replace(block, options=elsewhere))
    assert len(opened) == 3
    assert pictures(elsewhere.out) == pictures(moving.out)


def test_a_worker_opens_the_models_of_the_colours_again_when_they_are_exchanged(
    moving: RenderOptions, model_file: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    opened = opened_blocks(monkeypatch)
    moving.out.mkdir()
    other = moving.out / "other.json"
    other.write_text(Path(model_file).read_text().replace('"fitted"', '"other"'))
    colours: dict[str, Any] = {"headset": model_file, "red_model": Path(model_file), "blue_model": other}
    options = replace(moving, **colours, method="raytrace", eye_track=None)
    for each in (options, options, replace(options, red_model=other, blue_model=Path(model_file))):
        draw_block(block_of(each))
    assert len(opened) == 2
