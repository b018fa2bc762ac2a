"""Single dots beside their place are told from the smooth field of their photograph."""

from dataclasses import replace

import numpy as np

from wlr_render.calibration.capture_outliers import dot_inliers
from wlr_render.geometry.directions import ARCMIN, normalised
from wlr_render.optics.device_file import load_device
from wlr_render.optics.traced_mappings import traced_eye
from wlr_render.simulation import viewpoints
from wlr_render.simulation.simulate_captures import CaptureSetup, simulate_see_through


def see_through(noise_arcmin=0.05):
    truth = traced_eye(load_device("northstar"), "right")
    setup = CaptureSetup(truth, noise_arcmin, grid=(14, 12))
    places = viewpoints.planar(truth.eye_box, setup.field.reach, 4)
    return simulate_see_through(setup, places, np.random.default_rng(1))


def test_dots_that_are_off_are_found_and_no_others():
    captures = see_through()
    photograph = captures.target_pose * 10 + captures.capture
    rng = np.random.default_rng(3)
    off = rng.random(len(captures)) < 0.03
    kick = rng.normal(size=(len(captures), 3))
    kick -= np.sum(kick * captures.view_dir, axis=1, keepdims=True) * captures.view_dir
    kick *= off[:, None] * rng.uniform(2.0, 20.0, (len(captures), 1)) * ARCMIN / np.linalg.norm(kick, axis=1)[:, None]
    spoilt = replace(captures, view_dir=normalised(captures.view_dir + kick))
    assert np.array_equal(dot_inliers(spoilt, photograph), ~off)


def test_dots_that_are_stated_to_be_unsure_are_left_out():
    captures = see_through()
    photograph = captures.target_pose * 10 + captures.capture
    unsure = np.random.default_rng(4).random(len(captures)) < 0.05
    sigma = np.where(unsure, 8.0, 1.0) * captures.sigma_arcmin
    assert np.array_equal(dot_inliers(replace(captures, sigma_arcmin=sigma), photograph), ~unsure)


def test_a_photograph_of_few_dots_is_not_judged():
    captures = see_through()
    photograph = np.arange(len(captures)) // 5
    assert dot_inliers(captures, photograph).all()
