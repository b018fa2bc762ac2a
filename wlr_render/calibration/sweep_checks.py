"""Detect motion during a sweep: of the target, the headset, or the camera or its stage.

The headset's tracking camera sees the target before and after the sweep; the eyeball camera sees it through the optics
twice at one stage reading. A target that moves is seen to move by both, a headset that shifts by its own camera alone
(the optics hardly change where the target is seen), and a camera or stage that moves by the eyeball camera alone.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np

from wlr_render.calibration.board_poses import BoardView
from wlr_render.calibration.check import NEGLIGIBLE_ARCMIN, REFUSED_ARCMIN, Change, Check
from wlr_render.geometry import transforms
from wlr_render.geometry.directions import ARCMIN
from wlr_render.geometry.lens_camera import LensCamera
from wlr_render.numerics.arrays import FloatArray

_RAYLEIGH = 1.1774  # median distance from the origin of a point that scatters by 1 along both axes
_NOISY = 2.0  # a median distance this many times what noise makes is a change
_FOLLOWS = 0.5  # a view that moves by more than this part of what the target's motion would make has followed it


@dataclass(frozen=True, eq=False)
class RepeatedView:
    """Two photographs of the target through the optics, at one stage reading of one sweep.

    Attributes:
        target: number of the target pose.
        reading: (3,) of the stage.
        first, last: dots of the two; those that are in both are compared.
    """

    target: int
    reading: FloatArray
    first: BoardView
    last: BoardView


@dataclass(frozen=True, eq=False)
class TargetChange:
    """Motion of the target during a sweep, seen by the tracking camera.

    Attributes:
        names: of the photographs before and after.
        before, after: device_from_target (4, 4).
        change: between them, at the target's middle.
    """

    names: tuple[str, str]
    before: FloatArray
    after: FloatArray
    change: Change


@dataclass(frozen=True, eq=False)
class _ViewChange:
    """Displacement of dots during a sweep, seen by the eyeball camera.

    Attributes:
        names: of the two photographs.
        median_arcmin: median distance beyond noise.
        sigma_arcmin: its standard deviation.
        is_significant: whether it is more than noise and more than can be neglected.
        foreseen_arcmin: rms that the target's motion by the tracking camera would have made.
        follows: how much of that motion is in what is seen, 1 if all.
    """

    names: tuple[str, str]
    median_arcmin: float
    sigma_arcmin: float
    is_significant: bool
    foreseen_arcmin: float = 0.0
    follows: float = 0.0


def sweep_check(
    target: int,
    tracked: TargetChange | None,
    repeated: Sequence[RepeatedView],
    camera: LensCamera,
    device_from_camera: Callable[[FloatArray], FloatArray],
) -> Check | None:
    """Name what moved during the sweep at one target pose; None where nothing was photographed twice.

    Args:
        target: number of the target pose.
        tracked: how the tracking camera saw the target change.
        repeated: all photographs through the optics that were repeated in this sweep.
        camera: the eyeball camera.
        device_from_camera: stage reading (3,) -> (4, 4).
    """
    views = [_view_change(view, tracked, camera, device_from_camera) for view in repeated]
    step = f"sweep at target pose {target}"
    largest = max(views, key=lambda view: view.median_arcmin, default=None)
    if tracked is not None and tracked.change.is_significant:
        moved = f"{_culprit(views)} between {tracked.names[0]} and {tracked.names[1]}, by {tracked.change}"
        return tracked.change.check(step, f"{moved}; repeat this sweep with its tracking photographs", moved)
    if largest is None:
        right = "the tracking camera sees the target where it was"
        return None if tracked is None else tracked.change.check(step, right, right)
    culprit = "the camera or its stage" if tracked else "the target, the camera or its stage"
    sentence = (
        f"{culprit} moved between {largest.names[0]} and {largest.names[1]}: dots are displaced by "
        f"{largest.median_arcmin:.2g}' at one stage reading; repeat this sweep"
    )
    return Check(
        step,
        "displacement of dots at one stage reading, arcmin",
        largest.median_arcmin,
        largest.sigma_arcmin,
        NEGLIGIBLE_ARCMIN,
        sentence if largest.is_significant else "nothing moved",
        ok=not largest.is_significant,
        contradictory=largest.is_significant and largest.median_arcmin > REFUSED_ARCMIN,
    )


def _culprit(views: Sequence[_ViewChange]) -> str:
    """What moved, given that the tracking camera saw the target move."""
    follows = [view.follows for view in views if view.foreseen_arcmin > NEGLIGIBLE_ARCMIN]
    if not follows:
        return "the target moved or the headset shifted (no photograph through the optics, repeated, tells which)"
    return "the target moved" if np.median(follows) > _FOLLOWS else "the headset shifted"


def _view_change(
    view: RepeatedView,
    tracked: TargetChange | None,
    camera: LensCamera,
    device_from_camera: Callable[[FloatArray], FloatArray],
) -> _ViewChange:
    point, displaced, sigma_px = _common(view)
    noise = np.sqrt(2.0) * sigma_px * _RAYLEIGH
    median = float(np.median(np.linalg.norm(displaced, axis=1))) if len(point) else 0.0
    per_px = 1.0 / float(np.mean(camera.focal_px)) / ARCMIN
    beyond = float(np.sqrt(max(median**2 - noise**2, 0.0))) * per_px
    change = _ViewChange(
        (view.first.name, view.last.name),
        beyond,
        noise / np.sqrt(max(len(point), 1)) * per_px,
        median > _NOISY * noise and beyond > NEGLIGIBLE_ARCMIN,
    )
    if tracked is None or len(point) == 0:
        return change
    camera_from_device = transforms.inverse(device_from_camera(view.reading))
    before, after = (
        camera.pixel_of_point(transforms.apply(camera_from_device @ pose, point))
        for pose in (tracked.before, tracked.after)
    )
    foreseen = np.nan_to_num(after - before)
    power = float(np.sum(foreseen**2))
    return replace(
        change,
        foreseen_arcmin=float(np.sqrt(power / len(point))) * per_px,
        follows=float(np.sum(foreseen * displaced)) / power if power > 0 else 0.0,
    )


def _common(view: RepeatedView) -> tuple[FloatArray, FloatArray, float]:
    """Dots (n, 3) that both photographs show, their displacement (n, 2), and the noise of one of them."""
    where = {tuple(point): i for i, point in enumerate(view.last.point)}
    pairs = [(i, where[tuple(point)]) for i, point in enumerate(view.first.point) if tuple(point) in where]
    first, last = np.array(pairs, dtype=np.int64).reshape(-1, 2).T
    sigma_px = np.concatenate([view.first.sigma_px[first], view.last.sigma_px[last]])
    return (
        view.first.point[first],
        view.last.pixel[last] - view.first.pixel[first],
        float(np.sqrt(np.mean(sigma_px**2))) if len(first) else 0.0,
    )
