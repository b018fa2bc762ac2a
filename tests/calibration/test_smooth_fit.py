"""What the fits find of a bench, and that their standard errors are true whatever the bench adds to the noise."""

from dataclasses import replace

import numpy as np
import pytest
from calibration.toy_device import PANEL, display_captures, errors_arcmin, grid_in_plane
from present import narrowed

from wlr_render.calibration.fit_display import fit_display
from wlr_render.calibration.smooth_prior import smoothness_prior
from wlr_render.calibration.smooth_search import fit
from wlr_render.captures.correspondences import DisplayCaptures, select
from wlr_render.errors import BadInputError
from wlr_render.geometry.directions import ARCMIN, arcmin_between, dir_of_tangents, tangents_of_dir
from wlr_render.models.display_model import DisplayModel
from wlr_render.numerics.arrays import FloatArray
from wlr_render.numerics.shared_noise import SharedNoise
from wlr_render.optics.device_file import load_device
from wlr_render.optics.traced_mappings import traced_eye
from wlr_render.simulation import viewpoints
from wlr_render.simulation.capture_setup import CaptureSetup
from wlr_render.simulation.simulate_captures import simulate_display

SIGMA_ARCMIN = 1.0
CAPTURES = 25
PIXELS = PANEL.grid(8, 6).reshape(-1, 2)
DRAWS = 8


def clean(seed: int, sigma: float = SIGMA_ARCMIN) -> DisplayCaptures:
    return display_captures(grid_in_plane(5, 5), PIXELS, sigma_arcmin=sigma, seed=seed)


def shifted(captures: DisplayCaptures, shift: FloatArray) -> DisplayCaptures:
    """Cameras that stand elsewhere than stated, by `shift` (captures, 3) metres."""
    return replace(captures, viewpoint=captures.viewpoint + shift[captures.capture])


def kicked(captures: DisplayCaptures, off: FloatArray) -> DisplayCaptures:
    return replace(captures, view_dir=dir_of_tangents(tangents_of_dir(captures.view_dir) + off * ARCMIN))


def gross(captures: DisplayCaptures, rng: np.random.Generator) -> DisplayCaptures:
    wrong = rng.random(len(captures)) < 0.05
    return kicked(captures, wrong[:, None] * rng.normal(0.0, 60.0, (len(captures), 2)))


def rim(captures: DisplayCaptures, rng: np.random.Generator) -> DisplayCaptures:
    """Noise that doubles from the middle of the panel to its corners."""
    radius = np.linalg.norm(2 * captures.pixel / PANEL.size_px - 1, axis=1) / np.sqrt(2)
    return kicked(captures, np.sqrt((1 + radius) ** 2 - 1)[:, None] * rng.normal(size=(len(captures), 2)))


def drift(captures: DisplayCaptures, rng: np.random.Generator) -> DisplayCaptures:
    """A stage that creeps by 20 um over a session that takes its positions in any order.

    Row by row the drift would be a smooth function of the place, which no captures tell from the optics.
    """
    return shifted(captures, rng.permutation(np.linspace(-1e-5, 1e-5, CAPTURES))[:, None] * [1.0, 0.5, 0.0])


def stage_motion(captures: DisplayCaptures, rng: np.random.Generator) -> DisplayCaptures:
    return shifted(captures, rng.normal(0, 3e-5, (CAPTURES, 3)))


IMPERFECTIONS = {
    "none": lambda captures, rng: captures,
    "stage motion": stage_motion,
    "noise growing to the rim": rim,
    "5 % gross readings": gross,
    "heavy tails": lambda captures, rng: kicked(captures, rng.standard_t(3, (len(captures), 2))),
    "drift": drift,
}


@pytest.mark.slow
@pytest.mark.parametrize("name", IMPERFECTIONS)
def test_the_predicted_error_is_the_true_one(name: str) -> None:
    squares = []
    for seed in range(DRAWS):
        rng = np.random.default_rng(100 + seed)
        found = fit_display(IMPERFECTIONS[name](clean(seed), rng), "planar", 4)
        assert found.smooth.moved == ()
        true, predicted = errors_arcmin(found.mapping, rng)
        squares.append([np.mean(true**2), np.mean(predicted**2)])
    true, predicted = np.array(squares).T
    ratio = np.sqrt(predicted.mean() / true.mean())
    resampled = np.random.default_rng(0).integers(0, DRAWS, (500, DRAWS))
    ratios = np.sqrt(predicted[resampled].mean(axis=1) / true[resampled].mean(axis=1))
    low, high = np.quantile(ratios, [0.025, 0.975])
    print(f"{name}: predicted over true {ratio:.2f} ({low:.2f} to {high:.2f})")
    # The interval of the draws must reach into what is promised.
    assert low < 1.25
    assert high > 0.8


@pytest.mark.slow
@pytest.mark.parametrize(("shift", "turn"), [(0.0, 0.0), (3e-5, 0.0), (1e-5, 2e-4)])
def test_noise_and_stage_are_found(shift: float, turn: float) -> None:
    found = []
    for seed in range(6):
        rng = np.random.default_rng(seed)
        captures = shifted(clean(seed, 0.25), rng.normal(0, shift, (CAPTURES, 3)))
        turned = np.cross(rng.normal(0, turn, (CAPTURES, 3))[captures.capture], captures.view_dir)
        view_dir = captures.view_dir + turned
        captures = replace(captures, view_dir=view_dir / np.linalg.norm(view_dir, axis=1, keepdims=True))
        smooth = fit_display(captures, "planar", 4).smooth
        found.append([smooth.noise, smooth.shift_m, smooth.turn_rad])
    noise, shift_m, turn_rad = np.median(found, axis=0)
    assert noise == pytest.approx(1.0, rel=0.05)
    assert shift_m == pytest.approx(shift, rel=0.5, abs=5e-6)
    assert turn_rad == pytest.approx(turn, rel=0.5, abs=2e-5)


@pytest.mark.parametrize(("count", "size_m"), [(1, 3e-4), (2, 1e-3), (5, 2e-3)])
def test_captures_from_elsewhere_are_left_out_and_named_with_their_shift(count: int, size_m: float) -> None:
    for seed in range(2):
        rng = np.random.default_rng(seed)
        shift = rng.normal(0, 3e-6, (CAPTURES, 3))
        gone = rng.permutation(CAPTURES)[:count]
        angle = rng.uniform(0, 2 * np.pi, count)
        shift[gone] = size_m * np.stack([np.cos(angle), np.sin(angle), 0 * angle], axis=-1)
        found = fit_display(shifted(clean(seed, 0.1), shift), "planar", 4)
        assert {each.capture for each in found.smooth.moved} == set(gone)
        for each in found.smooth.moved:
            assert each.shift_m == pytest.approx(size_m, rel=0.3)
            assert each.log10_odds > 4
        true, predicted = errors_arcmin(found.mapping, rng)
        assert np.sqrt(np.mean(true**2)) < 2 * np.sqrt(np.mean(predicted**2))


@pytest.mark.parametrize("sigma", [0.005, 0.0005])
def test_a_sharp_camera_is_believed(sigma: float) -> None:
    smooth = fit_display(clean(1, sigma), "planar", 4).smooth
    assert smooth.noise == pytest.approx(1.0, rel=0.05)


def test_noise_that_neighbours_share_does_not_depend_on_where_its_search_starts() -> None:
    captures, rng = display_captures(grid_in_plane(5, 5), PANEL.grid(12, 10).reshape(-1, 2)), np.random.default_rng(0)
    place = captures.pixel[captures.capture == 0]
    root = np.linalg.cholesky(0.4 * SharedNoise(1.0, 250.0).correlation(place) + 0.6 * np.eye(len(place)))
    noise = (root @ rng.normal(size=(CAPTURES, len(place), 2))).reshape(-1, 2)
    smooth = fit_display(kicked(replace(captures, sigma_arcmin=np.ones(len(captures))), noise), "planar", 4).smooth
    readings = smooth.readings
    assert readings.shared is not None
    assert 0.2 < readings.shared.share < 0.6
    for off in (-0.2, -0.04, 0.04, 0.2):
        start = replace(readings.shared, share=readings.shared.share + off)
        before = replace(smooth, readings=readings.with_shared(start))
        assert fit(readings, before).readings.shared == readings.shared


def test_gross_readings_lose_their_weight() -> None:
    captures = clean(1)
    off = np.zeros((len(captures), 2))
    off[[5, 300]] = 100.0
    kept = fit_display(kicked(captures, off), "planar", 4).smooth.kept
    np.testing.assert_array_equal(np.flatnonzero(kept == 0.0), [5, 300])


def test_readings_that_contradict_each_other_are_refused() -> None:
    captures = clean(1)
    mixed = replace(captures, pixel=np.random.default_rng(0).permutation(captures.pixel))
    with pytest.raises(BadInputError, match=r"contradict each other: no smooth optics brings them within .*' of one"):
        fit_display(mixed)


def test_optics_beyond_the_orders_are_not_taken_for_a_bad_stage() -> None:
    """A motion that varies smoothly with the place does what terms beyond the orders would do."""
    truth = traced_eye(load_device("freeform40"), "right")
    setup = CaptureSetup(truth, 0.1, grid=(12, 10))
    places = viewpoints.planar(truth.eye_box, setup.field.reach, CAPTURES)
    captures = simulate_display(setup, places, np.random.default_rng(1))
    assert fit_display(captures, "planar", 7).smooth.shift_m < 5e-5


def test_readings_that_were_left_out_promise_nothing() -> None:
    """Further positions add to the readings in use: with none of them the covariance stays what it is."""
    readings = fit_display(clean(0)).smooth.readings
    half = fit(readings, weights=np.asarray(np.arange(len(readings)) % 2.0))
    variances = [
        np.trace(spread.covariance(readings.inputs[::7]), axis1=1, axis2=2).mean()
        for spread in (half.spread, half.spread_with(readings))
    ]
    assert variances[1] == pytest.approx(variances[0], rel=0.02)


def test_motions_of_the_camera_are_no_coefficients() -> None:
    """The readings also determine how a bad stage moved, which says nothing more of the model."""
    moves = np.random.default_rng(1).normal(0.0, 1e-4, (CAPTURES, 3))
    fitted = fit_display(shifted(clean(1, 0.25), moves), "planar", 2)
    report = fitted.report
    size = narrowed(fitted.mapping, DisplayModel).forward.coefficients.size
    assert fitted.smooth.posterior.determined > report.coefficients == size
    assert 0.5 * report.coefficients < report.determined <= report.coefficients


def test_what_is_left_out_is_predicted_as_by_a_fit_to_the_rest() -> None:
    # So little motion that both fits find the same sizes of the stage's errors.
    captures = shifted(clean(3), np.random.default_rng(3).normal(0, 8e-6, (CAPTURES, 3)))
    out = captures.capture // 5 == 2  # the middle row, so that nothing is extrapolated
    found, expected = fit_display(captures, "planar").smooth.left_out(out)
    rest = fit_display(select(captures, ~out), "planar").mapping
    seen = rest.view_dir_of_pixel(captures.pixel[out], captures.viewpoint[out]).value
    rms = np.sqrt(np.mean(arcmin_between(seen, captures.view_dir[out]) ** 2))
    assert found == pytest.approx(rms, rel=0.02)
    assert expected == pytest.approx(rms, rel=0.3)


def test_mixed_terms_are_expected_as_a_power_of_the_footprint_has_them() -> None:
    """(a u + b x)^4 (c v + d y)^2: its coefficients are products of binomial ones and powers of a, b, c and d."""
    readings = fit_display(display_captures(grid_in_plane(5, 5)), "planar", 6).smooth.readings
    prior = smoothness_prior(readings, moving=False)
    factors = {"lambda 0": 0.5, "lambda 1": 0.4, "mu 2": 0.3, "mu 3": 0.2}
    values = {name: -np.log(factors[name]) for name in factors} | {"footprint": 1.0}
    size = np.exp(prior.features @ [values.get(name, 0.0) for name in prior.names])
    power = np.polynomial.polynomial.polypow([1.0, 1.0], 4)
    for order, of_place in enumerate(power):
        (column,) = np.flatnonzero((readings.orders == [4 - order, 1, order, 1]).all(axis=1))
        assert np.isclose(size[column], of_place * 0.5 ** (4 - order) * 0.3**order * 2.0 * 0.4 * 0.2)
