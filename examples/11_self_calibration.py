"""A headset slips on the head; five clicks on known points restore the alignment of what is drawn."""

import numpy as np

from wlr_render.calibration.fit_eye import fit_eye
from wlr_render.calibration.self_calibration import Clicks, WearState
from wlr_render.captures.correspondences import EyeCaptures
from wlr_render.evaluation.metrics import summary
from wlr_render.evaluation.misalignment import misalignment_arcmin
from wlr_render.geometry.directions import dir_of_tangents
from wlr_render.optics.device_file import load_device
from wlr_render.optics.traced_mappings import traced_eye
from wlr_render.simulation.simulate_captures import CaptureSetup, simulate_display, simulate_see_through

truth = traced_eye(load_device("birdbath28"))
setup, rng = CaptureSetup(truth, camera_noise_arcmin=0.25, grid=(17, 15)), np.random.default_rng(1)
positions = setup.camera_positions("planar", 25)
captures = EyeCaptures(simulate_display(setup, positions, rng), simulate_see_through(setup, positions, rng))
models = fit_eye(captures).mappings

pupil = truth.eye_box.centre + [1.0e-3, 0.5e-3, 0.0]
tracked = pupil + [1.5e-3, -1.0e-3, 0.8e-3]  # what the eye tracker reports after the slip


def points(count: int) -> np.ndarray:
    """Real points (count, 3) in the device frame, 0.4 m to 4 m away."""
    view_dir = dir_of_tangents(rng.uniform([-0.25, -0.12], [0.25, 0.12], (count, 2)))
    return pupil + view_dir / rng.uniform(0.25, 2.5, (count, 1))


def misalignment(state: WearState) -> float:
    """Rms in arcminutes at points that were not clicked."""
    shown = points(200)
    return summary(misalignment_arcmin(truth, pupil, state.pixel(shown, tracked), shown)).rms


worn = WearState.begin(models)
print(f"after the slip: {misalignment(worn):.1f} arcmin rms")

# The wearer moves a drawn dot onto each of five real ones, to about 1 arcmin; one click goes wrong.
dots = points(5)
seen = truth.see_through.view_dir_of_real_point(dots, pupil).value
clicked = truth.display.pixel_of_view_dir(seen, pupil).value + rng.normal(0.0, 0.7, (5, 2))
clicked[2] += [40.0, -25.0]
worn = worn.updated(Clicks(clicked, dots, tracked), click_arcmin=1.0)
print(f"after five clicks: {misalignment(worn):.1f} arcmin rms; wrong clicks: {worn.outliers}")
