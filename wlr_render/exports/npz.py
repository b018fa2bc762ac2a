"""The rays of all panel pixels as NumPy arrays."""

import json
from collections.abc import Iterable, Iterator
from pathlib import Path

import numpy as np

from wlr_render.exports.facts import facts
from wlr_render.exports.format import Carries
from wlr_render.exports.rays import RAY_CONVENTION
from wlr_render.exports.view import ALL_COLOURS, ExportedView
from wlr_render.files import write_arrays


class Npz:
    """The format `npz`."""

    name = "npz"
    title = "rays of all panel pixels (NumPy)"
    carries = Carries(every_depth=True)
    convention = (
        "rays: (colours, 4, height, width) float32, the numbers a, b, c, d of the ray of each panel pixel, the top row "
        "first.",
        "colours: the names of the colours, or all for one map.",
        "facts: JSON text with the headset, eye, viewpoint, source camera and these sentences.",
        *RAY_CONVENTION,
    )
    use = (
        'with numpy.load(file) as data: rays, facts = data["rays"], json.loads(str(data["facts"]))',
        'camera = facts["source_camera"] has size_px, the tangents of the borders, position_in_device_m and '
        "device_from_camera.",
        "Nothing in the file needs allow_pickle.",
    )

    def files(self, view: ExportedView) -> list[str]:
        """One file of all colours."""
        return [f"{view.stem}-rays.npz"]

    def write(self, views: Iterable[ExportedView], folder: Path) -> Iterator[Path]:
        """Write a file for each view, with all its colours."""
        for view in views:
            (name,) = self.files(view)
            rays = np.stack([view.slope_offset(colour) for colour in view.colours])
            names = ALL_COLOURS if len(view.colours) == 1 else ", ".join(view.colours)
            text = json.dumps(facts(view, names, self))
            arrays = {"rays": rays, "colours": np.array(view.colours), "facts": np.array(text)}
            yield write_arrays(folder / name, arrays)
