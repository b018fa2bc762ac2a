"""Data sets from the frames of `render`, read back by their own libraries and without them."""

import hashlib
import json
import tarfile
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from wlr_render.errors import BadInputError
from wlr_render.finished_files import FinishedFiles
from wlr_render.jobs.pack import PackOptions, pack
from wlr_render.jobs.render import RenderOptions, render
from wlr_render.models.model_file import load_eye_model
from wlr_render.rendering.image_files import read_png

KEYS = [f"{eye}-00000{number}" for number in (0, 1) for eye in ("left", "right")]


@pytest.fixture(scope="module")
def frames_of(tmp_path_factory, straight_device, scene_file):
    """A function that draws two frames of each eye, with any layers, into a folder that nobody else has."""

    def draw(**others):
        folder = tmp_path_factory.mktemp("sequence")
        (folder / "head.tum").write_text("0 0 0 0 0 0 0 1\n0.1 0 0 0 0 0 0 1\n")
        given = {"head": folder / "head.tum", "frames_per_second": 10.0, "eye": "both", "method": "raytrace"}
        options = RenderOptions(straight_device, scene_file, out=folder / "frames", **given, **others)
        render(options)
        return options

    return draw


@pytest.fixture
def labelled(frames_of, straight_device):
    pytest.importorskip("OpenEXR")
    return frames_of(layers=("depth", "instance"), misalignment=straight_device)


def members(path):
    with tarfile.open(path) as shard:
        return {about.name: shard.extractfile(about).read() for about in shard.getmembers()}


def test_shards_hold_each_frame_with_its_layers_and_metadata(labelled, tmp_path):
    options = PackOptions("webdataset", labelled.out, frames_per_shard=3, out=tmp_path / "set")
    report = pack(options)
    assert report.verdict == "4 frames in 2 tar files, for webdataset."
    shards = [members(options.out / f"frames-00000{number}.tar") for number in (0, 1)]
    expected = [
        [f"{key}.{suffix}" for key in keys for suffix in ("exr", "json", "png")] for keys in (KEYS[:3], KEYS[3:])
    ]
    assert [list(shard) for shard in shards] == expected
    index = json.loads((labelled.out / "instances.json").read_text())
    record = json.loads((labelled.out / "sequence.json").read_text())
    misalignment = json.loads((labelled.out / "misalignment.json").read_text())["frames"]
    for number, key in enumerate(KEYS):
        shard = shards[number // 3]
        for suffix in ("exr", "png"):
            assert shard[f"{key}.{suffix}"] == (labelled.out / f"{key}.{suffix}").read_bytes()
        stated = json.loads(shard[f"{key}.json"])
        assert (stated["eye"], stated["index"], stated["key"]) == (key.split("-")[0], number // 2, key)
        drawn = record["frames"][number]
        assert all(stated[name] == drawn[name] for name in ("time_s", "viewpoint_in_device_m", "world_from_device"))
        assert stated["misalignment"].items() <= misalignment[number].items()
        own = [each for each in index["annotations"] if each["image_id"] == number + 1]
        assert stated["objects"] == [
            {name: value for name, value in each.items() if name not in ("id", "image_id", "category_id")}
            for each in own
        ]
        assert {each["instance"] for each in stated["objects"]} == {"ball", "wall"}
    again = replace(options, out=tmp_path / "again")
    pack(again)
    for name in ("frames-000000.tar", "frames-000001.tar"):
        assert (again.out / name).read_bytes() == (options.out / name).read_bytes()


def test_an_image_folder_has_a_line_and_a_picture_for_each_frame(labelled, tmp_path):
    options = PackOptions("huggingface", labelled.out, out=tmp_path / "set")
    pack(options)
    folder = options.out / "train"
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
    model_file, scene_file, tmp_path, monkeypatch, layout
):
    """Who gets it can tell two headsets by their names and hashes."""
    options = PackOptions(layout, tmp_path / "secret" / "frames", out=tmp_path / "secret" / "set")
    render(RenderOptions(model_file, scene_file, method="raytrace", out=options.folder))
    arguments = ["/home/me/wlr-render", "pack", layout, str(options.folder), f"--out={options.out}/"]
    arguments += ["C:\\Users\\me\\frames", "--out=C:\\Users\\me\\out\\"]
    monkeypatch.setattr("sys.argv", arguments)
    pack(options)
    if layout == "webdataset":
        stated = json.loads(members(options.out / "frames-000000.tar")["right-000000.json"])
    else:
        stated = json.loads((options.out / "train" / "metadata.jsonl").read_text())
    names = load_eye_model(model_file).mappings.name, Path(scene_file).stem
    for what, path, name in zip(("headset", "scene"), (model_file, scene_file), names, strict=True):
        assert stated[what] == name
        assert stated[f"{what}_sha256"] == hashlib.sha256(Path(path).read_bytes()).hexdigest()
    for path in options.out.rglob("*"):
        if path.is_file():
            for folder in (tmp_path, Path(model_file).parent, Path(scene_file).parent):
                assert str(folder).encode() not in path.read_bytes(), path
    command = json.loads((options.out / "report.json").read_text())["provenance"]["command"]
    assert command == f"wlr-render pack {layout} frames --out=set frames --out=out"


@pytest.mark.parametrize("folder", ["/home/me/headsets/", "C:\\Users\\me\\headsets\\"])
def test_frames_of_the_last_version_are_packed_by_the_names_of_their_files(folder, frames_of, tmp_path):
    """Its record of a sequence has no names."""
    drawn = frames_of()
    path = drawn.out / "sequence.json"
    record = json.loads(path.read_text())
    del record["names"]
    record["job"]["headset"] = f"{folder}north.toml"
    path.write_text(json.dumps(record))
    pack(PackOptions("huggingface", drawn.out, out=tmp_path / "set"))
    row = json.loads((tmp_path / "set" / "train" / "metadata.jsonl").read_text().splitlines()[0])
    assert row["headset"] == "north.toml"


def test_hugging_face_reads_the_image_folder(labelled, tmp_path, monkeypatch):
    """pip install datasets."""
    monkeypatch.setenv("HF_HOME", str(tmp_path / "cache"))
    monkeypatch.setenv("HF_HUB_OFFLINE", "1")
    datasets = pytest.importorskip("datasets", reason="datasets is not installed: pip install datasets.")
    options = PackOptions("huggingface", labelled.out, out=tmp_path / "set")
    pack(options)
    read = datasets.load_dataset(
        "imagefolder", data_dir=str(options.out), split="train", cache_dir=str(tmp_path / "cache")
    )
    assert read["key"][:] == KEYS
    for row in read:
        np.testing.assert_array_equal(np.asarray(row["image"]), read_png(labelled.out / f"{row['key']}.png"))
        assert np.shape(row["world_from_device"]) == (4, 4)
        assert row["objects"]["instance"] == ["ball", "wall"]
        assert row["misalignment"]["points"] > 100


def test_webdataset_reads_the_shards(labelled, tmp_path):
    """pip install webdataset."""
    webdataset = pytest.importorskip("webdataset", reason="webdataset is not installed: pip install webdataset.")
    options = PackOptions("webdataset", labelled.out, frames_per_shard=2, out=tmp_path / "set")
    pack(options)
    urls = [str(options.out / f"frames-00000{number}.tar") for number in (0, 1)]
    samples = list(webdataset.WebDataset(urls, shardshuffle=False).decode("rgb8"))
    assert [sample["__key__"] for sample in samples] == KEYS
    for sample in samples:
        np.testing.assert_array_equal(sample["png"], read_png(labelled.out / f"{sample['__key__']}.png"))
        assert [each["instance"] for each in sample["json"]["objects"]] == ["ball", "wall"]
        assert sample["exr"] == (labelled.out / f"{sample['__key__']}.exr").read_bytes()


def test_frames_without_layers_are_packed_too(frames_of, tmp_path):
    drawn = frames_of()
    report = pack(PackOptions("webdataset", drawn.out, out=tmp_path / "tar"))
    assert report.verdict == "4 frames in 1 tar file, for webdataset."
    found = members(tmp_path / "tar" / "frames-000000.tar")
    assert list(found) == [f"{key}.{suffix}" for key in KEYS for suffix in ("json", "png")]
    assert "objects" not in json.loads(found["left-000000.json"])
    pack(PackOptions("huggingface", drawn.out, out=tmp_path / "folder"))
    assert len(list((tmp_path / "folder" / "train").iterdir())) == 5


def test_one_frame_is_counted_as_one(straight_device, scene_file, tmp_path):
    render(RenderOptions(straight_device, scene_file, method="raytrace", out=tmp_path / "frames"))
    report = pack(PackOptions("webdataset", tmp_path / "frames", out=tmp_path / "set"))
    assert report.verdict == "1 frame in 1 tar file, for webdataset."


def test_the_predicted_error_of_a_frame_is_packed_without_its_map(model_file, scene_file, tmp_path):
    drawn = RenderOptions(model_file, scene_file, method="raytrace", predicted_error=0.5, out=tmp_path / "frames")
    render(drawn)
    stated = json.loads((drawn.out / "right-000000-labels.json").read_text())["predicted_error"]
    assert stated["rms_arcmin"] > 0
    pack(PackOptions("webdataset", drawn.out, out=tmp_path / "tar"))
    found = members(tmp_path / "tar" / "frames-000000.tar")
    assert list(found) == ["right-000000.json", "right-000000.png"]
    metadata = json.loads(found["right-000000.json"])
    assert metadata["predicted_error"] == stated
    assert "misalignment" not in metadata
    pack(PackOptions("huggingface", drawn.out, out=tmp_path / "folder"))
    (row,) = (tmp_path / "folder" / "train" / "metadata.jsonl").read_text().splitlines()
    assert json.loads(row)["predicted_error"] == stated
    (drawn.out / "right-000000-labels.json").write_text("{}")
    with pytest.raises(BadInputError, match=r"right-000000-labels\.json: is missing, or is not as it was drawn"):
        pack(PackOptions("webdataset", drawn.out, out=tmp_path / "again"))


@pytest.mark.parametrize("layout", ["webdataset", "huggingface"])
@pytest.mark.parametrize("name", ["right-000001.png", "left-000001.exr", "left-000000-labels.json"])
def test_a_frame_that_is_not_as_it_was_drawn_is_refused(labelled, tmp_path, layout, name):
    path = labelled.out / name
    path.write_bytes(path.read_bytes()[:-1] + b"x")
    size = {"frames_per_shard": 1} if layout == "webdataset" else {}
    with pytest.raises(BadInputError, match=rf"{name}: is missing, or is not as it was drawn; draw it again"):
        pack(PackOptions(layout, labelled.out, out=tmp_path / "set", **size))
    assert not (tmp_path / "set").exists()
    render(labelled)
    pack(PackOptions(layout, labelled.out, out=tmp_path / "mended"))


def test_what_a_killed_pack_left_is_no_part_of_the_data_set(frames_of, tmp_path):
    drawn = frames_of()
    left = tmp_path / "set" / ".wlr-part-pack"
    left.mkdir(parents=True)
    (left / "frames-000007.tar").touch()
    pack(PackOptions("webdataset", drawn.out, out=tmp_path / "set"))
    reports = {f"report.{kind}" for kind in ("html", "json", "md")}
    assert {path.name for path in (tmp_path / "set").iterdir()} == {"frames-000000.tar", *reports}


@pytest.mark.parametrize("fault", [OSError(28, "No space left on device"), KeyboardInterrupt()], ids=["disk", "ctrl-c"])
def test_a_pack_that_ends_while_it_is_moved_leaves_nothing(frames_of, tmp_path, monkeypatch, fault):
    drawn, out, before = frames_of(), tmp_path / "set", Path.replace

    def replace_or_fail(path, target):
        if target == out / "frames-000001.tar":
            raise fault
        return before(path, target)

    options = PackOptions("webdataset", drawn.out, frames_per_shard=1, out=out)
    monkeypatch.setattr(Path, "replace", replace_or_fail)
    with pytest.raises(KeyboardInterrupt if isinstance(fault, KeyboardInterrupt) else BadInputError):
        pack(options)
    assert not out.exists()
    monkeypatch.undo()
    pack(options)


@pytest.mark.parametrize("kind", ["misalignment", "annotations"])
def test_labels_that_lack_what_the_record_says_are_refused(labelled, tmp_path, kind):
    path = labelled.out / "left-000000-labels.json"
    labels = json.loads(path.read_text())
    del labels[kind]
    path.write_text(json.dumps(labels))
    FinishedFiles(labelled.out).add([path])
    for job in (pack, render):
        options = PackOptions("webdataset", labelled.out, out=tmp_path / "set") if job is pack else labelled
        with pytest.raises(BadInputError, match=rf"left-000000-labels\.json: '{kind}' is None, which no frame of"):
            job(options)


def test_a_folder_with_a_data_set_is_left_as_it_is(frames_of, tmp_path):
    drawn = frames_of()
    for layout in ("webdataset", "huggingface"):
        options = PackOptions(layout, drawn.out, out=tmp_path / layout)
        pack(options)
        with pytest.raises(BadInputError, match="holds a data set already; choose another folder or empty it"):
            pack(options)


@pytest.mark.parametrize(
    ("change", "complaint"),
    [
        (lambda record: record.clear(), "key 'format' is missing"),
        (lambda record: record["frames"][1].update(file="../../etc/passwd"), "which is no frame of `render`"),
        (lambda record: record["frames"][1].update(time_s="soon"), "'time_s' must be a number"),
        (lambda record: record.update(frames=3), "'frames' must be an array of tables"),
    ],
)
def test_a_record_that_is_none_is_refused(frames_of, tmp_path, change, complaint):
    drawn = frames_of()
    path = drawn.out / "sequence.json"
    record = json.loads(path.read_text())
    change(record)
    path.write_text(json.dumps(record))
    with pytest.raises(BadInputError, match=complaint):
        pack(PackOptions("webdataset", drawn.out, out=tmp_path / "set"))


def test_a_folder_without_frames_is_refused(tmp_path):
    with pytest.raises(BadInputError, match=r"sequence\.json"):
        pack(PackOptions("webdataset", tmp_path, out=tmp_path / "set"))
