"""What was read from photographs, kept as .npz files so that it need not be read twice."""

import hashlib
import json
import zipfile
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from wlr_render.files import write_arrays

VERSION = 1
"""Of the way of reading: kept results of another one are read anew."""


@dataclass(frozen=True)
class Store:
    """A folder of kept results.

    Attributes:
        folder: made when something is kept.
    """

    folder: Path

    def keep(self, name: str, fingerprint: str, arrays: dict[str, NDArray[Any]]) -> None:
        """Keep arrays under a photograph's name."""
        write_arrays(self._path(name), {"fingerprint": np.array(fingerprint)} | arrays)

    def find(self, name: str, fingerprint: str) -> dict[str, NDArray[Any]] | None:
        """What was kept, if it was read from these very files in this very way; else None."""
        path = self._path(name)
        if not path.is_file():
            return None
        try:
            with np.load(path, allow_pickle=False) as kept:
                return dict(kept) if str(kept["fingerprint"]) == fingerprint else None
        except (OSError, ValueError, KeyError, zipfile.BadZipFile):
            return None  # a kept file that cannot be read is made again

    def _path(self, name: str) -> Path:
        return self.folder / (name.replace("/", "__") + ".npz")


def fingerprint(paths: Sequence[Path], how: object) -> str:
    """Of files as they are now, and of how they are read: `how` in a form that `json` or `repr` tells apart."""
    about = [(path.name, path.stat().st_size, path.stat().st_mtime_ns) for path in paths]
    return hashlib.sha256(json.dumps([VERSION, about, repr(how)]).encode()).hexdigest()
