"""Write a session's folder as a lab would: every photograph taken through the true optics, and session.toml.

`simulation.toml`, beside it, says how the photographs were made, so that interrupted work goes on and verification can
take more photographs on the same bench. Calibration never opens it.
"""

from collections.abc import Iterator
from functools import partial
from pathlib import Path

import numpy as np

from wlr_render.captures.boards.board_drawing import write_board_svg
from wlr_render.captures.boards.board_file import save_board
from wlr_render.captures.decoded import DecodeOptions
from wlr_render.captures.patterns.catalogue import make_pattern
from wlr_render.captures.patterns.pattern import Pattern
from wlr_render.captures.photo_session import BoardPhotograph, CodeSet, PhotoSession, SessionCamera
from wlr_render.captures.photo_session_file import FILE, save_photo_session
from wlr_render.errors import BadInputError
from wlr_render.files import output_folder
from wlr_render.numerics.arrays import FloatArray
from wlr_render.processes import as_finished, few_workers
from wlr_render.progress import SILENT, Progress
from wlr_render.simulation.photographs import recipe as recipe_file
from wlr_render.simulation.photographs.camera import Sensor, SimulatedLens
from wlr_render.simulation.photographs.photo_bench import PhotoBench, PhotoPlan, plan_photographs
from wlr_render.simulation.photographs.recipe import SimulationRecipe
from wlr_render.simulation.photographs.take_photographs import BoardShot, CameraPose, PanelShots, take

BOARD = "board.toml"
_MOST_WORKERS = 4  # each takes up to 0.4 GB


def simulate_photo_session(
    folder: Path, recipe: SimulationRecipe, workers: int | None = None, progress: Progress = SILENT
) -> tuple[int, int]:
    """Take all photographs of a session that an earlier run has not taken; returns the numbers taken and kept.

    Raises:
        BadInputError: an unknown device, eye or pattern, or the folder holds a session made in another way.
    """
    bench = recipe.build()  # what cannot be simulated is refused before a folder is made
    root = output_folder(folder)
    pattern = make_pattern(recipe.pattern, bench.optics.panel.pixels)
    if (root / recipe_file.FILE).is_file():
        if apart := recipe_file.difference(recipe_file.load_recipe(root), recipe):
            raise BadInputError(
                f"{root}: holds a session that was simulated in another way ({apart}); choose another folder."
            )
    elif (root / FILE).is_file():
        raise BadInputError(f"{root}: holds a session that was not simulated; choose another folder.")
    else:
        recipe_file.save_recipe(root, recipe)
    plan = plan_photographs(bench, recipe.viewpoints)
    session = _session(root, bench, plan, pattern, recipe)
    poses = list(_poses(session, bench, plan, recipe.bench.stage_error_um, recipe.bench.seed))
    total = sum(len(pose.paths()) for pose in poses)
    taken = sum(progress(as_finished(take, poses, workers or few_workers(_MOST_WORKERS)), len(poses), "camera poses"))
    save_board(session.board, root / BOARD)
    write_board_svg(session.board, root / "board.svg")
    save_photo_session(session, {"pattern": recipe.pattern}, BOARD)
    return taken, total - taken


def _session(
    root: Path, bench: PhotoBench, plan: PhotoPlan, pattern: Pattern, recipe: SimulationRecipe
) -> PhotoSession:
    """What session.toml is to say: names and readings, and nothing of the truth."""
    poses = range(len(bench.device_from_target))
    eyeball = _camera(root / "intrinsics" / "eyeball", bench.eyeball, bench.eyeball_sensor, len(plan.eyeball_boards))
    tracking = _camera(
        root / "intrinsics" / "tracking", bench.tracking, bench.tracking_sensor, len(plan.tracking_boards)
    )
    # The first reading once more at the end of each sweep: what moved meanwhile shows there.
    readings = [*plan.sweep, plan.sweep[0]]
    return PhotoSession(
        folder=root,
        device=bench.device.name,
        eye=bench.eye,
        eye_box=bench.optics.eye_box,
        pattern=pattern,
        decoding=DecodeOptions(full_scale=eyeball.full_scale),
        board=bench.board,
        eyeball_camera=eyeball,
        tracking_camera=tracking,
        device_from_tracking=bench.device_from_tracking,
        bare=tuple(
            BoardPhotograph(root, f"bare/pose{pose}_{number:02d}.png", pose, stage)
            for pose in plan.bare_poses
            for number, stage in enumerate(plan.bare)
        ),
        tracking=tuple(
            BoardPhotograph(root, f"tracking/pose{pose}_{when}.png", pose, np.zeros(3))
            for pose in poses
            for when in ("before", "after")
        ),
        see_through=tuple(
            BoardPhotograph(root, f"see_through/pose{pose}_{number:02d}.png", pose, stage)
            for pose in poses
            for number, stage in enumerate(readings)
        ),
        display=tuple(CodeSet(root / "display" / f"{number:02d}", stage) for number, stage in enumerate(plan.sweep)),
    )


def _camera(folder: Path, lens: SimulatedLens, sensor: Sensor, count: int) -> SessionCamera:
    return SessionCamera(
        lens.camera.size_px, sensor.bits, tuple(folder / f"{number:02d}.png" for number in range(count))
    )


def _poses(
    session: PhotoSession, bench: PhotoBench, plan: PhotoPlan, stage_error_um: float, seed: int
) -> Iterator[CameraPose]:
    rng = np.random.default_rng([seed, 17, int(bench.eye == "left")])

    def camera_at(stage: FloatArray) -> FloatArray:
        return bench.camera_at(stage + rng.normal(0.0, 1e-6 * stage_error_um, 3))

    pose = partial(CameraPose, board=bench.board, seed=seed, eye=bench.eye)
    eyeball = partial(pose, bench.eyeball, bench.eyeball_sensor)
    tracking = partial(pose, bench.tracking, bench.tracking_sensor, optics=None)
    for number, stage in enumerate(plan.sweep):
        boards = [_on_bench(each, bench) for each in session.see_through if np.array_equal(each.stage, stage)]
        panels = [PanelShots(session.display[number].folder, session.pattern)]
        yield eyeball(camera_at(stage), bench.optics, boards=boards, panels=panels)
    for each in session.bare:
        yield eyeball(camera_at(each.stage), None, boards=[_on_bench(each, bench)])
    yield eyeball(np.eye(4), None, boards=_shots(session.eyeball_camera, plan.eyeball_boards))
    yield tracking(bench.device_from_tracking, boards=[_on_bench(each, bench) for each in session.tracking])
    yield tracking(np.eye(4), boards=_shots(session.tracking_camera, plan.tracking_boards))


def _on_bench(photograph: BoardPhotograph, bench: PhotoBench) -> BoardShot:
    return BoardShot(photograph.path, bench.device_from_target[photograph.target_pose])


def _shots(camera: SessionCamera, camera_from_board: FloatArray) -> tuple[BoardShot, ...]:
    return tuple(BoardShot(path, pose) for path, pose in zip(camera.intrinsics, camera_from_board, strict=True))
