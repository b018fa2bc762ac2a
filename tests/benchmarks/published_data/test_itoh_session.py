"""A camera that looks through a plate of known thickness, drawn here in closed form: imported, diagnosed, held out."""

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from present import as_number, present

from benchmarks.__main__ import main as benchmark
from benchmarks.published_data import study
from benchmarks.published_data.itoh_seethrough import SeeThroughPairs
from wlr_render.bench.session_folder import load_session
from wlr_render.bench.simulate_session import simulate
from wlr_render.diagnosis import procedure
from wlr_render.diagnosis.causes import CAUSES
from wlr_render.geometry.transforms import OPENXR_FROM_OPENCV, apply, rigid, rotation_about
from wlr_render.jobs.diagnose import DiagnoseOptions, diagnose
from wlr_render.numerics.arrays import FloatArray

DOTS = np.stack([*np.meshgrid(np.linspace(0, 0.3, 7), np.linspace(0, 0.4, 6)), np.zeros((6, 7))], axis=-1).reshape(
    -1, 3
)
FOCAL, CENTRE = np.array([1575.0, 1570.0]), np.array([660.0, 510.0])
DISTANCES_M = (1.0, 1.3)
THICKNESS_MM, PMMA_INDEX, SIGMA_PX = 20.0, 1.4936, 0.05
VIEWS = tuple(str(number) for number in (1, 2, 3, 5, 8, 9, 11, 20))
FEW = {name: CAUSES[name] for name in ("see_through_plate", "target_scale", "camera_focal_length")}


def seen_through_plate(to_point: FloatArray, thickness: float) -> FloatArray:
    """Direction (n, 3) in which a plane plate before the eye, facing along z, shows points (n, 3) from the eye."""
    across, depth = np.linalg.norm(to_point[:, :2], axis=1), -to_point[:, 2]
    tangent = across / depth
    for _ in range(30):
        sine = tangent / np.sqrt(1 + tangent**2) / PMMA_INDEX
        tangent = (across - thickness * sine / np.sqrt(1 - sine**2)) / (depth - thickness)
    return np.concatenate([to_point[:, :2] / across[:, None] * tangent[:, None], -np.ones((len(to_point), 1))], axis=1)


def pixels(direction: FloatArray, device_from_camera: FloatArray) -> FloatArray:
    x, y, z = (direction @ device_from_camera[:3, :3]).T
    return np.asarray(CENTRE + FOCAL * np.stack([x / z, y / z], axis=-1))


def view(
    number: int, thickness: float, rng: np.random.Generator
) -> tuple[FloatArray, FloatArray, FloatArray, FloatArray]:
    """Poses of camera and target, and where the camera sees the dots bare and through the plate."""
    turn = rotation_about("y", rng.normal(0, 0.05)) @ rotation_about("x", rng.normal(0, 0.05)) @ OPENXR_FROM_OPENCV
    camera = rigid(turn, [-0.03, -0.08, 0.12] + rng.normal(0, 0.005, 3))
    from_camera = rigid(rotation_about("z", 0.1 * number), np.array([-0.1, -0.15, DISTANCES_M[number % 2]]))
    target = camera @ from_camera
    to_point = apply(target, DOTS) - camera[:3, 3]
    through = pixels(seen_through_plate(to_point, 1e-3 * thickness), camera)
    return camera, target, pixels(to_point, camera), through + rng.normal(0, SIGMA_PX, (len(DOTS), 2))


def pairs_through_plate(thickness: float) -> SeeThroughPairs:
    rng = np.random.default_rng(4)
    cameras, targets, bare, through = zip(*(view(n, thickness, rng) for n in range(len(VIEWS))), strict=True)
    seconds = 60.0 * np.arange(len(VIEWS))
    camera, target, seen, displaced = (np.array(each) for each in (cameras, targets, bare, through))
    return SeeThroughPairs(
        VIEWS, (1280, 1024), FOCAL, CENTRE, camera, target, DOTS, seen, displaced,
        bare_time_s=np.asarray(seconds + 20), through_time_s=np.asarray(seconds),
    )  # fmt: skip


@pytest.fixture
def imported(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> Callable[[SeeThroughPairs], tuple[Path, str]]:
    """Convert such pairs; returns the folder, and what was printed."""

    def convert(pairs: SeeThroughPairs) -> tuple[Path, str]:
        monkeypatch.setattr(study, "read_itoh_seethrough", lambda source: pairs)
        assert benchmark(["published-data", "itoh-seethrough", str(tmp_path), "--out", str(tmp_path / "session")]) == 0
        return tmp_path / "session", capsys.readouterr().out

    return convert


def test_without_optics_the_session_predicts_what_the_bare_camera_saw(imported: Callable[..., Any]) -> None:
    pairs = pairs_through_plate(THICKNESS_MM)
    # A pose that is 10 mm wrong: the dot still lies on the ray that the bare camera saw it along.
    poses = pairs.device_from_target.copy()
    poses[:, 0, 3] += 0.01
    folder, printed = imported(replace(pairs, device_from_target=poses))
    assert printed.startswith(f"8 captures, {8 * len(DOTS)} readings")
    bench, session = load_session(folder)
    plan = session.plan.see_through
    np.testing.assert_allclose(
        present(simulate(bench, session.plan).dot_pixel), pairs.bare_px.reshape(-1, 2), atol=1e-8
    )
    np.testing.assert_allclose(present(session.readings.dot_pixel), pairs.through_px.reshape(-1, 2), atol=1e-9)
    assert plan is not None
    assert tuple(dict.fromkeys(plan.capture.astype(str))) == VIEWS
    np.testing.assert_allclose(np.unique(plan.time_s), pairs.through_time_s)


def test_the_plate_is_found_and_predicts_the_other_distance(
    imported: Callable[..., Any], tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    folder, _ = imported(pairs_through_plate(THICKNESS_MM))
    bench, session = load_session(folder)
    found = procedure.diagnose(bench, session, causes=FEW)
    (cause,) = found.causes
    assert (found.verdict, cause.name) == ("explained", "see_through_plate")
    thickness = cause.parameters[0]
    assert abs(thickness.value - THICKNESS_MM) < 4 * thickness.sigma < 0.01 * THICKNESS_MM
    report = diagnose(DiagnoseOptions(folder, causes=tuple(FEW), hold_out=True, out=tmp_path / "out"))
    *_, table, values = report.tables
    thick = values.rows[0]
    assert thick[:2] == ["see_through_plate", "thickness (mm)"]
    by_diagnosis, by_captures = map(as_number, thick[-2:])
    assert 0.3 * by_diagnosis < by_captures < 3.0 * by_diagnosis
    assert [row[:2] for row in table.rows] == [
        ["all other captures", "each see-through capture"],
        ["all other distances", "1.02 m"],
        ["all other distances", "1.31 to 1.32 m"],
    ]
    for row in table.rows:
        readings, before, after, noise = map(as_number, row[-4:])
        assert readings == len(DOTS) * (8 if readings > 4 * len(DOTS) else 4)
        assert before > 10 * noise
        assert after == pytest.approx(noise, rel=0.1)
    assert "Fitted to all other captures, the causes found predict each see-through capture to 0." in report.verdict
    assert "Fitted to all other distances, the causes found predict 1." in report.verdict
