"""Calibration boards: flat targets with identifiable features at known positions.

Board frame: x right along the columns, y down along the rows, z into the board, origin in the middle of the features'
grid (OpenCV's axes, as a camera sees a board that hangs upright before it). Metres. A feature's index is its
(column, row), whole numbers from the top left, for every kind of board.
"""

from abc import ABC, abstractmethod
from dataclasses import dataclass, replace
from typing import Annotated, Any

import numpy as np
from numpy.typing import NDArray

from wlr_render.captures.boards.lattice_shape import Discs
from wlr_render.captures.photographs import Photograph
from wlr_render.errors import BadInputError
from wlr_render.io.file_records import LENGTH, Key, scaled
from wlr_render.numerics.arrays import FloatArray, IntArray
from wlr_render.usual import BOARD_DOT_M, BOARD_FLATNESS_M, BOARD_SCALE

RealArray = NDArray[np.floating[Any]]


MIRRORED = "the picture is mirrored; photograph the board directly, or switch the camera's mirroring off."
"""Error message for a mirrored picture of a board."""


class BoardNotFoundError(BadInputError):
    """Error for a photograph of no board, too little of it, or another board; the message states the reason."""


@dataclass(frozen=True)
class BoardTolerances:
    """Tolerances of the print: standard deviations that an adjustment uses as prior.

    Attributes:
        scale_sigma: relative standard deviation of the scale, independent along x and y: printers scale.
        flatness_m: standard deviation of the board's bow and twist, at its edge.
        print_error_m: standard deviation of the positions of single features, per axis.
    """

    scale_sigma: Annotated[float, Key(least=0, most=0.5)] = BOARD_SCALE.value
    flatness_m: Annotated[float, Key("flatness_mm", LENGTH, least=0, most=100, digits=9)] = BOARD_FLATNESS_M.value
    print_error_m: Annotated[float, Key("print_error_um", scaled(1e-6), least=0, most=10_000, digits=6)] = (
        BOARD_DOT_M.value
    )


USUAL_TOLERANCES = BoardTolerances()
"""Tolerances of a board printed on paper and glued to a plate."""


@dataclass(frozen=True, eq=False)
class BoardObservation:
    """Features of a board identified in one photograph.

    Attributes:
        index: (n, 2) column and row of each feature on the board.
        pixel: (n, 2) positions of the features, camera pixels from the outer corner of the top-left pixel; for a dot
            its *centre*, without the bias of a perspective view of a disc.
        sigma_px: (n,) estimated standard deviation of `pixel` per axis.
        ambiguous_half_turn: True if the board looks the same after a half turn, so that the indices may belong to the
            turned board; `half_turned` has the alternative.
        discs: discs of the dots, from which `pixel` is recomputed once the lens is known; None for corners.
    """

    index: IntArray
    pixel: FloatArray
    sigma_px: FloatArray
    ambiguous_half_turn: bool = False
    discs: Discs | None = None

    def only(self, rows: NDArray[np.bool_]) -> "BoardObservation":
        """Return the features selected by a mask (n,)."""
        discs = None if self.discs is None else self.discs.only(rows)
        return replace(self, index=self.index[rows], pixel=self.pixel[rows], sigma_px=self.sigma_px[rows], discs=discs)

    def half_turned(self, board: "Board") -> "BoardObservation":
        """Return the same features, numbered as on the board turned by 180 degrees."""
        all_indices = board.indices()
        return replace(self, index=all_indices.min(axis=0) + all_indices.max(axis=0) - self.index)

    def __len__(self) -> int:
        return len(self.index)


@dataclass(frozen=True, eq=False)
class BoardLayout:
    """Layout of a board.

    Attributes:
        features: (2,) numbers of columns and rows of its features.
        pitch_m: distance of neighbouring features.
        size_m: (2,) width and height of the board with its margin.
        finest_m: size of the smallest printed shape.
        title: kind, numbers and sizes in words, for the printed board.
    """

    features: IntArray
    pitch_m: float
    size_m: FloatArray
    finest_m: float
    title: str


class Board(ABC):
    """A calibration board: its features, its appearance, and its detection in a photograph.

    Attributes:
        tolerances: tolerances of the print relative to the board file.
    """

    tolerances: BoardTolerances

    @property
    @abstractmethod
    def _layout(self) -> BoardLayout: ...

    @property
    def size_m(self) -> FloatArray:
        """(2,) width and height of the board with its margin."""
        return self._layout.size_m

    @property
    def title(self) -> str:
        """Kind, numbers and sizes in words, for the printed board."""
        return self._layout.title

    @property
    def finest_m(self) -> float:
        """Size of the smallest printed shape."""
        return self._layout.finest_m

    @property
    def half_turn_symmetric(self) -> bool:
        """True if the board looks the same turned by 180 degrees."""
        return False

    def indices(self) -> IntArray:
        """Return (column, row) of all features, (n, 2), row by row."""
        return grid_indices(*self._layout.features)

    def point_of(self, index: NDArray[np.integer]) -> FloatArray:
        """Return the positions (..., 3), metres in the board frame, of features by (column, row), (..., 2)."""
        layout = self._layout
        return flat_points((np.asarray(index) - 0.5 * (layout.features - 1)) * layout.pitch_m)

    @abstractmethod
    def reflectance(self, in_board: RealArray, softness_m: RealArray | float = 0.0) -> RealArray:
        """Return the reflectance at positions (..., 2), x and y: 1 white, 0 black, NaN beyond the board's edge.

        Args:
            in_board: (..., 2) metres, board frame.
            softness_m: (...) width by which edges are blurred, e.g. a camera pixel's footprint.
        """

    @abstractmethod
    def svg_shapes(self) -> list[str]:
        """Return the SVG elements of the black shapes, in millimetres from the board's top left corner."""

    def find(self, image: Photograph, name: str = "photograph") -> BoardObservation:
        """Find and identify the board's features in a photograph.

        Args:
            image: (h, w) grey, of any exposure.
            name: name of the photograph, for the error.

        Raises:
            BoardNotFoundError: the picture shows no board, too little of it or another board, or it is mirrored, too
                dark or too bright.
        """
        try:
            return self._find(image)
        except BoardNotFoundError as error:
            raise BoardNotFoundError(f"{name}: {error}") from error

    @abstractmethod
    def _find(self, image: Photograph) -> BoardObservation:
        """Find the board as in `find`, with errors that lack the photograph's name."""


def grid_indices(columns: int, rows: int) -> IntArray:
    """Return (column, row) of a whole grid, (columns * rows, 2), row by row."""
    column, row = np.meshgrid(np.arange(columns), np.arange(rows))
    return np.stack([column, row], axis=-1).reshape(-1, 2)


def flat_points(in_plane: FloatArray) -> FloatArray:
    """Return positions (..., 3) with z = 0 from x and y, (..., 2)."""
    return np.concatenate([in_plane, np.zeros((*in_plane.shape[:-1], 1))], axis=-1)
