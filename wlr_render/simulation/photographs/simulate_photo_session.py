"""Simulation of a lab's session folder: every photograph, taken through the true optics, and session.toml.

`simulation.toml`, in the same folder, is the recipe of the photographs, so that interrupted work can be resumed and
verification can take more photographs on the same bench. Calibration never opens it.
"""

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path

import numpy as np

from wlr_render.captures.boards.board_drawing import write_board_svg
from wlr_render.captures.boards.board_file import save_board
from wlr_render.captures.patterns.catalogue import make_pattern
from wlr_render.captures.photo_session import BoardPhotograph, PhotoSession, SessionCamera
from wlr_render.captures.photo_session_file import FILE, save_photo_session
from wlr_render.io.atomic_files import output_folder
from wlr_render.io.input_files import hashes_of_inputs
from wlr_render.io.kept import Kept, Signature, recipe_of, signatures_of
from wlr_render.numerics.arrays import FloatArray
from wlr_render.simulation.photographs.camera import SimulatedLens
from wlr_render.simulation.photographs.photo_bench import PhotoBench
from wlr_render.simulation.photographs.photo_plan import (
    PhotoPlan,
    SessionVisits,
    Visit,
    plan_photographs,
    planned_session,
    true_camera_poses,
)
from wlr_render.simulation.photographs.recipe import SimulationRecipe, save_recipe, values_of
from wlr_render.simulation.photographs.take_photographs import BoardShot, CameraPose, PanelShots, take
from wlr_render.work.progress import SILENT, Progress
from wlr_render.work.workers import LOCAL, WorkerPool, as_finished

BOARD = "board.toml"
_MOST_WORKERS = 4  # most workers by default, because each takes up to 0.4 GB


@dataclass(frozen=True)
class TakenPhotographs:
    """Photographs that a run took for a session.

    Attributes:
        taken, kept: numbers of photographs taken in this run and kept from an earlier run.
        changed: photographs of an earlier run that had changed since then and were taken again.
    """

    taken: int
    kept: int
    changed: Sequence[Path]


def simulate_photo_session(
    folder: Path, recipe: SimulationRecipe, workers: WorkerPool = LOCAL, progress: Progress = SILENT
) -> TakenPhotographs:
    """Take the photographs of a session that no earlier run has taken.

    Raises:
        BadInputError: an unknown device, eye or pattern, or the folder holds a session made with other options or input
            files.
    """
    with hashes_of_inputs() as inputs:
        bench = recipe.build()  # impossible options are refused before a folder is made
    root = output_folder(folder)
    pattern = make_pattern(recipe.pattern, bench.optics.panel.pixels)
    finished = Kept(root, recipe_of("simulate", values_of(recipe), inputs), {root / FILE: {}})
    finished.begin()
    save_recipe(root, recipe)
    plan = plan_photographs(bench, recipe.viewpoints)
    visits = true_camera_poses(bench, plan)
    session = planned_session(root, bench, plan, visits, pattern)
    tasks = [(pose, pose.paths()) for pose in camera_poses(session, bench, plan, visits)]
    total = sum(len(paths) for _, paths in tasks)
    tasks = [(pose, missing) for pose, paths in tasks if (missing := finished.unfinished(paths))]
    changed = finished.changed(path for _, missing in tasks for path in missing)
    taken = 0
    finishing = as_finished(_take, tasks, workers.at_most(_MOST_WORKERS), root)
    for signatures in progress(finishing, len(tasks), "camera poses"):
        finished.add(signatures)
        taken += len(signatures)
    save_board(session.board, root / BOARD)
    write_board_svg(session.board, root / "board.svg")
    save_photo_session(session, {"pattern": recipe.pattern}, BOARD)
    return TakenPhotographs(taken, total - taken, changed)


def _take(task: tuple[CameraPose, Sequence[Path]]) -> dict[Path, Signature]:
    return signatures_of(take(*task))


def camera_poses(
    session: PhotoSession, bench: PhotoBench, plan: PhotoPlan, visits: SessionVisits
) -> Iterator[CameraPose]:
    """Yield all camera poses with their photographs; eyeball photographs of one pose and lens are traced together."""
    pose = poses_on(bench, bench.options.seed)
    eyeball = partial(pose, bench.eyeball, bench.eyeball_sensor)
    tracking = partial(pose, bench.tracking, bench.tracking_sensor, optics=None)
    together: dict[bytes, CameraPose] = {}

    def add(lens: SimulatedLens, visit: Visit, boards: list[BoardShot], panels: list[PanelShots]) -> None:
        key = visit.device_from_camera.tobytes() + lens.camera.focal_px.tobytes()
        one = together.setdefault(key, pose(lens, bench.eyeball_sensor, visit.device_from_camera, bench.optics))
        together[key] = replace(one, boards=[*one.boards, *boards], panels=[*one.panels, *panels])

    for code_set, visit in zip(session.display, visits.display, strict=True):
        add(bench.eyeball, visit, [], [PanelShots(code_set.folder, session.pattern)])
    for photograph, visit in zip(session.see_through, visits.see_through, strict=True):
        add(bench.eyeball_focused(photograph.target_pose), visit, [_on_bench(photograph, bench)], [])
    yield from together.values()
    for photograph, visit in zip(session.bare, visits.bare, strict=True):
        lens = bench.eyeball_focused(photograph.target_pose)
        yield pose(lens, bench.eyeball_sensor, visit.device_from_camera, None, boards=[_on_bench(photograph, bench)])
    yield eyeball(np.eye(4), None, boards=_shots(session.eyeball_camera, plan.eyeball_boards))
    yield tracking(bench.device_from_tracking, boards=[_on_bench(each, bench) for each in session.tracking])
    if session.tracking_camera is not None:
        yield tracking(np.eye(4), boards=_shots(session.tracking_camera, plan.tracking_boards))


def poses_on(bench: PhotoBench, seed: int) -> Callable[..., CameraPose]:
    """Return a function that makes a `CameraPose` with the board, vibration, stray light and noise seed of a bench."""
    sizes = bench.options.imperfections
    return partial(
        CameraPose,
        board=bench.printed,
        seed=seed,
        eye=bench.eye,
        vibration_px=sizes.vibration_px,
        stray_light=sizes.stray_light,
    )


def _on_bench(photograph: BoardPhotograph, bench: PhotoBench) -> BoardShot:
    return BoardShot(photograph.path, bench.device_from_target[photograph.target_pose])


def _shots(camera: SessionCamera, camera_from_board: FloatArray) -> tuple[BoardShot, ...]:
    return tuple(BoardShot(path, pose) for path, pose in zip(camera.intrinsics, camera_from_board, strict=True))
