"""Layers and labels of `render`: the files beside the frames, the index of instances, misalignment, videos."""

import json
import sys
from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path
from types import ModuleType, SimpleNamespace
from typing import Any

import cv2
import numpy as np
import pytest
from jobs.test_render import metadata
from numpy.typing import NDArray
from present import present
from small_headsets import changed_device

from wlr_render.draw.frame_layers import INSTANCE, LAYERS
from wlr_render.draw.painters import TracedPainter
from wlr_render.draw.ray_tracing import RayRenderer
from wlr_render.errors import BadInputError
from wlr_render.evaluation.misalignment import misalignment_arcmin
from wlr_render.extras import MissingExtraError
from wlr_render.geometry import transforms
from wlr_render.jobs.frame_labels import instance_annotations, read_labels, write_labels
from wlr_render.jobs.headset import open_eye
from wlr_render.jobs.render import render
from wlr_render.jobs.render_options import RenderOptions
from wlr_render.mappings import Eye
from wlr_render.report.blocks import Plot
from wlr_render.scene.exr_file import read_exr
from wlr_render.scene.image_files import read_png, write_video
from wlr_render.scene.scene_file import load_scene
from wlr_render.tracking.trajectory import EYES

BALL, WALL = 1, 2
TWO_FRAMES = "".join(f"{time} 0.0 0.0 0.0 0.0 {time / 20} 0.0 {(1 - time**2 / 400) ** 0.5}\n" for time in (0.0, 0.1))


@pytest.fixture
def exr() -> ModuleType:
    library: ModuleType = pytest.importorskip("OpenEXR")
    return library


@pytest.fixture
def labelled(tmp_path: Path, straight_device: str, scene_file: str, exr: object) -> RenderOptions:
    """Two frames of each eye with all layers, ray traced."""
    head = tmp_path / "head.tum"
    head.write_text(TWO_FRAMES)
    return RenderOptions(
        straight_device,
        scene_file,
        eye="both",
        head=head,
        frames_per_second=10.0,
        method="raytrace",
        layers=LAYERS,
        out=tmp_path / "frames",
    )


def decoded(segmentation: Mapping[str, Any]) -> NDArray[Any]:
    """Mask of COCO's run lengths."""
    height, width = segmentation["size"]
    value = np.arange(len(segmentation["counts"])) % 2
    return np.repeat(value, segmentation["counts"]).reshape(width, height).T.astype(bool)


def content(folder: Path) -> dict[Any, Any]:
    return {path.name: path.read_bytes() for path in sorted(folder.iterdir()) if path.name != "finished.jsonl"}


@pytest.mark.parametrize("shape", [(1, 1), (5, 7), (40, 30)])
@pytest.mark.parametrize("kinds", [1, 2, 5])
def test_masks_boxes_and_areas_are_those_of_the_picture(shape: tuple[int, int], kinds: int) -> None:
    instance = np.random.default_rng(kinds).integers(0, kinds + 1, shape).astype(np.uint32)
    instance[: shape[0] // 2, shape[1] // 2 :] = kinds
    found = instance_annotations(instance)
    assert [each["instance_id"] for each in found] == [number for number in np.unique(instance) if number]
    for each in found:
        mask = decoded(each["segmentation"])
        np.testing.assert_array_equal(mask, instance == each["instance_id"])
        rows, columns = np.nonzero(mask)
        low = columns.min(), rows.min()
        assert each["bbox"] == [*low, np.ptp(columns) + 1, np.ptp(rows) + 1]
        assert each["area"] == mask.sum()
    assert instance_annotations(np.zeros(shape, np.uint32)) == []


def test_layers_and_index_say_the_same_and_name_what_the_scene_has(labelled: RenderOptions) -> None:
    render(labelled)
    index = json.loads((labelled.out / "instances.json").read_text())
    assert [(each["id"], each["name"]) for each in index["instances"]] == [(BALL, "ball"), (WALL, "wall")]
    kinds = {each["id"]: each["name"] for each in index["categories"]}
    assert [kinds[each["category_id"]] for each in index["instances"]] == ["ball", "plane"]
    assert [each["file_name"] for each in index["images"]] == [
        f"{eye}-00000{number}.png" for number in (0, 1) for eye in ("left", "right")
    ]
    assert [each["id"] for each in index["annotations"]] == list(range(1, len(index["annotations"]) + 1))
    for image in index["images"]:
        channels, texts = read_exr(labelled.out / image["file_name"].replace(".png", ".exr"))
        colour = read_png(labelled.out / image["file_name"])
        own = [each for each in index["annotations"] if each["image_id"] == image["id"]]
        assert {each["instance_id"] for each in own} == set(np.unique(channels[INSTANCE])) - {0} == {BALL, WALL}
        for each in own:
            np.testing.assert_array_equal(decoded(each["segmentation"]), channels[INSTANCE] == each["instance_id"])
        background = (
            (colour == colour[channels[INSTANCE] == 0][:1]).all(axis=-1) if (channels[INSTANCE] == 0).any() else 0
        )
        np.testing.assert_array_equal(background, channels[INSTANCE] == 0)
        assert channels[INSTANCE].dtype == np.uint32
        assert colour.shape[:2] == channels["depth.Z"].shape == (image["height"], image["width"])
        assert json.loads(texts["world_from_device"])[3] == [0, 0, 0, 1]
        assert (texts["eye"], texts["depth"].split(":")[0]) == (image["file_name"].split("-")[0], "Z")


def test_coco_tools_read_the_index(labelled: RenderOptions, capsys: pytest.CaptureFixture[str]) -> None:
    """pip install pycocotools."""
    coco = pytest.importorskip("pycocotools.coco", reason="pycocotools is not installed: pip install pycocotools.")
    masks = pytest.importorskip("pycocotools.mask")
    render(labelled)
    index = coco.COCO(str(labelled.out / "instances.json"))
    capsys.readouterr()
    assert len(index.getImgIds()) == 4
    for annotation in index.loadAnns(index.getAnnIds()):
        mask = index.annToMask(annotation)
        np.testing.assert_array_equal(mask.astype(bool), decoded(annotation["segmentation"]))
        encoded = index.annToRLE(annotation)
        assert masks.area(encoded) == annotation["area"]
        np.testing.assert_array_equal(masks.toBbox(encoded), annotation["bbox"])


def test_supersampling_changes_colours_and_no_layer(labelled: RenderOptions) -> None:
    render(labelled)
    fine = replace(labelled, supersample=3, out=labelled.out.with_name("fine"))
    render(fine)
    for stem in ("left-000000", "right-000001"):
        once, thrice = (read_exr(each.out / f"{stem}.exr")[0] for each in (labelled, fine))
        for name in once:
            np.testing.assert_array_equal(once[name], thrice[name])
        assert set(np.unique(thrice[INSTANCE])) <= {0, BALL, WALL}
        colours = [read_png(each.out / f"{stem}.png") for each in (labelled, fine)]
        assert (colours[0] != colours[1]).any()


@pytest.mark.gl
@pytest.mark.usefixtures("gl_context")
def test_rastered_frames_have_the_layers_of_ray_traced_ones(labelled: RenderOptions) -> None:
    render(labelled)
    drawn = replace(labelled, method="raster", out=labelled.out.with_name("drawn"))
    render(drawn)
    for stem in ("left-000000", "right-000001"):
        raster, traced = (read_exr(each.out / f"{stem}.exr")[0] for each in (drawn, labelled))
        same = raster[INSTANCE] == traced[INSTANCE]
        assert same.mean() > 0.999
        for name in traced:
            assert np.abs(raster[name].astype(float) - traced[name])[same].max() < 1e-3, name


def test_a_run_that_is_resumed_ends_up_with_the_same_files(labelled: RenderOptions, tmp_path: Path) -> None:
    job = replace(labelled, misalignment=labelled.headset)
    render(job)
    whole = content(job.out)
    assert len([name for name in whole if name.startswith(("left-", "right-"))]) == 12
    again = replace(job, out=tmp_path / "again")
    render(replace(again, frame_limit=1))
    assert len(json.loads((again.out / "instances.json").read_text())["images"]) == 2
    assert render(again).record["frames_drawn"] == 2
    (again.out / "left-000000.exr").write_bytes(b"cut")
    (again.out / "right-000001-labels.json").unlink()
    assert render(again).record["frames_drawn"] == 2
    reports = ("report.html", "report.md", "report.json")
    resumed = content(again.out)
    assert {name: resumed[name] for name in whole if name not in reports} == {
        name: whole[name] for name in whole if name not in reports
    }
    with pytest.raises(BadInputError, match=r"--layers was \[.*\] and is \['depth'\];"):
        render(replace(job, layers=("depth",)))
    with pytest.raises(BadInputError, match=r"--misalignment was .* and is None;"):
        render(labelled)
    assert render(replace(job, layers=LAYERS[::-1])).record["frames_drawn"] == 0


def test_the_page_of_frames_reads_layers_as_it_says(labelled: RenderOptions) -> None:
    """The example in docs/frames.md."""
    render(replace(labelled, eye="right"))
    page = (Path(__file__).resolve().parents[2] / "docs" / "frames.md").read_text(encoding="utf-8")
    (code,) = (part.split("```")[0] for part in page.split("```python\n")[1:])
    path = labelled.out / "right-000000.exr"
    found: dict[str, Any] = {}
    exec(code.replace("out/set/right-000000.exr", str(path)), found)
    channels, _ = read_exr(path)
    np.testing.assert_array_equal(found["albedo"], np.stack([channels[f"albedo.{each}"] for each in "RGB"], axis=-1))
    np.testing.assert_array_equal(found["depth_m"], channels["depth.Z"])
    np.testing.assert_array_equal(found["position_m"][..., 1], channels["position.Y"])


@pytest.mark.parametrize("method", ["raytrace", pytest.param("raster", marks=pytest.mark.gl)])
def test_misalignment_of_each_frame_is_that_of_what_it_shows(
    tmp_path: Path,
    model_file: str,
    small_panel_model: Eye,
    scene_file: str,
    method: str,
    request: pytest.FixtureRequest,
) -> None:
    if method == "raster":
        request.getfixturevalue("gl_context")
    device = changed_device(tmp_path, "northstar", ("[1440, 1600]", "[90, 100]"))
    pose = transforms.rigid(transforms.rotation_about("y", 0.1), np.array([0.02, 0.01, 0.03]))
    head = tmp_path / "head.tum"
    head.write_text("".join(f"{time} 0.02 0.01 0.03 0.0 {np.sin(0.05)} 0.0 {np.cos(0.05)}\n" for time in (0.0, 1.0)))
    given: dict[str, Any] = {"head": head, "frame_limit": 1, "method": method, "misalignment": device}
    options = RenderOptions(model_file, scene_file, out=tmp_path / "frames", **given)
    report = render(options)
    (frame,) = metadata(options.out)
    found = frame["misalignment"]
    assert (frame["file_name"], frame["eye"], frame["time_s"]) == ("right-000000.png", "right", 0.0)
    truth, model = open_eye(device), open_eye(model_file)
    viewpoint = model.eye_box.centre
    assert frame["viewpoint_in_device_m"] == viewpoint.tolist()
    painter = TracedPainter(model, RayRenderer(load_scene(scene_file)))
    world_point = present(painter.paint(viewpoint, pose, with_geometry=True).position).astype(float)
    point = transforms.apply(transforms.inverse(pose), world_point)
    shown = np.isfinite(point[..., 0])
    error = misalignment_arcmin(truth, viewpoint, truth.display.panel.pixel_centres()[shown], point[shown])
    share = 0.02 if method == "raytrace" else 0.1
    assert found["median_arcmin"] == pytest.approx(np.nanmedian(error), rel=share)
    assert found["rms_arcmin"] == pytest.approx(np.sqrt(np.nanmean(error**2)), rel=share)
    assert 0.001 < found["median_arcmin"] < found["p95_arcmin"] <= found["max_arcmin"] < 2
    assert found["points"] > 3000
    assert report.tables[0].rows[0][4:] == [found[name] for name in ("median_arcmin", "p95_arcmin", "max_arcmin")]


def test_the_report_plots_misalignment_over_time(labelled: RenderOptions) -> None:
    report = render(replace(labelled, layers=(), misalignment=labelled.headset))
    (plot,) = (block for block in report.blocks if isinstance(block, Plot))
    frames = metadata(labelled.out)
    assert [line["name"] for line in plot.data] == [f"{eye} eye, {name}" for eye in EYES for name in ("median", "95 %")]
    for number, eye in enumerate(EYES):
        own = [frame for frame in frames if frame["eye"] == eye]
        for line, key in zip(plot.data[2 * number :], ("median_arcmin", "p95_arcmin"), strict=False):
            assert line["x"] == [frame["time_s"] for frame in own]
            assert line["y"] == pytest.approx([frame["misalignment"][key] for frame in own], rel=1e-3)
    still = replace(labelled, layers=(), head=None, misalignment=labelled.headset, out=labelled.out.with_name("still"))
    assert not [block for block in render(still).blocks if isinstance(block, Plot)]


def test_frames_that_show_nothing_have_no_misalignment_and_no_annotations(
    labelled: RenderOptions, tmp_path: Path
) -> None:
    behind = tmp_path / "behind.toml"
    text = Path(labelled.scene).read_text(encoding="utf-8").replace("-0.5]\n\n", "0.5]\n\n").replace("-1.5]", "1.5]")
    behind.write_text(text, encoding="utf-8")
    job = replace(labelled, scene=str(behind), misalignment=labelled.headset, out=tmp_path / "behind")
    report = render(job)
    frames = [frame["misalignment"] for frame in metadata(job.out)]
    assert [(each["points"], each["median_arcmin"]) for each in frames] == [(0, None)] * 4
    assert json.loads((job.out / "instances.json").read_text())["annotations"] == []
    assert report.tables[0].rows[0][4:] == [None, None, None]


def test_layers_without_openexr_leave_nothing_behind(labelled: RenderOptions, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "OpenEXR", None)
    with pytest.raises(MissingExtraError, match=r"--layers: .*pip install 'openexr"):
        render(labelled)
    assert not labelled.out.exists()


@pytest.mark.parametrize(
    ("device", "sentence"),
    [
        ("model", "is a fitted model; name the device"),
        ("northstar", "has another panel than .*no_optics.toml; .*; for a device file give that file again"),
    ],
)
def test_an_exact_device_that_is_none_or_another_is_refused(
    labelled: RenderOptions, model_file: str, device: str, sentence: str
) -> None:
    given = model_file if device == "model" else device
    with pytest.raises(BadInputError, match=f"--misalignment .*{sentence}"):
        render(replace(labelled, misalignment=given))
    assert not labelled.out.exists()


def test_both_eyes_are_shown_side_by_side(labelled: RenderOptions, tmp_path: Path) -> None:
    if not _encodes_video(tmp_path):
        pytest.skip("this OpenCV encodes no VP9 video.")
    job = replace(labelled, layers=(), video=True)
    report = render(job)
    names = [path.name for path in report.files if path.suffix == ".mp4"]
    assert names == ["left.mp4", "right.mp4", "stereo.mp4"]
    video = cv2.VideoCapture(str(job.out / "stereo.mp4"))
    _, shown = video.read()
    left, right = (read_png(job.out / f"{eye}-000000.png").astype(int) for eye in ("left", "right"))
    beside = np.concatenate([left, right], axis=1)
    assert shown.shape == beside.shape
    straight, crossed = (np.abs(shown[..., ::-1] - each).mean() for each in (beside, beside[:, ::-1]))
    assert straight < 6 < crossed
    assert video.read()[0]
    assert not video.read()[0]


def _encodes_video(folder: Path) -> bool:
    try:
        write_video(folder / "try.mp4", [np.zeros((36, 64, 3), np.uint8)], 10.0)
    except BadInputError:
        return False
    return True


def test_a_video_that_is_given_up_is_closed(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """A writer that is open has its thread and its file."""
    released = []
    writer = SimpleNamespace(isOpened=lambda: True, write=lambda frame: None, release=lambda: released.append(True))
    monkeypatch.setattr(cv2, "VideoWriter", _Opener(writer))
    pictures = [np.zeros((36, 64, 3), np.uint8), np.zeros((36, 66, 3), np.uint8)]
    with pytest.raises(BadInputError, match="frame 1 has another size than the first"):
        write_video(tmp_path / "right.mp4", pictures, 10.0)
    assert (released, list(tmp_path.iterdir())) == ([True], [])


class _Opener:
    def __init__(self, writer: SimpleNamespace) -> None:
        self.writer = writer

    def __call__(self, *_: object) -> SimpleNamespace:
        return self.writer

    def fourcc(self, *_: object) -> int:
        return 0


@pytest.mark.parametrize("text", ['{"format": "wlr-view", "version": 1}', '{"annotations": 3}', "[]", "cut"])
def test_labels_of_another_kind_are_refused(tmp_path: Path, text: str) -> None:
    path = write_labels(tmp_path / "right-000000-labels.json", [{"instance_id": 1}])
    assert read_labels(path) == [{"instance_id": 1}]
    path.write_text(text)
    with pytest.raises(BadInputError, match=r"labels\.json: .* the labels of a frame.*; draw the frames again"):
        read_labels(path)
