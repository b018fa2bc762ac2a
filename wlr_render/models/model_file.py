"""Model files: the fitted models of one or both eyes of a headset in one JSON text that needs no special reader.

    format "wlr-eye-model", version 3, package_version, frame "openxr", device
    units              {length "m", direction "tangent", pixel "px"}
    eyes               one or two of
        eye            "left" or "right"
        name           of the model
        eye_box        {centre_m, size_m}
        display        {kind, panel {width_px, height_px}, base_plane {z_m, slope} (planar only), its polynomials, and
                       spread if the model has one}
        see_through    {kind, base_plane {z_m, slope} (planar only), its polynomials, and spread if the model has one}
        report         residuals that the calibration reported, in free form

display or see_through is omitted where it was not calibrated.

Versions 1 and 2 are still read. Version 1 has the keys of its single eye in the header. Both have base planes without
slope and polynomials with the `degree` up to which they hold all terms, and call a display's `backward_start`
`backward`; their see-through `backward` is not used. They have no spread.

Kinds and the inputs and outputs of their polynomials are defined by the classes in this package. A polynomial is
{low, high, terms}: inputs are scaled linearly so that low..high becomes -1..1, and its value is the sum over
terms of `values` (one per output) times the product over inputs of Chebyshev T_k, with k from `orders`. Numbers are
written so that they are read back exactly.

A spread {apart, joint, shared, sources} is the covariance of the values of the mapping's first polynomial (`forward`,
`deviation` or `point`) as two tables of factors, either of which may be absent:

    {orders (absent if they are the polynomial's), unit, values}

Factor c at given inputs is unit[c] times the sum over terms of values[term][c] times the term's product of T_k, with
`low` and `high` of the polynomial; `values` are whole numbers of up to five digits. The polynomial has m outputs, x and
y in turn. `joint` has m r factors: number o r + j is the change of output o by random variable j. `apart` has m r / 2:
number b r + j is the change of outputs 2 b and 2 b + 1, by random variables j of the x and of the y axis. All variables
are independent and standard normal, and the first `shared` of `joint` are the same ones in the eye's display and
see-through. `sources` names the source of error of each of them, assembly errors of a prescription if it is absent. The
covariance of outputs o and p is therefore

    C[o][p] = sum_j joint[o r + j] joint[p r + j]  +  sum_j apart[b r + j] apart[c r + j] if o - p is even

where b and c are o and p halved and rounded down.

The standard error of a view direction follows: with S the (2, m) derivative of its tangents t = (tx, ty) by the
outputs, and V = S C S', its square is, in radians squared,

    ((1 + ty^2) V[0][0] - 2 tx ty V[0][1] + (1 + tx^2) V[1][1]) / (1 + tx^2 + ty^2)^2

S is the unit matrix for a static or volumetric display. The base-plane point p~ of a planar display moves with t, so
that S = (1 - F D)^-1, where F is the derivative of `forward` by p~ and D the derivative of p~ by t: d times the unit
matrix for a plane without slope that lies d metres in front of the viewpoint. Of a see-through, S = -(dG/dt)^-1 (1, 1 /
Z), where G(t) = 0 is the equation that the class solves for a point at depth Z; e.g. G = t + A + B / Z - (P - p~) / Z
if planar.
"""

import json
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, fields
from importlib import metadata
from pathlib import Path
from typing import Any

import numpy as np

from wlr_render.atomic_files import write_text
from wlr_render.errors import BadInputError
from wlr_render.geometry.planes import BasePlane
from wlr_render.html_summary import SummaryTable, html_summary
from wlr_render.input_files import as_bad_input, require_pixels
from wlr_render.mappings import DisplayMapping, Eye, EyeBox, Panel, SeeThroughMapping
from wlr_render.models.absent import AbsentDisplay, AbsentSeeThrough
from wlr_render.models.bundle import BundleDisplay, BundleSeeThrough
from wlr_render.models.fitted_model import Forms
from wlr_render.models.plausible import plausible_eye_box, require_plausible_plane, require_plausible_values
from wlr_render.models.point_per_pixel import PointPerPixelDisplay
from wlr_render.models.spread import PRESCRIPTION, Covariance
from wlr_render.models.static import StaticDisplay, StaticSeeThrough
from wlr_render.models.volumetric import VolumetricDisplay, VolumetricSeeThrough
from wlr_render.numerics.arrays import FloatArray, IntArray
from wlr_render.numerics.polynomial import HIGHEST_ORDER, Box, Polynomial, term_count, total_degree
from wlr_render.toml_files import Table, read_json

FORMAT = "wlr-eye-model"
VERSION = 3
_BACKWARD = "backward"  # key of versions 1 and 2: the polynomial that answered backward queries
_DIGITS = 5  # significant digits of a spread's factors
_LARGEST_SPREAD = 100.0  # largest plausible factor of a spread, radians or metres
_MOST_TERMS = 10_000
_UNITS = {"length": "m", "direction": "tangent", "pixel": "px"}

# A new model only needs a line here: its fields and FORMS define its form in the file.
DISPLAYS: dict[str, type[Any]] = {
    "planar": BundleDisplay,
    "volumetric": VolumetricDisplay,
    "static": StaticDisplay,
    "point-per-pixel": PointPerPixelDisplay,
}
SEE_THROUGHS: dict[str, type[Any]] = {
    "planar": BundleSeeThrough,
    "volumetric": VolumetricSeeThrough,
    "static": StaticSeeThrough,
}


@dataclass(frozen=True)
class EyeModel:
    """Fitted mappings of one eye, with the device name and the report of the fit.

    Attributes:
        mappings: display and see-through, each one of this package's models.
        device: device name.
        report: JSON-ready figures of the fit; stored, never interpreted.
    """

    mappings: Eye
    device: str
    report: Mapping[str, Any] = field(default_factory=dict)

    def _repr_html_(self) -> str:
        columns = ("fitted", "kind", "terms", "camera positions", "noise (arcmin)", "predicted error, rms (arcmin)")
        sides = (("display", self.mappings.display, DISPLAYS), ("see_through", self.mappings.see_through, SEE_THROUGHS))
        rows = [[name.replace("_", "-"), *self._fitted(name, mapping, kinds)] for name, mapping, kinds in sides]
        fitted = SummaryTable(columns, rows)
        return html_summary(
            f"Model of {self.device}, {self.mappings.eye} eye: {self.mappings.name}",
            [],
            [self.mappings.summary, fitted],
        )

    def _fitted(self, name: str, mapping: object, kinds: dict[str, type[Any]]) -> list[str]:
        """Return the table cells of one mapping; a dash for each number that the report lacks."""
        kind = next((kind for kind, model in kinds.items() if isinstance(mapping, model)), "")
        if not kind:
            return ["not calibrated", "-", "-", "-", "-"]
        modelled, report = getattr(mapping, _modelled(kinds[kind])), self.report.get(name)
        terms = str(len(modelled.orders)) if isinstance(modelled, Polynomial) else "-"
        values = [report.get(key) if isinstance(report, Mapping) else None for key in _SHOWN]
        return [kind, terms, *(f"{each:.3g}" if isinstance(each, int | float) else "-" for each in values)]


_SHOWN = ("viewpoints", "noise_arcmin", "predicted_arcmin")  # keys of the report that a summary shows


def save_eye_models(path: str | Path, models: Sequence[EyeModel]) -> Path:
    """Write a model file atomically.

    Raises:
        BadInputError: two models of one eye or of two devices, a mapping that is not one of this package's models, or a
            folder that cannot be written.
    """
    by_eye = {model.mappings.eye: model for model in models}
    devices = {model.device for model in models}
    if len(by_eye) != len(models) or len(devices) != 1:
        raise BadInputError(f"{path}: a model file holds one model of each eye of one device; write one file each.")
    record = {
        "format": FORMAT,
        "version": VERSION,
        "package_version": metadata.version("wlr_render"),
        "frame": "openxr",
        "units": _UNITS,
        "device": devices.pop(),
        "eyes": [_eye_record(by_eye[eye]) for eye in sorted(by_eye)],
    }
    return write_text(path, _json_text(record) + "\n")


def add_eye_models(path: str | Path, models: Sequence[EyeModel]) -> tuple[str, ...]:
    """Add models to a file, keeping its models of other eyes of the same device; returns the eyes that were kept.

    Raises:
        BadInputError: as `save_eye_models`, or as `load_eye_models` for a file that is there.
    """
    new = {model.mappings.eye for model in models}
    present = load_eye_models(path) if Path(path).exists() else {}
    kept = [model for eye, model in present.items() if eye not in new and model.device == models[0].device]
    save_eye_models(path, [*kept, *models])
    return tuple(model.mappings.eye for model in kept)


def remove_eye_models(path: str | Path, eyes: Sequence[str]) -> None:
    """Remove the models of some eyes from a file; the file goes with its last model."""
    kept = [model for eye, model in load_eye_models(path).items() if eye not in eyes] if Path(path).exists() else []
    if kept:
        save_eye_models(path, kept)
    else:
        Path(path).unlink(missing_ok=True)


def load_eye_model(path: str | Path, eye: str | None = None) -> EyeModel:
    """Read one eye of a model file: the requested eye, or the only one.

    Raises:
        BadInputError: as `load_eye_models`, or the file lacks that eye, or has both eyes and none was requested.
    """
    models = load_eye_models(path)
    if eye is None and len(models) > 1:
        raise BadInputError(f"{path}: holds models of both eyes; say which one is meant: left or right.")
    if eye is not None and eye not in models:
        (only,) = models
        raise BadInputError(
            f"{path}: is a model of the {only} eye; the {eye} eye was asked for: calibrate it into the same folder, "
            f"or choose the {only} eye."
        )
    return models[eye or next(iter(models))]


def load_eye_models(path: str | Path) -> dict[str, EyeModel]:
    """Read a model file; returns its models by eye.

    Raises:
        BadInputError: the file cannot be read, is truncated, has another format or version, or lacks a key.
    """
    table = read_json(path, "a model file")
    version = _check_header(table)
    device = table.text("device")
    eyes = [table] if version == 1 else table.tables("eyes", most=2)
    models = [_eye_model(eye, device, version) for eye in eyes]
    for read in (table, *eyes):
        read.finish()
    by_eye = {model.mappings.eye: model for model in models}
    if not 1 <= len(by_eye) == len(models):
        present = ", ".join(model.mappings.eye for model in models) or "none"
        raise table.fail(f"'eyes' must hold one model, or one of each eye, not {present}; calibrate again.")
    return by_eye


def _eye_record(model: EyeModel) -> dict[str, Any]:
    eye = model.mappings
    record: dict[str, Any] = {
        "eye": eye.eye,
        "name": eye.name,
        "eye_box": {"centre_m": eye.eye_box.centre.tolist(), "size_m": eye.eye_box.size.tolist()},
    }
    if not isinstance(eye.display, AbsentDisplay):
        record["display"] = _mapping_record(eye.display, DISPLAYS)
    if not isinstance(eye.see_through, AbsentSeeThrough):
        record["see_through"] = _mapping_record(eye.see_through, SEE_THROUGHS)
    return record | {"report": dict(model.report)}


def _eye_model(table: Table, device: str, version: int) -> EyeModel:
    eye_box = plausible_eye_box(table.table("eye_box"))
    display: DisplayMapping = AbsentDisplay()
    see_through: SeeThroughMapping = AbsentSeeThrough()
    if table.has("display") or not table.has("see_through"):
        display = _mapping(table.table("display"), DISPLAYS, eye_box, version)
    if table.has("see_through"):
        see_through = _mapping(table.table("see_through"), SEE_THROUGHS, eye_box, version)
    mappings = Eye(table.text("name"), table.text("eye", choices=["left", "right"]), display, see_through, eye_box)
    report = table.raw_table("report")
    with as_bad_input(f"{table.where}: 'report'", "plain JSON", "calibrate again"):
        json.dumps(report, allow_nan=False)  # refuses a report that could not be written again
    return EyeModel(mappings, device, report)


def _check_header(table: Table) -> int:
    """Check that a file is a model file; returns its version."""
    if table.text("format", default="missing") != FORMAT:
        raise table.fail(f"is not a model file: its format is not '{FORMAT}'; name one that calibration wrote.")
    if (version := table.number("version")) not in range(1, VERSION + 1):
        raise table.fail(f"has version {version:g}; this program reads versions 1 to {VERSION}: calibrate again.")
    table.text("package_version")
    table.text("frame", choices=["openxr"])
    units = table.table("units")
    for quantity, unit in _UNITS.items():
        units.text(quantity, choices=[unit])
    units.finish()
    return int(version)


def _json_text(value: Any, margin: str = "\n") -> str:
    """Return JSON with a line for each entry, and lists without nested tables or lists on one line."""
    if isinstance(value, dict) and value:
        entries = [f"{json.dumps(key)}: {_json_text(entry, margin + ' ')}" for key, entry in value.items()]
        opening, closing = "{}"
    elif isinstance(value, list) and any(isinstance(entry, dict | list) for entry in value):
        entries, opening, closing = [_json_text(entry, margin + " ") for entry in value], "[", "]"
    else:
        return json.dumps(value, allow_nan=False, separators=(",", ":"))
    return f"{opening}{margin} " + f",{margin} ".join(entries) + f"{margin}{closing}"


def _mapping_record(mapping: object, kinds: dict[str, type[Any]]) -> dict[str, Any]:
    for kind, model in kinds.items():
        if isinstance(mapping, model):
            record = {"kind": kind} | {name: _record(getattr(mapping, name)) for name in _part_names(model)}
            if mapping.spread is None:
                return record
            return record | {"spread": _spread_record(mapping.spread, getattr(mapping, _modelled(model)))}
    raise BadInputError(f"a {type(mapping).__name__} cannot be written to a model file; only {', '.join(kinds)} can.")


def _part_names(model: type[Any]) -> list[str]:
    return [f.name for f in fields(model) if f.name not in ("eye_box", "spread")]


def _modelled(model: type[Any]) -> str:
    """Return the name of the polynomial that the spread belongs to."""
    forms: Forms = model.FORMS
    return next(iter(forms))


def _spread_record(spread: Covariance, polynomial: Polynomial) -> dict[str, Any]:
    tables = {"apart": spread.apart, "joint": spread.joint}
    records = {name: _factors_record(each, polynomial) for name, each in tables.items() if each.coefficients.size}
    sources = {"sources": list(spread.sources)} if spread.sources else {}
    return {"shared": spread.shared, **sources, **records}


def _factors_record(factors: Polynomial, polynomial: Polynomial) -> dict[str, Any]:
    """Return the factors as whole numbers, each factor in a power of ten that gives its largest `_DIGITS` digits."""
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
    if isinstance(part, Panel):
        return {"width_px": part.width_px, "height_px": part.height_px}
    if isinstance(part, BasePlane):
        return {"z_m": part.z, "slope": list(part.slope)}
    if not isinstance(part, Polynomial):
        raise BadInputError("only models made of polynomials can be written to a model file; this one is not.")
    orders, values = part.orders.tolist(), part.coefficients.tolist()
    return {
        "low": part.box.low.tolist(),
        "high": part.box.high.tolist(),
        "terms": [{"orders": o, "values": v} for o, v in zip(orders, values, strict=True)],
    }


def _mapping(table: Table, kinds: dict[str, type[Any]], eye_box: EyeBox, version: int) -> Any:
    model = kinds[table.text("kind", choices=list(kinds))]
    forms: Forms = model.FORMS
    old = {"backward_start": _BACKWARD} if version < VERSION else {}
    parts = {name: _part(table.table(old.get(name, name)), name, forms) for name in _part_names(model)}
    if version < VERSION:
        table.raw(_BACKWARD)
    require_plausible_values(table, parts, _modelled(model) if kinds is DISPLAYS else "")
    modelled, spread = parts[_modelled(model)], None
    if table.has("spread") and isinstance(modelled, Polynomial):
        spread = _spread(table.table("spread"), modelled)
    table.finish()
    return model(eye_box=eye_box, **parts, spread=spread)


def _spread(table: Table, polynomial: Polynomial) -> Covariance:
    outputs = polynomial.coefficients.shape[1]
    apart = _factors(table, "apart", polynomial, outputs // 2)
    joint = _factors(table, "joint", polynomial, outputs)
    shared, variables = table.whole("shared"), joint.coefficients.shape[1] // outputs
    if shared > variables:
        raise table.fail(f"'shared' is {shared}, but 'joint' has {variables} variables; calibrate again.")
    sources = tuple(table.texts("sources")) if table.has("sources") else (PRESCRIPTION,) * shared
    if len(sources) != shared:
        raise table.fail(f"'sources' names {len(sources)} variables, but 'shared' is {shared}; calibrate again.")
    table.finish()
    return Covariance(outputs, apart, joint, sources)


def _factors(parent: Table, name: str, polynomial: Polynomial, outputs: int) -> Polynomial:
    """Read the factors of a spread, `outputs` of each variable."""
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


def _part(table: Table, name: str, forms: Forms) -> Panel | BasePlane | Polynomial:
    part: Panel | BasePlane | Polynomial
    if name == "panel":
        part = Panel(table.whole("width_px", 1), table.whole("height_px", 1))
        require_pixels(table.where, part.size_px, "calibrate again")
    elif name == "base_plane":
        slope_x, slope_y = table.vector("slope", 2, default=(0.0, 0.0))
        part = BasePlane(table.number("z_m"), (float(slope_x), float(slope_y)))
        require_plausible_plane(table, part)
    else:
        part = _polynomial(table, *forms[name])
    table.finish()
    return part


def _polynomial(table: Table, variables: int, outputs: int) -> Polynomial:
    box = Box(table.vector("low", variables), table.vector("high", variables))
    if not np.all(box.low < box.high):
        raise table.fail("'low' must be less than 'high' on every axis.")
    terms = table.tables("terms", most=_MOST_TERMS)
    if not terms:
        raise table.fail("'terms' is empty; write one term at least.")
    orders = _orders(table, np.array([term.row("orders", variables) for term in terms], dtype=np.float64))
    if table.has("degree"):  # version 1 or 2
        degree = table.whole("degree", most=HIGHEST_ORDER)
        if len(terms) != term_count(variables, degree) or not np.array_equal(orders, total_degree(variables, degree)):
            raise table.fail(
                f"'terms' must be all {term_count(variables, degree)} of total degree up to {degree}, ordered by it "
                "and by 'orders'."
            )
    return Polynomial(orders, box, np.array([term.row("values", outputs) for term in terms], dtype=np.float64))


def _orders(table: Table, read: FloatArray) -> IntArray:
    orders = read.astype(np.int64)
    if np.any(orders != read) or orders.min() < 0 or orders.max() > HIGHEST_ORDER:
        raise table.fail(f"'orders' must be whole numbers from 0 to {HIGHEST_ORDER}.")
    if len(np.unique(orders, axis=0)) != len(orders):
        raise table.fail("'terms' has the same 'orders' twice; write each term once.")
    return orders
