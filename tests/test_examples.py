"""The examples run as they stand, each in a folder of its own, and say something."""

import subprocess
import sys
from pathlib import Path

import pytest

EXAMPLES = sorted((Path(__file__).resolve().parent.parent / "examples").glob("[0-9][0-9]_*.py"))
WORDS_AND_FILES = {
    "01_world_rays": ("2304000 rays, 100.0% of them OK", set()),
    "02_calibrate": ("against the truth, anywhere in the eye box: 0.0", {"birdbath28.model.json"}),
    "03_render_a_frame": ("pixels are disoccluded", {"raster.png", "raytrace.png", "warp.tiff"}),
    "04_moving_wearer": ("4 frames in frames; again: 4 kept", {"head.tum", "eyes.txt", "frames"}),
    "05_diagnose": ("Explained: printed size of the target", {"session", "diagnosis.html", "extended"}),
    "06_photographs": ("81 dots found to 0.00", set()),
}


@pytest.mark.parametrize("path", EXAMPLES, ids=lambda path: path.stem)
def test_an_example_runs(path, tmp_path):
    words, files = WORDS_AND_FILES[path.stem]
    command = [sys.executable, "-W", "error::RuntimeWarning", str(path)]
    result = subprocess.run(command, cwd=tmp_path, capture_output=True, text=True, timeout=300)
    assert result.returncode == 0, result.stderr
    assert words in result.stdout
    assert {entry.name for entry in tmp_path.iterdir()} == files


def test_every_example_is_known_here():
    assert {path.stem for path in EXAMPLES} == set(WORDS_AND_FILES)
