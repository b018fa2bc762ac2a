"""The result of a diagnosis: verdict, causes with values and evidence, what stays unexplained, the extended bench."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from wlr_render.diagnosis.held_out import HeldOutGain
from wlr_render.diagnosis.noise import NoiseFloor
from wlr_render.diagnosis.observations import Observations
from wlr_render.diagnosis.outliers import MovedCapture
from wlr_render.numerics.arrays import FloatArray
from wlr_render.simulation.bench import Bench

NO_EFFECT, EXPLAINED, PARTLY, UNEXPLAINED = "no effect", "explained", "partly explained", "unexplained"


@dataclass(frozen=True)
class ParameterValue:
    """A fitted number.

    Attributes:
        name, unit: as the cause has them.
        value: in that unit.
        plausible: standard deviation of what is met in practice, in that unit.
        sigma: one standard error; 0 for a moment, which is known to the gap between two captures.
    """

    name: str
    value: float
    sigma: float
    unit: str
    plausible: float


@dataclass(frozen=True)
class Overlap:
    """A cause that would have looked much the same.

    Attributes:
        name: of the other cause.
        cosine: of the angle between the effect found and its best imitation by the other; 1 is the same.
        separated_by: the extra measurement that tells them apart.
    """

    name: str
    cosine: float
    separated_by: str


@dataclass(frozen=True)
class Rival:
    """A candidate for the place of a cause, the others being as found.

    Attributes:
        name, variant: which cause, acting how.
        misfit: mean square residual over the noise's that it leaves; 1 is the noise floor.
        cost_behind: by how much its cost (-2 log of the marginal likelihood) exceeds the best one's; NaN where it
            promised too little to be fitted.
    """

    name: str
    variant: str
    misfit: float
    cost_behind: float


@dataclass(frozen=True)
class FoundCause:
    """A cause with its evidence.

    Attributes:
        name, title, part: see `cause.Cause`.
        variant: how it acts.
        parameters: its values.
        gain: on held-out captures, over the other causes found without this one.
        overlaps: causes that it could be mistaken for.
        rivals: the ranking for its place, best first, itself among them.
        effect_over_noise: rms change of the readings by it, in units of sigma.
        remedy: what to do about it; empty where nothing but what its part asks for.
    """

    name: str
    title: str
    part: str
    variant: str
    parameters: tuple[ParameterValue, ...]
    gain: HeldOutGain
    overlaps: tuple[Overlap, ...]
    rivals: tuple[Rival, ...]
    effect_over_noise: float
    remedy: str = ""


@dataclass(frozen=True)
class Correction:
    """A flexible smooth correction: no cause, and offered as none.

    Attributes:
        part: of the session it corrects.
        bound_to: the variables that it is a function of.
        form: how it depends on them.
        terms: coefficients per axis.
        gain: on held-out captures.
    """

    part: str
    bound_to: str
    form: str
    terms: int
    gain: HeldOutGain


@dataclass(frozen=True)
class Unexplained:
    """What no cause explains.

    Attributes:
        part: "display", "see-through" or "run-time".
        bound_to: "panel pixels", "camera pixels", "target", "stage", "time" or "colour".
        rms_over_noise: rms residual of that part over its noise.
        corrections: all corrections tried on that part, best first.
    """

    part: str
    bound_to: str
    rms_over_noise: float
    corrections: tuple[Correction, ...]


@dataclass(frozen=True)
class Figures:
    """How far a simulation is from the measurement; None for a part that the session does not have.

    Attributes:
        display_rms_px: panel pixels per axis.
        see_through_rms_arcmin: per axis.
        run_time_rms_arcmin: of the virtual dot against the real one, per axis.
        over_noise: rms of all readings in units of sigma.
    """

    display_rms_px: float | None
    see_through_rms_arcmin: float | None
    run_time_rms_arcmin: float | None
    over_noise: float


@dataclass(frozen=True)
class DetectionLimit:
    """The smallest size at which a parameter would have been found.

    Attributes:
        cause, parameter, unit: which.
        smallest: five standard errors.
    """

    cause: str
    parameter: str
    unit: str
    smallest: float


@dataclass(frozen=True, eq=False)
class Diagnosis:
    """All of it.

    Attributes:
        verdict: NO_EFFECT, EXPLAINED, PARTLY or UNEXPLAINED.
        causes: what was found, most important first.
        outliers: captures set aside.
        floors: noise per part.
        noise: the figures that noise alone would give.
        before, after: with the nominal and with the extended bench.
        unexplained: None when down to the noise.
        limits: of every cause; for a verdict of no effect.
        reasons: sentences on why the selection ended, and what was considered and dropped.
        observations: what was compared, with the noise that was gone by.
        residual_before, residual_after: (n, 2) units of sigma, of all readings, outliers too.
        used: (n,) readings that no outlier has.
        extended: the extended bench.
        condition: of the correlations between all values found; 1 where each is known by itself.
    """

    verdict: str
    causes: tuple[FoundCause, ...]
    outliers: tuple[MovedCapture, ...]
    floors: tuple[NoiseFloor, ...]
    noise: Figures
    before: Figures
    after: Figures
    unexplained: Unexplained | None
    limits: tuple[DetectionLimit, ...]
    reasons: tuple[str, ...]
    observations: Observations
    residual_before: FloatArray
    residual_after: FloatArray
    used: NDArray[np.bool_]
    extended: Bench
    condition: float = 1.0
