"""Accuracy of a headset's eye tracker on people (jemr2022-vr-eyetracking, Journal of Eye Movement Research 2022)."""

import csv
import gzip
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from wlr_render.errors import BadInputError
from wlr_render.numerics.arrays import FloatArray


@dataclass(frozen=True)
class GazeErrors:
    """One row per shown target, both eyes combined; tracker glitches that the authors marked are left out.

    Attributes:
        error_deg: (n,) angle between gaze and target.
        offset_deg: (n, 2) gaze minus target, right and up.
        scatter_deg: (n,) standard deviation of the gaze while it rested on the target.
    """

    error_deg: FloatArray
    offset_deg: FloatArray
    scatter_deg: FloatArray


def read_gaze_errors(folder: str | Path) -> GazeErrors:
    """Read all `data_targets_*.csv.gz` (tab separated) of a folder.

    Raises:
        BadInputError: the folder has no such file, or a file cannot be read or lacks a column.
    """
    paths = sorted(Path(folder).glob("data_targets_*.csv.gz"))
    if not paths:
        raise BadInputError(f"{folder}: holds no data_targets_*.csv.gz; give the folder of the set.")
    rows = np.array([row for path in paths for row in _rows(path)]).reshape(-1, 4)
    rows = rows[np.isfinite(rows).all(axis=1)]
    if len(rows) == 0:
        raise BadInputError(f"{folder}: no row is marked 'valid' and complete; download the set again.")
    return GazeErrors(rows[:, 0], rows[:, 1:3], rows[:, 3])


def _rows(path: Path) -> list[list[float]]:
    try:
        with gzip.open(path, "rt", encoding="utf-8") as text:
            table = list(csv.DictReader(text, delimiter="\t"))
        valid = [row for row in table if row["outlier_reason"] == "valid"]
        return [[float(row[key] or "nan") for key in ("acc", "offX", "offY", "sd")] for row in valid]
    except (OSError, EOFError, UnicodeDecodeError) as error:
        raise BadInputError(f"{path}: is not a readable gzip file ({error}); download it again.") from error
    except KeyError as error:
        raise BadInputError(f"{path}: lacks the column {error}; it is not a table of targets.") from error
    except (TypeError, ValueError) as error:
        raise BadInputError(f"{path}: holds something that is not a number ({error}).") from error
