"""Read traces of the OSVR HDK 1.3 lens by its designers: screen position of each field angle, per eye relief."""

import re
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from scipy.spatial import Delaunay

from wlr_render.captures.correspondences import DisplayCaptures
from wlr_render.errors import BadInputError
from wlr_render.geometry.directions import dir_of_tangents
from wlr_render.io.input_files import as_bad_input, read_text, require_length
from wlr_render.mappings import EyeBox, Panel
from wlr_render.numerics.arrays import FloatArray

PIXEL_MM = 0.05
PANEL = Panel(1300, 1300)
"""Panel with pixels of 0.05 mm and the lens axis in the middle, for tables in millimetres from the axis."""

_LARGEST_SCREEN_MM = 500.0
_NAME = re.compile(r"(\d+(?:\.\d+)?)_mm_Eye_Relief")


@dataclass(frozen=True)
class LensTable:
    """One eye relief. field_deg: (n, 2) horizontal and vertical field angles; screen_mm: (n, 2) screen positions."""

    field_deg: FloatArray
    screen_mm: FloatArray


def read_osvr_hdk13(path: str | Path) -> LensTable:
    """Read one table of four columns; lines that report a ray error are left out.

    Raises:
        BadInputError: the file cannot be read, or a line is not four finite numbers.
    """
    lines = read_text(path, "a table of a lens").split("\n")
    kept = [line for line in lines if line.strip() and "error" not in line.lower()]
    with as_bad_input(path, "lines of four numbers"):
        rows = np.array([[float(word) for word in line.split()] for line in kept])
    if rows.ndim != 2 or rows.shape[1:] != (4,) or not np.isfinite(rows).all():
        raise BadInputError(f"{path}: must hold lines of four finite numbers, two angles and two millimetres.")
    if np.any(np.abs(rows[:, :2]) >= 90) or np.any(np.abs(rows[:, 2:]) > _LARGEST_SCREEN_MM):
        raise BadInputError(f"{path}: angles must be degrees below 90, and places millimetres of a screen; correct it.")
    return LensTable(rows[:, :2], rows[:, 2:])


def read_osvr_captures(folder: str | Path) -> DisplayCaptures:
    """Read all tables N_mm_Eye_Relief*.txt of a folder as captures of one display from N mm behind the lens.

    The device frame has its origin at the middle eye relief on the lens axis. Sigma is the rounding of angles and
    millimetres to the printed digits; the trace itself is exact. Field angles at which the picture folds over are
    omitted.

    Raises:
        BadInputError: the folder has fewer than two tables, or a table is faulty.
    """
    named = [(match, path) for path in sorted(Path(folder).glob("*.txt")) if (match := _NAME.match(path.name))]
    tables = sorted((float(match[1]), path) for match, path in named)
    if len(tables) < 2:
        raise BadInputError(f"{folder}: has {len(tables)} tables N_mm_Eye_Relief*.txt; two or more are needed.")
    reliefs = np.array([relief for relief, _ in tables])
    require_length(f"{folder}: the eye relief of a file name", 1e-3 * reliefs, 0.5)
    read = [_unfolded(path, read_osvr_hdk13(path)) for _, path in tables]
    counts = [len(table.field_deg) for table in read]
    field = np.concatenate([table.field_deg for table in read])
    screen = np.concatenate([table.screen_mm for table in read])
    along = 1e-3 * (reliefs - 0.5 * (reliefs[0] + reliefs[-1]))
    viewpoint = np.repeat(along[:, None] * [0.0, 0.0, 1.0], counts, axis=0)
    central = np.linalg.norm(field, axis=1) <= 5.0
    deg_per_mm = np.sqrt(np.sum(field[central] ** 2) / np.sum(screen[central] ** 2))
    rounding_deg = np.hypot(_rounding(field), deg_per_mm * _rounding(screen))
    return DisplayCaptures(
        device="osvr_hdk13",
        eye="right",
        eye_box=EyeBox(np.zeros(3), np.array([0.0, 0.0, float(np.ptp(along))])),
        panel=PANEL,
        viewpoint=viewpoint,
        view_dir=dir_of_tangents(np.tan(np.radians(field))),
        pixel=0.5 * PANEL.size_px + screen * [1.0, -1.0] / PIXEL_MM,
        capture=np.repeat(np.arange(len(read)), counts),
        sigma_arcmin=60.0 * np.sqrt(np.mean(rounding_deg**2, axis=1)),
    )


def _rounding(values: FloatArray) -> FloatArray:
    """Return the standard deviation of rounding to three digits; values below 1 count as 1, so that it is never 0."""
    exponent = np.floor(np.log10(np.maximum(np.abs(values), 1.0)))
    return np.asarray(10.0 ** (exponent - 2) / np.sqrt(12.0))


def _unfolded(path: Path, table: LensTable) -> LensTable:
    """Return the table without points next to a fold of the picture."""
    with as_bad_input(path, "field angles that cover an area"):
        corners = Delaunay(table.field_deg).simplices
    folded = _areas(table.screen_mm[corners]) * _areas(table.field_deg[corners]) <= 0.0
    kept = np.ones(len(table.field_deg), dtype=bool)
    kept[corners[folded]] = False
    return LensTable(table.field_deg[kept], table.screen_mm[kept])


def _areas(triangle: FloatArray) -> FloatArray:
    """Return twice the signed areas (t,) of triangles (t, 3, 2)."""
    first, second = triangle[:, 1] - triangle[:, 0], triangle[:, 2] - triangle[:, 0]
    return np.asarray(first[:, 0] * second[:, 1] - first[:, 1] * second[:, 0])
