"""The script `wlr` with stand-ins for what it calls."""

import os
import shutil
import subprocess
from pathlib import Path

ROOT = Path(__file__).resolve().parent.parent


def run_script(folder, arguments, commands):
    """Run a copy of `wlr` whose venv is complete, with `commands` (shell scripts by name) before all others."""
    bin_folder = folder / ".venv" / "bin"
    bin_folder.mkdir(parents=True)
    for name in ("wlr", "pyproject.toml", "constraints.txt"):
        shutil.copy(ROOT / name, folder)
    for name, text in commands.items():
        (bin_folder / name).write_text(f"#!/bin/sh\n{text}\n")
        (bin_folder / name).chmod(0o755)
    stamp = subprocess.run("cat pyproject.toml constraints.txt | cksum", shell=True, cwd=folder, capture_output=True)
    (folder / ".venv" / "wlr-stamp").write_bytes(stamp.stdout)
    (folder / ".venv" / "wlr-gl").write_text("egl\n")
    environment = {**os.environ, "PATH": f"{bin_folder}:{os.environ['PATH']}", "WLR_NO_APT": "1"}
    return subprocess.run(
        [folder / "wlr", *arguments], capture_output=True, text=True, timeout=60, env=environment, check=True
    )


def test_readers_says_at_the_end_what_is_installed(tmp_path):
    """No package can be installed, and mrcal is missing."""
    commands = {"python": "exit 0", "dpkg": '[ "$2" != python3-mrcal ]'}
    *_, missing, last = run_script(tmp_path, ["readers"], commands).stderr.splitlines()
    assert missing == "wlr: could not install python3-mrcal; the tests that need it are skipped"
    assert last == "wlr: installed: Mitsuba, LLVM 19, ffmpeg"
