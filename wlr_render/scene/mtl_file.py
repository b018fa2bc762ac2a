"""Material libraries (MTL) of OBJ files: the diffuse colour and its texture; all other content is listed."""

import re
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Protocol

import numpy as np

from wlr_render.errors import BadInputError
from wlr_render.io.delimited_text import is_number
from wlr_render.io.input_files import require_picture, shown
from wlr_render.numerics.arrays import FloatArray

_DEFAULTS = {"d": r"1(\.0*)?", "tr": "[0. ]+", "ke": "[0. ]+", "pm": "[0. ]+", "illum": r"[1-9]\d*"}
"""Patterns of values at which ignoring a key loses nothing."""
_LOST_MAPS = {"map_d", "map_tr", "map_ke", "map_bump", "bump", "norm", "disp", "decal", "refl"}
_NUMBERS = {"-o": (0.0, 0.0, 0.0), "-s": (1.0, 1.0, 1.0), "-t": (0.0, 0.0, 0.0), "-mm": (0.0, 1.0)}
"""Texture options with their neutral numbers; an option may state fewer numbers."""
_CHOICES = {"-clamp": "off", "-cc": "off"} | dict.fromkeys(
    ("-blendu", "-blendv", "-texres", "-boost", "-bm", "-type", "-imfchan")
)
"""Options that take one word, and the word without effect; None if no word affects a diffuse texture."""


class Neighbours(Protocol):
    """Files in the folder of the file being read."""

    def find(self, names: Sequence[str]) -> str | None:
        """Return the first name that a file has."""

    def get(self, name: str) -> bytes:
        """Return the content of a file; raise if it is missing."""


def obj_text(content: bytes) -> str:
    """Return the text of an OBJ or MTL file: UTF-8, or else Latin-1."""
    try:
        return content.decode("utf-8-sig")
    except UnicodeDecodeError:
        return content.decode("latin-1")


def statements(text: str) -> Iterator[tuple[int, list[str]]]:
    """Yield the line number and words of each statement; a backslash continues a line, also with blanks after it."""
    whole, start = "", 0
    for number, line in enumerate(re.split(r"\r\n|\r|\n", text), start=1):
        start = start if whole else number
        line = line.rstrip()
        if line.endswith("\\") and (whole or not line.lstrip().startswith("#")):
            whole += line[:-1] + " "
            continue
        words = (whole + line).split()
        whole = ""
        if words and not words[0].startswith("#"):
            yield start, words
    if words := whole.split():
        yield start, words


def without_comment(text: str) -> str:
    """Return a statement without a comment at its end."""
    return re.split(r"(?:^|\s)#", text, maxsplit=1)[0].strip() if "#" in text else text


def spellings(name: str) -> list[str]:
    """Return a file's name as it stands, then without quotes or a comment, with slashes for Windows' backslashes."""
    plain = [name, name.strip("\"'"), without_comment(name)]
    return [*dict.fromkeys(plain + [each.replace("\\", "/") for each in plain])]


@dataclass(eq=False)
class ObjMaterial:
    """A material of a library.

    Attributes:
        base_colour: (3,) linear RGB factor.
        texture: name of the texture's file, empty without a texture.
        picture: content of that file, once the material is used.
        lost: keys and options that are not drawn.
    """

    base_colour: FloatArray = field(default_factory=lambda: np.ones(3))
    texture: str = ""
    picture: bytes | None = None
    lost: list[str] = field(default_factory=list)


class Materials:
    """The materials of an OBJ file's libraries, by name.

    Raises:
        BadInputError: from `open`: a library or texture is missing, or a colour is invalid.
    """

    def __init__(self, path: Path, neighbours: Neighbours) -> None:
        """Prepare for the OBJ file `path`."""
        self._path, self._neighbours = path, neighbours
        self._materials: dict[str, ObjMaterial] = {}
        self._libraries: list[str] = []
        self._used: dict[str, ObjMaterial] = {}

    def __len__(self) -> int:
        return len(self._materials)

    @property
    def names(self) -> str:
        """The libraries' names, for messages."""
        return " or ".join(map(shown, self._libraries))

    def get(self, name: str) -> ObjMaterial | None:
        """Return a material, with its texture read; None if no library has it."""
        found = next((each for each in (name, without_comment(name)) if each in self._materials), None)
        if found is None:
            return None
        material = self._used[found] = self._materials[found]
        picture = self._neighbours.find(spellings(material.texture)) or material.texture
        if material.picture is None and without_comment(picture) != "":
            material.picture = self._neighbours.get(picture)
            require_picture(f"{self._path}: its file {shown(picture)[1:-1]}", material.picture)
        return material

    def lost(self) -> Iterator[tuple[str, list[str]]]:
        """Yield the name of each material that was used, and its keys that are not drawn."""
        for name, material in self._used.items():
            yield shown(name), material.lost

    def open(self, names: str) -> None:
        """Read the libraries of one `mtllib` line: one file, whose name may have blanks, or several."""
        whole = self._neighbours.find(spellings(names))
        for name in [names] if whole else names.split(" "):
            library = self._neighbours.find(spellings(name)) or name
            self._libraries.append(library)
            self._read(library, self._neighbours.get(library))

    def _read(self, library: str, content: bytes) -> None:
        read: dict[str, ObjMaterial] = {}
        material = ObjMaterial()
        for _, words in statements(obj_text(content)):
            key, text = words[0], " ".join(words[1:])
            if key.lower() == "newmtl":
                material = read[text] = ObjMaterial()
            else:
                self._statement(library, material, key.lower(), text)
        self._materials = read | self._materials  # the library that is named first takes precedence

    def _statement(self, library: str, material: ObjMaterial, key: str, text: str) -> None:
        value = without_comment(text)
        if key == "kd":
            if re.match("(spectral|xyz) ", value):
                material.lost.append(f"Kd {value.split()[0]}")
            else:
                stated = self._colour(library, value)
                material.base_colour = np.clip(stated, 0.0, 1.0)
                material.lost += ["Kd outside 0 to 1"] * bool((material.base_colour != stated).any())
        elif key == "map_kd":
            material.texture, options = _map_options(text)
            material.lost += [f"map_Kd {option}" for option in options if material.texture]
        elif key in _LOST_MAPS or (key in _DEFAULTS and not re.fullmatch(_DEFAULTS[key], value)):
            material.lost.append(f"illum {value}" if key == "illum" else key)

    def _colour(self, library: str, text: str) -> FloatArray:
        """Read three numbers, or one for all three."""
        try:
            colour = [float(each) for each in text.split()]
        except ValueError:
            colour = []
        colour = 3 * colour if len(colour) == 1 else colour
        if len(colour) != 3 or not np.isfinite(colour).all():
            raise BadInputError(
                f"{self._path}: in {shown(library)}, 'Kd' is {shown(text)}, not three numbers; correct it."
            )
        return np.array(colour)


def _map_options(text: str) -> tuple[str, list[str]]:
    """Return the file name in a texture statement, and its options that would change the picture and are not drawn."""
    words, lost = text.split(" "), []
    while words and (option := words[0].lower()) in _NUMBERS | _CHOICES:
        plain = _NUMBERS.get(option, ())
        count = next(
            (at for at, word in enumerate(words[1:]) if at == len(plain) or not is_number(word)), len(words) - 1
        )
        if option in _CHOICES:
            count = 1
            changed = _CHOICES[option] not in (None, *map(str.lower, words[1:2]))
        else:
            changed = any(float(word) != same for word, same in zip(words[1:], plain[:count], strict=False))
        lost += [option] * changed
        words = words[1 + count :]
    return " ".join(words), lost
