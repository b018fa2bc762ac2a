"""Write device prescriptions in the format that `device_file` reads (devices/README.md), in device axes."""

from dataclasses import replace
from pathlib import Path as FilePath
from typing import Any

import numpy as np

from wlr_render.mappings import FieldOfView
from wlr_render.numerics.arrays import FloatArray
from wlr_render.optics.device import (
    ClearAperture,
    Device,
    EyeOptics,
    Interaction,
    Path,
    PlacedPanel,
    PlacedSurface,
    mirrored,
)
from wlr_render.optics.device_file import MM, base_chain
from wlr_render.optics.glass_files import shipped_glasses
from wlr_render.optics.media import AIR, Medium
from wlr_render.optics.raised import Raised, RaisedSag
from wlr_render.optics.sag_surfaces import (
    AnamorphicAsphere,
    AnamorphicTerm,
    Asphere,
    GaussianBump,
    SumOfProfiles,
    Toroid,
    XYPolynomial,
)
from wlr_render.optics.surfaces import Conic, Ellipsoid, Offset, Shape
from wlr_render.toml_files import write_toml

Content = dict[str, Any]
"""A table of the file, in plain lists and numbers, so that two tables can be compared."""


def save_device(device: Device, path: str | FilePath) -> FilePath:
    """Write a device that `load_device` reads back, to the rounding of its numbers.

    Media of one name that differ between the eyes get the side added to the name. A displaced surface gets a separate
    base if its base has another pose or is not in a path.
    """
    return write_toml(path, device_content(device))


def device_content(device: Device) -> Content:
    """Return the content that `save_device` writes; two devices are the same if it is equal."""
    names = _medium_names(device)
    head = {"name": device.name, "source": device.source, "frame": "openxr"}
    media = [_medium(name, medium) for medium, name in names.items() if medium != AIR]
    eyes = _eyes(device, names)
    return head | ({"medium": media} if media else {}) | {"eye": eyes}


def _medium_names(device: Device) -> dict[Medium, str]:
    """Return a name for each medium in use: its own name, unless another medium has it."""
    names = {AIR: AIR.name}
    for side, eye in device.eyes.items():
        for step in eye.display.steps + eye.see_through.steps:
            name = step.medium.name
            while name in names.values() and step.medium not in names:
                name = f"{name}_{side}"
            names.setdefault(step.medium, name)
    return names


def _medium(name: str, medium: Medium) -> Content:
    shift = {"index_shift": medium.index_shift} if medium.index_shift else {}
    for glass in shipped_glasses().values():
        if (medium.terms, medium.powers) == (glass.terms, glass.powers):
            return {"name": name, "formula": glass.name} | shift
    poles = [list(term) for term in medium.terms if term[1]]
    # A Sellmeier term with a pole of 0 is a constant of n^2, and so is a factor of the power 0.
    constant = sum(strength for strength, pole in medium.terms if not pole)
    constant += sum(factor for factor, power in medium.powers if not power)
    powers = [[factor, power] for factor, power in medium.powers if power]
    if powers:
        sellmeier = {"sellmeier": poles} if poles else {}
        return {"name": name} | sellmeier | {"schott": [[1.0 + constant, 0.0], *powers]} | shift
    if poles:
        return {"name": name, "sellmeier": [*poles, *([[constant, 0.0]] if constant else [])]} | shift
    return {"name": name, "index": replace(medium, index_shift=0.0).index(1.0)} | shift


def _eyes(device: Device, names: dict[Medium, str]) -> list[Content]:
    """Return one table for both eyes if one is the mirror image of the other, else one for each."""
    first, *others = device.eyes
    tables = {side: _eye(eye, names) for side, eye in device.eyes.items()}
    if others and tables[others[0]] == _eye(mirrored(device.eyes[first]), names):
        return [{"side": first, "also_mirrored": True} | tables[first]]
    return [{"side": side} | table for side, table in tables.items()]


def _eye(eye: EyeOptics, names: dict[Medium, str]) -> Content:
    return {
        "display_path": _path(eye.display, names),
        "see_through_path": _path(eye.see_through, names),
        **({} if eye.field is None else {"field_deg": _field(eye.field)}),
        "eye_box": {"centre_mm": _mm(eye.eye_box.centre), "size_mm": _mm(eye.eye_box.size)},
        "panel": _panel(eye.panel),
        **_surfaces(eye.surfaces()),
    }


def _path(path: Path, names: dict[Medium, str]) -> list[Content]:
    return [
        {"at": step.surface.name, "do": str(step.interaction)}
        | ({"into": names[step.medium]} if step.interaction is Interaction.REFRACT else {})
        for step in path.steps
    ]


def _field(field: FieldOfView) -> list[float]:
    left_down, right_up = np.rad2deg(np.arctan(field.low)), np.rad2deg(np.arctan(field.high))
    return np.stack([left_down, right_up], axis=-1).ravel().tolist()


def _panel(panel: PlacedPanel) -> Content:
    return {
        "centre_mm": _mm(panel.device_from_panel[:3, 3]),
        "size_mm": _mm(panel.size),
        "pixels": [panel.pixels.width_px, panel.pixels.height_px],
        "u_axis": panel.device_from_panel[:3, 0].tolist(),
        "v_axis": panel.device_from_panel[:3, 1].tolist(),
        **({"curvature_per_m": panel.curvature.tolist()} if panel.curvature.any() else {}),
    }


def _surfaces(surfaces: tuple[PlacedSurface, ...]) -> Content:
    """Return all surfaces and the bases that displaced ones need, each base before the surfaces that refer to it."""
    placed, bases = list(surfaces), dict[str, str]()
    for surface in placed:  # grows by the bases, which may be displaced too
        if not isinstance(surface.shape, Offset | Raised | RaisedSag):
            continue
        base = _base(surface, surface.shape.base, placed)
        bases[surface.name] = base.name
        if base not in placed:
            placed.append(base)
    ordered = sorted(placed, key=lambda surface: len(base_chain(surface.shape)))
    return {"surface": [_surface(surface, bases) for surface in ordered]} if placed else {}


def _base(surface: PlacedSurface, shape: Shape, placed: list[PlacedSurface]) -> PlacedSurface:
    """Return the surface that is the base of a displaced one: an existing surface in its place, or a new one."""
    for other in placed:
        if other.shape is shape and np.array_equal(other.device_from_surface, surface.device_from_surface):
            return other
    name = f"{surface.name}_base"
    while any(name == other.name for other in placed):
        name += "_base"
    return replace(surface, name=name, shape=shape)


def _surface(surface: PlacedSurface, bases: dict[str, str]) -> Content:
    if isinstance(surface.shape, Offset):
        content = {"shape": "offset", "of": bases[surface.name], "distance_mm": surface.shape.distance / MM}
    elif isinstance(surface.shape, Raised | RaisedSag):
        errors = [
            _shape(each.sag) | _pose(surface.device_from_surface @ each.surface_from_error)
            for each in surface.shape.errors
        ]
        content = {"shape": "raised", "of": bases[surface.name], "error": errors}
    else:
        content = _shape(surface.shape) | _pose(surface.device_from_surface)
    return {"name": surface.name} | content | _aperture(surface.aperture)


def _shape(shape: Shape) -> Content:
    match shape:
        case Conic(curvature=0.0):
            return {"shape": "plane"}
        case Conic():
            return {"shape": "conic"} | _base_conic(shape)
        case Ellipsoid():
            return {"shape": "ellipsoid", "semi_axes_mm": _mm(shape.semi_axes)}
        case Toroid():
            return {"shape": "toroid", "radius_x_mm": shape.radius_x / MM, "radius_y_mm": shape.radius_y / MM}
        case Asphere():
            base = _base_conic(shape) if shape.curvature else {}
            sag = {f"r{k}": each / MM ** (1 - k) for k, each in enumerate(shape.coefficients, start=2) if each}
            return {"shape": "asphere"} | base | {"sag_mm": sag or {"r2": 0.0}}
        case SumOfProfiles():
            return {"shape": "sum_of_profiles"} | _biconic(shape)
        case XYPolynomial():
            base = _base_conic(shape) if shape.curvature else {}
            return {"shape": "xy_polynomial"} | base | {"sag_mm": _polynomial(shape.coefficients)}
        case AnamorphicAsphere():
            return {"shape": "anamorphic"} | _anamorphic(shape)
        case GaussianBump():
            return {"shape": "bump", "height_mm": shape.height / MM, "width_mm": shape.width / MM}
    raise TypeError(f"a device file has no shape {type(shape).__name__}.")


def _base_conic(shape: Conic | Asphere | XYPolynomial) -> Content:
    return {"radius_mm": 1.0 / shape.curvature / MM, "conic": shape.conic}


def _polynomial(coefficients: FloatArray) -> Content:
    """Return non-zero terms with keys such as x2y3; one zero term if all vanish."""
    powers = [(int(m), int(n)) for m, n in np.argwhere(coefficients)] or [(0, 0)]
    return {_term_key(m, n): float(coefficients[m, n]) / MM ** (1 - m - n) for m, n in powers}


def _term_key(m: int, n: int) -> str:
    """Return the key of a term, such as x2y3 or y4; x0 for the constant."""
    return f"x{m}" * (m > 0) + f"y{n}" * (n > 0) or "x0"


def _biconic(shape: AnamorphicAsphere | SumOfProfiles) -> Content:
    """Return the radii of the profiles that have one, and conics."""
    radii = {
        f"radius_{axis}_mm": 1.0 / curvature / MM
        for axis, curvature in zip("xy", shape.curvature, strict=True)
        if curvature
    }
    return radii | {"conic_x": shape.conic[0], "conic_y": shape.conic[1]}


def _anamorphic(shape: AnamorphicAsphere) -> Content:
    return _biconic(shape) | ({"term": [_term(term) for term in shape.terms]} if shape.terms else {})


def _term(term: AnamorphicTerm) -> Content:
    order = 2 * term.power
    return {"order": order, "sag_mm": term.amplitude / MM ** (1 - order), "asymmetry": term.asymmetry}


def _pose(device_from_surface: FloatArray) -> Content:
    rotation = device_from_surface[:3, :3]
    return {
        "origin_mm": _mm(device_from_surface[:3, 3]),
        "z_axis": rotation[:, 2].tolist(),
        "x_axis": rotation[:, 0].tolist(),
        **({"mirrored": True} if np.linalg.det(rotation) < 0 else {}),
    }


def _aperture(aperture: ClearAperture) -> Content:
    """Return a pair (low, high) for each axis on which the aperture is bounded."""
    sides = zip("xyz", aperture.low, aperture.high, strict=True)
    return {f"aperture_{axis}_mm": _mm(np.array(side)) for axis, *side in sides if np.isfinite(side).any()}


def _mm(metres: FloatArray) -> list[float]:
    millimetres: list[float] = (metres / MM).tolist()
    return millimetres
