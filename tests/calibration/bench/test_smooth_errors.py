"""Smooth errors of boards and errors by reading of a stage's axes: their sizes are found, and sigmas include them."""

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any, cast

import numpy as np
import pytest
from calibration.bench.imperfect_bench import Imperfections, TrueBench, adjusted, thinned
from present import narrowed, present
from scipy.spatial.transform import Rotation

from benchmarks.simulated_lab.saved_station import load_station
from wlr_render.calibration.bench.adjustment import Adjustment
from wlr_render.calibration.bench.board_views import TRACKING, BenchObservations
from wlr_render.calibration.bench.calibrate_bench import CalibratedBench
from wlr_render.calibration.bench.faults import worst_fault
from wlr_render.calibration.bench.start import start_state
from wlr_render.calibration.bench.station_file import save_station
from wlr_render.calibration.poses import motion_between, small_motion
from wlr_render.captures.photo_session import PhotoSession
from wlr_render.lenses.lens_camera import LensCamera
from wlr_render.numerics.arrays import FloatArray

Crumpled = Sequence[tuple["CrumpledBench", Adjustment]]

PRINT_M, HEIGHT_M, SCREW_M, PERIOD_M, RIPPLE_PX = 6e-5, 1e-4, 1e-5, 1.7e-3, 0.1


class CrumpledBench(TrueBench):
    """A board with smooth printing errors and heights of another shape than a parabola."""

    def __post_init__(self) -> None:
        super().__post_init__()
        rng = np.random.default_rng([self.seed, 8])
        x, y = self.nominal[:, :2].T
        for axis, size in ((0, PRINT_M), (1, PRINT_M), (2, HEIGHT_M)):
            wave, phase = rng.normal(size=(2, 40)) / 0.09, rng.uniform(0, 2 * np.pi, 40)
            field = np.cos(np.outer(x, wave[0]) + np.outer(y, wave[1]) + phase).sum(axis=1)
            # The affine part is the board's pose and scale.
            affine = np.column_stack([np.ones(len(x)), x, y])
            field -= affine @ np.linalg.lstsq(affine, field, rcond=None)[0]
            self.point[:, axis] += size * field / field.std()


class ScrewBench(TrueBench):
    """A stage whose axes have a periodic error."""

    def smooth(self, reading: FloatArray) -> FloatArray:
        screw = SCREW_M * np.sin(2 * np.pi * reading / PERIOD_M + self.phase[:, 0])
        return np.asarray(super().smooth(reading) + np.concatenate([np.zeros(3), self.axes @ screw]))


class RippledLens:
    """A lens with oblique waves over its picture, which no model of few terms has."""

    def __init__(self, model: LensCamera) -> None:
        self.model, self.size_px, self.kind, self.centre_px = model, model.size_px, model.kind, model.centre_px

    def pixel_of_point(self, point: FloatArray) -> FloatArray:
        pixel = self.model.pixel_of_point(point)
        unit = (pixel - self.centre_px) / (0.5 * np.hypot(*self.size_px))
        waves = np.stack([unit @ [6.0, 5.0] + 1.0, unit @ [-4.0, 7.0] + 2.0], axis=-1)
        return np.asarray(pixel + RIPPLE_PX * np.sqrt(2.0) * np.cos(waves))


class RippledBench(TrueBench):
    """Lenses with waves."""

    def __post_init__(self) -> None:
        super().__post_init__()
        self.lens = {name: cast(LensCamera, RippledLens(model)) for name, model in self.lens.items()}


class WarmBench(TrueBench):
    """A camera that warms up: its image shifts by 0.5 px, half of it in the first fifth of the session."""

    turn = np.array([2.9e-4, -2.2e-4, 0.0, 0.0, 0.0, 0.0])
    visits = -1
    order = (*range(11), *range(20, 31), *range(11, 20))  # the sweep is between both targets

    def camera_at(self, reading: FloatArray) -> FloatArray:
        self.visits += 1
        warm = 1.0 - np.exp(-self.order[self.visits] / 9.0)
        return super().camera_at(reading) @ small_motion(warm * self.turn)

    def observations(self, *given: Any, **named: Any) -> BenchObservations:
        found = super().observations(*given, **named)
        timed = zip(found.places.items(), self.order, strict=True)
        return replace(found, places={name: replace(place, time_s=40.0 * k) for (name, place), k in timed})


@pytest.fixture(scope="module")
def crumpled() -> list[tuple[CrumpledBench, Adjustment]]:
    found = []
    for seed in range(3):
        bench = CrumpledBench(seed, replace(Imperfections(), extrinsics_rad=0.0, extrinsics_m=0.0))
        found.append((bench, adjusted(thinned(bench.observations(lens_photographs=6), 4))))
    return found


def test_features_that_no_photograph_shows_are_predicted_by_those_that_it_shows(crumpled: Crumpled) -> None:
    """Three quarters of the dots are in no view; the fields are wider than the distances of the others."""
    for bench, found in crumpled:
        shape = found.state.shape["board"]
        unseen = shape.rows_of(bench.feature) < 0
        assert unseen.mean() > 0.7
        off = (shape.point_of(bench.feature, bench.nominal) - bench.point)[unseen]
        place = np.column_stack([np.ones(len(off)), bench.nominal[unseen, :2]])
        off -= place @ np.linalg.lstsq(place, off, rcond=None)[0]  # poses of the board have these parts
        assert np.sqrt(np.mean(off[:, :2] ** 2)) < 0.5 * PRINT_M
        assert np.sqrt(np.mean(off[:, 2] ** 2)) < 0.6 * HEIGHT_M


def test_the_smooth_part_of_a_board_is_told_from_the_errors_of_single_features(crumpled: Crumpled) -> None:
    dots = [found.sizes.feature_m["board"] for _, found in crumpled]
    fields = [found.sizes["print"] for _, found in crumpled]
    assert np.mean(dots) < 0.6 * PRINT_M
    assert PRINT_M / 2 < np.exp(np.mean(np.log(fields))) < PRINT_M * 2


def pulls_of_places(bench: CrumpledBench | ScrewBench | WarmBench, found: Adjustment) -> FloatArray:
    """(places, 6) errors over sigmas, of rotation and position, of the camera at places that no view shows."""
    places = [place for place in bench.true_places if place.startswith("sweep")]
    poses = [found.camera_pose(place) for place in places]
    return np.array(
        [
            motion_between(pose.b_from_a, bench.true_places[place]) / np.sqrt(np.diag(pose.covariance))
            for place, pose in zip(places, poses, strict=True)
        ]
    )


def test_errors_of_cameras_before_a_crumpled_board_are_as_large_as_their_sigmas(crumpled: Crumpled) -> None:
    pulls = np.concatenate([pulls_of_places(bench, found) for bench, found in crumpled])
    assert 0.5 < np.sqrt(np.mean(pulls**2)) < 1.5


def test_a_board_in_a_station_file_has_its_smooth_errors(crumpled: Crumpled, tmp_path: Path) -> None:
    bench, found = crumpled[0]
    path = save_station(
        tmp_path / "station-right.json", CalibratedBench(cast(PhotoSession, None), found, (), {}, (), ())
    )
    expected = found.state.shape["board"].point_of(bench.feature, bench.nominal)
    np.testing.assert_allclose(
        present(load_station(path).shape).point_of(bench.feature, bench.nominal), expected, atol=2e-9
    )


@pytest.mark.slow
def test_errors_by_reading_are_in_the_sigmas_of_places() -> None:
    """Visits to one reading share an error, so that their mean is worse than a mean of independent errors."""
    pulls, sizes = [], []
    for seed in range(5):
        size = replace(
            Imperfections(), extrinsics_rad=0.0, extrinsics_m=0.0, repeatability_m=5e-7, turn_jitter_rad=1e-6
        )
        bench = ScrewBench(seed, size)
        found = adjusted(thinned(bench.observations(lens_photographs=6)))
        sizes.append(found.sizes["screw"])
        pulls.append(pulls_of_places(bench, found)[:, 3:])
    assert np.sqrt(np.mean(np.square(pulls))) < 1.25  # 1.32 without errors by reading
    assert np.exp(np.mean(np.log(sizes))) > 0.4 * SCREW_M


def test_a_camera_that_warms_up_is_followed_where_times_are_known() -> None:
    pulls, off = [], []
    for seed in range(3):
        bench = WarmBench(seed, replace(Imperfections(), extrinsics_rad=0.0, extrinsics_m=0.0))
        found = adjusted(thinned(bench.observations(lens_photographs=6)))
        turns = np.array(list(found.state.of("drift").values()))
        drift = np.array([found.state.drift_terms(place) @ turns for place in bench.true_places])
        true = np.outer(1.0 - np.exp(-np.array(bench.order) / 9.0), WarmBench.turn[:2])
        off.append((drift - drift.mean(axis=0)) - (true - true.mean(axis=0)))
        pulls.append(pulls_of_places(bench, found))
    assert 0.5 < np.sqrt(np.mean(np.square(pulls))) < 1.5
    assert np.sqrt(np.mean(np.square(off))) < 0.2 * np.std(true, axis=0).mean()


def test_a_session_without_times_has_no_drift() -> None:
    observations = TrueBench(1).observations(lens_photographs=3)
    few = {name: replace(place, time_s=9.0) for name, place in list(observations.places.items())[:5]}
    lens = TrueBench(1).lens
    for places in (observations.places, {**observations.places, **few}):
        assert not start_state(replace(observations, places=places), lens).of("drift")


def test_a_camera_of_few_photographs_has_the_noise_of_its_own() -> None:
    """Only the unknowns of its photographs count."""
    noise = []
    for seed in range(4):
        observations = thinned(
            TrueBench(seed, replace(Imperfections(), outliers=0.0)).observations(lens_photographs=6), 16
        )
        noise.append(adjusted(observations).sizes.noise[TRACKING])
    assert np.mean(noise) == pytest.approx(1.0, abs=0.06)


def test_what_a_lens_model_leaves_is_in_its_lens_and_no_fault() -> None:
    bench = RippledBench(2)
    found = adjusted(thinned(bench.observations(lens_photographs=9), 4))
    assert worst_fault(found) is None
    for name, true in bench.lens.items():
        lens = found.state.lens[name]
        side = [np.linspace(0.1, 0.9, 15) * length for length in lens.size_px]
        direction = narrowed(true, RippledLens).model.dir_of_pixel(np.stack(np.meshgrid(*side), axis=-1).reshape(-1, 2))
        seen = lens.dir_of_pixel(true.pixel_of_point(direction))
        # The axis of a camera is where its lens model has it: directions count up to a turn.
        turn, _ = Rotation.align_vectors(seen, direction)
        off_px = np.mean(lens.focal_px) * np.linalg.norm(seen - turn.apply(direction), axis=1)
        assert np.sqrt(np.mean(off_px**2)) < 0.6 * RIPPLE_PX
