"""Rough lenses and views without outliers of each camera, with the kind of lens chosen on held-out views."""

import contextlib
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from wlr_render.calibration.bench.adjustment import UndeterminedError, adjust
from wlr_render.calibration.bench.board_views import (
    FEWEST_FEATURES,
    BenchObservations,
    BoardView,
    CameraSetup,
)
from wlr_render.calibration.bench.start import board_pose, start_lens, start_state, undetermined
from wlr_render.calibration.bench.state import BenchState
from wlr_render.captures.boards.board_homography import by_homography
from wlr_render.errors import BadInputError
from wlr_render.geometry import transforms
from wlr_render.lenses.lens import Lens
from wlr_render.lenses.lens_camera import LensCamera
from wlr_render.numerics.arrays import FloatArray

_KINDS = ("brown", "fisheye", "rational")  # lens kinds by preference; thin prisms are tried if rational terms help
_FEWER = {"rational": "brown", "thin-prism": "rational"}  # simpler kind with a subset of each kind's terms
_FEWEST_VIEWS = 3  # fewest views of a plane that determine a camera (Zhang, IEEE PAMI 22 (2000), 1330)
_CHOICE_FEATURES, _CHOICE_VIEWS = 100, 20  # features of a view, and views, for the choice of the kind of lens
_ENOUGH = 350  # number of features of a view; more take time and add little
_OUTLIER_SIGMAS = 6.0  # outlier threshold of features in robust sigmas, beyond any noise
_POOR_FIT = 3.0  # largest scatter of a photograph, relative to expectation; one above has 9 times too much weight
_MISREAD, _LENS_BENDS_PX = 10.0, 2.0
"""Distance from a plane's image relative to the median photograph's, plus pixels, which only misread features exceed: a
lens distorts all views, and some by a few pixels more."""
_BETTER_SIGMAS = 2.0  # standard errors by which more terms must improve held-out views; chance does it once in 40


class RefusedViewsError(BadInputError):
    """Error for remaining photographs that are too few, or do not determine the unknowns.

    Attributes:
        rejected: name -> reason for photographs that were rejected before.
    """

    def __init__(self, sentence: str, rejected: Mapping[str, str]) -> None:
        super().__init__(sentence)
        self.rejected = rejected


@dataclass(frozen=True, eq=False)
class SoundViews:
    """Views of one camera without outliers, and its rough lens.

    Attributes:
        views: remaining views in their order. lens: lens estimated from them, or known.
        rejected: name -> reason for rejected photographs.
        tried: kind of lens -> rms error of held-out features, pixels; empty without a choice.
    """

    views: Sequence[BoardView]
    lens: Lens
    rejected: Mapping[str, str]
    tried: Mapping[str, float]


def sound_views(views: Sequence[BoardView], setup: CameraSetup, observations: BenchObservations) -> SoundViews:
    """Return a camera's views without outliers, and a rough lens.

    Raises:
        RefusedViewsError: fewer than three photographs are usable, or they do not determine the lens.
    """
    rejected = {view.name: reason for view in views if (reason := _too_few(view))}
    rejected |= _misread([view for view in views if view.name not in rejected])
    usable = [view for view in views if view.name not in rejected]
    tried: dict[str, float] = {}
    lens = setup.calibrated
    if lens is None:
        try:
            lens, tried = _chosen_lens(usable, setup, observations)
        except BadInputError as error:
            raise RefusedViewsError(str(error), rejected) from error
    kept: list[BoardView] = []
    scales: list[float] = []
    sigma_m: list[float] = []
    for view in (each.seen_by(lens) for each in usable):
        try:
            pose, scale = board_pose(lens, view)
        except BadInputError as error:
            rejected[view.name] = str(error).removeprefix(f"{view.name}: ").removesuffix(".")
            continue
        residual = np.abs(view.pixel - lens.pixel_of_point(transforms.apply(pose, view.point))) / view.sigma_px[:, None]
        near = residual.max(axis=1) <= _OUTLIER_SIGMAS * max(scale, 1.0)
        kept.append(view.only(near))
        scales.append(scale)
        distance = float(np.linalg.norm(pose[:3, 3]))
        sigma_m.append(float(np.median(view.sigma_px) / np.mean(lens.focal_px)) * distance)
    sound = []
    for view, scale, usual in zip(kept, scales, _usual_scales(np.array(scales), np.array(sigma_m)), strict=True):
        if len(kept) > 2 and scale > _POOR_FIT * usual:
            rejected[view.name] = (
                f"its features miss the best pose of the board {scale / usual:.1f} times as far as expected from "
                "the other photographs; it is blurred, or misread, or the lens was changed"
            )
        elif reason := _too_few(view):
            rejected[view.name] = reason
        else:
            sound.append(view)
    return SoundViews(_thinned(sound, _ENOUGH), lens, rejected, tried)


def _usual_scales(scale: FloatArray, sigma_m: FloatArray) -> FloatArray:
    """Return the expected scatter (n,) of each photograph, estimated from all photographs.

    Errors of a printed board are lengths: in pixels, they are larger on a near board than on a distant one.

    Args:
        scale: (n,) observed scatter relative to the stated sigma.
        sigma_m: (n,) stated sigma as a length on the board.
    """
    if not scale.size:
        return scale
    board_m = np.median(sigma_m * np.sqrt(np.maximum(scale**2 - 1.0, 0.0)))
    return np.asarray(np.maximum(np.median(scale), np.hypot(1.0, board_m / sigma_m)))


def _thinned(views: Sequence[BoardView], features: int) -> list[BoardView]:
    """Thin each view to about `features` features, the same in all views, so that several views show each error."""
    every = max(1, round(float(np.median([len(view) for view in views])) / features)) if views else 1
    return [view.only((view.feature @ [1, 2]) % every == 0) for view in views]


def _too_few(view: BoardView) -> str:
    if len(view) >= FEWEST_FEATURES:
        return ""
    return f"shows only {len(view)} features of the board, fewer than {FEWEST_FEATURES}"


def _misread(views: Sequence[BoardView]) -> dict[str, str]:
    """Return reasons to reject views much farther from a plane's image than the median; a lens distorts all views."""
    misses = np.array([_plane_residual_px(view) for view in views])
    limit = _LENS_BENDS_PX + _MISREAD * float(np.median(misses)) if views else 0.0
    return {
        view.name: f"its features miss the image of a flat board by {miss:.2g} px; they are misread"
        for view, miss in zip(views, misses, strict=True)
        if not miss <= limit
    }


def _plane_residual_px(view: BoardView) -> float:
    """Return the rms distance, px, of features from the best homography of the board plane; NaN if no fit exists."""
    plane = view.point[:, :2]
    seen = by_homography(plane, view.pixel, plane)
    return np.nan if seen is None else float(np.sqrt(np.mean((seen - view.pixel) ** 2)))


def free_views(
    views: Sequence[BoardView],
    setup: CameraSetup,
    kind: str,
    observations: BenchObservations,
    first: LensCamera | None = None,
) -> BenchState:
    """Adjust a lens of one kind, and the boards' shapes, to views of boards held anywhere.

    Args:
        views: views of one camera.
        setup: setup of the camera.
        kind: kind of the lens.
        observations: source of the board tolerances.
        first: starting lens, of this kind or a kind with its first terms; None to find one.

    Raises:
        BadInputError: the views do not determine the lens.
    """
    free = [replace(view, target=None, place=None) for view in views]
    camera = free[0].camera
    alone = BenchObservations(free, {camera: replace(setup, kind=kind)}, {}, (), tolerances=observations.tolerances)
    try:
        lens = start_lens(free, setup.size_px, kind) if first is None else first.as_kind(kind)
        start = start_state(alone, {camera: lens}, rough=True)
        return adjust(start).state  # a rough lens needs no covariance
    except UndeterminedError as error:
        raise undetermined(views) from error


def _chosen_lens(
    views: Sequence[BoardView], setup: CameraSetup, observations: BenchObservations
) -> tuple[Lens, dict[str, float]]:
    """Return the lens of the simplest kind that predicts held-out photographs as well as any, and rms by kind, px."""
    if len(views) < _FEWEST_VIEWS:
        raise BadInputError(
            f"a camera needs {_FEWEST_VIEWS} or more photographs of the board, tilted in different directions, and "
            f"{len(views)} can be used."
        )
    some = np.unique(np.linspace(0, len(views) - 1, min(len(views), _CHOICE_VIEWS)).round().astype(int))
    few = _thinned([views[number] for number in some], _CHOICE_FEATURES)
    camera = few[0].camera
    folds = [few[0::2], few[1::2]]
    if setup.kind != "auto" or min(map(len, folds)) < _FEWEST_VIEWS:
        kind = "brown" if setup.kind == "auto" else setup.kind
        return _lens_of_kind(few, setup, kind, observations), {}
    missed: dict[str, FloatArray] = {}
    lenses: dict[str, list[LensCamera]] = {}
    for kind in (*_KINDS, "thin-prism"):
        if kind == "thin-prism" and _simplest(missed) != "rational":
            continue
        # A fit of all terms at once may end in a local minimum, so that it starts from the lens with fewer terms.
        fewer = lenses.get(_FEWER.get(kind, ""), (None, None))
        starts = zip(folds, fewer, strict=True)
        try:
            fitted = [free_views(fold, setup, kind, observations, first) for fold, first in starts]
        except (BadInputError, np.linalg.LinAlgError):
            continue
        lenses[kind] = [lens for state in fitted if isinstance(lens := state.lens[camera], LensCamera)]
        held = zip(fitted, folds[::-1], strict=True)
        missed[kind] = np.concatenate([_missed_px(state, camera, views) for state, views in held])
    if not missed:
        raise undetermined(views)
    rms = {kind: float(np.sqrt(np.mean(each))) for kind, each in missed.items()}
    chosen = _simplest(missed)
    return free_views(few, setup, chosen, observations, lenses[chosen][0]).lens[camera], rms


def _lens_of_kind(
    views: Sequence[BoardView], setup: CameraSetup, kind: str, observations: BenchObservations
) -> LensCamera:
    """Return a lens of a stated kind, fitted from the lens with fewer terms if the views determine one."""
    first = None
    if kind in _FEWER:
        with contextlib.suppress(BadInputError, np.linalg.LinAlgError):
            first = _lens_of_kind(views, setup, _FEWER[kind], observations)
    lens = free_views(views, setup, kind, observations, first).lens[views[0].camera]
    assert isinstance(lens, LensCamera)  # free views have no residual field
    return lens


def _simplest(missed: Mapping[str, FloatArray]) -> str:
    """Return the first kind that is not worse than the best by more than chance.

    The comparison uses logarithms with equal weight for all photographs, because a few show a distortion best, and one
    may be poor.
    """
    best = min(missed, key=lambda kind: float(np.mean(np.log(missed[kind]))), default="")
    for kind, each in missed.items():
        worse = np.log(each / missed[best])
        if np.mean(worse) <= _BETTER_SIGMAS * np.std(worse) / np.sqrt(len(worse)):
            return kind
    return best


def _missed_px(state: BenchState, camera: str, views: Sequence[BoardView]) -> FloatArray:
    """Return the mean square residual (n,) of each view at its best pose, per axis, with outliers bounded, px^2."""
    lens, result = state.lens[camera], []
    for view in views:
        true = replace(view, point=state.shape[view.board].point_of(view.feature, view.point))
        try:
            pose, scale = board_pose(lens, true)
        except BadInputError:  # the view is outside the lens model's domain
            result.append(float(np.sum(np.square(lens.size_px))))
            continue
        residual = view.pixel - lens.pixel_of_point(transforms.apply(pose, true.point))
        most = np.minimum(_OUTLIER_SIGMAS * max(scale, 1.0) * view.sigma_px[:, None], max(lens.size_px))
        result.append(np.mean(np.where(np.isfinite(residual), np.clip(residual, -most, most), most) ** 2))
    return np.array(result)
