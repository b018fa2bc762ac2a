"""A sequential prescription of a lens design program: surfaces in the order of the light, and ignored keys.

Lengths are in metres and poses in the file's frame, whose z axis the light follows before the first mirror.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Literal

import numpy as np

from wlr_render.errors import BadInputError
from wlr_render.geometry.transforms import rigid
from wlr_render.input_files import shown
from wlr_render.numerics.arrays import FloatArray
from wlr_render.optics.device import ClearAperture
from wlr_render.optics.media import AIR, Medium
from wlr_render.optics.sag_surfaces import Asphere
from wlr_render.optics.surfaces import Conic, Shape
from wlr_render.toml_files import Table

UNITS_M = {
    **{"mm": 1e-3, "cm": 1e-2, "in": 0.0254, "inch": 0.0254, "inches": 0.0254},
    **{"m": 1.0, "me": 1.0, "meter": 1.0, "meters": 1.0},
}
"""Metres of the units of length that lens files name."""

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


Notes = list[Ignored]


def ignore(
    notes: Notes,
    surface: int | None,
    key: str,
    value: object,
    reason: str,
    bends_rays: bool = False,
    part: Part = "other",
) -> None:
    """Note a key that is not read, or is read with another meaning than in the file."""
    notes.append(Ignored(surface, key, shown(value, quoted=False), reason, bends_rays, part))


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
    medium: Medium = AIR
    reflects: bool = False
    is_stop: bool = False
    aperture: ClearAperture = field(
        default_factory=lambda: ClearAperture(np.full(3, -np.inf), np.full(3, np.inf)),
    )
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


def conic_or_asphere(curvature: float, conic: float, terms: Sequence[float], unit: float) -> Shape:
    """Return a conic, or an asphere if `terms` is given.

    Args:
        curvature: curvature in 1 / file unit.
        conic: k.
        terms: factors of r^2, r^3, ... in file units.
        unit: metres of a file unit.
    """
    if not any(terms):
        return Conic(curvature / unit, conic)
    last = max(place for place, term in enumerate(terms) if term)
    scaled = tuple(float(term) * unit ** (-1 - place) for place, term in enumerate(terms[: last + 1]))
    return Asphere(scaled, curvature / unit, conic if curvature else 0.0)


def box_aperture(low: Sequence[float], high: Sequence[float]) -> ClearAperture:
    """Return a clear aperture bounded in x and y, metres; open along z."""
    return ClearAperture(np.array([*low, -np.inf]), np.array([*high, np.inf]))
