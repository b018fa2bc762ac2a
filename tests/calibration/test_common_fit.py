"""Errors that all captures share, in the covariance of fitted models: against fits to captures that are off by them."""

import dataclasses
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray
from present import narrowed, present

from wlr_render.calibration.fit_display import fit_display
from wlr_render.calibration.fit_eye import Calibration, calibrate
from wlr_render.captures.correspondences import AnyCaptures, Captures
from wlr_render.captures.feature_captures import CommonErrors
from wlr_render.error_sources import ErrorSource
from wlr_render.geometry.directions import ARCMIN
from wlr_render.mappings import Eye
from wlr_render.models.display_model import DisplayModel
from wlr_render.models.registration import model_registration_covariance
from wlr_render.models.see_through_model import SeeThroughModel
from wlr_render.numerics.arrays import FloatArray
from wlr_render.optics.device_file import load_device
from wlr_render.optics.traced_mappings import traced_eye
from wlr_render.simulation.capture_setup import CaptureSetup
from wlr_render.simulation.simulate_captures import simulate_display, simulate_see_through

Simulated = tuple[Any, Any, Calibration]

Tested = tuple[Any, Any, Any, Any]

SOURCES = ("stage", "stage", "targets")
OFFSET_MM = np.array([0.0, 0.1, 0.2])


def simulated(seed: int = 1, places: int = 9) -> tuple[Eye, Captures]:
    truth = traced_eye(load_device("birdbath28"), "right")
    setup = CaptureSetup(truth, 0.25, grid=(9, 8))
    positions = setup.camera_positions("planar", places)
    rng = np.random.default_rng(seed)
    return truth, Captures(simulate_display(setup, positions, rng), simulate_see_through(setup, positions, rng))


def stated(part: AnyCaptures | None, target_m: float = 1e-3) -> AnyCaptures:
    """With a common error of the viewpoint in y and z, as large as `OFFSET_MM`, and of all targets along y."""
    assert part is not None
    names, poses = np.unique(part.capture), np.unique(getattr(part, "target_pose", np.zeros(0, int)))
    motion = np.zeros((len(names), 6, 3))
    motion[:, 4, 0], motion[:, 5, 1] = 1e-3 * OFFSET_MM[1:]
    target = np.zeros((len(poses), 7, 3, 3))
    target[:, 0, 1, 2] = target_m
    return dataclasses.replace(part, common=CommonErrors(SOURCES, names, motion, target_pose=poses, target=target))


def with_common(captures: Captures) -> Captures:
    return Captures(stated(captures.display), stated(captures.see_through))


def off_by(captures: Captures, variables: NDArray[Any]) -> Captures:
    """The captures as they state if the common errors have these values."""
    display, see_through = captures.both
    of_display, of_see_through = (present(part.common).changes(part, slice(None)) for part in captures.both)
    point = see_through.point + present(of_see_through.point) @ variables
    viewpoint = see_through.viewpoint + of_see_through.viewpoint @ variables
    return Captures(
        dataclasses.replace(display, viewpoint=display.viewpoint + of_display.viewpoint @ variables),
        dataclasses.replace(see_through, viewpoint=viewpoint, point=point),
    )


@pytest.fixture(scope="module")
def session() -> Simulated:
    truth, captures = simulated()
    captures = with_common(captures)
    return truth, captures, calibrate(captures)


@pytest.fixture(scope="module")
def tested(session: Simulated) -> Tested:
    """Pixels, viewpoints in the middle of the eye box, and real points that are seen there in truth."""
    truth, _, _ = session
    rng = np.random.default_rng(5)
    pixel = rng.uniform(0.2, 0.8, (200, 2)) * truth.display.panel.size_px
    viewpoint = truth.eye_box.at(rng.uniform(-0.7, 0.7, (200, 3)))
    seen = truth.display.view_dir_of_pixel(pixel, viewpoint).value
    ray = truth.see_through.real_ray_of_view_dir(seen, viewpoint).value
    return pixel, viewpoint, ray[:, :3] + 1.5 * ray[:, 3:], seen


def rms(values: FloatArray) -> float:
    return float(np.sqrt(np.mean(np.sum(values**2, axis=-1))))


@pytest.mark.slow
@pytest.mark.parametrize("values", [(1.0, 1.0, 0.0), (0.0, 0.0, 1.0)], ids=["stage", "targets"])
def test_shared_deviation_is_the_change_of_a_fit_to_captures_that_are_off(
    session: Simulated, tested: Tested, values: tuple[float, float, float]
) -> None:
    _, captures, fit = session
    pixel, viewpoint, point, _ = tested
    other = calibrate(off_by(captures, np.array(values)))
    for side, subject in (("display", pixel), ("see_through", point)):
        before, after = getattr(fit.mappings, side), getattr(other.mappings, side)
        answer = before.view_dir(subject, viewpoint).value
        found = (after.view_dir(subject, viewpoint).value - answer) / ARCMIN
        errors = before.direction_errors(subject, viewpoint, answer)
        assert errors.sources[:3] == SOURCES
        expected = errors.shared[..., :3] @ values / ARCMIN
        # Noise is the same in both, and hyperparameters nearly so.
        assert rms(found - expected) < 0.03 + 0.05 * rms(expected), (side, rms(expected))


def test_viewpoints_that_are_off_are_predicted(tested: Tested) -> None:
    """Offsets of one sigma in y and z: no residual shows them, and the prediction follows the truth."""
    pixel, viewpoint, _, seen = tested
    _, exact = simulated(places=25)
    captures, true, predicted = with_common(exact), [], []
    for signs in ((1.0, 1.0, 0.0), (1.0, -1.0, 0.0)):
        display = fit_display(present(off_by(captures, np.array(signs)).display)).mapping
        true.append(rms(display.view_dir_of_pixel(pixel, viewpoint).value - seen) / ARCMIN)
        predicted.append(np.sqrt(np.mean(display.sigma(pixel, viewpoint) ** 2)))
    size = np.sqrt(np.mean(np.square(true)))
    assert 0.8 < np.sqrt(np.mean(np.square(predicted))) / size < 1.25
    white = fit_display(present(exact.display)).mapping.sigma(pixel, viewpoint)
    assert np.sqrt(np.mean(white**2)) < 0.5 * size


def test_mean_and_noise_do_not_depend_on_stated_common_errors(session: Simulated, tested: object) -> None:
    """A fit cannot see what all captures share."""
    _, _, fit = session
    other = calibrate(simulated()[1])
    for one, two in ((fit.display, other.display), (fit.see_through, other.see_through)):
        assert one is not None
        assert two is not None
        np.testing.assert_array_equal(one.smooth.polynomial.coefficients, two.smooth.polynomial.coefficients)
        assert one.report.held_out_arcmin == two.report.held_out_arcmin
        assert one.report.predicted_arcmin > two.report.predicted_arcmin


def test_registration_by_source(session: Simulated, tested: Tested) -> None:
    """Targets that are off by 1 mm move the see-through of points at 1.5 m, not the display."""
    _, _, fit = session
    pixel, viewpoint, point, _ = tested
    display = narrowed(fit.mappings.display, DisplayModel)
    see_through = narrowed(fit.mappings.see_through, SeeThroughModel)
    covariance = model_registration_covariance(display, see_through, pixel, viewpoint, point)
    assert list(covariance) == [ErrorSource.NOISE_AND_STAGE, "stage", "targets", "stage axes"]
    up, right = (np.sqrt(np.mean(covariance["targets"][:, axis, axis])) for axis in (1, 0))
    assert 0.3 < up / (1e-3 / 1.5 / ARCMIN) < 3.0
    assert right < 0.3 * up
