"""A sequential prescription of a lens design program: surfaces in the order of the light, and ignored keys.

Lengths are in metres and poses in the file's frame, whose z axis the light follows before the first mirror.
"""

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Literal

import numpy as np

from wlr_render.errors import BadInputError
from wlr_render.geometry.transforms import rigid
from wlr_render.io.input_files import shown
from wlr_render.io.toml_files import Table
from wlr_render.numerics.arrays import FloatArray
from wlr_render.optics.device import ClearAperture
from wlr_render.optics.lens_files.glass_catalogues import (
    GlassCatalogue,
    model_glass,
    require_glass,
    unknown_glass_remedy,
)
from wlr_render.optics.media import AIR, Medium
from wlr_render.optics.sag_surfaces import Asphere, SumOfProfiles, Toroid
from wlr_render.optics.surfaces import Conic, Shape

UNITS_M = {
    **{"mm": 1e-3, "cm": 1e-2, "in": 0.0254, "inch": 0.0254, "inches": 0.0254},
    **{"m": 1.0, "me": 1.0, "meter": 1.0, "meters": 1.0},
}
"""Metres of the units of length that lens files name."""

MOST_POWER = 20
"""Largest power of a coordinate in a device file."""

_MOST_SURFACES = 1000
_LARGEST = 1e12

Part = Literal["shape", "glass", "other"]


@dataclass(frozen=True)
class Ignored:
    """A key of the file that has no counterpart in the device.

    Attributes:
        surface: number of the surface in the file; None for the file as a whole.
        key: name of the key in the file.
        value: value in the file, shortened.
        reason: reason for leaving it out, and its substitute.
        bends_rays: True if it changes rays.
        part: "shape" for a surface of a type that is not read, "glass" for a glass that is taken approximately.
    """

    surface: int | None
    key: str
    value: str
    reason: str
    bends_rays: bool = False
    part: Part = "other"


@dataclass
class LensReading:
    """State of reading one lens file.

    Attributes:
        path: path of the file, for messages.
        catalogue: catalogue for the glasses that the file names.
        unit: metres of the file's unit of length.
        surface: number of the surface that is being read; None for the file as a whole.
        notes: keys without a counterpart in the device.
    """

    path: Path
    catalogue: GlassCatalogue
    unit: float = 1e-3
    surface: int | None = None
    notes: list[Ignored] = field(default_factory=list)

    def ignore(self, key: str, value: object, reason: str, bends_rays: bool = False, part: Part = "other") -> None:
        """Note a key that is not read, or is read with another meaning than in the file."""
        self.notes.append(Ignored(self.surface, key, shown(value, quoted=False), reason, bends_rays, part))

    def glass(self, key: str, name: str, manufacturers: Sequence[str] = ()) -> Medium | None:
        """Find a glass by its name and note where it was found; None if no catalogue has it."""
        found = self.catalogue.find(name, manufacturers)
        if found is not None and found.note:
            self.ignore(key, name, found.note, found.is_other, "glass" if found.is_other else "other")
        return None if found is None else found.medium

    def required_glass(self, key: str, name: str, where: str, manufacturers: Sequence[str] = ()) -> Medium:
        """Find a glass as `glass` does; refuse one that no catalogue has. `where` begins the sentence."""
        medium = self.glass(key, name, manufacturers)
        if medium is None:
            raise BadInputError(f"{where}: no catalogue has the glass {shown(name)}. {unknown_glass_remedy()}")
        return medium

    def model_glass(self, key: str, index: float, abbe: float, where: str) -> Medium:
        """Return a glass that the file states by n_d and V_d, and note it."""
        self.ignore(key, f"{index:g}, {abbe:g}", "taken by n_d and V_d; between lines it may differ", part="glass")
        return model_glass(index, abbe, where)

    def asphere(self, base: Conic, step: int, terms: Sequence[float], key: str) -> Shape:
        """Return a conic with terms in r^step, r^(2 step), ... in file units; note the terms that are left out."""
        by_power = {step * place: term for place, term in enumerate(terms, 1)}
        if by_power.get(1):
            self.ignore(f"{key}[0]", by_power[1], "the term in r, a tip on the axis, is not read", True)
        if any(term for power, term in by_power.items() if power > MOST_POWER):
            self.ignore(key, f"above r{MOST_POWER}", "powers that a device file does not have", True)
        return asphere(base, by_power, self.unit)


@dataclass(frozen=True, eq=False)
class LensSurface:
    """One surface of a sequential prescription.

    Attributes:
        number: number in the file, where the object is 0.
        label: comment in the file; may be empty.
        shape: shape in local axes.
        file_from_surface: (4, 4); NaN for an object at infinity.
        medium: medium behind the surface, for light in the order of the file.
        reflects: True for a mirror.
        is_stop: True for the aperture stop.
        aperture: clear aperture that stops rays in the file.
        semi_diameter: semi-diameter of the drawn surface in the file, metres; NaN if not stated.
    """

    number: int
    label: str
    shape: Shape
    file_from_surface: FloatArray
    medium: Medium
    reflects: bool
    is_stop: bool
    aperture: ClearAperture
    semi_diameter: float = np.nan


@dataclass(frozen=True, eq=False)
class LensFile:
    """A sequential prescription: object, surfaces, image, in the order of the light."""

    title: str
    surfaces: tuple[LensSurface, ...]
    ignored: tuple[Ignored, ...]

    def medium_before(self, place: int) -> Medium:
        """Return the medium before the surface at a place of `surfaces`."""
        return self.surfaces[place - 1].medium if place else AIR

    def bends_rays(self, place: int) -> bool:
        """Return whether the surface at a place of `surfaces` is a mirror or has different media on its two sides."""
        surface = self.surfaces[place]
        return surface.reflects or surface.medium != self.medium_before(place)


def require_surfaces(path: object, count: int) -> None:
    """Refuse files with too few or too many surfaces."""
    if not 3 <= count <= _MOST_SURFACES:
        raise BadInputError(
            f"{path}: has {count} surfaces; a lens file that can be read has an object, an image, and 1 to "
            f"{_MOST_SURFACES - 2} surfaces between them."
        )


def finite(value: object, where: str, infinite: bool = False) -> float:
    """Return a number of a lens file; `infinite` allows infinity.

    Raises:
        BadInputError: the value is not a number, or too large for a lens; `where` begins the sentence.
    """
    try:
        number = float(value) if isinstance(value, str | int | float) and not isinstance(value, bool) else np.nan
    except (ValueError, OverflowError):
        number = np.nan
    if not (abs(number) <= _LARGEST or (infinite and math.isinf(number))):
        raise BadInputError(f"{where} is {shown(value)}; it must be a number of at most {_LARGEST:g}: correct it.")
    return number


def number_of(table: Table, key: str, default: float | None = None, infinite: bool = False) -> float:
    """Return a number of a JSON file, `default` if it is missing or null; `infinite` allows infinity.

    Raises:
        BadInputError: the value is not a number, or too large for a lens.
    """
    value = table.raw(key)
    if value is None and default is not None:
        return default
    return finite(value, f"{table.where}: '{key}'", infinite)


def shift(x: float = 0.0, y: float = 0.0, z: float = 0.0) -> FloatArray:
    """Return the translation, (4, 4), metres."""
    return rigid(np.eye(3), np.array([x, y, z]))


def asphere(base: Conic, terms: Mapping[int, float], unit: float) -> Shape:
    """Return a conic with terms by their power of r, from r^2 to the largest of a device file; others are left out.

    Args:
        base: the conic, in metres; returned as it is without terms.
        terms: factors by power, in file units.
        unit: metres of a file unit.
    """
    last = max((power for power, term in terms.items() if term and 2 <= power <= MOST_POWER), default=0)
    if not last:
        return base
    scaled = tuple(float(terms.get(power, 0.0)) * unit ** (1 - power) for power in range(2, last + 1))
    return Asphere(scaled, base.curvature, base.conic if base.curvature else 0.0)


def toroid(curvature: tuple[float, float], conic: tuple[float, float]) -> Shape:
    """Return the toroid of two curvatures along x and y in 1/m; a cylinder with its conic, or a plane, without one."""
    x, y = curvature
    if x and y:
        return Toroid(1.0 / x, 1.0 / y)
    return SumOfProfiles(curvature, (conic[0] if x else 0.0, conic[1] if y else 0.0)) if x or y else Conic(0.0)


def constant_glass(index: float, where: str) -> Medium:
    """Return a medium without dispersion, or air for an index of 1.

    Raises:
        BadInputError: the index is implausible; `where` begins the sentence.
    """
    return AIR if index == 1.0 else require_glass(Medium.constant(f"n{index:g}", index), where)


def box_aperture(low: Sequence[float] = (-np.inf, -np.inf), high: Sequence[float] = (np.inf, np.inf)) -> ClearAperture:
    """Return a clear aperture bounded in x and y, metres; open along z."""
    return ClearAperture(np.array([*low, -np.inf]), np.array([*high, np.inf]))
