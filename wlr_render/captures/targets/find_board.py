"""From a photograph to identified dots."""

import numpy as np

from wlr_render.captures.photographs import Photograph
from wlr_render.captures.targets.board_sighting import BoardNotFoundError, BoardSighting
from wlr_render.captures.targets.dot_board import DotBoard
from wlr_render.captures.targets.dot_centres import MeasuredDots, measure_dots
from wlr_render.captures.targets.dot_detection import find_dots
from wlr_render.captures.targets.dot_identity import identify
from wlr_render.captures.targets.dot_lattice import LEAST_DOTS, Lattice, link_lattices
from wlr_render.captures.targets.lattice_shape import LatticeShape, lattice_shape
from wlr_render.numerics.arrays import BoolArray, FloatArray, IntArray

_TRIES = 3  # lattices, the largest first, that are compared with the board
_OUTLIER_SPREADS = 6.0  # of the usual departure from the lattice
_OUTLIER_CELLS = 0.005  # of a cell's side; less is never an outlier
_LEAST_CELL = 0.05  # of the usual one; under a row of dots alone there are none
_LARGE_ARE_DARKEST = 75  # percentile of contrasts nearby: about the middle one of the large dots, blurred least


def find_board(image: Photograph, board: DotBoard, name: str = "photograph") -> BoardSighting:
    """Find the dots of a board in a photograph and tell which they are.

    Dots whose size is not as printed, or which lie beside the lattice of their neighbours, are left out and counted.

    Args:
        image: (h, w) grey, of any exposure.
        board: what was printed.
        name: of the photograph, for the complaint.

    Raises:
        BoardNotFoundError: the board is not in the picture or too little of it, another board is, the picture is
            mirrored, or it is too dark or too bright to show anything.
    """
    dots = find_dots(image)
    lattices = link_lattices(dots)
    if not lattices:
        raise BoardNotFoundError(f"{name}: {_why_nothing(image, len(dots))}")
    complaint: BoardNotFoundError | None = None
    lattices = lattices[:_TRIES]
    measured = measure_dots(image, dots, np.concatenate([lattice.dot for lattice in lattices]))
    for lattice in lattices:
        try:
            return _sighting(lattice, measured, board)
        except BoardNotFoundError as error:
            complaint = complaint or error
    raise BoardNotFoundError(f"{name}: {complaint}")


def _sighting(lattice: Lattice, measured: MeasuredDots, board: DotBoard) -> BoardSighting:
    """Identify one lattice.

    Raises:
        BoardNotFoundError: the sentence lacks the photograph's name.
    """
    smooth, shape = _smooth_part(lattice, measured)
    dot = smooth.dot
    is_large = _large(measured, dot, shape, board)
    index = identify(smooth.index, is_large, board.large)

    on_board = np.all((index >= 0) & (index < [board.columns, board.rows]), axis=-1)
    diameter = board.diameter_of(np.where(on_board[:, None], index, 0))
    agreeing = on_board & (is_large == (diameter == board.large_m))
    pixel = measured.dots.centre[dot] - shape.centroid_shift(0.5 * diameter / board.pitch_m)
    order = np.nonzero(agreeing)[0]
    order = order[np.lexsort(index[order].T)]
    return BoardSighting(
        index[order],
        pixel[order],
        measured.sigma_px[dot][order],
        unidentified=len(lattice) - int(on_board.sum()),
        disagreeing=int((on_board & ~agreeing).sum()),
    )


def _smooth_part(lattice: Lattice, measured: MeasuredDots) -> tuple[Lattice, LatticeShape]:
    """The dots that lie where their neighbours expect them, the worst taken out first.

    Raises:
        BoardNotFoundError: too few are left.
    """
    keep = np.isfinite(measured.sigma_px[lattice.dot])
    while True:
        lattice = Lattice(lattice.dot[keep], lattice.index[keep])
        if len(lattice) < LEAST_DOTS:
            raise BoardNotFoundError(f"only {len(lattice)} dots in one piece were seen whole; show more of the board.")
        pixel = measured.dots.centre[lattice.dot]
        shape = lattice_shape(lattice.index, pixel)
        off = np.linalg.norm(pixel - shape.expected, axis=-1) / shape.doubt
        most = np.maximum(_OUTLIER_SPREADS * float(np.median(off)), _OUTLIER_CELLS * np.sqrt(shape.cell_px2))
        # A stray dot makes its neighbours look stray too; only the worst of a neighbourhood goes.
        keep = (off <= most) | (off < off[shape.neighbour].max(axis=1))
        keep &= shape.cell_px2 > _LEAST_CELL * float(np.median(shape.cell_px2))
        if keep.all():
            return lattice, shape


def _large(measured: MeasuredDots, dot: IntArray, shape: LatticeShape, board: DotBoard) -> BoolArray:
    """(k,) which dots are large: by area over the area of a lattice cell, which no view of the board changes."""
    contrast = measured.contrast[dot]
    nearby = np.concatenate([contrast[:, None], contrast[shape.neighbour]], axis=1)
    area: FloatArray = measured.darkness_px2[dot] / np.percentile(nearby, _LARGE_ARE_DARKEST, axis=1)
    between = 0.25 * np.pi * board.large_m * board.small_m / board.pitch_m**2
    return np.asarray(area / shape.cell_px2 > between)


def _why_nothing(image: Photograph, dots: int) -> str:
    low, high = np.percentile(image, [1, 99])
    if high == image.max() > 0.5 * np.iinfo(image.dtype).max and np.mean(image == high) > 0.5:
        return f"most of the picture is at its brightest value, {high:.0f}; expose it less."
    return (
        f"no board is in the picture: {dots} dark spots were seen, no {LEAST_DOTS} of them on a lattice, among grey "
        f"values from {low:.0f} to {high:.0f}; expose it more, or show more of the board."
    )
