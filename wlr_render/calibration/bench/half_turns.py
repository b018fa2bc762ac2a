"""The right way round of boards that look the same turned by 180 degrees, from the other photographs of the target.

Detection numbers the features of such a board from either end. All cameras count as upright except the tracking camera,
which has a known roll. The board's columns then run the same way in all photographs of one target pose.
"""

from collections.abc import Iterator
from dataclasses import replace
from itertools import chain
from pathlib import Path

import numpy as np

from wlr_render.captures.boards.board import Board, BoardObservation
from wlr_render.captures.photo_session import BoardPhotograph, PhotoSession
from wlr_render.captures.session_reading import Reading
from wlr_render.errors import BadInputError
from wlr_render.geometry import transforms
from wlr_render.numerics.arrays import FloatArray

_CLEAR = 0.5  # cosine of the angle between two directions of the columns from which they count as alike: 60 degrees


def with_half_turns(session: PhotoSession, reading: Reading) -> Reading:
    """Return the reading with the features of all photographs of a target pose numbered from the same end.

    Photographs for a camera's lens need no such choice: each has a pose of its own.

    Raises:
        BadInputError: a photograph shows the board rolled by 60 to 120 degrees from the others, or from the given pose.
    """
    boards: dict[Path, BoardObservation] = dict(reading.boards)
    along: dict[int, FloatArray] = {}
    for photo, to_device in _photographs(session):
        seen = reading.boards.get(photo.path)
        if seen is None or not seen.ambiguous_half_turn:
            continue
        board = session.board_of(photo.target_pose)
        columns = to_device @ np.append(_columns_in_image(board, seen), 0.0)
        columns = columns[:2] / np.linalg.norm(columns[:2])
        expected = along.setdefault(photo.target_pose, _expected(session, photo.target_pose, columns))
        alike = float(columns @ expected)
        if abs(alike) < _CLEAR:
            raise BadInputError(
                f"{photo.name}: the board looks the same turned by 180 degrees, and which way round it hangs at target "
                f"pose {photo.target_pose} is not clear, because its columns run at {np.degrees(np.arccos(alike)):.0f} "
                "degrees to the expected direction; keep cameras and board upright, or use a board that looks "
                "different when turned."
            )
        if alike < 0:
            boards[photo.path] = seen.half_turned(board)
    return replace(reading, boards=boards)


def _photographs(session: PhotoSession) -> Iterator[tuple[BoardPhotograph, FloatArray]]:
    """Photographs of targets, each with device_from_camera (3, 3) of a camera that looks ahead, or the tracking one."""
    for photo in chain(session.bare, session.beside, session.see_through):
        yield photo, transforms.OPENXR_FROM_OPENCV
    if session.device_from_tracking is not None:
        for photo in session.tracking:
            yield photo, session.device_from_tracking[:3, :3]


def _expected(session: PhotoSession, target: int, first: FloatArray) -> FloatArray:
    """(2,) unit vector, device frame, along the board's columns at a target pose.

    Where the pose is not given, the turn of the target is free, and is that of its first photograph.
    """
    given = session.targets.get(target)
    if given is not None:
        return np.asarray(given.device_from[:2, 0] / np.linalg.norm(given.device_from[:2, 0]))
    return np.array([1.0, 0.0]) if session.gauge_target == target else first


def _columns_in_image(board: Board, seen: BoardObservation) -> FloatArray:
    """(2,) direction in the image in which the columns' numbers grow."""
    place = board.point_of(seen.index)[:, :2]
    design = np.concatenate([place, np.ones((len(place), 1))], axis=1)
    return np.asarray(np.linalg.lstsq(design, seen.pixel, rcond=None)[0][0])
