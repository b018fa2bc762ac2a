"""Covariance of the registration error: the view direction of a pixel minus the view direction of its real point.

All errors are small, so that their effects are linear. Derivatives by viewpoint, real point and pixel are central
differences of the mappings, traced or fitted. When a tracker reports the viewpoint v + d instead of v, the renderer
chooses the pixel that covers the point from v + d; from v, the directions of pixel and point then differ by the
difference of their derivatives times -d. An error of the head pose moves the point in the device frame.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import partial

import numpy as np

from wlr_render.budget.error_sizes import ErrorSizes, variances
from wlr_render.error_sources import ErrorSource
from wlr_render.errors import BadInputError
from wlr_render.geometry import rays, transforms
from wlr_render.geometry.directions import ARCMIN
from wlr_render.mappings import Eye, QueryResult
from wlr_render.models.fitted_model import FittedDisplay, FittedModel, FittedSeeThrough
from wlr_render.models.registration import model_registration_covariance, right_and_up
from wlr_render.numerics.arrays import BoolArray, FloatArray
from wlr_render.tracking.eye_model import entrance_pupil_shift

MODEL, EYE, HEAD, DRAWING = "model", "eye tracker", "head tracker", "drawing"
"""Owners of error sources; the name of a source is "OWNER: DETAIL"."""
TRACKING_CAMERA = f"{MODEL}: {ErrorSource.TRACKING_CAMERA}"
"""Error source of models fitted to photographs: the stated pose of the headset's camera, the frame of all readings."""

_STEP_M = 20e-6  # step of a viewpoint: models curve over millimetres, and solves converge to 1e-12
_STEP_RAD = 1e-4  # step of a real point, as an angle at the viewpoint
_STEP_PX = 0.05  # step of a pixel
_STRAIGHT_AHEAD = np.array([0.0, 0.0, -1.0])


@dataclass(frozen=True, eq=False)
class RegistrationCovariance:
    """Covariance of the registration error by source.

    Attributes:
        by_source: "OWNER: DETAIL" -> (..., 2, 2) square arcminutes, along the axes right and up perpendicular to the
            view direction; NaN where the eye does not see the pixel or the point.
        view_dir: (..., 3) view direction of the pixel.
        point: (..., 3) real point that the pixel covers, device frame, metres.
        is_inside: (...) True where both mappings are inside their fitted range.
    """

    by_source: dict[str, FloatArray]
    view_dir: FloatArray
    point: FloatArray
    is_inside: BoolArray

    @property
    def total(self) -> FloatArray:
        """Sum over all sources, (..., 2, 2) square arcminutes."""
        return np.asarray(sum(self.by_source.values()))

    def in_camera_frame(self) -> "RegistrationCovariance":
        """Return the covariance for trackers that measure in the frame of the tracking camera, with its stated pose.

        An error of the stated pose then moves display, world, eye and trackers together and causes no registration
        error.
        """
        kept = {name: covariance for name, covariance in self.by_source.items() if name != TRACKING_CAMERA}
        return replace(self, by_source=kept)


def registration_covariance(
    eye: Eye, pixel: FloatArray, viewpoint: FloatArray, depth_m: float | FloatArray, sizes: ErrorSizes
) -> RegistrationCovariance:
    """Return the covariance of the registration error of pixels, by source.

    Args:
        eye: display and see-through mappings; the model error of exact mappings is zero.
        pixel: (..., 2) panel pixels. viewpoint: (..., 3) device frame, metres. Both broadcast.
        depth_m: (...) depth of the real points in front of the viewpoints, along the device's z axis.
        sizes: sizes of the errors, except model errors.

    Raises:
        BadInputError: a fitted model has no covariance.
    """
    lead = np.broadcast_shapes(np.shape(pixel)[:-1], np.shape(viewpoint)[:-1], np.shape(depth_m))
    pixel, viewpoint = np.broadcast_to(pixel, (*lead, 2)), np.broadcast_to(viewpoint, (*lead, 3))
    shown, seen, point = _covered(eye, pixel, viewpoint, depth_m)
    by_source = _Sensitivity(eye, pixel, viewpoint, point, shown.value).covariances(sizes)
    return RegistrationCovariance(by_source, shown.value, point, shown.ok & seen.ok)


def _covered(
    eye: Eye, pixel: FloatArray, viewpoint: FloatArray, depth_m: float | FloatArray
) -> tuple[QueryResult, QueryResult, FloatArray]:
    shown = eye.display.view_dir_of_pixel(pixel, viewpoint)
    seen = eye.see_through.real_ray_of_view_dir(shown.value, viewpoint)
    return shown, seen, rays.split(rays.at_z(seen.value, viewpoint[..., 2] - depth_m))[0]


def disparity_covariance(
    eyes: Sequence[Eye], point: FloatArray, viewpoints: Sequence[FloatArray], sizes: Sequence[ErrorSizes]
) -> dict[str, FloatArray]:
    """Return the covariance of the disparity error by source: right registration error minus left registration error.

    The models of the two eyes are independent, and so are the noise and bias of their eye trackers. Errors of the head
    pose are common to both eyes and cancel except where the optics of the eyes differ. Eyes turn together, so that
    latency is common, too, and so is corneal refraction. An error of the tracking camera's stated pose moves both eyes
    together and is omitted.

    Args:
        eyes: left and right eye.
        point: (..., 3) real points, device frame, metres.
        viewpoints: (..., 3) viewpoints of both eyes.
        sizes: sizes of the errors of both eyes, which share their trackers.

    Returns:
        Source -> (..., 2, 2) square arcminutes: horizontal, then vertical disparity; NaN where an eye does not see the
        point through its display.

    Raises:
        BadInputError: a fitted model has no covariance.
    """
    both = []
    for eye, viewpoint in zip(eyes, viewpoints, strict=True):
        lead = np.broadcast_shapes(np.shape(point)[:-1], np.shape(viewpoint)[:-1])
        at, seen_from = np.broadcast_to(point, (*lead, 3)), np.broadcast_to(viewpoint, (*lead, 3))
        seen = eye.see_through.view_dir_of_real_point(at, seen_from)
        pixel = eye.display.pixel_of_view_dir(seen.value, seen_from)
        both.append(_Sensitivity(eye, pixel.value, seen_from, at, seen.value))
    left, right = both
    independent = [sensitivity.covariances(of_eye) for sensitivity, of_eye in zip(both, sizes, strict=True)]
    of_left = left.common_motions(sizes[0])
    common = {
        name: _spread(by - of_left[name][0], variance)
        for name, (by, variance) in right.common_motions(sizes[1]).items()
    }
    names = dict.fromkeys(name for by_source in independent for name in by_source if name != TRACKING_CAMERA)
    summed = {
        name: np.asarray(sum(by_source[name] for by_source in independent if name in by_source)) for name in names
    }
    return summed | common


def has_covariance(eye: Eye) -> bool:
    """Return whether both mappings of an eye are fitted models with a covariance."""
    both = eye.display, eye.see_through
    return all(isinstance(each, FittedModel) and each.spread is not None for each in both)


class _Sensitivity:
    """Derivatives of the registration error of pixels (..., 2) and points (..., 3) in directions (..., 3)."""

    def __init__(
        self, eye: Eye, pixel: FloatArray, viewpoint: FloatArray, point: FloatArray, view_dir: FloatArray
    ) -> None:
        self.eye, self.pixel, self.viewpoint, self.point = eye, pixel, viewpoint, point
        axes = right_and_up(view_dir) / ARCMIN
        display, see_through = eye.display, eye.see_through

        def shown(pixel: FloatArray, viewpoint: FloatArray) -> QueryResult:
            return display.view_dir_of_pixel(pixel, viewpoint)

        def seen(point: FloatArray, viewpoint: FloatArray) -> QueryResult:
            return see_through.view_dir_of_real_point(point, viewpoint)

        distance = np.linalg.norm(point - viewpoint, axis=-1)
        of_viewpoint = partial(_derivative, argument=viewpoint, step=_STEP_M)
        by_point = axes @ _derivative(lambda at: seen(at, viewpoint), point, _STEP_RAD * distance)
        self.by_viewpoint = axes @ (of_viewpoint(partial(shown, pixel)) - of_viewpoint(partial(seen, point)))
        self.by_motion = np.concatenate([by_point @ -transforms.cross_matrix(point), by_point], axis=-1)
        self.by_pixel = axes @ _derivative(lambda at: shown(at, viewpoint), pixel, _STEP_PX)
        self.by_cornea = self.by_viewpoint @ entrance_pupil_shift(_STRAIGHT_AHEAD, view_dir)[..., None]

    def covariances(self, sizes: ErrorSizes) -> dict[str, FloatArray]:
        """Return the covariances (..., 2, 2) by source, square arcminutes."""
        eye, drawing, truncation = sizes.eye, sizes.drawing, sizes.truncation
        each_axis = np.eye(2) + 0.0 * self.by_viewpoint[..., :1]  # NaN where the eye sees nothing
        moved = {name: _spread(by, variance) for name, (by, variance) in self.common_motions(sizes).items()}
        drawn = 0.5 * (drawing.warp_grid_arcmin**2 + drawing.raster_arcmin**2)
        rounding = np.full(2, drawing.is_rounded / 12.0)
        return {
            **{f"{MODEL}: {name}": each for name, each in self._model().items()},
            f"{MODEL}: {ErrorSource.TRUNCATION}": (truncation.display_arcmin**2 + truncation.see_through_arcmin**2)
            * each_axis,
            f"{EYE}: noise": _spread(self.by_viewpoint, variances(eye.noise_m)),
            f"{EYE}: bias": _spread(self.by_viewpoint, variances(eye.bias_m)),
            **moved,
            f"{DRAWING}: raster and warp grid": drawn * each_axis,
            f"{DRAWING}: whole pixels": _spread(self.by_pixel, rounding),
        }

    def common_motions(self, sizes: ErrorSizes) -> dict[str, tuple[FloatArray, FloatArray]]:
        """Return derivatives (..., 2, k) and variances (k,) of the errors common to both eyes, by source."""
        eye, head = sizes.eye, sizes.head
        return {
            f"{EYE}: latency": (self.by_viewpoint, eye.latency_s**2 * variances(eye.speed_m_s)),
            f"{HEAD}: noise": (self.by_motion, variances(head.rotation_rad, head.position_m)),
            f"{HEAD}: latency": (
                self.by_motion,
                head.latency_s**2 * variances(head.angular_speed_rad_s, head.speed_m_s),
            ),
            f"{DRAWING}: corneal refraction": (self.by_cornea, np.full(1, float(sizes.drawing.has_one_viewpoint))),
        }

    def _model(self) -> dict[str, FloatArray]:
        display, see_through = self.eye.display, self.eye.see_through
        if isinstance(display, FittedDisplay) and isinstance(see_through, FittedSeeThrough):
            if not has_covariance(self.eye):
                raise BadInputError(
                    f"{self.eye.name}: the model of the {self.eye.eye} eye has no covariance, which files of earlier "
                    "versions and the kinds 'static' and 'point-per-pixel' lack; calibrate again as a planar model, "
                    "from the photographs or captures that it was made from (`wlr-render calibrate PATH`)."
                )
            return model_registration_covariance(display, see_through, self.pixel, self.viewpoint, self.point)
        if isinstance(display, FittedModel) or isinstance(see_through, FittedModel):
            raise BadInputError(f"{self.eye.name}: a budget needs display and see-through; calibrate both.")
        return {}


def _derivative(
    query: Callable[[FloatArray], QueryResult], argument: FloatArray, step: float | FloatArray
) -> FloatArray:
    """Return the derivative (..., 3, k) of directions by an argument (..., k), from central differences of `step`."""
    count = argument.shape[-1]
    offset = np.asarray(step)[..., None] * np.concatenate([np.eye(count), -np.eye(count)]).reshape(
        2 * count, *(1,) * (argument.ndim - 1), count
    )
    plus, minus = np.split(query(argument + offset).value, 2)
    return np.asarray(np.moveaxis(plus - minus, 0, -1) / (2.0 * np.asarray(step)[..., None, None]))


def _spread(by: FloatArray, variance: FloatArray) -> FloatArray:
    """Return the covariance (..., 2, 2) from derivatives (..., 2, k) by independent variables with variances (k,)."""
    return np.asarray((by * variance) @ np.swapaxes(by, -1, -2))
