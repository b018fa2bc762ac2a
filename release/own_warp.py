"""Write shaders/own_warp.glsl and own_warp.wgsl, the warp for programs of others.

The GLSL is shaders/mesh_warp.glsl with all that it includes. The command `naga` makes the WGSL of it: install naga-cli.

python release/own_warp.py
"""

import hashlib
import re
import shutil
import subprocess
import sys
import tempfile
from pathlib import Path

sys.path.insert(0, str(Path(__file__).resolve().parents[1]))

from wlr_render.gl.programs import shader_source
from wlr_render.warp.gl_cells import WARP_CONSTANTS

# One colour at a time, as linear light, without overlays and without a map of the panel's uniformity.
_SETTINGS = {"CHANNELS": "1", "ENCODING": "NONE", "OVERLAYS": "0", "UNIFORMITY": "0", "MESH_WARP": "1"}
_CONDITION = re.compile(r"#(ifndef|if|elif) ([A-Z_]+)(?: == (\w+))?")
# Entry points in WGSL, and what naga takes a stage's kind from: the end of its file's name.
_ENTRY_POINTS = {"tiles_vertex": "vert", "tiles_fragment": "frag", "vertex": "vert", "fragment": "frag"}
_DECLARED = re.compile(r"^(?:fn|struct|const|var(?:<\w+>)?) (\w+)", re.MULTILINE)


def own_warp() -> str:
    """Return the text of the file."""
    header, body = shader_source("mesh_warp.glsl", {}).split("#line 2\n")[1].split("\n\n", 1)
    body = re.sub(r"\n{3,}", "\n\n", "\n".join(_selected(body.splitlines())))
    given = WARP_CONSTANTS | {"CHANNELS": 1}
    defines = [f"#define {name} {value}" for name, value in given.items() if re.search(rf"\b{name}\b", body)]
    written_by = "// Written by release/own_warp.py from mesh_warp.glsl and what that includes."
    return "\n".join([header, written_by, "", *defines, "", body, ""])


def wgsl_of(glsl: str, naga: str) -> str:
    """Translate the text of own_warp.glsl by a command `naga`: one module with the entry points of all stages."""
    modules = []
    with tempfile.TemporaryDirectory() as folder:
        for stage, kind in _ENTRY_POINTS.items():
            given, made = Path(folder) / f"warp.{kind}", Path(folder) / "warp.wgsl"
            defines = "".join(f"#define {name}\n" for name in ("VULKAN", "NO_GATHER", f"{stage.upper()}_STAGE"))
            given.write_text(f"#version 450\n{defines}{glsl}", encoding="utf-8")
            subprocess.run([naga, given, made], check=True)
            modules.append(_named_after(stage, made.read_text(encoding="utf-8")))
    body = "\n".join(modules)
    version = subprocess.run([naga, "--version"], capture_output=True, text=True, check=True).stdout
    header = [
        f"// own_warp.glsl in WGSL, whose first lines say how to draw it. Entry points: {', '.join(_ENTRY_POINTS)}.",
        f"// Written by release/own_warp.py with naga {version.split('.')[0]}.",
        f"// SHA-256 of the GLSL's tokens and of the text below: {_digest(glsl, body)}",
    ]
    return "\n".join([*header, "", body])


def is_of(wgsl: str, glsl: str) -> bool:
    """Whether a text of `wgsl_of` is of this GLSL and has not been edited since."""
    header, body = wgsl.split("\n\n", 1)
    return header.endswith(f" {_digest(glsl, body)}")


def _digest(glsl: str, body: str) -> str:
    """Return the SHA-256 of both; by tokens, so that a comment or a line break in the GLSL makes no WGSL stale."""
    tokens = re.sub(r"//.*", "", glsl).split()
    return hashlib.sha256(" ".join([*tokens, body]).encode()).hexdigest()


def _named_after(stage: str, wgsl: str) -> str:
    """Name the entry point after the stage, and begin all other names of the module with it."""
    names = {name: stage if name == "main" else f"{stage}_{name}" for name in _DECLARED.findall(wgsl)}
    renamed = re.sub(r"\w+", lambda word: names.get(word[0], word[0]), wgsl)
    return re.sub(r" +$", "", renamed, flags=re.MULTILINE)


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
    text, naga = own_warp(), shutil.which("naga")
    kept = Path(__file__).resolve().parents[1] / "shaders" / "own_warp.wgsl"
    kept.with_suffix(".glsl").write_text(text, encoding="utf-8")
    if naga is not None:
        kept.write_text(wgsl_of(text, naga), encoding="utf-8")
    elif not is_of(kept.read_text(encoding="utf-8"), text):
        raise SystemExit(
            "own_warp.py: shaders/own_warp.wgsl is not of today's shaders: install naga-cli, run this again."
        )
