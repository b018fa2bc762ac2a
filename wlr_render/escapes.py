"""Text of files in reports: one function for each format, so that a name controls no terminal and forges no markup."""

import html
import re
import unicodedata
from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from matplotlib.figure import Figure

_UNSAFE = ("Cc", "Cf", "Cs", "Zl", "Zp")
_CODE = re.compile(r"(?<!`)(`[^`\n]+`)(?!`)")


def printable(text: str) -> str:
    r"""Escape control, formatting and unencodable characters for one line of plain text, e.g. ESC as `\x1b`."""
    if text.isprintable():
        return text
    return "".join(
        char.encode("unicode_escape").decode() if unicodedata.category(char) in _UNSAFE else char for char in text
    )


def printable_lines(text: str) -> str:
    """As `printable`, for text of several lines."""
    return "\n".join(map(printable, text.split("\n")))


def markdown_text(text: str) -> str:
    """Return the text as one line of Markdown without markup, but for code between single backticks."""
    parts = _CODE.split(printable_lines(text).replace("\n", " "))
    return "".join(part if index % 2 else re.sub(r"([\\<\[*])", r"\\\1", part) for index, part in enumerate(parts))


def html_code(text: str) -> str:
    """Return the text as HTML, with code between single backticks in an element of its own."""
    parts = _CODE.split(printable_lines(text))
    return "".join(
        f"<code>{html.escape(part[1:-1])}</code>" if index % 2 else html.escape(part)
        for index, part in enumerate(parts)
    )


def html_text(value: object) -> object:
    """Return a value of a page's template before it is escaped as HTML: browsers obey formatting characters, too."""
    return printable_lines(value) if isinstance(value, str) and not hasattr(value, "__html__") else value


def plotly_text(value: Any, key: str = "") -> Any:
    """A JSON value for Plotly, which reads a part of HTML in every text; hover templates are the program's own."""
    if isinstance(value, str):
        return value if key == "hovertemplate" else html.escape(printable_lines(value), quote=False)
    if isinstance(value, Mapping):
        return {name: plotly_text(item, name) for name, item in value.items()}
    return [plotly_text(item, key) for item in value] if isinstance(value, Sequence) else value


def plain_figure(figure: "Figure") -> None:
    """Have the words of a matplotlib figure drawn as they stand; "$" starts no formula, except in powers at ticks."""
    from matplotlib.text import Text

    axes = [axis for each in figure.axes for axis in (each.xaxis, each.yaxis)]
    ticks = {label for axis in axes for which in ("major", "minor") for label in axis.get_ticklabels(which=which)}
    for text in figure.findobj(Text):
        if text not in ticks:
            text.set_parse_math(False)
            text.set_text(printable_lines(text.get_text()))
