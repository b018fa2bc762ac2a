"""Grids of equal dark circles, in rows or staggered, detected as a whole."""

from dataclasses import dataclass
from typing import Annotated

import numpy as np
import scipy
from numpy.typing import NDArray

from wlr_render.captures.boards.board import (
    USUAL_TOLERANCES,
    Board,
    BoardLayout,
    BoardNotFoundError,
    BoardObservation,
    BoardTolerances,
    RealArray,
    flat_points,
)
from wlr_render.captures.boards.board_keys import MARGIN, MOST_FEATURES, BoardLength
from wlr_render.captures.boards.dot_centres import measure_dots
from wlr_render.captures.boards.dot_lattice import LEAST_DOTS, find_dots, link_lattices
from wlr_render.captures.boards.lattice_shape import Discs, smooth_rows
from wlr_render.captures.photographs import Photograph
from wlr_render.io.file_records import ELSEWHERE, Key
from wlr_render.numerics.arrays import BoolArray, FloatArray, IntArray

_TRIES = 3  # number of largest lattices that are compared with the grid
_OTHER_DIAMETER = 1.5  # largest ratio to the stated diameter; a radius stated as diameter has 2
_QUARTER = np.array([[0, 1], [-1, 0]])


@dataclass(frozen=True, eq=False)
class CircleGrid(Board):
    """A grid of dark circles on white.

    Attributes:
        columns: circles in a row.
        rows: number of rows.
        pitch_m: distance of neighbouring rows and, in a grid that is not staggered, of columns. In a staggered grid
            (OpenCV's asymmetric one) the circles of a row have twice this distance, and every second row, from the
            second on, is shifted right by the pitch.
        diameter_m: diameter of a circle.
        margin_m: white from the outermost circles' centres to the edge.
        staggered: True if every second row is shifted.
        tolerances: tolerances of the print.
    """

    columns: Annotated[int, Key(least=2, most=MOST_FEATURES)]
    rows: Annotated[int, Key(least=3, most=MOST_FEATURES)]
    pitch_m: Annotated[float, BoardLength("pitch")]
    diameter_m: Annotated[float, BoardLength("diameter")]
    margin_m: Annotated[float, MARGIN]
    staggered: Annotated[bool, ELSEWHERE] = False
    tolerances: BoardTolerances = USUAL_TOLERANCES

    @property
    def _extent(self) -> IntArray:
        """Width and height (2,) between the outermost centres, in pitches."""
        width = 2 * self.columns - 1 if self.staggered else self.columns - 1
        return np.array([width, self.rows - 1])

    @property
    def _layout(self) -> BoardLayout:
        return BoardLayout(
            np.array([self.columns, self.rows]),
            self.pitch_m,
            size_m=np.asarray(self._extent * self.pitch_m + 2 * self.margin_m),
            finest_m=self.diameter_m,
            title=f"{'staggered ' if self.staggered else ''}circle grid {self.columns} x {self.rows}, pitch "
            f"{1e3 * self.pitch_m:g} mm, circles {1e3 * self.diameter_m:g} mm",
        )

    @property
    def half_turn_symmetric(self) -> bool:
        """True except for staggered grids with an odd number of rows."""
        return not self.staggered or self.rows % 2 == 0

    def _pitches(self, index: NDArray[np.integer]) -> IntArray:
        """Return the positions (..., 2), in pitches, from the top left."""
        index = np.asarray(index, dtype=np.int64)
        if not self.staggered:
            return np.asarray(index, dtype=np.int64)
        return np.asarray(np.stack([2 * index[..., 0] + index[..., 1] % 2, index[..., 1]], axis=-1), dtype=np.int64)

    def point_of(self, index: NDArray[np.integer]) -> FloatArray:
        """Return the centres (..., 3), board frame, by (column, row), (..., 2)."""
        return flat_points((self._pitches(index) - 0.5 * self._extent) * self.pitch_m)

    @property
    def _lattice(self) -> FloatArray:
        """Matrix (2, 2) from positions in pitches to positions in the square lattice of the circles."""
        return np.array([[0.5, -0.5], [0.5, 0.5]]) if self.staggered else np.eye(2)

    def reflectance(self, in_board: RealArray, softness_m: RealArray | float = 0.0) -> RealArray:
        """Return the reflectance; see `Board.reflectance`."""
        place = in_board / self.pitch_m + 0.5 * self._extent
        nearest = np.rint(np.nan_to_num(place) @ self._lattice) @ np.linalg.inv(self._lattice)
        x, y = np.rint(nearest[..., 0]), np.rint(nearest[..., 1])
        column = (x - y % 2) / 2 if self.staggered else x
        there = (column >= 0) & (column < self.columns) & (y >= 0) & (y < self.rows)
        from_centre = self.pitch_m * np.linalg.norm(place - nearest, axis=-1)
        beyond_edge = np.where(there, from_centre - 0.5 * self.diameter_m, np.inf)
        with np.errstate(divide="ignore", invalid="ignore"):
            ramp = np.clip(beyond_edge / softness_m + 0.5, 0.0, 1.0)
        white = np.where(np.asarray(softness_m) > 0, ramp, beyond_edge > 0)
        inside = (np.abs(in_board) <= 0.5 * self.size_m).all(axis=-1)
        return np.where(inside, white, np.nan).astype(in_board.dtype)

    def svg_shapes(self) -> list[str]:
        """Return the circles as SVG elements."""
        centre_mm = 1e3 * (self.point_of(self.indices())[:, :2] + 0.5 * self.size_m)
        return [f'<circle cx="{x:.4f}" cy="{y:.4f}" r="{500.0 * self.diameter_m:.4f}"/>' for x, y in centre_mm]

    def _find(self, image: Photograph) -> BoardObservation:
        """Find the board; all circles must be in the picture."""
        dots = find_dots(image)
        most = 0
        for lattice in link_lattices(dots)[:_TRIES]:
            most = max(most, len(lattice))
            placed = self._placed(lattice.index)
            if placed is None:
                continue
            index, dot = placed[0], lattice.dot[placed[1]]
            measured = measure_dots(image, dots, dot)
            whole = np.nonzero(np.isfinite(measured.sigma_px[dot]))[0]
            along = self._pitches(index) @ self._lattice
            unit = self.pitch_m * (np.sqrt(2.0) if self.staggered else 1.0)
            rows, shape = smooth_rows(along[whole], measured.dots.centre[dot[whole]], LEAST_DOTS)
            if shape is None:
                continue
            keep = whole[rows]
            # Blur reduces the contrast of small circles: their area lies between the values for black and for the
            # measured contrast.
            black = measured.darkness_px2[dot[keep]] / shape.cell_px2
            least_m, most_m = (
                unit * float(np.sqrt(4 / np.pi * np.median(area)))
                for area in (black, black / measured.contrast[dot[keep]])
            )
            if least_m > _OTHER_DIAMETER * self.diameter_m or most_m < self.diameter_m / _OTHER_DIAMETER:
                raise BoardNotFoundError(
                    f"the circles seen have diameters of {1e3 * least_m:.2g} to {1e3 * most_m:.2g} mm, where "
                    f"board.toml has {1e3 * self.diameter_m:g}; correct the diameter or the pitch."
                )
            discs = Discs(measured.dots.centre[dot[keep]], np.full(len(keep), 0.5 * self.diameter_m))
            pixel = discs.centroid - shape.centroid_shift(discs.radius_m / unit)
            order = np.lexsort(index[keep].T)
            return BoardObservation(
                index[keep][order],
                pixel[order],
                measured.sigma_px[dot[keep]][order],
                ambiguous_half_turn=self.half_turn_symmetric,
                discs=discs.only(order),
            )
        raise BoardNotFoundError(
            f"no {self.title} is in the picture: {len(dots)} dark spots were seen, {most} of them "
            "on one lattice; show all of its circles, and check the numbers in board.toml."
        )

    def _placed(self, lattice: IntArray) -> tuple[IntArray, IntArray] | None:
        """Return the index (n, 2) and the lattice's dot (n,) of each circle; None if the grid does not fit.

        Raises:
            BoardNotFoundError: further circles continue the grid.
        """
        index = self.indices()
        shifted = np.rint(self._pitches(index) @ self._lattice).astype(np.int64)
        shifted -= shifted.min(axis=0)
        for turns in range(4):
            turned = lattice @ np.linalg.matrix_power(_QUARTER, turns)
            turned = turned - turned.min(axis=0)
            if (turned.max(axis=0) < shifted.max(axis=0)).any():
                continue
            there = _occupied(turned)
            fits = np.argwhere(np.rint(scipy.signal.correlate(there, _occupied(shifted), mode="valid")) == len(shifted))
            extra = len(turned) - len(shifted)
            if len(fits) > 1 or (len(fits) == 1 and extra >= 0.5 * min(self.columns, self.rows)):
                raise BoardNotFoundError(
                    f"the grid seen has more circles than board.toml says ({self.columns} x {self.rows}): "
                    f"{len(turned)} lie on its lattice; count them."
                )
            if len(fits) == 1:
                which = np.full(there.shape, -1)
                which[turned[:, 0], turned[:, 1]] = np.arange(len(turned))
                at = shifted + fits[0]
                return index, which[at[:, 0], at[:, 1]]
        return None


def _occupied(place: IntArray) -> FloatArray:
    """Return an array (m, n) with 1 where a position of the lattice is occupied."""
    taken: BoolArray = np.zeros(place.max(axis=0) + 1, dtype=bool)
    taken[place[:, 0], place[:, 1]] = True
    return taken.astype(np.float64)
