"""Plausibility checks of the numbers in a model file."""

from collections.abc import Mapping

import numpy as np

from wlr_render.io.file_records import read_record
from wlr_render.io.input_files import require_eye_box, require_length
from wlr_render.io.toml_files import Table
from wlr_render.mappings import EyeBox, Panel
from wlr_render.numerics.polynomial import Box, Polynomial, basis

_FAR_M = 1.0  # largest distance of an eye box from the headset's origin
_STEEPEST = 100.0  # largest tangent or deviation: 89.4 degrees
_FARTHEST_PX = 1e6  # largest coordinate of a start pixel
_BESIDE = 0.5  # largest distance of pixels outside the panel, in panel sizes
_LEAST_SHARE = 0.1  # smallest share of a panel on each axis
_NARROWEST = 1e-3  # smallest range of a display's tangents: 3 arcminutes
# Points in the middle of a box (its corners may have no data): multiples of the powers of a root of g^6 = g + 1.
_INSIDE = 0.1 + 0.8 * np.mod(0.5 + np.arange(32)[:, None] * 1.1347241384015194 ** -np.arange(1.0, 6.0), 1.0)


def plausible_eye_box(table: Table) -> EyeBox:
    """Read an eye box; refuse a negative or large one, or one that is far away."""
    eye_box = read_record(EyeBox, table)
    require_length(f"{table.where}: 'centre_m'", eye_box.centre, _FAR_M)
    require_eye_box(f"{table.where}: 'size_m'", eye_box.size)
    return eye_box


def require_plausible_values(table: Table, polynomials: Mapping[str, Polynomial], panel: Panel | None) -> None:
    """Refuse polynomials that reach absurd values within their own boxes.

    Args:
        table: the mapping, for messages.
        polynomials: polynomials of the mapping, by name.
        panel: panel of a display, whose first polynomial must cover it with pixels.
    """
    display = next(iter(polynomials)) if panel else ""
    for name, part in polynomials.items():
        low, high = part.box.low, part.box.high
        others = np.abs([low[2:], high[2:]] if name == display else [low, high])
        if panel and name == display:
            _require_on_panel(table, name, part.box, panel)
        if others.max(initial=0.0) > _STEEPEST:
            raise table.fail(
                f"'{name}' has an input up to {others.max():g}, more than the plausible {_STEEPEST:g} (metres or "
                "tangents); calibrate again."
            )
        # The basis is evaluated directly, because a call first searches for the fastest order of summation.
        values = basis(low + (high - low) * _INSIDE[:, : len(low)], part.orders, part.box) @ part.coefficients
        most = _FARTHEST_PX if name == "backward_start" else _STEEPEST
        if not np.abs(values).max() <= most:
            raise table.fail(
                f"'{name}' reaches {np.abs(values).max():g} within its own box, more than the plausible {most:g}; "
                "calibrate again."
            )
        if name == display and np.ptp(values[:, :2], axis=0).min() < _NARROWEST:
            raise table.fail(f"'{name}' shows all pixels in one direction or on one line; calibrate again.")


def _require_on_panel(table: Table, name: str, box: Box, panel: Panel) -> None:
    """Refuse pixels, the first two inputs of every display's polynomial, that do not lie on the panel."""
    low, high = box.low[:2] / panel.size_px, box.high[:2] / panel.size_px
    if low.min() < -_BESIDE or high.max() > 1 + _BESIDE or (high - low).min() < _LEAST_SHARE:
        raise table.fail(
            f"'{name}' is fitted to pixels {box.low[:2].round(1).tolist()} to {box.high[:2].round(1).tolist()}, not to "
            f"a panel of {panel.width_px}x{panel.height_px}; correct [panel], or calibrate again."
        )
