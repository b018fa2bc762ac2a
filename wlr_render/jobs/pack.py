"""Pack the frames of `render` as a data set: WebDataset's tar files, or an image folder of Hugging Face's `datasets`.

A sample is one frame of one eye: the picture, its layers and its metadata, all named after the frame. An interrupted
run leaves no files.
"""

import contextlib
import io
import json
import shutil
import tarfile
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from wlr_render.errors import BadInputError
from wlr_render.io.atomic_files import disk_errors, output_folder, write_bytes, written_whole
from wlr_render.io.input_files import LIMITS, read_bytes
from wlr_render.jobs.frame_labels import LABELS_FILE, LAYERS_FILE, read_labels
from wlr_render.jobs.frame_plan import METADATA
from wlr_render.jobs.render_options import RenderOptions
from wlr_render.work.progress import Progress

_SHARDS, _SHARD = "frames-*.tar", "frames-{:06d}.tar"
_SPLIT = "train"
_TEMPORARY = ".wlr-part-pack"


@dataclass(frozen=True)
class _Sample:
    """A frame to pack: its key, metadata and files by suffix."""

    key: str
    metadata: dict[str, Any]
    files: dict[str, Path]


def pack_frames(
    folder: Path,
    frames: Sequence[Mapping[str, Any]],
    sources: Mapping[str, str],
    options: RenderOptions,
    progress: Progress,
) -> list[Path]:
    """Write finished frames as a data set into the subfolder with the layout's name, replacing an earlier one.

    Args:
        folder: folder of the frames.
        frames: file name and facts of each frame.
        sources: sources of all frames, for their metadata.
        options: options of `render`.
        progress: progress, counted in frames.

    Returns:
        The tar files, or the metadata file.

    Raises:
        BadInputError: the subfolder has other files, a file of a frame is faulty, or the disk is full.
    """
    final, temporary = folder / str(options.pack), output_folder(folder) / _TEMPORARY
    _refuse_others(final)
    samples = progress(_samples(folder, frames, sources, options), len(frames), "frames of the data set")
    shutil.rmtree(temporary, ignore_errors=True)  # left by a killed run; other runs are locked out of this folder
    try:
        with disk_errors(temporary):
            temporary.mkdir()
        if options.pack == "webdataset":
            files = _write_shards(temporary, samples, options.frames_per_shard)
        else:
            files = [_write_image_folder(temporary / _SPLIT, samples)]
        with disk_errors(final):
            with contextlib.suppress(FileNotFoundError):
                shutil.rmtree(final)
            temporary.replace(final)
    finally:
        shutil.rmtree(temporary, ignore_errors=True)
    return [final / path.relative_to(temporary) for path in files]


def _refuse_others(folder: Path) -> None:
    """Reject a folder with files outside a `render` data set, because the new data set would replace them."""
    if not folder.exists():
        return
    with disk_errors(folder):
        others = sorted(path.name for path in folder.iterdir() if path.name != _SPLIT and not path.match(_SHARDS))
    if others:
        raise BadInputError(
            f"{folder / others[0]}: does not belong to the data set that would replace it; move it away."
        )


def _samples(
    folder: Path, frames: Sequence[Mapping[str, Any]], sources: Mapping[str, str], options: RenderOptions
) -> Iterator[_Sample]:
    for frame in frames:
        key = Path(frame["file_name"]).stem
        facts = {name: value for name, value in frame.items() if name != "file_name"}
        metadata = {"key": key, **facts, **sources}
        if "instance" in options.layers:
            metadata["objects"] = read_labels(folder / f"{key}{LABELS_FILE}")
        layers = {"exr": folder / f"{key}{LAYERS_FILE}"} if options.layers else {}
        yield _Sample(key, metadata, layers | {"png": folder / frame["file_name"]})


def _write_shards(out: Path, samples: Iterator[_Sample], count: int) -> list[Path]:
    """Write tar files of `count` samples each, deterministically: the same frames give the same bytes."""
    written: list[Path] = []
    for first in samples:
        path = out / _SHARD.format(len(written))
        with written_whole(path) as temporary, disk_errors(path), tarfile.open(temporary, "w") as shard:
            _add(shard, first)
            for _, sample in zip(range(count - 1), samples, strict=False):
                _add(shard, sample)
        written.append(path)
    return written


def _add(shard: tarfile.TarFile, sample: _Sample) -> None:
    parts = {suffix: read_bytes(path, LIMITS.picture_bytes) for suffix, path in sample.files.items()}
    parts["json"] = json.dumps(sample.metadata).encode()
    for suffix in sorted(parts):
        about = tarfile.TarInfo(f"{sample.key}.{suffix}")
        about.size = len(parts[suffix])
        shard.addfile(about, io.BytesIO(parts[suffix]))


def _write_image_folder(folder: Path, samples: Iterator[_Sample]) -> Path:
    """Copy all files and, last, write their metadata."""
    path = output_folder(folder) / METADATA
    with written_whole(path) as temporary, disk_errors(path), temporary.open("w", encoding="utf-8") as file:
        for sample in samples:
            for source in sample.files.values():
                write_bytes(folder / source.name, read_bytes(source, LIMITS.picture_bytes))
            row = {"file_name": f"{sample.key}.png", **sample.metadata}
            if "exr" in sample.files:
                row["layers"] = f"{sample.key}.exr"
            if "objects" in row:
                row["objects"] = _columns(row["objects"])
            file.write(json.dumps(row) + "\n")
    return path


def _columns(objects: Sequence[dict[str, Any]]) -> dict[str, list[Any]]:
    """Return annotations as one list per key, the form of objects in `datasets`; the layers have the masks."""
    names = ("instance_id", "instance", "category", "bbox", "area")
    return {name: [each[name] for each in objects] for name in names}
