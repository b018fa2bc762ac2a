"""Format of a camera's files: conversion of stored values to linear grey values, and saturation."""

from dataclasses import dataclass, replace
from pathlib import Path
from typing import Annotated, Any

import cv2
import numpy as np
from numpy.typing import NDArray

from wlr_render.errors import BadInputError
from wlr_render.io.delimited_text import with_commas
from wlr_render.io.file_records import ELSEWHERE, Key, read_part, record_keys
from wlr_render.io.input_files import as_bad_input, read_text
from wlr_render.io.toml_files import Table

StoredValues = NDArray[np.unsignedinteger[Any]]

CHANNELS = ("grey", "red", "green", "blue")
MOSAICS = {
    "rggb": cv2.COLOR_BAYER_RGGB2RGB,
    "grbg": cv2.COLOR_BAYER_GRBG2RGB,
    "gbrg": cv2.COLOR_BAYER_GBRG2RGB,
    "bggr": cv2.COLOR_BAYER_BGGR2RGB,
}
_LUMA = np.array([0.299, 0.587, 0.114])  # weights of ITU-R BT.601, as in cv2.COLOR_RGB2GRAY
_LINEARISED = 65535  # full scale of linearised values, finer than any camera's


@dataclass(frozen=True)
class PhotographFormat:
    """Conversion of a camera's files to linear values of one channel, uint8 or uint16.

    Saturated pixels, and no others, have the value `full_scale`. Saturation is tested in the stored values,
    channel by channel, before colours are mixed and before linearisation.

    Attributes:
        bits: bits of the camera, 8 to 16.
        saturation: smallest stored value that counts as saturated, right-justified; None: the largest value of `bits`.
        left_justified: True if values of less than 16 bits fill the upper bits of 16. None: True where all lower bits
            of a picture are zero.
        black_level: stored value without light. It affects only `gamma` and merged exposures, because everything else
            uses differences of photographs.
        gamma: the stored value is proportional to light ** (1 / gamma).
        channel: channel of coloured files and mosaics: "grey", "red", "green" or "blue".
        mosaic: colours of the top-left 2 x 2 pixels of raw files, e.g. "rggb"; empty without a mosaic.
        linearisation: pairs (stored value, light), in increasing order; instead of `gamma`.
        linearisation_file: path of that table as session.toml names it.
        synthetic: True for pictures that no camera took, without saturation.
    """

    bits: Annotated[int, Key(least=8, most=16)]
    saturation: float | None = None
    left_justified: bool | None = None
    black_level: float = 0.0
    gamma: Annotated[float, Key(least=0.2, most=5)] = 1.0
    channel: Annotated[str, Key(choices=CHANNELS)] = "grey"
    mosaic: Annotated[str, Key(choices=("", *MOSAICS))] = ""
    linearisation: Annotated[tuple[tuple[float, float], ...], ELSEWHERE] = ()
    linearisation_file: Annotated[str, Key("linearisation")] = ""
    synthetic: bool = False

    def __post_init__(self) -> None:
        if not 0 <= self.black_level < self._largest:
            raise BadInputError(f"'black_level' is {self.black_level:g}; it must be 0 to {self._largest - 1}.")
        if self.saturation is not None and not self.black_level < self.saturation <= self._largest:
            raise BadInputError(
                f"'saturation' is {self.saturation:g}; it must be above the black level, {self.black_level:g}, and at "
                f"most {self._largest}."
            )
        if self.linearisation_file and self.gamma != 1.0:
            raise BadInputError("give either 'gamma' or 'linearisation'.")

    @property
    def full_scale(self) -> int:
        """Value of a saturated pixel after conversion."""
        if self.gamma != 1.0 or self.linearisation:
            return _LINEARISED
        return int(np.ceil(self._end))

    @property
    def end_of_scale(self) -> float:
        """Value from which a pixel counts as saturated; infinite for synthetic pictures."""
        return np.inf if self.synthetic else self.full_scale

    @property
    def _largest(self) -> int:
        return int(2**self.bits) - 1

    @property
    def _end(self) -> float:
        return self._largest if self.saturation is None else self.saturation

    @classmethod
    def from_table(cls, table: Table, root: Path = Path()) -> "PhotographFormat":
        """Read the keys of a camera's table (only `bits` is required); the caller calls `table.finish`.

        Args:
            table: e.g. [eyeball_camera] of session.toml.
            root: folder that the path of `linearisation` starts from.

        Raises:
            BadInputError: a value is out of range, keys exclude each other, or the linearisation cannot be read.
        """
        form = read_part(cls, table)
        if not form.linearisation_file:
            return form
        return replace(form, linearisation=_read_linearisation(table.path("linearisation", root)))

    def keys(self) -> dict[str, Any]:
        """Return the keys from which `from_table` reads the same format; defaults are left out."""
        return record_keys(self)

    def convert(self, stored: StoredValues, name: str) -> StoredValues:
        """Convert stored values to linear values of one channel.

        Args:
            stored: (h, w) grey or mosaic, or (h, w, 3) red, green, blue; uint8 or uint16.
            name: name of the file, for messages.

        Returns:
            (h, w) uint8 or uint16.

        Raises:
            BadInputError: the values do not fit the bits or the mosaic.
        """
        values, end = self._right_justified(stored, name)
        if self.mosaic:
            if values.ndim != 2:
                raise BadInputError(f"{name}: has colours already; remove 'mosaic' ({self.mosaic}) from its camera.")
            light, saturated = self._of_mosaic(values, end)
        elif values.ndim == 3:
            over = values >= end
            light = self._of_colours(self._linear(values))
            used = slice(None) if self.channel == "grey" else [CHANNELS.index(self.channel) - 1]
            saturated = np.asarray(over[..., used].any(axis=-1))
        elif self.channel != "grey":
            raise BadInputError(f"{name}: is grey; 'channel' is '{self.channel}': remove it, or state the 'mosaic'.")
        else:
            light, saturated = self._linear(values), values >= end
        full = self.full_scale
        if self.synthetic:
            return _rounded(light, full)
        linear = _rounded(light, full - 1)
        linear[saturated] = full
        return linear

    def _right_justified(self, stored: StoredValues, name: str) -> tuple[StoredValues, float]:
        """Return the values, right-justified if they fill the upper bits, and the smallest saturated value."""
        if 8 * stored.itemsize < self.bits:
            raise BadInputError(
                f"{name}: has {8 * stored.itemsize} bits a pixel, too few for a camera with values up to "
                f"{self._largest}; check its 'bits'."
            )
        shift = 8 * stored.itemsize - self.bits if stored.itemsize > 1 else 0
        if shift and (self.left_justified or (self.left_justified is None and is_left_justified(stored, self.bits))):
            stored = stored >> np.uint16(shift)
        end = self._end
        if stored.itemsize > 1 and self.bits == 16 and self.saturation is None and self.left_justified is not False:
            # 12-bit values in the upper bits of 16, stated as 16 bits: the largest is 65520.
            unused = next((n for n in range(8, 1, -1) if is_left_justified(stored, 16 - n)), 0)
            end = self._largest - (2**unused - 1)
        if (largest := int(stored.max(initial=0))) > self._largest:
            raise BadInputError(
                f"{name}: has values up to {largest}, beyond the camera's {self._largest}; check its 'bits'."
            )
        return stored, end

    def _linear(self, values: StoredValues) -> StoredValues:
        """Convert stored values to light, 0 to `full_scale`; linear values stay unchanged."""
        if not self.linearisation and self.gamma == 1.0:
            return values
        return _linear_table(self)[values]

    def _of_mosaic(self, values: StoredValues, end: float) -> tuple[StoredValues, NDArray[np.bool_]]:
        over = values >= end
        colours = cv2.cvtColor(self._linear(values), MOSAICS[self.mosaic])
        # Interpolation spreads a saturated pixel to its neighbours.
        spread = cv2.dilate(over.astype(np.uint8), np.ones((3, 3), np.uint8)).astype(bool)
        return self._of_colours(colours), spread

    def _of_colours(self, linear: StoredValues) -> StoredValues:
        """Return the channel (h, w) of linear red, green and blue (h, w, 3)."""
        if self.channel != "grey":
            return np.ascontiguousarray(linear[..., CHANNELS.index(self.channel) - 1])
        return np.asarray(np.rint(linear @ _LUMA), dtype=linear.dtype)


def is_left_justified(stored: StoredValues, bits: int) -> bool:
    """Return whether values of `bits` bits fill the upper bits of 16: all lower bits of the whole picture are zero."""
    if stored.itemsize != 2 or not 8 <= bits < 16:
        return False
    return not int(np.bitwise_or.reduce(stored, axis=None)) & (2 ** (16 - bits) - 1)


def _rounded(light: StoredValues, largest: int) -> StoredValues:
    """Return a copy clipped to `largest`."""
    return np.minimum(light, light.dtype.type(min(largest, np.iinfo(light.dtype).max)))


def _linear_table(kind: PhotographFormat) -> NDArray[np.uint16]:
    """Return the light (65536,), uint16, of each stored value: 0 at the black level, `full_scale` at saturation."""
    value = np.arange(65536.0)
    if kind.linearisation:
        stored, light = np.array(kind.linearisation).T
        light = np.interp(value, stored, light) - light[0]
        light /= np.interp(kind._end, stored, np.array(kind.linearisation)[:, 1]) - kind.linearisation[0][1]
    else:
        light = np.maximum((value - kind.black_level) / (kind._end - kind.black_level), 0) ** kind.gamma
    return np.asarray(np.rint(np.minimum(light, 1) * _LINEARISED), dtype=np.uint16)


def _read_linearisation(path: Path) -> tuple[tuple[float, float], ...]:
    """Read pairs (stored value, light) from two columns of a text file, or from one with the light of 0, 1, 2, ...

    Raises:
        BadInputError: the file is missing, does not hold numbers, or they do not increase.
    """
    kind = "a camera's linearisation"
    rows = [row for line in read_text(path, kind).split("\n") if (row := line.partition("#")[0].strip())]
    with as_bad_input(path, kind, "write numbers only"):
        numbers = np.loadtxt(with_commas(rows), delimiter=",", ndmin=2)
    if numbers.shape[1] == 1:
        numbers = np.column_stack([np.arange(len(numbers)), numbers])
    if numbers.shape[1] != 2 or len(numbers) < 2 or not np.all(np.isfinite(numbers)):
        raise BadInputError(f"{path}: must hold two columns, stored value and light, or one, the light of 0, 1, 2, ...")
    if np.any(np.diff(numbers, axis=0) < 0) or np.any(np.diff(numbers[:, 0]) == 0) or np.ptp(numbers[:, 1]) == 0:
        raise BadInputError(f"{path}: stored values must increase, and light must not decrease with them.")
    return tuple((float(value), float(light)) for value, light in numbers)
