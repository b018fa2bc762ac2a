"""Quality of a fit: residuals and cross-validated errors."""

from dataclasses import dataclass

import numpy as np

from wlr_render.calibration.regression import Fitted, HeldOut
from wlr_render.captures.correspondences import DisplayCaptures, SeeThroughCaptures
from wlr_render.errors import BadInputError
from wlr_render.geometry.directions import arcmin_between
from wlr_render.mappings import QueryResult
from wlr_render.numerics.arrays import FloatArray


@dataclass(frozen=True)
class Residuals:
    """Sizes of residual vectors, in the unit that the attribute holding this names."""

    rms: float
    p95: float
    maximum: float

    @classmethod
    def of(cls, size: FloatArray) -> "Residuals":
        """Of residual lengths (n,); elements without a value (NaN) do not count.

        Raises:
            BadInputError: none has a value.
        """
        known = size[np.isfinite(size)]
        if known.size == 0:
            raise BadInputError("the fitted model answers none of the captures it was made from; use a lower degree.")
        return cls(float(np.sqrt(np.mean(known**2))), float(np.quantile(known, 0.95)), float(known.max()))


@dataclass(frozen=True)
class FitReport:
    """Quality of a model on the captures it was fitted to, and on held-out captures.

    Attributes:
        kind: "planar", "volumetric", "static" or "point-per-pixel".
        degree: total degree N.
        coefficients: of each polynomial by name: the number of its coefficients.
        condition: largest condition number of the scaled designs.
        viewpoints: number of camera positions.
        samples: number of measured directions.
        unsolved: samples at which the fitted model has no answer.
        residual_arcmin: of the view directions, predicted from pixel (or real point) and viewpoint by the whole model.
        residual_px: of the pixels, predicted from view direction and viewpoint; None for see-through.
        contraction: of the model's solve over the eye box; below 1 the solve has one solution (`models.contraction`).
        held_out_arcmin: of the forward fit, per degree tried; a degree that the positions left over cannot determine is
            missing.
    """

    kind: str
    degree: int
    coefficients: dict[str, int]
    condition: float
    viewpoints: int
    samples: int
    unsolved: int
    residual_arcmin: Residuals
    residual_px: Residuals | None
    contraction: float
    held_out_arcmin: tuple[HeldOut, ...]

    def held_out_at_degree(self) -> HeldOut | None:
        """The held-out error of the degree in use, or None where it could not be determined."""
        return next((entry for entry in self.held_out_arcmin if entry.degree == self.degree), None)

    @classmethod
    def of(
        cls,
        kind: str,
        captures: DisplayCaptures | SeeThroughCaptures,
        fits: dict[str, Fitted],
        contraction: float,
        seen: QueryResult,
        shown: QueryResult | None = None,
    ) -> "FitReport":
        """Compare a model's predictions with the captures it was fitted to.

        Args:
            kind: of the model.
            captures: n rows.
            fits: by polynomial name.
            contraction: of the model's solve.
            seen: predicted view directions (n, 3).
            shown: predicted panel pixels (n, 2), for a display.
        """
        first = next(iter(fits.values()))
        residual_px, usable = None, seen.usable
        if shown is not None and isinstance(captures, DisplayCaptures):
            usable = usable & shown.usable
            residual_px = Residuals.of(np.linalg.norm(shown.value - captures.pixel, axis=1))
        return cls(
            kind=kind,
            degree=first.degree,
            coefficients={name: fitted.polynomial.coefficients.size for name, fitted in fits.items()},
            condition=max(fitted.condition for fitted in fits.values()),
            viewpoints=len(np.unique(captures.capture)),
            samples=len(captures),
            unsolved=int(np.sum(~usable)),
            residual_arcmin=Residuals.of(arcmin_between(seen.value, captures.view_dir)),
            residual_px=residual_px,
            contraction=contraction,
            held_out_arcmin=first.held_out,
        )
