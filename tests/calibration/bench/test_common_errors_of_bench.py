"""Common errors of captures from a joint adjustment: with each camera's own motion they are all that it knows."""

import numpy as np
import pytest
from present import present
from small_photo_session import with_stated_lenses

from benchmarks.simulated_lab.simulate_readings import simulate_readings
from wlr_render.calibration.bench.calibrate_bench import CalibratedBench, calibrate_bench, place_key
from wlr_render.calibration.bench.common_errors import SOURCES
from wlr_render.calibration.photograph_captures import sound_captures
from wlr_render.calibration.poses import adjoint
from wlr_render.captures.correspondences import Captures
from wlr_render.captures.photo_session import PhotoSession
from wlr_render.geometry import transforms
from wlr_render.geometry.directions import ARCMIN
from wlr_render.planning.planned_bench import ReadingOptions
from wlr_render.simulation.photographs.photo_bench import PhotoBenchOptions
from wlr_render.simulation.photographs.recipe import SimulationRecipe

Calibrated = tuple[PhotoSession, CalibratedBench, Captures]


@pytest.fixture(scope="module")
def calibrated() -> Calibrated:
    recipe = SimulationRecipe("birdbath28", viewpoints=4, bench=PhotoBenchOptions((640, 512), seed=3))
    made = simulate_readings(recipe, ReadingOptions(panel_samples=60, most_dots=50))
    session = with_stated_lenses(made.session)
    bench = calibrate_bench(session, made.reading)
    return session, bench, sound_captures(session, made.reading, bench)[0]


def test_own_and_common_motions_are_those_of_the_adjustment(calibrated: Calibrated) -> None:
    session, bench, captures = calibrated
    for part, entries in ((captures.display, session.display), (captures.see_through, session.see_through)):
        poses, covariance = bench.adjustment.camera_poses([place_key(session, each) for each in entries])
        for number, pose in enumerate(poses):
            about = adjoint(transforms.rigid(np.eye(3), -pose[:3, 3]))
            block = about @ covariance[6 * number : 6 * number + 6, 6 * number : 6 * number + 6] @ about.T
            assert part is not None
            common = present(part.common).motion[number]
            found = present(part.motion).size[number] ** 2 + np.sum(common**2, axis=1)
            np.testing.assert_allclose(found, np.diag(block), rtol=1e-6)


def test_the_extrinsics_move_all_cameras_and_targets_alike(calibrated: Calibrated) -> None:
    """Rays to the points turn as little as the optics bend them; the cameras turn by what session.toml states."""
    session, _, captures = calibrated
    assert captures.see_through is not None
    common = captures.see_through.common
    assert common is not None
    assert set(common.sources) <= set(SOURCES)
    assert list(common.sources) == sorted(common.sources, key=SOURCES.index)
    mine = [source == "tracking camera" for source in common.sources]
    turn = np.sqrt(np.mean(np.sum(common.motion[:, :3][..., mine] ** 2, axis=2)))
    assert turn == pytest.approx(present(session.tracking_sigma)[0], rel=0.1)
    changes, seen = common.changes(captures.see_through, slice(None)), captures.see_through
    assert seen is not None
    depth = (seen.viewpoint - seen.point)[:, 2, None, None]
    moved = changes.viewpoint - present(changes.point)
    by_ray = changes.tangents + (moved[:, :2] + seen.tangents[:, :, None] * moved[:, 2:]) / depth
    assert np.sqrt(np.mean(by_ray[..., mine] ** 2)) < 0.02 * turn


def test_own_motions_are_of_the_stage_alone(calibrated: Calibrated) -> None:
    """Repeatability of 5 um and 10 urad, and what a few photographs leave open; not the 0.3 mm of the extrinsics."""
    _, _, captures = calibrated
    assert captures.display is not None
    turn, shift = (
        np.sqrt(np.mean(present(captures.display.motion).size[:, part] ** 2)) for part in (slice(0, 3), slice(3, 6))
    )
    assert 3e-6 < turn < 1e-4
    assert 1e-6 < shift < 5e-5
    assert np.any(present(captures.display.common).motion[:, :3] > 1.0 * ARCMIN)
