"""Identified dots of a board in photographs, and the poses of one camera found from them."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field

import numpy as np

from wlr_render.calibration.poses import Pose
from wlr_render.captures.targets.board_sighting import BoardSighting
from wlr_render.captures.targets.dot_board import DotBoard
from wlr_render.geometry.lens_camera import LensCamera
from wlr_render.numerics.arrays import FloatArray

FEWEST_DOTS = 8
"""A pose has 6 unknowns; four dots are 8 readings, and twice that tells whether they are right."""


@dataclass(frozen=True, eq=False)
class BoardView:
    """Dots of a flat board in one photograph.

    Attributes:
        name: of the photograph, as messages should have it.
        point: (n, 3) dots, board frame, metres.
        pixel: (n, 2) where they are seen, from the outer corner of the top-left pixel.
        sigma_px: (n,) standard deviation of `pixel` per axis; only their ratios matter to poses.
    """

    name: str
    point: FloatArray
    pixel: FloatArray
    sigma_px: FloatArray

    @classmethod
    def of_sighting(cls, name: str, sighting: BoardSighting, board: DotBoard) -> "BoardView":
        """What was found of a board in the photograph `name`."""
        return cls(name, board.point_of(sighting.index), sighting.pixel, sighting.sigma_px)

    def __len__(self) -> int:
        return len(self.point)


@dataclass(frozen=True, eq=False)
class BoardPoses:
    """Where one camera saw the board, photograph by photograph.

    Attributes:
        camera: the lens that the poses were found with.
        names: n photographs.
        camera_from_board: (n, 4, 4).
        covariance: (6 n, 6 n) of small motions in the camera's frame, of all photographs together: an error of the
            camera's own values moves all poses at once.
        rms_px: (n,) rms distance per axis of dots from where the pose has them.
        set_aside: name -> reason, of photographs that gave no pose.
    """

    camera: LensCamera
    names: tuple[str, ...]
    camera_from_board: FloatArray
    covariance: FloatArray
    rms_px: FloatArray
    set_aside: Mapping[str, str] = field(default_factory=dict)

    def __len__(self) -> int:
        return len(self.names)

    def __getitem__(self, name: str) -> Pose:
        i = self.names.index(name)
        return Pose(self.camera_from_board[i], self.covariance[6 * i : 6 * i + 6, 6 * i : 6 * i + 6])

    def only(self, names: Sequence[str]) -> "BoardPoses":
        """The poses of some photographs, in the order of `names`."""
        index = np.array([self.names.index(name) for name in names], dtype=np.int64)
        rows = (6 * index[:, None] + np.arange(6)).ravel()
        return BoardPoses(
            self.camera,
            tuple(names),
            self.camera_from_board[index],
            self.covariance[np.ix_(rows, rows)],
            self.rms_px[index],
            self.set_aside,
        )
