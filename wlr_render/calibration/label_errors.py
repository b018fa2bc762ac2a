"""Errors by label: errors shared by readings of one dot, visit or time, beyond the fit and its noise.

A fit predicts its own error from the noise and the errors that it models. Means of the residuals by every label of the
captures are a check that can fail. The errors of a label's groups are modelled as a normal random function of one size
s, independent or with a correlation C that decreases with the distance between groups, over one of a few lengths.
With the covariance K of the readings y, marginalised over all unknowns of the fit, and the columns Z of the label,
u = Z' K^-1 y has the covariance A = Z' K^-1 Z if the label has no errors, and the evidence for such errors is

    log p(y | s, C) - log p(y | 0) = (u' (C^-1 / s^2 + A)^-1 u - log |I + s^2 C A|) / 2

Its average over s and C gives the odds of the label, which exceed 100 in less than one of 100 sessions without such
errors.
"""

from collections.abc import Iterator
from dataclasses import dataclass, replace
from itertools import pairwise
from typing import Any

import numpy as np
import scipy

from wlr_render.calibration.label_terms import means_by, reading_groups
from wlr_render.calibration.posterior_spread import lower_root, principal
from wlr_render.calibration.reading_sums import Response
from wlr_render.calibration.readings import motion_columns
from wlr_render.calibration.smooth_fit import SmoothFit
from wlr_render.captures.correspondences import DisplayCaptures, SeeThroughCaptures
from wlr_render.error_sources import ErrorSource
from wlr_render.numerics.arrays import FloatArray, IntArray

STANDS_OUT, MATTERS = 2.0, 0.3
"""Least log10 odds of a significant label, and least effect of its errors on the model, relative to the error that the
fit expects, for a report to name them: 4 % more error."""
_SOURCES = {
    "dot and pose": ErrorSource.SHAPE_AT_POSES,
    "dot": ErrorSource.PRINTING,
    "visit": ErrorSource.VISITS,
    "time": ErrorSource.DRIFT,
    "reading": ErrorSource.STAGE_AXES,
    "direction": ErrorSource.TRAVEL,
    "cell": ErrorSource.FIELD,
}
"""Source of a label's errors, by the start of the label's name."""
_SIZES = np.geomspace(0.01, 10.0, 31)  # tested sizes of errors per axis, in units of the noise
_USUAL, _DECADES = 0.1, 0.6  # usual size, and sigma of its decimal logarithm; larger errors show in single readings
_LENGTHS = (0.1, 0.3)  # correlation lengths, in extents of the label's places
_DETERMINED = 0.2  # least share of a contrast's information that the fit leaves, relative to the largest share
_CELLS, _DOTS, _DOTS_OF_POSE = 16, 16, 8  # numbers of bins along an axis of the image and of a board
_TIMES = 24  # number of bins of time
_FAR = 100.0  # distance at which errors are independent, in extents
_SAMPLES = 200  # number of readings over which the effect on the model is averaged


@dataclass(frozen=True)
class LabelError:
    """Errors that the readings of each group of a label share.

    Attributes:
        label: e.g. "dot" or "time".
        groups: number of groups.
        ratio: mean square of the groups' weighted residual means, relative to the value expected from fit and noise.
        log10_odds: log10 odds for such errors, given the errors of labels with larger odds; corrected for the number of
            labels.
        size_arcmin: most probable rms length of the errors; 0 if errors are not more probable than none.
        in_model_arcmin: rms error of the model at the readings, due to errors of this size.
        own_arcmin: rms error of the model at the readings that the fit expects without such errors and common errors.
    """

    label: str
    groups: int
    ratio: float
    log10_odds: float
    size_arcmin: float
    in_model_arcmin: float
    own_arcmin: float

    @property
    def stands_out(self) -> bool:
        """True if the errors are significant."""
        return self.log10_odds > STANDS_OUT

    @property
    def matters(self) -> bool:
        """True if the errors are significant and increase the model's error noticeably."""
        return self.stands_out and self.in_model_arcmin > MATTERS * self.own_arcmin

    @property
    def source(self) -> ErrorSource:
        """Source of these errors in an error budget."""
        return next(source for start, source in _SOURCES.items() if self.label.startswith(start))


@dataclass(frozen=True)
class _Label:
    """Groups of readings of one label.

    Attributes:
        group: (n,) group of each reading, -1 for none. columns: (n, 2, k) change by the errors of the reading's group.
        place: (n, d) place of each reading, in extents, if errors of near groups may correlate; None for independent
            errors.
    """

    name: str
    group: IntArray
    columns: FloatArray
    place: FloatArray | None = None

    @property
    def groups(self) -> int:
        return int(self.group.max(initial=-1)) + 1

    @property
    def width(self) -> int:
        return self.groups * int(self.columns.shape[2])

    def design(self, axis: int) -> "scipy.sparse.csr_array":
        """Return the columns (n, groups * k) of one axis of the readings."""
        labelled, k = np.flatnonzero(self.group >= 0), self.columns.shape[2]
        column = (self.group[labelled, None] * k + np.arange(k)).ravel()
        values = self.columns[labelled, axis].ravel(), (np.repeat(labelled, k), column)
        design = scipy.sparse.csr_array(values, shape=(len(self.group), self.width))
        design.eliminate_zeros()
        return design

    def correlations(self) -> Iterator[FloatArray]:
        """Yield correlations (width, width) of the errors: the identity, then Matern 3/2 for each length."""
        yield np.eye(self.width)
        if self.place is not None:
            labelled = self.group >= 0
            place = means_by(self.group[labelled], self.place[labelled])
            apart = np.sqrt(3.0) * np.linalg.norm(place[:, None] - place, axis=2)
            for length in _LENGTHS:
                yield np.kron((1.0 + apart / length) * np.exp(-apart / length), np.eye(self.columns.shape[2]))


@dataclass(frozen=True)
class _Statistics:
    """Statistics of the readings about the errors of all labels.

    Attributes:
        score: u (k,). information: A (k, k).
        plain: (k, k) information for known unknowns of the fit.
        follow, of_side: response of the fit to these errors: change (2, columns, k) of an output's coefficients, and
            change (side, k) of the unknowns common to both outputs.
    """

    score: FloatArray
    information: FloatArray
    plain: FloatArray
    follow: FloatArray
    of_side: FloatArray

    def absorbed(self, part: slice, root: FloatArray) -> "_Statistics":
        """Return the statistics of a fit with one label's errors as further unknowns, of covariance root root'."""
        by_error = self.information[:, part] @ root
        gain = np.linalg.solve(np.eye(root.shape[1]) + root.T @ by_error[part], by_error.T).T
        score = self.score - gain @ (root.T @ self.score[part])
        return replace(self, score=score, information=self.information - gain @ by_error.T)


def label_errors(
    smooth: SmoothFit, captures: DisplayCaptures | SeeThroughCaptures
) -> tuple[tuple[LabelError, ...], Response]:
    """Return the errors of all labels of a fit's captures, and the fit's response to the significant ones.

    Significant errors come first, each tested with the previous ones in the model; the others are tested with all
    significant errors in the model. Exact data have no errors.
    """
    readings, parameters = smooth.readings, smooth.readings.parameters
    response = Response((), np.zeros((0, 2, readings.coefficients)), np.zeros((0, parameters)))
    labels = list(_labels(smooth, captures)) if np.any(readings.sigma > 0) else []
    if not labels:
        return (), response
    common = np.zeros((len(readings), 2, 0))  # errors of the bench stated by the captures
    if readings.common is not None:
        common = readings.common.columns(readings.slopes(smooth.polynomial))
    groups = [_Label("common", np.zeros(len(readings), np.int64), common), *labels]
    stated, *parts = (slice(*each) for each in pairwise(np.cumsum([0, *(each.width for each in groups)])))
    found = _statistics(smooth, groups)
    effect = _effect(smooth, found)
    found = found.absorbed(stated, np.eye(stated.stop))
    noise, own = smooth.noise * float(np.median(readings.sigma)), smooth.own_arcmin(_sample(smooth))
    named: list[LabelError] = []
    left = list(zip(labels, parts, strict=True))
    while left:
        judged = []
        for label, part in left:
            ratio, log10_odds, size, correlation = _judged(label, part, found, noise)
            log10_odds -= float(np.log10(len(labels)))
            root = size * lower_root(correlation, 1e-9)
            in_model = float(np.sqrt(np.sum((effect[:, :, part] @ root) ** 2) / len(effect)))
            sizes = float(np.sqrt(2.0)) * size, in_model
            judged.append((LabelError(label.name, label.groups, ratio, log10_odds, *sizes, own), root))
        best = int(np.argmax([each.log10_odds for each, _ in judged]))
        error, root = judged[best]
        if not error.stands_out:
            return (*named, *sorted((each for each, _ in judged), key=lambda each: -each.log10_odds)), response
        named.append(error)
        _, part = left.pop(best)
        few = root @ principal((effect[:, :, part] @ root).reshape(-1, root.shape[1]))
        of_axes = (found.follow[:, : readings.coefficients, part] @ few).transpose(2, 0, 1)
        sources = (error.source,) * few.shape[1]
        response = Response(sources, of_axes, (found.of_side[:parameters, part] @ few).T).beside(response)
        found = found.absorbed(part, root)
    return tuple(named), response


def _labels(smooth: SmoothFit, captures: DisplayCaptures | SeeThroughCaptures) -> Iterator[_Label]:
    """Yield all labels with two groups or more."""
    readings = smooth.readings
    angle = np.eye(2) / readings.metric[:, None, None]
    tried = []
    if isinstance(captures, DisplayCaptures):
        tried.append(_Label("cell of the panel", _cells(captures.pixel, _CELLS), angle, _extents(captures.pixel)))
    else:
        away = captures.point - captures.viewpoint  # stated, because cells of measured directions would sort noise
        seen = away[:, :2] / away[:, 2:]
        tried.append(_Label("cell of the field", _cells(seen, _CELLS), angle, _extents(seen)))
        tried += _of_dots(captures, angle / away[:, 2, None, None], angle)
    tried.append(_Label("visit", readings.capture, angle))
    tried.append(_Label("time", _bins(captures.time_s, _TIMES), angle, _extents(captures.time_s[:, None])))
    if readings.motion is not None:
        shift = motion_columns(readings, smooth.polynomial)[:, :, :3]
        size = np.sqrt(0.5 * np.mean(np.sum(shift**2, axis=1) * readings.metric[:, None] ** 2, axis=0))
        shift = shift / np.maximum(size, 1e-300)
        for axis in range(3):
            reading = captures.viewpoint[:, axis]
            name, by_axis = f"reading of stage axis {'xyz'[axis]}", shift[..., axis, None]
            tried.append(_Label(name, reading_groups(reading), by_axis, _extents(reading[:, None])))
        travel = np.where(np.isfinite(captures.travel), captures.travel > 0, -1).astype(np.int64)
        tried.append(_Label("direction of travel", _numbered(travel), shift[..., :1]))
    yield from (each for each in tried if each.groups > 1)


def _of_dots(captures: SeeThroughCaptures, shifted: FloatArray, turned: FloatArray) -> Iterator[_Label]:
    """Yield labels of the target; columns `shifted` are for shifts of a dot, `turned` for turns of its direction."""
    dot, pose = captures.target_point[:, :2], np.unique(captures.target_pose, return_inverse=True)[1]
    size, place = np.sqrt(np.mean(shifted**2) / np.mean(turned**2)), _extents(dot)
    yield _Label("dot", _cells(dot, _DOTS), shifted / size, place)
    if pose.any():
        cell = _cells(dot, _DOTS_OF_POSE)
        group = _numbered(np.where(cell < 0, -1, cell + (cell.max() + 1) * pose))
        yield _Label("dot and pose", group, turned, np.column_stack([place, _FAR * pose]))


def _extents(place: FloatArray) -> FloatArray:
    """Return places (n, d) in units of their largest extent; unknown places are NaN."""
    known = place[np.isfinite(place).all(axis=1)]
    return np.asarray(place / max(float(np.ptp(known, axis=0).max()), 1e-300)) if len(known) else place


def _numbered(group: IntArray) -> IntArray:
    """Return groups (n,) renumbered without gaps; -1 stays."""
    return np.asarray(np.where(group < 0, -1, np.searchsorted(np.unique(group[group >= 0]), group)))


def _bins(value: FloatArray, count: int) -> IntArray:
    """Return the bin (n,) of each value among bins of equal width; -1 for unknown values."""
    finite = np.isfinite(value)
    if not finite.any() or np.ptp(value[finite]) <= 0:
        return np.where(finite, 0, -1)
    part = (value - value[finite].min()) / np.ptp(value[finite]) * count
    return _numbered(np.where(finite, np.minimum(np.nan_to_num(part), count - 1), -1).astype(np.int64))


def _cells(place: FloatArray, count: int) -> IntArray:
    """Return the cell (n,) of each place (n, 2), -1 if unknown; each dot of a coarse board has a separate cell."""
    columns, rows = (_bins(axis, count) for axis in place.T)
    return _numbered(np.where((columns < 0) | (rows < 0), -1, columns + count * rows))


def _statistics(smooth: SmoothFit, labels: list[_Label]) -> _Statistics:
    """Return u, A and the response of the fit to the errors of all labels."""
    readings, posterior, residual = smooth.readings, smooth.posterior, smooth.residual
    designs = [scipy.sparse.hstack([each.design(axis) for each in labels], format="csr") for axis in (0, 1)]
    width = designs[0].shape[1]
    score, plain = np.zeros(width), np.zeros((width, width))
    by_axis, by_side = np.zeros((2, len(posterior.alone), width)), np.zeros((len(posterior.side_covariance), width))
    for rows, weight in readings.blocks_of_noise(smooth.kept):
        inverse = weight**2 if isinstance(weight, np.ndarray) else [each.T @ each for each in weight]
        side, known = smooth.side_columns(rows), _times(inverse, residual[rows])
        own = None if readings.mixed else _times(inverse, readings.design(rows))
        for axis, design in enumerate(designs):
            used, touched = np.unique(design[rows].indices), np.flatnonzero(side[:, axis].any(axis=0))
            columns = design[rows][:, used]
            score[used] += columns.T @ known[:, axis]
            product = columns.T @ _times(inverse, columns)
            plain[np.ix_(used, used)] += product.toarray() if scipy.sparse.issparse(product) else product
            by_side[np.ix_(touched, used)] += (columns.T @ _times(inverse, side[:, axis, touched])).T
            if own is not None:
                by_axis[axis][:, used] += (columns.T @ own).T
    square = smooth.noise**2
    score, plain, by_axis, by_side = (each / square for each in (score, plain, by_axis, by_side))
    follow = posterior.alone @ by_axis  # change of the coefficients for known side unknowns
    information = plain
    if not readings.mixed:
        information = plain - sum(each.T @ moved for each, moved in zip(by_axis, follow, strict=True))
        by_side = by_side + np.einsum("osc,ocg->sg", posterior.by_side, by_axis, optimize=True)
    of_side = posterior.side_covariance @ by_side
    information = information - by_side.T @ of_side
    follow += posterior.by_side.transpose(0, 2, 1) @ of_side
    return _Statistics(score, information, plain, follow, of_side)


def _times(inverse: FloatArray | list[FloatArray], values: Any) -> Any:
    """Return the inverse noise covariance of readings, given as diagonal or blocks, times values (r, k)."""
    if isinstance(inverse, np.ndarray):
        return scipy.sparse.diags_array(inverse) @ values
    product, last = np.empty(values.shape), 0
    for each in inverse:
        first, last = last, last + len(each)
        product[first:last] = each @ values[first:last]
    return product


def _effect(smooth: SmoothFit, found: _Statistics) -> FloatArray:
    """Return the change (r, 2, k) of the model at some readings, arcminutes, due to the errors of all labels."""
    readings, parameters, own = smooth.readings, smooth.readings.parameters, smooth.readings.coefficients
    rows = _sample(smooth)
    change = readings.shared_columns(rows)[:, :, :parameters] @ found.of_side[:parameters]
    if own:
        change += (readings.design(rows)[:, :own] @ found.follow[:, :own]).transpose(1, 0, 2)
    return np.asarray(change * readings.metric[rows, None, None])


def _sample(smooth: SmoothFit) -> IntArray:
    return np.random.default_rng(0).permutation(len(smooth.readings))[:_SAMPLES]


def _judged(label: _Label, part: slice, found: _Statistics, noise: float) -> tuple[float, float, float, FloatArray]:
    """Return the evidence for the errors of a label.

    Returns:
        The mean square of u relative to its expectation without errors; log10 odds for errors; their most probable size
        per axis in arcminutes, 0 if errors are not more probable than none; and their most probable correlation.
    """
    lower = lower_root(found.plain[part, part], 1e-9)
    left = scipy.linalg.solve_triangular(lower, found.information[part, part], lower=True)
    values, vectors = np.linalg.eigh(scipy.linalg.solve_triangular(lower, left.T, lower=True))
    determined = values >= max(_DETERMINED * float(values[-1]), 1e-9)
    vectors, values = vectors[:, determined], values[determined]
    score = vectors.T @ scipy.linalg.solve_triangular(lower, found.score[part], lower=True)
    scaled = np.sqrt(values)[:, None] * (vectors.T @ lower.T)  # map from errors to contrasts of unit variance
    square, likely = (noise * _SIZES) ** 2, -0.5 * (np.log10(_SIZES / _USUAL) / _DECADES) ** 2
    odds, correlations = [], list(label.correlations())
    for each in correlations:
        spread, axes = np.linalg.eigh(scaled @ each @ scaled.T)
        power = (axes.T @ (score / np.sqrt(values))) ** 2
        over = square[:, None] * np.maximum(spread, 0.0)
        odds.append(0.5 * np.sum(over * power / (1.0 + over) - np.log1p(over), axis=1))
    best = max(range(len(odds)), key=lambda each: float(odds[each].max()))
    top = float(odds[best].max())
    weights = np.exp(likely) / np.sum(np.exp(likely)) / len(odds)
    mean = top + float(np.log(np.sum(np.exp(np.array(odds) - top) * weights)))
    size = noise * float(_SIZES[np.argmax(odds[best])]) if top > 0 else 0.0
    ratio = float(score @ score / max(values.sum(), 1e-300))
    return ratio, mean / float(np.log(10.0)), size, correlations[best]
