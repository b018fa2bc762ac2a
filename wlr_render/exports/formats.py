"""The formats of `export` by their names."""

from typing import Literal

from wlr_render.exports.format import Format
from wlr_render.exports.stmap import StMap

FormatName = Literal["stmap"]
FORMATS: tuple[Format, ...] = (StMap(),)


def format_of(name: str) -> Format:
    """The format of a name."""
    return next(form for form in FORMATS if form.name == name)
