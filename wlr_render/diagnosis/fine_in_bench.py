"""Fine effects in the form of bench effects: cells at a station, and the displacement in each cell."""

from dataclasses import replace

import numpy as np

from wlr_render.bench.bench import Bench
from wlr_render.bench.bench_effects import PARTS, BenchEffect
from wlr_render.bench.simulate_session import camera_orientations
from wlr_render.diagnosis.coherence import ROUNDS, FineEffect, fine_effect
from wlr_render.diagnosis.observations import DISPLAY, PART_NAMES, SEE_THROUGH
from wlr_render.diagnosis.prediction import Predictor
from wlr_render.diagnosis.station_fields import dot_lever
from wlr_render.geometry.directions import dir_of_tangents, tangents_of_dir
from wlr_render.numerics.arrays import BoolArray, FloatArray, IntArray
from wlr_render.numerics.cells import Cells, cells_of

_ROUNDS = 2  # rounds of cells, each finer than the one before
_STATED = 0.05  # change of a reading, in sigma, below which it is not used for the effect
_DISPLACES = {"panel": "shift", "camera": "shift", "target": "shift", "combiner": "view"}
_TO_FILE = {"panel": 1.0, "camera": 1.0, "target": 1.0, "combiner": 1e6}
UNITS = {"panel": "panel px", "camera": "px", "target": "mm", "combiner": "urad"}
"""Units of the displacements by fine effects, by station."""


def with_fine(bench: Bench, fine: FineEffect | None, as_stated: Predictor, least_log10_odds: float) -> Bench:
    """Add a fine effect to a bench, and then finer cells of its residual, if they improve held-out captures.

    Args:
        bench: the bench.
        fine: the effect found with this bench.
        as_stated: predictor of all readings, with the noise as stated.
        least_log10_odds: see `fine_effect`.
    """
    for _ in range(_ROUNDS):
        if fine is None or not fine.predicts:
            break
        bench = replace(bench, effects=(*bench.effects, *fine_in_bench(fine, as_stated)))
        fine = fine_effect(as_stated, as_stated.residual_of_bench(bench), least_log10_odds, ROUNDS)
    return bench


def fine_in_bench(fine: FineEffect, predictor: Predictor) -> tuple[BenchEffect, ...]:
    """Return the bench effects that do the same as a fine effect, one for each part of the session that shows it.

    Args:
        fine: the effect.
        predictor: predictor of all readings, with the sigma of the effect.
    """
    part = predictor.observations.part[fine.rows]
    effects = [_of_part(fine, predictor, int(number), part == number) for number in np.unique(part)]
    return tuple(effect for effect in effects if effect is not None)


def size_of(fine: FineEffect, predictor: Predictor) -> tuple[float, float]:
    """Return the rms displacement by a fine effect over the readings of its part, with its standard error.

    For a spot, return the displacement in its strongest cell. See `UNITS` for the unit.

    Args:
        fine: the effect.
        predictor: predictor of all readings, with the sigma of the effect.
    """
    part = PART_NAMES.index(fine.part)
    mine, strength = predictor.observations.part[fine.rows] == part, np.linalg.norm(fine.change, axis=1)
    if np.isfinite(fine.width):
        cell = cells_of(fine.at, fine.cell)[1]
        mine &= cell == cell[np.argmax(np.where(mine, strength, 0.0))]
    displaced = _displacement(fine.station, predictor, part, fine.rows[mine], fine.change[mine])
    size = _TO_FILE[fine.station] * float(np.sqrt(np.mean(np.sum(displaced**2, axis=1))))
    relative = np.sqrt(fine.noise / np.sum(mine)) / max(np.sqrt(np.mean(strength[mine] ** 2)), np.finfo(float).tiny)
    return size, size * float(relative)


def _of_part(fine: FineEffect, predictor: Predictor, part: int, mine: BoolArray) -> BenchEffect | None:
    """Return the bench effect from the readings of one part, in a mask (m,); None if it does not move them."""
    mine = mine & (np.linalg.norm(fine.change, axis=1) > _STATED)
    if not mine.any():
        return None
    station, per_unit = fine.station, 1.0
    displaced = _TO_FILE[station] * _displacement(station, predictor, part, fine.rows[mine], fine.change[mine])
    middles, cell = cells_of(fine.at[mine], fine.cell)
    values = np.stack([np.bincount(cell, each) for each in displaced.T], axis=1) / np.bincount(cell)[:, None]
    if station == "target":
        per_unit = 1e-3 / float(np.median(predictor.observations.nominal.target.pitch))
    function = Cells(per_unit * fine.cell, per_unit * middles, values)
    in_one = "" if station in ("panel", "target") else PARTS[part]
    meeting = fine.meeting if part == DISPLAY else 0
    return BenchEffect(station, _DISPLACES[station], function, part=in_one, meeting=meeting)


def _displacement(station: str, predictor: Predictor, part: int, rows: IntArray, change: FloatArray) -> FloatArray:
    """Return the displacement (m, components) at a station that changes readings of one part by `change` (m, 2) sigma.

    Units: panel and camera in pixels, the target in millimetres, the view in tangents.
    """
    observations = predictor.observations
    change = change * observations.sigma_px[rows, None]
    of_part = rows - int(np.flatnonzero(observations.part == part)[0])
    image_moves = -change if part == DISPLAY else change  # a panel point moves opposite to its reading
    if station == "camera":
        return image_moves
    if station == "panel":
        return np.asarray(np.einsum("nij,nj->ni", observations.panel_from_camera[of_part], change))
    if station == "target":
        dots = observations.session.plan.see_through
        assert dots is not None
        lever = (dot_lever(predictor, dots) * observations.sigma_of(SEE_THROUGH)[:, :, None])[of_part]
        across = np.linalg.solve(lever[:, :, :2], change[:, :, None])[:, :, 0]
        return np.concatenate([across, np.zeros((len(across), 1))], axis=1)
    bench, place = observations.nominal, observations.image_place[rows]
    plan = observations.session.plan.display if part == DISPLAY else observations.session.plan.see_through
    assert plan is not None
    turned = camera_orientations(bench, plan)[of_part]
    seen, moved = (
        tangents_of_dir(np.einsum("nij,nj->ni", turned, dir_of_tangents(bench.camera.tangents_of_pixel(each))))
        for each in (place, place + image_moves)
    )
    return np.asarray(moved - seen)
