"""The protocol of a file format of `export`, and the base of formats with files for each colour."""

from abc import ABC, abstractmethod
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Protocol

from wlr_render.exports.export_view import ExportedView


@dataclass(frozen=True)
class Capabilities:
    """What a format holds; the rest of what a user asks for is refused, or named in the files and on the terminal.

    Attributes:
        every_depth: rays, so that a reader who knows the depth of a point finds its place in the picture.
        colours: a map each for red, green and blue.
        pupils: several pupil positions, in a file each or in one.
        asymmetric_field: borders of the source picture at different angles to the left and right, or up and down, and a
            turned camera for each eye.
        between_pixels: positions between the pixels of the source picture.
        every_pixel: a position or ray for each panel pixel, not an approximation between some.
        both_eyes: one file of both eyes, which cannot be without one of them.
        is_exr: OpenEXR files, which an extra writes.
    """

    every_depth: bool = False
    colours: bool = True
    pupils: bool = True
    asymmetric_field: bool = True
    between_pixels: bool = True
    every_pixel: bool = True
    both_eyes: bool = False
    is_exr: bool = False


@dataclass(frozen=True)
class Loss:
    """Misalignment over the panel where a fixed map is used for something that it was not made for.

    Attributes:
        case: in words.
        rms_arcmin, max_arcmin: over panel pixels that have a ray; None where the case is not defined, or not known.
    """

    case: str
    rms_arcmin: float | None
    max_arcmin: float | None


class Format(Protocol):
    """A file format, listed in `formats.FORMATS`.

    Attributes:
        name: of the format on the command line.
        title: what it is, and for whom, in one line.
        holds: its capabilities.
        convention: what the numbers of a file mean, a sentence each; also in every file or beside it.
        use: how a reader uses the files in the program that they are for, a step each; NAME stands for the start of a
            file's name, WxH for the panel's size.
    """

    @property
    def name(self) -> str: ...  # noqa: D102  (the attributes of the class)

    @property
    def title(self) -> str: ...  # noqa: D102

    @property
    def holds(self) -> Capabilities: ...  # noqa: D102

    @property
    def convention(self) -> Sequence[str]: ...  # noqa: D102

    @property
    def use(self) -> Sequence[str]: ...  # noqa: D102

    def files(self, view: ExportedView) -> Sequence[str]:
        """Return the names of the files that hold a view, in the order in which they are written."""

    def interpolation(self, view: ExportedView, colour: str) -> Loss:
        """Error of what a reader interpolates between the points of a file; of formats that hold every pixel, none."""

    def write(self, views: Iterable[ExportedView], folder: Path) -> Iterator[Path]:
        """Write the files of all views into a folder; yields each one when it is finished.

        Views are made one after the other and are large: a format that writes a file for each keeps none.

        Raises:
            BadInputError: the format does not hold a view, or a file cannot be written.
            MissingExtraError: a library that the format needs is not installed.
        """


class EveryPixel:
    """Base of formats that hold every pixel of the panel."""

    def interpolation(self, view: ExportedView, colour: str) -> Loss:
        """No error."""
        return Loss("", 0.0, 0.0)


class FormatByColour(ABC):
    """Base of formats that have files for each view and colour.

    Attributes:
        endings: of the names of these files, behind the view and the colour.
    """

    endings: tuple[str, ...]

    def files(self, view: ExportedView) -> list[str]:
        """Return the files of one colour after the other."""
        return [stem + ending for stem in view.stems for ending in self.endings]

    def write(self, views: Iterable[ExportedView], folder: Path) -> Iterator[Path]:
        """Write the files of all views; see `Format`."""
        for view in views:
            for colour, stem in zip(view.colours, view.stems, strict=True):
                yield from self._write(view, colour, [folder / (stem + ending) for ending in self.endings])

    @abstractmethod
    def _write(self, view: ExportedView, colour: str, paths: Sequence[Path]) -> Iterable[Path]:
        """Write the files of one colour, one for each ending; returns or yields their paths."""
