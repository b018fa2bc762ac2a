"""Fit planar models to simulated captures, print the predicted and the true error, save and load the models."""

from pathlib import Path

import numpy as np

from wlr_render.calibration.fit_eye import fit_eye
from wlr_render.captures.correspondences import EyeCaptures
from wlr_render.evaluation.mapping_error import display_error, observations_of_pixels
from wlr_render.evaluation.metrics import summary
from wlr_render.models.model_file import load_eye_model, save_eye_models
from wlr_render.optics.device_file import load_device
from wlr_render.optics.traced_mappings import traced_eye
from wlr_render.simulation import viewpoints
from wlr_render.simulation.simulate_captures import CaptureSetup, simulate_display, simulate_see_through

truth = traced_eye(load_device("birdbath28"))
setup = CaptureSetup(truth, camera_noise_arcmin=0.25)
rng = np.random.default_rng(1)
positions = viewpoints.planar(truth.eye_box, setup.field.reach, 25)

# Your own captures have the same two records: pixels or real points, with viewpoints and view directions.
captures = EyeCaptures(simulate_display(setup, positions, rng), simulate_see_through(setup, positions, rng))
fit = fit_eye(captures)
report = fit.display.report
print(f"display error predicted by the fit: {report.predicted_arcmin:.3f} arcmin rms, noise {report.noise_arcmin:.3f}")

path = save_eye_models(Path("birdbath28.model.json"), [fit.model()])
model = load_eye_model(path).mappings
anywhere = viewpoints.random_in_eye_box(truth.eye_box, 50, rng)[:, None]
pixels = rng.uniform(0, truth.display.panel.size_px, (50, 40, 2))
error = display_error(model.display, observations_of_pixels(truth.display, anywhere, pixels))
print(f"error against the exact optics, over the eye box: {summary(error.forward_arcmin).rms:.3f} arcmin rms")
