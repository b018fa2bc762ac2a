"""Commands of CODE V lens files (.seq): separated by `;`, continued by `&`, with comments after `!`."""

import re
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass, field
from pathlib import Path

from wlr_render.errors import BadInputError
from wlr_render.io.input_files import shown
from wlr_render.optics.lens_files.sequence import LensReading, finite

_TOKEN = re.compile(r"""[Ll]?(?:'[^']*'|"[^"]*")|[^\s;'"!]+|[;!'"]""")
_LABEL = re.compile(r"""[Ll]['"]""")
_TARGET = re.compile(r"S(O|I|\d{1,6})", re.IGNORECASE)
_TEXTS = {"TIT", "SLB", "DIM", "GLA", "RMD", "RET", "GLB", "ZOO", "PIK"}
"""Commands with words as values, or with surfaces other than the one that they belong to."""
_HARMLESS = {
    *("LEN", "GO", "INI", "UID", "WL", "WTW", "REF", "CWL", "EPD", "FNO", "NA", "NAO", "WTF", "WID", "POL", "CA"),
    *("XAN", "YAN", "XOB", "YOB", "XIM", "YIM", "XRI", "YRI", "VUX", "VLX", "VUY", "VLY", "CLS", "DER", "DOR"),
    *("CCX", "CCY", "THC", "GLC", "KC", "CCF", "AC", "BC", "CC", "DC", "EC", "FC", "GC", "HC", "JC", "SCC", "HCC"),
    *("XDC", "YDC", "ZDC", "ADC", "BDC", "CDC", "THM", "CUM", "HOR", "HWL", "HCT", "HCO", "KXC", "KYC", "PFR", "PTP"),
    *("MFL", "SUR", "LIS", "VIE", "CMP", "COM", "PTC", "SLC", "DLR", "DLT", "DLN", "TRX", "TRY", "BTX", "BTY"),
}
"""Commands of fields, wavelengths, pupil, drawing, tolerances and optimisation, and numbers of a diffractive surface,
which `DIF` names."""


@dataclass(frozen=True)
class Command:
    """One command: its words without quotes, and its line in the file."""

    words: tuple[str, ...]
    line: int

    @property
    def name(self) -> str:
        """The name in capitals: at most three letters are significant; never blank."""
        return "".join(self.words[0].split())[:3].upper() or "''"


def commands_of(path: Path, lines: Iterable[str]) -> Iterator[Command]:
    """Yield the commands of a file in their order.

    Raises:
        BadInputError: a quoted text does not end in its line.
    """
    words: list[str] = []
    first, is_continued = 1, False
    for number, line in enumerate(lines, 1):
        first, last = first if is_continued else number, ""
        for token in _TOKEN.findall(line):
            if token == "!":
                break
            if token == ";":
                yield from _command(words, first)
                words, first, last = [], number, ""
            elif token in "'\"":
                raise BadInputError(f"{path}: line {number}: a text in quotes does not end in its line; close it.")
            else:
                words.append(token if _LABEL.match(token) else token.strip("'\""))
                last = token
        is_continued = last.endswith("&")  # outside quotes
        if is_continued:
            words[-1:] = [words[-1][:-1]] if words[-1] != "&" else []
        else:
            yield from _command(words, first)
            words = []
    yield from _command(words, first)


def _command(words: list[str], line: int) -> Iterator[Command]:
    if words:
        yield Command(tuple(words), line)


def number_of(reading: LensReading, command: Command, words: Sequence[str], place: int) -> float:
    """Return one of the values of a command as a number.

    Raises:
        BadInputError: it is missing or not a number.
    """
    where = f"{reading.path}: line {command.line}: value {place + 1} of {command.words[0].upper()}"
    return finite(words[place] if place < len(words) else "", where)


@dataclass
class CodevSurface:
    """The commands of one surface, or of the file as a whole.

    Attributes:
        reading: state of reading the file.
        number: number of the surface.
        line: the command S with curvature or radius, thickness, glass; for the file as a whole, any command.
        has_radius: True if the line states a radius.
        commands: other commands, by name and qualifiers, such as 'CIR OBS'; a later command replaces an earlier one.
        used: keys of the commands that have been read.
    """

    reading: LensReading
    number: int
    line: Command
    has_radius: bool = False
    commands: dict[str, Command] = field(default_factory=dict)
    used: set[str] = field(default_factory=set)

    def words(self, key: str) -> list[str]:
        """Return the values of a command as words, without qualifiers; empty if it is missing."""
        command = self.commands.get(key)
        if command is None:
            return []
        self.used.add(key)
        return [word for word in command.words[1:] if not _LABEL.match(word) and word.upper() not in key.split()[1:]]

    def value(self, key: str, default: float = 0.0) -> float:
        """Return the first number of a command."""
        words = self.words(key)
        return number_of(self.reading, self.commands[key], words, 0) if key in self.commands else default


@dataclass
class CodevFile:
    """The commands of a file, by the surface that they belong to.

    Attributes:
        reading: state of reading the file.
        whole: commands of the file as a whole.
        surfaces: surfaces in order, starting with the object.
        glasses: private glasses: definition and wavelengths, by name in capitals.
    """

    reading: LensReading
    whole: CodevSurface
    surfaces: list[CodevSurface] = field(default_factory=list)
    glasses: dict[str, tuple[Command, Command | None]] = field(default_factory=dict)
    _has_radius: bool = False
    _is_private: bool = False
    _wavelengths: Command | None = None
    _has_image: bool = False
    _stop: CodevSurface | None = None

    def take(self, command: Command) -> None:
        """Store a command with its surface, its private glass or the whole file.

        Raises:
            BadInputError: it names a surface that does not exist.
        """
        name = command.name
        if name in ("PRV", "END"):
            self._is_private = name == "PRV"
        elif self._is_private and name == "PWL":
            self._wavelengths = command
        elif self._is_private:
            self.glasses[command.words[0].upper()] = command, self._wavelengths
        elif name == "RDM":
            self._has_radius = not command.words[1:] or not command.words[1].upper().startswith("N")
        elif re.fullmatch(r"S(O|I|\d{0,6})", command.words[0].upper()):
            self._take_surface(command)
        elif name not in _HARMLESS:
            self._sort(command)

    def end(self) -> None:
        """Add the image, which a file may omit: a plane behind the thickness of the last surface."""
        if len(self.surfaces) > 1 and not self._has_image:
            image = Command(("SI", "0", "0"), self.surfaces[-1].line.line)
            self.surfaces.append(CodevSurface(self.reading, len(self.surfaces), image))

    def _take_surface(self, command: Command) -> None:
        text = command.words[0].upper()[1:]
        stated = int(text) if text.isdecimal() else 0 if text == "O" else len(self.surfaces)
        if stated < len(self.surfaces):
            self.surfaces[stated].line, self.surfaces[stated].has_radius = command, self._has_radius
            return
        if stated > len(self.surfaces) or self._has_image or (not self.surfaces and text not in ("O", "0")):
            last = "the image SI" if self._has_image else f"S{len(self.surfaces) - 1}" if self.surfaces else "nothing"
            raise BadInputError(
                f"{self.reading.path}: line {command.line}: surface {shown(command.words[0])} follows {last}; "
                "surfaces are stated in their order, from SO to SI."
            )
        self._has_image = text == "I"
        self.surfaces.append(CodevSurface(self.reading, stated, command, self._has_radius))

    def _sort(self, command: Command) -> None:
        """Add a command to the surface that it names, or else to the last one."""
        owner = self.surfaces[-1] if self.surfaces else self.whole
        qualifiers, words = [], [command.words[0]]
        is_value = False
        for word in command.words[1:]:
            is_value = is_value or command.name in _TEXTS or _is_number(word)
            target = _TARGET.fullmatch(word)
            if target and (not is_value or (command.name in ("GLA", "SLB", "RMD") and len(words) == 1)):
                owner = self._surface(target[1].upper(), command)
            elif word.upper() != "CLR":
                words.append(word)
                if not is_value and not _LABEL.match(word):
                    qualifiers.append(word.upper())
        if command.name in ("TIT", "DIM", "TEM", "PRE", "ZOO"):
            owner = self.whole
            qualifiers = [word.upper() for word in words[1:2] if re.fullmatch(r"[Zz]\d+", word)]
        if command.name == "PIK":
            owner, qualifiers = self.whole, [str(command.line)]
        if command.name == "STO":
            if self._stop is not None:
                self._stop.commands.pop("STO", None)
            self._stop = owner
        key = " ".join([command.name, *qualifiers])[:40]
        labels = {word for word in words if _LABEL.match(word)}
        if key in owner.commands and labels.difference(owner.commands[key].words):
            key += f" {min(labels)}"  # another aperture of the same surface
        owner.commands.pop(key, None)
        owner.commands[key] = Command(tuple(words), command.line)

    def _surface(self, text: str, command: Command) -> CodevSurface:
        place = 0 if text == "O" else len(self.surfaces) - 1 if text == "I" else int(text)
        if not 0 <= place < len(self.surfaces):
            raise BadInputError(f"{self.reading.path}: line {command.line}: surface S{text} does not exist yet.")
        return self.surfaces[place]


def _is_number(word: str) -> bool:
    try:
        float(word)
    except ValueError:
        return False
    return True
