"""The verb from end to end, with a few causes so that it is quick."""

import contextlib
import io
import json
import re
import shutil
from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from _pytest.capture import CaptureResult
from command_line import refused
from memo import memoised, shared_folder
from oracle.captures import Plan
from oracle.effects import Effect
from oracle.session_writer import write_session
from present import present
from small_photo_session import SmallSession

from wlr_render.bench.bench import Bench
from wlr_render.bench.bench_file import load_bench
from wlr_render.bench.session_captures import captures_of
from wlr_render.bench.session_folder import load_session, save_session
from wlr_render.bench.simulate_session import dot_geometry, simulate
from wlr_render.captures.correspondences import Captures
from wlr_render.captures.session import Session, select_rows
from wlr_render.cli import main
from wlr_render.diagnosis import improvement, procedure
from wlr_render.diagnosis.cause import Cause
from wlr_render.diagnosis.cause_selection import Progress
from wlr_render.diagnosis.causes import CAUSES
from wlr_render.diagnosis.observations import readings_of_rows
from wlr_render.diagnosis.prediction import Predictor
from wlr_render.diagnosis.report import Diagnosis
from wlr_render.diagnosis.settings import DEFAULT, Settings
from wlr_render.jobs import diagnose
from wlr_render.numerics.arrays import FloatArray

SCALE_PERCENT = 0.4
FEW = {name: CAUSES[name] for name in ("target_scale", "target_bow", "tracking_translation")}


def with_few_causes(
    nominal: Bench, session: Session, progress: Progress, causes: Mapping[str, Cause], settings: Settings
) -> Diagnosis:
    """Diagnose with an eighth of the readings, and few causes unless the options choose others."""
    causes = FEW if causes == CAUSES else causes
    return procedure.diagnose(nominal, session, progress, causes, replace(settings, subsample=600))


@pytest.fixture
def few_causes(monkeypatch: pytest.MonkeyPatch) -> None:
    """Few causes, and no models of both benches: `diagnosed` has the improvement in use."""
    monkeypatch.setattr(diagnose, "diagnose_session", with_few_causes)
    monkeypatch.setattr(diagnose, "improvement_found", lambda _: None)


def printed_too_large(folder: Path) -> Path:
    """A folder with a session whose target was printed too large, and its diagnosis; nobody writes there."""
    effect = Effect("target_scale", {"scale_percent": SCALE_PERCENT})
    plan = Plan(grid=(7, 6), dots=(7, 5), off_plane=6)
    write_session(folder / "printed", plan, [effect], np.random.default_rng(2))
    with pytest.MonkeyPatch.context() as patch, contextlib.redirect_stdout(io.StringIO()) as printed:
        patch.setattr(diagnose, "diagnose_session", with_few_causes)
        patch.setattr(improvement, "_ROWS", 800)
        assert main(["diagnose", str(folder / "printed"), "--out", str(folder / "out")]) == 0
    (folder / "printed.txt").write_text(printed.getvalue(), encoding="utf-8")
    return folder


@pytest.fixture(scope="module")
def printed(tmp_path_factory: pytest.TempPathFactory) -> Path:
    shared = shared_folder(tmp_path_factory)
    return memoised(printed_too_large, shared)(shared / "printed_too_large")


@pytest.fixture(scope="module")
def session(printed: Path) -> Path:
    return printed / "printed"


@pytest.fixture(scope="module")
def diagnosed(printed: Path) -> tuple[Path, str]:
    """Folder of the diagnosis, and what was printed."""
    return printed / "out", (printed / "printed.txt").read_text(encoding="utf-8")


def measured_dots(folder: Path) -> FloatArray:
    """Dots (n, 3) of a session's targets, metres, device frame."""
    nominal, measured = load_session(folder)
    return dot_geometry(nominal, present(measured.plan.see_through))[1]


def run(capsys: pytest.CaptureFixture[str], *arguments: object) -> tuple[int, CaptureResult[str]]:
    status = main(["diagnose", *map(str, arguments)])
    return status, capsys.readouterr()


@pytest.mark.slow
def test_the_verb_names_the_cause_and_writes_record_page_and_bench(diagnosed: tuple[Path, str]) -> None:
    out, printed = diagnosed
    assert "Explained: printed size of the target (target_scale: scale_" in printed
    assert "Improvement in use" in printed
    page = (out / "diagnosis.md").read_text()
    assert f"wlr-render diagnose {out}/corrected --out {out}/again\n" in page
    assert f"wlr-render calibrate {out}/corrected\n" in page
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
    diagnosed: tuple[Path, str], few_causes: object, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    out = shutil.copytree(diagnosed[0], tmp_path / "out")
    corrected = (out / "corrected").rename(tmp_path / "session")
    (out / "corrected").mkdir()
    (out / "corrected" / "bench.toml").write_text("of an earlier diagnosis")
    status, printed = run(capsys, corrected, "--out", out)
    assert status == 0
    assert "No effect found" in printed.out
    record = json.loads((out / "diagnosis.json").read_text())
    assert (record["verdict"], record["causes"], record["in_use"]) == ("no effect", [], None)
    assert {limit["cause"] for limit in record["detection_limits"]} == set(FEW)
    assert not (out / "corrected" / "bench.toml").exists()


def test_captures_are_diagnosed_by_the_device_that_they_name(
    session: Path, few_causes: object, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    calibrated, out = tmp_path / "calibrated", tmp_path / "out"
    calibrated.mkdir()
    display, see_through = captures_of(*load_session(session)).both
    untimed = Captures(
        replace(display, time_s=np.full(len(display), np.nan)),
        replace(see_through, time_s=np.full(len(see_through), np.nan)),
    )
    untimed.save(calibrated / "captures-right.npz")
    status, printed = run(capsys, calibrated, "--device", "northstar", "--out", out)
    assert status == 0
    assert "Explained: printed size of the target (target_scale: scale_" in printed.out
    assert "No times are recorded" in printed.out
    record = json.loads((out / "diagnosis.json").read_text())
    assert [cause["name"] for cause in record["causes"]] == ["target_scale"]
    assert record["session"] == "calibrated"
    corrected, measured = load_session(out / "corrected")
    residual = Predictor.of_session(corrected, measured).observations.residual(simulate(corrected, measured.plan))
    assert np.sqrt(np.nanmean(residual**2)) == pytest.approx(1.0, abs=0.05)
    status, printed = run(capsys, session, "--device", "northstar", "--out", out)
    assert status == 2
    assert "--device does not apply" in printed.err


def test_the_signature_of_a_cause_is_drawn_before_anything_is_fitted(
    session: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(diagnose, "diagnose_session", None)
    status, printed = run(capsys, session, "--show-cause", "target_scale", "--out", tmp_path)
    assert status == 0
    assert "target_scale (printed size of the target) acts at the station 'target'" in printed.out
    record = json.loads((tmp_path / "signature.json").read_text())
    (wide,) = {each["name"]: each for each in record["parameters"] if each["name"] == "scale_x"}.values()
    # By the definition: a dot at x on the target moves by x times the scale, which is seen at the target's distance.
    _, measured = load_session(session)
    plan, camera = measured.plan.see_through, np.array(present(measured.plan.see_through).stage)
    distance = np.mean(np.linalg.norm(measured_dots(session) - camera, axis=1))
    expected = np.degrees(1e-2 * wide["size"] * np.sqrt(np.mean(present(plan).dot[:, 0] ** 2) / 2) / distance) * 60
    assert wide["rms"]["see-through"] == pytest.approx(expected, rel=0.3)
    assert wide["rms"]["display"] is None
    status, printed = run(capsys, session, "--show-cause", "target_scal", "--out", tmp_path / "no")
    assert status == 2
    assert "There is no cause 'target_scal'; did you mean target_scale" in printed.err


SCREW = re.findall(
    r"```python\n(.*?)```", (Path(__file__).parents[2] / "docs" / "diagnosis.md").read_text("utf-8"), re.DOTALL
)[1]
"""The documented cause that displaces the stage."""


@pytest.fixture(scope="module")
def screwed(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, Path]:
    """Folder of a session whose stage has a lead screw of 1 mm that errs by 30 um, and the file of that cause."""
    folder = tmp_path_factory.mktemp("screw")
    effect, plan = Effect("stage_screw_error", {"swing_mm": 0.03}), Plan(grid=(7, 6), dots=(7, 5), off_plane=6)
    write_session(folder / "session", plan, [effect], np.random.default_rng(2))
    causes = folder / "causes.py"
    causes.write_text(SCREW.replace("PITCH_MM = 2.0", "PITCH_MM = 1.0").replace("8.0", "5.5"))
    return folder / "session", causes


def test_a_cause_of_your_own_at_a_station_is_drawn(
    screwed: tuple[Path, Path], tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    session, causes = screwed
    status, printed = run(capsys, session, "--show-cause", "lead_screw", "--add-causes", causes, "--out", tmp_path)
    assert status == 0
    assert "acts at the station 'stage'" in printed.out
    drawn = json.loads((tmp_path / "signature.json").read_text())
    assert [each["name"] for each in drawn["parameters"]] == ["sine", "cosine"]
    assert all(each["rms"]["display"] > 0.0 for each in drawn["parameters"])


@pytest.mark.slow
def test_a_cause_of_your_own_at_a_station_is_named_and_written(
    screwed: tuple[Path, Path], few_causes: object, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    session, causes = screwed
    status, _ = run(capsys, session, "--add-causes", causes, "--causes", "lead_screw", "--out", tmp_path)
    assert status == 0
    (cause,) = json.loads((tmp_path / "diagnosis.json").read_text())["causes"]
    sine, cosine = (cause["parameters"][name] for name in ("sine", "cosine"))
    assert sine["value"] == pytest.approx(30.0, abs=4 * sine["sigma"])
    assert cosine["value"] == pytest.approx(0.0, abs=4 * cosine["sigma"])
    corrected, measured = load_session(tmp_path / "corrected")
    (effect,) = corrected.effects
    assert (effect.station, effect.displaces) == ("stage", "pose")
    residual = Predictor.of_session(corrected, measured).observations.residual(simulate(corrected, measured.plan))
    assert np.sqrt(np.nanmean(residual**2)) == pytest.approx(1.0, abs=0.05)


@pytest.mark.parametrize("verb", ["diagnose", "predict"])
def test_a_faulty_effect_is_one_sentence(
    session: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str], verb: str
) -> None:
    """tests/bench/test_bench_file.py has the faults."""
    faulty = shutil.copytree(session, tmp_path / "faulty")
    with (faulty / "bench.toml").open("a") as file:
        file.write('\n[[effect]]\ndisplaces = "shift"\n')
    places = [faulty] if verb == "diagnose" else [faulty / "bench.toml", session]
    sentence = refused([verb, *map(str, places), "--out", str(tmp_path / "out")], capsys)
    assert f"{faulty / 'bench.toml'} [[effect]] number 1: key 'station' is missing" in sentence


def test_a_session_is_not_replaced_by_what_is_found_in_it(
    session: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    inside = tmp_path / "out" / "corrected"
    shutil.copytree(session, inside)
    status, printed = run(capsys, inside, "--out", tmp_path / "out")
    assert status == 2
    assert "would replace this session" in printed.err
    assert sorted(path.name for path in inside.iterdir()) == sorted(path.name for path in Path(session).iterdir())


def test_captures_of_one_point_each_are_refused(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    folder = tmp_path / "few"
    write_session(folder, Plan(grid=(4, 3), dots=(3, 3)), [], np.random.default_rng(1))
    for name in ("display", "seethrough"):
        (folder / f"{name}.csv.gz").unlink()
    plan = "capture,time_s,travel,stage_x_mm,stage_y_mm,stage_z_mm,channel,camera_u,camera_v,pixel_u,pixel_v\n"
    rows = [f"{n},{40 * n},1,{32 + n},0,33,1,640,512,700,500\n" for n in range(3)]
    (folder / "display.csv").write_text(plan + "".join(rows))
    status, printed = run(capsys, folder, "--out", tmp_path / "out")
    assert status == 2
    assert "few: no capture has more than 1 points, and a small motion of the camera explains them" in printed.err
    assert not (tmp_path / "out").exists()


def test_few_captures_are_diagnosed_with_what_cannot_be_told(
    session: Path, few_causes: object, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """One display capture and two of see-through at two distances show the wrong print."""
    bench, whole = load_session(session)
    display, see_through = whole.plan.display, whole.plan.see_through
    assert see_through is not None
    first = [np.flatnonzero(see_through.target_pose == pose)[0] for pose in (0, len(bench.target.pitch) - 1)]
    pairs = zip(see_through.capture[first], see_through.target_pose[first], strict=True)
    kept = [present(display).capture == present(display).capture[0], np.zeros(len(see_through), dtype=bool)]
    for capture, pose in pairs:
        kept[1] |= (see_through.capture == capture) & (see_through.target_pose == pose)
    shown = select_rows(present(display), kept[0])
    plan = replace(whole.plan, display=shown, see_through=select_rows(see_through, kept[1]))
    few = replace(whole, plan=plan, readings=readings_of_rows(whole.readings, [*kept, kept[0]]))
    folder = save_session(tmp_path / "few", bench, few)
    status, printed = run(capsys, folder, "--out", tmp_path / "out")
    assert status == 0, printed.err
    assert "Explained: printed size of the target" in printed.out
    warned = json.loads((tmp_path / "out" / "diagnosis.json").read_text())["warnings"]
    (one,) = [each for each in warned if "The display part has 1 capture" in each]
    assert "its repeatability is unknown, and the usual one is assumed" in one
    assert "6 or more captures of the part" in one
    assert any("The see-through part has 2 captures: it does not show which of them moved" in each for each in warned)
    assert any("a slip, or another cause that begins at some time, cannot be" in each for each in warned) == (
        len({*present(plan.display).time_s, *present(plan.see_through).time_s}) < 4
    )
    assert "Display: noise 0." in printed.out  # and no repeatability of one capture


def test_captures_of_calibrated_photographs_are_diagnosed(
    photo_session: SmallSession, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """A session of photographs from end to end: its places and lens are fitted, its headset is as its prescription."""
    out = tmp_path / "diagnosis"
    status, printed = run(capsys, photo_session.out, "--device", photo_session.recipe.device, "--out", out)
    assert status == 0, printed.err
    record = json.loads((out / "diagnosis.json").read_text())
    assert record["verdict"] == "no effect"
    assert [each["part"] for each in record["motions"]] == ["display", "see-through"]
    for each in record["motions"]:
        assert 0.0 < each["shift_um"] < 200.0
    assert "repeat to " in printed.out


OWN = """
from dataclasses import replace
from wlr_render.diagnosis.cause import Cause, Parameter

def printed_larger(bench, percent):
    target = replace(bench.target, scale=bench.target.scale * (1.0 + 1e-2 * percent))
    return replace(bench, target=target)

CAUSES = (
    Cause(
        "wet_paper", "paper swollen by moisture", "target", (Parameter("growth", "%", 0.5),),
        source="the humidity of our cellar", separated_by="a dry day", variants={"in both directions": printed_larger},
    ),
)
"""


def test_a_cause_of_the_users_own_is_found_and_the_listed_one_is_not(
    session: Path, few_causes: object, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    own = tmp_path / "cellar.py"
    own.write_text(OWN)
    out = tmp_path / "out"
    status, printed = run(
        capsys, session, "--out", out, "--add-causes", own, "--causes", "wet_paper", "target_bow", "--max-causes", 1
    )
    assert status == 0, printed.err
    record = json.loads((out / "diagnosis.json").read_text())
    assert "Only wet_paper, target_bow were considered (--causes)." in record["warnings"]
    (cause,) = record["causes"]
    assert cause["name"] == "wet_paper"
    growth = cause["parameters"]["growth"]
    assert abs(growth["value"] - SCALE_PERCENT) < 4 * growth["sigma"]


def test_stated_priors_reach_the_causes_and_go_where_the_corrected_bench_has_the_effect(
    session: Path, monkeypatch: pytest.MonkeyPatch, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """A prior of a cause that is found is not in the corrected bench: it would be expected there a second time."""
    seen: dict[str, Cause] = {}

    def quick(
        nominal: Bench, session: Session, progress: Progress, causes: Mapping[str, Cause], settings: Settings
    ) -> Diagnosis:
        seen.update(causes)
        assert settings.max_causes == 0
        few = {name: causes[name] for name in FEW}
        return procedure.diagnose(nominal, session, progress, few, replace(DEFAULT, subsample=1500))

    monkeypatch.setattr(diagnose, "diagnose_session", quick)
    monkeypatch.setattr(diagnose, "improvement_found", lambda _: None)
    bench, stated = tmp_path / "bench.toml", (session / "bench.toml").read_text()
    priors = "[prior]\ntarget_scale.scale_x = [0.3, 0.2]\ncamera_pupil_offset.offset_z = {mean = 0.1, sigma = 0.05}\n"
    bench.write_text(stated + priors)
    status, printed = run(
        capsys, session, "--out", tmp_path / "out", "--bench", bench, "--exclude", "latency", "--max-causes", 0
    )
    assert status == 0, printed.err
    assert set(seen) == set(CAUSES) - {"latency"}
    x, y = seen["target_scale"].parameters
    assert (x.prior_mean, x.prior_sigma, y) == (0.3, 0.2, CAUSES["target_scale"].parameters[1])
    assert (
        "Not considered: latency (--exclude)."
        in json.loads((tmp_path / "out" / "diagnosis.json").read_text())["warnings"]
    )
    corrected = load_bench(tmp_path / "out" / "corrected" / "bench.toml")
    assert corrected.priors == {"camera_pupil_offset": {"offset_z": (0.1, 0.05)}}


@pytest.mark.parametrize(
    ("options", "sentence"),
    [
        (["--causes", "combiner_tlt"], "There is no cause 'combiner_tlt'; did you mean combiner_tilt"),
        (["--exclude", "ghosts"], "There is no cause 'ghosts'; choose from combiner_tilt, "),
        (["--causes", "latency", "--exclude", "latency"], "Every cause is excluded"),
        (["--add-causes", "none.py"], "none.py: there is no such file"),
        (["--add-causes", "no_such_module"], "no_such_module: cannot be loaded (ModuleNotFoundError"),
    ],
)
def test_causes_that_cannot_be_considered_are_refused_in_a_sentence(
    session: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str], options: Sequence[str], sentence: str
) -> None:
    status, printed = run(capsys, session, "--out", tmp_path / "out", *options)
    assert status == 2
    assert sentence in " ".join(printed.err.split())
