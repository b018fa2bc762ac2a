"""Layers, instances and misalignment of a frame, and the file that joins the instances of a sequence.

`STEM.exr` has the layers of `draw/frame_layers.py`, and `STEM-labels.json` the instances that the frame shows, which
would make the ledger of all frames too long. At the end, `instances.json` (COCO layout) joins them.
"""

import json
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from wlr_render.draw.frame_layers import MEANINGS, Layer
from wlr_render.draw.painters import Frame
from wlr_render.evaluation.metrics import summary
from wlr_render.evaluation.misalignment import misalignment_arcmin
from wlr_render.geometry import transforms
from wlr_render.io.atomic_files import disk_errors, write_text, written_whole
from wlr_render.io.input_files import LIMITS, as_bad_input, read_text
from wlr_render.io.toml_files import parse_json
from wlr_render.jobs.frame_plan import PlannedFrame
from wlr_render.mappings import Eye, Panel
from wlr_render.scene.exr_file import write_exr
from wlr_render.scene.scene import Scene

INSTANCES = "instances.json"
LAYERS_FILE, LABELS_FILE = ".exr", "-labels.json"
"""Endings of the names of a frame's files."""
_KIND = "the labels of a frame"
_GRID = 60, 60
"""Pixels across and down whose misalignment is computed."""


def write_layers(
    path: Path, planned: PlannedFrame, channels: Mapping[str, NDArray[Any]], layers: Sequence[Layer]
) -> Path:
    """Write the layers of a frame; the header states their meaning and viewpoint."""
    texts = {
        "format": "wlr-frame-layers 1",
        "frame": "openxr (x right, y up, looking along -z); 0 in every channel where the pixel shows nothing",
        "eye": planned.eye,
        "time_s": repr(planned.time_s),
        "viewpoint_in_device_m": json.dumps(planned.viewpoint.tolist()),
        "world_from_device": json.dumps(planned.world_from_device.tolist()),
    }
    return write_exr(path, channels, texts | {layer: MEANINGS[layer] for layer in layers})


def write_labels(path: Path, annotations: Sequence[dict[str, Any]]) -> Path:
    """Write the instances that a frame shows."""
    content = {"format": "wlr-frame-labels", "version": 1, "annotations": annotations}
    return write_text(path, json.dumps(content) + "\n")


def read_labels(path: Path) -> list[dict[str, Any]]:
    """Read the instances that a frame shows from a file of `write_labels`.

    Raises:
        BadInputError: the file is missing, or is not a file of labels.
    """
    remedy = "draw the frames again"
    labels = parse_json(path, read_text(path, _KIND, LIMITS.data_bytes, remedy), _KIND, remedy)
    with as_bad_input(path, _KIND, remedy):
        return list(labels["annotations"])


def instance_annotations(instance: NDArray[np.uint32]) -> list[dict[str, Any]]:
    """Return box, area and mask of each instance in a picture, in COCO's terms.

    Args:
        instance: (height, width) numbers of instances, 0 for background.

    Returns:
        By instance: `bbox` [x, y, width, height] and `area` in pixels, and the mask as COCO's run lengths along columns
        from left to right; the first run counts pixels outside the mask.
    """
    height, width = instance.shape
    flat = instance.T.ravel()
    start = np.concatenate([[0], np.flatnonzero(np.diff(flat)) + 1])
    end = np.append(start[1:], flat.size)
    found = []
    for number in np.unique(flat[start]):
        if number == 0:
            continue
        first, beyond = (edge[flat[start] == number] for edge in (start, end))
        edges = np.concatenate([[0], np.stack([first, beyond], axis=-1).ravel(), [flat.size]])
        counts = np.diff(edges)
        left, right = first[0] // height, (beyond[-1] - 1) // height
        # A run on two columns has the lowest pixel of one and the highest of the next.
        is_split = (first // height != (beyond - 1) // height).any()
        top, bottom = (0, height - 1) if is_split else ((first % height).min(), ((beyond - 1) % height).max())
        found.append(
            {
                "instance_id": int(number),
                "bbox": [int(left), int(top), int(right - left + 1), int(bottom - top + 1)],
                "area": int((beyond - first).sum()),
                "iscrowd": 0,
                "segmentation": {"size": [height, width], "counts": counts[: -1 if counts[-1] == 0 else None].tolist()},
            }
        )
    return found


def frame_misalignment(truth: Eye, planned: PlannedFrame, frame: Frame) -> dict[str, Any]:
    """Return the angles at the eye between a frame's content and the real points, through the true mappings.

    Args:
        truth: the true mappings of the eye.
        planned: viewpoint and head pose.
        frame: frame drawn with its geometry.

    Returns:
        Number of evaluated pixels with content, and rms, median, 95 % and maximum in arcminutes; None without such
        pixels.
    """
    assert frame.position is not None
    pixel = (np.floor(truth.display.panel.grid(*_GRID)) + 0.5).reshape(-1, 2)
    position = frame.position[pixel[:, 1].astype(int), pixel[:, 0].astype(int)].astype(np.float64)
    shown = np.isfinite(position[:, 0])
    point = transforms.apply(transforms.inverse(planned.world_from_device), position[shown])
    error = summary(misalignment_arcmin(truth, planned.viewpoint, pixel[shown], point))
    names = {"rms_arcmin": error.rms, "median_arcmin": error.median, "p95_arcmin": error.p95}
    values = {**names, "max_arcmin": error.maximum}
    return {"points": error.count} | {name: value if error.count else None for name, value in values.items()}


def named_annotations(instance: NDArray[np.uint32], scene: Scene) -> list[dict[str, Any]]:
    """Return `instance_annotations` with the names of each instance and of its category, the mesh."""
    found = instance_annotations(instance)
    placed = [scene.instances[each["instance_id"] - 1] for each in found]
    return [
        {"instance": of.name, "category": scene.mesh_of(of).name, **each}
        for of, each in zip(placed, found, strict=True)
    ]


def write_instances(folder: Path, scene: Scene, panels: Mapping[str, Panel], plan: Sequence[PlannedFrame]) -> Path:
    """Write `instances.json`, the instances of all frames in the layout of COCO, from the frames' labels.

    A category is the name of a mesh. `instances` lists the placements with the numbers of `instance_id` and of the
    layer's values. Annotations are written one by one, because a long sequence may have more than fit into memory.
    """
    kinds = list(dict.fromkeys(mesh.name for mesh in scene.meshes))
    category = [1 + kinds.index(scene.mesh_of(instance).name) for instance in scene.instances]
    sizes = {eye: {"width": panel.width_px, "height": panel.height_px} for eye, panel in panels.items()}
    named = zip(scene.instances, category, strict=True)
    head = {
        "info": {"description": f"Instances of the scene '{scene.name}'", "format": "wlr-instances", "version": "1"},
        "images": [
            {"id": number, "file_name": f"{planned.stem}.png", **sizes[planned.eye], "time_s": planned.time_s}
            for number, planned in enumerate(plan, start=1)
        ],
        "categories": [{"id": k, "name": name, "supercategory": ""} for k, name in enumerate(kinds, start=1)],
        "instances": [
            {"id": k, "name": each.name, "category_id": kind} for k, (each, kind) in enumerate(named, start=1)
        ],
    }
    path, count = folder / INSTANCES, 0
    with written_whole(path) as temporary, disk_errors(path), temporary.open("w", encoding="utf-8") as file:
        file.write(json.dumps(head)[:-1] + ', "annotations": [')
        for number, planned in enumerate(plan, start=1):
            for each in read_labels(planned.file(folder, LABELS_FILE)):
                count += 1
                numbers = {"id": count, "image_id": number, "category_id": category[each["instance_id"] - 1]}
                file.write((",\n" if count > 1 else "\n") + json.dumps(numbers | each))
        file.write("\n]}\n")
    return path
