"""Eye models as files: one JSON text per eye, readable without this package.

    format "wlr-eye-model", version 1, package_version, frame "openxr", name, device, eye
    units        {length "m", direction "tangent", pixel "px"}
    eye_box      {centre_m, size_m}
    display      {kind, panel {width_px, height_px}, base_plane {z_m} (planar only), and its polynomials}
    see_through  {kind, base_plane {z_m} (planar only), and its polynomials}
    report       what the calibration said about its errors, in free form

Kinds and the inputs and outputs of their polynomials are those of the classes in this package. A polynomial is
{degree, low, high, terms}: inputs are scaled linearly so that low..high becomes -1..1, and its value is the sum over
terms of `values` (one per output) times the product over inputs of Chebyshev T_k, with k from `orders`. Numbers are
written so that they read back bit for bit.
"""

import json
from collections.abc import Mapping
from dataclasses import dataclass, field, fields
from importlib import metadata
from pathlib import Path
from typing import Any

import numpy as np

from wlr_render.errors import BadInputError
from wlr_render.files import Table, write_text
from wlr_render.geometry.planes import BasePlane
from wlr_render.mappings import EyeBox, EyeMappings, Panel
from wlr_render.models.display import BundleDisplay
from wlr_render.models.point_per_pixel import PointPerPixelDisplay
from wlr_render.models.queries import Forms
from wlr_render.models.see_through import BundleSeeThrough
from wlr_render.models.static import StaticDisplay, StaticSeeThrough
from wlr_render.models.volumetric import VolumetricDisplay, VolumetricSeeThrough
from wlr_render.numerics.polynomial import Box, Polynomial, exponents, term_count

FORMAT = "wlr-eye-model"
VERSION = 1
_UNITS = {"length": "m", "direction": "tangent", "pixel": "px"}

# A new model needs a line here and nothing else: its fields and FORMS say how it is written.
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
    """Fitted mappings of one eye with what is known about them.

    Attributes:
        mappings: display and see-through, each one of this package's models.
        device: device name.
        report: JSON-ready figures of the fit; carried, never interpreted.
    """

    mappings: EyeMappings
    device: str
    report: Mapping[str, Any] = field(default_factory=dict)


def save_eye_model(path: str | Path, model: EyeModel) -> Path:
    """Write a model file whole or not at all.

    Raises:
        BadInputError: a mapping is not one of this package's models, or the folder cannot be written.
    """
    eye = model.mappings
    record = {
        "format": FORMAT,
        "version": VERSION,
        "package_version": metadata.version("wlr_render"),
        "frame": "openxr",
        "units": _UNITS,
        "name": eye.name,
        "device": model.device,
        "eye": eye.eye,
        "eye_box": {"centre_m": eye.eye_box.centre.tolist(), "size_m": eye.eye_box.size.tolist()},
        "display": _mapping_record(eye.display, DISPLAYS),
        "see_through": _mapping_record(eye.see_through, SEE_THROUGHS),
        "report": dict(model.report),
    }
    return write_text(path, json.dumps(record, indent=1, allow_nan=False) + "\n")


def load_eye_model(path: str | Path) -> EyeModel:
    """Read a model file.

    Raises:
        BadInputError: the file cannot be read, is cut short, is something else or of another version, or lacks a key.
    """
    content = _read_json(path)
    report = content.pop("report", {})
    table = Table(content, str(path))
    _check_header(table)
    box = table.table("eye_box")
    eye_box = EyeBox(box.vector("centre_m", 3), box.vector("size_m", 3))
    eye = EyeMappings(
        name=table.text("name"),
        eye=table.text("eye", choices=["left", "right"]),
        display=_mapping(table.table("display"), DISPLAYS, eye_box),
        see_through=_mapping(table.table("see_through"), SEE_THROUGHS, eye_box),
        eye_box=eye_box,
    )
    device = table.text("device")
    table.finish()
    if not isinstance(report, dict):
        raise table.fail("'report' must be an object.")
    return EyeModel(eye, device, report)


def _read_json(path: str | Path) -> dict[str, Any]:
    try:
        content = json.loads(Path(path).read_text(encoding="utf-8"))
    except OSError as error:
        raise BadInputError(f"{path}: cannot be read ({error.strerror}).") from error
    except (json.JSONDecodeError, UnicodeDecodeError) as error:
        raise BadInputError(f"{path}: is not a model file, or is cut short ({error}); write it again.") from error
    if not isinstance(content, dict):
        raise BadInputError(f"{path}: is not a model file (its JSON is not an object).")
    return content


def _check_header(table: Table) -> None:
    if table.text("format", default="missing") != FORMAT:
        raise table.fail(f"is not a model file: its format is not '{FORMAT}'.")
    if (version := table.number("version")) != VERSION:
        raise table.fail(f"has version {version:g}; this program reads version {VERSION}: calibrate again.")
    table.text("package_version")
    table.text("frame", choices=["openxr"])
    units = table.table("units")
    for quantity, unit in _UNITS.items():
        units.text(quantity, choices=[unit])
    units.finish()


def _mapping_record(mapping: object, kinds: dict[str, type[Any]]) -> dict[str, Any]:
    for kind, model in kinds.items():
        if isinstance(mapping, model):
            return {"kind": kind} | {name: _record(getattr(mapping, name)) for name in _part_names(model)}
    raise BadInputError(f"a {type(mapping).__name__} cannot be written to a model file; only {', '.join(kinds)} can.")


def _part_names(model: type[Any]) -> list[str]:
    return [f.name for f in fields(model) if f.name != "eye_box"]


def _record(part: Panel | BasePlane | Polynomial) -> dict[str, Any]:
    if isinstance(part, Panel):
        return {"width_px": part.width_px, "height_px": part.height_px}
    if isinstance(part, BasePlane):
        return {"z_m": part.z}
    orders = exponents(len(part.box.low), part.degree).tolist()
    values = part.coefficients.tolist()
    return {
        "degree": part.degree,
        "low": part.box.low.tolist(),
        "high": part.box.high.tolist(),
        "terms": [{"orders": o, "values": v} for o, v in zip(orders, values, strict=True)],
    }


def _mapping(table: Table, kinds: dict[str, type[Any]], eye_box: EyeBox) -> Any:
    model = kinds[table.text("kind", choices=list(kinds))]
    forms: Forms = model.FORMS
    parts = {name: _part(table.table(name), name, forms) for name in _part_names(model)}
    table.finish()
    return model(eye_box=eye_box, **parts)


def _part(table: Table, name: str, forms: Forms) -> Panel | BasePlane | Polynomial:
    part: Panel | BasePlane | Polynomial
    if name == "panel":
        part = Panel(_whole(table, "width_px"), _whole(table, "height_px"))
    elif name == "base_plane":
        part = BasePlane(table.number("z_m"))
    else:
        part = _polynomial(table, *forms[name])
    table.finish()
    return part


def _polynomial(table: Table, variables: int, outputs: int) -> Polynomial:
    degree = _whole(table, "degree")
    box = Box(table.vector("low", variables), table.vector("high", variables))
    if not np.all(box.low < box.high):
        raise table.fail("'low' must be less than 'high' on every axis.")
    terms = table.tables("terms")
    if len(terms) != term_count(variables, degree):
        wanted = term_count(variables, degree)
        raise table.fail(f"degree {degree} in {variables} variables has {wanted} terms, but 'terms' has {len(terms)}.")
    orders = np.array([term.vector("orders", variables) for term in terms])
    if not np.array_equal(orders, exponents(variables, degree)):
        raise table.fail(f"'terms' must be all those of total degree up to {degree}, ordered by it and by 'orders'.")
    return Polynomial(degree, box, np.array([term.vector("values", outputs) for term in terms]))


def _whole(table: Table, key: str) -> int:
    value = table.number(key)
    if value != int(value) or value < 0:
        raise table.fail(f"'{key}' must be a whole number from 0, not {value}.")
    return int(value)
