"""Escaping of foreign text in reports, one function per format: a name cannot control a terminal or inject markup."""

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
    """Escape like `printable`, keeping line breaks."""
    return "\n".join(map(printable, text.split("\n")))


def markdown_text(text: str) -> str:
    """Escape the text as one line of Markdown, keeping only code between single backticks."""
    parts = _CODE.split(printable_lines(text).replace("\n", " "))
    return "".join(part if index % 2 else re.sub(r"([\\<\[*])", r"\\\1", part) for index, part in enumerate(parts))


def html_code(text: str) -> str:
    """Escape the text as HTML, with code between single backticks in a code element."""
    parts = _CODE.split(printable_lines(text))
    return "".join(
        f"<code>{html.escape(part[1:-1])}</code>" if index % 2 else html.escape(part)
        for index, part in enumerate(parts)
    )


def html_text(value: object) -> object:
    """Escape, in a template value and before HTML escaping, the formatting characters that browsers obey."""
    return printable_lines(value) if isinstance(value, str) and not hasattr(value, "__html__") else value


def plotly_text(value: Any, key: str = "") -> Any:
    """Escape a JSON value for Plotly, which interprets some HTML in every text; hover templates are trusted."""
    if isinstance(value, str):
        return value if key == "hovertemplate" else html.escape(printable_lines(value), quote=False)
    if isinstance(value, Mapping):
        return {name: plotly_text(item, name) for name, item in value.items()}
    return [plotly_text(item, key) for item in value] if isinstance(value, Sequence) else value


def plain_figure(figure: "Figure") -> None:
    """Turn off formulas in a matplotlib figure: "$" is drawn literally, except in powers at ticks."""
    from matplotlib.text import Text

    axes = [axis for each in figure.axes for axis in (each.xaxis, each.yaxis)]
    ticks = {label for axis in axes for which in ("major", "minor") for label in axis.get_ticklabels(which=which)}
    for text in figure.findobj(Text):
        if text not in ticks:
            text.set_parse_math(False)
            text.set_text(printable_lines(text.get_text()))
