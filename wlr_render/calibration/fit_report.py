"""A fitted model and its report: estimated noise and stage, predicted error, and benefit of further positions."""

from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any, Generic, Self, TypeVar

import numpy as np

from wlr_render.calibration.label_errors import LabelError, label_errors
from wlr_render.calibration.label_terms import LabelTerm, unseen_errors
from wlr_render.calibration.moved_captures import CaptureMotion, MotionAgreement
from wlr_render.calibration.posterior_spread import label_response
from wlr_render.calibration.reading_sums import Response
from wlr_render.calibration.readings import FitReadings
from wlr_render.calibration.smooth_fit import SmoothFit
from wlr_render.captures.correspondences import DisplayCaptures, SeeThroughCaptures, select, with_copies
from wlr_render.error_sources import ErrorSource
from wlr_render.errors import BadInputError
from wlr_render.geometry.directions import ARCMIN, arcmin_between
from wlr_render.mappings import QueryResult
from wlr_render.models.fitted_model import FittedDisplay, FittedSeeThrough
from wlr_render.numerics.arrays import BoolArray, FloatArray, IntArray

AnyModel = TypeVar("AnyModel", FittedDisplay, FittedSeeThrough)
_BANDS = 5  # most bands of camera positions along x and along y that are left out in turn
_TESTED = 2_000  # number of pairs of viewpoint and pixel or point over which the predicted error is averaged


@dataclass(frozen=True)
class Residuals:
    """Lengths of residual vectors, in the unit of the attribute that has this value."""

    rms: float
    p95: float
    maximum: float

    @classmethod
    def of(cls, size: FloatArray) -> "Residuals":
        """Summarise residual lengths (n,), ignoring NaN.

        Raises:
            BadInputError: all lengths are NaN.
        """
        known = size[np.isfinite(size)]
        if known.size == 0:
            raise BadInputError("the fitted model answers none of the captures it was made from; use a lower degree.")
        return cls(float(np.sqrt(np.mean(known**2))), float(np.quantile(known, 0.95)), float(known.max()))


@dataclass(frozen=True)
class HeldOut:
    """Camera positions that were left out and predicted by a fit to the other positions.

    Attributes:
        left_out: name of the positions, e.g. "row 2 of 5".
        captures: number of captures left out.
        rms_arcmin: rms prediction error. expected_arcmin: rms error that the fit expects, including noise and motions.
    """

    left_out: str
    captures: int
    rms_arcmin: float
    expected_arcmin: float


@dataclass(frozen=True)
class OneMore:
    """Predicted error of the model with one more row or column of camera positions.

    Attributes:
        positions: description, e.g. "a row of 5 camera positions at y = +4 mm".
        predicted_arcmin: rms error of the model with these positions, as `FitReport.predicted_arcmin`.
    """

    positions: str
    predicted_arcmin: float


@dataclass(frozen=True)
class ErrorShare:
    """Contribution of one source to the predicted error of a model.

    Attributes:
        source: e.g. "printing errors of the board".
        arcmin: rms contribution, over the same rays as `FitReport.predicted_arcmin`; squares of all sources add up.
        size, usual: estimated rms size of the source's own errors, and the usual size; None for sources without an
            estimate, e.g. errors stated by the bench.
        unit: unit of both sizes, "m" or "arcmin"; empty without sizes.
    """

    source: str
    arcmin: float
    size: float | None = None
    usual: float | None = None
    unit: str = ""


@dataclass(frozen=True)
class FitReport:
    """Quality of a model, for its own captures and beyond.

    Attributes:
        kind: "planar", "volumetric", "static", "point-per-pixel", "grey-box" or "prescription".
        orders: limits of the orders, e.g. "pixel 8, place 5".
        coefficients: number of coefficients, including parameters of a prescription.
        determined: effective number of coefficients that the captures determine.
        viewpoints: number of camera positions. samples: number of measured directions.
        unsolved: number of samples without an answer of the model. outliers: number of samples of weight zero.
        residual_arcmin: residuals of view directions, predicted from pixel (or real point) and viewpoint.
        residual_px: residuals of pixels, predicted from view direction and viewpoint; None for see-through.
        contraction: contraction of the model's solve over the eye box; below 1, the solution is unique
            (`models.contraction`).
        noise_arcmin: estimated noise per axis. stated_noise_arcmin: median sigma of the captures; None for exact data.
        repeatability_um, wobble_urad: estimated standard deviations, rms per axis, of the camera's shift and rotation
            from capture to capture.
        moved: captures whose camera positions differ from the stated ones by far more than the others'.
        log_evidence: natural logarithm of the evidence, the largest for the most probable model of the same captures.
        predicted_arcmin: rms error that the fit expects over the eye box, including errors of significant labels.
        held_out: rows and columns of camera positions predicted from the others.
        one_more: the most useful further row or column; None for kinds that do not depend on the place.
        motion_agreement: comparison with the camera motions stated by the captures; None without stated motions.
        labels: errors shared by readings of a dot, visit, time and so on, beyond the fit; empty for exact data.
        shares: contributions to `predicted_arcmin`, the largest first.
        unseen: errors that `predicted_arcmin` omits, because the captures lack the data to estimate them.
        unsure: captures whose camera moved, or where the optics are less smooth than the model; the fit uses them.
    """

    kind: str
    orders: str
    coefficients: int
    determined: float
    viewpoints: int
    samples: int
    unsolved: int
    outliers: int
    residual_arcmin: Residuals
    residual_px: Residuals | None
    contraction: float
    noise_arcmin: float
    stated_noise_arcmin: float | None
    repeatability_um: float
    wobble_urad: float
    moved: tuple[CaptureMotion, ...]
    log_evidence: float
    predicted_arcmin: float
    held_out: tuple[HeldOut, ...]
    one_more: OneMore | None
    motion_agreement: MotionAgreement | None = None
    labels: tuple[LabelError, ...] = ()
    shares: tuple[ErrorShare, ...] = ()
    unseen: tuple[str, ...] = ()
    unsure: tuple[CaptureMotion, ...] = ()

    @property
    def held_out_arcmin(self) -> tuple[float, float] | None:
        """Rms error over all held-out rows and columns, and the expected rms; None if nothing was held out."""
        if not self.held_out:
            return None
        captures = np.array([each.captures for each in self.held_out], dtype=np.float64)
        found, expected = (
            float(np.sqrt(np.average(np.square(sizes), weights=captures)))
            for sizes in zip(*((each.rms_arcmin, each.expected_arcmin) for each in self.held_out), strict=True)
        )
        return found, expected


@dataclass(frozen=True)
class ModelFit(Generic[AnyModel]):
    """A fitted model with the details of its fit.

    Attributes:
        kind: see `FitReport`.
        mapping: the model, with its covariance.
        captures: the fitted captures.
        smooth: the fit of the model's polynomial.
        readings_of: function (captures) -> readings of the fit.
        orders: limits of the orders in words.
        contraction, labels: see `FitReport`.
    """

    kind: str
    mapping: AnyModel
    captures: DisplayCaptures | SeeThroughCaptures
    smooth: SmoothFit
    readings_of: Callable[..., FitReadings]
    orders: str
    contraction: float
    labels: tuple[LabelError, ...] = ()

    @cached_property
    def report(self) -> FitReport:
        """Report of the fit; computing the held-out errors and the further row takes about as long as the fit."""
        smooth, captures = self.smooth, self.captures
        seen = self.seen(captures)
        residual_px, usable = None, seen.usable
        if isinstance(self.mapping, FittedDisplay) and isinstance(captures, DisplayCaptures):
            shown = self.mapping.pixel_of_view_dir(captures.view_dir, captures.viewpoint)
            usable = usable & shown.usable
            residual_px = Residuals.of(np.linalg.norm(shown.value - captures.pixel, axis=1))
        stated = captures.sigma_arcmin if np.any(captures.sigma_arcmin > 0) else None
        unit = 1.0 if stated is None else float(np.median(stated))
        determined, coefficients = smooth.determined
        return FitReport(
            kind=self.kind,
            orders=self.orders,
            coefficients=coefficients,
            determined=determined,
            viewpoints=len(np.unique(captures.capture)),
            samples=len(captures),
            unsolved=int(np.sum(~usable)),
            outliers=int(np.sum(smooth.kept == 0.0)),
            residual_arcmin=Residuals.of(arcmin_between(seen.value, captures.view_dir)),
            residual_px=residual_px,
            contraction=self.contraction,
            noise_arcmin=smooth.noise * unit,
            stated_noise_arcmin=None if stated is None else unit,
            repeatability_um=1e6 * smooth.shift_m,
            wobble_urad=1e6 * smooth.turn_rad,
            moved=smooth.moved,
            log_evidence=smooth.posterior.log_evidence,
            predicted_arcmin=self.predicted_arcmin(self.mapping),
            held_out=tuple(self._held_out()),
            one_more=self._one_more(),
            motion_agreement=smooth.motion_agreement,
            labels=self.labels,
            shares=self._shares(),
            unseen=unseen_errors(captures) if stated is not None else (),
            unsure=smooth.unsure,
        )

    @cached_property
    def _by_label(self) -> tuple[tuple[LabelError, ...], Response]:
        return label_errors(self.smooth, self.captures)

    @property
    def sources_by_label(self) -> tuple[str, ...]:
        """Sources of all errors by label in the covariance; the sources that `with_label_errors` adds come last."""
        return label_response(self.smooth.readings, self.smooth.posterior).sources + self._by_label[1].sources

    def with_label_errors(self, before: tuple[str, ...] = (), after: tuple[str, ...] = ()) -> Self:
        """Return the fit with errors by label (`label_errors`) in the covariance.

        Args:
            before, after: error sources of the eye's other model, without effect on this one; their variables come
                before and after this model's variables, so that both models have the same variables.
        """
        labels, response = self._by_label
        smooth = replace(self.smooth, of_labels=response, others=(before, after))
        return replace(self, smooth=smooth, mapping=self.mapping.with_spread(smooth.spread), labels=labels)

    def predicted_arcmin(self, model: AnyModel) -> float:
        """Return the rms standard error of a model over its eye box, at the pixels or points of these captures."""
        return float(np.sqrt(np.nanmean(model.sigma(*self.tested(model)) ** 2)))

    def tested(self, model: AnyModel) -> tuple[FloatArray, FloatArray]:
        """Return random pixels (n, 2) or points (n, 3) of the captures, and random viewpoints (n, 3) in the eye box."""
        rng = np.random.default_rng(0)
        rows = rng.integers(0, len(self.captures), _TESTED)
        return self.subject(self.captures)[rows], model.eye_box.at(rng.uniform(-1.0, 1.0, (_TESTED, 3)))

    def _shares(self) -> tuple[ErrorShare, ...]:
        subject, viewpoint = self.tested(self.mapping)
        answer = self.mapping.view_dir(subject, viewpoint).value
        errors = self.mapping.direction_errors(subject, viewpoint, answer)
        square = np.nanmean(np.sum(errors.shared**2, axis=1), axis=0) / ARCMIN**2
        own = float(np.nanmean(np.trace(errors.unshared, axis1=1, axis2=2))) / ARCMIN**2
        fitted = self.smooth.readings.axis_terms + self.smooth.readings.shared_terms
        terms: dict[str, LabelTerm] = {each.source: each for each in fitted}
        found = [ErrorShare(ErrorSource.NOISE_AND_STAGE, own**0.5)]
        for source in dict.fromkeys(errors.sources):
            share = float(np.sum(square[[each == source for each in errors.sources]])) ** 0.5
            if (term := terms.get(source)) is not None:
                size = float(np.exp(self.smooth.posterior.hyper[term.name]))
                found.append(ErrorShare(source, share, size, term.usual.value, term.usual.unit))
            elif share > 0:
                found.append(ErrorShare(source, share))
        return tuple(sorted(found, key=lambda each: -each.arcmin))

    @staticmethod
    def subject(captures: DisplayCaptures | SeeThroughCaptures) -> FloatArray:
        """Return the panel pixels (n, 2) or real points (n, 3) of captures."""
        return captures.pixel if isinstance(captures, DisplayCaptures) else captures.point

    def seen(self, captures: DisplayCaptures | SeeThroughCaptures) -> QueryResult:
        """Return the view directions that the model predicts for captures of the fitted kind."""
        return self.mapping.view_dir(self.subject(captures), captures.viewpoint)

    @property
    def _has_places(self) -> bool:
        return bool(self.smooth.readings.is_place.any()) and len(np.unique(self.captures.capture)) > 1

    def left_out(self, name: str, out: BoolArray) -> HeldOut:
        """Return the error of a fit without the captures in mask `out` (n,), at the hyperparameters of all captures."""
        rms, expected = self.smooth.left_out(out)
        return HeldOut(name, len(np.unique(self.captures.capture[out])), rms, expected)

    def _held_out(self) -> list[HeldOut]:
        if not self._has_places:
            return []
        captures, found = self.captures, []
        for axis, noun in enumerate(("column", "row")):
            band = bands(captures.viewpoint[:, axis], captures.capture)
            count = int(band.max()) + 1
            for number in range(count if count > 1 else 0):
                out = band == number
                if np.any(self.smooth.kept[out] > 0):
                    found.append(self.left_out(f"{noun} {number + 1} of {count}", out))
        return found

    def _one_more(self) -> OneMore | None:
        """Return the row or column, placed where the model is least certain, that reduces the error more."""
        if not self._has_places:
            return None
        _, first = np.unique(self.captures.capture, return_index=True)
        position = self.captures.viewpoint[first]
        low, high = position.min(axis=0), position.max(axis=0)
        count = max(3, round(len(position) ** 0.5))
        tried = []
        for axis, noun in enumerate(("column", "row")):
            along = np.linspace(low[1 - axis], high[1 - axis], count)
            places = []
            for level in np.linspace(low[axis], high[axis], _BANDS):
                place = np.tile(0.5 * (low + high), (count, 1))
                place[:, axis], place[:, 1 - axis] = level, along
                places.append(place)
            rows = np.random.default_rng(0).integers(0, len(self.captures), 200)
            subject = self.subject(self.captures)[rows][:, None]
            sure = [np.nanmean(self.mapping.sigma(subject, place[None]) ** 2) for place in places]
            worst = places[int(np.argmax(sure))]
            predicted = self.predicted_arcmin(self.with_positions(worst))
            name = f"a {noun} of {count} camera positions at {'xy'[axis]} = {1e3 * worst[0, axis]:+.1f} mm"
            tried.append(OneMore(name, predicted))
        return min(tried, key=lambda each: each.predicted_arcmin)

    def with_positions(self, viewpoint: FloatArray) -> AnyModel:
        """Return the model with the covariance expected with further camera positions (m, 3)."""
        return self.mapping.with_spread(self.smooth.spread_with(self.readings_of(self._with_positions(viewpoint))))

    def with_design(self, captures: DisplayCaptures | SeeThroughCaptures, hyper: Mapping[str, float]) -> AnyModel:
        """Return the model with the covariance expected from a fit to other captures of the same headset.

        Args:
            captures: captures of another design.
            hyper: see `SmoothFit.spread_from`.
        """
        return self.mapping.with_spread(self.smooth.spread_from(self.readings_of(captures), hyper))

    def with_camera_motions(self, curve: Callable[[FloatArray], FloatArray]) -> AnyModel:
        """Return the model that these captures would give if the camera had moved in each.

        Args:
            curve: (positions (m, 3)) -> (m, 6) rotation (rad) and displacement (m) of the camera at each position.
        """
        _, first = np.unique(self.smooth.readings.capture, return_index=True)
        motion = curve(self.captures.viewpoint[first])
        model: Any = self.mapping  # a dataclass, like every model
        changed: AnyModel = replace(model, **{model.MODELLED: self.smooth.with_motions(np.roll(motion, 3, axis=1))})
        return changed

    def _with_positions(self, viewpoint: FloatArray) -> DisplayCaptures | SeeThroughCaptures:
        """Return captures with new ones at viewpoints (m, 3), each with pixels or points of the nearest capture."""
        captures: Any = self.captures  # captures of either kind; the result has the same kind
        names, first = np.unique(captures.capture, return_index=True)
        apart = np.linalg.norm(captures.viewpoint[first] - viewpoint[:, None], axis=2)
        seeing = [np.flatnonzero(captures.capture == name) for name in names[np.argmin(apart, axis=1)]]
        position = np.repeat(np.arange(len(viewpoint)), [len(rows) for rows in seeing])
        whole = with_copies(captures, np.concatenate(seeing), position)
        whole = replace(whole, viewpoint=np.concatenate([captures.viewpoint, viewpoint[position]]))
        seen = self.seen(select(whole, np.arange(len(captures), len(whole))))
        known = seen.usable & (seen.value[:, 2] < 0)
        view_dir = np.where(known[:, None], seen.value, whole.view_dir[len(captures) :])
        whole = replace(whole, view_dir=np.concatenate([captures.view_dir, view_dir]))
        further: DisplayCaptures | SeeThroughCaptures = select(whole, np.append(np.ones(len(captures), bool), known))
        return further


def bands(coordinate: FloatArray, capture: IntArray) -> IntArray:
    """Return the band number (n,) of each row along a coordinate (n,); bands have about equal numbers of captures."""
    _, first, position = np.unique(capture, return_index=True, return_inverse=True)
    order = np.argsort(np.argsort(coordinate[first], kind="stable"), kind="stable")
    count = min(_BANDS, max(2, round(len(first) ** 0.5)))
    return np.asarray((order * count // len(first))[position])
