"""Covariance of registration: the direction in which a pixel is shown less that in which its real point is seen.

All errors are small: their effect is linear. Derivatives by viewpoint, real point and pixel are central differences of
the mappings, whatever their kind. A tracker that reports the viewpoint v + d makes the renderer choose the pixel that
covers the point as seen from v + d; seen from v, pixel and point are then apart by the difference of both directions'
derivatives times -d. An error of the head's pose moves the point in the device frame, where the renderer looks for it.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import partial

import numpy as np

from wlr_render.budget.error_sizes import ErrorSizes, variances
from wlr_render.errors import BadInputError
from wlr_render.geometry import rays, transforms
from wlr_render.geometry.directions import ARCMIN
from wlr_render.mappings import Eye, QueryResult
from wlr_render.models.fitted_model import FittedDisplay, FittedModel, FittedSeeThrough
from wlr_render.models.registration import model_registration_covariance, right_and_up
from wlr_render.numerics.arrays import BoolArray, FloatArray

MODEL, EYE, HEAD, DRAWING = "model", "eye tracker", "head tracker", "drawing"
"""Owners of the sources; a source is "OWNER: what"."""
TRACKING_CAMERA = f"{MODEL}: tracking camera"
"""Source of models from photographs: the stated pose of the headset's camera, in whose frame all was measured."""

_STEP_M = 20e-6  # of a viewpoint: models bend over millimetres, solves end at 1e-12
_STEP_RAD = 1e-4  # of a real point, as seen from the viewpoint
_STEP_PX = 0.05


@dataclass(frozen=True, eq=False)
class RegistrationCovariance:
    """Covariance of registration by source.

    Attributes:
        by_source: "OWNER: what" -> (..., 2, 2) square arcminutes, along the axes right and up, perpendicular to the
            view direction; NaN where the eye does not see pixel or point.
        view_dir: (..., 3) direction in which the pixel is shown.
        point: (..., 3) real point that it covers, device frame, metres.
        is_inside: (...) whether both mappings answer inside of what they were fitted to.
    """

    by_source: dict[str, FloatArray]
    view_dir: FloatArray
    point: FloatArray
    is_inside: BoolArray

    @property
    def total(self) -> FloatArray:
        """Sum over all sources, (..., 2, 2)."""
        return np.asarray(sum(self.by_source.values()))

    def in_camera_frame(self) -> "RegistrationCovariance":
        """Covariance where the trackers measure by the tracking camera, with its stated pose.

        An error of that pose then moves display, world, eye and trackers alike, and is none of registration.
        """
        kept = {name: each for name, each in self.by_source.items() if name != TRACKING_CAMERA}
        return replace(self, by_source=kept)


def registration_covariance(
    eye: Eye, pixel: FloatArray, viewpoint: FloatArray, depth_m: float | FloatArray, sizes: ErrorSizes
) -> RegistrationCovariance:
    """Covariance of registration of pixels, by source.

    Args:
        eye: both mappings; exact ones have no errors of their own.
        pixel: (..., 2) panel pixels. viewpoint: (..., 3) device frame, metres. Both broadcast.
        depth_m: (...) of the real points in front of the viewpoints, along the device's z axis.
        sizes: of all errors but those of the models.

    Raises:
        BadInputError: a fitted model without covariance.
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
    """Covariance of both eyes' disparity: registration of the right eye less that of the left, by source.

    The models of both eyes are independent, and so are noise and bias of their eye trackers. Errors of the head's
    pose are common to both eyes, and cancel but for what the eyes see differently. Eyes turn together: latency is
    common, too. An error of the tracking camera's stated pose moves both eyes alike, and is left out.

    Args:
        eyes: left and right.
        point: (..., 3) real points, device frame, metres.
        viewpoints: (..., 3) of both eyes.
        sizes: of the errors of both eyes, which have the same trackers.

    Returns:
        Source -> (..., 2, 2) square arcminutes: horizontal, then vertical disparity; NaN where an eye does not see the
        point through its display.

    Raises:
        BadInputError: a fitted model without covariance.
    """
    both = []
    for eye, viewpoint in zip(eyes, viewpoints, strict=True):
        lead = np.broadcast_shapes(np.shape(point)[:-1], np.shape(viewpoint)[:-1])
        at, seen_from = np.broadcast_to(point, (*lead, 3)), np.broadcast_to(viewpoint, (*lead, 3))
        seen = eye.see_through.view_dir_of_real_point(at, seen_from)
        pixel = eye.display.pixel_of_view_dir(seen.value, seen_from)
        both.append(_Sensitivity(eye, pixel.value, seen_from, at, seen.value))
    left, right = both
    apart = [each.covariances(of_eye) for each, of_eye in zip(both, sizes, strict=True)]
    of_left = left.common_motions(sizes[0])
    common = {
        name: _spread(by - of_left[name][0], variance)
        for name, (by, variance) in right.common_motions(sizes[1]).items()
    }
    names = dict.fromkeys(name for each in apart for name in each if name != TRACKING_CAMERA)
    summed = {name: np.asarray(sum(each[name] for each in apart if name in each)) for name in names}
    return summed | common


class _Sensitivity:
    """How registration of pixels (..., 2) with points (..., 3), seen along (..., 3), follows every error."""

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

    def covariances(self, sizes: ErrorSizes) -> dict[str, FloatArray]:
        """(..., 2, 2) by source."""
        eye, drawing, truncation = sizes.eye, sizes.drawing, sizes.truncation
        each_axis = np.eye(2) + 0.0 * self.by_viewpoint[..., :1]  # NaN where nothing is seen
        moved = {name: _spread(by, variance) for name, (by, variance) in self.common_motions(sizes).items()}
        drawn = 0.5 * (drawing.warp_grid_arcmin**2 + drawing.raster_arcmin**2)
        rounding = np.full(2, drawing.is_rounded / 12.0)
        return {
            **{f"{MODEL}: {name}": each for name, each in self._model().items()},
            f"{MODEL}: truncation": (truncation.display_arcmin**2 + truncation.see_through_arcmin**2) * each_axis,
            f"{EYE}: noise": _spread(self.by_viewpoint, variances(eye.noise_m)),
            f"{EYE}: bias": _spread(self.by_viewpoint, variances(eye.bias_m)),
            **moved,
            f"{DRAWING}: raster and warp grid": drawn * each_axis,
            f"{DRAWING}: whole pixels": _spread(self.by_pixel, rounding),
        }

    def common_motions(self, sizes: ErrorSizes) -> dict[str, tuple[FloatArray, FloatArray]]:
        """Derivatives (..., 2, k) by what moves both eyes alike, and its variances (k,), by source."""
        eye, head = sizes.eye, sizes.head
        return {
            f"{EYE}: latency": (self.by_viewpoint, eye.latency_s**2 * variances(eye.speed_m_s)),
            f"{HEAD}: noise": (self.by_motion, variances(head.rotation_rad, head.position_m)),
            f"{HEAD}: latency": (
                self.by_motion,
                head.latency_s**2 * variances(head.angular_speed_rad_s, head.speed_m_s),
            ),
        }

    def _model(self) -> dict[str, FloatArray]:
        display, see_through = self.eye.display, self.eye.see_through
        if isinstance(display, FittedDisplay) and isinstance(see_through, FittedSeeThrough):
            if display.spread is None or see_through.spread is None:
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
    """Derivative (..., 3, k) of directions by an argument (..., k), by central differences of `step` (...)."""
    count = argument.shape[-1]
    offset = np.asarray(step)[..., None] * np.concatenate([np.eye(count), -np.eye(count)]).reshape(
        2 * count, *(1,) * (argument.ndim - 1), count
    )
    plus, minus = np.split(query(argument + offset).value, 2)
    return np.asarray(np.moveaxis(plus - minus, 0, -1) / (2.0 * np.asarray(step)[..., None, None]))


def _spread(by: FloatArray, variance: FloatArray) -> FloatArray:
    """Covariance (..., 2, 2) by independent variables (k,) through derivatives (..., 2, k)."""
    return np.asarray((by * variance) @ np.swapaxes(by, -1, -2))
