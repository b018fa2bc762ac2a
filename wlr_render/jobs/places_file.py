"""Camera places as a CSV file: millimetres from the centre of the eye box, in the order to visit.

`plan` writes the file, and `simulate --places` reads it.
"""

from pathlib import Path

import numpy as np

from wlr_render.errors import BadInputError
from wlr_render.io.input_files import shown
from wlr_render.numerics.arrays import FloatArray
from wlr_render.tracking.text_rows import read_text_table

_COLUMNS = ("x_mm", "y_mm", "z_mm")
_ORDER_SEED = 1
_BEYOND = 1.05  # largest distance over the reach, which a plan of places to add takes from captures


def in_random_order(places: FloatArray) -> FloatArray:
    """Return the places (m, 3) in random order, so that drifts over time do not look like optics."""
    return np.asarray(places[np.random.default_rng(_ORDER_SEED).permutation(len(places))])


def places_csv(places: FloatArray) -> str:
    """Return places (m, 3) from the centre of the eye box, metres, as CSV, in random order."""
    rows = [",".join(f"{1e3 * each:.3f}" for each in place) for place in in_random_order(places)]
    return "\n".join([",".join(_COLUMNS), *rows]) + "\n"


def read_places(path: Path, reach_m: FloatArray, axes: str, most: int) -> FloatArray:
    """Read a file of places.

    Args:
        path: the file.
        reach_m: (3,) largest distance along each axis from the centre of the eye box that rays of the display reach.
        axes: axes of the stage that move, "xyz", "xy" or "x".
        most: largest number of places.

    Returns:
        Places (m, 3) from the centre of the eye box, millimetres, in the order of the file.

    Raises:
        BadInputError: the file is missing or has other columns or too many rows, a cell is not a number, or a place is
            beyond the stage or the reach.
    """
    table = read_text_table(path, "a list of places")
    header = table.header or table.rows[0].fields
    wanted = ",".join(_COLUMNS)
    if header != _COLUMNS:
        raise BadInputError(
            f"{path}: the columns are {shown(','.join(header))}; they must be {wanted}, as those of `wlr-render plan`."
        )
    if len(table.rows) > most:
        raise BadInputError(f"{path}: has {len(table.rows)} places; it must have at most {most}.")
    for row in table.rows:
        row.require_columns((3,), wanted)
        for name, value, reach in zip(_COLUMNS, row.numbers(0, 3), 1e3 * reach_m, strict=True):
            if value and name[0] not in axes:
                raise row.fail(f"{name} is {value:g}, but the stage {axes} does not move along {name[0]}; write 0.")
            if abs(value) > _BEYOND * reach:
                raise row.fail(
                    f"{name} is {value:g}; rays through the eye box end {reach:.3g} mm from its centre: is it in mm?"
                )
    return np.array([row.numbers(0, 3) for row in table.rows])
