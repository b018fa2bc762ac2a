"""The rays of all panel pixels in an OpenEXR picture of four channels: right for every depth."""

from collections.abc import Iterable, Iterator
from pathlib import Path

from wlr_render.exports.facts import facts, header_texts
from wlr_render.exports.format import Carries
from wlr_render.exports.view import ExportedView
from wlr_render.rendering.exr_file import write_exr

RAY_CONVENTION = (
    "A ray is (a, b, c, d) in the frame of the source camera: at depth Z it is at x = a Z + c, y = b Z + d, z = -Z, in "
    "metres.",
    "A reader who knows Z shows at this panel pixel what the source picture has at the tangents a + c / Z, b + d / Z; "
    "(a, b) at infinity.",
    "In the picture that is u = (tx - left) / (right - left) width and v = (top - ty) / (top - bottom) height, with "
    "the borders of the table below.",
    "Values are those of the centres of the panel's pixels, NaN where a pixel has no ray.",
)
"""Of all formats that hold rays."""


class Rays:
    """The format `rays`."""

    name = "rays"
    title = "rays of all panel pixels (OpenEXR)"
    carries = Carries(every_depth=True)
    convention = (
        "The channels R, G, B, A hold the numbers a, b, c, d of the ray of each panel pixel; A is no opacity.",
        *RAY_CONVENTION,
        "The first row of the file is the panel's top row.",
    )
    use = (
        "As primary rays: origin (c, d, 0) and direction (a, b, -1), turned by device_from_camera and moved to the "
        "source camera's place.",
        "As a warp with depth: find the Z where the ray meets the source picture's depth, then read the picture there.",
        "Read the file as raw data. Programs that know alpha must not divide by it (Blender: alpha mode channel "
        "packed).",
    )

    def files(self, view: ExportedView) -> list[str]:
        """A file for each colour."""
        return view.file_names("-rays.exr")

    def write(self, views: Iterable[ExportedView], folder: Path) -> Iterator[Path]:
        """Write a file for each view and colour."""
        for view in views:
            for colour, name in zip(view.colours, self.files(view), strict=True):
                channels = dict(zip("RGBA", view.slope_offset(colour), strict=True))
                texts = header_texts(facts(view, colour, self))
                yield write_exr(folder / name, channels, texts)
