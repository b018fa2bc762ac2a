"""STMap: an OpenEXR picture of normalised positions, as Nuke, Fusion, Resolve and After Effects read it."""

from collections.abc import Iterable, Iterator
from pathlib import Path

import numpy as np

from wlr_render.exports.facts import facts, header_texts
from wlr_render.exports.format import Carries
from wlr_render.exports.view import ExportedView, has_ray
from wlr_render.rendering.exr_file import write_exr

NOTHING = np.float32(-1.0)
"""Position of panel pixels without a ray: outside the picture; NaN would spread in a reader's filter."""


class StMap:
    """The format `stmap`."""

    name = "stmap"
    title = "STMap (OpenEXR) for compositing programs"
    carries = Carries()
    convention = (
        "R is the position in the source picture from its left border, 0, to its right border, 1.",
        "G is the position from its bottom border, 0, to its top border, 1; B is 0.",
        "Values are those of the centres of the panel's pixels; the first row of the file is the panel's top row.",
        "R = G = -1 where a panel pixel has no ray: show black there.",
    )
    use = (
        "Draw the source picture with the camera of the table below, and show the warped picture on the panel pixel by "
        "pixel.",
        "Nuke: read the file as raw data, connect it to the stmap input of an STMap node, uv channels rgb, filter "
        "bilinear or better.",
        "OpenImageIO: oiiotool source.exr map.exr --st_warp:filter=triangle:flip_t=1 --crop WxH+0+0 --fullpixels -o "
        "panel.exr, with the panel's size as WxH, for its t runs down and its result has the size of the source.",
        "OpenImageIO in Python: ImageBufAlgo.st_warp(source, map, 'triangle', flip_t=True, roi=the panel's pixels), "
        "which also serves a source picture smaller than the panel.",
    )

    def files(self, view: ExportedView) -> list[str]:
        """A file for each colour."""
        return view.file_names("-stmap.exr")

    def write(self, views: Iterable[ExportedView], folder: Path) -> Iterator[Path]:
        """Write a file for each view and colour."""
        for view in views:
            width, height = view.source.camera.size_px
            for colour, name in zip(view.colours, self.files(view), strict=True):
                source = view.source_px(colour)
                channels = {"R": source[..., 0] / width, "G": 1 - source[..., 1] / height}
                channels = {key: np.where(has_ray(source), values, NOTHING) for key, values in channels.items()}
                channels["B"] = np.zeros_like(channels["R"])
                texts = header_texts(facts(view, colour, self))
                yield write_exr(folder / name, channels, texts)
