"""The window of Monado's compositor against our own map, position by position."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from wlr_render.errors import BadInputError
from wlr_render.exports.export_view import ExportedView
from wlr_render.numerics.arrays import FloatArray

EYE_CODES = {"left": 64, "right": 192}
"""Blue of each eye's picture, as painted by `session.py`; red is the position from the left, green from the top."""
_BLOCK = 40


@dataclass(frozen=True)
class PositionErrors:
    """Errors of the positions in one eye's picture along one axis, in codes: the picture is 255 wide and high.

    Attributes:
        eye: "left" or "right".
        axis: "across" or "down".
        window_px: (width, height) of the eye's part of the window.
        rms, mean, largest: statistics over its pixels; rounding to whole codes alone is 0.29 rms.
        largest_block_mean: largest mean of blocks of 40 x 40 pixels, in which rounding averages out.
        same_without_colours: statistics after the mean error of each code is subtracted, because the error of colour
            conversion depends on the code alone. A map error that depends on the code alone would be hidden too.
        reversed_rms: rms of the same window with its rows in reverse, to show that the comparison can fail.
    """

    eye: str
    axis: str
    window_px: tuple[int, int]
    rms: float
    mean: float
    largest: float
    largest_block_mean: float
    same_without_colours: float
    reversed_rms: float


def position_errors(screen: NDArray[np.uint8], fov: FloatArray, view: ExportedView) -> list[PositionErrors]:
    """Return the errors across and down.

    Args:
        screen: (height, width, 3) RGB.
        fov: (4,) angles of the left, right, upper and lower border of the eye's picture, as the OpenXR client gets
            them.
        view: the eye as it was exported.

    Raises:
        BadInputError: the screen does not show the eye's picture.
    """
    window = _window(screen, view.eye)
    height, width = window.shape[:2]
    u, v = (
        (np.arange(count) + 0.5) / count * size for count, size in zip((width, height), view.panel_size_px, strict=True)
    )
    rays = view.rays_at(view.middle_colour, np.stack(np.meshgrid(u, v), axis=-1))
    tangents = view.tangents(np.moveaxis(rays, -1, 0))
    left, right, up, down = np.tan(fov)
    expected = 255 * (tangents - [left, up]) / [right - left, down - up]
    return [_errors(view.eye, axis, window[..., k], expected[..., k]) for k, axis in enumerate(("across", "down"))]


def _window(screen: NDArray[np.uint8], eye: str) -> FloatArray:
    """Return red and green of an eye's part of the screen, (height, width, 2)."""
    shows = screen[..., 2] == EYE_CODES[eye]
    rows, columns = np.flatnonzero(shows.any(axis=1)), np.flatnonzero(shows.any(axis=0))
    if not len(rows):
        raise BadInputError(f"the screen does not show the {eye} eye's picture; see what monado-service printed.")
    part = slice(rows[0], rows[-1] + 1), slice(columns[0], columns[-1] + 1)
    if not shows[part].all():
        raise BadInputError(f"the {eye} eye's picture has holes on the screen; keep other windows off it.")
    return screen[part][..., :2].astype(np.float64)


def _errors(eye: str, axis: str, shown: FloatArray, expected: FloatArray) -> PositionErrors:
    (height, width), error, in_reverse = shown.shape, shown - expected, shown[::-1] - expected
    code = np.rint(expected).astype(np.int64).clip(0, 255)
    of_code = np.bincount(code.ravel(), error.ravel(), 256) / np.maximum(np.bincount(code.ravel(), minlength=256), 1)
    return PositionErrors(
        eye,
        axis,
        (width, height),
        float(np.sqrt(np.mean(error**2))),
        float(error.mean()),
        float(np.abs(error).max()),
        _largest_block_mean(error),
        _largest_block_mean(error - of_code[code]),
        float(np.sqrt(np.mean(in_reverse**2))),
    )


def _largest_block_mean(error: FloatArray) -> float:
    rows, columns = (size // _BLOCK for size in error.shape)
    blocks = error[: rows * _BLOCK, : columns * _BLOCK].reshape(rows, _BLOCK, columns, _BLOCK)
    return float(np.abs(blocks.mean(axis=(1, 3))).max())
