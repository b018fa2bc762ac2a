"""Priors of the unknowns of a bench."""

from collections.abc import Mapping, Sequence
from itertools import product
from typing import Any

import numpy as np

from wlr_render import usual
from wlr_render.calibration.bench.bench_blocks import EXACT, FALL, LENS, POSE, Block, Key
from wlr_render.calibration.bench.board_shape import BOARD_SHAPE, BoardShape
from wlr_render.calibration.bench.board_views import EYEBALL, CameraSetup, KnownPose
from wlr_render.calibration.bench.state import AXIS_PARTS, SMOOTH_DEGREE, stated_twist
from wlr_render.captures.boards.board import BoardTolerances
from wlr_render.captures.photo_session import StageAxis
from wlr_render.geometry.lens import Lens
from wlr_render.geometry.lens_camera import LensCamera
from wlr_render.geometry.residual_lens import RESIDUAL, ResidualLens
from wlr_render.numerics.arrays import FloatArray

FLAT = 10.0
"""Prior size of an unknown without prior knowledge: radians, metres, per unit."""
TURNS = np.repeat([1.0, 0.0], 3)
"""Rotations among the six parts of a motion."""
_NO_HYPER: Mapping[str, Any] = {}
_POWERS = {"k1": 2, "k2": 4, "k3": 6, "k4": 2, "k5": 4, "k6": 6, "s2": 3, "s4": 3}
"""Power of the distance from the centre with which a term displaces, relative to that distance; 1 for the others."""
_HELD = ("k4", "k5", "k6", "s1", "s2", "s3", "s4")  # terms of perspective lenses that a residual field replaces
_LIKE_A_TURN = ("s1", "s3")  # terms that look like p1, p2 and a turn: a residual of 0.1 px turns the camera by 30'


def numbers_block(size: FloatArray, hyper: Mapping[str, Any] = _NO_HYPER, source: str = "") -> Block:
    """Return a block of numbers that are zero on an exact bench."""
    return Block(np.zeros(size.shape), size, np.zeros(size.shape), hyper, source)


def lens_block(name: str, lens: Lens, setup: CameraSetup) -> Block:
    """Return the block of the lens of a camera."""
    source = lens_source(name)
    if setup.calibrated is not None:
        known = np.zeros(len(lens.values)) if setup.calibrated_sigma is None else setup.calibrated_sigma
        return Block(lens, known, setup.calibrated.values, source=source, chart=LENS)
    sizes, hyper = np.full(len(lens.values), 0.3 * float(np.mean(lens.focal_px))), {}
    # A term may be as large as to displace the corner of the picture by its distance from the centre.
    corner = float(np.linalg.norm(0.5 * np.array(lens.size_px) / lens.focal_px))
    sizes[4:] = [
        EXACT if term in _LIKE_A_TURN else max(1.0, corner ** -_POWERS.get(term, 1)) for term in lens.names[4:]
    ]
    middle = np.where(np.arange(len(sizes)) < 4, np.nan, 0.0)
    if isinstance(lens, ResidualLens):
        held = np.isin(lens.names, _HELD) & (lens.kind != "fisheye")
        sizes[held], middle[held] = EXACT, lens.values[held]
        sizes[-lens.residual_px.size :] = np.repeat(lens.field.sizes, 2)
        hyper["residual"] = np.array(lens.names) == RESIDUAL
    return Block(lens, sizes, middle, hyper, source, LENS)


def lens_source(name: str) -> str:
    """Return the source of the errors of a camera's lens."""
    return "lens" if name == EYEBALL else "tracking camera"


def with_residual(lens: Lens, setup: CameraSetup) -> Lens:
    """Return a lens with a residual field for the fit to estimate; a stated lens stays as it is."""
    return ResidualLens.of(lens) if isinstance(lens, LensCamera) and setup.calibrated is None else lens


def shape_block(shape: BoardShape, tolerances: BoardTolerances) -> Block:
    """Return the block of the shape of a board."""
    size = np.zeros(len(shape.low))
    size[: len(BOARD_SHAPE)] = [tolerances.flatness_m] * 3 + [tolerances.scale_sigma] * 3
    if shape.fields is None:
        return numbers_block(size, source="board")
    height, printed = shape.fields
    end = len(BOARD_SHAPE) + len(height)
    size[len(BOARD_SHAPE) : end], size[end:] = height.sizes, np.tile(printed.sizes, 2)
    number = np.arange(len(size))
    return numbers_block(
        size, {"height": (number >= len(BOARD_SHAPE)) & (number < end), "print": number >= end}, "board"
    )


def pose_block(pose: FloatArray, known: KnownPose | None, source: str) -> Block:
    """Return the block of a pose (4, 4) with its prior."""
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


def stage_error_blocks(axes: Sequence[StageAxis]) -> dict[Key, Block]:
    """Return the blocks of the stage's smooth error; the linear motion of an axis is its twist's."""
    blocks: dict[Key, Block] = {}
    for (number, axis), degree in product(enumerate(axes), range(1, SMOOTH_DEGREE + 1)):
        sizes = np.ones(6)
        if degree == 1:
            sizes[slice(0 if axis.kind == "rotary" else 3, 6)] = EXACT
        hyper = {"smooth turn": TURNS, "smooth shift": 1.0 - TURNS, FALL: 1.0 - degree}
        blocks["smooth", number * SMOOTH_DEGREE + degree - 1] = numbers_block(sizes, hyper, "stage")
    return blocks
