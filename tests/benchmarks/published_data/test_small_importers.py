"""Tables of others: gaze errors, lateral colour, eye relief."""

import gzip
import json

import numpy as np
import pytest

from benchmarks.published_data.jemr2022_eyetracking import read_gaze_errors
from benchmarks.published_data.vive_hmd_config import read_vive_hmd_config


def gaze_table(path, text):
    with gzip.open(path, "wt") as file:
        file.write(text)


HEAD = "user\tacc\toffX\toffY\tsd\toutlier_reason\n"


def test_glitches_and_gaps_are_left_out(tmp_path):
    gaze_table(
        tmp_path / "data_targets_a_1.csv.gz", HEAD + "1\t0.5\t0.3\t-0.4\t0.1\tvalid\n1\t9\t9\t0\t3\tsampling_glitch\n"
    )
    gaze_table(tmp_path / "data_targets_b_1.csv.gz", HEAD + "2\t1.0\t0.6\t0.8\t0.2\tvalid\n2\t\t0\t0\t0\tvalid\n")
    found = read_gaze_errors(tmp_path)
    np.testing.assert_array_equal(found.error_deg, [0.5, 1.0])
    np.testing.assert_array_equal(found.offset_deg, [[0.3, -0.4], [0.6, 0.8]])
    np.testing.assert_array_equal(found.scatter_deg, [0.1, 0.2])


def vive_config(path, coefficients):
    eye = {"intrinsics": [[2.0, 0, 0], [0, 2.0, 0], [0, 0, -1]]}
    for name, k in zip(("distortion_red", "distortion", "distortion_blue"), coefficients, strict=True):
        eye[name] = {"coeffs": k}
    path.write_text(json.dumps({"tracking_to_eye_transform": [eye, eye]}))
    return path


def test_lateral_colour_in_closed_form(tmp_path):
    lens, _ = read_vive_hmd_config(vive_config(tmp_path / "config.json", [[0.0, 0.0], [-0.5, 0.0], [0.0, -0.75]]))
    # At r = 1: red unchanged, green doubled, blue four times as far.
    np.testing.assert_allclose(lens.tangents(np.array([[1.0]])), [[[0.5, 1.0, 2.0]]])
    expected = np.degrees(np.arctan(2.0) - np.arctan(0.5)) * 60
    assert lens.lateral_colour_arcmin(np.array(1.0)) == pytest.approx(expected)
