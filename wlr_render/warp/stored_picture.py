"""Storage conventions of submitted pictures: encoding of colours, kind of depth, and row order."""

from dataclasses import dataclass
from enum import Enum, auto
from functools import cached_property
from numbers import Real
from typing import Any, Literal, get_args

import numpy as np
from numpy.typing import NDArray

from wlr_render.errors import BadInputError
from wlr_render.io.input_files import shown

Encoding = Literal["srgb", "linear"]
"""Meaning of a colour's numbers: sRGB codes, or linear light."""

_CODE_BITS = 8, 10, 12, 16


@dataclass(frozen=True)
class StoredColour:
    """Storage convention of a picture's colours.

    Attributes:
        encoding: "srgb" codes, or "linear" light, which is 1 where all primaries are at full power; larger and negative
            numbers are kept, and clipped on output. Numbers of float arrays and textures are codes over the largest
            code, or light. A texture of an sRGB format holds sRGB codes; as "linear" light it is read as decoded by
            OpenGL.
        bits: bits of a code: 8, 10, 12 or 16, needed for uint16 arrays and for RGB10_A2 textures given as ModernGL
            textures. Pictures of 8 bits are kept in 8 bits, others in half floats.
        alpha: whether the fourth component is the picture's alpha. Then colours are premultiplied, in linear light, and
            composed frames have the filtered alpha, with 0 where the picture is not visible.

    Raises:
        BadInputError: another encoding or number of bits, or `alpha` is neither True nor False.
    """

    encoding: Encoding = "srgb"
    bits: int = 8
    alpha: bool = False

    def __post_init__(self) -> None:
        if self.encoding not in get_args(Encoding):
            raise BadInputError(f"encoding is {shown(self.encoding)}; choose from {', '.join(get_args(Encoding))}.")
        if isinstance(self.bits, bool) or self.bits not in _CODE_BITS:
            raise BadInputError(f"bits is {shown(self.bits)}; choose from {', '.join(map(str, _CODE_BITS))}.")
        if not isinstance(self.alpha, bool):
            raise BadInputError(f"alpha is {shown(self.alpha)}; give True or False.")


CODES, PREMULTIPLIED = StoredColour(), StoredColour(alpha=True)


class DepthKind(Enum):
    """Kinds of stored depth; all are measured along the camera's -z axis."""

    METRES = auto()
    """Metres; 0, infinity or NaN for background, as in pyrender's arrays."""
    WINDOW = auto()
    """Depth-buffer value in 0..1 of a perspective projection; the far plane's value means background."""
    INVERSE = auto()
    """1/m; 0, infinity or NaN for background."""


_DEPTH_STEP = 2.0**-16  # step of the coarsest depth format, which rounds the ends of a range

NEAREST_M = 1e-4
"""Nearest depth in a picture, and nearest near plane. The warp divides by depths in float32."""


class Rows(Enum):
    """The row of an array or a texture that comes first in memory."""

    TOP_FIRST = auto()
    BOTTOM_FIRST = auto()


@dataclass(frozen=True)
class StoredDepth:
    """Storage convention of a depth image.

    Attributes:
        kind: kind of the stored numbers.
        near_m, far_m: for WINDOW, the distances stored as `min_depth` and `max_depth`; `far_m` may be infinite. For a
            reversed depth buffer they are exchanged: (inf, 0.05) stores the near plane as 1.
        min_depth, max_depth: for WINDOW, the range of glDepthRange or of a Vulkan or Direct3D viewport; with the
            distances as in XrCompositionLayerDepthInfoKHR. Values outside the range are background, and so are values
            within a step of a 16-bit format of a far plane that is neither 0 nor 1.

    Raises:
        BadInputError: WINDOW without two different distances of at least `NEAREST_M`, one of them finite, or a range
            that is not within 0 and 1 and ascends.
    """

    kind: DepthKind = DepthKind.METRES
    near_m: float = 0.0
    far_m: float = np.inf
    min_depth: float = 0.0
    max_depth: float = 1.0

    def __post_init__(self) -> None:
        if not isinstance(self.kind, DepthKind):
            raise BadInputError(f"{self.kind!r} is not a kind of depth; give one of {', '.join(map(str, DepthKind))}.")
        if self.kind is DepthKind.WINDOW:
            check_planes(self.near_m, self.far_m)
            if not (_are_numbers(self.min_depth, self.max_depth) and 0 <= self.min_depth < self.max_depth <= 1):
                raise BadInputError(
                    f"min_depth is {shown(self.min_depth)} and max_depth is {shown(self.max_depth)}: give the smaller "
                    "and the larger end of the depth range, from 0 to 1; a reversed buffer exchanges near_m and far_m."
                )
        elif (self.near_m, self.far_m, self.min_depth, self.max_depth) != (0.0, np.inf, 0.0, 1.0):
            raise BadInputError(
                f"near_m = {shown(self.near_m)}, far_m = {shown(self.far_m)}, min_depth and max_depth are used with "
                "DepthKind.WINDOW only; leave them out, or give that kind."
            )

    @cached_property
    def inverse_of_0_and_1(self) -> tuple[float, float]:
        """Inverse depths (1/m) of stored values 0 and 1, for WINDOW and INVERSE; extrapolated from a depth range."""
        if self.kind is not DepthKind.WINDOW:
            return 0.0, 1.0
        slope = (1 / self.far_m - 1 / self.near_m) / (self.max_depth - self.min_depth)
        return 1 / self.near_m - slope * self.min_depth, 1 / self.far_m + slope * (1 - self.max_depth)

    @property
    def nothing(self) -> float:
        """Stored number for background, in addition to NaN; for INVERSE also 0, the inverse depth of infinity."""
        if self.kind is DepthKind.WINDOW:
            return self.min_depth if self.near_m > self.far_m else self.max_depth
        return 0.0 if self.kind is DepthKind.METRES else np.inf

    @property
    def _range_of_surfaces(self) -> tuple[float, float]:
        """The depth range, shifted by a step towards near at both ends, which a depth format may round."""
        nearer = _DEPTH_STEP if self.near_m > self.far_m else -_DEPTH_STEP
        low = 0.0 if self.min_depth == 0 else max(0.0, self.min_depth + nearer)
        high = 1.0 if self.max_depth == 1 else min(1.0, self.max_depth + nearer)
        return low, high

    @cached_property
    def limits(self) -> tuple[np.float32, np.float32]:
        """Smallest and largest stored number of a surface."""
        largest = np.finfo(np.float32).max
        ends: dict[DepthKind, tuple[float, float]] = {
            DepthKind.METRES: (NEAREST_M, float(largest)),
            DepthKind.WINDOW: self._range_of_surfaces,
            DepthKind.INVERSE: (0.0, 1 / NEAREST_M),
        }
        low, high = ends[self.kind]
        return np.float32(low), np.float32(high)


METRES = StoredDepth()


def check_planes(near_m: float, far_m: float) -> None:
    """Check the distances of a projection's near and far plane; they may be exchanged, and one may be infinite.

    Raises:
        BadInputError: they are not two different distances of at least `NEAREST_M`.
    """
    planes: tuple[object, object] = near_m, far_m
    if not _are_numbers(*planes) or not (near_m >= NEAREST_M and far_m >= NEAREST_M and near_m != far_m):
        raise BadInputError(
            f"near_m is {shown(near_m)} and far_m is {shown(far_m)}: give two different positive distances of "
            f"{NEAREST_M:g} m or more, from the projection that draws the depth."
        )


def _are_numbers(*values: object) -> bool:
    return all(isinstance(each, Real) and not isinstance(each, bool) for each in values)


def check_colour_array(colour: NDArray[Any], stored: StoredColour) -> None:
    """Check that an array is (height, width, 3 or 4) of a type that `stored` allows.

    Raises:
        BadInputError: wrong shape or type, codes larger than their bits allow, or a number that is not finite.
    """
    if str(colour.dtype) not in COLOUR_TYPES or colour.ndim != 3 or colour.shape[2] not in (3, 4):
        raise BadInputError(
            f"The colours must be (height, width, 3 or 4) of {', '.join(COLOUR_TYPES)}, not {colour.shape} of "
            f"{colour.dtype}."
        )
    if stored.alpha and colour.shape[2] == 3:
        raise BadInputError("The colours have three components and no alpha: give four, or StoredColour(alpha=False).")
    if (colour.dtype == np.uint8) != (stored.bits == 8) and colour.dtype.kind == "u":
        raise BadInputError(
            f"The colours are {colour.dtype}, and StoredColour has bits={stored.bits}: give uint8 for 8 bits, and "
            "uint16 for 10, 12 or 16."
        )
    largest = (1 << stored.bits) - 1
    if colour.dtype == np.uint16 and colour.max(initial=0) > largest:
        raise BadInputError(
            f"The colours reach {colour.max()}, and codes of {stored.bits} bits {largest}: give such codes, or their "
            "bits."
        )
    if colour.dtype.kind == "f" and not np.isfinite(colour).all():
        row, column = np.argwhere(~np.isfinite(colour).all(axis=-1))[0]
        raise BadInputError(f"The colour at row {row}, column {column} is not finite: give finite numbers.")


COLOUR_TYPES = {"uint8": "f1", "uint16": "nu2", "float16": "f2", "float32": "f4"}
"""Types of colour arrays, and formats of the textures that hold them."""


def check_depth_format(stored: StoredDepth) -> None:
    """Check the stated encoding of a depth image in a depth format.

    Raises:
        BadInputError: the encoding is metres, the default; such a format holds depth-buffer values from 0 to 1.
    """
    if stored.kind is DepthKind.METRES:
        raise BadInputError(
            "the depth has a depth format, which holds no metres; say what 0 and 1 stand for with "
            "stored=StoredDepth(DepthKind.WINDOW, near, far)."
        )


def check_arrays(
    colour: NDArray[Any],
    depth: NDArray[Any] | None,
    stored: StoredDepth,
    size: tuple[int, int],
    stored_colour: StoredColour = CODES,
) -> None:
    """Check that arrays are a picture of a size (width, height): colour (height, width, 3 or 4), depth (height, width).

    The depth may be None if the picture needs no depth.

    Raises:
        BadInputError: wrong shape, type or size, or a depth outside 0 to 1 for WINDOW, else outside
            `StoredDepth.limits`.
    """
    check_colour_array(colour, stored_colour)
    if depth is not None and (depth.dtype != np.float32 or depth.ndim != 2):
        raise BadInputError(f"The depth must be (height, width) of float32, not {depth.shape} of {depth.dtype}.")
    for name, verb, array in (("colours", "have", colour), ("depth", "has", depth)):
        if array is not None and array.shape[:2] != size[::-1]:
            raise BadInputError(
                f"The {name} {verb} {array.shape[1]}x{array.shape[0]} pixels, the camera {size[0]}x{size[1]}: draw "
                "with that camera."
            )
    if depth is None:
        return
    low, high = (np.float32(0), np.float32(1)) if stored.kind is DepthKind.WINDOW else stored.limits
    outside = depth < low  # False for NaN
    if stored.kind is not DepthKind.METRES:
        outside |= depth > high
    outside &= depth != np.float32(stored.nothing)
    if outside.any():
        row, column = np.argwhere(outside)[0]
        raise BadInputError(
            f"The depth at row {row}, column {column} is {depth[row, column]}: depths in {stored.kind.name} run from "
            f"{low:g} to {high:g}, and {stored.nothing:g} and NaN are background; give such depths, or their kind."
        )
