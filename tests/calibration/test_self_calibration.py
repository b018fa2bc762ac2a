"""Self-calibration by clicks: exact recovery, more clicks, honest covariance, wrong clicks, slips, bad input."""

from collections.abc import Callable, Mapping
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from fitted_eyes import fitted_eye
from numpy.typing import NDArray
from present import narrowed

from wlr_render.calibration.self_calibration import (
    GROWTH,
    OFFSET,
    PANEL_KEPT,
    PARAMETERS,
    POINTING,
    SHIFT,
    TURN,
    Clicks,
    WearSettings,
    WearState,
)
from wlr_render.errors import BadInputError
from wlr_render.geometry import transforms
from wlr_render.geometry.directions import ARCMIN, arcmin_between, dir_of_tangents, normalised
from wlr_render.mappings import Eye, is_planar, require_planar
from wlr_render.models.display_model import DisplayModel
from wlr_render.models.moved_panel import MovedPanelDisplay
from wlr_render.models.see_through_model import SeeThroughModel
from wlr_render.numerics.arrays import FloatArray
from wlr_render.optics.device_file import load_device
from wlr_render.optics.traced_mappings import traced_eye

DEVICE = "birdbath28"
DEPTHS_M = np.array([0.4, 2.0, 0.7, 4.0, 1.0])


@pytest.fixture(scope="module")
def eye() -> Eye:
    return fitted_eye(DEVICE, 3)


def moved_by(
    offset: tuple[float, float, float] | FloatArray = (0, 0, 0),
    shift: tuple[float, float] = (0, 0),
    growth: float = 0.0,
    turn_arcmin: tuple[float, float, float] = (0, 0, 0),
) -> FloatArray:
    return np.concatenate([offset, shift, [growth], np.array(turn_arcmin) * ARCMIN, [0.0, 0.0]])


def dots(eye: Eye, count: int, rng: np.random.Generator) -> tuple[Any, Any]:
    """Viewpoints as tracked, and points in the middle of the field of view at several depths."""
    tracked = eye.eye_box.at(rng.uniform(-0.4, 0.4, (count, 3)))
    direction = dir_of_tangents(rng.uniform([-0.25, -0.13], [0.25, 0.13], (count, 2)))
    return tracked, tracked + direction * (DEPTHS_M[np.arange(count) % 5] / -direction[:, 2])[:, None]


def seen_pixel(
    eye: Eye, truth: FloatArray, tracked: FloatArray, point: FloatArray, error_arcmin: float | FloatArray = 0.0
) -> FloatArray:
    """The pixel that is on a point, straight from the two mappings; written down apart from the package."""
    pupil = tracked + truth[OFFSET]
    device = point @ transforms.rotations_of_vectors(truth[TURN]).T
    seen = eye.see_through.view_dir_of_real_point(device, pupil).value
    right = normalised(np.cross(seen, [0.0, 1.0, 0.0]))
    error = np.broadcast_to(error_arcmin, (len(seen), 2)) * ARCMIN
    aimed = normalised(seen + error[:, :1] * right + error[:, 1:] * np.cross(right, seen))
    at_calibration = eye.display.pixel_of_view_dir(aimed, pupil).value
    middle = 0.5 * eye.display.panel.size_px
    return middle + (at_calibration - middle - truth[SHIFT]) / (1.0 + truth[GROWTH])


def clicked(eye: Eye, truth: FloatArray, count: int, rng: np.random.Generator, noise_arcmin: float = 0.0) -> Clicks:
    tracked, point = dots(eye, count, rng)
    error = noise_arcmin * rng.normal(size=(count, 2))
    return Clicks(seen_pixel(eye, truth, tracked, point, error), point, tracked)


def misalignment(
    eye: Eye, truth: FloatArray, state: WearState, rng: np.random.Generator, count: int = 60
) -> FloatArray:
    """Angles in arcmin at dots that were not clicked, drawn with the state and seen with the truth."""
    tracked, point = dots(eye, count, rng)
    pupil, middle = tracked + truth[OFFSET], 0.5 * eye.display.panel.size_px
    drawn = state.pixel(point, tracked)
    at_calibration = drawn + truth[SHIFT] + truth[GROWTH] * (drawn - middle)
    device = point @ transforms.rotations_of_vectors(truth[TURN]).T
    return arcmin_between(
        eye.display.view_dir_of_pixel(at_calibration, pupil).value,
        eye.see_through.view_dir_of_real_point(device, pupil).value,
    )


def rms(values: FloatArray) -> float:
    return float(np.sqrt(np.mean(np.square(values))))


TRUTH = moved_by((1.2e-3, -0.8e-3, 0.9e-3), (1.6, -1.1), 6e-4, (0.0, 0.0, 1.5))
ONE_CAUSE_EACH = WearSettings(turn_arcmin=0.0, pointing_arcmin=0.0, tracking_m=0.0)


def test_without_noise_the_parameters_are_found_exactly(eye: Eye) -> None:
    display, see_through = narrowed(eye.display, DisplayModel), narrowed(eye.see_through, SeeThroughModel)
    exact = replace(eye, display=replace(display, spread=None), see_through=replace(see_through, spread=None))
    truth = TRUTH.copy()
    truth[TURN] = 0.0
    clicks = clicked(eye, truth, 20, np.random.default_rng(1))
    state = WearState.begin(exact, ONE_CAUSE_EACH).updated(clicks, click_arcmin=0.05)
    # The prior pulls by the square of 0.05' over what it leaves open.
    for part in (OFFSET, SHIFT, GROWTH):
        np.testing.assert_allclose(state.mean[part], truth[part], rtol=1e-3)
    assert state.outliers == ()


def test_a_turn_of_the_head_tracker_is_corrected_although_it_resembles_a_shift(eye: Eye) -> None:
    truth = TRUTH + moved_by(turn_arcmin=(2.0, -1.0, 0.0))
    rng = np.random.default_rng(2)
    settings = WearSettings(turn_arcmin=2.0, pointing_arcmin=0.0, tracking_m=0.0)
    begun = WearState.begin(eye, settings)
    state = begun.updated(clicked(eye, truth, 40, rng), click_arcmin=0.05)
    assert state.mean[TURN][2] == pytest.approx(truth[TURN][2], abs=0.4 * ARCMIN)
    assert rms(misalignment(eye, truth, begun, rng)) > 5.0
    assert rms(misalignment(eye, truth, state, rng)) < 0.1


def test_with_the_panel_kept_a_shift_is_corrected_by_the_pose_alone(eye: Eye) -> None:
    truth, rng = moved_by((1e-3, 0.5e-3, 0.0), (1.5, -1.5)), np.random.default_rng(4)
    begun = WearState.begin(eye, PANEL_KEPT)
    state = begun.updated(clicked(eye, truth, 40, rng), click_arcmin=0.05)
    np.testing.assert_array_equal(state.mean[3:6], 0.0)
    before, after = (rms(misalignment(eye, truth, each, np.random.default_rng(5))) for each in (begun, state))
    assert before > 4.0
    assert after < 0.3


def test_drawing_with_the_corrected_mappings_pose_and_viewpoint_gives_the_corrected_pixel(eye: Eye) -> None:
    state = replace(WearState.begin(eye), mean=TRUTH)
    tracked, point = dots(eye, 10, np.random.default_rng(3))
    world_from_device = transforms.rigid(transforms.rotation_about("y", 0.3), np.array([0.1, 1.5, 2.0]))
    in_world = transforms.apply(world_from_device, point)
    corrected, viewpoint = state.corrected(eye), state.viewpoint(tracked)
    in_device = transforms.apply(transforms.inverse(state.pose(world_from_device)), in_world)
    seen = corrected.see_through.view_dir_of_real_point(in_device, viewpoint).value
    pixel = corrected.display.pixel_of_view_dir(seen, viewpoint).value
    np.testing.assert_allclose(pixel, state.pixel(point, tracked), atol=1e-6)
    np.testing.assert_allclose(pixel, seen_pixel(eye, TRUTH, tracked, point), atol=1e-6)
    np.testing.assert_allclose(corrected.display.view_dir_of_pixel(pixel, viewpoint).value, seen, atol=1e-9)


def test_a_moved_planar_display_stays_one_for_the_shader_and_another_does_not_become_one(eye: Eye) -> None:
    moved = MovedPanelDisplay(eye.display, np.array([1.5, -0.5]), 1e-3)
    display, _ = require_planar(replace(eye, display=moved))
    pixel = moved.panel.grid(5, 4).reshape(-1, 2)
    place = np.broadcast_to(eye.eye_box.centre[:2], pixel.shape)
    at_calibration = pixel + [1.5, -0.5] + 1e-3 * (pixel - 0.5 * moved.panel.size_px)
    of_still = narrowed(eye.display, DisplayModel).forward(np.concatenate([at_calibration, place], axis=1))
    np.testing.assert_allclose(display.modelled(np.concatenate([pixel, place], axis=1)), of_still, atol=1e-12)
    traced = MovedPanelDisplay(traced_eye(load_device(DEVICE)).display, np.zeros(2))
    assert not is_planar(replace(eye, display=traced))


@pytest.fixture(scope="module")
def drawn_updates(eye: Eye) -> NDArray[Any]:
    """Truths from the prior, seen through imperfections that the state does not model: rms and predictions."""
    rng = np.random.default_rng(5)
    settings = WearSettings()
    deviation = np.sqrt(settings.at_start)
    outcomes = []
    for _ in range(24):
        truth = deviation * rng.normal(size=PARAMETERS)
        clicks = clicked(eye, truth, 8, rng)
        # Heavy tails, the wearer's constant error, and a tracker whose error depends on where the pupil is.
        noise = settings.click_arcmin * rng.standard_t(6, (8, 2)) / np.sqrt(1.5) + truth[POINTING]
        tracked = clicks.viewpoint
        travel = tracked - eye.eye_box.centre
        pixel = seen_pixel(eye, truth, tracked, clicks.point, noise)
        clicks = Clicks(pixel, clicks.point, tracked + travel @ rng.normal(0.0, 0.04, (3, 3)).T)
        row = []
        for count in (0, 3, 8):
            state = WearState.begin(eye, settings)
            if count:
                state = state.updated(Clicks(*(each[:count] for each in (pixel, clicks.point, clicks.viewpoint))))
            tracked, point = dots(eye, 40, np.random.default_rng(6))
            true = misalignment(eye, truth, state, np.random.default_rng(6), 40)
            row.append(
                (
                    rms(true),
                    rms(state.sigma_arcmin(point, tracked)),
                    np.trace(state.covariance[:9, :9] / settings.at_start[:9, None]),
                )
            )
        outcomes.append(row)
    return np.array(outcomes)


def test_more_clicks_bring_less_misalignment_and_less_variance(drawn_updates: NDArray[Any]) -> None:
    true, _, variance = np.moveaxis(drawn_updates, -1, 0)
    pooled = np.sqrt(np.mean(true**2, axis=0))
    assert np.all(np.diff(pooled) < 0)
    assert pooled[2] < 0.4 * pooled[0]
    assert np.all(np.diff(variance, axis=1) < 1e-9)


def test_predicted_misalignment_is_the_true_one_in_spite_of_imperfections(drawn_updates: NDArray[Any]) -> None:
    true, predicted = np.sqrt(np.mean(drawn_updates[..., :2] ** 2, axis=0)).T
    np.testing.assert_array_less(0.8, predicted / true)
    np.testing.assert_array_less(predicted / true, 1.25)


def test_a_wrong_click_is_named_and_weighs_less(eye: Eye) -> None:
    rng = np.random.default_rng(7)
    clicks = clicked(eye, TRUTH, 5, rng, noise_arcmin=1.0)
    pixel = clicks.pixel.copy()
    pixel[3] += [25.0, -20.0]
    begun = WearState.begin(eye)
    right = begun.updated(clicks, click_arcmin=1.0)
    state = begun.updated(replace(clicks, pixel=pixel), click_arcmin=1.0)
    assert right.outliers == ()
    assert state.outliers == (3,)
    after_right, after_wrong = (
        rms(misalignment(eye, TRUTH, each, np.random.default_rng(8))) for each in (right, state)
    )
    assert after_wrong < 1.5 * after_right + 0.5


def test_two_wrong_clicks_of_seven_are_named(eye: Eye) -> None:
    clicks = clicked(eye, TRUTH, 7, np.random.default_rng(9), noise_arcmin=1.0)
    clicks.pixel[[1, 5]] += [[30.0, 10.0], [28.0, 12.0]]
    assert WearState.begin(eye).updated(clicks, click_arcmin=1.0).outliers == (1, 5)


def test_a_slip_that_was_not_announced_is_found_and_no_other(eye: Eye) -> None:
    rng = np.random.default_rng(10)
    state = WearState.begin(eye).updated(clicked(eye, TRUTH, 10, rng, noise_arcmin=1.0))
    found = []
    for step in (0.0, 3e-3):
        truth = TRUTH + moved_by(step * np.array([0.6, 0.8, 0.0]))
        after = state.updated(clicked(eye, truth, 5, rng, noise_arcmin=1.0))
        found.append(after.has_slipped)
        assert rms(misalignment(eye, truth, after, rng)) < 2.5
    assert found == [False, True]


def test_an_announced_slip_and_time_widen_what_clicks_may_change(eye: Eye) -> None:
    begun = WearState.begin(eye)
    variance = np.diag(begun.carried(1800.0).slipped().covariance - begun.covariance)
    np.testing.assert_allclose(variance, 0.5 * begun.settings.per_hour + begun.settings.by_slip, atol=1e-15)
    np.testing.assert_array_equal(begun.carried(900.0).mean, begun.mean)


def test_clicks_at_one_dot_do_not_average_the_models_errors_away(eye: Eye) -> None:
    """Two hundred exact clicks at one dot: what remains is the error that the models have there in common."""
    still = WearSettings(0.0, 50.0, 0.0, 0.0, 0.0, tracking_m=0.0, slip_m=0.0)
    tracked, point = dots(eye, 1, np.random.default_rng(11))
    pixel = seen_pixel(eye, np.zeros(PARAMETERS), tracked, point)
    many = Clicks(*(np.repeat(each, 200, axis=0) for each in (pixel, point, tracked)))
    state = WearState.begin(eye, still).updated(many, click_arcmin=0.05)
    per_px = 0.5 * np.sum(
        [
            arcmin_between(
                eye.display.view_dir_of_pixel(pixel, tracked).value,
                eye.display.view_dir_of_pixel(pixel + step, tracked).value,
            )
            for step in np.eye(2)
        ]
    )
    shift_arcmin = np.sqrt(np.trace(state.covariance[SHIFT, SHIFT])) * per_px
    of_pixel = narrowed(eye.display, DisplayModel).sigma(pixel, tracked)
    models = np.hypot(of_pixel, narrowed(eye.see_through, SeeThroughModel).sigma(point, tracked))[0]
    assert shift_arcmin == pytest.approx(models, rel=0.1)


def one_click(eye: Eye, **changes: Any) -> dict[Any, Any]:
    tracked, point = dots(eye, 1, np.random.default_rng(12))
    given = {"pixel": seen_pixel(eye, np.zeros(PARAMETERS), tracked, point), "point": point, "viewpoint": tracked}
    return given | {name: change(given[name]) for name, change in changes.items()}


@pytest.mark.parametrize(
    ("changes", "sentence"),
    [
        ({"pixel": lambda p: p[:0]}, "there is no click; give pixels"),
        (
            {"pixel": lambda p: np.full((1, 2), np.nan)},
            "pixel of the clicks is .*; give 2 finite numbers for each of the 1",
        ),
        ({"point": lambda p: p[0]}, "point of the clicks is .*give 3 finite numbers"),
        ({"pixel": lambda p: p + 5000.0}, "click 0: the pixel .* is not on the panel of 1920 x 1080"),
        ({"point": lambda p: 1e3 * p}, "click 0: the point .* m from the eye; give metres .* not millimetres"),
        ({"point": lambda p: p * [1, 1, -1]}, "click 0: the point .* -z ahead"),
        ({"viewpoint": lambda p: 1e3 * p}, "click 0: the viewpoint .* far from the eye box .* not millimetres"),
        ({"point": lambda p: p + [3.0, 0.0, 0.0]}, "click 0: the point .* degrees from the pixel"),
    ],
)
def test_bad_clicks_are_refused_in_a_sentence(
    eye: Eye, changes: Mapping[str, Callable[..., Any]], sentence: str
) -> None:
    with pytest.raises(BadInputError, match=sentence):
        WearState.begin(eye).updated(Clicks(**one_click(eye, **changes)))


def test_clicks_most_of_which_contradict_each_other_are_refused(eye: Eye) -> None:
    clicks = clicked(eye, TRUTH, 4, np.random.default_rng(13))
    clicks.pixel[1:] += [[60.0, 0.0], [0.0, -70.0], [-50.0, 50.0]]
    with pytest.raises(BadInputError, match=r"3 of 4 clicks contradict the others.* Click again"):
        WearState.begin(eye).updated(clicks)


@pytest.mark.parametrize(
    ("make", "sentence"),
    [
        (lambda eye: WearSettings(slip_m=1.5), "slip_m is 1.5 m; is it in millimetres"),
        (lambda eye: WearSettings(shift_px=-1.0), "shift_px is -1; a standard deviation"),
        (lambda eye: WearSettings(growth=np.nan), "growth is nan; give zero"),
        (
            lambda eye: WearState.begin(eye, WearSettings(click_arcmin=0.0)).updated(Clicks(**one_click(eye))),
            "at least 0.05",
        ),
        (lambda eye: WearSettings(outlier_share=0.7), "outlier_share must lie between"),
        (lambda eye: WearState.begin(eye).carried(-1.0), "the time that has passed is -1.0 s"),
        (lambda eye: WearState.begin(eye).updated(Clicks(**one_click(eye)), click_arcmin=-2), "click_arcmin is -2"),
    ],
)
def test_bad_settings_are_refused_in_a_sentence(eye: Eye, make: Callable[..., Any], sentence: str) -> None:
    with pytest.raises(BadInputError, match=sentence):
        make(eye)
