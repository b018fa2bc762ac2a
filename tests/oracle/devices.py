"""The three headsets that sessions with a hidden effect are made of, in the second tracer's terms.

Numbers: `northstar` from the published CAD of Project North Star (repository leapmotion/ProjectNorthStar), the other
two are this project's own designs. Millimetres; x right, y down, z forward.
"""

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np

from oracle.own_tracer import (
    FloatArray,
    Sheet,
    Spheroid,
    Surface,
    reflected,
    refracted,
    turn,
)
from wlr_render.errors import BadInputError

SEE_THROUGH_UM = 0.55
CHANNEL_UM = (0.65, 0.55, 0.45)
"""Wavelengths of red, green and blue."""

_BOW_STEPS = 4


@dataclass(frozen=True, eq=False)
class Panel:
    """The display panel.

    Attributes:
        centre: (3,) device frame.
        axes: (3, 3) columns along u, along v, and the normal, u x v.
        size_mm: (2,) lit width and height.
        pixels: (2,) counts.
        bow_per_mm: curvature; the panel's face is z = bow r^2 / 2 along its normal.
    """

    centre: FloatArray
    axes: FloatArray
    size_mm: FloatArray
    pixels: FloatArray
    bow_per_mm: float = 0.0

    def pixel(self, origin: FloatArray, direction: FloatArray) -> FloatArray:
        """Where rays (n, 3), (n, 3) meet the panel's face, (n, 2) pixels; NaN where they go away from it."""
        o, d = (origin - self.centre) @ self.axes, direction @ self.axes
        along = -o[:, 2] / d[:, 2]
        for _ in range(_BOW_STEPS if self.bow_per_mm else 0):
            place = o[:, :2] + along[:, None] * d[:, :2]
            along = (0.5 * self.bow_per_mm * np.sum(place**2, axis=-1) - o[:, 2]) / d[:, 2]
        along = np.where(along > 0.0, along, np.nan)
        return np.asarray(((o + along[:, None] * d)[:, :2] / self.size_mm + 0.5) * self.pixels)


@dataclass(frozen=True)
class Encounter:
    """What happens at one surface: `into` is "mirror", "glass" or "air"."""

    surface: str
    into: str


@dataclass(frozen=True, eq=False)
class OwnDevice:
    """A headset before one eye.

    Attributes:
        eye: (3,) middle of the eye box.
        surfaces: by name.
        display: encounters from the eye to the panel.
        see_through: encounters from the eye to the world.
        outer: name of the face that a thicker substrate moves.
        panel: the panel.
        index_shift: refractive index minus that of PMMA.
    """

    eye: FloatArray
    surfaces: dict[str, Surface]
    display: tuple[Encounter, ...]
    see_through: tuple[Encounter, ...]
    outer: str
    panel: Panel
    index_shift: float = 0.0

    @property
    def pivot(self) -> FloatArray:
        """Where the central line of sight, along z from the eye, meets the first surface, (3,)."""
        point, _ = self.surfaces[self.see_through[0].surface].meet(self.eye[None], np.array([[0.0, 0.0, 1.0]]))
        return np.asarray(point[0])

    def with_surfaces(self, change: Callable[[Surface], Surface]) -> "OwnDevice":
        """Every surface of the combiner changed alike."""
        return replace(self, surfaces={name: change(surface) for name, surface in self.surfaces.items()})

    def trace(
        self, path: tuple[Encounter, ...], origin: FloatArray, direction: FloatArray, wavelength_um: float
    ) -> tuple[FloatArray, FloatArray]:
        """Rays (n, 3), (n, 3 unit) behind the last surface of `display` or `see_through`; NaN where they are lost."""
        glass, now = pmma_index(wavelength_um) + self.index_shift, 1.0
        for encounter in path:
            origin, normal = self.surfaces[encounter.surface].meet(origin, direction)
            if encounter.into == "mirror":
                direction = reflected(direction, normal)
            else:
                behind = glass if encounter.into == "glass" else 1.0
                direction, now = refracted(direction, normal, now / behind), behind
        return origin, direction


def pmma_index(wavelength_um: float) -> float:
    """Refractive index of PMMA: Sultanova, Kasarova, Nikolov, Acta Physica Polonica A 116 (2009) 585."""
    square = wavelength_um**2
    return float(np.sqrt(1.0 + 1.1819 * square / (square - 0.011313)))


def _axes(first: list[float], second: list[float]) -> FloatArray:
    """Right-handed axes in columns: `first`, what of `second` is across it, and their product."""
    a = np.array(first) / np.linalg.norm(first)
    b = np.array(second) - (np.array(second) @ a) * a
    b = b / np.linalg.norm(b)
    return np.stack([a, b, np.cross(a, b)], axis=1)


def _panel(
    centre: list[float], along_u: list[float], along_v: list[float], size: list[float], pixels: list[float]
) -> Panel:
    return Panel(np.array(centre), _axes(along_u, along_v), np.array(size), np.array(pixels))


_COMBINER = (Encounter("inner", "glass"), Encounter("outer", "air"))


def _northstar() -> OwnDevice:
    axes = _axes([0.94615, -0.25342, -0.20145], [0.20825, 0.0, 0.97808])[:, [1, 2, 0]]
    outer = Surface(Spheroid(124.975, 157.5), axes, np.array([116.153, -24.0747, -19.1371]))
    return OwnDevice(
        eye=np.array([32.0, 0.0, 30.0]),
        surfaces={"inner": replace(outer, shape=outer.shape.pushed_out(-2.5)), "outer": outer},
        display=(Encounter("inner", "mirror"),),
        see_through=_COMBINER,
        outer="outer",
        panel=_panel(
            [72.3326, 7.9101, 56.2323],
            [0.86811, -0.03425, 0.49519],
            [0.20340, 0.93456, -0.29194],
            [59.4, 66.0],
            [1440, 1600],
        ),
    )


# fmt: off
_FREEFORM40_SAG = {
    (2, 0): -.00657507919, (0, 2): -.00498341219, (2, 1): -3.71579997e-5, (0, 3): -2.63814982e-5,
    (4, 0): -1.15989665e-7, (2, 2): -8.60269151e-7, (0, 4): 8.57769539e-8, (4, 1): 1.87511534e-9,
    (2, 3): -5.34803927e-9, (0, 5): 1.82458756e-8, (6, 0): -7.52437105e-10, (4, 2): 1.24803464e-9,
    (2, 4): -1.952237e-9, (0, 6): -7.73169236e-10,
}  # powers of x and y
# fmt: on


def _freeform40() -> OwnDevice:
    coefficients = np.zeros((7, 7))
    for powers, value in _FREEFORM40_SAG.items():
        coefficients[powers] = value
    inner = Surface(
        Sheet(coefficients, 0.0, (-26.0, 26.0, -18.0, 16.0)),
        turn(np.array([np.radians(-30.0), 0.0, 0.0])),
        np.array([0.0, 0.0, 40.0]),
    )
    return OwnDevice(
        eye=np.zeros(3),
        surfaces={"inner": inner, "outer": replace(inner, shape=Sheet(coefficients, 2.0, (-27.0, 27.0, -19.0, 16.0)))},
        display=(Encounter("inner", "mirror"),),
        see_through=_COMBINER,
        outer="outer",
        panel=_panel(
            [0.0, -37.0572, 18.6050], [1.0, 0.0, 0.0], [0.0, -0.93697197, 0.34940457], [34.56, 19.44], [1920, 1080]
        ),
    )


def _birdbath28() -> OwnDevice:
    tilt, centre = turn(np.array([np.radians(45.0), 0.0, 0.0])), np.array([0.0, 0.0, -18.0])
    clear = (-21.0, 21.0, -13.0, 19.0)
    near = Surface(Sheet(np.zeros((1, 1)), 0.0, clear), tilt, np.array([0.0, 0.0, 20.0]))
    through_plate = (Encounter("plate_near", "glass"), Encounter("plate_far", "air"))
    return OwnDevice(
        eye=np.zeros(3),
        surfaces={
            "plate_near": near,
            "plate_far": replace(near, shape=near.shape.pushed_out(1.0)),
            "mirror": Surface(Spheroid(56.0, 56.0), np.eye(3), centre),
            "shell": Surface(Spheroid(58.0, 58.0), np.eye(3), centre),
        },
        display=(*through_plate, Encounter("mirror", "mirror"), Encounter("plate_far", "mirror")),
        see_through=(*through_plate, Encounter("mirror", "glass"), Encounter("shell", "air")),
        outer="shell",
        panel=_panel(
            [0.0, -11.0267, 21.4097], [1.0, 0.0, 0.0], [0.0, 0.01166851, 0.99993192], [22.1, 12.43], [1920, 1080]
        ),
    )


_MAKERS = {"northstar": _northstar, "freeform40": _freeform40, "birdbath28": _birdbath28}
NAMES = tuple(_MAKERS)
"""The headsets that there are."""


def own_device(name: str) -> OwnDevice:
    """A headset by name.

    Raises:
        BadInputError: there is no such headset here.
    """
    if name not in _MAKERS:
        raise BadInputError(f"Hidden effects know no device '{name}'; choose {', '.join(NAMES)}.")
    return _MAKERS[name]()
