"""Misalignment of drawn dots and real dots, from two photographs: display off and display on."""

from collections.abc import Set
from dataclasses import dataclass, fields
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from wlr_render.captures.boards.board import Board, BoardObservation
from wlr_render.captures.photographs import describe_pixels, read_photograph
from wlr_render.errors import BadInputError
from wlr_render.geometry.directions import arcmin_between
from wlr_render.lenses.lens import Lens
from wlr_render.numerics.arrays import FloatArray


@dataclass(frozen=True, eq=False)
class PairMisalignment:
    """Misalignment of the dots detected in both photographs.

    Attributes:
        index: (n, 2) column and row on the board.
        real_px: (n, 2) position of the real dot, camera pixels.
        virtual_px: (n, 2) position of the virtual dot.
        arcmin: (n,) angle between the two, as seen from the camera.
        sigma_arcmin: (n,) standard deviation of that angle along any one axis, from the noise of both photographs.
    """

    index: NDArray[np.int64]
    real_px: FloatArray
    virtual_px: FloatArray
    arcmin: FloatArray
    sigma_arcmin: FloatArray

    def __len__(self) -> int:
        return len(self.index)

    def only(self, dots: Set[tuple[int, int]]) -> "PairMisalignment":
        """Return the dots with these columns and rows."""
        kept = np.array([tuple(dot) in dots for dot in self.index.tolist()], dtype=bool)
        return PairMisalignment(*(getattr(self, field.name)[kept] for field in fields(self)))


def pair_misalignment(real: BoardObservation, virtual: BoardObservation, camera: Lens) -> PairMisalignment:
    """Match the dots of both photographs by their indices on the board, and omit dots detected in only one.

    Args:
        real: dots in the photograph with the display off.
        virtual: dots in the photograph with the display on, from the same position.
        camera: lens of the camera that took both.
    """
    place = {tuple(dot): row for row, dot in enumerate(virtual.index.tolist())}
    matched = [(row, place[tuple(dot)]) for row, dot in enumerate(real.index.tolist()) if tuple(dot) in place]
    first, second = np.array(matched, dtype=np.int64).reshape(-1, 2).T
    real_px, virtual_px = real.pixel[first], virtual.pixel[second]
    sigma_px = np.hypot(real.sigma_px[first], virtual.sigma_px[second])
    arcmin = arcmin_between(camera.dir_of_pixel(real_px), camera.dir_of_pixel(virtual_px))
    across = arcmin_between(camera.dir_of_pixel(real_px), camera.dir_of_pixel(real_px + [1.0, 0.0]))
    return PairMisalignment(real.index[first], real_px, virtual_px, arcmin, sigma_px * across)


@dataclass(frozen=True, eq=False)
class JudgedPair:
    """The misalignment in a pair of photographs.

    Attributes:
        name: camera position and target, in words.
        method: how the picture on the display was drawn.
        off, on: the photographs.
        misalignment: misalignment of their dots; None if they cannot be compared.
        complaint: reason why they cannot be compared, else empty.
    """

    name: str
    method: str
    off: Path
    on: Path
    misalignment: PairMisalignment | None
    complaint: str = ""


def judge_pair(name: str, method: str, photographs: tuple[Path, Path], board: Board, camera: Lens) -> JudgedPair:
    """Match the dots of two photographs.

    Args:
        name: camera position and target, in words.
        method: how the picture on the display was drawn.
        photographs: photographs with the display off, and on.
        board: the target.
        camera: lens of the camera that took both.

    Raises:
        BadInputError: a photograph cannot be read, its size differs from the camera's, or their bit depths differ.
    """
    off, on = photographs
    images = [read_photograph(path) for path in photographs]
    for path, image in zip(photographs, images, strict=True):
        if image.shape[::-1] != tuple(camera.size_px):
            raise BadInputError(
                f"{path}: is {describe_pixels(image)}, but its camera was calibrated for {camera.size_px[0]} x "
                f"{camera.size_px[1]}; take both photographs with the camera of the calibration."
            )
    if images[0].dtype != images[1].dtype:
        raise BadInputError(
            f"{on}: is {describe_pixels(images[1])}, {off.name} has another depth; take both in the same format."
        )
    try:
        real, virtual = (board.find(image, path.name) for path, image in zip(photographs, images, strict=True))
    except BadInputError as error:
        return JudgedPair(name, method, off, on, None, str(error))
    return JudgedPair(name, method, off, on, pair_misalignment(real, virtual, camera))
