"""Shapes of the surfaces in device files (devices/README.md), read and written."""

from typing import Any

from wlr_render.io.file_records import read_part, record_keys
from wlr_render.io.toml_files import Table
from wlr_render.optics.sag_surfaces import (
    AnamorphicAsphere,
    Asphere,
    GaussianBump,
    SagSurface,
    SumOfProfiles,
    Toroid,
    XYPolynomial,
)
from wlr_render.optics.surfaces import Conic, Ellipsoid, Shape

SHAPES: dict[str, type[Shape]] = {
    "plane": Conic,
    "conic": Conic,
    "ellipsoid": Ellipsoid,
    "toroid": Toroid,
    "asphere": Asphere,
    "xy_polynomial": XYPolynomial,
    "sum_of_profiles": SumOfProfiles,
    "anamorphic": AnamorphicAsphere,
    "bump": GaussianBump,
}
"""Classes of the shapes that are stated without another surface, by their names in a device file."""
SAG_SHAPES = sorted(kind for kind, made in SHAPES.items() if issubclass(made, SagSurface))
"""Shapes that are heights over x and y, as form errors are."""


def read_shape(table: Table, kind: str) -> Any:
    """Read the keys of one kind of shape."""
    if kind == "plane":
        return Conic(0.0)
    shape = read_part(SHAPES[kind], table)
    if table.has("conic") and not table.has("radius_mm"):
        raise table.fail("'conic' is there without 'radius_mm'; write both, or neither.")
    if isinstance(shape, AnamorphicAsphere | SumOfProfiles) and not any(shape.curvature):
        raise table.fail("neither radius_x_mm nor radius_y_mm is there; write at least one.")
    return shape


def shape_content(shape: Shape) -> dict[str, Any]:
    """Return the keys that `read_shape` reads, with the kind as `shape`."""
    if isinstance(shape, Conic) and not shape.curvature:
        return {"shape": "plane"}
    (kind,) = (kind for kind, made in SHAPES.items() if type(shape) is made and kind != "plane")
    return {"shape": kind} | record_keys(shape)
