"""Pack the frames of `render` as a data set: WebDataset's tar files, or an image folder of Hugging Face's `datasets`.

A sample is one frame of one eye: the picture, its layers and its metadata, all named after the frame. Frames that are
not as `finished.jsonl` lists them are refused, so that what is packed is what was drawn. A pack that is refused or
interrupted leaves nothing.
"""

import contextlib
import io
import json
import re
import shutil
import tarfile
from collections.abc import Iterator, Sequence
from dataclasses import KW_ONLY, dataclass
from pathlib import Path, PureWindowsPath
from typing import Annotated, Any, Literal

from wlr_render.atomic_files import disk_errors, output_folder, write_bytes, written_whole
from wlr_render.errors import BadInputError
from wlr_render.finished_files import LIST, FinishedFiles
from wlr_render.input_files import LIMITS, read_bytes, shown
from wlr_render.jobs.frame_labels import labels_file, layers_file, read_labels
from wlr_render.jobs.job import job
from wlr_render.jobs.options import OnlyWith, Options, ProgressArgument, Range, described
from wlr_render.jobs.sequence_record import RECORD
from wlr_render.progress import SILENT
from wlr_render.report.blocks import Report
from wlr_render.report.save import save_report
from wlr_render.toml_files import Table, read_json

Layout = Literal["webdataset", "huggingface"]
METADATA = "metadata.jsonl"
_SHARD = "frames-{:06d}.tar"
_SPLIT = "train"
_TEMPORARY = ".wlr-part-pack"
_JUDGEMENTS = ("misalignment", "predicted_error")
"""Labels of a frame as a whole, each with the name of its option."""
_FRAME = re.compile(r"(left|right)-(\d{6,9})\.png")


@dataclass(frozen=True)
class PackOptions(Options):
    """Options of `pack`."""

    layout: Annotated[Layout, described("Tar files of WebDataset, or an image folder of Hugging Face's datasets.")]
    folder: Annotated[Path, described("Folder that `render` wrote.")]
    _: KW_ONLY
    frames_per_shard: Annotated[
        int,
        described("Frames in each tar file (webdataset only)."),
        Range(1, 1_000_000),
        OnlyWith("layout", ("webdataset",)),
    ] = 1000
    out: Annotated[Path, described("Folder of the data set, which must not hold one.")] = Path("out/pack")


@dataclass(frozen=True)
class _Sample:
    """A frame to pack: its key, metadata and files by suffix."""

    key: str
    metadata: dict[str, Any]
    files: dict[str, Path]


@job
def pack(options: PackOptions, *, progress: ProgressArgument = SILENT) -> Report:
    """Write the frames of a folder as a data set into `options.out`.

    Raises:
        BadInputError: the folder holds no frames of `render`, a frame is missing or was changed, or `options.out` holds
            a data set already.
    """
    folder, out = options.folder, output_folder(options.out)
    if any(out.glob("frames-*.tar")) or (out / _SPLIT).exists():
        raise BadInputError(f"{out}: holds a data set already; choose another folder or empty it.")
    remedy = "name a folder that `render` wrote"
    record = read_json(folder / RECORD, "the record of a sequence", remedy, LIMITS.record_bytes)
    record.text("format", choices=("wlr-sequence",))
    entries = record.tables("frames", most=LIMITS.rows)
    samples = progress(_samples(folder, record, entries), len(entries), "frames")
    with _moved_when_complete(out) as temporary:
        if options.layout == "webdataset":
            files = _write_shards(temporary, samples, options.frames_per_shard)
        else:
            files = [_write_image_folder(temporary / _SPLIT, samples)]
    written = [out / path.relative_to(temporary) for path in files]
    shards = "1 tar file" if len(written) == 1 else f"{len(written)} tar files"
    place = f"in {shards}" if options.layout == "webdataset" else f"beside {written[0].relative_to(out)}"
    frames = "1 frame" if len(entries) == 1 else f"{len(entries)} frames"
    report = Report(
        f"Data set of {folder.resolve().name}",
        f"{frames} {place}, for {options.layout}.",
        inputs=[folder / RECORD, folder / LIST],
        files=written,
        record={"frames": len(entries)},
        is_published=True,
    )
    return save_report(report, out)


@contextlib.contextmanager
def _moved_when_complete(out: Path) -> Iterator[Path]:
    """Context manager for a temporary folder, whose content is moved into `out` if the block ends without an error.

    All of it is moved, or nothing: half of the shards would look like a whole data set.
    """
    temporary = out / _TEMPORARY
    shutil.rmtree(temporary, ignore_errors=True)  # of a killed run: no other one may write into this folder now
    with disk_errors(temporary):
        temporary.mkdir()
    moved: list[Path] = []
    try:
        yield temporary
        try:
            # The first shard last: readers begin with it, so that a killed run leaves nothing that has one.
            for path in sorted(temporary.iterdir(), reverse=True):
                moved.append(out / path.name)
                with disk_errors(moved[-1]):
                    path.replace(moved[-1])
        except BaseException:
            for path in moved:
                with contextlib.suppress(FileNotFoundError):
                    path.replace(temporary / path.name)
            raise
    finally:
        shutil.rmtree(temporary, ignore_errors=True)


def _samples(folder: Path, record: Table, entries: Sequence[Table]) -> Iterator[_Sample]:
    finished, job_table = FinishedFiles(folder), record.table("job")
    has_layers = job_table.has("layers") and bool(job_table.unchecked("layers"))
    has_labels = has_layers and "instance" in job_table.texts("layers")
    judged = [each for each in _JUDGEMENTS if job_table.has(each) and job_table.unchecked(each) is not None]
    sources = _sources(record, job_table)
    for entry in entries:
        name = entry.text("file")
        found = _FRAME.fullmatch(name)
        if found is None:
            raise entry.fail(f"'file' is {shown(name)}, which is no frame of `render`; draw the frames again.")
        key, labels = Path(name).stem, labels_file(folder, Path(name).stem)
        files = ({"exr": layers_file(folder, key)} if has_layers else {}) | {"png": folder / name}
        read = [*files.values(), *([labels] if has_labels or judged else [])]
        if wrong := finished.not_whole(read):
            raise BadInputError(
                f"{wrong[0]}: is missing, or is not as it was drawn; draw it again: `render` with the same options."
            )
        metadata = {
            "key": key,
            "eye": found[1],
            "index": int(found[2]),
            "time_s": entry.number("time_s"),
            "viewpoint_in_device_m": entry.vector("viewpoint_in_device_m", 3).tolist(),
            "world_from_device": entry.vectors("world_from_device", 4).tolist(),
            "held": entry.flag("held", default=False),
            **sources,
            **{kind: read_labels(labels, kind) for kind in judged},
        }
        if has_labels:
            metadata["objects"] = read_labels(labels, "annotations")
        yield _Sample(key, metadata, files)


def _sources(record: Table, job_table: Table) -> dict[str, str]:
    """Names and hashes of the headset and the scene: who gets the data set has no use for paths of this machine.

    Windows paths may have separators of either kind, and the frames may have been drawn on another machine.
    """
    hashes = record.table("files")
    names = record.table("names") if record.has("names") else None  # version 0.2.0 wrote none
    sources = {}
    for what in ("headset", "scene"):
        sources[what] = names.text(what) if names else PureWindowsPath(job_table.text(what)).name
        sources[f"{what}_sha256"] = hashes.text(what)
    return sources


def _write_shards(out: Path, samples: Iterator[_Sample], count: int) -> list[Path]:
    """Tar files of `count` samples each; the same frames give the same bytes."""
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
    """Copies of all files and, last, their metadata."""
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
    """Annotations as a list for each key, as `datasets` has detected objects; masks are in the layers."""
    names = ("instance_id", "instance", "category", "bbox", "area")
    return {name: [each[name] for each in objects] for name in names}
