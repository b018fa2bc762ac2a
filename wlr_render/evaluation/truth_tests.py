"""Errors of an eye's mappings against the true ones, at random viewpoints, pixels and real points."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from wlr_render.evaluation import mapping_error
from wlr_render.evaluation.metrics import Summary, summary
from wlr_render.mappings import Eye, FieldOfView

TESTS = (100, 60)  # random viewpoints, and random pixels per viewpoint
TEST_DEPTHS_M = (0.3, 5.0)
PIXEL_DIRECTION = "direction of a pixel (arcmin)"
POINT_DIRECTION = "direction of a real point (arcmin)"


def compare(
    eye: Eye, truth: Eye, seed: int | Sequence[int] = 2, field: FieldOfView | None = None
) -> dict[str, Summary]:
    """Return the errors of an eye's mappings against true ones, over the eye box of the truth.

    Args:
        eye: a fitted eye, such as `Calibration.mappings`.
        truth: the same eye with exact optics, from `open_eye` of a device.
        seed: seed of the random viewpoints, pixels and depths; it must differ from the seed of the fitted captures.
        field: directions to test; the whole panel by default. `truth.field` is the nominal field of view.

    Returns:
        A summary (rms, median, 95 % and maximum) of each kind of error, by its name with the unit: direction of a pixel
        and of a real point, pixel of a direction, direction of a real ray. A query without a result counts as
        missing.

    Example:
        >>> import wlr_render as wlr
        >>> truth = wlr.open_eye("birdbath28")
        >>> fit = wlr.calibrate(wlr.simulate(truth))
        >>> wlr.compare(fit.mappings, truth)["direction of a pixel (arcmin)"].rms < 0.1
        True
    """
    return TruthTests.of(truth, seed, field).errors(eye)


@dataclass(frozen=True)
class TruthTests:
    """Exact observations of an eye at random viewpoints in the eye box."""

    display: mapping_error.DisplayObservations
    see_through: mapping_error.SeeThroughObservations

    @classmethod
    def of(cls, truth: Eye, seed: int | Sequence[int], field: FieldOfView | None = None) -> "TruthTests":
        """Observe random pixels on the panel or, if `field` is given, in random directions of it, and real points."""
        rng = np.random.default_rng(seed)
        count, per_viewpoint = TESTS
        viewpoint = truth.eye_box.at(rng.uniform(-1.0, 1.0, (count, 1, 3)))
        seen = mapping_error.observations_at_random(truth, viewpoint, per_viewpoint, rng, field)
        near, far = TEST_DEPTHS_M
        depth = 1.0 / rng.uniform(1.0 / far, 1.0 / near, len(seen.pixel))
        points = mapping_error.see_through_observations(truth.see_through, seen.viewpoint, seen.view_dir, depth)
        return cls(seen, points)

    def errors(self, model: Eye) -> dict[str, Summary]:
        """Return the errors of a model, by name with unit."""
        display = mapping_error.display_error(model.display, self.display)
        world = mapping_error.see_through_error(model.see_through, self.see_through)
        return {
            PIXEL_DIRECTION: summary(display.forward_arcmin),
            "pixel of a direction (px)": summary(display.backward_px),
            POINT_DIRECTION: summary(world.backward_arcmin),
            "direction of a real ray (arcmin)": summary(world.forward_arcmin),
        }
