"""Recipes for model fits of either side of the headset, display or see-through: base plane, kinds, limits, refusals."""

from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from functools import partial
from typing import Any, Generic

import numpy as np

from wlr_render.calibration.fit_report import AnyModel, ModelFit
from wlr_render.calibration.reading_sums import UndeterminedModelError
from wlr_render.calibration.readings import TREND_ALONE, FitReadings, Limits, Trend
from wlr_render.calibration.smooth_prior import Stage
from wlr_render.calibration.smooth_search import fit_within
from wlr_render.captures.correspondences import AnyCaptures, select
from wlr_render.errors import BadInputError
from wlr_render.geometry.planes import BasePlane
from wlr_render.mappings import EyeBox
from wlr_render.models.contraction import require_unique
from wlr_render.models.model_place import NOWHERE, ModelPlace, OwnPlace
from wlr_render.models.spread import Covariance
from wlr_render.numerics.arrays import FloatArray, IntArray
from wlr_render.numerics.polynomial import Box, Polynomial

_FLAT = 0.1  # largest thickness over extent of positions in a plane; thicker layers are spread in depth on purpose
_SPREAD = 0.1  # least ratio of extents across and along the best-fit line; below it, stage errors tilt the plane
_STEEPEST = np.tan(np.deg2rad(20.0))  # largest slope of the plane; headsets lean forward by up to about 15 degrees
_LEAST_RISE = 1e-3  # least rise over extent; no camera position shows 0.06 degrees
_SIGNIFICANT = 10.0  # F statistic of both slopes, which chance exceeds in one of 1,000 sessions of 25 positions


def choose_base_plane(viewpoint: FloatArray, eye_box: EyeBox) -> BasePlane:
    """Return the base plane with the best conditioning for captures.

    At camera positions in the plane, p~ is the position itself, without noise of a direction or of the solve. The plane
    is therefore the least-squares plane through coplanar positions: tilted if a tilt of up to 20 degrees is
    significant, else of constant z. For positions spread in depth, it is the plane of constant z through the centre of
    the eye box, which has the smallest contraction over the box, because contraction grows with distance from the
    plane.

    Args:
        viewpoint: (n, 3) positions, metres, device frame; repeated positions count once.
        eye_box: box of valid viewpoints.
    """
    position = np.unique(viewpoint, axis=0)
    mean = position[0] + (position - position[0]).mean(axis=0)  # exact where all coordinates are equal
    lateral, rise = (position - mean)[:, :2], (position - mean)[:, 2]
    along, across = (
        np.linalg.svd(lateral, compute_uv=False, full_matrices=True)[:2] if len(position) > 1 else (0.0, 0.0)
    )
    if len(position) > 2 and across > _SPREAD * along:
        slope = np.linalg.lstsq(lateral, rise, rcond=None)[0]
        risen = lateral @ slope
        thickness = np.sqrt(np.sum((rise - risen) ** 2) / max(len(position) - 3, 1))
        extent = across / np.sqrt(len(position))
        flat = thickness <= _FLAT * extent and np.hypot(*slope) <= _STEEPEST
        significant = np.sum(risen**2) > 2 * _SIGNIFICANT * thickness**2
        if flat and significant and np.std(risen) > _LEAST_RISE * extent:
            return BasePlane(float(mean[2] - slope @ mean[:2]), (float(slope[0]), float(slope[1])))
    if len(position) > 1 and np.linalg.norm(rise) <= _FLAT * along:
        return BasePlane(float(mean[2]))
    return BasePlane(float(eye_box.centre[2]))


@dataclass(frozen=True)
class ModelKind(Generic[AnyCaptures, AnyModel]):
    """Recipe for fitting one kind of model.

    Attributes:
        readings: (captures, place, limits, trend) -> readings.
        model: (captures, place, regressor, spread) -> model.
        place: place of the model's viewpoints; None for the base plane. `NOWHERE` means a fit at one camera position.
        needs_trend: True if the model has a trend. is_trend_alone: True if it has only the trend.
    """

    readings: Callable[..., FitReadings]
    model: Callable[[AnyCaptures, ModelPlace, Polynomial, Covariance | None], AnyModel]
    place: OwnPlace | None = None
    needs_trend: bool = False
    is_trend_alone: bool = False


def _with_orders(
    readings_within: Callable[..., FitReadings], orders: IntArray, captures: AnyCaptures, **given: Any
) -> FitReadings:
    """Return readings of captures with the terms chosen by a fit."""
    return replace(readings_within(captures, limits=TREND_ALONE, **given), orders=orders)


def nearest_to_centre(captures: AnyCaptures) -> AnyCaptures:
    """Return the captures of each target pose from the camera position nearest to the eye box's centre."""
    distance = np.linalg.norm(captures.viewpoint - captures.eye_box.centre, axis=1)
    poses = getattr(captures, "target_pose", np.zeros(len(captures)))
    chosen = np.zeros(len(captures), dtype=bool)
    for pose in np.unique(poses):
        rows = np.flatnonzero(poses == pose)
        chosen[rows] = captures.capture[rows] == captures.capture[rows[np.argmin(distance[rows])]]
    return select(captures, chosen)


@dataclass(frozen=True)
class Side(Generic[AnyCaptures, AnyModel]):
    """Recipes for one side of the headset, display or see-through.

    Attributes:
        name: "display" or "see-through".
        subject: input of the model besides the place, "pixel" or "direction".
        kinds: kinds by name, including "planar".
        limits: limits of the orders in the fit that finds which terms matter, and in all fits; see
            `smooth_search.fit_within`.
        check: function (captures, kind, place) that refuses captures before a fit.
        lacking: (captures, kind) -> end of an error message, with the data missing to determine a model.
    """

    name: str
    subject: str
    kinds: Mapping[str, ModelKind[AnyCaptures, AnyModel]]
    limits: tuple[Limits, ...]
    check: Callable[[AnyCaptures, str, ModelPlace], None]
    lacking: Callable[[AnyCaptures, str], str]

    def fit(
        self,
        captures: AnyCaptures,
        kind: str = "planar",
        degree: int | None = None,
        base_plane: BasePlane | None = None,
        trend: Trend | None = None,
        weights: FloatArray | None = None,
        stage: Stage | None = None,
    ) -> ModelFit[AnyModel]:
        """Fit a model to captures by maximum evidence.

        Args:
            captures: the readings.
            kind: "planar" (viewpoints are carried along measured rays to the base plane), "volumetric", "static" (uses
                only the camera position of each target pose nearest to the eye box's centre), for a display
                "point-per-pixel", or with a trend "grey-box" (planar, with the trend as prior mean) or "prescription"
                (the trend alone).
            degree: highest total degree; None for the terms within `limits` that matter.
            base_plane: base plane of a planar model; None for the plane of `choose_base_plane`.
            trend: prior mean on the base plane, for a grey box or prescription.
            weights: (n,) weights of the captures' readings, see `smooth_search.fit`.
            stage: stage errors estimated from other captures of the bench; None to estimate them.

        Raises:
            BadInputError: the kind is unknown, a point lies behind the base plane, captures determine nothing or
                contradict each other, or the model may have two solutions; the message names the remedy.
        """
        if kind not in self.kinds:
            choice = ", ".join(self.kinds)
            raise BadInputError(f"the kind of {self.name} model '{kind}' is unknown; choose one of {choice}.")
        how = self.kinds[kind]
        if how.needs_trend and trend is None:
            raise BadInputError(
                f"a {kind} {self.name} model needs the device's prescription; name it, or fit a planar model."
            )
        used = nearest_to_centre(captures) if how.place is NOWHERE else captures
        self._require_at_eye_box(used)
        place = how.place or base_plane or choose_base_plane(used.viewpoint, used.eye_box)
        self.check(used, kind, place)
        limits = self.limits if degree is None else (Limits(degree, degree, degree),)
        if how.is_trend_alone:
            limits = (TREND_ALONE,)
        readings_within = partial(how.readings, place=place, trend=trend if how.needs_trend else None)
        try:
            smooth = fit_within(lambda limits: readings_within(used, limits=limits), limits, weights, stage)
        except UndeterminedModelError as error:
            raise self.undetermined(kind, self.lacking(used, kind)) from error
        except np.linalg.LinAlgError as error:
            raise BadInputError(
                f"the {self.name} captures of {captures.device} do not determine a {kind} model to the digits of the "
                "machine: there are too few camera positions, or the motions between them explain all that they see; "
                "add camera positions."
            ) from error
        if degree is None:  # a stated degree may be the cause of a contradiction
            smooth.require_agreement(f"the {self.name} captures of {captures.device}", used.sigma_arcmin)
        readings_of = partial(_with_orders, readings_within, smooth.readings.orders)
        mapping = how.model(used, place, smooth.polynomial, smooth.spread)
        contraction = require_unique(mapping.contraction(), kind, self.name)
        orders = smooth.readings.limits.words(self.subject, bool(smooth.readings.is_place.any()))
        return ModelFit(kind, mapping, used, smooth, readings_of, orders, contraction)

    def with_trend(self, fitted: ModelFit[AnyModel], plane: BasePlane, trend: Trend) -> ModelFit[AnyModel]:
        """Return the fit with another prior of the trend's parameters; see `SmoothFit.with_trend`."""
        smooth = fitted.smooth.with_trend(trend)
        captures: Any = fitted.captures  # AnyCaptures of this side
        mapping = self.kinds[fitted.kind].model(captures, plane, smooth.polynomial, smooth.spread)
        return replace(fitted, mapping=mapping, smooth=smooth, readings_of=partial(fitted.readings_of, trend=trend))

    def _require_at_eye_box(self, captures: AnyCaptures) -> None:
        """Refuse captures that were not taken near the eye box.

        Raises:
            BadInputError: along an axis, all camera positions are farther outside than the eye box's largest side.
        """
        box = captures.eye_box
        low, high = captures.viewpoint.min(axis=0), captures.viewpoint.max(axis=0)
        reach = 0.5 * box.size + box.size.max()
        if np.all((low <= box.centre + reach) & (high >= box.centre - reach)):
            return
        taken, wanted = (
            ", ".join(f"{axis} {1e3 * a:.0f} to {1e3 * b:.0f}" for axis, a, b in zip("xyz", *ends, strict=True))
            for ends in ((low, high), (box.centre - 0.5 * box.size, box.centre + 0.5 * box.size))
        )
        raise BadInputError(
            f"the {self.name} captures of {captures.device} were taken at {taken} mm, far from the eye box at {wanted} "
            "mm: check order, sign, unit (metres) and frame of the viewpoints, or the eye box."
        )

    def undetermined(self, kind: str, lacking: str) -> BadInputError:
        """Return the error for captures that do not determine a model of a kind."""
        return BadInputError(f"the captures do not determine a {kind} {self.name} model: {lacking}.")

    def planar_box(self, captures: AnyCaptures, plane: BasePlane) -> Box:
        """Return the box of a planar fit's inputs, for which its trend is compiled."""
        return self.kinds["planar"].readings(captures, plane, TREND_ALONE, None).box
