"""One photograph of the board, or one set of code photographs, from files to what it says."""

from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from wlr_render.captures.decoded import Decoded, DecodedSamples, DecodeOptions, Rejection, sample
from wlr_render.captures.patterns.pattern import Pattern
from wlr_render.captures.photographs import (
    BadPhotographError,
    check_photograph,
    photographs_in,
    read_each,
    read_photograph,
)
from wlr_render.captures.targets.dot_board import BoardObservation, DotBoard
from wlr_render.captures.targets.find_board import find_board
from wlr_render.errors import BadInputError
from wlr_render.jobs.calibrate.store import Store, fingerprint

_THUMBNAIL_PX = 160  # width of the picture of fates that is kept of a decoded set


@dataclass(frozen=True)
class SetAside:
    """A photograph, or a set, that nothing could be read from.

    Attributes:
        name: as reports give it.
        reason: the sentence.
        fault: whether the session is not as session.toml says (missing, of another size, out of order, without the
            board), rather than one photograph having failed.
    """

    name: str
    reason: str
    fault: bool


@dataclass(frozen=True, eq=False)
class PanelReading:
    """What a set of code photographs says.

    Attributes:
        samples: panel positions at camera pixels.
        counts: (number of reasons,) how many camera pixels have which `Rejection`.
        fates: (h, w) uint8 `Rejection` of a thinned-out picture.
        extent: (2, 2) lowest and highest panel position accepted.
    """

    samples: DecodedSamples
    counts: NDArray[np.int64]
    fates: NDArray[np.uint8]
    extent: NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class BoardTask:
    """Find the board in one photograph."""

    name: str
    path: Path
    board: DotBoard
    size_px: tuple[int, int]
    full_scale: int

    def stored(self, store: Store) -> BoardObservation | None:
        """The observation as kept, or None."""
        if not self.path.is_file():
            return None
        kept = store.find(self.name, self._fingerprint())
        if kept is None:
            return None
        unidentified, disagreeing = (int(number) for number in kept["counts"])
        return BoardObservation(kept["index"], kept["pixel"], kept["sigma_px"], unidentified, disagreeing)

    def do(self, store: Store) -> None:
        """Read the photograph and keep what it says."""
        image = read_photograph(self.path)
        check_photograph(image, self.size_px, self.full_scale, self.name)
        found = find_board(image, self.board, self.name)
        counts = np.array([found.unidentified, found.disagreeing])
        arrays = {"index": found.index, "pixel": found.pixel, "sigma_px": found.sigma_px, "counts": counts}
        store.keep(self.name, self._fingerprint(), arrays)

    def _fingerprint(self) -> str:
        board = self.board
        how = [board.pitch_m, board.large_m, board.small_m, board.large.tolist(), self.size_px, self.full_scale]
        return fingerprint([self.path], how)


@dataclass(frozen=True, eq=False)
class PanelTask:
    """Decode one set of code photographs."""

    name: str
    folder: Path
    pattern: Pattern
    decoding: DecodeOptions
    size_px: tuple[int, int]

    def stored(self, store: Store) -> PanelReading | None:
        """The reading as kept, or None."""
        try:
            kept = store.find(self.name, self._fingerprint())
        except BadInputError:
            return None  # there are no photographs, as `do` says
        if kept is None:
            return None
        samples = DecodedSamples(kept["camera_pixel"], kept["panel_pixel"], kept["sigma_px"], kept["scale"])
        return PanelReading(samples, kept["counts"], kept["fates"], kept["extent"])

    def do(self, store: Store) -> None:
        """Read the photographs and keep what they say."""
        paths = photographs_in(self.folder)
        if len(paths) != (wanted := len(self.pattern.names())):
            raise BadInputError(
                f"holds {len(paths)} photographs, but the code has {wanted} pictures; give one photograph a picture."
            )
        first = read_photograph(paths[0])
        # The first picture shows the panel white: what is wrong with it is wrong with all.
        check_photograph(first, self.size_px, self.decoding.full_scale, f"{self.name}/{paths[0].name}")
        decoded = self.pattern.decode(read_each(paths), self.decoding)
        samples = sample(decoded)
        if len(samples) == 0:
            raise BadInputError(_why_nothing(decoded))
        store.keep(self.name, self._fingerprint(), _arrays(decoded, samples))

    def _fingerprint(self) -> str:
        return fingerprint(photographs_in(self.folder), [self.pattern, self.decoding, self.size_px])


Task = BoardTask | PanelTask


def do_task(work: tuple[Task, Store]) -> SetAside | None:
    """Do one task; what is wrong with its photographs is told, not raised."""
    task, store = work
    try:
        task.do(store)
    except BadPhotographError as error:
        # One photograph of the board that failed is one place less; a code without one of its pictures is none.
        return SetAside(task.name, _without_name(error, task), fault=isinstance(task, PanelTask))
    except BadInputError as error:
        return SetAside(task.name, _without_name(error, task), fault=True)
    return None


def _why_nothing(decoded: Decoded) -> str:
    """What most of the camera's lit pixels were rejected for."""
    counts = decoded.counts()
    counts.pop(Rejection.DARK, None)
    if not counts:
        return "no camera pixel could be decoded: the panel's light is nowhere seen; is it in the picture?"
    most = max(counts, key=lambda reason: counts[reason])
    finer = " (stripes finer than a camera pixel? the code gray-fringes has wider ones)"
    hint = finer if most == Rejection.UNSURE_BIT else ""
    return f"no camera pixel could be decoded; most were rejected because {most.sentence}{hint}."


def _without_name(error: BadInputError, task: Task) -> str:
    text = str(error)
    path = task.path if isinstance(task, BoardTask) else task.folder
    for prefix in (f"{path}: ", f"{task.name}: ", f"{path}/", f"{task.name}/"):
        text = text.removeprefix(prefix)
    return text.removesuffix(".")


def _arrays(decoded: Decoded, samples: DecodedSamples) -> dict[str, NDArray[Any]]:
    step = max(1, decoded.rejection.shape[1] // _THUMBNAIL_PX)
    accepted = decoded.pixel[decoded.accepted].astype(np.float64)
    return {
        "camera_pixel": samples.camera_pixel,
        "panel_pixel": samples.panel_pixel,
        "sigma_px": samples.sigma_px,
        "scale": samples.scale,
        "counts": np.bincount(decoded.rejection.ravel(), minlength=len(Rejection)),
        "fates": decoded.rejection[::step, ::step],
        "extent": np.stack([accepted.min(axis=0), accepted.max(axis=0)]),
    }
