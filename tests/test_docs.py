"""What the documents name is there."""

import re
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parent.parent
FOLDERS = ("benchmarks", "docs", "examples", "shaders")
TEXTS = [ROOT / "README.md", *(path for folder in FOLDERS for path in sorted((ROOT / folder).rglob("*.md")))]
FILE = re.compile(r"`([\w./-]+\.(?:py|md|glsl|frag|vert|toml))`")
LINK = re.compile(r"\]\(([^)#:]+)\)")
# Files of users, not of ours.
THEIRS = {
    "session.toml",
    "bench.toml",
    "board.toml",
    "device.toml",
    "report.md",
    "calibration.md",
}
PLACES = [
    ROOT,
    ROOT / "wlr_render",
    ROOT / "shaders",
    ROOT / "docs",
    *(p for p in (ROOT / "wlr_render").rglob("*") if p.is_dir()),
    *(p for p in (ROOT / "benchmarks").rglob("*") if p.is_dir()),
]


@pytest.mark.parametrize("text", TEXTS, ids=lambda path: str(path.relative_to(ROOT)))
def test_files_that_a_text_names_exist(text):
    content = text.read_text(encoding="utf-8")
    named = {name for name in FILE.findall(content) if "NAME" not in name} - THEIRS
    lost = {name for name in named if not any((place / name).exists() for place in [text.parent, *PLACES])}
    lost |= {link for link in LINK.findall(content) if not (text.parent / link).exists()}
    assert not lost
