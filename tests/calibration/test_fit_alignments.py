"""Models of a wearer's alignments, judged by the traced device at the wearer's eye, and by other points."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

import wlr_render as wlr
from wlr_render.calibration.fit_alignments import AlignmentFit, fit_alignments
from wlr_render.captures.alignments_file import Alignments
from wlr_render.errors import BadInputError
from wlr_render.geometry import rays
from wlr_render.geometry.directions import ARCMIN, dir_of_tangents, tangents_of_dir
from wlr_render.mappings import Eye
from wlr_render.models.registration import model_registration_covariance, right_and_up
from wlr_render.numerics.arrays import FloatArray

NEAR_M, FAR_M = 0.4, 2.5
HAND_ARCMIN, CONSTANT_ARCMIN, ALIKE, TAIL = 5.0, 2.0, 0.6, 4


@pytest.fixture(scope="module")
def headset() -> Eye:
    return wlr.open_eye("birdbath28", "right")


def wearer(truth: Eye, count: int, seed: int, alike: float = ALIKE) -> tuple[Alignments, FloatArray]:
    """Alignments and the place of the eye, of a head that sways slowly with wide tails, and a hand's constant error."""
    rng = np.random.default_rng(seed)
    eye = truth.eye_box.at(rng.uniform(-1, 1, 3))
    pixel = rng.uniform(0.08, 0.92, (count, 2)) * truth.display.panel.size_px
    distance = rng.uniform(NEAR_M, FAR_M, count)
    sway = rng.standard_t(TAIL, (count, 2)) / np.sqrt(TAIL / (TAIL - 2))
    for number in range(1, count):
        sway[number] = alike * sway[number - 1] + np.sqrt(1 - alike**2) * sway[number]
    off = (HAND_ARCMIN * sway + CONSTANT_ARCMIN * rng.standard_normal(2)) * ARCMIN
    shown = truth.display.view_dir_of_pixel(pixel, eye).value
    aimed = dir_of_tangents(tangents_of_dir(shown) + off)
    ray = truth.see_through.real_ray_of_view_dir(aimed, np.broadcast_to(eye, aimed.shape)).value
    point = rays.split(rays.at_z(ray, eye[2] - distance))[0]
    name, panel = truth.name, truth.display.panel
    return Alignments(Path("mine.toml"), name, truth.eye, panel, truth.eye_box, pixel, point), eye


def errors(truth: Eye, fit: AlignmentFit, eye: FloatArray) -> tuple[FloatArray, FloatArray]:
    """True errors (n, 2) of other points drawn with the model, and their predicted covariance, arcminutes."""
    rng, count = np.random.default_rng(9), 100
    pixel = rng.uniform(0.05, 0.95, (count, 2)) * truth.display.panel.size_px
    depth = 1.0 / rng.uniform(1 / FAR_M, 1 / NEAR_M, (count, 1))
    believed, there = (np.broadcast_to(each, (count, 3)) for each in (fit.mappings.eye_box.centre, eye))
    shown = fit.display.view_dir_of_pixel(pixel, believed).value
    point = believed - shown / shown[:, 2:] * depth
    predicted = model_registration_covariance(fit.display, fit.see_through, pixel, believed, point)
    true = truth.display.view_dir_of_pixel(pixel, there).value
    true = true - truth.see_through.view_dir_of_real_point(point, there).value
    return np.einsum("nij,nj->ni", right_and_up(shown), true) / ARCMIN, np.sum(list(predicted.values()), axis=0)


@pytest.mark.slow
def test_predicted_errors_cover_those_of_wearers_whose_heads_sway(headset: Eye) -> None:
    found = []
    for seed in range(10):
        alignments, eye = wearer(headset, 10, seed)
        error, covariance = errors(headset, fit_alignments(alignments), eye)
        within = np.einsum("ni,nij,nj->n", error, np.linalg.inv(covariance), error) <= -2 * np.log(0.05)
        trace = np.trace(covariance, axis1=1, axis2=2)
        found.append([np.mean(error**2) * 2, trace.mean(), within.mean()])
    square, predicted, within = np.mean(found, axis=0)
    assert np.sqrt(square) < 20.0
    assert 0.8 < np.sqrt(predicted / square) < 2.0
    assert within > 0.9


@pytest.mark.slow
def test_the_order_of_alignments_tells_sway_from_optics(headset: Eye) -> None:
    """The same alignments in another order show no slow sway, and give a worse model."""
    squares = []
    for seed in range(300, 308):
        alignments, eye = wearer(headset, 20, seed, alike=0.9)
        order = np.random.default_rng(seed).permutation(20)
        shuffled = replace(alignments, pixel=alignments.pixel[order], point=alignments.point[order])
        fits = map(fit_alignments, (alignments, shuffled))
        squares.append([np.mean(errors(headset, fit, eye)[0] ** 2) for fit in fits])
    in_order, without = np.sqrt(np.mean(squares, axis=0))
    assert in_order < 0.95 * without


def test_alignments_without_error_find_the_display_and_the_eye(flat_image_headset: Eye) -> None:
    alignments, eye = wearer(flat_image_headset, 30, 1)
    shown = flat_image_headset.display.view_dir_of_pixel(alignments.pixel, eye).value
    depth = np.linspace(0.3, 3.0, 30)[:, None]
    ray = flat_image_headset.see_through.real_ray_of_view_dir(shown, np.broadcast_to(eye, shown.shape)).value
    fit = fit_alignments(replace(alignments, point=rays.split(rays.at_z(ray, eye[2] - depth[:, 0]))[0]))
    error, _ = errors(flat_image_headset, fit, eye)
    assert np.sqrt(np.mean(error**2)) < 2.0
    # The plate shifts what lies behind it along z, as another place of the eye would.
    assert np.all(np.abs(fit.eye_m - eye)[:2] < 4.0 * fit.eye_sigma_m[:2])
    assert fit.eye_sigma_m[:2].max() < 0.5e-3
    assert fit.doubtful == ()


def test_a_wrong_alignment_is_named(headset: Eye) -> None:
    alignments, _ = wearer(headset, 16, 3)
    point = alignments.point.copy()
    point[6, 0] += 0.05 * np.linalg.norm(point[6])
    assert fit_alignments(replace(alignments, point=point)).doubtful == (7,)


def test_a_wrong_alignment_does_not_make_others_doubtful(headset: Eye) -> None:
    """Of 5 degrees, it bends the fit so far that others seem wrong beside it."""
    for seed in (5, 6, 10):
        alignments, _ = wearer(headset, 12, seed)
        point = alignments.point.copy()
        point[6, 0] += 0.09 * np.linalg.norm(point[6])
        assert fit_alignments(replace(alignments, point=point)).doubtful == (7,)


def test_alignments_that_determine_nothing_are_refused(headset: Eye) -> None:
    alignments, _ = wearer(headset, 8, 2)
    with pytest.raises(BadInputError, match=r"mine\.toml: has 5 alignments; a model needs 6 to 1000, at pixels"):
        fit_alignments(alignments.select(np.arange(8) < 5))
    line = alignments.pixel.copy()
    line[:, 1] = line[:, 0]
    with pytest.raises(BadInputError, match="the pixels of all 8 alignments lie on one line of the panel"):
        fit_alignments(replace(alignments, pixel=line))
    exchanged = alignments.point[np.random.default_rng(0).permutation(8)]
    with pytest.raises(BadInputError, match=r"contradict each other by .*x right, y up, z backward"):
        fit_alignments(replace(alignments, point=exchanged))
