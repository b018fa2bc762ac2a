"""Read every photograph of a session in parallel, and keep the results so that interrupted work can be resumed.

A photograph that cannot be read does not stop the others: it is excluded and listed with the reason.
"""

import functools
import json
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field, fields, replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from wlr_render.captures.boards.board import Board, BoardObservation
from wlr_render.captures.boards.board_file import board_table
from wlr_render.captures.boards.lattice_shape import Discs
from wlr_render.captures.code_files import CodeFiles, find_code_files
from wlr_render.captures.decoded import Decoded, DecodedSamples, DecodeOptions, Rejection, sample
from wlr_render.captures.patterns.pattern import Pattern
from wlr_render.captures.photo_session import BoardPhotograph, CodeSet, CodeTable, PhotoSession, SessionCamera
from wlr_render.captures.photograph_format import PhotographFormat
from wlr_render.captures.photographs import BadPhotographError, check_photograph, file_note, read_photograph
from wlr_render.errors import BadInputError
from wlr_render.io.atomic_files import write_arrays
from wlr_render.io.input_files import LIMITS, read_arrays, read_bytes
from wlr_render.io.kept import sha256_of
from wlr_render.work.progress import SILENT, Progress
from wlr_render.work.workers import LOCAL, WorkerPool, as_finished

_VERSION = 7  # version of the reader; photographs read by another version are read again
_THUMBNAIL_PX = 160  # width of the picture of rejections that is kept for a decoded set
_MOST_WORKERS = 3  # most workers by default, because decoding 1280 x 1024 pixels takes half a gigabyte in each process


@dataclass(frozen=True)
class Excluded:
    """A photograph or set that could not be read, or that the results do not use.

    Attributes:
        name: name in reports.
        reason: reason as a sentence.
        fault: True if the session contradicts session.toml (missing, of another size, out of order, without the board),
            rather than one photograph having failed.
        off_arcmin: distance of its features from the prediction of the other photographs; 0 if nothing was read.
    """

    name: str
    reason: str
    fault: bool
    off_arcmin: float = 0.0


@dataclass(frozen=True, eq=False)
class PanelReading:
    """Result of decoding a set of code photographs.

    Attributes:
        samples: panel positions at camera pixels.
        counts: (number of reasons,) number of camera pixels for each `Rejection`.
        fates: (h, w) uint8 `Rejection` of a subsampled picture.
        extent: (2, 2) lowest and highest panel position accepted.
        missing: names of the pictures without a photograph; decoding did without them.
        file_note: sentence about the format of the files, if it was detected and not stated.
        light_note: sentence about light that was repaired, where white was photographed again.
    """

    samples: DecodedSamples
    counts: NDArray[np.int64]
    fates: NDArray[np.uint8]
    extent: NDArray[np.float64]
    missing: tuple[str, ...] = ()
    file_note: str = ""
    light_note: str = ""


@dataclass(frozen=True, eq=False)
class Reading:
    """Results of reading a session's photographs.

    Attributes:
        boards: observation of each photograph of the board that could be read.
        panels: reading of each decoded set of code photographs, by its folder.
        excluded: photographs that could not be read, with the reasons.
        kept: number of results from an earlier run.
    """

    boards: dict[Path, BoardObservation] = field(default_factory=dict)
    panels: dict[Path, PanelReading] = field(default_factory=dict)
    excluded: tuple[Excluded, ...] = ()
    kept: int = 0

    @property
    def notes(self) -> list[str]:
        """Sentences about the format of files, and about sets of repaired light or without some photographs."""
        about_files = dict.fromkeys(panel.file_note for panel in self.panels.values() if panel.file_note)
        of_light = [f"{folder.name}: {panel.light_note}" for folder, panel in self.panels.items() if panel.light_note]
        missing = [
            f"{folder.name}: decoded without the missing photographs of {', '.join(panel.missing)}."
            for folder, panel in self.panels.items()
            if panel.missing
        ]
        return [*list(about_files)[:1], *of_light, *missing]

    def views_of(self, photographs: Sequence[BoardPhotograph]) -> list[tuple[BoardPhotograph, BoardObservation]]:
        """Return the readable photographs with their features inside the entry's regions."""
        read = [(each, self.boards[each.path]) for each in photographs if each.path in self.boards]
        counted = [(each, observation.only(each.counts(observation.pixel))) for each, observation in read]
        return [(each, observation) for each, observation in counted if len(observation)]

    def panels_of(self, sets: Sequence[CodeSet]) -> list[tuple[CodeSet, PanelReading]]:
        """Return the decoded sets with their readings."""
        return [(each, self.panels[each.folder]) for each in sets if each.folder in self.panels]


def read_session(
    session: PhotoSession, folder: Path, workers: WorkerPool = LOCAL, progress: Progress = SILENT
) -> Reading:
    """Find the board and decode the panel in all photographs of a session.

    Args:
        session: session with the paths of the photographs.
        folder: folder in which the results are kept for the next run.
        workers: processes or machines; by default all cores that memory allows.
        progress: progress display.
    """
    panels, boards = list(_panel_tasks(session)), list(_board_tasks(session))
    tasks: list[_Task] = [*panels, *boards]  # longest tasks first
    kept = {number: arrays for number, task in enumerate(tasks) if (arrays := _kept(task, folder))}
    waiting = [(number, task, folder) for number, task in enumerate(tasks) if number not in kept]
    finished = as_finished(_do_task, waiting, workers.at_most(_MOST_WORKERS), folder)
    outcomes = dict(progress(finished, len(waiting), "photographs"))
    read = kept | {number: each for number, each in outcomes.items() if not isinstance(each, Excluded)}
    return Reading(
        {task.path: task.result(read[number]) for number, task in enumerate(boards, len(panels)) if number in read},
        {task.path: task.result(read[number]) for number, task in enumerate(panels) if number in read},
        tuple(each for _, each in sorted(outcomes.items()) if isinstance(each, Excluded)),
        len(kept),
    )


def _panel_tasks(session: PhotoSession) -> "Iterator[_PanelTask]":
    camera, code = session.eyeball_camera, session.code
    for code_set in session.display:
        name, pattern = session.name_of(code_set.path), session.panels[code_set.eye].pattern
        yield _PanelTask(name, code_set.path, code, pattern, session.decoding, camera.size_px, camera.format)


def _board_tasks(session: PhotoSession) -> "Iterator[_BoardTask]":
    """Yield every photograph of the board once."""
    taken = (*session.bare, *session.beside, *session.see_through)
    by_camera: list[tuple[SessionCamera, Sequence[BoardPhotograph]]] = [(session.eyeball_camera, taken)]
    if session.tracking_camera is not None:
        by_camera.append((session.tracking_camera, session.tracking))
    for camera, photographs in by_camera:
        boards = dict.fromkeys(camera.intrinsics, session.board)
        boards |= {each.path: session.board_of(each.target_pose) for each in photographs}
        for path, board in boards.items():
            yield _BoardTask(session.name_of(path), path, board, camera.size_px, camera.format)


@dataclass(frozen=True, eq=False)
class _BoardTask:
    """Task: find the board in one photograph."""

    name: str
    path: Path
    board: Board
    size_px: tuple[int, int]
    kind: PhotographFormat

    def fingerprint(self) -> str:
        return _fingerprint([self.path], [board_table(self.board), self.size_px, self.kind])

    def read(self) -> dict[str, NDArray[Any]]:
        image = read_photograph(self.path, self.kind)
        check_photograph(image, self.size_px, self.kind, self.name)
        observation = self.board.find(image, self.name)
        discs = observation.discs
        arrays = {name: np.asarray(value) for name, value in vars(observation).items() if name != "discs"}
        return arrays if discs is None else arrays | vars(discs)

    def result(self, kept: dict[str, NDArray[Any]]) -> BoardObservation:
        discs = Discs(kept["centroid"], kept["radius_m"]) if "centroid" in kept else None
        half_turn = bool(kept["ambiguous_half_turn"])
        return BoardObservation(kept["index"], kept["pixel"], kept["sigma_px"], half_turn, discs)


@dataclass(frozen=True, eq=False)
class _PanelTask:
    """Task: decode one set of code photographs."""

    name: str
    path: Path
    code: CodeTable
    pattern: Pattern
    decoding: DecodeOptions
    size_px: tuple[int, int]
    kind: PhotographFormat

    def fingerprint(self) -> str:
        files = self._files()
        roles = [[path.name for path in paths] for paths in files.pictures]
        further = [files.taken, [(place, path.name) for place, path in files.whites]]
        how = [roles, further, files.exposures_s, self.pattern, self.decoding, self.size_px, self.kind]
        return _fingerprint(files.paths, how)

    def _files(self) -> CodeFiles:
        return find_code_files(self.path, self.pattern.names(), self.code.order, self.code.manifest)

    def read(self) -> dict[str, NDArray[Any]]:
        files = self._files()
        self._check_first(files)
        options = replace(self.decoding, full_scale=self.kind.full_scale, end_of_scale=files.end_of_scale(self.kind))
        decoded = self.pattern.decode(files.read(self.kind), options)
        samples = sample(decoded)
        if len(samples) == 0:
            raise BadInputError(_why_nothing(decoded))
        light = files.light(self.kind)
        step = max(1, decoded.rejection.shape[1] // _THUMBNAIL_PX)
        accepted = decoded.pixel[decoded.accepted].astype(np.float64)
        return vars(samples) | {
            "counts": np.bincount(decoded.rejection.ravel(), minlength=len(Rejection)),
            "fates": decoded.rejection[::step, ::step],
            "extent": np.stack([accepted.min(axis=0), accepted.max(axis=0)]),
            "missing": np.array(files.missing, dtype=np.int64),
            "file_note": np.array(file_note(files.paths[0], self.kind)),
            "light_note": np.array("" if light is None else light.note),
        }

    def _check_first(self, files: CodeFiles) -> None:
        """Check one picture for the whole set: the first lit one, with its exposures merged.

        Raises:
            BadInputError: as `check_photograph`.
        """
        names = self.pattern.names()
        for name, paths, image in zip(names, files.pictures, files.read(self.kind), strict=True):
            if image is None or name == "black":
                continue
            longest = paths[int(np.argmax(files.exposures_s))] if files.exposures_s else paths[0]
            merged_from = files.end_of_scale(self.kind) if files.exposures_s else None
            check_photograph(image, self.size_px, self.kind, str(longest), merged_from)
            return

    def result(self, kept: dict[str, NDArray[Any]]) -> PanelReading:
        samples = DecodedSamples(**{each.name: kept[each.name] for each in fields(DecodedSamples)})
        missing = tuple(self.pattern.names()[number] for number in kept["missing"])
        said = (str(kept[name]) for name in ("file_note", "light_note"))
        return PanelReading(samples, kept["counts"], kept["fates"], kept["extent"], missing, *said)


_Task = _BoardTask | _PanelTask


def _do_task(work: tuple[int, _Task, Path]) -> tuple[int, dict[str, NDArray[Any]] | Excluded]:
    """Read photographs and save the result; return the task's number, and the result or the reason of the failure."""
    number, task, folder = work
    try:
        # Copies, because a view would keep the whole picture in memory.
        arrays = {name: np.array(value) for name, value in task.read().items()}
    except BadInputError as error:
        # A failed photograph of the board loses one view; a failed picture of a code loses the whole set.
        one_less = isinstance(error, BadPhotographError) and isinstance(task, _BoardTask)
        text = str(error)
        for prefix in (f"{task.path}: ", f"{task.name}: ", f"{task.path}/", f"{task.name}/"):
            text = text.removeprefix(prefix)
        return number, Excluded(task.name, text.removesuffix("."), fault=not one_less)
    write_arrays(_kept_path(task, folder), {"fingerprint": np.array(task.fingerprint())} | arrays)
    return number, arrays


def _kept(task: _Task, folder: Path) -> dict[str, NDArray[Any]] | None:
    """Return the kept result if it comes from exactly these files and settings, else None."""
    path = _kept_path(task, folder)
    try:
        kept = read_arrays(path, "a kept reading")
        return kept if str(kept.get("fingerprint")) == task.fingerprint() else None
    except (OSError, BadInputError):
        return None  # photographs are missing, or the kept file cannot be read: they are read again


def _kept_path(task: _Task, folder: Path) -> Path:
    # The hash distinguishes truncated names; 50 characters are 200 bytes at most, within file systems' limit.
    name = task.name.replace("/", "__")[-50:]
    return folder / f"{name}-{sha256_of(task.name.encode())[:16]}.npz"


def _fingerprint(paths: Sequence[Path], how: object) -> str:
    """Return the SHA-256 of the names and contents of files, and of the settings of reading."""
    about = [(path.name, _sha256(path, path.stat().st_mtime_ns)) for path in paths]
    return sha256_of(json.dumps([_VERSION, about, repr(how)]).encode())


@functools.cache
def _sha256(path: Path, date_ns: int) -> str:
    """Return the SHA-256 of a file, calculated once in a run unless the file changes."""
    return sha256_of(read_bytes(path, LIMITS.picture_bytes))


def _why_nothing(decoded: Decoded) -> str:
    """Return the reason why most of the camera's lit pixels were rejected."""
    counts = decoded.counts()
    counts.pop(Rejection.DARK, None)
    if not counts:
        return "no camera pixel could be decoded: the panel's light is nowhere seen; is it in the picture?"
    most = max(counts, key=lambda reason: counts[reason])
    finer = " (stripes finer than a camera pixel? the code gray-fringes has wider ones)"
    hint = finer if most == Rejection.UNSURE_BIT else ""
    return f"no camera pixel could be decoded; most were rejected because {most.sentence}{hint}."
