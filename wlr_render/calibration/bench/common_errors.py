"""Errors of a calibrated bench in the form used by captures: independent motion of each camera, and common errors.

The joint covariance of the unknowns has a block-lower-triangular root in the order of `SOURCES`: the variables of a
source describe its errors given the previous sources. Only the few combinations of each source that affect the readings
are kept; the rest of a camera's motion is treated as independent.
"""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
import scipy

from wlr_render.calibration.bench.bench_blocks import Key
from wlr_render.calibration.bench.board_views import EYEBALL
from wlr_render.calibration.bench.calibrate_bench import CalibratedBench, board_name, place_key
from wlr_render.calibration.poses import adjoint
from wlr_render.calibration.posterior_spread import lower_root
from wlr_render.calibration.readings import angular_metric
from wlr_render.captures.correspondences import AnyCaptures, DisplayCaptures, SeeThroughCaptures
from wlr_render.captures.feature_captures import CaptureMotionPrior, CommonErrors, point_terms
from wlr_render.captures.photo_session import BoardPhotograph, SessionEntry
from wlr_render.error_sources import ErrorSource
from wlr_render.geometry import transforms
from wlr_render.numerics.arrays import FloatArray
from wlr_render.numerics.polynomial import Box, Polynomial, basis, total_degree

SOURCES = (
    ErrorSource.LENS,
    ErrorSource.BOARD,
    ErrorSource.TRACKING_CAMERA,
    ErrorSource.TARGETS,
    ErrorSource.STAGE,
    ErrorSource.BENCH_DRIFT,
)
"""Sources of common errors, in the order of the root."""
_KEPT = 0.999  # share of a source's variance in the readings that is kept, which makes sigmas 0.05 % too small
_MOST = 24  # most variables of all sources, largest first; each takes time in fits and space in model files
_LEAST_ARCMIN = 1e-3  # least rms effect of a variable on the readings, a hundredth of the models' errors
_JITTER = 1e-10  # share of each variance that is added, because some poses depend on others to nearly all digits
_LENS_DEGREE, _LENS_GRID = 7, 21  # degree of a lens's change over the picture, and points of its fit along a side
_IMAGES_M = (0.3, 5.0)  # distances of virtual images for estimates of effects of camera shifts
_ROWS = 400  # number of rows of each side for estimates of effects
_MOTION_LOG_SIGMA = 0.3  # sigma of the logarithm of the factor on the poses' sigmas, from some twenty photographs

Entries = Sequence[SessionEntry]


def with_bench_errors(
    bench: CalibratedBench,
    display: tuple[DisplayCaptures, Entries] | None,
    see_through: tuple[SeeThroughCaptures, Entries] | None,
) -> tuple[DisplayCaptures | None, SeeThroughCaptures | None]:
    """Return captures with `motion` and `common` from the joint adjustment.

    Args:
        bench: the calibrated bench.
        display, see_through: captures of one eye, with the session's entries of the captures (or of the visits, if
            these are numbered), in the order of their numbers.
    """
    factor, sources = _shared_root(bench)
    sides = [side for side in (display, see_through) if side is not None]
    errors = [_errors(bench, factor, sources, entries) for _, entries in sides]
    effects = [_effect(captures, common) for (captures, _), (common, _) in zip(sides, errors, strict=True)]
    turn, kept = _chosen(np.concatenate(effects) / np.sqrt(len(effects)), sources)
    return (
        display and _with_known(display[0], *errors[0], turn, kept),
        see_through and _with_known(see_through[0], *errors[-1], turn, kept),
    )


def _shared_root(bench: CalibratedBench) -> tuple[FloatArray, tuple[str, ...]]:
    """Return the change (unknowns, variables) of all unknowns by the sources' variables, and each variable's source."""
    adjustment = bench.adjustment
    of: dict[str, list[Key]] = {source: [] for source in SOURCES}
    for key, block in adjustment.state.blocks.items():
        if block.source:
            of[block.source].append(key)
    columns = adjustment.layout.columns([key for keys in of.values() for key in keys])
    sources = tuple(name for name, keys in of.items() for _ in adjustment.layout.columns(keys))
    covariance = adjustment.covariance[columns]
    root = lower_root(covariance[:, columns], _JITTER)
    return np.asarray(scipy.linalg.solve_triangular(root, covariance, lower=True)).T, sources


def _errors(
    bench: CalibratedBench, factor: FloatArray, sources: tuple[str, ...], entries: Entries
) -> tuple[CommonErrors, FloatArray]:
    """Return the errors of some entries' captures by all variables, and the variance (entries, 6) of camera poses."""
    adjustment = bench.adjustment
    poses, rows, random = adjustment.camera_rows([place_key(bench.session, each) for each in entries])
    motion = np.empty((len(poses), 6, factor.shape[1]))
    variance = np.empty((len(poses), 6))
    for k, (pose, row, own) in enumerate(zip(poses, rows, random, strict=True)):
        # Convert motions about the device's origin to motions about the pupil.
        about = adjoint(transforms.rigid(np.eye(3), -pose[:3, 3]))
        used = np.flatnonzero(np.any(row, axis=0))
        at = about @ row[:, used]
        motion[k] = at @ factor[used]
        covariance = at @ adjustment.covariance[np.ix_(used, used)] @ at.T + about @ own @ about.T
        variance[k] = np.diag(covariance)
    numbers = sorted({each.target_pose for each in entries if isinstance(each, BoardPhotograph)})
    where = adjustment.layout.where
    focus = [-factor[where["focus", k]][0] if ("focus", k) in where else np.zeros(len(sources)) for k in numbers]
    common = CommonErrors(
        sources,
        np.arange(len(poses)),
        motion,
        _lens_change(bench, factor),
        np.array(numbers, np.int64),
        np.array([_target_change(bench, factor, k) for k in numbers]),
        np.array(focus),
    )
    return common, variance


def _lens_change(bench: CalibratedBench, factor: FloatArray) -> Polynomial | None:
    """Return the change of the tangents at fixed pixels of the eyeball camera, see `CommonErrors.lens`."""
    lens = bench.eyeball
    if not len(lens.values):
        return None
    side = (np.arange(_LENS_GRID) + 0.5) / _LENS_GRID
    pixel = np.stack(np.meshgrid(side, side), axis=-1).reshape(-1, 2) * lens.size_px
    tangents = lens.tangents_of_pixel(pixel)
    tangents = tangents[np.isfinite(tangents).all(axis=1)]
    seen = lens.project(np.column_stack([tangents, np.ones(len(tangents))]))
    # At a fixed pixel, the change of the tangents cancels the effect of the change of the lens values.
    by_variable = seen.by_values @ factor[bench.adjustment.layout.where["lens", EYEBALL]]
    change = -np.linalg.solve(seen.by_point[:, :, :2], by_variable)
    good, openxr = np.isfinite(change).all(axis=(1, 2)), np.array([1.0, -1.0])
    tangents, change = tangents[good] * openxr, change[good] * openxr[:, None]
    orders, box = total_degree(2, _LENS_DEGREE), Box.around(tangents)
    found = np.linalg.lstsq(basis(tangents, orders, box), change.reshape(len(tangents), -1))[0]
    return Polynomial(orders, box, np.asarray(found, np.float64))


def _target_change(bench: CalibratedBench, factor: FloatArray, number: int) -> FloatArray:
    """Return coefficients (terms, 3, variables) of the change of a target's points, see `CommonErrors.target`."""
    state, where = bench.adjustment.state, bench.adjustment.layout.where
    pose, name = state.targets[number], board_name(bench.session, number)
    board = bench.session.board_of(number)
    nominal = board.point_of(board.indices())
    shape = state.shape.get(name)
    point = transforms.apply(pose, nominal if shape is None else nominal + shape.by_low(nominal) @ shape.low)
    motion = adjoint(pose) @ factor[where["target", number]]
    change = -transforms.cross_matrix(point) @ motion[:3] + motion[3:]
    if shape is not None:
        change = change + pose[:3, :3] @ (shape.by_low(nominal) @ factor[where["shape", name]])
    found = np.linalg.lstsq(point_terms(point), change.reshape(len(point), -1), rcond=1e-9)[0]
    return np.asarray(found.reshape(-1, 3, factor.shape[1]))


def _effect(captures: DisplayCaptures | SeeThroughCaptures, common: CommonErrors) -> FloatArray:
    """Return changes (2 rows, variables) of the residuals of sampled rows, arcminutes over the root of their number.

    Optics are neglected: the camera sees the real points, or images at the distances `_IMAGES_M`, through air.
    """
    rows = np.random.default_rng(0).permutation(len(captures))[:_ROWS]
    changes, tangents = common.changes(captures, rows), captures.tangents[rows]
    moved, depth = changes.viewpoint, np.resize(_IMAGES_M, len(rows))
    if isinstance(captures, SeeThroughCaptures):
        depth = (captures.viewpoint - captures.point)[rows, 2]
    if changes.point is not None:
        moved = moved - changes.point
    straight = (moved[:, :2] + tangents[:, :, None] * moved[:, 2:]) / depth[:, None, None]
    effect = (changes.tangents + straight) * angular_metric(tangents)[:, None, None]
    return np.asarray(effect.reshape(2 * len(rows), -1) / np.sqrt(len(rows)))


def _chosen(effect: FloatArray, sources: tuple[str, ...]) -> tuple[FloatArray, tuple[str, ...]]:
    """Return combinations (variables, m) that matter, each of one source's variables, and their sources (m,)."""
    found: list[tuple[float, str, FloatArray]] = []
    for name in SOURCES:
        own = np.flatnonzero([source == name for source in sources])
        if not own.size:
            continue
        _, size, axes = np.linalg.svd(effect[:, own], full_matrices=False)
        before = np.cumsum(size**2) - size**2
        for k in np.flatnonzero((before < _KEPT * np.sum(size**2)) & (size > _LEAST_ARCMIN)):
            turn = np.zeros(len(sources))
            turn[own] = axes[k]
            found.append((float(size[k]), name, turn))
    least = sorted((size for size, _, _ in found), reverse=True)[:_MOST][-1:]
    kept = [(name, turn) for size, name, turn in found if size >= least[0]]
    turns = np.array([turn for _, turn in kept]).reshape(-1, len(sources)).T
    return turns, tuple(name for name, _ in kept)


def _with_known(
    captures: AnyCaptures, common: CommonErrors, variance: FloatArray, turn: FloatArray, sources: tuple[str, ...]
) -> AnyCaptures:
    """Return captures with `motion` and `common`; `turn` selects the common variables, and `motion` has the rest."""
    own = variance - np.sum((common.motion @ turn) ** 2, axis=2)
    motion = CaptureMotionPrior(common.capture, np.sqrt(np.maximum(own, 0.0)), _MOTION_LOG_SIGMA)
    if not sources:
        return replace(captures, motion=motion, common=None)
    kept = common.combined(turn, sources)
    if "lens" not in sources:
        kept = replace(kept, lens=None, focus=np.zeros_like(kept.focus))
    return replace(captures, motion=motion, common=kept)
