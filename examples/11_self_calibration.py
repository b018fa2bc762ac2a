"""A headset slips on the head; five clicks on known points restore the alignment of the pictures."""

import numpy as np

import wlr_render as wlr
from wlr_render.engine import Clicks, WearState
from wlr_render.geometry import arcmin_between, dir_of_tangents

truth, rng = wlr.open_eye("birdbath28"), np.random.default_rng(1)
models = wlr.calibrate(wlr.simulate(truth, grid=(17, 15))).mappings

pupil = truth.eye_box.centre + [1.0e-3, 0.5e-3, 0.0]
tracked = pupil + [1.5e-3, -1.0e-3, 0.8e-3]  # the eye tracker's report after the slip


def points(count: int) -> np.ndarray:
    """Real points (count, 3) in the device frame, 0.4 m to 4 m away."""
    view_dir = dir_of_tangents(rng.uniform([-0.25, -0.12], [0.25, 0.12], (count, 2)))
    return pupil + view_dir / rng.uniform(0.25, 2.5, (count, 1))


def misalignment(state: WearState) -> float:
    """Rms in arcminutes at points that were not clicked: between each point and the pixel that is drawn for it."""
    real = points(200)
    seen = truth.see_through.view_dir_of_real_point(real, pupil).value
    shown = truth.display.view_dir_of_pixel(state.pixel(real, tracked), pupil).value
    return np.sqrt(np.nanmean(arcmin_between(shown, seen) ** 2))


worn = WearState.begin(models)
print(f"after the slip: {misalignment(worn):.1f} arcmin rms")

# The wearer moves a drawn dot onto each of five real ones, to about 1 arcmin; one click goes wrong.
dots = points(5)
seen = truth.see_through.view_dir_of_real_point(dots, pupil).value
clicked = truth.display.pixel_of_view_dir(seen, pupil).value + rng.normal(0.0, 0.7, (5, 2))
clicked[2] += [40.0, -25.0]
worn = worn.updated(Clicks(clicked, dots, tracked), click_arcmin=1.0)
print(f"after five clicks: {misalignment(worn):.1f} arcmin rms; wrong clicks: {worn.outliers}")
