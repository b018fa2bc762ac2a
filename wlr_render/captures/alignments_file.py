"""A wearer's alignments: pixels that covered real points, in a TOML file."""

from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from wlr_render.captures.capture_checks import require_on_panel
from wlr_render.errors import BadInputError
from wlr_render.io.input_files import prefix_errors, require_eye_box, require_length, require_pixels
from wlr_render.io.toml_files import read_toml
from wlr_render.mappings import EyeBox, Panel
from wlr_render.numerics.arrays import BoolArray, FloatArray

FORMAT, VERSION = "wlr-alignments", 1
_DEVICE_M, _WORLD_M, _NEAREST_M = 10.0, 100.0, 0.1


@dataclass(frozen=True, eq=False)
class Alignments:
    """Alignments of one eye of one wearer, device frame, metres.

    Attributes:
        path: the file. device: name of the headset. eye: "left" or "right".
        panel: the panel.
        eye_box: the region that contains the eye; its position within the region is unknown.
        pixel: (n, 2) pixels.
        point: (n, 3) real point that each pixel covered.
        time_s: (n,) increasing times; None if not recorded.
    """

    path: Path
    device: str
    eye: str
    panel: Panel
    eye_box: EyeBox
    pixel: FloatArray
    point: FloatArray
    time_s: FloatArray | None = None

    def select(self, rows: BoolArray) -> "Alignments":
        """Return the alignments selected by a mask (n,)."""
        time_s = None if self.time_s is None else self.time_s[rows]
        return replace(self, pixel=self.pixel[rows], point=self.point[rows], time_s=time_s)


def is_alignments(path: Path) -> bool:
    """Return whether a file has alignments, or states their `format`."""
    try:
        table = read_toml(path) if path.suffix.lower() == ".toml" and path.is_file() else None
        return table is not None and (table.has("alignment") or table.text("format", "") == FORMAT)
    except BadInputError:
        return False


def load_alignments(path: str | Path) -> Alignments:
    """Read a file of alignments; docs/files.md has the format.

    Raises:
        BadInputError: a key is missing, unknown or implausible; the message names it.
    """
    table = read_toml(path)
    table.check_head(FORMAT, VERSION)
    table.text("frame", choices=["openxr"])
    device, eye = table.text("device"), table.text("eye", choices=["left", "right"])
    width, height = table.vector("panel_px", 2, least=1)
    box = table.table("eye_box")
    eye_box = EyeBox(box.vector("centre_m", 3), box.vector("size_m", 3))
    box.finish()
    rows = table.tables("alignment", most=1000)
    pixel = np.array([each.vector("pixel", 2) for each in rows])
    point = np.array([each.vector("point_m", 3) for each in rows])
    timed = [each.has("time_s") for each in rows]
    times = [each.number("time_s") for each, has_time in zip(rows, timed, strict=True) if has_time]
    time_s = np.array(times) if all(timed) else None
    for each in rows:
        each.finish()
    table.finish()
    require_pixels(path, (width, height), "correct 'panel_px'")
    with prefix_errors(Path(path)):
        require_eye_box("'eye_box'", eye_box.size)
        require_length("'eye_box'", eye_box.centre, _DEVICE_M)
        require_length("'point_m'", point, _WORLD_M)
        require_on_panel(pixel, (width, height))
        _require_single(pixel, point)
        near = eye_box.centre[2] - point[:, 2]
        if near.min() < _NEAREST_M:
            number = int(np.argmin(near)) + 1
            raise BadInputError(
                f"[[alignment]] {number} has its point {near.min():.3g} m in front of the eye box (towards -z), and "
                f"{_NEAREST_M:g} m is the least; give it in the device frame, in metres."
            )
        if time_s is not None and np.any(np.diff(time_s) <= 0):
            raise BadInputError("'time_s' does not rise from one [[alignment]] to the next; give them in their order.")
        if any(timed) and time_s is None:
            raise BadInputError("'time_s' is given for some alignments only; give it for all, or for none.")
    return Alignments(Path(path), device, eye, Panel(int(width), int(height)), eye_box, pixel, point, time_s)


def _require_single(pixel: FloatArray, point: FloatArray) -> None:
    """Refuse copies of an alignment, which a fit would use as independent measurements."""
    first: dict[tuple[float, ...], int] = {}
    for number, values in enumerate(map(tuple, np.hstack([pixel, point]).tolist()), 1):
        if (same := first.setdefault(values, number)) != number:
            raise BadInputError(f"[[alignment]] {number} is a copy of [[alignment]] {same}; remove it.")
