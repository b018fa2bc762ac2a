"""Registration of a small simulated session: the target drawn over itself, both photographed, and compared."""

import os
import shutil
from dataclasses import replace

import numpy as np
import pytest
from small_photo_session import in_this_process

from benchmarks.simulated_lab import registration_photographs
from benchmarks.simulated_lab.lab_options import SimulatedLabOptions
from benchmarks.simulated_lab.registration import METHODS
from benchmarks.simulated_lab.study import run
from wlr_render.geometry.directions import ARCMIN
from wlr_render.models.model_file import load_eye_model, save_eye_models
from wlr_render.report.blocks import Plot

pytestmark = pytest.mark.slow  # the session that all of them copy takes some twenty seconds to make

DEPTH_M = 0.6


@pytest.fixture
def options(photo_session, tmp_path, monkeypatch):
    monkeypatch.setattr(registration_photographs, "as_finished", in_this_process)
    return SimulatedLabOptions(
        part=("registration",),
        session=photo_session.folder,
        calibration=(photo_session.out,),
        out=tmp_path / "lab",
        viewpoints=1,
        depths_m=(DEPTH_M,),
    )


def test_drawn_dots_cover_real_ones(options):
    """The models fit to 0.2 arcminutes, the camera's pose is known to 0.4, and one display pixel is nearly 7.

    Dots that the panel's edge cuts are found off their places, by arcminutes; hence medians.
    """
    result = run(replace(options, viewpoints=2))
    overall, pairs = result.tables
    assert [row[0] for row in overall.rows] == list(METHODS)
    names = [f"{DEPTH_M} m, viewpoint {view}" for view in (0, 1)]
    assert [row[:2] for row in pairs.rows] == [[name, method] for name in names for method in METHODS]
    for row in pairs.rows:
        dots, median = row[2:4]
        assert dots >= 20
        assert 0 < median < 1.0
        assert row[-1] is None
    assert "ray traced: drawn dots lie" in result.verdict
    assert {path.name for path in options.out.iterdir()} >= {"misalignment.png", "close_up.png", "simulated-lab.html"}


def displace_display(calibration):
    """By the model every display pixel lies 0.005 aside, as a tangent."""
    path = calibration / "model.json"
    model = load_eye_model(path)
    forward = model.mappings.display.forward
    coefficients = np.array(forward.coefficients)
    coefficients[0, 0] += 0.005  # the constant term of tx
    display = replace(model.mappings.display, forward=replace(forward, coefficients=coefficients))
    os.remove(path)
    save_eye_models(path, [replace(model, mappings=replace(model.mappings, display=display))])


def test_several_calibrations_are_compared_on_the_same_dots_by_target(options, photo_session, tmp_path):
    """The target faces the eye, is tilted and is shifted; one calibration has the error of the test before."""
    other = tmp_path / "displaced"
    shutil.copytree(photo_session.out, other)
    displace_display(other)
    result = run(replace(options, calibration=(photo_session.out, other)))
    overall, by_target, pairs = result.tables
    labels = [f"{name}, {method}" for name in ("out", "displaced") for method in METHODS]
    assert [row[0] for row in overall.rows] == labels
    targets = [f"{DEPTH_M} m, {pose}" for pose in ("frontal", "tilted", "shifted")]
    assert [row[:2] for row in by_target.rows] == [[target, label] for target in targets for label in labels]
    assert len(pairs.rows) == 12
    for target, label, dots, median, *_ in by_target.rows:
        assert dots == next(row[2] for row in by_target.rows if row[0] == target)
        assert dots >= 20
        # The field reaches 18 degrees: a tangent there is 0.9 of an angle.
        assert median == pytest.approx(0.005 / ARCMIN, rel=0.15) if "displaced" in label else median < 1.0
    assert len({row[3] for row in by_target.rows}) > 1  # the poses do differ
    assert any(isinstance(block, Plot) for block in result.blocks)
