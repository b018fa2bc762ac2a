"""Planar models of the device files, fitted to a small exact bench; made once per run."""

from collections.abc import Callable
from dataclasses import replace
from functools import lru_cache
from typing import Any

import numpy as np

from wlr_render.calibration.fit_eye import calibrate
from wlr_render.captures.correspondences import AnyCaptures, Captures, select
from wlr_render.mappings import Eye
from wlr_render.numerics.arrays import IntArray
from wlr_render.numerics.polynomial import Box, Polynomial, basis
from wlr_render.optics.device_file import load_device
from wlr_render.optics.traced_mappings import traced_eye
from wlr_render.simulation.capture_setup import CaptureSetup
from wlr_render.simulation.simulate_captures import simulate_display, simulate_see_through

DEGREES = {3: 2, 5: 3}  # of the display, and of see-through beside it


def thinned(captures: AnyCaptures) -> AnyCaptures:
    """Every fifth reading, which lie in all parts of the field."""
    return select(captures, np.arange(len(captures)) % 5 == 0)


@lru_cache
def captures(device: str, kind: str = "planar") -> Captures:
    setup = CaptureSetup(traced_eye(load_device(device), "right"), grid=(17, 15))
    positions, rng = setup.camera_positions(kind, 25), np.random.default_rng(0)
    return Captures(simulate_display(setup, positions, rng), simulate_see_through(setup, positions, rng))


@lru_cache
def fitted_eye(device: str, degree: int) -> Eye:
    return calibrate(captures(device), "planar", degree, DEGREES[degree]).mappings


def with_source(mappings: Eye, source: str) -> Eye:
    """The eye with a large error of a source, as the first variable of both models' covariance."""
    spreads = {}
    for name in ("display", "see_through"):
        spread = getattr(mappings, name).spread
        joint = spread.joint
        of_source = np.zeros((len(joint.orders), spread.outputs, 1 + joint.outputs // spread.outputs))
        of_source[..., 1:] = joint.coefficients.reshape(len(joint.orders), spread.outputs, -1)
        if name == "display":
            of_source[0, 0, 0] = 0.01
        grown = replace(joint, coefficients=of_source.reshape(len(joint.orders), -1))
        spreads[name] = getattr(mappings, name).with_spread(replace(spread, joint=grown, sources=(source,)))
    return replace(mappings, **spreads)


def fitted_terms(function: Callable[..., Any] | Polynomial, box: Box, orders: IntArray) -> Polynomial:
    """Least squares to a function (n, variables) -> (n, outputs) by some terms."""
    sample = np.random.default_rng(0).uniform(box.low, box.high, (4 * len(orders), len(box.low)))
    coefficients, *_ = np.linalg.lstsq(basis(sample, orders, box), function(sample))
    return Polynomial(orders, box, coefficients)
