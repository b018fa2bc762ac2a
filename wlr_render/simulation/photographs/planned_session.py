"""session.toml of a simulated session: names and readings, and nothing of the truth."""

from pathlib import Path

import numpy as np

from wlr_render.captures.decoded import DecodeOptions
from wlr_render.captures.patterns.pattern import Pattern
from wlr_render.captures.photo_session import (
    BoardPhotograph,
    CodeSet,
    PhotoSession,
    SessionCamera,
    SessionPanel,
    StageAxis,
    StageDescription,
)
from wlr_render.captures.photo_session_entries import with_places
from wlr_render.captures.photograph_format import PhotographFormat
from wlr_render.simulation.photographs.camera import Sensor, SimulatedLens
from wlr_render.simulation.photographs.photo_bench import PhotoBench
from wlr_render.simulation.photographs.photo_plan import PhotoPlan, stage_axis_count
from wlr_render.simulation.photographs.visits import SessionVisits


def planned_session(
    root: Path, bench: PhotoBench, plan: PhotoPlan, visits: SessionVisits, pattern: Pattern
) -> PhotoSession:
    """The session of these visits, whose photographs are to lie in the folder `root`."""
    poses = range(len(bench.device_from_target))
    eyeball = _camera(root / "intrinsics" / "eyeball", bench.eyeball, bench.eyeball_sensor, len(plan.eyeball_boards))
    tracking = _camera(
        root / "intrinsics" / "tracking", bench.tracking, bench.tracking_sensor, len(plan.tracking_boards)
    )
    bare = [f"bare/pose{pose}_{n:02d}.png" for pose in plan.bare_poses for n in range(len(plan.bare))]
    # The first reading once more at the end of each sweep: what moved meanwhile shows there.
    sweep = len(visits.see_through) // len(poses)
    through = [
        (pose, f"pose{pose}_{n:02d}.png", visits.see_through[pose * sweep + n]) for pose in poses for n in range(sweep)
    ]
    sizes, axes = bench.options.imperfections, stage_axis_count(bench)
    sigma = (float(np.radians(sizes.extrinsics_deg)), 1e-3 * sizes.extrinsics_mm)

    def target_photographs(folder: str) -> tuple[BoardPhotograph, ...]:
        return tuple(
            BoardPhotograph(root, f"{folder}/{name}", pose, visit.reading, visit.place, eye=bench.eye)
            for pose, name, visit in through
        )

    session = PhotoSession(
        folder=root,
        device=bench.device.name,
        eyes=(bench.eye,),
        eye_boxes={bench.eye: bench.optics.eye_box},
        panels={bench.eye: SessionPanel(pattern)},
        decoding=DecodeOptions(full_scale=eyeball.full_scale),
        board=bench.board,
        eyeball_camera=eyeball,
        tracking_camera=tracking,
        device_from_tracking=bench.stated_device_from_tracking,
        tracking_sigma=sigma if all(sigma) else None,
        stage=StageDescription((StageAxis(),) * axes) if axes else None,
        bare=tuple(
            BoardPhotograph(root, name, plan.bare_poses[number // len(plan.bare)], visit.reading, eye=bench.eye)
            for number, (name, visit) in enumerate(zip(bare, visits.bare, strict=True))
        ),
        tracking=tuple(
            BoardPhotograph(root, f"tracking/pose{pose}_{when}.png", pose)
            for pose in poses
            for when in ("before", "after")
        ),
        see_through=target_photographs("see_through"),
        beside=() if axes else target_photographs("beside"),
        display=tuple(
            CodeSet(root / "display" / f"{number:02d}", visit.reading, visit.place, eye=bench.eye)
            for number, visit in enumerate(visits.display)
        ),
    )
    return with_places(session)


def _camera(folder: Path, lens: SimulatedLens, sensor: Sensor, count: int) -> SessionCamera:
    paths = tuple(folder / f"{number:02d}.png" for number in range(count))
    return SessionCamera(lens.camera.size_px, PhotographFormat(sensor.bits), paths)
