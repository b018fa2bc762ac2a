"""Reader of the JSON files of Optiland: every surface has a pose in one frame."""

from collections.abc import Callable
from pathlib import Path

import numpy as np

from wlr_render.geometry.transforms import rigid, rotation_about
from wlr_render.input_files import shown
from wlr_render.numerics.arrays import FloatArray
from wlr_render.optics.device import ClearAperture
from wlr_render.optics.lens_files.glass_catalogues import GlassCatalogue, model_glass, require_glass
from wlr_render.optics.lens_files.sequence import (
    LensFile,
    LensSurface,
    Notes,
    box_aperture,
    conic_or_asphere,
    ignore,
    number_of,
    require_surfaces,
)
from wlr_render.optics.media import AIR, Medium
from wlr_render.optics.sag_surfaces import SumOfProfiles, Toroid, XYPolynomial
from wlr_render.optics.surfaces import Conic, Shape
from wlr_render.toml_files import Table

_MM = 1e-3
_MOST_TERMS = 21  # most powers of x or y, from 0 on
_DEEPEST = 20  # deepest nesting of frames
_OPEN = (-np.inf, -np.inf), (np.inf, np.inf)


def read_optiland(path: Path, file: Table, catalogue: GlassCatalogue) -> LensFile:
    """Read a file that Optiland's `save_optiland_file` wrote.

    Args:
        path: path of the file, for messages.
        file: content of the file.
        catalogue: catalogue for the glasses that the file names.

    Raises:
        BadInputError: a value is missing or not a number, or no catalogue has a glass.
    """
    entries = file.table("surface_group").tables("surfaces", most=1000)
    require_surfaces(path, len(entries))
    notes: Notes = []
    surfaces: list[LensSurface] = []
    medium = AIR
    for number, entry in enumerate(entries):
        geometry = entry.table("geometry")
        # Files of older versions have no model: the surface itself states whether it is a mirror.
        has_model = entry.raw("interaction_model") is not None
        model = entry.table("interaction_model") if has_model else entry
        reflects = model.flag("is_reflective", default=False)
        if has_model and model.text("type") != "RefractiveReflectiveModel":
            ignore(notes, number, "interaction_model", model.text("type"), "bends rays in another way", True, "shape")
        medium = medium if reflects else _medium(entry, number, catalogue, notes)
        surfaces.append(
            LensSurface(
                number,
                str(entry.raw("comment") or "")[:100],
                _shape(geometry, number, notes),
                _pose(geometry.table("cs"), infinite=number == 0),
                medium,
                reflects,
                entry.flag("is_stop", default=False),
                _aperture(entry, number, notes),
            )
        )
    return LensFile(str(file.raw("name") or "")[:200], tuple(surfaces), tuple(notes))


def _pose(frame: Table, infinite: bool, depth: int = 0) -> FloatArray:
    """Return the pose of a frame from its origin and its rotations about x, y, z of its parent frame, in this order."""
    if depth > _DEEPEST:
        raise frame.fail(f"frames are stated in one another more than {_DEEPEST} deep; write them in the global frame.")
    x, y, z = (number_of(frame, key, 0.0, infinite and key == "z") for key in "xyz")
    about = {axis: rotation_about(axis, number_of(frame, f"r{axis}", 0.0)) for axis in "xyz"}
    if not np.isfinite(z):
        return np.full((4, 4), np.nan)
    pose = rigid(about["z"] @ about["y"] @ about["x"], _MM * np.array([x, y, z]))
    if frame.raw("reference_cs") is None:
        return pose
    return _pose(frame.table("reference_cs"), infinite, depth + 1) @ pose


def _medium(entry: Table, number: int, catalogue: GlassCatalogue, notes: Notes) -> Medium:
    material = entry.table("material_post")
    kind = material.text("type")
    if kind == "IdealMaterial":
        index = number_of(material, "index")
        return AIR if index == 1.0 else require_glass(Medium.constant(f"n{index:g}", index), material.where)
    if kind == "AbbeMaterial":
        index, abbe = number_of(material, "index"), number_of(material, "abbe")
        ignore(
            notes,
            number,
            "AbbeMaterial",
            f"{index:g}, {abbe:g}",
            "taken by n_d and V_d; between lines it may differ",
            part="glass",
        )
        return model_glass(index, abbe, material.where)
    if kind == "Material":
        name = material.text("name")
        reference = material.raw("reference")
        glass = catalogue.require(name, material.where, (reference,) if isinstance(reference, str) else ())
        glass.tell(notes, number, "material_post", name)
        return glass.medium
    raise material.fail(f"material {shown(kind)} is not read; write it as IdealMaterial, AbbeMaterial or Material.")


def _aperture(entry: Table, number: int, notes: Notes) -> ClearAperture:
    if entry.raw("aperture") is None:
        return box_aperture(*_OPEN)
    aperture = entry.table("aperture")
    kind = aperture.text("type")
    if kind == "RectangularAperture":
        low, high = ([_MM * number_of(aperture, f"{axis}_{end}") for axis in "xy"] for end in ("min", "max"))
        return box_aperture(low, high)
    if kind in ("RadialAperture", "OffsetRadialAperture"):
        half = _MM * number_of(aperture, "r_max")
        x, y = (_MM * number_of(aperture, key, 0.0) for key in ("offset_x", "offset_y"))
        ignore(notes, number, "aperture", kind, "a circle: the square around it is the clear aperture")
        if number_of(aperture, "r_min", 0.0) > 0:
            ignore(notes, number, "r_min", number_of(aperture, "r_min"), "rays pass the middle of the ring")
        return box_aperture((x - half, y - half), (x + half, y + half))
    ignore(notes, number, "aperture", kind, "this form is not read: the surface is open")
    return box_aperture(*_OPEN)


def _curvature(geometry: Table, key: str = "radius") -> float:
    """Return the curvature in 1/mm; 0 for a radius that is infinite or 0."""
    radius = number_of(geometry, key, np.inf, infinite=True)
    return 1.0 / radius if radius and np.isfinite(radius) else 0.0


def _coefficients(geometry: Table, key: str = "coefficients") -> FloatArray:
    value = geometry.raw(key)
    try:
        array = np.array([] if value is None else value, dtype=float)
    except (ValueError, TypeError, OverflowError) as error:
        raise geometry.fail(f"'{key}' is {shown(value)}; it must be numbers.") from error
    if not np.isfinite(array).all() or array.ndim > 2 or max(array.shape, default=0) > _MOST_TERMS:
        raise geometry.fail(f"'{key}' must be finite, and at most {_MOST_TERMS} along each axis.")
    return array


def _shape(geometry: Table, number: int, notes: Notes) -> Shape:
    kind = geometry.text("type")
    read = _SHAPES.get(kind)
    if read is None:
        ignore(notes, number, "geometry", kind, "this shape is not read: its conic stands in its place", True, "shape")
        return _conic(geometry, number, notes)
    return read(geometry, number, notes)


def _conic(geometry: Table, number: int, notes: Notes) -> Shape:
    return Conic(_curvature(geometry) / _MM, number_of(geometry, "conic", 0.0))


def _asphere_of(step: int) -> Callable[[Table, int, Notes], Shape]:
    """Return a reader of terms r^step, r^(2 step), ..."""

    def read(geometry: Table, number: int, notes: Notes) -> Shape:
        terms: dict[int, float] = {step * (k + 1): c for k, c in enumerate(_coefficients(geometry).ravel().tolist())}
        if terms.get(1):
            ignore(notes, number, "coefficients[0]", terms[1], "the term in r, a tip on the axis, is not read", True)
        if any(value for power, value in terms.items() if power > 20):
            ignore(notes, number, "coefficients", "above r20", "powers that a device file does not have", True)
        by_power = [terms.get(power, 0.0) for power in range(2, 21)]
        return conic_or_asphere(_curvature(geometry), number_of(geometry, "conic", 0.0), by_power, _MM)

    return read


def _polynomial(geometry: Table, number: int, notes: Notes) -> Shape:
    in_mm = np.atleast_2d(_coefficients(geometry))
    if not in_mm.any():
        return _conic(geometry, number, notes)
    m, n = np.indices(in_mm.shape)
    if np.any(in_mm[m + n > 20]):
        ignore(notes, number, "coefficients", "above order 20", "orders that a device file does not have", True)
    curvature = _curvature(geometry) / _MM
    coefficients = np.where(m + n > 20, 0.0, in_mm) * _MM ** (1.0 - m - n)
    return XYPolynomial(coefficients, curvature, number_of(geometry, "conic", 0.0) if curvature else 0.0)


def _biconic(geometry: Table, number: int, notes: Notes) -> Shape:
    """Return the sum of two profiles, Optiland's biconic; Zemax and others have one root of both coordinates."""
    x, y = (_curvature(geometry, f"radius_{axis}") / _MM for axis in "xy")
    if not x and not y:
        return Conic(0.0)
    return SumOfProfiles((x, y), (number_of(geometry, "conic_x", 0.0), number_of(geometry, "conic_y", 0.0)))


def _toroid(geometry: Table, number: int, notes: Notes) -> Shape:
    x, y = (_curvature(geometry, f"radius_{axis}") / _MM for axis in "xy")
    conic, terms = number_of(geometry, "conic_yz", 0.0), _coefficients(geometry, "coeffs_poly_y")
    if terms.any():
        ignore(notes, number, "coeffs_poly_y", terms.tolist(), "terms of y of a toroid are not read", True)
    if not x:
        return SumOfProfiles((0.0, y), (0.0, conic)) if y else Conic(0.0)
    if not y:
        return SumOfProfiles((x, 0.0))
    if conic:
        ignore(notes, number, "conic_yz", conic, "the conic of a toroid is not read: it is a circle", True)
    return Toroid(1.0 / x, 1.0 / y)


_SHAPES: dict[str, Callable[[Table, int, Notes], Shape]] = {
    "Plane": lambda geometry, number, notes: Conic(0.0),
    "StandardGeometry": _conic,
    "EvenAsphere": _asphere_of(2),
    "OddAsphere": _asphere_of(1),
    "PolynomialGeometry": _polynomial,
    "BiconicGeometry": _biconic,
    "ToroidalGeometry": _toroid,
}
"""Readers by Optiland's class of geometry; other classes are read as their conic, with a note."""


def is_optiland(content: Table) -> bool:
    """Return whether a JSON file was written by Optiland."""
    group = content.raw("surface_group")
    return isinstance(group, dict) and "surfaces" in group
