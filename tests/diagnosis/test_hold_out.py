"""Cross-validation of a diagnosis: capture files and other benches."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from diagnosis.small_session import SIGMA_PX, measured, small_bench, small_plan
from present import as_number, present

from wlr_render.bench.bench_file import save_bench
from wlr_render.bench.session_captures import captures_of
from wlr_render.bench.session_folder import save_session
from wlr_render.cli import main
from wlr_render.diagnosis.observations import Observations
from wlr_render.jobs.diagnose import DiagnoseOptions, diagnose

TILT = [0.15, -0.1, 0.05]


@pytest.fixture(scope="module")
def observed() -> Observations:
    """Readings of a small bench whose combiner is tilted."""
    bench = small_bench()
    return measured(bench, small_plan(bench), SIGMA_PX, seed=8, combiner_tilt=TILT)


@pytest.mark.slow
def test_a_capture_file_is_held_out_with_the_causes_that_are_named(observed: Observations, tmp_path: Path) -> None:
    few = observed.of_rows(observed.spread(600))
    captures = captures_of(few.nominal, few.session).save(tmp_path / "captures-right.npz")
    options = DiagnoseOptions(captures, causes=("combiner_tilt", "panel_shift"), hold_out=True, out=tmp_path / "out")
    *_, held_out, values = diagnose(options).tables
    assert {row[0] for row in values.rows} == {"combiner_tilt"}
    assert held_out.rows[0][1] == "each display capture"
    assert as_number(held_out.rows[0][3]) > 20 * as_number(held_out.rows[0][5])
    for *_, after, noise in held_out.rows:
        assert after == pytest.approx(noise, rel=0.1)


def test_distances_are_those_of_the_target_and_in_order(observed: Observations) -> None:
    named = observed.target_distances()
    near, far = named.values()
    pose = present(observed.session.plan.see_through).target_pose
    assert list(named) == sorted(named)
    np.testing.assert_array_equal(np.flatnonzero(near), np.flatnonzero(observed.part == 1)[pose == 0])
    np.testing.assert_array_equal(np.flatnonzero(far), np.flatnonzero(observed.part == 1)[pose == 1])
    shown = observed.of_rows(observed.part == 0)
    assert shown.target_distances() == {}


def test_the_bench_to_start_from_can_be_named(
    observed: Observations, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    folder = save_session(tmp_path / "session", observed.nominal, observed.session)
    other = save_bench(replace(observed.nominal, eye="left"), tmp_path / "left.toml")
    assert main(["diagnose", str(folder), "--hold-out", "--bench", str(other), "--out", str(tmp_path / "out")]) == 2
    assert "left.toml: is a bench of northstar (left eye)" in capsys.readouterr().err
