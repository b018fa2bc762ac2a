"""Every method by name on one small set of captures of a traced headset."""

import itertools
import time
from dataclasses import replace
from functools import cache, partial

import numpy as np
import pytest

from benchmarks.rivals import networks
from benchmarks.rivals.method_trials import _bench_of, _drawn, with_pixel_noise
from benchmarks.rivals.methods import METHODS, STRUCTURES, MethodData
from benchmarks.trials import EvaluatedEye, capture_setup
from wlr_render.captures.correspondences import Captures
from wlr_render.evaluation.mapping_error import SeeThroughObservations, see_through_observations
from wlr_render.evaluation.misalignment import misalignment_arcmin
from wlr_render.mappings import Eye
from wlr_render.optics.device import EyeOptics
from wlr_render.simulation import viewpoints
from wlr_render.simulation.capture_setup import CaptureSetup
from wlr_render.simulation.simulate_captures import simulate_display, simulate_see_through

AT = EvaluatedEye("birdbath28", "right", (10.0, 8.0, 6.0))
GRID = (9, 7)
NOISE_PX = 0.25
WORST_ARCMIN = 60.0
"""Composite error. The offset network has about 45' on so coarse a grid, the prescription as drawn 36'."""


ONE_OF_EACH_KIND = [
    name
    for name in METHODS
    if "misshapen" not in name
    and name not in ("planar", "volumetric")
    and (name.rpartition("-")[2] not in ("static", "volumetric") or name in STRUCTURES or "linear-table" in name)
]
"""Regressors in the structure planar, one of them in all three, and other methods.

Of ours, test_rivals_comparison.py fits the planar kind; the volumetric one is dear and differs by its name alone.
"""


@pytest.fixture(autouse=True)
def _small_budgets(monkeypatch: pytest.MonkeyPatch) -> None:
    ticks = itertools.count()
    monkeypatch.setattr(time, "process_time", lambda: 0.03 * next(ticks))
    monkeypatch.setattr(networks, "_DECODER_ITERATIONS", 10)


def _coarse_bench(optics: EyeOptics) -> CaptureSetup:
    return replace(_bench_of(AT, optics), grid=GRID)


@cache
def captured() -> tuple[MethodData, Eye, SeeThroughObservations]:
    """Captures from 16 positions, the headset, and real points that are seen from positions off the plane."""
    setup, rng = replace(capture_setup(AT), grid=GRID), np.random.default_rng(1)
    eyes = []
    for kind in ("planar", "volumetric"):
        positions = setup.camera_positions(kind, 16)
        shown, world = simulate_display(setup, positions, rng), simulate_see_through(setup, positions, rng)
        eyes.append(Captures(with_pixel_noise(shown, NOISE_PX, rng), with_pixel_noise(world, NOISE_PX, rng)))
    viewpoint = viewpoints.random_in_eye_box(setup.truth.eye_box, 6, rng)[:, None]
    view_dir = setup.field.directions(5, 4)
    view_dir = view_dir * [0.8, 0.8, 1.0]
    view_dir = view_dir / np.linalg.norm(view_dir, axis=1, keepdims=True)
    shape = (6, len(view_dir), 3)
    viewpoint, view_dir = (np.broadcast_to(each, shape).reshape(-1, 3) for each in (viewpoint, view_dir))
    seen = see_through_observations(setup.truth.see_through, viewpoint, view_dir, np.ones(len(view_dir)))
    planar, volumetric = eyes
    return MethodData(planar, volumetric, partial(_drawn, AT, (2, 0)), _coarse_bench), setup.truth, seen


@pytest.mark.slow
@pytest.mark.parametrize("name", ONE_OF_EACH_KIND)
def test_a_method_gives_finite_answers(name: str) -> None:
    data, truth, seen = captured()
    rival = METHODS[name].fit(data)
    assert rival.numbers > 0
    view_dir = rival.see_through.view_dir_of_real_point(seen.point, seen.viewpoint)
    pixel = rival.display.pixel_of_view_dir(view_dir.value, seen.viewpoint)
    on_panel = ((pixel.value > 0) & (pixel.value < truth.display.panel.size_px)).all(axis=1)
    answered = view_dir.usable & pixel.usable & on_panel
    assert answered.mean() > 0.85  # a network of a small budget is not everywhere smooth enough for its inverse
    error = misalignment_arcmin(truth, seen.viewpoint, pixel.value, seen.point)[answered]
    assert np.sqrt(np.mean(error**2)) < WORST_ARCMIN
