"""A sequential prescription of a lens design program: surfaces in the order of the light, and ignored keys.

Lengths are in metres and poses in the file's frame, whose z axis the light follows before the first mirror.
"""

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import ClassVar, Literal

import numpy as np

from wlr_render.errors import BadInputError
from wlr_render.geometry.transforms import inverse, rigid, rotation_about
from wlr_render.io.input_files import shown
from wlr_render.io.toml_files import Table
from wlr_render.numerics.arrays import FloatArray
from wlr_render.optics.device import ClearAperture
from wlr_render.optics.device_keys import MOST_POWER
from wlr_render.optics.lens_files.glass_catalogues import (
    GlassCatalogue,
    model_glass,
    unknown_glass_remedy,
)
from wlr_render.optics.media import AIR, Medium
from wlr_render.optics.sag_surfaces import Asphere, SumOfProfiles, Toroid, XYPolynomial
from wlr_render.optics.surfaces import Conic, Shape

UNITS_M = {
    **{"mm": 1e-3, "cm": 1e-2, "in": 0.0254, "inch": 0.0254, "inches": 0.0254},
    **{"m": 1.0, "me": 1.0, "meter": 1.0, "meters": 1.0},
}
"""Metres per unit of length, by its name in lens files."""

INFINITE = 1e10
"""Distance that CODE V and rayoptics write for an object at infinity, in the file's unit."""
NORMS = 1e-9, 1e9
"""Shortest and longest length that divides the coordinates of a polynomial, in the file's unit."""

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
        part: "shape" for a surface of a type that is not read, "glass" for a glass that is approximated.
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
        unit: the file's unit of length in metres.
        surface: number of the surface that is being read; None for the file as a whole.
        notes: keys without a counterpart in the device.
        unknown_glasses: numbers of surfaces, by the name of a glass that no catalogue has.
    """

    path: Path
    catalogue: GlassCatalogue
    unit: float = 1e-3
    surface: int | None = None
    notes: list[Ignored] = field(default_factory=list)
    unknown_glasses: dict[str, list[str]] = field(default_factory=dict)

    def ignore(self, key: str, value: object, reason: str, bends_rays: bool = False, part: Part = "other") -> None:
        """Note a key that is not read, or is read with another meaning than in the file."""
        self.notes.append(Ignored(self.surface, key, shown(value, quoted=False), reason, bends_rays, part))

    def glass(self, key: str, name: str, manufacturers: Sequence[str] = ()) -> Medium | None:
        """Find a glass by its name and note where it was found; None if no catalogue has it."""
        found = self.catalogue.find(name, manufacturers)
        if found is not None and found.note:
            self.ignore(key, name, found.note, found.is_other, "glass" if found.is_other else "other")
        return None if found is None else found.medium

    def required_glass(self, key: str, name: str, manufacturers: Sequence[str] = ()) -> Medium:
        """Find a glass like `glass`; if no catalogue has it, `lens_file` refuses the file."""
        return self.glass(key, name, manufacturers) or self.unknown_glass(name)

    def unknown_glass(self, name: str) -> Medium:
        """Return a placeholder for a glass that no catalogue has; `lens_file` refuses the file."""
        self.unknown_glasses.setdefault(name, []).append(str(self.surface))
        return Medium(name)

    def model_glass(self, key: str, index: float, abbe: float, where: str) -> Medium:
        """Return the glass that the file states by n_d and V_d, and note it."""
        self.ignore(key, f"{index:g}, {abbe:g}", "taken by n_d and V_d; between lines it may differ", part="glass")
        return model_glass(index, abbe, where)

    def asphere(self, base: Conic, terms: Mapping[int, float], key: str) -> Shape:
        """Return a conic with terms by power of r in file units; note the terms that are left out."""
        if tip := terms.get(1):
            self.ignore(key, tip, "the term in r, a tip on the axis, is not read", True)
        if any(term for power, term in terms.items() if power > MOST_POWER):
            self.ignore(key, f"above r{MOST_POWER}", "powers that a device file does not have", True)
        last = max((power for power, term in terms.items() if term and 2 <= power <= MOST_POWER), default=0)
        scaled = tuple(float(terms.get(power, 0.0)) * self.unit ** (1 - power) for power in range(2, last + 1))
        return Asphere(scaled, base.curvature, base.conic) if last else base

    def polynomial(self, base: Conic, terms: FloatArray, key: str) -> Shape:
        """Return a conic with terms (m, n) of x^m y^n in file units; note the terms that are left out."""
        m, n = np.indices(terms.shape)
        if np.any(terms[m + n > MOST_POWER]):
            self.ignore(key, f"above order {MOST_POWER}", "orders that a device file does not have", True)
        scaled = np.where(m + n > MOST_POWER, 0.0, terms) * self.unit ** (1.0 - m - n)
        return XYPolynomial(scaled, base.curvature, base.conic) if scaled.any() else base

    def toroid(
        self, curvature: tuple[float, float], conic: tuple[float, float], terms: Sequence[float], keys: tuple[str, str]
    ) -> Shape:
        """Return a toroid of curvatures along x and y in 1/m; if one is 0, a cylinder with its conic; if both, a plane.

        Conics and terms of y that are left out are noted under `keys`: (key of the conic, key of the terms).
        """
        x, y = curvature
        if any(terms):
            self.ignore(keys[1], list(terms), "terms of y of a toroid are not read", True)
        if not (x and y):
            return SumOfProfiles(curvature, (conic[0] if x else 0.0, conic[1] if y else 0.0)) if x or y else Conic(0.0)
        if any(conic):
            self.ignore(keys[0], sum(conic), "the conic of a toroid is not read: it is a circle", True)
        return Toroid(1.0 / x, 1.0 / y)

    def unread_shape(self, key: str, kind: str, bends_rays: bool = True) -> None:
        """Note a surface of a type that is not read."""
        self.ignore(key, kind, "this type is not read: its conic stands in its place", bends_rays, "shape")

    def other_environment(self, key: str, value: str) -> None:
        """Note a temperature or pressure at which the indices differ from the catalogues."""
        reason = "the indices are those at 20 degrees Celsius and 1 atmosphere; another environment is not read"
        self.ignore(key, value, reason, True)

    def rectangle(self, centre: Sequence[float], half: Sequence[float]) -> ClearAperture:
        """Return an aperture by its centre and half sides in file units."""
        low, high = (self.unit * (np.array(centre) + sign * np.array(half)) for sign in (-1.0, 1.0))
        return box_aperture(low.tolist(), high.tolist())

    def circle(self, key: str, value: object, centre: Sequence[float], radius: float) -> ClearAperture:
        """Return the square around a circular aperture; lengths in file units."""
        self.ignore(key, value, "a circle: the square around it is the clear aperture")
        return self.rectangle(centre, (radius, radius))

    def lens_file(self, title: str, surfaces: Sequence["LensSurface"]) -> "LensFile":
        """Return the content of the file.

        Raises:
            BadInputError: no catalogue has one of the glasses.
        """
        if self.unknown_glasses:
            names = "; ".join(f"{name} (surface {', '.join(each)})" for name, each in self.unknown_glasses.items())
            raise BadInputError(f"{self.path}: no catalogue has these glasses: {names[:300]}. {unknown_glass_remedy()}")
        return LensFile(title, tuple(surfaces), tuple(self.notes))


@dataclass(frozen=True, eq=False)
class Decentre:
    """A shift and tilts of a surface, in the convention of CODE V and rayoptics.

    Attributes:
        kind: one of `KINDS`: the axes behind the surface stay decentred, are tilted once more (at a mirror, they follow
            the light), or return; or the inverse decentre follows the surface and none precedes it.
        shift: (4, 4), metres.
        rotation: (4, 4).
    """

    KINDS: ClassVar = ("bend", "dec and return", "decenter", "reverse")

    kind: str = "decenter"
    shift: FloatArray = field(default_factory=lambda: np.eye(4))
    rotation: FloatArray = field(default_factory=lambda: np.eye(4))

    @classmethod
    def of(cls, kind: str, place: Sequence[float], degrees: Sequence[float]) -> "Decentre":
        """Return the decentre with a shift along x, y and z in metres, then tilts about x, y and z in degrees."""
        alpha, beta, gamma = np.deg2rad(degrees)
        # About x and y the angles are left-handed.
        rotation = rotation_about("x", -alpha) @ rotation_about("y", -beta) @ rotation_about("z", gamma)
        return cls(kind, shift(*place), rigid(rotation, np.zeros(3)))

    def step(self, thickness: float, following: "Decentre") -> FloatArray:
        """Return the pose (4, 4) of the next surface, with decentre `following`, in the axes of this surface."""
        turn, moved = np.eye(4), np.eye(4)
        if self.kind == "bend":
            turn = self.rotation
        elif self.kind != "decenter":
            turn, moved = self.rotation.T, inverse(self.shift)
        behind = turn @ moved @ shift(z=thickness)
        return behind if following.kind == "reverse" else behind @ following.shift @ following.rotation


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


def by_power(step: int, terms: Sequence[float]) -> dict[int, float]:
    """Return the factors of r^step, r^(2 step), ... by power."""
    return {step * place: term for place, term in enumerate(terms, 1)}


def xy_powers() -> list[tuple[int, int]]:
    """Return the powers of x and y in the order x, y, x^2, xy, y^2, ... up to `MOST_POWER`."""
    return [(order - n, n) for order in range(1, MOST_POWER + 1) for n in range(order + 1)]


def conic(curvature: float, constant: float) -> Conic:
    """Return the conic with a curvature in 1/m; a plane gets the conic constant 0."""
    return Conic(curvature, constant if curvature else 0.0)


def box_aperture(low: Sequence[float] = (-np.inf, -np.inf), high: Sequence[float] = (np.inf, np.inf)) -> ClearAperture:
    """Return a clear aperture bounded in x and y, metres; open along z."""
    return ClearAperture(np.array([*low, -np.inf]), np.array([*high, np.inf]))
