"""Quality of a fit: residuals and cross-validated errors."""

from dataclasses import asdict, dataclass
from typing import Any

import numpy as np

from wlr_render.errors import BadInputError
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
class HeldOut:
    """Error on camera positions that were left out of the fit, for one degree.

    Attributes:
        degree: total degree N.
        rms: root mean square length of the residual vector, over all positions, each left out once.
        standard_error: of `rms`, from its spread over the folds.
    """

    degree: int
    rms: float
    standard_error: float


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
        held_out_arcmin: of the forward fit, per degree tried; a degree that the positions left over cannot determine is
            missing.
        held_out_px: of the backward fit at `degree`; None for see-through, or where it could not be determined.
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
    held_out_arcmin: tuple[HeldOut, ...]
    held_out_px: HeldOut | None

    def held_out_at_degree(self) -> HeldOut | None:
        """The held-out error of the degree in use, or None where it could not be determined."""
        return next((entry for entry in self.held_out_arcmin if entry.degree == self.degree), None)

    def record(self) -> dict[str, Any]:
        """As JSON-ready values, for the model file."""
        return asdict(self)
