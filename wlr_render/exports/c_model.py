"""A fitted headset as a binary file, with a C header that solves its rays for every pupil position."""

import struct
import zlib
from collections.abc import Iterator, Sequence
from pathlib import Path

import numpy as np

from wlr_render.errors import BadInputError
from wlr_render.exports.export_view import ExportedView
from wlr_render.exports.format import Capabilities, Format
from wlr_render.io.atomic_files import write_bytes, write_text
from wlr_render.mappings import is_planar, require_planar
from wlr_render.numerics.arrays import FloatArray, IntArray
from wlr_render.numerics.polynomial import Polynomial

HEADER = "wlr_render.h"
_MAGIC, _VERSION = b"wlrmodel", 1
_MOST_ORDER, _MOST_PRODUCTS = 31, 160
"""Largest order and number of products that the header reads."""
_ERROR_CELLS = 18, 16
"""Columns and rows over the panel for which predicted errors are stored: the cells of `budget.error_map`."""
_ERROR_PUPILS = 3
"""Pupil positions along each axis of the eye box for which predicted errors are stored."""
_UNKNOWN = -1.0


class CModel(Format):
    """The format `c`."""

    name = "c"
    title = "fitted model with a C header, for engines and plug-ins"
    holds = Capabilities(every_depth=True, every_pupil=True)
    endings = (".wlr",)
    convention = (
        "NAME.wlr: little-endian binary, version 1, with the polynomials of the fitted headset for every pupil "
        "position; docs/exports.md has a table of its bytes.",
        f"{HEADER}: functions in C99 and C++11 that read it, without other libraries. wlr_rays returns world rays of "
        "panel pixels, wlr_mesh a distortion mesh, wlr_pixel_of_point the pixel that shows a real point; each with a "
        "status and the predicted registration error in arcminutes.",
        "Lengths are metres in the device frame. The source camera of wlr_mesh is at the pupil unless you give another "
        "position; its axes and borders are in the file.",
        "Predicted errors are for points at infinity, without the errors of your trackers and of your drawing.",
    )
    use = (
        f"Include {HEADER} in one source file, and link libm. Compile it without -ffast-math.",
        'Once: `wlr_open("NAME.wlr", &model)` allocates; no later call does. Check that it returns WLR_OPENED.',
        "Each frame: `wlr_rays` or `wlr_mesh` with the pupil's position. Show black where the status is above "
        "WLR_OUTSIDE_FIT.",
    )

    def files(self, view: ExportedView) -> list[str]:
        """Return the names of the models of a view's colours and of the header that reads them."""
        return [*super().files(view), HEADER]

    def _write(self, view: ExportedView, colour: str, paths: Sequence[Path]) -> Iterator[Path]:
        yield write_bytes(paths[0], model_bytes(view, colour))
        yield write_text(paths[0].with_name(HEADER), Path(__file__).with_name(HEADER).read_text(encoding="utf-8"))


def model_bytes(view: ExportedView, colour: str) -> bytes:
    """Return the file of one colour.

    Raises:
        BadInputError: the headset is not a fitted planar model, or its polynomials are too long for the header.
    """
    eye, camera = view.mappings(colour), view.source.camera
    if not is_planar(eye):
        raise BadInputError(
            f"{eye.name}: the formats c and page hold planar models only; calibrate the headset, or choose another "
            "format, e.g. rays."
        )
    display, see_through = require_planar(eye)
    edges = np.stack([camera.tangent_min, camera.tangent_max], axis=1)
    planes = [np.array([each.place.z, *each.place.slope]) for each in (display, see_through)]
    numbers: list[FloatArray] = [
        eye.eye_box.centre,
        eye.eye_box.size,
        *planes,
        view.source.device_from_camera.ravel(),
        edges.ravel(),
    ]
    body = struct.pack("<3I", eye.eye == "right", *view.panel_size_px) + np.concatenate(numbers).astype("<f8").tobytes()
    body += b"".join(_polynomial(each.modelled, eye.name) for each in (display, see_through))
    errors = _square_errors(view, colour)
    body += struct.pack("<2I", *errors.shape[:2]) + errors.astype("<f8").tobytes()
    return _MAGIC + struct.pack("<2I", _VERSION, zlib.crc32(body)) + body


def _polynomial(polynomial: Polynomial, name: str) -> bytes:
    """Return a polynomial of four inputs as a table over products of the first two inputs and of the last two."""
    (heads, head), (tails, tail) = (_by_order(polynomial.orders[:, axes]) for axes in (slice(2), slice(2, 4)))
    if polynomial.orders.max() > _MOST_ORDER or max(len(heads), len(tails)) > _MOST_PRODUCTS:
        raise BadInputError(
            f"{name}: the format c holds polynomials of order {_MOST_ORDER} and {_MOST_PRODUCTS} products at most; "
            "calibrate with a lower --degree."
        )
    table = np.zeros((len(heads), len(tails), polynomial.outputs))
    table[head, tail] = polynomial.coefficients
    orders = np.concatenate([heads, tails]).astype("<u4")
    numbers = [polynomial.box.low, polynomial.box.high]
    counts = struct.pack("<2I", len(heads), len(tails))
    return counts + np.concatenate(numbers).astype("<f8").tobytes() + orders.tobytes() + table.astype("<f8").tobytes()


def _by_order(orders: IntArray) -> tuple[IntArray, IntArray]:
    """Return the distinct rows (n, 2), lowest total order first, and the row index of each term.

    In this order the coefficients of a product end at the total degree, and a reader skips the zeros.
    """
    rows, index = np.unique(orders, axis=0, return_inverse=True)
    place = np.argsort(rows.sum(axis=1), kind="stable")
    return rows[place], np.argsort(place).astype(np.int64)[index.reshape(-1)]


def _square_errors(view: ExportedView, colour: str) -> FloatArray:
    """Return predicted squared errors (rows, columns, z, y, x of the pupil) in square arcminutes; empty if unknown."""
    if not view.predictors:
        return np.zeros((0,) * 5)
    eye, unit = view.mappings(colour), np.linspace(-1.0, 1.0, _ERROR_PUPILS)
    columns, rows = _ERROR_CELLS
    pupils = eye.eye_box.at(np.stack(np.meshgrid(unit, unit, unit, indexing="ij"), axis=-1)[..., ::-1]).reshape(-1, 3)
    predict, pixel = view.predictors[view.colours.index(colour)], eye.display.panel.grid(columns, rows).reshape(-1, 2)
    errors = np.stack([predict(pupil, view.depth_m).at_pixel(pixel) for pupil in pupils], axis=-1)
    return np.nan_to_num(errors**2, nan=_UNKNOWN).reshape(rows, columns, *[_ERROR_PUPILS] * 3)
