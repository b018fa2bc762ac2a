"""Faults of a photographic session: moved parts and wrong records."""

from dataclasses import dataclass

import numpy as np

from wlr_render.geometry import transforms
from wlr_render.numerics.arrays import FloatArray


@dataclass(frozen=True)
class Shift:
    """A rigid motion in the axes of the device frame.

    Attributes:
        mm: displacement.
        deg: rotation vector, about the origin of the moved part.
    """

    mm: tuple[float, float, float] = (0.0, 0.0, 0.0)
    deg: tuple[float, float, float] = (0.0, 0.0, 0.0)

    def moved(self, pose: FloatArray) -> FloatArray:
        """Return the pose (4, 4) after the motion."""
        turn = transforms.rotations_of_vectors(np.deg2rad(self.deg))
        return transforms.rigid(turn @ pose[:3, :3], pose[:3, 3] + 1e-3 * np.array(self.mm))


@dataclass(frozen=True)
class BoardMove:
    """The target moved at one of its poses.

    Attributes:
        target_pose: pose at which the target moved.
        shift: motion of the target.
        visit: visit of the pose's sweep from which on the target is displaced; ignored by `Faults.board_moved`.
    """

    target_pose: int
    shift: Shift
    visit: int = 0


@dataclass(frozen=True)
class HeadsetSlip:
    """The headset moved on its mount, with its tracking camera.

    Attributes:
        target_pose: target pose in whose sweep the headset moved.
        visit: visit of that sweep from which on the headset is displaced.
        shift: motion of the headset.
    """

    target_pose: int
    visit: int
    shift: Shift


@dataclass(frozen=True)
class Exchange:
    """The readings of two entries of a list of session.toml were exchanged.

    Attributes:
        of: list, "bare", "see_through" or "display".
        first, second: numbers of the entries.
    """

    of: str
    first: int
    second: int


@dataclass(frozen=True)
class Faults:
    """Faults of a session; none by default.

    Attributes:
        board_moved: the target moved between its bare photographs and the photographs with the headset mounted.
        board_moved_in_sweep: the target moved during a sweep, before its tracking photograph.
        headset_slipped: the headset moved during a sweep. All later photographs, even at later target poses, are seen
            from the moved headset, except bare photographs.
        exchanged: readings exchanged in session.toml.
        axis_off_deg: deviation of the stage's y axis from its right angle to x.
    """

    board_moved: BoardMove | None = None
    board_moved_in_sweep: BoardMove | None = None
    headset_slipped: HeadsetSlip | None = None
    exchanged: Exchange | None = None
    axis_off_deg: float = 0.0


NO_FAULTS = Faults()
