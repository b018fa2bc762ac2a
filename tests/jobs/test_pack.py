"""Data sets from the frames of `render`, read back by their own libraries and without them."""

import hashlib
import json
import tarfile
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from jobs.test_render import metadata
from present import present

from wlr_render.errors import BadInputError
from wlr_render.jobs.render import render
from wlr_render.jobs.render_options import Layout, RenderOptions
from wlr_render.models.model_file import load_eye_model
from wlr_render.report.blocks import Report
from wlr_render.scene.image_files import read_png

KEYS = [f"{eye}-00000{number}" for number in (0, 1) for eye in ("left", "right")]


@pytest.fixture(scope="module")
def frames_of(
    tmp_path_factory: pytest.TempPathFactory, straight_device: str, scene_file: str
) -> Callable[..., RenderOptions]:
    """A function that draws two frames of each eye, with any layers, into a folder that nobody else has."""

    def draw(**others: Any) -> RenderOptions:
        folder = tmp_path_factory.mktemp("sequence")
        (folder / "head.tum").write_text("0 0 0 0 0 0 0 1\n0.1 0 0 0 0 0 0 1\n")
        given: dict[str, Any] = {
            "head": folder / "head.tum",
            "frames_per_second": 10.0,
            "eye": "both",
            "method": "raytrace",
        }
        options = RenderOptions(straight_device, scene_file, out=folder / "frames", **given, **others)
        render(options)
        return options

    return draw


@pytest.fixture
def labelled(frames_of: Callable[..., RenderOptions], straight_device: str) -> RenderOptions:
    pytest.importorskip("OpenEXR")
    return frames_of(layers=("depth", "instance"), misalignment=straight_device)


def packed(drawn: RenderOptions, layout: Layout, **size: Any) -> tuple[Report, Any]:
    """Pack frames that are drawn already; returns the report and the folder of the data set."""
    report = render(replace(drawn, pack=layout, **size))
    assert report.verdict.startswith("0 frames drawn")
    return report, drawn.out / layout


def members(path: Path) -> dict[Any, Any]:
    with tarfile.open(path) as shard:
        return {about.name: present(shard.extractfile(about)).read() for about in shard.getmembers()}


def test_shards_hold_each_frame_with_its_layers_and_metadata(labelled: RenderOptions) -> None:
    report, folder = packed(labelled, "webdataset", frames_per_shard=3)
    paths = [folder / f"frames-00000{number}.tar" for number in (0, 1)]
    assert set(paths) == set(folder.iterdir()) <= set(report.files)
    shards = [members(path) for path in paths]
    expected = [
        [f"{key}.{suffix}" for key in keys for suffix in ("exr", "json", "png")] for keys in (KEYS[:3], KEYS[3:])
    ]
    assert [list(shard) for shard in shards] == expected
    index = json.loads((labelled.out / "instances.json").read_text())
    frames = metadata(labelled.out)
    for number, key in enumerate(KEYS):
        shard = shards[number // 3]
        for suffix in ("exr", "png"):
            assert shard[f"{key}.{suffix}"] == (labelled.out / f"{key}.{suffix}").read_bytes()
        stated = json.loads(shard[f"{key}.json"])
        assert (stated["eye"], stated["index"], stated["key"]) == (key.split("-")[0], number // 2, key)
        assert {name: stated.get(name, key + ".png") for name in frames[number]} == frames[number]
        assert stated["misalignment"]["points"] > 0
        own = [each for each in index["annotations"] if each["image_id"] == number + 1]
        assert stated["objects"] == [
            {name: value for name, value in each.items() if name not in ("id", "image_id", "category_id")}
            for each in own
        ]
        assert {each["instance"] for each in stated["objects"]} == {"ball", "wall"}
    before = [path.read_bytes() for path in paths]
    packed(labelled, "webdataset", frames_per_shard=3)
    assert [path.read_bytes() for path in paths] == before


def test_an_image_folder_has_a_line_and_a_picture_for_each_frame(labelled: RenderOptions) -> None:
    folder = packed(labelled, "huggingface")[1] / "train"
    rows = [json.loads(line) for line in (folder / "metadata.jsonl").read_text().splitlines()]
    assert [row["file_name"] for row in rows] == [f"{key}.png" for key in KEYS]
    for row in rows:
        for name in (row["file_name"], row["layers"]):
            assert (folder / name).read_bytes() == (labelled.out / name).read_bytes()
        assert set(map(len, row["objects"].values())) == {2}
        assert row["objects"]["category"] == ["ball", "plane"]
    assert len(list(folder.iterdir())) == 9


@pytest.mark.parametrize("layout", ["webdataset", "huggingface"])
def test_a_data_set_names_its_sources_and_no_path_of_this_machine(
    model_file: str, scene_file: str, tmp_path: Path, layout: Layout
) -> None:
    """Who gets it can tell two headsets by their names and hashes."""
    render(RenderOptions(model_file, scene_file, method="raytrace", pack=layout, out=tmp_path / "secret"))
    folder = tmp_path / "secret" / layout
    if layout == "webdataset":
        stated = json.loads(members(folder / "frames-000000.tar")["right-000000.json"])
    else:
        stated = json.loads((folder / "train" / "metadata.jsonl").read_text())
    names = load_eye_model(model_file).mappings.name, Path(scene_file).stem
    for what, path, name in zip(("headset", "scene"), (model_file, scene_file), names, strict=True):
        assert stated[what] == name
        assert stated[f"{what}_sha256"] == hashlib.sha256(Path(path).read_bytes()).hexdigest()
    for file in folder.rglob("*"):
        if file.is_file():
            for place in (tmp_path, Path(model_file).parent, Path(scene_file).parent):
                assert str(place).encode() not in file.read_bytes(), file


def test_hugging_face_reads_the_image_folder(
    labelled: RenderOptions, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """pip install datasets."""
    monkeypatch.setenv("HF_HOME", str(tmp_path / "cache"))
    monkeypatch.setenv("HF_HUB_OFFLINE", "1")
    datasets = pytest.importorskip("datasets", reason="datasets is not installed: pip install datasets.")
    _, folder = packed(labelled, "huggingface")
    read = datasets.load_dataset("imagefolder", data_dir=str(folder), split="train", cache_dir=str(tmp_path / "cache"))
    assert read["key"][:] == KEYS
    for row in read:
        np.testing.assert_array_equal(np.asarray(row["image"]), read_png(labelled.out / f"{row['key']}.png"))
        assert np.shape(row["world_from_device"]) == (4, 4)
        assert row["objects"]["instance"] == ["ball", "wall"]
        assert row["misalignment"]["points"] > 100


def test_webdataset_reads_the_shards(labelled: RenderOptions) -> None:
    """pip install webdataset."""
    webdataset = pytest.importorskip("webdataset", reason="webdataset is not installed: pip install webdataset.")
    _, folder = packed(labelled, "webdataset", frames_per_shard=2)
    urls = [str(folder / f"frames-00000{number}.tar") for number in (0, 1)]
    samples = list(webdataset.WebDataset(urls, shardshuffle=False).decode("rgb8"))
    assert [sample["__key__"] for sample in samples] == KEYS
    for sample in samples:
        np.testing.assert_array_equal(sample["png"], read_png(labelled.out / f"{sample['__key__']}.png"))
        assert [each["instance"] for each in sample["json"]["objects"]] == ["ball", "wall"]
        assert sample["exr"] == (labelled.out / f"{sample['__key__']}.exr").read_bytes()


def test_frames_without_layers_are_packed_too(frames_of: Callable[..., RenderOptions]) -> None:
    drawn = frames_of()
    found = members(packed(drawn, "webdataset")[1] / "frames-000000.tar")
    assert list(found) == [f"{key}.{suffix}" for key in KEYS for suffix in ("json", "png")]
    assert "objects" not in json.loads(found["left-000000.json"])
    assert len(list((packed(drawn, "huggingface")[1] / "train").iterdir())) == 5


@pytest.mark.usefixtures("known_warp_grid")
def test_the_predicted_error_of_a_frame_is_packed_without_its_map(
    model_file: str, scene_file: str, tmp_path: Path
) -> None:
    drawn = RenderOptions(model_file, scene_file, method="raytrace", predicted_error=0.5, out=tmp_path / "frames")
    render(drawn)
    stated = metadata(drawn.out)[0]["predicted_error"]
    assert stated["rms_arcmin"] > 0
    found = members(packed(drawn, "webdataset")[1] / "frames-000000.tar")
    assert list(found) == ["right-000000.json", "right-000000.png"]
    packed_with = json.loads(found["right-000000.json"])
    assert packed_with["predicted_error"] == stated
    assert "misalignment" not in packed_with
    (row,) = (packed(drawn, "huggingface")[1] / "train" / "metadata.jsonl").read_text().splitlines()
    assert json.loads(row)["predicted_error"] == stated


@pytest.mark.parametrize("name", ["right-000001.png", "left-000001.exr", "left-000000-labels.json"])
def test_a_frame_that_is_not_as_it_was_drawn_is_drawn_again_and_packed(labelled: RenderOptions, name: str) -> None:
    path = labelled.out / name
    drawn = path.read_bytes()
    path.write_bytes(drawn[:-1] + b"x")
    report = render(replace(labelled, pack="huggingface"))
    assert report.verdict.startswith("1 frame drawn")
    assert path.read_bytes() == drawn


def test_what_a_killed_pack_left_is_no_part_of_the_data_set(frames_of: Callable[..., RenderOptions]) -> None:
    drawn = frames_of()
    left = drawn.out / ".wlr-part-pack"
    left.mkdir(parents=True)
    (left / "frames-000007.tar").touch()
    _, folder = packed(drawn, "webdataset")
    assert [path.name for path in folder.iterdir()] == ["frames-000000.tar"]
    assert not left.exists()


@pytest.mark.parametrize("fault", [OSError(28, "No space left on device"), KeyboardInterrupt()], ids=["disk", "ctrl-c"])
def test_a_pack_that_ends_while_it_is_moved_leaves_nothing(
    frames_of: Callable[..., RenderOptions], monkeypatch: pytest.MonkeyPatch, fault: KeyboardInterrupt | OSError
) -> None:
    drawn, before = frames_of(), Path.replace

    def replace_or_fail(path: Path, target: Path) -> Path:
        if target == drawn.out / "webdataset":
            raise fault
        return before(path, target)

    monkeypatch.setattr(Path, "replace", replace_or_fail)
    with pytest.raises(KeyboardInterrupt if isinstance(fault, KeyboardInterrupt) else BadInputError):
        packed(drawn, "webdataset")
    assert not (drawn.out / "webdataset").exists()
    assert not (drawn.out / ".wlr-part-pack").exists()
    monkeypatch.undo()
    packed(drawn, "webdataset")


def test_a_folder_of_other_files_is_not_replaced(frames_of: Callable[..., RenderOptions]) -> None:
    drawn = frames_of()
    mine = drawn.out / "huggingface" / "notes.txt"
    mine.parent.mkdir()
    mine.touch()
    with pytest.raises(BadInputError, match=r"notes\.txt: does not belong to the data set that would replace it"):
        packed(drawn, "huggingface")
    assert mine.is_file()
