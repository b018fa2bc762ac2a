"""Fits to captures that state how far the camera moved: right, wrong, for some captures more than for others.

Motions are uniform or drifts, noise has heavy tails: the fits model neither.
"""

from dataclasses import replace

import numpy as np
import pytest
from calibration.toy_device import PANEL, display_captures, errors_arcmin, grid_in_plane, see_through_captures
from numpy.typing import ArrayLike
from present import present

from wlr_render.calibration.fit_display import fit_display
from wlr_render.calibration.fit_see_through import fit_see_through
from wlr_render.captures.correspondences import AnyCaptures, DisplayCaptures, concatenate, select
from wlr_render.captures.feature_captures import CaptureMotionPrior
from wlr_render.geometry.directions import ARCMIN, normalised
from wlr_render.geometry.transforms import rotations_of_vectors
from wlr_render.numerics.arrays import FloatArray

PLACES = 25
PIXELS = PANEL.grid(8, 6).reshape(-1, 2)
SIZE = np.array([6e-5, 3e-5, 4e-5, 10e-6, 10e-6, 25e-6])
NOISE_ARCMIN = 0.25


def moved(
    captures: AnyCaptures, motion: FloatArray, rng: np.random.Generator, noise_arcmin: float = NOISE_ARCMIN
) -> AnyCaptures:
    """As taken by a camera that turned and stood elsewhere by `motion` (groups, 6), with noise of heavy tails."""
    own = motion[captures.visits[1]]
    measured = np.einsum("nji,nj->ni", rotations_of_vectors(own[:, :3]), captures.view_dir)
    noise = noise_arcmin * ARCMIN / np.sqrt(2) * rng.standard_t(4, measured.shape)
    noise -= np.sum(noise * measured, axis=1, keepdims=True) * measured
    return replace(
        captures,
        viewpoint=captures.viewpoint - own[:, 3:],
        view_dir=normalised(measured + noise),
        sigma_arcmin=np.full(len(captures), noise_arcmin),
    )


def uniform(rng: np.random.Generator, size: FloatArray) -> FloatArray:
    return size * rng.uniform(-np.sqrt(3), np.sqrt(3), size.shape)


def stated(captures: AnyCaptures, size: FloatArray, log_sigma: float) -> AnyCaptures:
    return replace(captures, motion=CaptureMotionPrior(np.unique(captures.visits[0]), size, log_sigma))


def display() -> DisplayCaptures:
    return display_captures(grid_in_plane(5, 5), PIXELS)


def rms(values: ArrayLike) -> float:
    return float(np.sqrt(np.mean(np.square(values))))


def creeping(rng: np.random.Generator, size: FloatArray) -> tuple[FloatArray, FloatArray]:
    """A stage that creeps while it takes its positions in any order, the same way in all axes."""
    along = rng.permutation(np.linspace(-1.0, 1.0, len(size)))[:, None]
    return np.sqrt(3) * along * SIZE, np.sqrt(3) * np.abs(along) * SIZE + 0.1 * SIZE


@pytest.mark.slow
@pytest.mark.parametrize(
    ("factor", "log_sigma", "drifts"),
    [(1.0, 0.1, False), (2.0, 0.5, False), (0.5, 0.5, False), (1.0, 0.1, True)],
)
def test_the_predicted_error_is_the_true_one(factor: float, log_sigma: float, drifts: bool) -> None:
    errors = []
    for seed in range(8):
        rng = np.random.default_rng(seed)
        size = np.tile(SIZE, (PLACES, 1))
        motion, size = creeping(rng, size) if drifts else (uniform(rng, size), size)
        found = fit_display(stated(moved(display(), motion, rng), factor * size, log_sigma), "planar", 4)
        assert found.smooth.moved == ()
        errors.append([rms(each) for each in errors_arcmin(found.mapping, rng)])
    true, predicted = np.sqrt(np.mean(np.square(errors), axis=0))
    print(f"{factor}, {log_sigma}, {drifts}: predicted over true {predicted / true:.2f}")
    assert 0.75 < predicted / true < 1.35


@pytest.mark.slow
def test_captures_that_are_known_to_be_worse_spoil_nothing() -> None:
    """Five of them were taken by hand."""
    size = np.tile(SIZE, (PLACES, 1))
    worse = [3, 8, 11, 17, 20]
    size[worse] *= 10.0
    true, predicted, without, alone, factors = [], [], [], [], []
    for seed in range(4):
        rng = np.random.default_rng(seed)
        captures = moved(display(), uniform(rng, size), rng)
        found = fit_display(stated(captures, size, 0.5), "planar", 4)
        assert found.smooth.moved == ()
        agreement = found.smooth.motion_agreement
        assert agreement is not None
        factors.append([agreement.shift_factor, agreement.turn_factor])
        errors = errors_arcmin(found.mapping, rng)
        true.append(rms(errors[0]))
        predicted.append(rms(errors[1]))
        told_nothing = fit_display(captures, "planar", 4)
        assert {each.capture for each in told_nothing.smooth.moved} == set(worse)
        without.append(rms(errors_arcmin(told_nothing.mapping, rng)[0]))
        good = select(stated(captures, size, 0.5), ~np.isin(captures.capture, worse))
        alone.append(rms(errors_arcmin(fit_display(good, "planar", 4).mapping, rng)[0]))
    assert rms(true) < rms(without)
    assert rms(true) < rms(alone)
    assert 0.75 < rms(predicted) / rms(true) < 1.35
    np.testing.assert_allclose(np.median(factors, axis=0), 1.0, atol=0.35)


def test_captures_that_are_known_to_be_worse_are_not_named() -> None:
    rng = np.random.default_rng(0)
    size = np.tile(SIZE, (PLACES, 1))
    size[[3, 11, 17]] *= 40.0
    captures = moved(display(), uniform(rng, size), rng)
    assert fit_display(captures, "planar", 4).smooth.moved != ()
    assert fit_display(stated(captures, size, 0.2), "planar", 4).smooth.moved == ()


def test_a_good_capture_that_moved_as_much_as_bad_ones_may_is_named() -> None:
    rng = np.random.default_rng(1)
    size = np.tile(SIZE, (PLACES, 1))
    size[[1, 3, 7, 9, 11, 15, 19, 21]] *= 40.0
    motion = uniform(rng, size)
    motion[12, 3:5] += 7e-4
    found = fit_display(stated(moved(display(), motion, rng), size, 0.2), "planar", 4)
    assert [each.capture for each in found.smooth.moved] == [12]


@pytest.mark.parametrize("log_sigma", [0.1, 0.5])
def test_captures_far_beyond_their_prior_are_left_out_and_named(log_sigma: float) -> None:
    rng = np.random.default_rng(0)
    size = np.tile(SIZE, (PLACES, 1))
    motion = uniform(rng, size)
    gone = rng.permutation(PLACES)[:2]
    motion[gone, 3:5] += 1e-3
    found = fit_display(stated(moved(display(), motion, rng), size, log_sigma), "planar", 4)
    assert {each.capture for each in found.smooth.moved} == set(gone)
    true, predicted = errors_arcmin(found.mapping, rng)
    assert rms(true) < 1.5 * rms(predicted)


@pytest.mark.parametrize("factor", [0.25, 1.0, 4.0])
def test_readings_agree_with_a_right_prior_alone(factor: float) -> None:
    rng = np.random.default_rng(3)
    size = np.tile(SIZE, (PLACES, 1))
    found = fit_display(stated(moved(display(), uniform(rng, size), rng), factor * size, 0.2), "planar", 4)
    agreement = found.report.motion_agreement
    assert agreement is not None
    assert agreement.shift_m == pytest.approx(factor * np.sqrt(np.mean(SIZE[3:] ** 2)))
    assert agreement.turn_rad == pytest.approx(factor * np.sqrt(np.mean(SIZE[:3] ** 2)))
    assert found.report.wobble_urad == pytest.approx(1e6 * agreement.turn_factor * agreement.turn_rad)
    if factor == 1.0:
        assert max(agreement.shift_sigmas, agreement.turn_sigmas) < 2.5
        assert agreement.turn_factor == pytest.approx(1.0, rel=0.3)
    else:
        assert max(agreement.shift_sigmas, agreement.turn_sigmas) > 3.0
        assert (agreement.turn_factor < 0.8) if factor > 1 else (agreement.turn_factor > 1.25)


def test_each_axis_has_its_own_size() -> None:
    """A camera that rolls, and is known to do nothing else."""
    rng = np.random.default_rng(0)
    size = np.tile([1e-7, 1e-7, 1e-3, 1e-7, 1e-7, 1e-7], (PLACES, 1))
    motion = uniform(rng, size)
    found = fit_display(stated(moved(display(), motion, rng), size, 0.1), "planar", 4)
    turned = found.smooth.posterior.group_mean
    assert abs(np.corrcoef(turned[:, 5], motion[:, 2])[0, 1]) > 0.8
    assert np.abs(turned[:, :5]).max() < 1e-6


def test_a_fit_without_motions_states_none() -> None:
    assert fit_display(display(), "planar", 4).report.motion_agreement is None


def test_visits_of_a_position_move_apart_and_stay_one_position() -> None:
    """Each target pose is photographed twice from each position; the second time the camera stands elsewhere."""
    once = see_through_captures(grid_in_plane(5, 5))
    first = once.visits[1]
    twice = concatenate([replace(once, visit=number) for number in (first, first + first.max() + 1)])
    rng = np.random.default_rng(2)
    size = np.tile(SIZE, (len(twice.visits[0]), 1))
    captures = moved(twice, uniform(rng, size), rng, 0.05)
    found = fit_see_through(stated(captures, size, 0.1), "planar", 3)
    assert found.smooth.posterior.group_mean.shape == (4 * PLACES, 6)
    assert found.report.viewpoints == PLACES
    assert sum(each.captures for each in found.report.held_out) == 2 * PLACES
    assert present(found.report.motion_agreement).shift_sigmas < 3.0
    assert present(found.report.one_more).predicted_arcmin < found.report.predicted_arcmin
    # One motion for both visits leaves the difference of the two to the noise.
    unnumbered = replace(captures, visit=np.full(len(captures), -1))
    assert fit_see_through(unnumbered, "planar", 3).smooth.noise > 1.5 * found.smooth.noise
