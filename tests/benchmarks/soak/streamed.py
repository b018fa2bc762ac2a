"""Recorded wearers for streams, in files as a lab would have them."""

from collections.abc import Sequence
from pathlib import Path

import numpy as np

from benchmarks.soak.wearer import Wearer
from wlr_render.mappings import EyeBox
from wlr_render.numerics.arrays import FloatArray
from wlr_render.tracking.eye_trajectory_file import write_eye_trajectory
from wlr_render.tracking.trajectory import EyeTrajectory, ViewpointTrack

RATE_HZ = 100.0
BOX = EyeBox(np.array([0.001, -0.002, 0.01]), np.array([0.010, 0.008, 0.006]))


def recorded(
    path: Path,
    offsets_mm: FloatArray,
    lost: range | tuple[()] = (),
    eye: str = "right",
    centre: FloatArray = BOX.centre,
) -> Wearer:
    """A wearer whose pupil is at these places (n, 3) from the box's centre, a row every 10 ms but for the lost ones."""
    offsets_mm = np.asarray(offsets_mm, dtype=float)
    kept = np.setdiff1d(np.arange(len(offsets_mm)), lost)
    track = ViewpointTrack(kept / RATE_HZ, centre + 1e-3 * offsets_mm[kept])
    write_eye_trajectory(path, EyeTrajectory({eye: track}))
    return Wearer(eyes=path)


def fixations(*offsets_mm: Sequence[float], each: int = 4) -> FloatArray:
    """Places (n, 3): some rows at each fixation, with a jump between."""
    return np.repeat(np.array(offsets_mm, dtype=float), each, axis=0)
