"""The base of the file formats of `export`."""

from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path

from wlr_render.exports.export_view import ExportedView


@dataclass(frozen=True)
class Capabilities:
    """Capabilities of a format; other requests are refused, or named in the files and on the terminal.

    Attributes:
        every_depth: rays, with which a reader who knows a point's depth can compute its position in the picture.
        colours: separate maps for red, green and blue.
        pupils: several pupil positions, one file each.
        every_pupil: one file for all pupil positions.
        asymmetric_field: borders of the source picture at different angles to the left and right, or up and down, and a
            turned camera for each eye.
        between_pixels: positions between the pixels of the source picture.
        every_pixel: a position or ray for each panel pixel, without interpolation.
        both_eyes: one file for both eyes, which requires both.
        is_exr: OpenEXR files, which need an optional dependency.
    """

    every_depth: bool = False
    colours: bool = True
    pupils: bool = True
    every_pupil: bool = False
    asymmetric_field: bool = True
    between_pixels: bool = True
    every_pixel: bool = True
    both_eyes: bool = False
    is_exr: bool = False


@dataclass(frozen=True)
class Loss:
    """Misalignment over the panel where a fixed map is used outside its purpose.

    Attributes:
        case: the use, in words.
        rms_arcmin, max_arcmin: over panel pixels that have a ray; None if undefined or unknown.
    """

    case: str
    rms_arcmin: float | None
    max_arcmin: float | None


class Format:
    """A file format, listed in `formats.FORMATS`.

    A format has `endings`, and `_write` writes the files of one colour; or it overrides `files` and `write`.

    Attributes:
        name: name of the format on the command line.
        title: content and audience, in one line.
        holds: its capabilities.
        convention: sentences on the meaning of a file's numbers; also written in every file or next to it.
        use: steps for using the files in their program; NAME is the start of a file's name, WxH the panel's size.
        endings: endings of the file names of a view and colour.
        has_all_colours: whether a file holds all colours of its view.
    """

    name: str
    title: str
    holds: Capabilities
    convention: Sequence[str]
    use: Sequence[str]
    endings: Sequence[str]
    has_all_colours = False

    def files(self, view: ExportedView) -> list[str]:
        """Return the names of a view's files, in the order in which they are written."""
        return [stem + ending for _, stem in self._parts(view) for ending in self.endings]

    def interpolation(self, view: ExportedView, colour: str) -> Loss:
        """Return a reader's interpolation error between the points of a file; none for formats with every pixel."""
        return Loss("", 0.0, 0.0)

    def write(self, views: Iterable[ExportedView], folder: Path) -> Iterator[Path]:
        """Write the files of all views into a folder; yield each file when it is finished.

        Views are generated one by one and are large: a format that writes one file per view keeps no view.

        Raises:
            BadInputError: the format cannot represent a view, or a file cannot be written.
            MissingExtraError: a library that the format needs is not installed.
        """
        for view in views:
            for colour, stem in self._parts(view):
                yield from self._write(view, colour, [folder / (stem + ending) for ending in self.endings])

    def _parts(self, view: ExportedView) -> list[tuple[str, str]]:
        """Return the colour, or all colours, and the start of the file names of each part of a view."""
        if self.has_all_colours:
            return [(view.all_colours, view.stem)]
        return list(zip(view.colours, view.stems, strict=True))

    def _write(self, view: ExportedView, colour: str, paths: Sequence[Path]) -> Iterable[Path]:
        """Write the files of one colour, or of all, one for each ending; return or yield their paths."""
        raise NotImplementedError
