"""Read every photograph of a session, many at a time, keeping what was read so that interrupted work resumes.

What cannot be read does not stop the others: it is named, with its reason, and set aside.
"""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field
from pathlib import Path

from wlr_render.captures.photo_session import BoardPhotograph, CodeSet, PhotoSession, SessionCamera
from wlr_render.captures.targets.dot_board import BoardObservation
from wlr_render.jobs.calibrate.reading_tasks import BoardTask, PanelReading, PanelTask, SetAside, Task, do_task
from wlr_render.jobs.calibrate.store import Store
from wlr_render.jobs.processes import as_finished, few_workers
from wlr_render.progress import SILENT, Progress

_MOST_WORKERS = 3
"""Decoding takes half a gigabyte a process for photographs of 1280 x 1024; all together stay below two."""


@dataclass(frozen=True, eq=False)
class Reading:
    """What a session's photographs say.

    Attributes:
        boards: observation of each photograph of the board that could be read.
        panels: of each set of code photographs that could be decoded, by its folder.
        set_aside: what could not be read, and why.
        kept: how many were found read already by an earlier run.
    """

    boards: dict[Path, BoardObservation] = field(default_factory=dict)
    panels: dict[Path, PanelReading] = field(default_factory=dict)
    set_aside: tuple[SetAside, ...] = ()
    kept: int = 0

    def seen(self, photographs: Sequence[BoardPhotograph]) -> list[tuple[BoardPhotograph, BoardObservation]]:
        """Those of some photographs that could be read, with their observations."""
        return [(each, self.boards[each.path]) for each in photographs if each.path in self.boards]

    def decoded(self, sets: Sequence[CodeSet]) -> list[tuple[CodeSet, PanelReading]]:
        """Those of some sets that could be decoded, with what they say."""
        return [(each, self.panels[each.folder]) for each in sets if each.folder in self.panels]


def read_session(
    session: PhotoSession, store: Store, workers: int | None = None, progress: Progress = SILENT
) -> Reading:
    """Find the board and decode the panel wherever the session has photographs of them.

    Args:
        session: names them.
        store: where what was read is kept, and found again.
        workers: processes, or None for one per core, but not more than memory allows.
        progress: shows how far the work is.
    """
    panel_tasks, board_tasks = list(_panel_tasks(session)), list(_board_tasks(session))
    tasks: list[Task] = [*panel_tasks, *board_tasks]  # the long ones first
    waiting = [(task, store) for task in tasks if task.stored(store) is None]
    outcomes = list(
        progress(as_finished(do_task, waiting, workers or few_workers(_MOST_WORKERS)), len(waiting), "photographs")
    )
    order = {task.name: number for number, task in enumerate(tasks)}
    return Reading(
        {task.path: seen for task in board_tasks if (seen := task.stored(store))},
        {task.folder: decoded for task in panel_tasks if (decoded := task.stored(store))},
        tuple(sorted((each for each in outcomes if each), key=lambda each: order[each.name])),
        len(tasks) - len(waiting),
    )


def _panel_tasks(session: PhotoSession) -> Iterator[PanelTask]:
    for each in session.display:
        yield PanelTask(
            session.name_of(each.folder), each.folder, session.pattern, session.decoding, session.eyeball_camera.size_px
        )


def _board_tasks(session: PhotoSession) -> Iterator[BoardTask]:
    """Every photograph of the board once."""
    eyeball, tracking = session.eyeball_camera, session.tracking_camera
    by_camera: list[tuple[SessionCamera, list[Path]]] = [
        (eyeball, [*eyeball.intrinsics, *(each.path for each in (*session.bare, *session.see_through))]),
        (tracking, [*tracking.intrinsics, *(each.path for each in session.tracking)]),
    ]
    for camera, paths in by_camera:
        for path in dict.fromkeys(paths):
            yield BoardTask(session.name_of(path), path, session.board, camera.size_px, camera.full_scale)
