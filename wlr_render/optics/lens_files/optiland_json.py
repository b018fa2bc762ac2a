"""Reader of the JSON files of Optiland: every surface has a pose in one frame."""

from collections.abc import Callable
from pathlib import Path

import numpy as np

from wlr_render.geometry.transforms import rigid, rotation_about
from wlr_render.io.input_files import shown
from wlr_render.io.toml_files import Table
from wlr_render.numerics.arrays import FloatArray
from wlr_render.optics.device import ClearAperture
from wlr_render.optics.device_keys import MOST_POWER
from wlr_render.optics.lens_files.glass_catalogues import GlassCatalogue, model_glass
from wlr_render.optics.lens_files.sequence import (
    LensFile,
    LensReading,
    LensSurface,
    box_aperture,
    by_power,
    conic,
    number_of,
    require_surfaces,
)
from wlr_render.optics.media import AIR, Medium
from wlr_render.optics.sag_surfaces import SumOfProfiles
from wlr_render.optics.surfaces import Conic, Shape

_MM = 1e-3
_DEEPEST = 20  # deepest nesting of frames


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
    reading = LensReading(path, catalogue, _MM)
    surfaces: list[LensSurface] = []
    medium = AIR
    for number, entry in enumerate(entries):
        reading.surface = number
        geometry = entry.table("geometry")
        # Files of older versions have no model: the surface itself states whether it is a mirror.
        has_model = entry.raw("interaction_model") is not None
        model = entry.table("interaction_model") if has_model else entry
        reflects = model.flag("is_reflective", default=False)
        if has_model and model.text("type") != "RefractiveReflectiveModel":
            reading.ignore("interaction_model", model.text("type"), "bends rays in another way", True, "shape")
        medium = medium if reflects else _medium(entry, reading)
        surfaces.append(
            LensSurface(
                number,
                str(entry.raw("comment") or "")[:100],
                _shape(geometry, reading),
                _pose(geometry.table("cs"), infinite=number == 0),
                medium,
                reflects,
                entry.flag("is_stop", default=False),
                _aperture(entry, reading),
            )
        )
    return reading.lens_file(str(file.raw("name") or "")[:200], surfaces)


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


def _medium(entry: Table, reading: LensReading) -> Medium:
    material = entry.table("material_post")
    kind = material.text("type")
    if kind == "IdealMaterial":
        return model_glass(number_of(material, "index"), 0.0, material.where)
    if kind == "AbbeMaterial":
        index, abbe = number_of(material, "index"), number_of(material, "abbe")
        return reading.model_glass(kind, index, abbe, material.where)
    if kind == "Material":
        reference = material.raw("reference")
        makers = (reference,) if isinstance(reference, str) else ()
        return reading.required_glass("material_post", material.text("name"), makers)
    raise material.fail(f"material {shown(kind)} is not read; write it as IdealMaterial, AbbeMaterial or Material.")


def _aperture(entry: Table, reading: LensReading) -> ClearAperture:
    if entry.raw("aperture") is None:
        return box_aperture()
    aperture = entry.table("aperture")
    kind = aperture.text("type")
    if kind == "RectangularAperture":
        low, high = ([_MM * number_of(aperture, f"{axis}_{end}") for axis in "xy"] for end in ("min", "max"))
        return box_aperture(low, high)
    if kind in ("RadialAperture", "OffsetRadialAperture"):
        if number_of(aperture, "r_min", 0.0) > 0:
            reading.ignore("r_min", number_of(aperture, "r_min"), "rays pass the middle of the ring")
        centre = [number_of(aperture, key, 0.0) for key in ("offset_x", "offset_y")]
        return reading.circle("aperture", kind, centre, number_of(aperture, "r_max"))
    reading.ignore("aperture", kind, "this form is not read: the surface is open")
    return box_aperture()


def _curvature(geometry: Table, key: str = "radius") -> float:
    """Return the curvature in 1/m; 0 for a radius that is infinite or 0."""
    radius = number_of(geometry, key, np.inf, infinite=True)
    return 1.0 / radius / _MM if radius and np.isfinite(radius) else 0.0


def _coefficients(geometry: Table, key: str = "coefficients") -> FloatArray:
    value = geometry.raw(key)
    try:
        array = np.array([] if value is None else value, dtype=float)
    except (ValueError, TypeError, OverflowError) as error:
        raise geometry.fail(f"'{key}' is {shown(value)}; it must be numbers.") from error
    if not np.isfinite(array).all() or array.ndim > 2 or max(array.shape, default=0) > MOST_POWER + 1:
        raise geometry.fail(f"'{key}' must be finite, and at most {MOST_POWER + 1} along each axis.")
    return array


def _shape(geometry: Table, reading: LensReading) -> Shape:
    kind = geometry.text("type")
    if kind not in _SHAPES:
        reading.unread_shape("geometry", kind)
    return _SHAPES.get(kind, _conic)(geometry, reading)


def _conic(geometry: Table, reading: LensReading) -> Conic:
    return conic(_curvature(geometry), number_of(geometry, "conic", 0.0))


def _asphere_of(step: int) -> Callable[[Table, LensReading], Shape]:
    """Return a reader of terms r^step, r^(2 step), ..."""
    return lambda geometry, reading: reading.asphere(
        _conic(geometry, reading), by_power(step, _coefficients(geometry).ravel().tolist()), "coefficients"
    )


def _polynomial(geometry: Table, reading: LensReading) -> Shape:
    return reading.polynomial(_conic(geometry, reading), np.atleast_2d(_coefficients(geometry)), "coefficients")


def _biconic(geometry: Table, reading: LensReading) -> Shape:
    """Return the sum of two profiles, Optiland's biconic; Zemax and others have one root of both coordinates."""
    x, y = (_curvature(geometry, f"radius_{axis}") for axis in "xy")
    if not x and not y:
        return Conic(0.0)
    return SumOfProfiles((x, y), (number_of(geometry, "conic_x", 0.0), number_of(geometry, "conic_y", 0.0)))


def _toroid(geometry: Table, reading: LensReading) -> Shape:
    x, y = (_curvature(geometry, f"radius_{axis}") for axis in "xy")
    terms = _coefficients(geometry, "coeffs_poly_y").ravel().tolist()
    return reading.toroid((x, y), (0.0, number_of(geometry, "conic_yz", 0.0)), terms, ("conic_yz", "coeffs_poly_y"))


_SHAPES: dict[str, Callable[[Table, LensReading], Shape]] = {
    "Plane": lambda geometry, reading: Conic(0.0),
    "StandardGeometry": _conic,
    "EvenAsphere": _asphere_of(2),
    "OddAsphere": _asphere_of(1),
    "PolynomialGeometry": _polynomial,
    "BiconicGeometry": _biconic,
    "ToroidalGeometry": _toroid,
}
"""Readers by Optiland's class of geometry; other classes are read as their conic, with a note."""
