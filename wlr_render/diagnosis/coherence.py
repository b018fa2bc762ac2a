"""Effects too fine for a smooth field: residuals of different captures that agree at one place of a station.

A smooth surface is subtracted from every photograph. The residual is noise, independent from one capture to the next,
unless a fine structure is fixed to a station: then residuals of different captures in one cell of that station have a
common mean. The effect is at the station with the best odds for such means; the means are a map of the effect.
"""

from collections import Counter
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from itertools import product

import numpy as np

from wlr_render.diagnosis.combiner_fields import footprints
from wlr_render.diagnosis.field_terms import over_rows
from wlr_render.diagnosis.held_out import HeldOutImprovement, held_out_improvement
from wlr_render.diagnosis.observations import DISPLAY, PART_NAMES, SEE_THROUGH, Observations
from wlr_render.diagnosis.prediction import Predictor
from wlr_render.diagnosis.residual_surfaces import surfaces
from wlr_render.diagnosis.settings import BEYOND_DOUBT
from wlr_render.numerics.arrays import BoolArray, FloatArray, IntArray
from wlr_render.numerics.cells import cells_of
from wlr_render.numerics.polynomial import Box

_CLIP, _CLIP_OF_REST = 4.0, 8.0  # sigma at which residuals are clipped in the first round, and in later ones
_MOST_LEVERAGE = 0.8  # leverage of a reading on its photograph's surface beyond which its residual is not used
_COORDINATES = {
    "combiner": ("place on the combiner", "mm"),
    "camera": ("camera pixels", "px"),
    "panel": ("panel pixels", "px"),
    "target": ("place on the target", "mm"),
}
_CELLS_MM = (0.5, 1.0, 2.0)  # widths of cells on the combiner
_CELLS_PANEL = (80, 160)  # numbers of cells across the panel
_CELLS_CAMERA = (80, 160)  # numbers of cells across the image
_FOLDS, ROUNDS = 4, (1, 4)
_FEWEST_CAPTURES = 4  # fewest captures of a part in which cells are compared
_PREDICTS = 2.0  # standard errors by which held-out captures must be predicted better, where the odds leave doubt
_SPOT, _MOSTLY = 4.0, 0.5  # radius of a spot in cell widths, and the share of the power that it must contain
_BOX, _FEWEST_CELLS = 3.5, 3.0  # half width of the box around a spot, in its rms radii; smallest, in cells
_SHARES = (0.003, 0.01, 0.03, 0.1, 0.3, 1.0)  # shares of the cells that may have a mean
_SIZES = tuple(np.geomspace(0.02, 100.0, 18))  # variances of the means relative to the noise variance
_CELL_STANDS_OUT = 18.0  # sum of two squared unit normal variables that one cell in 8,000 exceeds


@dataclass(frozen=True, eq=False)
class FineEffect:
    """An effect that residuals of different captures have in common in cells of a station.

    Attributes:
        station: station at which it acts.
        part: part of the session that shows it best.
        meeting: number of the surface along the display's path on which the display's readings are placed.
        cell: width of a cell, in the unit.
        noise: noise variance per reading that the scatter of the cell means implies, in squares of sigma.
        cells: (c, 2) middles of the cells, in the unit.
        means: (c, 2) mean residual of each cell, in units of sigma.
        place, width: (2,) and (): middle of the cells that stand out, and their rms distance from it, in the unit;
            NaN where most of the station stands out.
        improvement, share_removed: improvement of held-out captures by the means of the others, and the share of the
            excess that the means remove.
        rows: (m,) indices of the readings that show it, in all parts.
        at: (m, 2) their places at the station.
        change: (m, 2) their change by the effect, in units of sigma.
        log10_odds: log10 odds for the effect against noise alone.
        next_station: the station with the next best evidence; empty without another station.
        odds_against_next: log10 odds against that station.
    """

    station: str
    part: str
    meeting: int
    cell: float
    noise: float
    cells: FloatArray
    means: FloatArray
    place: FloatArray
    width: float
    improvement: HeldOutImprovement
    share_removed: float
    rows: IntArray
    at: FloatArray
    change: FloatArray
    log10_odds: float = 0.0
    next_station: str = ""
    odds_against_next: float = 0.0

    @property
    def coordinates(self) -> str:
        """Name of the station's coordinates."""
        return _COORDINATES[self.station][0]

    @property
    def unit(self) -> str:
        """Unit of the station's coordinates."""
        return _COORDINATES[self.station][1]

    @property
    def spot_on_combiner(self) -> Box | None:
        """Box around the cells that stand out, if they form a spot on the combiner."""
        if self.station != "combiner" or not np.isfinite(self.width):
            return None
        half = max(_BOX * self.width, _FEWEST_CELLS * self.cell)
        return Box(self.place - half, self.place + half)

    @property
    def predicts(self) -> bool:
        """True if the effect improves the prediction of held-out captures."""
        return self.improvement.significance > _PREDICTS


@dataclass(frozen=True, eq=False)
class _Cells:
    """Readings of one part, assigned to the cells of one station.

    Attributes:
        station, part, meeting: as in `FineEffect`; `part` is a number.
        width: width of a cell.
        place: (m, 2) places of the readings at the station.
        left: (m, 2) their residuals about the photographs' surfaces.
        capture: (m,) their captures.
        rows: (m,) their indices among all readings.
        middles: (c, 2) middles of the cells that have readings.
        cell: (m,) index of each reading's cell.
    """

    station: str
    part: int
    meeting: int
    width: float
    place: FloatArray
    left: FloatArray
    capture: IntArray
    rows: IntArray
    middles: FloatArray
    cell: IntArray

    @cached_property
    def noise(self) -> float:
        """Noise variance per reading, estimated from the sum of each capture's readings in each cell.

        Sums are used because neighbours in one capture may share noise. Their mean square includes the tails of the
        noise, which a median would miss, and some of the effect, which makes the odds for the effect smaller.
        """
        both, count = self.cell * (int(self.capture.max()) + 1) + self.capture, np.ones(len(self.cell))
        owner = np.unique(both, return_inverse=True)[1]
        total = np.stack([np.bincount(owner, self.left[:, axis]) for axis in (0, 1)], axis=1)
        return float(np.mean(total**2 / np.bincount(owner, count)[:, None]))

    def sums(self, rows: BoolArray) -> tuple[FloatArray, FloatArray]:
        """Return the number (c,) of the selected readings in each cell, and the sum (c, 2) of their residuals."""
        count = np.bincount(self.cell[rows], minlength=len(self.middles)).astype(np.float64)
        total = [np.bincount(self.cell[rows], self.left[rows, axis], len(self.middles)) for axis in (0, 1)]
        return count, np.stack(total, axis=1)

    @cached_property
    def agreement(self) -> tuple[float, float, float]:
        """Log10 odds for cell means against noise alone, share of the cells with a mean, and its variance per axis.

        Share and variance are unknown; all values tried are equally likely a priori.
        """
        count, total = self.sums(np.ones(len(self.cell), dtype=bool))
        several = np.bincount(np.unique(np.stack([self.cell, self.capture]), axis=1)[0], minlength=len(count)) > 1
        if not several.any() or self.noise == 0.0:
            return 0.0, 0.0, 0.0
        count, square = count[several], np.sum(total[several] ** 2, axis=1) / self.noise
        logs, tried = [], list(product(_SHARES, _SIZES))
        for share, size in tried:
            logs.append(float(np.sum(np.logaddexp(*_log_likelihoods(count, square, share, size)))))
        best = int(np.argmax(logs))
        odds = (float(np.logaddexp.reduce(logs)) - np.log(len(tried))) / np.log(10.0)
        return odds, tried[best][0], tried[best][1] * self.noise

    def means(self, rows: BoolArray, share: float, variance: float) -> FloatArray:
        """Return the expected mean (c, 2) of each cell from the readings in a mask (m,)."""
        count, total = self.sums(rows)
        square, size = np.sum(total**2, axis=1) / self.noise, variance / self.noise
        none, some = _log_likelihoods(count, square, share, size)
        probable = np.exp(-np.logaddexp(0.0, none - some))
        return np.asarray(total * (probable * size / (1.0 + count * size))[:, None])


def _log_likelihoods(count: FloatArray, square: FloatArray, share: float, size: float) -> tuple[float, FloatArray]:
    """Return the log likelihood that a cell has no mean, and that each cell has one (c,), relative to noise alone.

    Args:
        count: (c,) number of readings in each cell.
        square: (c,) squared sums of their residuals, relative to the noise variance.
        share: share of the cells that have a mean.
        size: variance of the means, relative to the noise variance.
    """
    none = float(np.log1p(-share)) if share < 1.0 else -np.inf
    return none, np.log(share) - np.log1p(count * size) + 0.5 * square * size / (1.0 + count * size)


def _spot(middles: FloatArray, power: FloatArray, reach: float) -> tuple[FloatArray, float]:
    """Return the middle (2,) and the rms radius of the spot with most of the power; NaN if the power is spread out."""
    middles, power = middles[power > 0.0], power[power > 0.0]
    close = np.linalg.norm(middles[:, None, :] - middles, axis=2) < reach
    near = close @ power
    if not power.size or near.max() < _MOSTLY * power.sum():
        return np.full(2, np.nan), float("nan")
    weight = power * close[int(np.argmax(near))]
    place = weight @ middles / weight.sum()
    return place, float(np.sqrt(weight @ np.sum((middles - place) ** 2, axis=1) / weight.sum()))


def fine_effect(
    predictor: Predictor, residual: FloatArray, least_log10_odds: float, rounds: Sequence[int] = (1,)
) -> FineEffect | None:
    """Find an effect that is finer than any smooth field.

    Args:
        predictor: predictor of all readings, with the sigma of their noise; with outliers, which may be a fine effect.
        residual: (n, 2) residual after the causes, in units of sigma.
        least_log10_odds: least odds for reporting the effect.
        rounds: numbers of rounds of filling the cells; the one that predicts held-out captures best is used. One round
            removes little of an effect that is fixed to another station; more remove all of one fixed to its cells.

    Returns:
        The effect at the station where residuals agree most; None where they agree nowhere.
    """
    best: dict[tuple[str, int], _Cells] = {}
    tried = Counter[tuple[str, int]]()
    for cells in _all_cells(predictor, residual):
        of_part = cells.station, cells.part
        tried[of_part] += 1
        if of_part not in best or cells.agreement[0] > best[of_part].agreement[0]:
            best[of_part] = cells
    odds: dict[str, float] = {}
    for (station, part), cells in best.items():  # parts are independent, so that their log odds add
        charged = cells.agreement[0] - float(np.log10(tried[station, part]))
        odds[station] = odds.get(station, 0.0) + max(charged, 0.0)
    ranked = sorted(odds, key=lambda station: -odds[station])
    if not ranked or odds[ranked[0]] < least_log10_odds + np.log10(len(best)):
        return None
    shown = [each for each in best.values() if each.station == ranked[0] and each.agreement[0] > least_log10_odds]
    shown.sort(key=lambda each: -each.agreement[0])
    rival = ranked[1] if len(ranked) > 1 else ""
    described = [_described(predictor.observations, residual, shown, each) for each in rounds]
    found = replace(
        max(described, key=lambda each: each.improvement.significance),
        log10_odds=odds[ranked[0]],
        next_station=rival,
        odds_against_next=odds[ranked[0]] - odds.get(rival, 0.0),
    )
    # Readings of one point at one pixel may share an error in neighbouring captures without any effect at a station.
    is_plain = found.log10_odds > BEYOND_DOUBT or found.predicts
    return found if is_plain else None


def _described(observations: Observations, residual: FloatArray, parts: Sequence[_Cells], rounds: int) -> FineEffect:
    """Return the effect with its map and its improvement of held-out captures; the first part shows it best."""
    first, every = parts[0], np.ones(len(residual), dtype=bool)
    change = _change(observations, residual, parts, every, rounds)
    left = np.nan_to_num(_standardised(observations, residual - change)) + change
    count, total = replace(first, left=left[first.rows]).sums(every[first.rows])
    noise = replace(first, left=(left - change)[first.rows]).noise
    means = total / count[:, None]
    power = np.sum(means**2, axis=1) * count / first.noise
    place, width = _spot(first.middles, np.where(power > _CELL_STANDS_OUT, power, 0.0), _SPOT * first.width)
    improvement, share = _held_out(observations, residual, parts, change, rounds)
    rows = np.concatenate([each.rows for each in parts])
    return FineEffect(
        station=first.station,
        part=PART_NAMES[first.part],
        meeting=max(each.meeting for each in parts),
        cell=first.width,
        noise=noise,
        cells=first.middles,
        means=means,
        place=place,
        width=width,
        improvement=improvement,
        share_removed=share,
        rows=rows,
        at=np.concatenate([each.place for each in parts]),
        change=change[rows],
    )


def _change(
    observations: Observations, residual: FloatArray, parts: Sequence[_Cells], used: BoolArray, rounds: int
) -> FloatArray:
    """Return the change (n, 2) of all readings by the cell means of the readings in a mask (n,).

    Surfaces absorb some of the cell means, and wild readings are clipped; therefore each round averages the remaining
    residual in the cells again.
    """
    change = np.zeros(residual.shape)
    for number in range(rounds):
        clip = _CLIP_OF_REST if number else _CLIP
        left = np.nan_to_num(_standardised(observations, residual - change, clip))
        for cells in parts:
            _, share, variance = cells.agreement
            means = replace(cells, left=left[cells.rows]).means(used[cells.rows], share, variance)
            change[cells.rows] += means[cells.cell]
    return change


def _held_out(
    observations: Observations, residual: FloatArray, parts: Sequence[_Cells], change: FloatArray, rounds: int
) -> tuple[HeldOutImprovement, float]:
    """Return the improvement of held-out captures, and its ratio to the improvement of all captures by `change`."""
    rows = np.concatenate([each.rows for each in parts])
    group = observations.group[rows]
    names = np.unique(group)
    left, after = (
        np.nan_to_num(_standardised(observations, each, _CLIP_OF_REST)) for each in (residual, residual - change)
    )
    held_out = left.copy()
    for number in range(_FOLDS):
        out = np.isin(observations.group, names[number::_FOLDS])
        others = _change(observations, residual, parts, ~out, rounds)
        held_out[out] = np.nan_to_num(_standardised(observations, residual - others, _CLIP_OF_REST))[out]
    removed, excess = (float(np.sum(left[rows] ** 2) - np.sum(each[rows] ** 2)) for each in (held_out, after))
    return held_out_improvement(left[rows], held_out[rows], group), removed / max(excess, removed, 1e-9)


def _standardised(observations: Observations, residual: FloatArray, clip: float = _CLIP) -> FloatArray:
    """Return the standardised residual (n, 2) about the photographs' surfaces; NaN where the leverage is too large."""
    left, leverage = np.full(residual.shape, np.nan), np.ones(len(residual))
    for surface in surfaces(observations, residual):
        left[surface.rows], leverage[surface.rows] = surface.left, surface.leverage
    left[leverage >= _MOST_LEVERAGE] = np.nan
    return np.clip(left / np.sqrt(1.0 - leverage.clip(0.0, _MOST_LEVERAGE))[:, None], -clip, clip)


def _all_cells(predictor: Predictor, residual: FloatArray) -> Iterator[_Cells]:
    """Yield the cells of every station and width to try."""
    observations = predictor.observations
    left, group = _standardised(observations, residual), observations.group
    for part in (DISPLAY, SEE_THROUGH):
        judged = np.isfinite(left).all(axis=1) & (observations.part == part)
        if len(np.unique(group[judged])) < _FEWEST_CAPTURES:
            continue
        for station, place, widths, meeting in _places(predictor, part):
            rows = np.flatnonzero(judged & np.isfinite(place).all(axis=1))
            for width in widths if rows.size else ():
                cells = cells_of(place[rows], width)
                yield _Cells(station, part, meeting, width, place[rows], left[rows], group[rows], rows, *cells)


def _places(predictor: Predictor, part: int) -> Iterator[tuple[str, FloatArray, Sequence[float], int]]:
    """Yield stations that a part shows: name, places (n, 2), widths of cells, and `meeting` of `FineEffect`."""
    observations = predictor.observations
    nominal, plan, rows = observations.nominal, observations.session.plan, observations.part == part
    for meeting in range(len(nominal.optics.display.steps)) if part == DISPLAY else (0,):
        path = "display" if part == DISPLAY else ""
        yield "combiner", footprints(predictor, path, meeting), _CELLS_MM, meeting
    yield "camera", observations.image_place, [float(nominal.camera.size_px[0] / count) for count in _CELLS_CAMERA], 0
    if part == DISPLAY and observations.session.readings.panel_pixel is not None:
        widths = [float(nominal.optics.panel.pixels.width_px) / count for count in _CELLS_PANEL]
        yield "panel", over_rows(rows, observations.session.readings.panel_pixel, np.nan), widths, 0
    if part == SEE_THROUGH and plan.see_through is not None:
        pitch = float(np.median(nominal.target.pitch))
        place = 1e3 * pitch * plan.see_through.dot / nominal.target.pitch[plan.see_through.target_pose][:, None]
        yield "target", over_rows(rows, place, np.nan), [1e3 * pitch], 0
