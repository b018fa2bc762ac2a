"""Registration of a small simulated session: the target drawn over itself, both photographed, and compared."""

from dataclasses import replace
from pathlib import Path

import pytest
from present import as_number
from small_photo_session import SmallSession, in_this_process

from benchmarks.simulated_lab import registration_photographs
from benchmarks.simulated_lab.lab_options import SimulatedLabOptions
from benchmarks.simulated_lab.registration import METHODS
from benchmarks.simulated_lab.study import run

pytestmark = pytest.mark.slow  # the session that all of them copy takes some twenty seconds to make

DEPTH_M = 0.6


@pytest.fixture
def options(photo_session: SmallSession, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> SimulatedLabOptions:
    monkeypatch.setattr(registration_photographs, "as_finished", in_this_process)
    return SimulatedLabOptions(
        part=("registration",),
        session=photo_session.folder,
        calibration=(photo_session.out,),
        out=tmp_path / "lab",
        viewpoints=1,
        depths_m=(DEPTH_M,),
    )


def test_drawn_dots_cover_real_ones(options: SimulatedLabOptions) -> None:
    """The models fit to 0.2 arcminutes, the camera's pose is known to 0.4, and one display pixel is nearly 7.

    Dots that the panel's edge cuts are found off their places, by arcminutes; hence medians.
    """
    result = run(replace(options, viewpoints=2))
    overall, pairs = result.tables
    assert [row[0] for row in overall.rows] == list(METHODS)
    names = [f"{DEPTH_M} m, viewpoint {view}" for view in (0, 1)]
    assert [row[:2] for row in pairs.rows] == [[name, method] for name in names for method in METHODS]
    for row in pairs.rows:
        dots, median = map(as_number, row[2:4])
        assert dots >= 20
        assert 0 < median < 1.0
        assert row[-1] is None
    assert "ray traced: drawn dots lie" in result.verdict
    assert {path.name for path in options.out.iterdir()} >= {"misalignment.png", "close_up.png", "simulated-lab.html"}
