"""A corrected bench predicts other sessions of the same bench: their own target poses, from one capture on."""

import gzip
import json
import shutil
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from memo import memoised, shared_folder
from oracle import captures as oracle_captures
from oracle.captures import Plan
from oracle.effects import Effect
from oracle.nature import BenchNature
from oracle.session_writer import write_session

from wlr_render.bench.bench import Mount, Target
from wlr_render.bench.bench_file import load_bench, save_bench
from wlr_render.bench.session_captures import captures_of
from wlr_render.bench.session_folder import bench_for_session, load_session, save_session
from wlr_render.cli import main
from wlr_render.diagnosis.bench_prediction import predict_session
from wlr_render.diagnosis.causes import CAUSES
from wlr_render.diagnosis.procedure import diagnose
from wlr_render.diagnosis.settings import Settings
from wlr_render.errors import BadInputError

PLAN = Plan(grid=(9, 8), dots=(9, 7), off_plane=6)
EFFECTS = [
    Effect("target_scale", {"scale_percent": 0.4}),
    Effect("combiner_tilt", {"x_deg": 0.15, "y_deg": -0.1, "z_deg": 0.0}),
]
OTHER_TURNS = ((4.0, -7.0, 20.0), (-8.0, 3.0, -15.0), (2.0, 9.0, 10.0))


def faulty_and_corrected(folder: Path) -> tuple[Path, Path]:
    """Folders of a session of a faulty bench, and of the same with the bench that its diagnosis corrected."""
    write_session(folder / "first", PLAN, EFFECTS, np.random.default_rng(2))
    nominal, session = load_session(folder / "first")
    causes = {name: CAUSES[name] for name in ("target_scale", "combiner_tilt", "camera_focal_length")}
    found = diagnose(nominal, session, causes=causes, settings=Settings(subsample=3000))
    assert {cause.name for cause in found.causes} == {"target_scale", "combiner_tilt"}
    return folder / "first", save_session(folder / "corrected", found.corrected, session)


@pytest.fixture(scope="module")
def both(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, Path]:
    shared = shared_folder(tmp_path_factory)
    return memoised(faulty_and_corrected, shared)(shared / "predict")


@pytest.fixture(scope="module")
def first(both: tuple[Path, Path]) -> Path:
    return both[0]


@pytest.fixture(scope="module")
def corrected(both: tuple[Path, Path]) -> Path:
    return both[1]


@pytest.fixture(scope="module")
def second(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Folder of another session of the same bench, with other places of the camera and other poses of the targets."""
    folder = tmp_path_factory.mktemp("second") / "second"
    with pytest.MonkeyPatch.context() as patched:
        patched.setattr(oracle_captures, "_TARGET_TURNS_DEG", OTHER_TURNS)
        write_session(folder, PLAN, EFFECTS, np.random.default_rng(5))
    return folder


@pytest.fixture(scope="module")
def ordinary(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Folder of a session of the same bench on a day when its stage repeats to 15 um and 30 urad."""
    folder = tmp_path_factory.mktemp("ordinary") / "ordinary"
    write_session(folder, PLAN, EFFECTS, np.random.default_rng(7), BenchNature(0.015, 30e-6))
    return folder


def run(capsys: pytest.CaptureFixture[str], *arguments: object) -> tuple[int, Any]:
    status = main(["predict", *map(str, arguments)])
    return status, capsys.readouterr()


@pytest.mark.slow
def test_a_corrected_bench_predicts_another_session_to_the_noise_and_the_nominal_one_does_not(
    corrected: Path, first: Path, second: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    status, printed = run(capsys, corrected, second, "--out", tmp_path)
    assert status == 0
    assert printed.out.startswith(f"{corrected} predicts the 90 captures of second to noise and repeatability. ")
    assert "better than second's own bench" in printed.out
    bench = corrected / "bench.toml"
    command = f"wlr-render calibrate {second} --bench {bench} --out {tmp_path / 'calibrate'}"
    assert command in json.loads((tmp_path / "report.json").read_text())["advice"][0]
    assert "The session's target poses are used" in printed.out
    record = json.loads((tmp_path / "report.json").read_text())
    assert {part["name"] for part in record["parts"]} == {"display", "see-through"}
    for part in record["parts"]:
        assert part["is_noise"]
        assert part["reduced_chi_squared"] == pytest.approx(1.0, abs=0.06)
        assert part["whitened"] == pytest.approx(1.0, abs=0.05)
        assert part["by_own_bench"] > 10
    assert [each["name"] for each in record["distances"]] == ["0.59 m", "1.11 m", "2.26 m"]
    assert len(record["captures"]) == 90
    status, printed = run(capsys, first / "bench.toml", second, "--out", tmp_path)
    assert status == 0
    assert f"{first / 'bench.toml'} does not predict the 90 captures of second." in printed.out
    assert "no better than second's own bench" in printed.out
    advice = json.loads((tmp_path / "report.json").read_text())["advice"][0]
    assert advice.endswith(f"wlr-render diagnose {second} --out {tmp_path / 'diagnose'}")


def test_on_a_bench_whose_stage_repeats_imperfectly_the_corrected_bench_predicts_and_the_nominal_does_not(
    corrected: Path, first: Path, ordinary: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """Motions of 15 um and 30 urad from capture to capture are several times the noise of a point."""
    assert run(capsys, corrected, ordinary, "--out", tmp_path / "out")[0] == 0
    record = json.loads((tmp_path / "out" / "report.json").read_text())
    assert record["sentence"].startswith(f"{corrected} predicts the 90 captures of ordinary to noise and repeatability")
    for part in record["parts"]:
        assert part["reduced_chi_squared"] > 1.2
        assert part["whitened"] == pytest.approx(1.0, abs=0.08)
        assert part["shift_um"] == pytest.approx(15.0, rel=0.35)
        assert part["turn_urad"] == pytest.approx(30.0, rel=0.35)
    assert run(capsys, first / "bench.toml", ordinary, "--out", tmp_path / "out")[0] == 0
    record = json.loads((tmp_path / "out" / "report.json").read_text())
    assert " does not predict the 90 captures of ordinary." in record["sentence"]
    assert not any(part["is_noise"] for part in record["parts"])


def test_one_capture_is_enough(
    corrected: Path, second: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    folder = tmp_path / "one"
    shutil.copytree(second, folder)
    table = folder / "seethrough.csv.gz"
    header, *rows = gzip.decompress(table.read_bytes()).decode().splitlines()
    table.unlink()
    (folder / "display.csv.gz").unlink()
    kept = [row for row in rows if row.startswith("2,3,")]
    (folder / "seethrough.csv").write_text("\n".join([header, *kept]) + "\n")
    status, printed = run(capsys, corrected, folder, "--out", tmp_path / "out")
    assert status == 0
    assert "predicts the only capture of one to noise and repeatability" in printed.out
    record = json.loads((tmp_path / "out" / "report.json").read_text())
    assert record["advice"] == ["This bench needs no correction for such captures."]
    (capture,) = record["captures"]
    assert capture["name"] == "see-through capture 3 of target pose 2"
    assert capture["readings"] == len(kept)


def test_the_noise_is_what_the_session_states_and_what_its_photographs_show(
    corrected: Path, second: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    folder = tmp_path / "noisy"
    shutil.copytree(second, folder)
    bench = folder / "bench.toml"
    bench.write_text(bench.read_text().replace("point_sigma_px = 0.1", "point_sigma_px = 0.05"))
    assert run(capsys, corrected, folder, "--out", tmp_path / "out")[0] == 0
    record = json.loads((tmp_path / "out" / "report.json").read_text())
    assert record["sentence"].startswith(f"{corrected} predicts the 90 captures of noisy to noise and repeatability")
    for part in record["parts"]:
        assert part["reduced_chi_squared"] == pytest.approx(4.0, rel=0.05)
        assert part["whitened"] == pytest.approx(1.0, abs=0.05)


def test_misread_points_are_counted_and_do_not_decide(corrected: Path, second: Path) -> None:
    own, session = load_session(second)
    bench = bench_for_session(load_bench(corrected / "bench.toml"), own, corrected, second)
    assert session.readings.dot_pixel is not None
    session.readings.dot_pixel[::100] += 30.0
    found = predict_session(bench, session)
    assert found.outliers == len(session.readings.dot_pixel[::100])
    assert all(part.is_noise for part in found.parts)


def test_captures_test_the_optics_of_the_bench_only(
    corrected: Path, first: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    nominal, session = load_session(first)
    captures = captures_of(replace(nominal, target=load_bench(corrected / "bench.toml").target), session)
    path = captures.save(tmp_path / "captures-right.npz")
    for bench, words in ((corrected, "need no correction"), (first, "does not predict the 90 captures")):
        status, printed = run(capsys, bench, path, "--out", tmp_path / "out")
        assert status == 0
        assert words in printed.out
        assert "only the headset's optics are tested" in printed.out


def test_a_slip_of_the_other_session_is_named_with_what_it_does(
    corrected: Path, second: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    bench = load_bench(corrected / "bench.toml")
    slipped = replace(bench, mount=Mount(slip_time_s=600.0, slip=np.array([5e-4, 0.0, 0.0])))
    path = save_bench(slipped, tmp_path / "slipped.toml")
    assert run(capsys, path, second, "--out", tmp_path / "out")[0] == 0
    record = json.loads((tmp_path / "out" / "report.json").read_text())
    assert record["reduced_chi_squared"] > 2.0
    assert record["without_slip"] == pytest.approx(1.0, abs=0.03)
    assert any("a slip at 600 s" in warning for warning in record["warnings"])


def test_diagnose_with_the_bench_of_another_session_keeps_the_session_s_target_poses(
    corrected: Path, second: Path
) -> None:
    own, _ = load_session(second)
    bench, _ = load_session(second, corrected / "bench.toml")
    np.testing.assert_array_equal(bench.target.device_from_target, own.target.device_from_target)
    np.testing.assert_allclose(bench.target.scale, 1.004, atol=4e-4)


def test_bows_of_single_poses_go_with_the_pitch_or_are_refused(corrected: Path) -> None:
    bench = load_bench(corrected / "bench.toml")
    bows = np.array([[0.1, 0.0], [0.2, 0.0], [0.3, 0.0]])
    bowed = replace(bench, target=replace(bench.target, bow=bows))
    two = Target(bench.target.device_from_target[:2], bench.target.pitch[[2, 1]])
    found = bench_for_session(bowed, replace(bench, target=two), "bench.toml", "session")
    np.testing.assert_array_equal(found.target.bow, bows[[2, 1]])
    other = replace(bench, target=replace(two, pitch=np.array([0.01, 0.02])))
    with pytest.raises(BadInputError, match=r"'bow_per_m' for each target pose.*\[\[target_pose\]\] 0 of session"):
        bench_for_session(bowed, other, "bench.toml", "session")


def test_faults_are_one_sentence(
    corrected: Path, second: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    other = tmp_path / "other.toml"
    other.write_text((second / "bench.toml").read_text().replace('device = "northstar"', 'device = "birdbath28"'))
    empty = tmp_path / "empty"
    empty.mkdir()
    report = tmp_path / "report"
    shutil.copytree(corrected, report / "corrected")
    for arguments, words in (
        ([other, second], "other.toml: is a bench of birdbath28"),
        ([tmp_path / "none.toml", second], "none.toml: does not exist; name a bench file"),
        (
            [report, second],
            f"report: is the report folder of a diagnosis; its corrected bench is in {report / 'corrected'}",
        ),
        ([second / "display.csv.gz", second], "display.csv.gz: line 1 is not UTF-8 text"),
        ([empty, second], "bench.toml: does not exist; name a bench file, or a folder with bench.toml"),
        ([corrected, empty], "empty: has no bench.toml, so it is not a bench session"),
        ([corrected], "predict needs SESSION; add --help for the arguments of this verb."),
    ):
        status, printed = run(capsys, *arguments, "--out", tmp_path / "out")
        assert status == 2
        assert printed.err.count("\n") == 1
        assert words in printed.err
