"""Find a dot board in a photograph and identify its dots.

The map from lattice coordinates to pixels is smooth around each dot. It predicts where the dot should be, how large a
lattice cell is there, and the offset between the centre of a disc's picture and the picture of the disc's centre.
"""

import math
from dataclasses import dataclass

import numpy as np
from scipy.spatial import cKDTree

from wlr_render.captures.photographs import Photograph
from wlr_render.captures.targets.dot_board import BoardNotFoundError, BoardObservation, DotBoard
from wlr_render.captures.targets.dot_centres import MeasuredDots, measure_dots
from wlr_render.captures.targets.dot_detection import find_dots
from wlr_render.captures.targets.dot_identity import identify
from wlr_render.captures.targets.dot_lattice import LEAST_DOTS, DotLattice, link_lattices
from wlr_render.numerics.arrays import BoolArray, FloatArray, IntArray

_NEIGHBOURS = 24  # a 5 x 5 window without its middle
_POWERS = [(total - j, j) for total in range(4) for j in range(total + 1)]  # of x and y: 1, x, y, x^2, x y, y^2, ...
_STIFFNESS = 1e-3  # keeps second and third orders finite where a fragment is too narrow to show them

_LEAST_STIFFNESS = 1e-9  # of first orders: a row of dots alone has no slope across, and gets zero

_TRIES = 3  # lattices, the largest first, that are compared with the board
_OUTLIER_SPREADS = 6.0  # of the usual departure from the lattice
_OUTLIER_CELLS = 0.005  # of a cell's side; less is never an outlier
_LEAST_CELL = 0.05  # of the usual one; under a row of dots alone there are none
_LARGE_ARE_DARKEST = 75  # percentile of contrasts nearby: about the middle one of the large dots, blurred least


@dataclass(frozen=True, eq=False)
class LatticeShape:
    """Third-order maps around n dots, each fitted to its neighbours without itself.

    At the edge of a fragment all neighbours lie on one side; with second orders only, third ones would pass for them.

    Attributes:
        expected: (n, 2) pixel where the neighbours say that the dot is.
        doubt: (n,) standard deviation per axis of the dot's distance from there, for dots of unit noise.
        slope: (n, 2, 2) pixels (rows) per lattice unit (columns).
        curvature: (n, 2, 2, 2) second derivatives: of pixel, by lattice unit, by lattice unit.
        neighbour: (n, k) which dots were used.
    """

    expected: FloatArray
    doubt: FloatArray
    slope: FloatArray
    curvature: FloatArray
    neighbour: IntArray

    @property
    def cell_px2(self) -> FloatArray:
        """(n,) area of a lattice cell in the picture."""
        return np.asarray(np.abs(np.linalg.det(self.slope)))

    def centroid_shift(self, radius: FloatArray) -> FloatArray:
        """(n, 2) centre of area of a disc's picture less the picture of its centre, pixels.

        With f the map, J its slope and the disc's second moments radius^2 / 4 per axis: the integral of f |J| over the
        integral of |J|, to second order. For a plane seen in perspective it is what J. Heikkila, "Geometric camera
        calibration using circular control points", PAMI 22 (2000) 1066, corrects; lenses and optics are in it too.

        Args:
            radius: (n,) of the discs, lattice units.
        """
        growth = np.einsum("nlc,nckl->nk", np.linalg.inv(self.slope), self.curvature)  # of ln |J|
        mean_lift = 0.5 * np.einsum("nckk->nc", self.curvature)
        return np.asarray(0.25 * radius[:, None] ** 2 * (mean_lift + np.einsum("nck,nk->nc", self.slope, growth)))


def lattice_shape(index: IntArray, pixel: FloatArray) -> LatticeShape:
    """Fit a third-order map around each dot.

    Args:
        index: (n, 2) lattice coordinates, n >= 2.
        pixel: (n, 2) where they are seen.
    """
    near = cKDTree(index).query(index, min(_NEIGHBOURS + 1, len(index)))[1][:, 1:]
    x, y = np.moveaxis((index[near] - index[:, None, :]).astype(np.float64), -1, 0)
    basis = np.stack([x**i * y**j / (math.factorial(i) * math.factorial(j)) for i, j in _POWERS], axis=-1)
    held = np.diag([(0.0, _LEAST_STIFFNESS, _STIFFNESS, _STIFFNESS)[i + j] for i, j in _POWERS])
    transposed = np.swapaxes(basis, 1, 2)
    covariance = np.linalg.inv(transposed @ basis + held)
    term = covariance @ (transposed @ (pixel[near] - pixel[:, None, :]))
    slope = np.stack([term[:, 1], term[:, 2]], axis=-1)
    curvature = np.stack([np.stack([term[:, 3], term[:, 4]], -1), np.stack([term[:, 4], term[:, 5]], -1)], -1)
    return LatticeShape(pixel + term[:, 0], np.sqrt(1.0 + covariance[:, 0, 0]), slope, curvature, near)


def find_board(image: Photograph, board: DotBoard, name: str = "photograph") -> BoardObservation:
    """Find and identify the dots of a board in a photograph.

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
            return _identified(lattice, measured, board)
        except BoardNotFoundError as error:
            complaint = complaint or error
    raise BoardNotFoundError(f"{name}: {complaint}")


def _identified(lattice: DotLattice, measured: MeasuredDots, board: DotBoard) -> BoardObservation:
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
    return BoardObservation(
        index[order],
        pixel[order],
        measured.sigma_px[dot][order],
        unidentified=len(lattice) - int(on_board.sum()),
        disagreeing=int((on_board & ~agreeing).sum()),
    )


def _smooth_part(lattice: DotLattice, measured: MeasuredDots) -> tuple[DotLattice, LatticeShape]:
    """The dots that lie where their neighbours expect them, the worst taken out first.

    Raises:
        BoardNotFoundError: too few are left.
    """
    keep = np.isfinite(measured.sigma_px[lattice.dot])
    while True:
        lattice = DotLattice(lattice.dot[keep], lattice.index[keep])
        if len(lattice) < LEAST_DOTS:
            raise BoardNotFoundError(f"only {len(lattice)} dots in one piece were seen whole; show more of the board.")
        pixel = measured.dots.centre[lattice.dot]
        shape = lattice_shape(lattice.index, pixel)
        off = np.linalg.norm(pixel - shape.expected, axis=-1) / shape.doubt
        most = np.maximum(_OUTLIER_SPREADS * float(np.median(off)), _OUTLIER_CELLS * np.sqrt(shape.cell_px2))
        # An outlier makes its neighbours look like outliers too; only the worst of a neighbourhood goes.
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
