"""Headsets that differ from their prescription in the poses of parts and the shapes of surfaces.

The errors have other parameters (rotations about random points, surfaces scaled along one axis) than a fit of the
prescription, so that the fit cannot reproduce them exactly.
"""

from dataclasses import replace

import numpy as np

from wlr_render.errors import BadInputError
from wlr_render.geometry.transforms import rigid, rotations_of_vectors
from wlr_render.numerics.arrays import FloatArray
from wlr_render.optics.device import EyeOptics
from wlr_render.optics.raised import Offset
from wlr_render.optics.sag_surfaces import XYPolynomial
from wlr_render.optics.surfaces import Conic, Ellipsoid, Shape

_PIVOT_M = 0.02  # distance of a part's centre of rotation from its origin


def wrong_headset(
    optics: EyeOptics, rng: np.random.Generator, turn_deg: float = 0.2, shift_mm: float = 0.3, shape: float = 0.0
) -> EyeOptics:
    """Return optics with a displaced combiner and panel and misshapen surfaces.

    Args:
        optics: the prescription.
        rng: source of the displacements.
        turn_deg, shift_mm: standard deviations per axis of the displacements.
        shape: relative error of the first semi-axis of each ellipsoid; without ellipsoids, of the curvature of each
            sphere, or of the vertex curvature of each polynomial along x, or along y if it is flat along x.

    Raises:
        BadInputError: the optics have no surfaces, or a surface of another type has a shape error.
    """
    if not optics.surfaces():
        raise BadInputError("the headset has no surfaces that could differ from its prescription.")
    combiner = _displacement(optics.surfaces()[0].device_from_surface[:3, 3], rng, turn_deg, shift_mm)
    panel = _displacement(optics.panel.device_from_panel[:3, 3], rng, turn_deg, shift_mm)
    moved = optics.with_surfaces(
        lambda s: replace(s, device_from_surface=combiner @ s.device_from_surface, shape=misshapen(s.shape, shape))
    )
    return replace(moved, panel=replace(optics.panel, device_from_panel=panel @ optics.panel.device_from_panel))


def misshapen(shape: Shape, relative: float) -> Shape:
    """Return a shape with a relative error; see `wrong_headset`. Planes remain planes."""
    if relative == 0.0:
        return shape
    if isinstance(shape, Offset):
        return replace(shape, base=misshapen(shape.base, relative))
    if isinstance(shape, Ellipsoid):
        return replace(shape, semi_axes=shape.semi_axes * np.array([1.0 + relative, 1.0, 1.0]))
    if isinstance(shape, Conic):
        return replace(shape, curvature=shape.curvature * (1.0 + relative))
    if isinstance(shape, XYPolynomial):
        return replace(shape, coefficients=_bent(shape, relative))
    raise BadInputError(
        f"no error of the shape is known for surfaces of the type {type(shape).__name__}; leave it out."
    )


def _bent(shape: XYPolynomial, relative: float) -> FloatArray:
    """Return the coefficients of a polynomial with a relative error of the vertex curvature, conic base included."""
    stated = shape.coefficients
    coefficients = np.zeros(np.maximum(stated.shape, 3))
    coefficients[: stated.shape[0], : stated.shape[1]] = stated
    for square in ((2, 0), (0, 2)):
        curvature = shape.curvature + 2.0 * coefficients[square]
        if curvature != 0.0:
            coefficients[square] += 0.5 * relative * curvature
            break
    return coefficients


def _displacement(near: FloatArray, rng: np.random.Generator, turn_deg: float, shift_mm: float) -> FloatArray:
    pivot = near + rng.uniform(-_PIVOT_M, _PIVOT_M, 3)
    rotation = rotations_of_vectors(np.deg2rad(rng.normal(0.0, turn_deg, 3)))
    return rigid(rotation, pivot - rotation @ pivot + 1e-3 * rng.normal(0.0, shift_mm, 3))
