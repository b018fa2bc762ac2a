"""Read the JSON files of rayoptics (.roa): surfaces, gaps between them, and decentres with CODE V's signs of angles."""

from pathlib import Path
from typing import Any

import numpy as np

from wlr_render.io.input_files import shown
from wlr_render.io.toml_files import Table
from wlr_render.optics.device import ClearAperture
from wlr_render.optics.glass_files import NIKON_POWERS, SCHOTT_POWERS
from wlr_render.optics.lens_files.glass_catalogues import GlassCatalogue, model_glass, require_glass
from wlr_render.optics.lens_files.sequence import (
    INFINITE,
    UNITS_M,
    Decentre,
    LensFile,
    LensReading,
    LensSurface,
    box_aperture,
    by_power,
    conic,
    finite,
    number_of,
    require_surfaces,
    shift,
)
from wlr_render.optics.media import AIR, Medium
from wlr_render.optics.surfaces import Conic, Shape

_SELLMEIER_MAKERS = ("SchottGlass", "OharaGlass")
_POWERS_OF_MAKERS = {
    "HoyaGlass": SCHOTT_POWERS,
    "SumitaGlass": SCHOTT_POWERS,
    "CDGMGlass": SCHOTT_POWERS,
    "HikariGlass": NIKON_POWERS,
}
"""Powers of the wavelength in the dispersion formulas of glass makers."""


def read_rayoptics(path: Path, file: Table, catalogue: GlassCatalogue) -> LensFile:
    """Read a .roa file.

    Args:
        path: path of the file, for messages.
        file: content of the file.
        catalogue: catalogue for the glasses that the file names without coefficients.

    Raises:
        BadInputError: a value is missing or not a number, or no catalogue has a glass.
    """
    model = file.table("optical_model").table("attributes")
    system = model.table("system_spec").table("attributes")
    unit_name = str(system.raw("_dimensions") or system.raw("dimensions") or "mm").lower()
    if unit_name not in UNITS_M:
        raise system.fail(f"the unit of length is {shown(unit_name)}; it must be one of {', '.join(UNITS_M)}.")
    unit = UNITS_M[unit_name]
    reading = LensReading(path, catalogue, unit)
    sequence = model.table("seq_model").table("attributes")
    entries, gaps = sequence.tables("ifcs", most=1000), sequence.tables("gaps", most=1000)
    require_surfaces(path, len(entries))
    if len(gaps) != len(entries) - 1:
        raise sequence.fail(f"there are {len(gaps)} gaps for {len(entries)} surfaces; write the file again.")
    profiles = model.table("profile_dict") if model.has("profile_dict") else None
    has_stop = sequence.raw("stop_surface") is not None
    stop = sequence.whole("stop_surface", most=len(entries) - 1) if has_stop else None
    surfaces: list[LensSurface] = []
    pose, medium, thickness, before = np.eye(4), AIR, 0.0, Decentre()
    for number, entry in enumerate(entries):
        reading.surface, surface = number, entry.table("attributes")
        decentre = _decentre(surface.table("decenter").table("attributes") if surface.raw("decenter") else None, unit)
        pose = pose @ before.step(unit * thickness, decentre)
        mode = surface.text("interact_mode")
        if mode not in ("transmit", "reflect", "dummy", "phantom"):
            reading.ignore("interact_mode", mode, "taken as a surface that light passes", True)
        kind = _class_of(surface.table("phase_element") if surface.raw("phase_element") else entry)
        if kind != "Surface":
            reading.ignore("surface", kind, "bends rays by more than its shape: not read", True, "shape")
        if mode != "reflect":
            medium = _medium(gaps[number], reading) if number < len(gaps) else medium
        thickness = number_of(gaps[number].table("attributes"), "thi") if number < len(gaps) else 0.0
        infinite = number == 0 and abs(thickness) >= INFINITE
        surfaces.append(
            LensSurface(
                number,
                str(surface.raw("label") or "")[:100],
                _shape(surface, profiles, reading),
                np.full((4, 4), np.nan) if infinite else pose @ shift(z=-unit * thickness) if number == 0 else pose,
                medium,
                mode == "reflect",
                number == stop,
                _aperture(surface, reading),
                unit * number_of(surface, "max_aperture", 0.0),
            )
        )
        if number == 0:
            thickness, decentre = 0.0, Decentre()
        before = decentre
    return reading.lens_file(str(system.raw("title") or "")[:200], surfaces)


def _class_of(entry: Table) -> str:
    """Return the name of an object's class, which follows the name of its module."""
    return entry.texts("__instance_type__")[-1]


def _array(table: Table, key: str, size: int | None = None) -> list[float]:
    """Return the numbers from a list or from rayoptics' form of an array; zeros if they are missing."""
    value: Any = table.raw(key)
    value = value.get("__ndarray__") if isinstance(value, dict) else value
    value = [0.0] * (size or 0) if value is None else value
    if not isinstance(value, list) or (size is not None and len(value) != size) or len(value) > 100:
        raise table.fail(f"'{key}' is {shown(value)}; it must be a list of {size or 'at most 100'} numbers.")
    return [finite(each, f"{table.where}: '{key}'") for each in value]


def _decentre(table: Table | None, unit: float) -> Decentre:
    if table is None:
        return Decentre()
    stated = table.raw("_dtype") or table.raw("dtype")
    if str(stated) not in Decentre.KINDS:
        raise table.fail(f"the decentre is {shown(stated)}; it must be one of {', '.join(Decentre.KINDS)}.")
    return Decentre.of(str(stated), [unit * each for each in _array(table, "dec", 3)], _array(table, "euler", 3))


def _medium(gap: Table, reading: LensReading) -> Medium:
    medium = gap.table("attributes").table("medium")
    kind, where = _class_of(medium), medium.where
    attributes = medium.table("attributes") if medium.has("attributes") else medium
    if kind == "Air":
        return AIR
    if kind == "ConstantIndex":
        return model_glass(number_of(attributes, "n"), 0.0, where)
    if kind == "ModelGlass":
        index, abbe = (number_of(attributes, key) for key in "nv")
        return reading.model_glass(kind, index, abbe, where)
    name = attributes.text("gname", "") or attributes.text("label", "") or kind
    if attributes.has("coefs"):
        coefficients = _array(attributes, "coefs")
        if kind in _SELLMEIER_MAKERS and len(coefficients) == 6:
            terms = zip(coefficients[:3], coefficients[3:], strict=True)
            return require_glass(Medium.squared(name, terms, [(1.0, 0.0)]), where)
        if kind in _POWERS_OF_MAKERS and len(coefficients) == len(_POWERS_OF_MAKERS[kind]):
            powers = zip(coefficients, _POWERS_OF_MAKERS[kind], strict=True)
            return require_glass(Medium.squared(name, (), powers), where)
    return reading.required_glass("medium", name, (kind.removesuffix("Glass"),))


def _aperture(surface: Table, reading: LensReading) -> ClearAperture:
    apertures = surface.tables("clear_apertures", required=False)
    if not apertures:
        return box_aperture()
    first, kind = apertures[0].table("attributes"), _class_of(apertures[0])
    if len(apertures) > 1 or first.raw("rotation"):
        reading.ignore("clear_apertures", len(apertures), "only the first, unturned, is read")
    centre = [number_of(first, f"{axis}_offset", 0.0) for axis in "xy"]
    if kind == "Circular":
        return reading.circle("clear_apertures", kind, centre, number_of(first, "radius"))
    if kind == "Rectangular":
        return reading.rectangle(centre, [number_of(first, f"{axis}_half_width") for axis in "xy"])
    reading.ignore("clear_apertures", kind, "this form is not read: the surface is open")
    return box_aperture()


def _shape(surface: Table, profiles: Table | None, reading: LensReading) -> Shape:
    if surface.has("profile"):
        profile = surface.table("profile")
    elif profiles is not None and surface.has("profile_id"):
        profile = profiles.table(str(surface.raw("profile_id")))
    else:
        return Conic(0.0)
    kind, attributes = _class_of(profile), profile.table("attributes")
    curvature = number_of(attributes, "cv", 0.0) / reading.unit
    constant = number_of(attributes, "cc", 0.0)
    if attributes.raw("cc") is None and attributes.raw("ec") is not None:
        constant = number_of(attributes, "ec") - 1.0
    terms = _array(attributes, "coefs") if attributes.has("coefs") else []
    base = conic(curvature, constant)
    if kind in ("EvenPolynomial", "RadialPolynomial"):
        return reading.asphere(base, by_power(2 if kind == "EvenPolynomial" else 1, terms), "coefs")
    if kind in ("XToroid", "YToroid"):
        around = number_of(attributes, "cR", 0.0) / reading.unit
        has_two_radii = curvature != 0.0 and around != 0.0
        if kind == "XToroid" and has_two_radii:
            reading.ignore("profile", kind, "taken as turned about an axis along y", True)
        if kind == "YToroid" or has_two_radii:
            return reading.toroid((around, curvature), (0.0, constant), terms, ("cc", "coefs"))
        return reading.toroid((curvature, around), (constant, 0.0), terms, ("cc", "coefs"))
    if kind not in ("Spherical", "Conic"):
        reading.unread_shape("profile", kind)
    return base
