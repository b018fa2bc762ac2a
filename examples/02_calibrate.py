"""Fit planar models to simulated captures, compare them with the exact optics, and save them."""

import wlr_render as wlr

truth = wlr.open_eye("birdbath28", "right")
captures = wlr.simulate(truth, positions=25, noise_arcmin=0.25)  # or wlr.load_captures("captures-right.npz")
fit = wlr.calibrate(captures)
for name, errors in wlr.compare(fit.mappings, truth).items():
    print(f"{name}: {errors.rms:.3f} rms, {errors.p95:.3f} at 95 %")
fit.save("birdbath28.json")
