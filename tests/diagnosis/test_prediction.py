"""Extensions of a bench: their order, their fast prediction against the plain one, and their Jacobian."""

from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from diagnosis.small_session import explanation, hypothesis, measured
from present import present

from wlr_render.bench.bench import Bench
from wlr_render.bench.simulate_session import simulate
from wlr_render.captures.session import SessionPlan
from wlr_render.diagnosis.cause import Cause, Parameter
from wlr_render.diagnosis.causes import CAUSES
from wlr_render.diagnosis.observations import DISPLAY, SEE_THROUGH, Observations
from wlr_render.diagnosis.prediction import Explanation, Hypothesis, Linearisation, Predictor
from wlr_render.diagnosis.weighed_readings import camera_motions
from wlr_render.errors import BadInputError
from wlr_render.numerics.arrays import FloatArray

# One of every kind of change: of all surfaces, of media, of the panel, of the camera, of the target, of the readout.
CHAIN = (
    explanation(combiner_tilt=[0.3, -0.2, 0.4]),
    explanation(combiner_tilt=[0.3, -0.2, 0.4], target_scale=[0.5, -0.3]),
    explanation(see_through_plate=[5.0, 10.0, -5.0], camera_pupil_offset=[0.5, 0.2, -0.7]),
    explanation(panel_shift=[0.3, 0.4], substrate_index=[0.02]),
    explanation(headset_slip=[0.3, 0.1, 0.2, 0.1, -0.1, 0.2, 1000.0], pixel_origin=[0.5, -0.5]),
    explanation(),
)
POINTS = {
    "combiner_tilt": [0.6, -0.5, 0.4],
    "substrate_thickness": [0.05],
    "see_through_plate": [6.0, 10.0, -5.0],
    "stage_tilt": [0.5, 0.2, -0.3],
    "camera_distortion": [0.005, -0.01],
    "tracking_rotation": [0.1, 0.2, -0.1],
    "thermal_drift": [0.05, 0.03, 600.0],
    "headset_slip": [0.3, 0.1, 0.2, 0.1, -0.1, 0.2, 1000.0],
    "gaze_pupil_shift": [8.0],
    "rolling_scanout": [6.0],
}


def plain_jacobian(observations: Observations, at: Linearisation, share: float = 2e-3) -> FloatArray:
    """By central differences of the plain simulation, per prior sigma."""
    plan, columns = observations.session.plan, []
    for number in at.free:
        shift = np.zeros(len(at.explanation.vector()))
        shift[number] = share * at.explanation.parameters()[number].prior_sigma
        ends = [
            at.explanation.at(at.explanation.vector() + sign * shift).bench(observations.nominal) for sign in (-1, 1)
        ]
        behind, ahead = (observations.residual(simulate(end, plan)) for end in ends)
        columns.append((behind - ahead) / (2 * share))
    return np.stack(columns, axis=-1)


def test_causes_act_in_their_order(bench: Bench) -> None:
    both = explanation(combiner_tilt=[1.0, 0.0, 0.0], combiner_shift=[0.0, 1.0, 2.0])
    first = CAUSES["combiner_tilt"].perturb(bench, np.array([1.0, 0.0, 0.0]))
    expected = CAUSES["combiner_shift"].perturb(first, np.array([0.0, 1.0, 2.0]))
    for found, wanted in zip(both.bench(bench).optics.surfaces(), expected.optics.surfaces(), strict=True):
        np.testing.assert_array_equal(found.device_from_surface, wanted.device_from_surface)
    assert Explanation().bench(bench) is bench


def test_an_extension_is_its_causes_and_one_vector() -> None:
    one = Explanation().plus(hypothesis("panel_shift"), np.array([1.0, 2.0]))
    two = one.plus(hypothesis("latency"), np.array([3.0])).plus(hypothesis("stage_tilt"))
    assert two.names == ("panel_shift", "latency", "stage_tilt")
    np.testing.assert_array_equal(two.vector(), [1, 2, 3, 0, 0, 0])
    assert [parameter.unit for parameter in two.parameters()] == ["mm", "mm", "ms", "deg", "deg", "deg"]
    moved = two.at(np.arange(6.0))
    assert [list(values) for values in moved.values] == [[0, 1], [2], [3, 4, 5]]
    rest = moved.without(1)
    assert rest.names == ("panel_shift", "stage_tilt")
    np.testing.assert_array_equal(rest.vector(), [0, 1, 3, 4, 5])
    assert len(Explanation().vector()) == 0
    assert Explanation().at(np.zeros(0)).names == ()


def test_the_prediction_from_any_neighbour_is_the_plain_one(
    bench: Bench, plan: SessionPlan, predictor: Predictor
) -> None:
    state = None
    for step in CHAIN:
        state = predictor.state(step, state)
        plain = simulate(step.bench(bench), plan)
        np.testing.assert_allclose(
            present(state.readings.panel_pixel), present(plain.panel_pixel), atol=1e-9, err_msg=str(step.names)
        )
        np.testing.assert_allclose(
            present(state.readings.dot_pixel), present(plain.dot_pixel), atol=1e-7, err_msg=str(step.names)
        )


def test_run_time_readings_are_predicted_plainly_too(bench: Bench, run_time: SessionPlan) -> None:
    predictor = Predictor(measured(bench, run_time))
    state, tilted = None, explanation(combiner_tilt=[0.3, 0.0, 0.0])
    for step in (
        tilted,
        explanation(latency=[5.0]),
        tilted.plus(hypothesis("latency"), np.array([5.0])),
        explanation(),
        explanation(camera_distortion=[0.02, -0.01]),
        explanation(panel_shift=[12.0, 0.0]),
        explanation(),
    ):
        state = predictor.state(step, state)
        plain = simulate(step.bench(bench), run_time).run_time_pixel
        # A shift of 12 mm takes some dots off the panel; back on it, they have no warm start.
        np.testing.assert_allclose(
            present(state.readings.run_time_pixel), present(plain), atol=1e-9, err_msg=str(step.names)
        )


def test_a_part_that_a_cause_cannot_touch_is_not_done_again(predictor: Predictor) -> None:
    rest = predictor.state(Explanation())
    shown = predictor.state(explanation(panel_shift=[0.1, 0.2]))
    assert shown.readings.dot_pixel is rest.readings.dot_pixel
    assert shown.readings.panel_pixel is not rest.readings.panel_pixel
    seen = predictor.state(explanation(target_bow=[0.1, 0.2]))
    assert seen.readings.panel_pixel is rest.readings.panel_pixel
    assert seen.readings.dot_pixel is not rest.readings.dot_pixel


@pytest.mark.parametrize("name", POINTS)
def test_the_jacobian_is_that_of_plain_central_differences(
    bench: Bench, plan: SessionPlan, run_time: SessionPlan, predictor: Predictor, name: str
) -> None:
    if CAUSES[name].part in ("eye tracking", "clock"):
        predictor = Predictor(measured(bench, run_time))
    at = predictor.linearised(explanation(**{name: POINTS[name]}))
    expected = plain_jacobian(predictor.observations, at)
    np.testing.assert_allclose(at.jacobian, expected, atol=2e-3 * np.abs(expected).max())


def test_a_state_without_a_cause_that_has_no_effect_serves_as_well(predictor: Predictor) -> None:
    old = explanation(camera_rotation=[0.1, -0.1, 0.2])
    new = old.plus(hypothesis("combiner_shift"))
    whole, added = predictor.linearised(new), predictor.linearised(new, predictor.state(old))
    np.testing.assert_array_equal(added.free, np.arange(6))
    np.testing.assert_allclose(added.jacobian, whole.jacobian, atol=1e-6 * np.abs(whole.jacobian).max())
    np.testing.assert_allclose(added.residual, whole.residual, atol=1e-6)


@pytest.mark.parametrize(("name", "units"), [("camera_pupil_offset", 1e-3), ("camera_rotation", np.degrees(1e-6))])
def test_motions_of_the_camera_are_the_derivatives_by_the_causes_that_move_it(
    predictor: Predictor, name: str, units: float
) -> None:
    at = predictor.signature(hypothesis(name))
    by_cause = at.jacobian / at.explanation.prior_sigma * units
    motions = (
        camera_motions(predictor)[:, :, :3] if name == "camera_pupil_offset" else camera_motions(predictor)[:, :, 3:]
    )
    np.testing.assert_allclose(motions, by_cause, atol=1e-6 * np.abs(by_cause).max())


def test_a_change_that_does_nothing_has_no_lever(predictor: Predictor, clean: Observations) -> None:
    steps = np.array([1e-6, 1e-3])
    lever = predictor.lever(lambda bench, values: bench, steps)
    assert lever.shape == (len(clean), 2, 2)
    assert not lever.any()


def test_what_changes_nothing_is_not_free(predictor: Predictor, clean: Observations) -> None:
    """Moments never are; forms are while there is a size; causes that a session cannot see never are."""
    at = predictor.linearised
    np.testing.assert_array_equal(at(explanation(see_through_plate=[0.0, 0.0, 0.0])).free, [0])
    np.testing.assert_array_equal(at(explanation(see_through_plate=[5.0, 2.0, 0.0])).free, [0, 1, 2])
    np.testing.assert_array_equal(at(explanation(thermal_drift=[0.0, 0.0, 900.0])).free, [0, 1])
    np.testing.assert_array_equal(at(explanation(headset_slip=[0, 0, 0, 0, 0, 0, 500.0])).free, range(6))
    assert at(explanation(latency=[3.0])).free.size == 0
    shown = at(explanation(panel_scale=[0.1, 0.1])).jacobian.sum(axis=-1)
    np.testing.assert_array_equal(shown[clean.part == SEE_THROUGH], 0.0)
    assert np.abs(shown[clean.part == DISPLAY]).max() > 1


def test_one_part_alone_can_be_predicted(bench: Bench, plan: SessionPlan) -> None:
    for alone in (SessionPlan(display=plan.display), SessionPlan(see_through=plan.see_through)):
        observations = measured(bench, alone)
        at = Predictor(observations).linearised(
            explanation(camera_rotation=[0.1, 0.0, 0.0], stage_scale=[1.0, 0.0, 0.0])
        )
        assert at.free.size == 6
        np.testing.assert_allclose(at.jacobian, plain_jacobian(observations, at), atol=1e-2 * np.abs(at.jacobian).max())


@pytest.mark.parametrize(
    ("changes", "touched"),
    [
        ({"wavelengths_um": (0.68, 0.58, 0.48)}, (True, False, False)),
        ({"target_wavelength_um": 0.65}, (False, True, True)),
    ],
)
def test_a_cause_of_other_colours_changes_the_readings(
    bench: Bench, plan: SessionPlan, run_time: SessionPlan, changes: dict[str, Any], touched: tuple[bool, bool, bool]
) -> None:
    """A user's own cause may change any attribute of a bench."""
    whole = replace(plan, run_time=run_time.run_time)
    predictor = Predictor(measured(bench, whole))
    cause = Cause(
        "leds", "LEDs", "device", (Parameter("share", "1", 1.0),), "s", "m", {"v": lambda old, v: other_colours(old, v)}
    )

    def other_colours(old: Bench, share: FloatArray) -> Bench:
        mixed: dict[str, Any] = {name: old_to_new(getattr(old, name), new, share[0]) for name, new in changes.items()}
        return replace(old, **mixed)

    at = Explanation().plus(Hypothesis(cause, "v"), np.ones(1))
    found, plain = predictor.state(at).readings, simulate(at.bench(bench), whole)
    for name in ("panel_pixel", "dot_pixel", "run_time_pixel"):
        np.testing.assert_allclose(getattr(found, name), getattr(plain, name), atol=1e-7, err_msg=name)
    nominal = predictor.state(Explanation()).readings
    assert tuple(new is not old for new, old in zip(found.parts, nominal.parts, strict=True)) == touched


def old_to_new(
    old: float | tuple[float, float, float], new: float | tuple[float, float, float], share: float
) -> float | tuple[float, float, float]:
    mixed = np.asarray(old) + share * np.subtract(new, old)
    return tuple(mixed.tolist()) if mixed.ndim else float(mixed)


def test_a_headset_that_cannot_be_traced_predicts_no_reading(bench: Bench, run_time: SessionPlan) -> None:
    """The panel is seen from nowhere; a step of a fit may well lead there."""
    predictor = Predictor(measured(bench, run_time))
    away = explanation(panel_shift=[900.0, 0.0])
    with pytest.raises(BadInputError):
        simulate(away.bench(bench), run_time)
    assert np.isnan(predictor.residual(away)).all()
