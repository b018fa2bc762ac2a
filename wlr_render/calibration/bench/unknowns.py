"""What is known of the unknowns of a bench before the photographs are read."""

from collections.abc import Sequence

import numpy as np

from wlr_render import usual
from wlr_render.calibration.bench.bench_blocks import EXACT, LENS, POSE, Block
from wlr_render.calibration.bench.board_views import EYEBALL, CameraSetup, KnownPose
from wlr_render.calibration.bench.state import AXIS_PARTS, stated_twist
from wlr_render.captures.photo_session import StageAxis
from wlr_render.geometry.lens import Lens
from wlr_render.numerics.arrays import FloatArray

FLAT = 10.0
"""Prior size of what is not known beforehand: radians, metres, per unit."""
_DECAY = 0.5  # factor of the smooth error's size from one degree to the next: rails bend more than they wave
_POWERS = {"k1": 2, "k2": 4, "k3": 6, "k4": 2, "k5": 4, "k6": 6, "s2": 3, "s4": 3}
"""Power of the distance from the centre with which a term displaces, relative to that distance; 1 for the others."""


def numbers_block(size: FloatArray, hyper: Sequence[str] = (), source: str = "") -> Block:
    """Return a block of numbers that are zero on an exact bench."""
    return Block(np.zeros(size.shape), size, np.zeros(size.shape), hyper, source)


def lens_block(name: str, lens: Lens, setup: CameraSetup) -> Block:
    """Return the block of the lens of a camera."""
    source = "lens" if name == EYEBALL else "tracking camera"
    if setup.calibrated is not None:
        known = np.zeros(len(lens.values)) if setup.calibrated_sigma is None else setup.calibrated_sigma
        return Block(lens, known, setup.calibrated.values, source=source, chart=LENS)
    sizes = np.full(len(lens.values), 0.3 * float(np.mean(lens.focal_px)))
    # A term may be as large as to displace the corner of the picture by its distance from the centre.
    corner = float(np.linalg.norm(0.5 * np.array(lens.size_px) / lens.focal_px))
    sizes[4:] = [max(1.0, corner ** -_POWERS.get(name, 1)) for name in lens.names[4:]]
    middle = np.where(np.arange(len(sizes)) < 4, np.nan, 0.0)
    return Block(lens, sizes, middle, source=source, chart=LENS)


def pose_block(pose: FloatArray, known: KnownPose | None, source: str) -> Block:
    """Return the block of a pose (4, 4) and what is known of it."""
    if known is None:
        return Block(pose, np.full(6, FLAT), source=source, chart=POSE)
    return Block(pose, np.repeat(known.sigma, 3), known.pose, source=source, chart=POSE)


def axis_block(axis: StageAxis, twist: FloatArray, base: FloatArray) -> Block:
    """Return the block of an axis with a twist (6,), with its scale known along it, and its direction's sigma across.

    Args:
        axis: as stated. twist: (6,). base: (4, 4) device_from_camera in the first mounting.
    """
    stated = stated_twist(axis, base)
    sizes = np.full(6, FLAT)
    if axis.kind == "linear":
        sizes[:3] = EXACT
    if axis.direction is not None:
        along = stated[AXIS_PARTS[axis.kind]] ** 2
        sigma = usual.STAGE_DIRECTION_RAD.value if axis.direction_sigma is None else axis.direction_sigma
        sizes[AXIS_PARTS[axis.kind]] = np.sqrt(usual.STAGE_SCALE.value**2 * along + sigma**2 * (1.0 - along))
    if axis.direction is not None and axis.pivot is not None:
        sizes[3:] = usual.STAGE_PIVOT_M.value
    return Block(twist, sizes, source="stage")


def smooth_block(order: Sequence[int], axes: Sequence[StageAxis]) -> Block:
    """Return the block of one term of the smooth error; the linear motion of an axis is its twist's."""
    sizes = np.full(6, _DECAY ** (sum(order) - 1))
    if sum(order) == 1:
        moved = next(axis for axis, each in zip(axes, order, strict=True) if each)
        sizes[slice(0 if moved.kind == "rotary" else 3, 6)] = EXACT
    return numbers_block(sizes, ["smooth turn"] * 3 + ["smooth shift"] * 3, "stage")
