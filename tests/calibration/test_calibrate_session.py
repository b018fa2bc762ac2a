"""A calibration that is refused: how far it came, and what was excluded before."""

from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace
from typing import cast

import numpy as np
import pytest
from present import present

from benchmarks.simulated_lab.simulate_readings import simulate_readings
from wlr_render.calibration import calibrate_session as steps
from wlr_render.calibration.calibrate_session import RefusedCalibrationError, calibrate_session
from wlr_render.calibration.fit_eye import KindComparison
from wlr_render.captures.correspondences import Captures, DisplayCaptures
from wlr_render.captures.photo_session import PhotoSession
from wlr_render.captures.session_reading import Excluded, Reading
from wlr_render.errors import BadInputError
from wlr_render.mappings import EyeBox, Panel
from wlr_render.planning.planned_bench import ReadingOptions
from wlr_render.simulation.photographs.photo_bench import PhotoBenchOptions
from wlr_render.simulation.photographs.recipe import SimulationRecipe

LENS_STATED = PhotoBenchOptions(camera_px=(640, 512))
MOVED = Excluded("display/03", "its points lie off", fault=True, off_arcmin=9.0)


@pytest.mark.slow
def test_photographs_that_the_bench_rejected_are_named_where_a_later_camera_is_refused(tmp_path: Path) -> None:
    recipe = SimulationRecipe("birdbath28", viewpoints=4, bench=LENS_STATED)
    made = simulate_readings(recipe, ReadingOptions(most_dots=40, panel_samples=50))
    eyeball = replace(made.session.eyeball_camera, lens="brown", intrinsics=made.session.eyeball_camera.intrinsics[2:8])
    assert made.session.tracking_camera is not None
    tracking = replace(made.session.tracking_camera, intrinsics=made.session.tracking_camera.intrinsics[:1])
    session = replace(
        made.session, eyeball_camera=eyeball, tracking_camera=tracking, tracking=made.session.tracking[:1]
    )
    path = eyeball.intrinsics[0]
    seen = made.reading.boards[path]
    scrambled = replace(seen, pixel=np.random.default_rng(0).permutation(seen.pixel))
    reading = replace(made.reading, boards=made.reading.boards | {path: scrambled})
    with pytest.raises(RefusedCalibrationError, match=r"\[tracking_camera\]: a camera needs 3") as refused:
        calibrate_session(session, reading, tmp_path, fit)
    assert refused.value.found is None
    (named,) = refused.value.reading.excluded
    assert named.name == session.name_of(path)
    assert "misread" in named.reason
    assert f"Excluded before: {named.name}: its features" in str(refused.value)


@pytest.fixture
def session(monkeypatch: pytest.MonkeyPatch) -> PhotoSession:
    """A session of two eyes whose bench and captures are given, not calibrated: that takes a minute."""
    rng = np.random.default_rng(0)
    captures = DisplayCaptures(
        device="a device",
        eye="right",
        eye_box=EyeBox(np.zeros(3), np.full(3, 0.01)),
        panel=Panel(640, 480),
        viewpoint=rng.normal(0.0, 1e-3, (9, 3)),
        view_dir=np.tile([0.0, 0.0, -1.0], (9, 1)),
        pixel=rng.uniform(0.0, 400.0, (9, 2)),
        capture=np.arange(9),
        sigma_arcmin=np.ones(9),
    )
    session = SimpleNamespace(eyes=("right", "left"))
    session.for_eye = lambda eye: SimpleNamespace(eye=eye)
    monkeypatch.setattr(steps, "with_half_turns", lambda session, reading: reading)
    monkeypatch.setattr(steps, "calibrate_bench", lambda *_: SimpleNamespace(checks=(), rejected=()))
    monkeypatch.setattr(steps, "save_station", lambda *_: None)
    monkeypatch.setattr(steps, "sound_captures", lambda own, *_: (Captures(replace(captures, eye=own.eye)), (MOVED,)))
    return cast(PhotoSession, session)


MODELS = cast(KindComparison, "models of the right eye")


def fit(captures: Captures) -> KindComparison:
    if present(captures.display).eye == "left":
        raise BadInputError("this eye cannot be fitted.")
    return MODELS


def test_a_refusal_at_the_second_eye_keeps_the_first(session: PhotoSession, tmp_path: Path) -> None:
    with pytest.raises(RefusedCalibrationError, match="this eye cannot be fitted") as refused:
        calibrate_session(session, Reading(), tmp_path, fit)
    found = refused.value.found
    assert found is not None
    assert {eye: each.kinds for eye, each in found.eyes.items()} == {"right": MODELS}
    assert found.eyes["right"].excluded == found.reading.excluded == (MOVED,)  # of each eye, once


def test_a_file_that_cannot_be_written_is_no_refusal_of_the_session(session: PhotoSession, tmp_path: Path) -> None:
    (tmp_path / "captures-right.npz").mkdir()
    with pytest.raises(BadInputError, match="captures-right") as error:
        calibrate_session(session, Reading(), tmp_path, fit)
    assert not isinstance(error.value, RefusedCalibrationError)
