"""Causes in the shape of parts of the headset: a bowed panel, and form errors of the combiner.

Device frame; x to the right and y up from the combiner's middle, where the line of sight straight ahead meets it.
Surfaces are raised away from the eye.
"""

from dataclasses import replace
from functools import partial

import numpy as np

from wlr_render.diagnosis.cause import Cause, Parameter, Role
from wlr_render.diagnosis.causes.optics import of_optics
from wlr_render.numerics.arrays import FloatArray
from wlr_render.optics.combiner_form import SURFACES, surfaces_raised
from wlr_render.optics.device import EyeOptics
from wlr_render.optics.sag_surfaces import GaussianBump, XYPolynomial

FORM_RADIUS_MM = 20.0
"""Form errors of the combiner are stated so far from its middle."""

_NARROWEST_MM = 0.5  # a fit may step below zero on its way
_TOLERANCES = (
    "tolerances of injection-moulded optics (Apollo Optical Systems): 10 fringes of power and 6 of irregularity over "
    "25 mm, that is 8 and 5 um over 40 mm"
)


def _panel_bowed(optics: EyeOptics, sag_mm: FloatArray) -> EyeOptics:
    """Curve the panel along u and v, by the sags (2,) at its edges in millimetres."""
    panel = optics.panel
    curvature = 2.0 * 1e-3 * sag_mm / (0.5 * panel.size) ** 2
    return replace(optics, panel=replace(panel, curvature=panel.curvature + curvature))


def _form_coefficients(values_um: FloatArray) -> FloatArray:
    """Return coefficients (4, 4) of x^m y^n, metres: Zernike terms of power without piston, astigmatism and coma."""
    power, astigmatism, oblique, coma_x, coma_y = 1e-6 * values_um
    radius = 1e-3 * FORM_RADIUS_MM
    coefficients = np.zeros((4, 4))
    coefficients[2, 0], coefficients[0, 2] = power + astigmatism, power - astigmatism
    coefficients[1, 1] = 2.0 * oblique
    coefficients[1, 0], coefficients[0, 1] = -2.0 * coma_x, -2.0 * coma_y
    coefficients[3, 0] = coefficients[1, 2] = 3.0 * coma_x
    coefficients[0, 3] = coefficients[2, 1] = 3.0 * coma_y
    m, n = np.indices(coefficients.shape)
    return np.asarray(coefficients * radius ** -(m + n).astype(float))


def _of_form(optics: EyeOptics, values: FloatArray, *, of_mirrors_only: bool = False) -> EyeOptics:
    """Add form errors (5,) in micrometres to all surfaces of the combiner, or only to its mirrors for the display."""
    if not values.any():
        return optics
    names = SURFACES["reflecting surfaces" if of_mirrors_only else "all surfaces"](optics)
    coefficients = _form_coefficients(values)
    return surfaces_raised(optics, names, lambda sign: XYPolynomial(sign * coefficients))


def _dented(optics: EyeOptics, values: FloatArray) -> EyeOptics:
    """Add a local bump to all surfaces of the combiner: depth (um), x, y and width (mm)."""
    depth_um, *place_mm, width_mm = values
    if depth_um == 0.0:
        return optics
    width = 1e-3 * max(float(width_mm), _NARROWEST_MM)
    names = SURFACES["all surfaces"](optics)
    return surfaces_raised(
        optics, names, lambda sign: GaussianBump(sign * 1e-6 * float(depth_um), width), 1e-3 * np.array(place_mm)
    )


FORM = (
    Cause(
        "panel_bow",
        "panel bowed",
        "device",
        (Parameter("sag_u", "mm", 0.3), Parameter("sag_v", "mm", 0.3)),
        source="our estimate for panels in plastic frames, 0.1 to 0.5 mm at the edge",
        separated_by="a straight edge on the panel's face, or the reflection of a grid in it",
        variants={"along its normal, u cross v": of_optics(_panel_bowed)},
        remedy="let the panel's frame hold it flat, or use the corrected headset",
        own_station="panel",
    ),
    Cause(
        "combiner_form",
        "form error of the combiner",
        "device",
        (
            Parameter("power", "um", 8.0),
            *(Parameter(name, "um", 5.0) for name in ("astigmatism", "oblique_astigmatism", "coma_x", "coma_y")),
        ),
        source=_TOLERANCES,
        separated_by="display captures from more camera positions; an interferogram or a coordinate measurement of it",
        variants={
            "in all its surfaces": of_optics(_of_form),
            "in the reflecting surfaces": of_optics(partial(_of_form, of_mirrors_only=True)),
        },
    ),
    Cause(
        "combiner_dent",
        "dent in the combiner",
        "device",
        (
            Parameter("depth", "um", 5.0),
            Parameter("x", "mm", 8.0, Role.SHAPE, (0.0, -7.0, 7.0)),
            Parameter("y", "mm", 8.0, Role.SHAPE, (0.0, -7.0, 7.0)),
            Parameter("width", "mm", 2.0, Role.SHAPE, (5.0,), minimum=_NARROWEST_MM),
        ),
        source=f"{_TOLERANCES}, the same locally",
        separated_by="a straight line reflected in the combiner while it moves across the field",
        variants={"Gaussian, in all its surfaces": of_optics(_dented)},
        remedy="replace the combiner, or use the corrected headset",
    ),
)
