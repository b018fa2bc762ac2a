"""Tables of fitted mappings in a model file: display or see-through, its polynomials and its spread.

The classes in this package define the inputs and outputs of the polynomials. A polynomial is
{low, high, terms}: inputs are scaled linearly so that low..high becomes -1..1, and its value is the sum over
terms of `values` (one per output) times the product over inputs of Chebyshev T_k, with k from `orders`.

A spread {apart, joint, shared, sources} is the covariance of the values of the mapping's first polynomial (`forward`,
`deviation` or `point`) as two tables of factors, either of which may be absent:

    {orders (absent if equal to the polynomial's), unit, values}

Factor c at given inputs is unit[c] times the sum over terms of values[term][c] times the term's product of T_k, with
`low` and `high` of the polynomial; `values` are whole numbers of up to five digits. The polynomial has m outputs, x and
y in turn. `joint` has m r factors: number o r + j is the change of output o by random variable j. `apart` has m r / 2:
number b r + j is the change of outputs 2 b and 2 b + 1, by random variables j of the x and of the y axis. All variables
are independent and standard normal, and the eye's display and see-through have the first `shared` variables of
`joint` in common. `sources` names the source of error of each shared variable. The covariance of outputs o and p is
therefore

    C[o][p] = sum_j joint[o r + j] joint[p r + j]  +  sum_j apart[b r + j] apart[c r + j] if o - p is even

where b and c are o and p halved and rounded down.

The standard error of a view direction follows: with S the (2, m) derivative of its tangents t = (tx, ty) by the
outputs, and V = S C S', its square is, in radians squared,

    ((1 + ty^2) V[0][0] - 2 tx ty V[0][1] + (1 + tx^2) V[1][1]) / (1 + tx^2 + ty^2)^2

S is the unit matrix for a static or volumetric display. The base-plane point p~ of a planar display moves with t, so
that S = (1 - F D)^-1, where F is the derivative of `forward` by p~ and D the derivative of p~ by t: d times the unit
matrix for a plane without slope that lies d metres in front of the viewpoint. For a see-through, S = -(dG/dt)^-1 (1, 1
/ Z), where G(t) = 0 is the equation that the class solves for a point at depth Z; e.g. G = t + A + B / Z - (P - p~) / Z
if planar.
"""

from collections.abc import Mapping
from typing import Any, TypeVar

import numpy as np

from wlr_render.errors import BadInputError
from wlr_render.geometry.planes import BasePlane
from wlr_render.io.file_records import read_record, record_keys
from wlr_render.io.input_files import require_pixels
from wlr_render.io.toml_files import Table
from wlr_render.mappings import EyeBox, Panel
from wlr_render.models.display_model import DisplayModel
from wlr_render.models.fitted_model import FittedDisplay, FittedModel
from wlr_render.models.model_place import NOWHERE, VIEWPOINT, ModelPlace
from wlr_render.models.plausible import require_plausible_values
from wlr_render.models.point_per_pixel import PointPerPixelDisplay
from wlr_render.models.see_through_model import SeeThroughModel
from wlr_render.models.spread import Covariance
from wlr_render.numerics.arrays import FloatArray, IntArray
from wlr_render.numerics.polynomial import HIGHEST_ORDER, Box, Polynomial, term_count, total_degree

_DIGITS = 5  # significant digits of a spread's factors
_LARGEST_SPREAD = 100.0  # largest plausible factor of a spread, radians or metres
_MOST_TERMS = 10_000
_PLACES = {"planar": None, "volumetric": VIEWPOINT, "static": NOWHERE}  # None: base plane of the file
_POINTS = "point-per-pixel"
_Model = TypeVar("_Model", bound=FittedModel)


def mapping_kind(mapping: object) -> str | None:
    """Return the kind of a fitted mapping in a model file; None for other mappings."""
    if isinstance(mapping, PointPerPixelDisplay):
        return _POINTS
    if not isinstance(mapping, DisplayModel | SeeThroughModel):
        return None
    return next((kind for kind, place in _PLACES.items() if place == mapping.place), "planar")


def mapping_record(mapping: object) -> dict[str, Any]:
    """Return the JSON object of a mapping, which `read_display` or `read_see_through` reads.

    Raises:
        BadInputError: mappings of this kind cannot be written.
    """
    if not isinstance(mapping, PointPerPixelDisplay | DisplayModel | SeeThroughModel):
        kinds = ", ".join([*_PLACES, _POINTS])
        raise BadInputError(f"a {type(mapping).__name__} cannot be written to a model file; only {kinds} can.")
    record = {"kind": mapping_kind(mapping)} | {name: _record(part) for name, part in _parts(mapping).items()}
    if mapping.spread is not None:
        record["spread"] = _spread_record(mapping.spread, mapping.modelled)
    return record


def _parts(mapping: PointPerPixelDisplay | DisplayModel | SeeThroughModel) -> dict[str, Panel | BasePlane | Polynomial]:
    if isinstance(mapping, PointPerPixelDisplay):
        return {"panel": mapping.panel, "point": mapping.point}
    plane: dict[str, Any] = {"base_plane": mapping.place} if isinstance(mapping.place, BasePlane) else {}
    if isinstance(mapping, SeeThroughModel):
        return plane | {"deviation" if plane else "forward": mapping.deviation}
    return {"panel": mapping.panel, **plane, "forward": mapping.forward, "backward_start": mapping.backward_start}


def _spread_record(spread: Covariance, polynomial: Polynomial) -> dict[str, Any]:
    tables = {"apart": spread.apart, "joint": spread.joint}
    records = {name: _factors_record(each, polynomial) for name, each in tables.items() if each.coefficients.size}
    sources = {"sources": list(spread.sources)} if spread.sources else {}
    return {"shared": spread.shared, **sources, **records}


def _factors_record(factors: Polynomial, polynomial: Polynomial) -> dict[str, Any]:
    """Return the factors as whole numbers in units of powers of ten; the largest value of each has `_DIGITS` digits."""
    if not (
        np.array_equal(factors.box.low, polynomial.box.low) and np.array_equal(factors.box.high, polynomial.box.high)
    ):
        raise ValueError("a spread and its polynomial must have the same box")
    largest = np.abs(factors.coefficients).max(axis=0)
    exponents = [int(f"{each:.{_DIGITS - 1}e}".partition("e")[2]) - _DIGITS + 1 if each else 0 for each in largest]
    unit = [float(f"1e{exponent}") for exponent in exponents]
    orders = {} if np.array_equal(factors.orders, polynomial.orders) else {"orders": factors.orders.tolist()}
    return orders | {"unit": unit, "values": np.rint(factors.coefficients / unit).astype(np.int64).tolist()}


def _record(part: Panel | BasePlane | Polynomial) -> dict[str, Any]:
    if isinstance(part, Panel | BasePlane):
        return record_keys(part)
    orders, values = part.orders.tolist(), part.coefficients.tolist()
    return {
        "low": part.box.low.tolist(),
        "high": part.box.high.tolist(),
        "terms": [{"orders": o, "values": v} for o, v in zip(orders, values, strict=True)],
    }


def read_display(table: Table, eye_box: EyeBox, version: int) -> FittedDisplay:
    """Read a display from its table in a model file of a version.

    Raises:
        BadInputError: a key is missing or unknown, or a value is not plausible.
    """
    kind = table.text("kind", choices=[*_PLACES, _POINTS])
    panel = read_record(Panel, panel_table := table.table("panel"))
    require_pixels(panel_table.where, panel.size_px, "calibrate again")
    if kind == _POINTS:
        point = _polynomial(table, "point", 2, 3)
        return _checked(table, PointPerPixelDisplay(panel, eye_box, point), {"point": point}, panel)
    place, start = _place(table, kind), "backward" if version == 1 else "backward_start"
    variables = 2 + place.coordinates
    forward, backward = _polynomial(table, "forward", variables, 2), _polynomial(table, start, variables, 2)
    parts = {"forward": forward, "backward_start": backward}
    return _checked(table, DisplayModel(panel, eye_box, place, forward, backward), parts, panel)


def read_see_through(table: Table, eye_box: EyeBox, version: int) -> SeeThroughModel:
    """Read a see-through mapping; see `read_display`."""
    kind = table.text("kind", choices=[*_PLACES])
    place, name = _place(table, kind), "deviation" if kind == "planar" else "forward"
    deviation = _polynomial(table, name, 2 + place.coordinates, 4)
    if version == 1:
        table.raw("backward")
    return _checked(table, SeeThroughModel(eye_box, place, deviation), {name: deviation})


def _place(table: Table, kind: str) -> ModelPlace:
    return _PLACES[kind] or read_record(BasePlane, table.table("base_plane"))


def _checked(table: Table, model: _Model, parts: Mapping[str, Polynomial], panel: Panel | None = None) -> _Model:
    """Check that the polynomials are plausible; return the model with the spread of the first, if the table has one."""
    require_plausible_values(table, parts, panel)
    if table.has("spread"):
        model = model.with_spread(_spread(table.table("spread"), next(iter(parts.values()))))
    table.finish()
    return model


def _spread(table: Table, polynomial: Polynomial) -> Covariance:
    outputs = polynomial.coefficients.shape[1]
    apart = _factors(table, "apart", polynomial, outputs // 2)
    joint = _factors(table, "joint", polynomial, outputs)
    shared, variables = table.whole("shared"), joint.coefficients.shape[1] // outputs
    if shared > variables:
        raise table.fail(f"'shared' is {shared}, but 'joint' has {variables} variables; calibrate again.")
    sources = tuple(table.texts("sources")) if table.has("sources") else ()
    if len(sources) != shared:
        raise table.fail(f"'sources' names {len(sources)} variables, but 'shared' is {shared}; calibrate again.")
    table.finish()
    return Covariance(outputs, apart, joint, sources)


def _factors(parent: Table, name: str, polynomial: Polynomial, outputs: int) -> Polynomial:
    """Read the factors of a spread, `outputs` per variable."""
    orders, box = polynomial.orders, polynomial.box
    if not parent.has(name):
        return Polynomial(orders, box, np.zeros((len(orders), 0)))
    table = parent.table(name)
    if table.has("orders"):
        orders = _orders(table, table.vectors("orders", orders.shape[1]))
    unit = table.numbers("unit")
    if not len(unit) or len(unit) % outputs or np.any(unit <= 0):
        raise table.fail(f"'unit' must hold positive numbers, {outputs} for each variable; calibrate again.")
    values = table.whole_numbers("values", (len(orders), len(unit)))
    if max((factors := values * unit).max(initial=0.0), -factors.min(initial=0.0)) > _LARGEST_SPREAD:
        raise table.fail(f"'unit' makes factors above {_LARGEST_SPREAD:g}; calibrate again.")
    table.finish()
    return Polynomial(orders, box, factors)


def _polynomial(parent: Table, name: str, variables: int, outputs: int) -> Polynomial:
    table = parent.table(name)
    box = Box(table.vector("low", variables), table.vector("high", variables))
    if not np.all(box.low < box.high):
        raise table.fail("'low' must be less than 'high' on every axis.")
    terms = table.tables("terms", most=_MOST_TERMS)
    if not terms:
        raise table.fail("'terms' is empty; write one term at least.")
    orders = _orders(table, np.array([term.vector("orders", variables) for term in terms]))
    if table.has("degree"):  # version 1
        degree = table.whole("degree", most=HIGHEST_ORDER)
        if len(terms) != term_count(variables, degree) or not np.array_equal(orders, total_degree(variables, degree)):
            raise table.fail(
                f"'terms' must be all {term_count(variables, degree)} of total degree up to {degree}, ordered by it "
                "and by 'orders'."
            )
    values = np.array([term.vector("values", outputs) for term in terms])
    table.finish()
    return Polynomial(orders, box, values)


def _orders(table: Table, read: FloatArray) -> IntArray:
    orders = read.astype(np.int64)
    if np.any(orders != read) or orders.min() < 0 or orders.max() > HIGHEST_ORDER:
        raise table.fail(f"'orders' must be whole numbers from 0 to {HIGHEST_ORDER}.")
    if len(np.unique(orders, axis=0)) != len(orders):
        raise table.fail("'terms' has the same 'orders' twice; write each term once.")
    return orders
