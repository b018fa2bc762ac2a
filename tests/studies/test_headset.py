import json
from pathlib import Path

import numpy as np
import pytest

from wlr_render.errors import BadInputError
from wlr_render.studies.headset import open_eye, require_in_eye_box


def test_a_device_is_traced_and_a_model_is_read(straight_device, model_file):
    traced = open_eye(straight_device, "left")
    assert (traced.name, traced.eye) == ("no_optics (traced)", "left")
    fitted = open_eye(Path(model_file))
    assert (fitted.name, fitted.eye) == ("fitted", "right")
    assert open_eye("no_optics").display.panel.width_px == 1280


def test_a_model_of_the_other_eye_is_refused(model_file):
    with pytest.raises(BadInputError, match=r"model\.json: is a model of the right eye; the left eye was asked for"):
        open_eye(model_file, "left")


def test_an_eye_that_the_device_does_not_have_is_refused():
    with pytest.raises(BadInputError, match="no left eye; choose right"):
        open_eye("no_optics", "left")


def test_a_model_cut_short_or_of_another_version_is_refused(model_file, tmp_path):
    text = Path(model_file).read_text(encoding="utf-8")
    short, newer = tmp_path / "short.json", tmp_path / "newer.json"
    short.write_text(text[: len(text) // 2], encoding="utf-8")
    newer.write_text(json.dumps(json.loads(text) | {"version": 2}), encoding="utf-8")
    with pytest.raises(BadInputError, match=r"short\.json: is not a model file, or is cut short"):
        open_eye(short)
    with pytest.raises(BadInputError, match=r"newer\.json: has version 2; this program reads version 1"):
        open_eye(newer)


def test_the_eye_box_is_a_border_with_a_micrometre_of_slack(straight_device):
    eye = open_eye(straight_device)
    corner = eye.eye_box.at(np.ones(3))
    require_in_eye_box(eye, corner, "here")
    require_in_eye_box(eye, corner + 0.9e-6, "here")
    with pytest.raises(BadInputError) as refused:
        require_in_eye_box(eye, corner + [0.0, 0.001, 0.0], "eyes.txt at 2.5 s")
    sentence = str(refused.value)
    assert sentence.startswith("eyes.txt at 2.5 s: the viewpoint (5.00, 5.00, 3.00) mm lies outside the eye box of")
    assert "(-5.00, -4.00, -3.00) to (5.00, 4.00, 3.00) mm" in sentence
