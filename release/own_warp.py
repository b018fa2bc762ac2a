"""Print shaders/own_warp.glsl, the warp for programs of others: shaders/mesh_warp.glsl with all that it includes.

python release/own_warp.py > shaders/own_warp.glsl
"""

import re
import sys
from pathlib import Path

sys.path.insert(0, str(Path(__file__).resolve().parents[1]))

from wlr_render.gl.programs import shader_source
from wlr_render.warp.gl_cells import WARP_CONSTANTS

# One colour at a time, as linear light, without overlays and without a map of the panel's uniformity.
_SETTINGS = {"CHANNELS": "1", "ENCODING": "NONE", "OVERLAYS": "0", "UNIFORMITY": "0", "MESH_WARP": "1"}
_CONDITION = re.compile(r"#(ifndef|if|elif) ([A-Z_]+)(?: == (\w+))?")


def own_warp() -> str:
    """Return the text of the file."""
    header, body = shader_source("mesh_warp.glsl", {}).split("#line 2\n")[1].split("\n\n", 1)
    body = re.sub(r"\n{3,}", "\n\n", "\n".join(_selected(body.splitlines())))
    given = WARP_CONSTANTS | {"CHANNELS": 1}
    defines = [f"#define {name} {value}" for name, value in given.items() if re.search(rf"\b{name}\b", body)]
    written_by = "// Written by release/own_warp.py from mesh_warp.glsl and what that includes."
    return "\n".join([header, written_by, "", *defines, "", body, ""])


def _selected(lines: list[str]) -> list[str]:
    """Return the lines without conditions that the settings decide, and without the lines that these leave out."""
    kept: list[str] = []
    sections: list[tuple[bool | None, bool]] = []  # selected, None if a compiler decides; whether one before was
    for line in lines:
        if line.startswith("#if"):
            sections.append((_decision(line), False))
        elif line.startswith(("#el", "#endif")) and sections[-1][0] is not None:
            selected, before = sections.pop()
            before = before or bool(selected)
            if not line.startswith("#endif"):
                sections.append((not before and (line == "#else" or bool(_decision(line))), before))
            continue
        elif line.startswith("#endif"):
            sections.pop()
            kept += [line] * all(selected is not False for selected, _ in sections)
            continue
        if all(selected is not False for selected, _ in sections) and not (
            line.startswith("#if") and sections[-1][0] is not None
        ):
            kept.append(line)
    return kept


def _decision(line: str) -> bool | None:
    """Whether a condition holds; None if the settings do not decide it."""
    found = _CONDITION.match(line)
    if found is None or found[2] not in _SETTINGS:
        return None
    value = _SETTINGS[found[2]]
    return value == found[3] if found[3] else (value == "0") == (found[1] == "ifndef")


if __name__ == "__main__":
    sys.stdout.write(own_warp())
