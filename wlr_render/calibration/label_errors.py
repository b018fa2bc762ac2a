"""Errors by label: what readings of one dot, visit or time share beyond what a fit and its noise explain.

A fit predicts its own error from the noise and the motions that it models. Means of its residuals by every label of
the captures are a check that can fail. Each label stands for a variance component: an error of its own for each of its
groups, normal with one size for all. With the covariance K of the readings y, all unknowns of the fit integrated over,
and the columns Z of the label, u = Z' K^-1 y has the covariance A = Z' K^-1 Z if the label has no errors, and the
evidence for errors of size s is

    log p(y | s) - log p(y | 0) = (u' (I / s^2 + A)^-1 u - log |I + s^2 A|) / 2

Averaged over s it is the odds of the label. They exceed 100 in less than one of 100 sessions without such errors.
"""

from collections.abc import Iterator
from dataclasses import dataclass
from itertools import pairwise

import numpy as np

from wlr_render.calibration.posterior_spread import principal
from wlr_render.calibration.reading_sums import Response
from wlr_render.calibration.readings import motion_columns
from wlr_render.calibration.smooth_fit import SmoothFit
from wlr_render.captures.correspondences import DisplayCaptures, SeeThroughCaptures
from wlr_render.numerics.arrays import FloatArray, IntArray
from wlr_render.numerics.evidence import weight_values

STANDS_OUT, MATTERS = 2.0, 0.3
"""Log10 odds from which the captures have the errors of a label, and their least effect on the model, over the error
that its fit expects, from which a report names them: 4 % more error."""
SOURCES_BY_LABEL = {
    "dot and pose": (
        "shape of the board at each pose",
        "Hold the board flat at all poses, and let the camera's focus alone.",
    ),
    "dot": ("printing errors of the board", "Print the board on glass, or measure its dots."),
    "visit": ("errors of each visit", "Let the stage settle before each photograph."),
    "time": ("drift", "Let camera and headset warm up, and visit the positions in random order."),
    "reading": ("stage axes", "Measure the errors of that axis, or track the camera."),
    "direction": ("direction of travel", "Approach all positions from one side."),
    "cell": (
        "errors by place in the field",
        "Check the camera's lens and the decoding; else the optics are less smooth than the model.",
    ),
}
"""Source of the errors of a label, by the start of its name, and what avoids them."""
REMEDIES = {"shape of the board": "Flatten the board, or measure its shape."} | dict(SOURCES_BY_LABEL.values())
"""What avoids the errors of a source, a sentence."""
_SIZES = np.geomspace(0.01, 10.0, 31)  # sizes of errors per axis in units of the noise, all as probable
_DETERMINED = 0.2  # least information of a contrast between groups, over the largest; the fit absorbs what has less
_CELLS, _DOTS, _DOTS_OF_POSE = 10, 16, 6  # along an axis of the image and of a board
_BINS, _TIMES = 16, 6  # bins of a stage's reading and of time
_SAMPLES = 200  # readings at which the effect on the model is averaged
_SAME_READING_M = 1e-4  # stage readings nearer than this are one


@dataclass(frozen=True)
class LabelError:
    """Errors that the readings of each group of a label share.

    Attributes:
        label: e.g. "dot" or "time".
        groups: number of them.
        ratio: mean square of the groups' weighted residual means over the one that fit and noise explain.
        log10_odds: for such errors, beside those of labels with larger odds; charged for the number of labels.
        size_arcmin: most probable rms length of the errors; 0 where they are not more probable than none.
        in_model_arcmin: rms error of the model at the readings that errors of this size cause.
        own_arcmin: rms error of the model at the readings that the fit expects without them and without common errors.
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
        """Whether the captures have such errors."""
        return self.log10_odds > STANDS_OUT

    @property
    def matters(self) -> bool:
        """Whether the captures have such errors, and the model is less certain for them."""
        return self.stands_out and self.in_model_arcmin > MATTERS * self.own_arcmin

    @property
    def source(self) -> str:
        """What such errors are of, as an error budget names it."""
        return self._said[0]

    @property
    def remedy(self) -> str:
        """What avoids such errors, a sentence."""
        return self._said[1]

    @property
    def _said(self) -> tuple[str, str]:
        return next(said for start, said in SOURCES_BY_LABEL.items() if self.label.startswith(start))


@dataclass(frozen=True)
class _Label:
    """One label: the group (n,) of each reading, -1 for none, and what an error of its group changes, (n, 2, k)."""

    name: str
    group: IntArray
    columns: FloatArray

    @property
    def groups(self) -> int:
        return int(self.group.max(initial=-1)) + 1

    @property
    def width(self) -> int:
        return self.groups * int(self.columns.shape[2])

    def design(self, rows: IntArray) -> FloatArray:
        """Columns (r, 2, groups * k)."""
        columns, group = self.columns[rows], self.group[rows]
        design = np.zeros((len(rows), 2, self.groups, columns.shape[2]))
        labelled = np.flatnonzero(group >= 0)
        design[labelled, :, group[labelled]] = columns[labelled]
        return design.reshape(len(rows), 2, -1)


def label_errors(
    smooth: SmoothFit, captures: DisplayCaptures | SeeThroughCaptures
) -> tuple[tuple[LabelError, ...], Response]:
    """Return the errors of all labels of the captures of a fit, and how it follows those that stand out.

    Those that stand out come first, each judged with the ones before it as part of the model; the others with all.
    Exact data have none.
    """
    readings, parameters = smooth.readings, smooth.readings.parameters
    response = Response((), np.zeros((0, 2, readings.coefficients)), np.zeros((0, parameters)))
    labels = list(_labels(smooth, captures)) if np.any(readings.sigma > 0) else []
    if not labels:
        return (), response
    common = np.zeros((len(readings), 2, 0))  # errors of the bench that the captures state
    if readings.common is not None:
        common = readings.common.columns(readings.slopes(smooth.polynomial))
    groups = [_Label("common", np.zeros(len(readings), np.int64), common), *labels]
    stated, *parts = (slice(*each) for each in pairwise(np.cumsum([0, *(each.width for each in groups)])))
    score, information, follow, of_side = _score(smooth, groups)
    score, information = _absorbed(score, information, stated, 1.0)
    effect = _effect(smooth, follow, of_side)
    noise, own = smooth.noise * float(np.median(readings.sigma)), smooth.own_arcmin(_sample(smooth))
    named: list[LabelError] = []
    left = list(zip(labels, parts, strict=True))
    while left:
        judged = []
        for label, part in left:
            ratio, log10_odds, size = _judged(score[part], information[part, part], noise)
            log10_odds -= float(np.log10(len(labels)))
            in_model = size * float(np.sqrt(np.sum(effect[:, :, part] ** 2) / len(effect)))
            sizes = float(np.sqrt(2.0)) * size, in_model
            judged.append(LabelError(label.name, label.groups, ratio, log10_odds, *sizes, own))
        best = int(np.argmax([each.log10_odds for each in judged]))
        if not judged[best].stands_out:
            return (*named, *sorted(judged, key=lambda each: -each.log10_odds)), response
        named.append(judged[best])
        part, size = left.pop(best)[1], judged[best].size_arcmin / np.sqrt(2.0)
        few = size * principal(effect[:, :, part].reshape(-1, part.stop - part.start))
        of_axes = (follow[:, : readings.coefficients, part] @ few).transpose(2, 0, 1)
        sources = (judged[best].source,) * few.shape[1]
        response = Response(sources, of_axes, (of_side[:parameters, part] @ few).T).beside(response)
        score, information = _absorbed(score, information, part, size)
    return tuple(named), response


def _labels(smooth: SmoothFit, captures: DisplayCaptures | SeeThroughCaptures) -> Iterator[_Label]:
    """All labels with two groups or more."""
    readings = smooth.readings
    angle = np.eye(2) / readings.metric[:, None, None]
    tried = []
    if isinstance(captures, DisplayCaptures):
        tried.append(_Label("cell of the panel", _cells(captures.pixel, _CELLS), angle))
    else:
        away = captures.point - captures.viewpoint  # directions as stated: cells by the readings would sort their noise
        tried.append(_Label("cell of the field", _cells(away[:, :2] / away[:, 2:], _CELLS), angle))
        tried += _of_dots(captures, angle / away[:, 2, None, None], angle)
    tried.append(_Label("visit", readings.capture, angle))
    tried.append(_Label("time", _bins(captures.time_s, _TIMES), angle))
    if readings.motion is not None:
        shift = motion_columns(readings, smooth.polynomial)[:, :, :3]
        size = np.sqrt(0.5 * np.mean(np.sum(shift**2, axis=1) * readings.metric[:, None] ** 2, axis=0))
        shift = shift / np.maximum(size, 1e-300)
        for axis in range(3):
            reading = captures.viewpoint[:, axis]
            tried.append(_Label(f"reading of stage axis {'xyz'[axis]}", _stage_bins(reading), shift[..., axis, None]))
        travel = np.where(np.isfinite(captures.travel), captures.travel > 0, -1).astype(np.int64)
        tried.append(_Label("direction of travel", _numbered(travel), shift[..., :1]))
    yield from (each for each in tried if each.groups > 1)


def _of_dots(captures: SeeThroughCaptures, shifted: FloatArray, turned: FloatArray) -> Iterator[_Label]:
    """Labels of the target, from the columns of a shift of a dot, of any size, and of a turn of its line of sight."""
    dot, pose = captures.target_point[:, :2], np.unique(captures.target_pose, return_inverse=True)[1]
    size = np.sqrt(np.mean(shifted**2) / np.mean(turned**2))
    yield _Label("dot", _cells(dot, _DOTS), shifted / size)
    if pose.any():
        cell = _cells(dot, _DOTS_OF_POSE)
        yield _Label("dot and pose", _numbered(np.where(cell < 0, -1, cell + (cell.max() + 1) * pose)), turned)


def _numbered(group: IntArray) -> IntArray:
    """Return groups (n,) numbered without gaps; -1 stays."""
    return np.asarray(np.where(group < 0, -1, np.searchsorted(np.unique(group[group >= 0]), group)))


def _bins(value: FloatArray, count: int) -> IntArray:
    """Group (n,) of each value among bins of equal width; -1 where it is unknown."""
    finite = np.isfinite(value)
    if not finite.any() or np.ptp(value[finite]) <= 0:
        return np.where(finite, 0, -1)
    part = (value - value[finite].min()) / np.ptp(value[finite]) * count
    return _numbered(np.where(finite, np.minimum(np.nan_to_num(part), count - 1), -1).astype(np.int64))


def _stage_bins(reading: FloatArray) -> IntArray:
    """Group (n,) of each reading of a stage's axis: itself where the axis takes few, else its bin."""
    distinct = np.round(reading / _SAME_READING_M).astype(np.int64)
    distinct -= distinct.min()
    return _numbered(distinct) if len(np.unique(distinct)) <= _BINS else _bins(reading, _BINS)


def _cells(place: FloatArray, count: int) -> IntArray:
    """Cell (n,) of places (n, 2), -1 where unknown; a dot of a coarse board is a cell of its own."""
    columns, rows = (_bins(axis, count) for axis in place.T)
    return _numbered(np.where((columns < 0) | (rows < 0), -1, columns + count * rows))


def _score(smooth: SmoothFit, labels: list[_Label]) -> tuple[FloatArray, FloatArray, FloatArray, FloatArray]:
    """Return u = Z' K^-1 y (k,) and A = Z' K^-1 Z for the columns Z of all labels, and how the fit follows them.

    The last two are the changes (2, columns, k) of an output's coefficients and (side, k) of the unknowns of both.
    """
    readings, posterior, residual = smooth.readings, smooth.posterior, smooth.residual
    width = sum(each.width for each in labels)
    score, information = np.zeros(width), np.zeros((width, width))
    by_axis, by_side = np.zeros((2, len(posterior.alone), width)), np.zeros((len(posterior.side_covariance), width))
    for rows, weight in readings.blocks_of_noise(smooth.kept):
        columns = np.concatenate([each.design(rows) for each in labels], axis=2)
        used = np.flatnonzero(columns.any(axis=(0, 1)))
        columns, side = columns[:, :, used], smooth.side_columns(rows)
        for axis in (0, 1):
            white = weight_values(weight, columns[:, axis])
            score[used] += white.T @ weight_values(weight, residual[rows, axis])
            information[np.ix_(used, used)] += white.T @ white
            weighted = weight_values(weight, white, transposed=True)
            by_side[:, used] += side[:, axis].T @ weighted
            if not readings.mixed:
                by_axis[axis][:, used] += readings.design(rows).T @ weighted
    square = smooth.noise**2
    score, information, by_axis, by_side = (each / square for each in (score, information, by_axis, by_side))
    follow = posterior.alone @ by_axis  # change of the coefficients, if the side unknowns were known
    if not readings.mixed:
        information -= sum(each.T @ moved for each, moved in zip(by_axis, follow, strict=True))
        by_side = by_side + np.einsum("osc,ocg->sg", posterior.by_side, by_axis)
    of_side = posterior.side_covariance @ by_side
    information -= by_side.T @ of_side
    follow += posterior.by_side.transpose(0, 2, 1) @ of_side
    return score, information, follow, of_side


def _effect(smooth: SmoothFit, follow: FloatArray, of_side: FloatArray) -> FloatArray:
    """Return the change (r, 2, k) of the model at some readings, arcminutes, from changes of its unknowns."""
    readings, parameters, own = smooth.readings, smooth.readings.parameters, smooth.readings.coefficients
    rows = _sample(smooth)
    change = readings.shared_columns(rows)[:, :, :parameters] @ of_side[:parameters]
    if own:
        change += (readings.design(rows)[:, :own] @ follow[:, :own]).transpose(1, 0, 2)
    return np.asarray(change * readings.metric[rows, None, None])


def _sample(smooth: SmoothFit) -> IntArray:
    return np.random.default_rng(0).permutation(len(smooth.readings))[:_SAMPLES]


def _absorbed(score: FloatArray, information: FloatArray, part: slice, size: float) -> tuple[FloatArray, FloatArray]:
    """Return u and A of a fit with further unknowns: the errors of one label, of a size."""
    inner = information[part, part] + np.eye(part.stop - part.start) / size**2
    gain = np.linalg.solve(inner, information[part]).T
    return score - gain @ score[part], information - gain @ information[part]


def _judged(score: FloatArray, information: FloatArray, noise: float) -> tuple[float, float, float]:
    """Return what a label's part of u and A says of its errors.

    Returns:
        The mean square of u over its expectation without errors, log10 odds for errors, and their most probable size
        per axis in arcminutes, 0 where they are not more probable than none.
    """
    values, vectors = np.linalg.eigh(information)
    determined = values >= _DETERMINED * values[-1]
    values, power = np.maximum(values[determined], 0.0)[:, None], ((vectors[:, determined].T @ score) ** 2)[:, None]
    square = (noise * _SIZES) ** 2
    odds = 0.5 * np.sum(square * power / (1.0 + square * values) - np.log1p(square * values), axis=0)
    best = float(odds.max())
    mean = float(best + np.log(np.mean(np.exp(odds - best))))
    size = noise * float(_SIZES[np.argmax(odds)]) if best > 0 else 0.0
    return float(power.sum() / max(values.sum(), 1e-300)), mean / float(np.log(10.0)), size
