"""True values behind a simulated session, with the requested faults."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from benchmarks.simulated_lab.faults import Faults
from wlr_render.captures.photo_session import PhotoSession
from wlr_render.errors import BadInputError
from wlr_render.geometry import transforms
from wlr_render.lenses.lens_camera import LensCamera
from wlr_render.numerics.arrays import FloatArray
from wlr_render.simulation.photographs.photo_bench import PhotoBench
from wlr_render.simulation.photographs.photo_plan import SessionVisits, Visit


@dataclass(frozen=True, eq=False)
class BenchTruth:
    """True values behind a simulated session, in the device frame, metres; lists have the session's order.

    Attributes:
        bench: the bench, with the true stage axes and the target's poses before any fault. Its eyeball lens has its
            middle focus, as for the panel and the photographs for the intrinsics.
        eyeball_at_target: the eyeball lens at each target pose.
        bare, see_through, display: (n, 4, 4) device_from_camera of each photograph or panel set.
        bare_targets, see_through_targets, tracking_targets: (n, 4, 4) device_from_target at each photograph.
    """

    bench: PhotoBench
    eyeball_at_target: tuple[LensCamera, ...]
    bare: FloatArray
    see_through: FloatArray
    display: FloatArray
    bare_targets: FloatArray
    see_through_targets: FloatArray
    tracking_targets: FloatArray


def true_values(session: PhotoSession, bench: PhotoBench, visits: SessionVisits, faults: Faults) -> BenchTruth:
    """Return the true poses of cameras and target at each photograph, in the headset's frame, even after a slip.

    Raises:
        BadInputError: a fault names a missing photograph.
    """
    poses = range(len(bench.device_from_target))
    sweep = len(session.see_through) // len(poses)
    camera = _poses_of(visits.see_through)
    target = np.repeat(bench.device_from_target, sweep, axis=0)
    tracked = np.repeat(bench.device_from_target, 2, axis=0)
    bare_target = bench.device_from_target[[each.target_pose for each in session.bare]]
    if (moved := faults.board_moved) is not None:
        # The bench has the poses during the sweeps: the bare photographs saw the target elsewhere.
        for number, each in enumerate(session.bare):
            if each.target_pose == known_number(moved.target_pose, poses, "target pose"):
                bare_target[number] = moved.shift.moved(bare_target[number])
    if (moved := faults.board_moved_in_sweep) is not None:
        pose = known_number(moved.target_pose, poses, "target pose")
        from_visit = pose * sweep + known_number(moved.visit, range(sweep), "visit")
        later = slice(from_visit, (pose + 1) * sweep)
        target[later] = moved.shift.moved(bench.device_from_target[pose])
        tracked[2 * pose + 1] = target[later.stop - 1]
    if (slip := faults.headset_slipped) is not None:
        pose = known_number(slip.target_pose, poses, "target pose")
        from_visit = pose * sweep + known_number(slip.visit, range(sweep), "visit")
        now_from_before = transforms.inverse(slip.shift.moved(np.eye(4)))
        camera[from_visit:] = now_from_before @ camera[from_visit:]
        target[from_visit:] = now_from_before @ target[from_visit:]
        tracked[2 * pose + 1 :] = now_from_before @ tracked[2 * pose + 1 :]
    return BenchTruth(
        bench=bench,
        eyeball_at_target=tuple(bench.eyeball_focused(pose).camera for pose in poses),
        bare=_poses_of(visits.bare),
        see_through=camera,
        display=camera[: len(session.display)],
        bare_targets=bare_target,
        see_through_targets=target,
        tracking_targets=tracked,
    )


def _poses_of(visits: Sequence[Visit]) -> FloatArray:
    return np.array([visit.device_from_camera for visit in visits]).reshape(-1, 4, 4)


def known_number(number: int, numbers: range, kind: str) -> int:
    """Return the number, if a session has it.

    Raises:
        BadInputError: the session does not have it.
    """
    if number not in numbers:
        raise BadInputError(f"The fault is of {kind} {number}; the session has {numbers.start} to {numbers.stop - 1}.")
    return number
