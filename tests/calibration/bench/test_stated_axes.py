"""One bare photograph, as in the paper's procedure: the stage's axes are stated in session.toml with their sigma.

The simulated stage turns, bends and creeps, its axes are not at right angles and misstate their travel by 0.1 %, and
all stated directions share one error: the adjustment takes the errors of the axes for independent.
"""

from dataclasses import replace
from typing import Any, Literal

import numpy as np
import pytest
from present import present
from scipy.linalg import block_diag
from small_photo_session import with_stated_lenses

from benchmarks.simulated_lab.simulate_readings import SimulatedReadings, simulate_readings
from wlr_render.calibration.bench.calibrate_bench import calibrate_bench, place_key
from wlr_render.calibration.poses import adjoint
from wlr_render.captures.photo_session import PhotoSession, StageDescription
from wlr_render.errors import BadInputError
from wlr_render.geometry import transforms
from wlr_render.numerics.arrays import FloatArray
from wlr_render.planning.planned_bench import ReadingOptions
from wlr_render.simulation.photographs.photo_bench import PhotoBenchOptions
from wlr_render.simulation.photographs.recipe import SimulationRecipe

FEW = ReadingOptions(most_dots=120, panel_samples=50)
STATED_DEG = 0.2


def simulated(seed: int, sampling: Literal["planar", "volumetric"] = "volumetric") -> SimulatedReadings:
    bench = PhotoBenchOptions(camera_px=(640, 512), seed=seed, sampling=sampling, stated_axes_deg=STATED_DEG)
    made = simulate_readings(SimulationRecipe("birdbath28", viewpoints=9, bench=bench), FEW)
    return replace(made, session=with_stated_lenses(made.session))


def with_axes(session: PhotoSession, **changes: Any) -> PhotoSession:
    axes = tuple(replace(axis, **changes) for axis in present(session.stage).axes)
    return replace(session, stage=StageDescription(axes))


def off_over_sigma(made: SimulatedReadings, session: PhotoSession) -> tuple[FloatArray, FloatArray]:
    """(n, 3) errors of the camera's positions about their mean, over their sigmas; and the sigmas."""
    found = calibrate_bench(session, made.reading)
    assert all(check.ok for check in found.checks)
    entries = (*session.display, *session.see_through)
    position = np.array([found.device_from_camera(each)[:3, 3] for each in entries])
    off = np.concatenate([made.truth.display, made.truth.see_through])[:, :3, 3] - position
    poses, covariance = found.adjustment.camera_poses([place_key(session, each) for each in entries])
    count = len(entries)
    about = [adjoint(transforms.rigid(np.eye(3), -pose[:3, 3]))[3:] for pose in poses]
    less_mean = np.eye(count) - 1.0 / count
    rows = np.kron(less_mean, np.eye(3)) @ block_diag(*about)
    sigma = np.sqrt(np.einsum("ij,jk,ik->i", rows, covariance, rows)).reshape(count, 3)
    return (off - off.mean(axis=0)) / sigma, sigma


@pytest.mark.slow
def test_positions_are_as_wrong_as_their_sigmas_say() -> None:
    ratios = []
    for seed in (1, 5, 6, 7):
        made = simulated(seed)
        (only,) = {each.name for each in made.session.bare if each.target_pose == 0}
        assert only == "bare/pose0_00.png"
        ratios.append(off_over_sigma(made, made.session)[0])
    assert 0.5 < np.sqrt(np.mean(np.square(ratios))) < 1.4
    # Of normal errors 95 %; one photograph at each target pose says little of the stage's random error.
    assert np.mean(np.abs(ratios) < 2.0) > 0.9


@pytest.mark.slow
def test_directions_stated_without_a_sigma_or_in_the_device_frame_count_as_known_to_an_ordinary_one() -> None:
    made = simulated(2)
    rotation = made.truth.bench.device_from_camera[:3, :3]
    in_device = tuple(
        replace(axis, direction=rotation @ present(axis.direction), is_in_camera=False)
        for axis in present(made.session.stage).axes
    )
    for session in (
        with_axes(made.session, direction_sigma=None),
        replace(made.session, stage=StageDescription(in_device)),
    ):
        ratio, sigma = off_over_sigma(made, session)
        assert np.sqrt(np.mean(ratio**2)) < 1.5
        assert 1e-5 < np.sqrt(np.mean(sigma**2)) < 4e-5


@pytest.mark.slow
def test_one_photograph_without_stated_axes_is_refused_with_both_remedies() -> None:
    made = simulated(1)
    unknown = with_axes(made.session, direction=None, direction_sigma=None, is_in_camera=False)
    with pytest.raises(BadInputError, match=r"axis 1, .* at other readings .*, or state the axis' 'direction' under"):
        calibrate_bench(unknown, made.reading)
