"""The verb from end to end, with a few causes so that it is quick."""

import json
import shutil
from dataclasses import replace
from functools import partial
from pathlib import Path

import numpy as np
import pytest
from oracle.captures import Plan
from oracle.effects import Effect
from oracle.session_writer import write_session

from wlr_render.captures.capture_file import save_captures
from wlr_render.cli import main
from wlr_render.diagnosis import procedure
from wlr_render.diagnosis.causes import CAUSES
from wlr_render.diagnosis.settings import Settings
from wlr_render.jobs import diagnose
from wlr_render.simulation.bench_file import load_bench
from wlr_render.simulation.session_captures import observations_of
from wlr_render.simulation.session_folder import load_session

SCALE_PERCENT = 0.4
FEW = {name: CAUSES[name] for name in ("target_scale", "target_bow", "tracking_translation")}


@pytest.fixture
def few_causes(monkeypatch):
    quick = partial(procedure.diagnose, causes=FEW, settings=Settings(subsample=1500))
    monkeypatch.setattr(diagnose, "diagnose_session", quick)


@pytest.fixture(scope="module")
def session(tmp_path_factory):
    """Folder of a session whose target was printed too large."""
    folder = tmp_path_factory.mktemp("bench") / "printed"
    effect = Effect("target_scale", {"scale_percent": SCALE_PERCENT})
    write_session(folder, Plan(grid=(7, 6), dots=(7, 5), off_plane=6), [effect], np.random.default_rng(2))
    return folder


def run(capsys, *arguments):
    status = main(["diagnose", *map(str, arguments)])
    return status, capsys.readouterr()


def test_the_verb_names_the_cause_and_writes_record_page_and_bench(session, few_causes, tmp_path, capsys):
    out = tmp_path / "out"
    status, printed = run(capsys, session, "--out", out)
    assert status == 0
    assert "Explained: printed size of the target (target_scale: scale_" in printed.out
    assert "Improvement in use" in printed.out
    page = (out / "diagnosis.md").read_text()
    assert f"wlr-render diagnose {out}/corrected --out {out}/again\n" in page
    assert f"wlr-render calibrate captures {out}/corrected\n" in page
    assert sorted(str(path.relative_to(out)) for path in out.rglob("*.*")) == [
        "corrected/bench.toml",
        "corrected/display.csv.gz",
        "corrected/seethrough.csv.gz",
        "diagnosis.html",
        "diagnosis.json",
        "diagnosis.md",
    ]
    record = json.loads((out / "diagnosis.json").read_text())
    (cause,) = record["causes"]
    for found in cause["parameters"].values():
        assert found["unit"] == "%"
        assert abs(found["value"] - SCALE_PERCENT) < 4 * found["sigma"]
    assert record["in_use"]["see_through"]["improvement"]["percent"] > 20
    corrected = load_bench(out / "corrected" / "bench.toml")
    np.testing.assert_allclose(corrected.target.scale, 1 + 1e-2 * SCALE_PERCENT, atol=3e-4)


def test_by_the_corrected_bench_the_session_shows_no_effect_and_the_old_bench_goes(
    session, few_causes, tmp_path, capsys
):
    out = tmp_path / "out"
    assert run(capsys, session, "--out", out)[0] == 0
    corrected = (out / "corrected").rename(tmp_path / "session")
    (out / "corrected").mkdir()
    (out / "corrected" / "bench.toml").write_text("of an earlier diagnosis")
    elsewhere = tmp_path / "record.json"
    status, printed = run(capsys, corrected, "--out", out, "--json", elsewhere)
    assert status == 0
    assert "No effect found" in printed.out
    record = json.loads(elsewhere.read_text())
    assert (record["verdict"], record["causes"], record["in_use"]) == ("no effect", [], None)
    assert {limit["cause"] for limit in record["detection_limits"]} == set(FEW)
    assert not (out / "diagnosis.json").exists()
    assert not (out / "corrected" / "bench.toml").exists()


def test_captures_are_diagnosed_by_the_device_that_they_name(session, few_causes, tmp_path, capsys):
    calibrated, out = tmp_path / "calibrated", tmp_path / "out"
    calibrated.mkdir()
    table = observations_of(*load_session(session))
    unrecorded = replace(table.conditions, time_s=np.full(len(table), np.nan))
    save_captures(calibrated / "captures-right.npz", replace(table, conditions=unrecorded))
    status, printed = run(capsys, calibrated, "--device", "northstar", "--out", out)
    assert status == 0
    assert "Explained: printed size of the target (target_scale: scale_" in printed.out
    assert "No times are recorded" in printed.out
    record = json.loads((out / "diagnosis.json").read_text())
    assert [cause["name"] for cause in record["causes"]] == ["target_scale"]
    assert record["session"] == "calibrated"
    status, printed = run(capsys, out / "corrected", "--out", out / "again")
    assert status == 0
    assert "No effect found" in printed.out
    status, printed = run(capsys, session, "--device", "northstar", "--out", out)
    assert status == 2
    assert "no device can be chosen for it" in printed.err


def test_a_session_is_not_replaced_by_what_is_found_in_it(session, tmp_path, capsys):
    inside = tmp_path / "out" / "corrected"
    shutil.copytree(session, inside)
    status, printed = run(capsys, inside, "--out", tmp_path / "out")
    assert status == 2
    assert "would replace this session" in printed.err
    assert sorted(path.name for path in inside.iterdir()) == sorted(path.name for path in Path(session).iterdir())


def test_faults_are_told_in_one_line_before_any_work(session, tmp_path, capsys, monkeypatch):
    def never(*arguments):
        raise AssertionError("work was begun")

    monkeypatch.setattr(diagnose, "diagnose_session", never)
    taken = tmp_path / "taken"
    taken.write_text("a file")
    for arguments, words in (
        ([tmp_path / "none"], "none: has no bench.toml, so it is not a bench session"),
        ([session, "--out", taken], "taken: cannot write to this output folder"),
        ([session, "--out", tmp_path / "out", "--html", tmp_path], "is a folder; name a file"),
        ([session, "--out", tmp_path / "out", "--json", taken / "x.json"], "cannot write to this output folder"),
    ):
        status, printed = run(capsys, *arguments)
        assert status == 2
        assert printed.err.count("\n") == 1
        assert words in printed.err


def test_too_few_captures_are_refused(tmp_path, capsys):
    folder = tmp_path / "few"
    write_session(folder, Plan(grid=(4, 3), dots=(3, 3)), [], np.random.default_rng(1))
    for name in ("display", "seethrough"):
        (folder / f"{name}.csv.gz").unlink()
    plan = "capture,time_s,travel,stage_x_mm,stage_y_mm,stage_z_mm,channel,camera_u,camera_v,pixel_u,pixel_v\n"
    rows = [f"{n},{40 * n},1,{32 + n},0,33,1,640,512,700,500\n" for n in range(3)]
    (folder / "display.csv").write_text(plan + "".join(rows))
    status, printed = run(capsys, folder, "--out", tmp_path / "out")
    assert status == 2
    assert "has 3 captures, too few captures to hold any out" in printed.err
    assert not (tmp_path / "out").exists()
