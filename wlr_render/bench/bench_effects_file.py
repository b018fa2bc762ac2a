"""Effects of a bench as `[[effect]]` tables of its file (format: docs/bench-session.md)."""

from typing import Any

import numpy as np

from wlr_render.bench.bench import Bench
from wlr_render.bench.bench_effects import KINDS, PARTS, AnyFunction, BenchEffect, EffectKind
from wlr_render.io.toml_files import Table
from wlr_render.numerics.arrays import FloatArray
from wlr_render.numerics.cells import Cells
from wlr_render.numerics.polynomial import HIGHEST_ORDER, Box, Polynomial
from wlr_render.numerics.waves import LocalWaves, Wave
from wlr_render.optics.combiner_form import SURFACES

_MOST_EFFECTS, _MOST_TERMS, _MOST_CELLS = 50, 1000, 50_000
_MOST_WITH_COVARIANCE = 300  # most coefficients of an effect with a covariance in the file
_ASYMMETRY = _BELOW_ZERO = 1e-6  # tolerances of a covariance, relative to the largest value and eigenvalue
_ANYWHERE = 1e6  # largest coordinate of a station without edges
_SHORTEST = 1e-6  # shortest period, in the unit of its coordinate
_DIGITS = 9  # digits of a covariance in the file


def effects_of(file: Table, bench: Bench) -> tuple[BenchEffect, ...]:
    """Read the [[effect]] tables of a bench file.

    Raises:
        BadInputError: a table breaks the format, or states coordinates outside its station.
    """
    return tuple(_effect(table, bench) for table in file.tables("effect", required=False, most=_MOST_EFFECTS))


def effect_keys(effect: BenchEffect) -> dict[str, Any]:
    """Return the keys of an effect's table; a function is stated as a polynomial."""
    function = effect.function.as_polynomial() if isinstance(effect.function, AnyFunction) else effect.function
    keys: dict[str, Any] = {"station": effect.station, "displaces": effect.displaces}
    keys |= {"part": effect.part} if effect.part else {}
    keys |= {name: getattr(effect, name) for name in ("target_pose", "channel") if getattr(effect, name) >= 0}
    keys |= {"meeting": effect.meeting} if effect.meeting else {}
    if isinstance(function, Cells):
        keys |= {"cell_size": function.size, "cells": function.middles}
    elif isinstance(function, Wave):
        keys |= {"along": function.axis, "period": function.period}
    else:
        name = "waves" if isinstance(function, LocalWaves) else "orders"
        keys |= {"low": function.box.low, "high": function.box.high, name: function.orders}
    keys |= {"coefficients": function.coefficients}
    if effect.covariance is None or len(effect.covariance) > _MOST_WITH_COVARIANCE:
        return keys
    return keys | {"covariance": [[float(f"{each:.{_DIGITS}g}") for each in row] for row in effect.covariance]}


def _effect(table: Table, bench: Bench) -> BenchEffect:
    station = table.text("station", choices=sorted({station for station, _ in KINDS}))
    displaces = table.text("displaces", choices=sorted(what for place, what in KINDS if place == station))
    kind = KINDS[station, displaces]
    if table.has("cells") and displaces in SURFACES:
        raise table.fail("a height of the combiner needs slopes, which 'cells' do not have; state 'orders' or 'waves'.")
    function: Polynomial | Cells | Wave | LocalWaves
    if table.has("period"):
        function = _wave(table, kind)
    else:
        function = _cells(table, kind) if table.has("cells") else _in_box(table, kind)
        _check_places(table, station, function, bench)
    covariance = _covariance(table, function.coefficients.size) if table.has("covariance") else None
    limits = {kind.limit: _limit(table, kind.limit, bench)} if kind.limit and table.has(kind.limit) else {}
    meetings, meeting = len(bench.optics.display.steps), 0
    if displaces == "view" and table.has("meeting"):
        meeting = table.whole("meeting", 0, max(meetings - 1, 0))
    table.finish()
    return BenchEffect(station, displaces, function, covariance=covariance, meeting=meeting, **limits)


def _limit(table: Table, name: str, bench: Bench) -> Any:
    """Read the value of `EffectKind.limit` to which an effect is limited."""
    if name == "part":
        return table.text(name, choices=PARTS)
    count = len(bench.target.pitch) if name == "target_pose" else len(bench.wavelengths_um)
    return table.whole(name, 0, max(count - 1, 0))


def _in_box(table: Table, kind: EffectKind) -> Polynomial | LocalWaves:
    variables = len(kind.per_coordinate)
    low, high = table.vector("low", variables), table.vector("high", variables)
    if not np.all(low < high):
        raise table.fail(f"'low' must be below 'high' in each of {kind.coordinates}.")
    key, least = ("waves", 1) if table.has("waves") else ("orders", 0)
    orders = table.vectors(key, variables)
    if len(orders) > _MOST_TERMS or not np.all(
        (orders == np.round(orders)) & (orders >= least) & (orders <= HIGHEST_ORDER)
    ):
        raise table.fail(
            f"'{key}' must be at most {_MOST_TERMS} lists of whole numbers from {least} to {HIGHEST_ORDER}, one for "
            f"each of {kind.coordinates}."
        )
    if least and orders.max() ** variables > _MOST_CELLS:
        raise table.fail(
            f"'waves' of {variables} coordinates must have orders of at most {int(_MOST_CELLS ** (1.0 / variables))}."
        )
    coefficients = _coefficients(table, kind, len(orders), _LISTS.format(len(orders), key))
    return (LocalWaves if least else Polynomial)(orders.astype(np.int64), Box(low, high), coefficients)


def _cells(table: Table, kind: EffectKind) -> Cells:
    middles = table.vectors("cells", len(kind.per_coordinate))
    if len(middles) > _MOST_CELLS:
        raise table.fail(f"'cells' has {len(middles)} lists; {_MOST_CELLS} is the most that is read: leave some out.")
    size = table.number("cell_size", above=0.0)
    cells = Cells(size, middles, _coefficients(table, kind, len(middles), _LISTS.format(len(middles), "cells")))
    if not cells.are_distinct:
        raise table.fail(f"two of 'cells' lie in one cell of 'cell_size' {size:g}; state each cell once.")
    return cells


def _wave(table: Table, kind: EffectKind) -> Wave:
    axis = table.whole("along", 0, len(kind.per_coordinate) - 1)
    period = table.number("period", least=_SHORTEST)
    return Wave(axis, period, _coefficients(table, kind, 2, "the sine and the cosine"))


_LISTS = "each of the {} lists of '{}'"


def _coefficients(table: Table, kind: EffectKind, count: int, lists: str) -> FloatArray:
    components = len(kind.per_displacement)
    coefficients = table.vectors("coefficients", components)
    if len(coefficients) != count:
        raise table.fail(
            f"'coefficients' must have one list of {components} numbers ({kind.displacement}) for {lists}, not "
            f"{len(coefficients)}."
        )
    return coefficients


def _check_places(table: Table, station: str, function: Polynomial | Cells | LocalWaves, bench: Bench) -> None:
    """Refuse coordinates that lie wholly outside the station."""
    key = "'cells'" if isinstance(function, Cells) else "'low' and 'high'"
    edges = {"panel": bench.optics.panel.pixels.size_px, "camera": bench.camera.size_px}
    most = edges.get(station, np.full(len(function.box.low), _ANYWHERE))
    least = np.zeros(len(most)) if station in edges else -most
    low, high = function.box.low[: len(most)], function.box.high[: len(most)]
    if np.all((low < most) & (high > least)):
        return
    stated = f"{_listed(low)} to {_listed(high)}"
    raise table.fail(
        f"{key} state coordinates from {stated}, outside the {station} ({_listed(least)} to {_listed(most)}): correct "
        "them."
    )


def _listed(values: FloatArray) -> str:
    return f"[{', '.join(f'{value:g}' for value in values)}]"


def _covariance(table: Table, count: int) -> FloatArray:
    if count > _MOST_WITH_COVARIANCE:
        raise table.fail(
            f"'covariance' is for at most {_MOST_WITH_COVARIANCE} coefficients, not {count}; leave it out."
        )
    matrix = table.vectors("covariance", count)
    if len(matrix) != count:
        raise table.fail(
            f"'covariance' has {len(matrix)} lists; it must have {count}, one for each coefficient, row by row."
        )
    largest = float(np.abs(matrix).max())
    if np.abs(matrix - matrix.T).max() > _ASYMMETRY * largest:
        raise table.fail("'covariance' is not symmetric; write the covariance of the coefficients, or leave it out.")
    values = np.linalg.eigvalsh(0.5 * (matrix + matrix.T))
    if values.min() < -_BELOW_ZERO * max(float(values.max()), largest):
        raise table.fail(
            f"'covariance' has the eigenvalue {values.min():.3g}, so that it is not a covariance: its variances or "
            "correlations are wrong; correct it, or leave it out."
        )
    return matrix
