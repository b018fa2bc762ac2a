"""Tables of others: lateral colour in closed form."""

import json
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from benchmarks.published_data.vive_hmd_config import read_vive_hmd_config


def vive_config(path: Path, coefficients: Sequence[list[float]]) -> Path:
    eye: dict[str, Any] = {"intrinsics": [[2.0, 0, 0], [0, 2.0, 0], [0, 0, -1]]}
    for name, k in zip(("distortion_red", "distortion", "distortion_blue"), coefficients, strict=True):
        eye[name] = {"coeffs": k}
    path.write_text(json.dumps({"tracking_to_eye_transform": [eye, eye]}))
    return path


def test_lateral_colour_in_closed_form(tmp_path: Path) -> None:
    lens, _ = read_vive_hmd_config(vive_config(tmp_path / "config.json", [[0.0, 0.0], [-0.5, 0.0], [0.0, -0.75]]))
    # At r = 1: red unchanged, green doubled, blue four times as far.
    np.testing.assert_allclose(lens.tangents(np.array([[1.0]])), [[[0.5, 1.0, 2.0]]])
    expected = np.degrees(np.arctan(2.0) - np.arctan(0.5)) * 60
    assert lens.lateral_colour_arcmin(np.array(1.0)) == pytest.approx(expected)
