"""Positions in pixels as a picture of three floats, PFM or TIFF: the warp maps that `render --maps` writes."""

from collections.abc import Iterable, Iterator
from pathlib import Path
from typing import Literal

import numpy as np

from wlr_render.exports.facts import facts, write_facts
from wlr_render.exports.format import Carries
from wlr_render.exports.view import ExportedView, has_ray
from wlr_render.rendering.image_files import write_map


class FloatMap:
    """The formats `pfm` and `tiff`."""

    carries = Carries()

    def __init__(self, name: Literal["pfm", "tiff"]) -> None:
        self.name = name
        self.title = f"positions in pixels ({name.upper()}) for OpenCV and others"
        rows = "the bottom row first, as PFM has it" if name == "pfm" else "the top row first"
        self.convention = (
            "Three channels of float32: R is the position u in the source picture in pixels to the right, G is v in "
            "pixels downwards, B is 1 / depth in 1/m, 0 for infinity.",
            "(0, 0) is the outer corner of the picture's top left pixel, and pixel centres lie at +0.5.",
            f"Values are those of the centres of the panel's pixels; the file has {rows}.",
            "All three are NaN where a panel pixel has no ray: show black there.",
        )
        self.use = (
            "OpenCV: m = cv2.imread(file, cv2.IMREAD_UNCHANGED) reads it as B, G, R with the top row first, whatever "
            "the format; cv2.remap(source, m[..., 2] - 0.5, m[..., 1] - 0.5, cv2.INTER_LINEAR) draws the panel's "
            "picture.",
            "Write 0 in place of NaN before cv2.remap, and black there afterwards.",
            "Others: read three floats per pixel without any colour management.",
        )

    def files(self, view: ExportedView) -> list[str]:
        """A map and its facts for each colour."""
        return view.file_names(f"-map.{self.name}", "-map.json")

    def write(self, views: Iterable[ExportedView], folder: Path) -> Iterator[Path]:
        """Write a file for each view and colour, and its facts as .json."""
        for view in views:
            paths = iter([folder / name for name in self.files(view)])
            for colour in view.colours:
                source = view.source_px(colour)
                inverse_depth = np.full_like(source[..., :1], 1 / view.depth_m)
                values = np.concatenate([source, inverse_depth], axis=-1)
                values[~has_ray(source)] = np.nan
                yield write_map(next(paths), values)
                yield write_facts(next(paths), facts(view, colour, self))
