"""Detection of motion during a sweep, of the target, the headset, or the camera or its stage.

The headset's tracking camera sees the target before and after the sweep; the eyeball camera sees it through the optics
twice at one stage reading. Both cameras see motion of the target. Only the tracking camera sees a shift of the headset
(the optics hardly change the apparent position of the target), and only the eyeball camera sees its own motion, or its
stage's.
"""

from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from functools import partial

import numpy as np

from wlr_render.calibration.bench.adjustment import Adjustment
from wlr_render.calibration.bench.bench_checks import REFUSED_ARCMIN, REFUSED_MM, Check, significance
from wlr_render.calibration.bench.board_views import APART, BoardView
from wlr_render.calibration.bench.faults import NEGLIGIBLE_M, NEGLIGIBLE_RAD, Fault
from wlr_render.calibration.poses import motion_between
from wlr_render.geometry import transforms
from wlr_render.geometry.directions import ARCMIN
from wlr_render.lenses.lens import Lens, radians_per_pixel
from wlr_render.numerics.arrays import FloatArray

NEGLIGIBLE_ARCMIN = NEGLIGIBLE_RAD / ARCMIN
_CERTAIN = 3.0  # sigmas by which a significant displacement exceeds the negligible one; chance does it once in 700
_FOLLOWS = 0.5  # least ratio of observed to predicted displacement of a view that follows the target's motion


@dataclass(frozen=True, eq=False)
class RepeatedView:
    """Two photographs of the target through the optics, at one stage reading of one sweep.

    Attributes:
        target: number of the target pose.
        device_from_camera: (4, 4) pose of the eyeball camera.
        first, last: dots of the two photographs, of which the common ones are compared.
        last_from_first: (3, 3) known rotation of the camera between the two photographs, due to warm-up.
        motion: (6, 6) covariance of the camera's motion between the photographs in addition to `last_from_first`,
            camera frame: rotation (rad), translation (m).
        device_from_target: (4, 4) pose of the board; its distance converts the motion to arcminutes.
    """

    target: int
    device_from_camera: FloatArray
    first: BoardView
    last: BoardView
    last_from_first: FloatArray = field(default_factory=partial(np.eye, 3))
    motion: FloatArray = field(default_factory=partial(np.zeros, (6, 6)))
    device_from_target: FloatArray = field(default_factory=partial(np.eye, 4))


@dataclass(frozen=True, eq=False)
class TargetChange:
    """Motion of the target during a sweep, observed by the tracking camera.

    Attributes:
        names: names of the photographs before and after.
        before, after: device_from_target (4, 4), equal if nothing moved.
        shift_mm: shift of the target's middle. turn_arcmin: rotation of the target.
        sigmas: joint significance of both, in sigmas of a normal variable.
    """

    names: tuple[str, str]
    before: FloatArray
    after: FloatArray
    shift_mm: float = 0.0
    turn_arcmin: float = 0.0
    sigmas: float = 0.0

    @classmethod
    def of(cls, adjustment: Adjustment, target: int, fault: Fault | None, names: Sequence[str]) -> "TargetChange":
        """Return the change at a target pose from a fault of the adjustment; no change without a fault."""
        before = adjustment.state.targets[target]
        moved = [k for k in adjustment.state.targets if k % APART == target and k >= APART]
        if fault is None or not moved:
            return cls((names[0], names[-1]), before, before)
        after = adjustment.state.targets[moved[-1]]
        motion = motion_between(np.eye(4), transforms.inverse(before) @ after)
        both = adjustment.covariance_of([("target", target), ("target", moved[-1])])
        apart = np.concatenate([-np.eye(6), np.eye(6)], axis=1)
        chi_square = float(motion @ np.linalg.solve(apart @ both @ apart.T, motion))
        return cls(
            (fault.names[0], fault.names[1]),
            before,
            after,
            1e3 * float(np.linalg.norm(motion[3:])),
            float(np.linalg.norm(motion[:3])) / ARCMIN,
            significance(chi_square, 6),
        )

    @property
    def is_significant(self) -> bool:
        """True if the target moved."""
        return self.sigmas > 0.0

    def __str__(self) -> str:
        return f"{self.shift_mm:.3g} mm and {self.turn_arcmin:.2g}' ({self.sigmas:.0f} sigma)"

    def check(self, step: str, sentence: str) -> Check:
        """Return the check of this change."""
        turned = self.turn_arcmin * ARCMIN / NEGLIGIBLE_RAD > 1e-3 * self.shift_mm / NEGLIGIBLE_M
        value, limit = (self.turn_arcmin, NEGLIGIBLE_ARCMIN) if turned else (self.shift_mm, 1e3 * NEGLIGIBLE_M)
        large = self.shift_mm > REFUSED_MM or self.turn_arcmin > REFUSED_ARCMIN
        return Check(
            step,
            "turn, arcmin" if turned else "shift, mm",
            value,
            value / max(self.sigmas, 1e-9) if self.is_significant else 0.0,
            limit,
            sentence,
            not self.is_significant,
            self.is_significant and large,
        )


@dataclass(frozen=True, eq=False)
class _ViewChange:
    """Displacement of dots during a sweep, observed by the eyeball camera.

    Attributes:
        names: names of the two photographs.
        arcmin: rms displacement of the best-fit affine motion of the dots, minus the contribution of noise.
        sigma_arcmin: standard deviation of `arcmin`, from noise and the expected motion of the stage.
        is_significant: True if the displacement is significantly more than negligible.
        foreseen_arcmin: rms displacement predicted from the target's motion, as observed by the tracking camera.
        follows: fraction of this motion in the measured displacement, 1 for all of it.
    """

    names: tuple[str, str]
    arcmin: float
    sigma_arcmin: float
    is_significant: bool
    foreseen_arcmin: float = 0.0
    follows: float = 0.0


def sweep_check(
    target: int,
    tracked: TargetChange | None,
    repeated: Sequence[RepeatedView],
    camera: Lens,
) -> Check | None:
    """Return the check of motion during the sweep at one target pose; None if nothing was photographed twice.

    Args:
        target: number of the target pose.
        tracked: change of the target observed by the tracking camera; None if not observed.
        repeated: all photographs through the optics that were repeated in this sweep.
        camera: the eyeball camera.
    """
    views = [_view_change(view, tracked, camera) for view in repeated]
    step = f"sweep at target pose {target}"
    # Take the largest of the significant displacements, or of all, because a large displacement may be noise.
    largest = max(views, key=lambda view: (view.is_significant, view.arcmin), default=None)
    if tracked is not None and tracked.is_significant:
        moved = f"{_culprit(views)} between {tracked.names[0]} and {tracked.names[1]}, by {tracked}"
        return tracked.check(step, f"{moved}; repeat this sweep with its tracking photographs")
    if largest is None:
        return None if tracked is None else tracked.check(step, "the tracking camera sees the target where it was")
    culprit = "the camera or its stage" if tracked else "the target, the camera or its stage"
    limit = f"{NEGLIGIBLE_ARCMIN:.1g}'"
    still = (
        f"no motion of more than {limit} is certain"
        if largest.arcmin > NEGLIGIBLE_ARCMIN
        else f"nothing moved by more than {limit}"
    )
    sentence = (
        f"{culprit} moved between {largest.names[0]} and {largest.names[1]}: features are displaced by "
        f"{largest.arcmin:.2g}' at one stage reading; repeat this sweep"
    )
    return Check(
        step,
        "displacement of features at one stage reading, arcmin",
        largest.arcmin,
        largest.sigma_arcmin,
        NEGLIGIBLE_ARCMIN,
        sentence if largest.is_significant else still,
        ok=not largest.is_significant,
        contradictory=largest.is_significant and largest.arcmin > REFUSED_ARCMIN,
    )


def _culprit(views: Sequence[_ViewChange]) -> str:
    """Return the name of the moved part, given that the tracking camera saw the target move."""
    follows = [view.follows for view in views if view.foreseen_arcmin > NEGLIGIBLE_ARCMIN]
    if not follows:
        return "the target moved or the headset shifted (no photograph through the optics, repeated, tells which)"
    return "the target moved" if np.median(follows) > _FOLLOWS else "the headset shifted"


def _view_change(
    view: RepeatedView,
    tracked: TargetChange | None,
    camera: Lens,
) -> _ViewChange:
    point, displaced, sigma_px, per_px = _common(view, camera)
    size, noise = _affine_part(point, displaced * per_px, sigma_px * per_px)
    sigma = float(np.hypot(noise, _expected_arcmin(view, point)))
    # A displacement beyond the refusal limit is significant even if the stage's estimated repeatability is poor.
    certain = size > min(NEGLIGIBLE_ARCMIN + _CERTAIN * sigma, REFUSED_ARCMIN + _CERTAIN * noise)
    change = _ViewChange((view.first.name, view.last.name), size, sigma, certain)
    if tracked is None or len(point) == 0:
        return change
    camera_from_device = transforms.inverse(view.device_from_camera)
    before, after = (
        camera.pixel_of_point(transforms.apply(camera_from_device @ pose, point))
        for pose in (tracked.before, tracked.after)
    )
    foreseen = np.nan_to_num(after - before)
    power = float(np.sum(foreseen**2))
    return replace(
        change,
        foreseen_arcmin=float(np.sqrt(np.mean(np.sum((foreseen * per_px) ** 2, axis=1)))),
        follows=float(np.sum(foreseen * displaced)) / power if power > 0 else 0.0,
    )


def _expected_arcmin(view: RepeatedView, point: FloatArray) -> float:
    """Return the rms displacement of points (n, 3) on the board, arcminutes, by expected motions of the camera."""
    if len(point) == 0 or not view.motion.any():
        return 0.0
    seen = transforms.apply(transforms.inverse(view.device_from_camera) @ view.device_from_target, point)
    distance = np.linalg.norm(seen, axis=1, keepdims=True)
    moved = np.concatenate([transforms.cross_matrix(seen), -np.broadcast_to(np.eye(3), (len(seen), 3, 3))], axis=2)
    sight = seen / distance
    across = moved - sight[:, :, None] * np.einsum("nk,nkm->nm", sight, moved)[:, None]
    square = np.einsum("nkm,ml,nkl->n", across, view.motion, across) / distance[:, 0] ** 2
    return float(np.sqrt(max(np.mean(square), 0.0))) / ARCMIN


def _common(view: RepeatedView, camera: Lens) -> tuple[FloatArray, FloatArray, FloatArray, FloatArray]:
    """Compare the dots that both photographs show.

    Returns:
        Points (n, 3) of the dots, displacements (n, 2) in pixels, sigmas (n, 1) of the displacements per axis, and
        arcminutes per pixel (n, 1) at the dots.
    """
    number = {tuple(feature): i for i, feature in enumerate(view.last.feature.tolist())}
    pairs = [(i, number[key]) for i, each in enumerate(view.first.feature.tolist()) if (key := tuple(each)) in number]
    first, last = np.array(pairs, dtype=np.int64).reshape(-1, 2).T
    sigma_px = np.hypot(view.first.sigma_px[first], view.last.sigma_px[last])
    direction = camera.dir_of_pixel(view.first.pixel[first])
    angle = radians_per_pixel(camera, direction) / ARCMIN
    displaced = view.last.pixel[last] - camera.pixel_of_point(direction @ view.last_from_first.T)
    known = np.isfinite(angle)
    return view.first.point[first][known], displaced[known], sigma_px[known, None], angle[known, None]


def _affine_part(point: FloatArray, displaced: FloatArray, sigma: FloatArray) -> tuple[float, float]:
    """Return the rms of the best affine fit to displacements (n, 2) of points (n, 3), without noise, and its sigma.

    A rigid motion of the target moves the dots by nearly an affine map, in which the noise of many dots averages out.
    """
    if len(point) == 0:
        return 0.0, 0.0
    design = np.column_stack([np.ones(len(point)), point[:, :2]])
    axes = np.linalg.qr(design / sigma)[0]  # orthonormal, so that a coefficient has unit noise
    found = axes.T @ (displaced / sigma)
    square = np.mean(np.sum((axes @ found * sigma) ** 2, axis=1))
    noise = np.mean(np.sum((axes * sigma) ** 2, axis=1)) / axes.shape[1]  # mean square change by each coefficient
    return float(np.sqrt(max(square - found.size * noise, 0.0))), float(np.sqrt(noise))
