"""The record of a diagnosis: verdict, causes with values and evidence, unexplained residual, and corrected bench."""

from dataclasses import dataclass, field

from wlr_render.bench.bench import Bench
from wlr_render.diagnosis.fit import Fit
from wlr_render.diagnosis.held_out import HeldOutImprovement
from wlr_render.diagnosis.noise import NoiseFloor
from wlr_render.diagnosis.observations import CaptureName, Observations
from wlr_render.diagnosis.settings import Settings
from wlr_render.diagnosis.weighed_readings import WeighedReadings
from wlr_render.numerics.arrays import BoolArray, FloatArray

NO_EFFECT, EXPLAINED, LOCATED = "no effect", "explained", "effect located"
PARTLY, UNEXPLAINED = "partly explained", "unexplained"


@dataclass(frozen=True)
class ParameterValue:
    """A fitted parameter of a cause.

    Attributes:
        name, unit: see `cause.Parameter`.
        value: fitted value, in that unit.
        sigma: standard error; 0 for a time, which is known to within the gap between two captures.
        prior_sigma, prior_mean: prior from practice, or as the bench file states it, in that unit.
    """

    name: str
    value: float
    sigma: float
    unit: str
    prior_sigma: float
    prior_mean: float = 0.0


@dataclass(frozen=True)
class DegenerateCause:
    """Another cause with nearly the same effect.

    Attributes:
        name: name of the other cause.
        share_of_gain: its first-order gain in evidence, relative to the named cause's; 1 for the same effect.
        separated_by: the extra measurement that separates the two.
    """

    name: str
    share_of_gain: float
    separated_by: str


@dataclass(frozen=True)
class RankedCandidate:
    """A candidate for the place of a cause, with the other causes as found.

    Attributes:
        name, variant: the cause and how it acts.
        reduced_chi_squared: reduced chi-squared of the remaining residual; 1 is noise.
        log10_odds: log10 odds of the best candidate against this one; NaN if it was not fitted.
    """

    name: str
    variant: str
    reduced_chi_squared: float
    log10_odds: float


@dataclass(frozen=True)
class FoundCause:
    """A named cause with its evidence.

    Attributes:
        name, title, part: see `cause.Cause`.
        variant: how it acts.
        parameters: its fitted values.
        improvement: improvement on held-out captures over the other found causes alone.
        degenerate: causes that it could be confused with.
        ranking: the candidates for its place, including itself, best first.
        effect_over_noise: rms change of the readings by the cause, in units of sigma.
        log10_odds: log10 odds for the cause against no cause in its place, with the others as found.
        log10_odds_against_its_station: log10 odds for its name against the fields of its station, or of another
            station with closer evidence.
        remedy: its remedy; empty for the remedy of its part.
    """

    name: str
    title: str
    part: str
    variant: str
    parameters: tuple[ParameterValue, ...]
    improvement: HeldOutImprovement
    degenerate: tuple[DegenerateCause, ...]
    ranking: tuple[RankedCandidate, ...]
    effect_over_noise: float
    log10_odds: float
    log10_odds_against_its_station: float
    remedy: str = ""


@dataclass(frozen=True, eq=False)
class StationEffect:
    """An effect that no listed cause explains, located at a station of the bench.

    Attributes:
        station: "panel", "combiner", "camera", "target", "stage", "time", "head motion" or "eye tracking".
        coordinates: coordinates of the station on which it depends.
        displaced: quantity that it displaces there, e.g. "shift".
        form: "smooth", or "fine" where it is finer than any smooth field.
        parts: parts of the session that it changes.
        log10_odds: log10 odds for the effect against no effect.
        next_station: the station with the next best evidence; empty where no other was judged.
        odds_against_next_station: log10 odds against that station.
        size: rms displacement at the station over the readings that it acts on, in `unit`; of a pose, its shift or
            its turn, whichever exceeds its error more; of heights, about their mean; of a spot, in its strongest cell;
            of a bump, its largest height, negative towards the eye.
        size_sigma: standard error of the size.
        length: diameter of its spot, or width of its cells, in `length_unit`; None for a smooth effect.
        place: (2,) middle of its spot in the coordinates of the station; None where it is spread over the station.
        held_out_improvement: improvement on captures held out of its fit.
        share_of_excess_removed: share of these captures' excess over noise and repeatability that it removes.
        likely: usual sources of such an effect.
        is_in_bench: whether the corrected bench contains it.
        map_place: (m, v) coordinates, at the station, of the readings that it acts on.
        map_displacement: (m, d) displacement there, in `map_unit`.
    """

    station: str
    coordinates: str
    displaced: str
    form: str
    parts: tuple[str, ...]
    log10_odds: float
    next_station: str
    odds_against_next_station: float
    size: float
    size_sigma: float
    unit: str
    length: float | None
    place: tuple[float, float] | None
    held_out_improvement: HeldOutImprovement
    share_of_excess_removed: float
    likely: tuple[str, ...]
    map_place: FloatArray = field(metadata={"json": False})
    map_displacement: FloatArray = field(metadata={"json": False})
    map_unit: str = field(metadata={"json": False})
    length_unit: str = ""
    is_in_bench: bool = False


@dataclass(frozen=True)
class TriedField:
    """A displacement field that was judged.

    Attributes:
        station, coordinates, displaced: as in `StationEffect`.
        degree: degree with the best evidence.
        log10_odds: log10 odds for the field against no field, with the causes and the located effects included.
    """

    station: str
    coordinates: str
    displaced: str
    degree: int
    log10_odds: float


@dataclass(frozen=True)
class Unexplained:
    """A residual that neither causes nor located effects explain.

    Attributes:
        part: "display", "see-through" or "run-time".
        excess: variance of its residual relative to noise and usual repeatability, minus one.
        rms_over_noise: rms residual of that part relative to its noise.
    """

    part: str
    excess: float
    rms_over_noise: float


@dataclass(frozen=True)
class ResidualSummary:
    """RMS of measured minus simulated, per axis; None for a part that the session does not have.

    Attributes:
        display_rms_px: panel pixels.
        see_through_rms_arcmin: arcminutes as the camera sees them.
        run_time_rms_arcmin: angle between the virtual and the real dot.
        over_noise: rms of all readings, in units of sigma.
    """

    display_rms_px: float | None
    see_through_rms_arcmin: float | None
    run_time_rms_arcmin: float | None
    over_noise: float


@dataclass(frozen=True)
class DetectionLimit:
    """The smallest value of a parameter that would have been found if its cause acted alone.

    Attributes:
        cause, parameter, unit: names.
        limit: smallest value: `Settings.detection_limit_se` standard errors.
    """

    cause: str
    parameter: str
    unit: str
    limit: float


@dataclass(frozen=True)
class CaptureResidual:
    """Residual of one capture relative to its noise.

    Attributes:
        capture: name of the capture.
        readings: number of readings used.
        rms_before, rms_after: rms with the nominal and with the corrected bench, in units of sigma.
        excluded: whether the capture was excluded.
    """

    capture: str
    readings: int
    rms_before: float
    rms_after: float
    excluded: bool


@dataclass(frozen=True)
class Correlations:
    """Correlations between the fitted values.

    Attributes:
        names: "cause.parameter" for each value.
        matrix: (p, p) correlation matrix.
        condition: condition number of the matrix; 1 where no values are correlated.
    """

    names: tuple[str, ...] = ()
    matrix: tuple[tuple[float, ...], ...] = ()
    condition: float = 1.0


@dataclass(frozen=True)
class MotionSize:
    """Repeatability of the captures of a part: standard deviation of the camera's motion per axis.

    Attributes:
        part: name of the part.
        shift_um, shift_error_um: repeatability of positions, and its standard error.
        turn_urad, turn_error_urad: repeatability of turns, and its standard error.
    """

    part: str
    shift_um: float
    shift_error_um: float
    turn_urad: float
    turn_error_urad: float


@dataclass(frozen=True)
class MovedCapture:
    """An excluded capture.

    Attributes:
        capture: name of the capture.
        shift_mm: (3,) apparent shift of its camera, device frame; None where a photograph without the headset, which
            moves with the camera, locates the dots.
        turn_deg: (3,) apparent rotation of its camera; None likewise.
        rms_before, rms_after: its rms residual in units of sigma, without and with that move.
        log10_odds: log10 odds for the move against a motion of the usual size.
    """

    capture: CaptureName
    shift_mm: tuple[float, ...] | None
    turn_deg: tuple[float, ...] | None
    rms_before: float
    rms_after: float
    log10_odds: float


@dataclass(frozen=True, eq=False)
class DiagnosisRecord:
    """Verdict, causes with values and evidence, unexplained residual, and the corrected bench.

    Attributes:
        session, device, eye: names.
        verdict: NO_EFFECT, EXPLAINED (by named causes only), LOCATED (an effect that no cause explains is located at a
            station, with or without named causes, and only noise is left), PARTLY or UNEXPLAINED.
        causes: named causes, largest effect first.
        effects: effects that no cause explains, best odds first.
        excluded: captures that moved.
        too_many_moved: captures of parts with too many moved captures to identify them; they are not excluded.
        noise_floors: noise of each part.
        motions: repeatability of each part that has two captures or more.
        noise: residual expected from noise alone.
        expected: residual expected from noise and the usual motions of the captures.
        before, after: residuals with the nominal and with the corrected bench.
        unexplained_parts: parts with more than noise left, worst first.
        fields: all fields that were judged, best odds first.
        detection_limits: detection limits of every cause; only for a verdict of no effect.
        reasons: sentences on why the selection ended, and on causes that were considered and dropped.
        captures: residual of each capture.
        correlations: between all values found.
        observations: all readings, with the noise that was used.
        residual_before, residual_after: (n, 2) residuals of all readings, including excluded ones, in units of sigma.
        usual_motion: (n, 2, 6) change of the readings, in units of sigma, by a camera motion of the usual size along
            and about each axis.
        used: (n,) mask of the readings that are not excluded.
        corrected: the corrected bench.
        readings: readings that are not outliers, with the errors that the bench gives them.
        fit: fit of all causes to these readings.
        settings: thresholds of the diagnosis and of its sentences.
    """

    session: str
    device: str
    eye: str
    verdict: str
    causes: tuple[FoundCause, ...]
    effects: tuple[StationEffect, ...]
    excluded: tuple[MovedCapture, ...]
    too_many_moved: tuple[MovedCapture, ...]
    noise_floors: tuple[NoiseFloor, ...]
    motions: tuple[MotionSize, ...]
    noise: ResidualSummary
    expected: ResidualSummary
    before: ResidualSummary
    after: ResidualSummary
    unexplained_parts: tuple[Unexplained, ...]
    fields: tuple[TriedField, ...]
    detection_limits: tuple[DetectionLimit, ...]
    reasons: tuple[str, ...]
    captures: tuple[CaptureResidual, ...]
    correlations: Correlations
    observations: Observations = field(metadata={"json": False})
    residual_before: FloatArray = field(metadata={"json": False})
    residual_after: FloatArray = field(metadata={"json": False})
    usual_motion: FloatArray = field(metadata={"json": False})
    used: BoolArray = field(metadata={"json": False})
    corrected: Bench = field(metadata={"json": False})
    readings: WeighedReadings = field(metadata={"json": False})
    fit: Fit = field(metadata={"json": False})
    settings: Settings = field(metadata={"json": False})

    @property
    def is_corrected(self) -> bool:
        """True if the corrected bench differs from the nominal one, by causes or by effects that a file can state."""
        return self.corrected is not self.observations.nominal

    @property
    def title(self) -> str:
        """Title of the report."""
        return f"Diagnosis of {self.session} ({self.device}, {self.eye} eye)"
