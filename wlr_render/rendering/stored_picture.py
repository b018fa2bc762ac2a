"""Storage conventions of submitted pictures: kind of depth, and row order."""

from dataclasses import dataclass
from enum import Enum, auto
from typing import Any

import numpy as np
from numpy.typing import NDArray

from wlr_render.errors import BadInputError
from wlr_render.geometry.pinhole import Pinhole
from wlr_render.rendering.view import GeometryImage


class DepthKind(Enum):
    """Kinds of stored depth; all are measured along the camera's -z axis."""

    METRES = auto()
    """Metres; 0 or infinity for background, as in pyrender's arrays."""
    WINDOW = auto()
    """A depth buffer's value in 0..1 of a perspective projection; nothing is where it has the far plane's value."""
    INVERSE = auto()
    """1/m; 0 for background."""


class Rows(Enum):
    """Which row of an array or a texture comes first in memory."""

    TOP_FIRST = auto()
    BOTTOM_FIRST = auto()


@dataclass(frozen=True)
class StoredDepth:
    """Storage convention of a depth image.

    Attributes:
        kind: of number.
        near_m, far_m: for WINDOW, the distances stored as 0 and as 1; `far_m` may be infinite. For a reversed depth
            buffer they change places: (inf, 0.05) stores the near plane as 1.

    Raises:
        BadInputError: WINDOW without two different positive distances, one of them finite.
    """

    kind: DepthKind = DepthKind.METRES
    near_m: float = 0.0
    far_m: float = np.inf

    def __post_init__(self) -> None:
        if not isinstance(self.kind, DepthKind):
            raise BadInputError(f"{self.kind!r} is not a kind of depth; give one of {', '.join(map(str, DepthKind))}.")
        if self.kind is DepthKind.WINDOW and not (self.near_m > 0 and self.far_m > 0 and self.near_m != self.far_m):
            raise BadInputError(
                f"Depth buffer values need two different positive distances, not near_m = {self.near_m} and "
                f"far_m = {self.far_m}: give those of the projection that drew them."
            )

    @property
    def inverse_of_0_and_1(self) -> tuple[float, float]:
        """1/m of the stored values 0 and 1, for WINDOW and INVERSE."""
        return (1 / self.near_m, 1 / self.far_m) if self.kind is DepthKind.WINDOW else (0.0, 1.0)


def picture_of_arrays(
    camera: Pinhole, colour: NDArray[np.uint8], depth: NDArray[np.float32], stored: StoredDepth, rows: Rows
) -> GeometryImage:
    """Convert a picture in memory to a `GeometryImage`; `picture_import.PictureImport` is its twin on the GPU.

    Args:
        camera: drawn with.
        colour: (height, width, 3 or 4) sRGB; alpha is not read.
        depth: (height, width).
        stored: what `depth` holds.
        rows: their order, of both.

    Raises:
        BadInputError: shape, type or size is another, or a depth is negative or NaN.
    """
    check_arrays(colour, depth, (camera.width_px, camera.height_px))
    down = slice(None, None, 1 if rows is Rows.TOP_FIRST else -1)
    colour, depth = colour[down, :, :3], depth[down]
    if stored.kind is DepthKind.METRES:
        inverse = np.divide(1.0, depth, out=np.zeros_like(depth), where=depth > 0)
    else:
        at_0, at_1 = stored.inverse_of_0_and_1
        inverse = (1 - depth) * at_0 + depth * at_1
        inverse[(depth == (0 if at_0 < at_1 else 1)) | (inverse < 0)] = 0  # on the far plane, also if it is finite
    return GeometryImage(np.array(colour, order="C"), np.array(inverse, np.float32, order="C"))


def check_arrays(colour: NDArray[Any], depth: NDArray[Any], size: tuple[int, int]) -> None:
    """Check that arrays are a picture of a size (width, height).

    Raises:
        BadInputError: shape, type or size is another, or a depth is negative or NaN.
    """
    shape = size[1], size[0]
    if colour.dtype != np.uint8 or colour.ndim != 3 or colour.shape[2] not in (3, 4):
        raise BadInputError(
            f"The colours must be (height, width, 3 or 4) of uint8, not {colour.shape} of {colour.dtype}."
        )
    if depth.dtype != np.float32 or depth.ndim != 2:
        raise BadInputError(f"The depth must be (height, width) of float32, not {depth.shape} of {depth.dtype}.")
    for name, verb, found in (("colours", "have", colour.shape[:2]), ("depth", "has", depth.shape)):
        if found != shape:
            raise BadInputError(
                f"The {name} {verb} {found[1]}x{found[0]} pixels, the camera {size[0]}x{size[1]}: draw with that "
                "camera."
            )
    if not (depth >= 0).all():
        row, column = np.argwhere(~(depth >= 0))[0]
        raise BadInputError(
            f"The depth at row {row}, column {column} is {depth[row, column]}: it must be 0 (nothing) or positive."
        )
