"""Fit a prescription's assembly errors to captures, and compile the fitted optics into the trend of a model.

The only module of calibration that imports the optics. The prescription is a user input, the nominal design of the
headset. In the real device, parts are displaced and surfaces differ; the model fit absorbs the residuals of the fitted
prescription.
"""

from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import partial
from typing import Any

import numpy as np
import scipy

from wlr_render.calibration.readings import Trend
from wlr_render.captures.correspondences import AnyCaptures, Captures, DisplayCaptures, SeeThroughCaptures, select
from wlr_render.errors import BadInputError
from wlr_render.geometry.directions import ARCMIN, dir_of_tangents, tangents_of_dir
from wlr_render.geometry.planes import BasePlane
from wlr_render.io.toml_files import toml_text
from wlr_render.numerics.arrays import FloatArray
from wlr_render.numerics.polynomial import Box, Polynomial
from wlr_render.optics.assembly import ASSEMBLY_NAMES, ASSEMBLY_SIZES, assembled
from wlr_render.optics.compile_polynomials import CompiledMap, compile_display, compile_see_through
from wlr_render.optics.device import Device, EyeOptics
from wlr_render.optics.device_file import device_content
from wlr_render.optics.media import GREEN_UM
from wlr_render.optics.traced_mappings import TracedDisplay
from wlr_render.optics.tracer import trace

Prescription = EyeOptics
"""The optics of one eye as designed; other modules of calibration import the type from here."""
_Residual = Callable[[EyeOptics], FloatArray]

_READINGS = 2500  # most readings of each side, far more than twelve unknowns need
_ROUNDS = 6
_SETTLED = 0.02  # relative change of the residuals' size that ends the rounds; it changes weights by 4 %
_FLOOR_ARCMIN = 1e-3  # least size of residuals, for exact captures
_LOST = 100.0  # residual of a reading without a ray, in sizes of the residuals; the robust loss ignores it
_MISSING_ALLOWED = 0.2  # largest share of readings without a ray; small assembly errors lose rays only at edges
IMPLAUSIBLE = 6.0
"""Largest assembly error in plausible sizes; a larger one means another headset, or a surface of another shape."""
_EXPLAINED_ARCMIN, _EXPLAINED = 1.0, 2.0
"""Largest residuals of a prescription of this headset: a camera pixel of 1', or twice the stated sigma."""
_EVALUATIONS = 40  # most Jacobians in a round; a prescription of this headset needs about five
_TANGENT_STEP = 1e-6  # step of finite differences, small enough for linear optics and large enough to keep nine digits


@dataclass(frozen=True, eq=False)
class FittedAssembly:
    """A prescription with fitted assembly errors.

    Attributes:
        prescription: the prescription without assembly errors.
        values: (12,) assembly errors, see `optics.assembly.ASSEMBLY_NAMES`.
        covariance: (12, 12) covariance of `values` for independent residuals; too small for a wrong shape.
        display_arcmin, see_through_arcmin: robust standard deviation of the residuals per axis, including noise; None
            without see-through captures.
    """

    prescription: EyeOptics
    values: FloatArray
    covariance: FloatArray
    display_arcmin: float
    see_through_arcmin: float | None

    @property
    def optics(self) -> EyeOptics:
        """The prescription with its assembly errors."""
        return assembled(self.prescription, self.values)


def fit_assembly(captures: Captures, optics: EyeOptics) -> FittedAssembly:
    """Fit the twelve assembly errors of a prescription, in green light, to display and see-through captures together.

    The method is nonlinear least squares, robust in the angles, with a Gaussian prior of plausible size for each error.
    The residual size is estimated separately for display and see-through and includes the prescription's model errors.

    A wrong shape can look like large assembly errors, which then help the models but have no physical meaning.

    Raises:
        BadInputError: many readings have no ray through the prescription, or the prescription explains the readings
            badly and needs an implausibly large assembly error.
    """
    parts: list[_Residual] = []
    if captures.display is not None:
        parts.append(_display_residual(_thinned(captures.display), optics))
    if captures.see_through is not None:
        parts.append(partial(_see_through_residual, _thinned(captures.see_through)))
    scaled = np.zeros(len(ASSEMBLY_NAMES))
    sizes = [_robust_size(part(optics)) for part in parts]
    for _ in range(_ROUNDS):

        def residual(scaled: FloatArray, sizes: list[float] = sizes) -> FloatArray:
            changed = assembled(optics, ASSEMBLY_SIZES * scaled)
            found = [part(changed) / size for part, size in zip(parts, sizes, strict=True)]
            return np.concatenate([*(np.nan_to_num(each, nan=_LOST) for each in found), scaled])

        solution = scipy.optimize.least_squares(
            residual, scaled, loss=_loss, f_scale=2.0, diff_step=1e-5, xtol=1e-6, ftol=1e-8, max_nfev=_EVALUATIONS
        )
        scaled, fitted = solution.x, assembled(optics, ASSEMBLY_SIZES * solution.x)
        before, sizes = sizes, [_robust_size(part(fitted)) for part in parts]
        if np.allclose(sizes, before, rtol=_SETTLED):
            break
    for part in parts:
        _check_reached(part(fitted), captures.source.device)
    if max(sizes) > _EXPLAINED_ARCMIN * ARCMIN and max(sizes) > _EXPLAINED * _stated_sigma(captures) * ARCMIN:
        _check_plausible(scaled, captures.source.device)
    covariance = np.linalg.inv(solution.jac.T @ solution.jac) * np.outer(ASSEMBLY_SIZES, ASSEMBLY_SIZES)
    display_arcmin, *see_through_arcmin = (size / ARCMIN for size in sizes)
    return FittedAssembly(
        optics, ASSEMBLY_SIZES * scaled, covariance, display_arcmin, next(iter(see_through_arcmin), None)
    )


def _loss(square: FloatArray) -> FloatArray:
    """Return soft-L1 of squares (n,) with two derivatives, (3, n); the prior's squares, at the end, stay squares."""
    root = np.sqrt(1.0 + square)
    found = np.stack([2.0 * (root - 1.0), 1.0 / root, -0.5 / root**3])
    prior = square[-len(ASSEMBLY_NAMES) :]
    found[:, -len(prior) :] = prior, np.ones_like(prior), np.zeros_like(prior)
    return found


def display_trend(assembly: FittedAssembly, plane: BasePlane, box: Box) -> Trend:
    """Compile the fitted prescription's display: (u px, v px, x m, y m) -> (tx, ty).

    The trend's parameters are the assembly errors in units of their plausible sizes, zero for the nominal prescription,
    so that the evidence penalises large assembly errors. The trend is linearised about the fitted errors.

    Args:
        assembly: the fit.
        plane: the base plane of the model.
        box: box of the model's inputs.

    Raises:
        BadInputError: almost no ray of the box passes the optics.
    """
    return _trend(assembly, compile_display(assembly.prescription, assembly.values, plane, box))


def see_through_trend(assembly: FittedAssembly, plane: BasePlane, box: Box) -> Trend:
    """Compile the fitted prescription's see-through: (x m, y m, tx, ty) -> (Ax, Ay, Bx m, By m); see `display_trend`.

    The parameters are the same as the display's.
    """
    return _trend(assembly, compile_see_through(assembly.prescription, assembly.values, plane, box))


def with_posterior(assembly: FittedAssembly, mean: FloatArray, covariance: FloatArray) -> FittedAssembly:
    """Return the assembly errors from a fit of models: mean (12,) and covariance (12, 12) of the trends' parameters."""
    scaled = covariance * np.outer(ASSEMBLY_SIZES, ASSEMBLY_SIZES)
    return replace(assembly, values=ASSEMBLY_SIZES * mean, covariance=scaled)


def prescription_report(assembly: FittedAssembly, device: str, eye: str) -> dict[str, Any]:
    """Return the assembly errors with their sigmas, and the corrected prescription as the text of a device file."""
    sigma = np.sqrt(np.diag(assembly.covariance))
    found = zip(ASSEMBLY_NAMES, assembly.values, sigma, strict=True)
    corrected = Device(device, "prescription with assembly errors fitted to captures", {eye: assembly.optics})
    return {
        "assembly_errors": {name: {"value": float(value), "sigma": float(error)} for name, value, error in found},
        "device_file": toml_text(device_content(corrected)),
    }


def _trend(assembly: FittedAssembly, compiled: CompiledMap) -> Trend:
    polynomial, count = compiled.polynomial, len(ASSEMBLY_SIZES)
    by_size = (compiled.by_assembly_error * ASSEMBLY_SIZES).reshape(len(polynomial.orders), -1)
    about_fitted = Trend(polynomial, Polynomial(polynomial.orders, polynomial.box, by_size))
    return about_fitted.about(-assembly.values / ASSEMBLY_SIZES, np.eye(count))


def _display_residual(captures: DisplayCaptures, optics: EyeOptics) -> _Residual:
    """Return a function (optics) -> angles (2 n,) in radians from measured to traced pixels; NaN where no ray passes.

    The prescription `optics` converts pixels to angles.
    """
    steps = _TANGENT_STEP * np.array([[0.0, 0.0], [1.0, 0.0], [0.0, 1.0]])[:, None]
    directions = dir_of_tangents(captures.tangents + steps)
    pixel, _ = TracedDisplay(optics, GREEN_UM).plane_pixel(directions, captures.viewpoint)
    by_tangents = np.moveaxis(pixel[1:] - pixel[0], 0, -1) / _TANGENT_STEP
    by_tangents[~np.isfinite(by_tangents).all(axis=(1, 2))] = np.nan
    tangents_by_pixel = np.linalg.inv(by_tangents)

    def residual(optics: EyeOptics) -> FloatArray:
        found, _ = TracedDisplay(optics, GREEN_UM).plane_pixel(captures.view_dir, captures.viewpoint)
        return _angles(np.einsum("nij,nj->ni", tangents_by_pixel, found - captures.pixel), captures.tangents)

    return residual


def _see_through_residual(captures: SeeThroughCaptures, optics: EyeOptics) -> FloatArray:
    """Return the angles (2 n,), radians at the viewpoint, by which world rays miss points; NaN without a ray."""
    seen = trace(optics.see_through, captures.viewpoint, captures.view_dir, GREEN_UM)
    past = BasePlane(0.0).carry(seen.origin - captures.point, tangents_of_dir(seen.direction))
    return _angles(past / (captures.viewpoint[:, 2:] - captures.point[:, 2:]), captures.tangents)


def _angles(change: FloatArray, tangents: FloatArray) -> FloatArray:
    """Convert changes (n, 2) of tangents (n, 2) to angles (2 n,), with the right size on average over directions."""
    return np.asarray(change * (1.0 + np.sum(tangents**2, axis=1, keepdims=True)) ** -0.75).reshape(-1)


def _thinned(captures: AnyCaptures) -> AnyCaptures:
    if len(captures) <= _READINGS:
        return captures
    return select(captures, np.sort(np.random.default_rng(0).permutation(len(captures))[:_READINGS]))


def _robust_size(residual: FloatArray) -> float:
    """Return the robust standard deviation, 1.48 times the median absolute residual, radians."""
    known = np.abs(residual[np.isfinite(residual)])
    return float(max(1.48 * np.median(known) if len(known) else 0.0, _FLOOR_ARCMIN * ARCMIN))


def _check_reached(residual: FloatArray, device: str) -> None:
    lost = float(np.mean(~np.isfinite(residual)))
    if lost > _MISSING_ALLOWED:
        raise BadInputError(
            f"{100 * lost:.0f} % of the readings of {device} have no ray through the prescription, however its parts "
            "are moved; check that it is of this headset and this eye, and in the device frame."
        )


def _stated_sigma(captures: Captures) -> float:
    """Return the stated sigma of the readings, arcminutes: the larger median of the two parts; 0 for exact data."""
    parts = (part for part in (captures.display, captures.see_through) if part is not None)
    return max(float(np.median(part.sigma_arcmin)) for part in parts)


def _check_plausible(scaled: FloatArray, device: str) -> None:
    largest = int(np.argmax(np.abs(scaled)))
    if abs(scaled[largest]) > IMPLAUSIBLE:
        raise BadInputError(
            f"the prescription would explain the captures of {device} only with {ASSEMBLY_NAMES[largest]} = "
            f"{ASSEMBLY_SIZES[largest] * scaled[largest]:.3g}, {abs(scaled[largest]):.0f} times what is plausible; "
            "check that it is of this headset and this eye, and in the device frame."
        )
