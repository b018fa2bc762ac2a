"""Read traces of the OSVR HDK 1.3 lens by its designers: screen position of each field angle, per eye relief."""

from dataclasses import dataclass
from pathlib import Path

import numpy as np

from wlr_render.errors import BadInputError
from wlr_render.numerics.arrays import FloatArray


@dataclass(frozen=True)
class LensTable:
    """One eye relief. field_deg: (n, 2) horizontal and vertical field angles; screen_mm: (n, 2) where they fall."""

    field_deg: FloatArray
    screen_mm: FloatArray


def read_osvr_hdk13(path: str | Path) -> LensTable:
    """Read one table of four columns; lines that speak of a ray error are left out.

    Raises:
        BadInputError: the file cannot be read, or a line is not four finite numbers.
    """
    try:
        lines = Path(path).read_text(encoding="utf-8").splitlines()
    except (OSError, UnicodeDecodeError) as error:
        raise BadInputError(f"{path}: cannot be read as text ({error}).") from error
    kept = [line for line in lines if line.strip() and "error" not in line.lower()]
    try:
        rows = np.array([[float(word) for word in line.split()] for line in kept])
    except ValueError as error:
        raise BadInputError(f"{path}: holds a line that is not four numbers ({error}).") from error
    if rows.ndim != 2 or rows.shape[1:] != (4,) or not np.isfinite(rows).all():
        raise BadInputError(f"{path}: must hold lines of four finite numbers, two angles and two millimetres.")
    return LensTable(rows[:, :2], rows[:, 2:])


def relief_swim_arcmin_per_mm(near: LensTable, far: LensTable, moved_mm: float, radius_deg: float) -> float:
    """Rms change of direction per millimetre of eye relief, over field angles within `radius_deg`.

    The change on the screen is turned into an angle by the near table's scale within 5 degrees of the axis.

    Raises:
        BadInputError: the tables share no field angles there.
    """
    # The files print angles with two decimals: equal text is equal bits.
    match = (near.field_deg[:, None] == far.field_deg[None]).all(axis=-1)
    first, second = np.nonzero(match)
    inside = np.linalg.norm(near.field_deg[first], axis=1) <= radius_deg
    central = np.linalg.norm(near.field_deg, axis=1) <= 5.0
    if not inside.any() or not central.any():
        raise BadInputError(
            f"the two tables share no field angles within {radius_deg:g} degrees; take two of one lens."
        )
    mm_per_deg = np.sqrt(np.sum(near.screen_mm[central] ** 2) / np.sum(near.field_deg[central] ** 2))
    change = np.linalg.norm(far.screen_mm[second] - near.screen_mm[first], axis=1)[inside]
    return float(np.sqrt(np.mean(change**2)) / mm_per_deg * 60.0 / moved_mm)
