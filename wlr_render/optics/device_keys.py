"""Forms of the keys of device files that are not numbers or vectors: poses, eye box, field of view, terms of shapes."""

import re
from dataclasses import KW_ONLY, dataclass
from functools import partial
from typing import Any

import numpy as np

from wlr_render.errors import BadInputError
from wlr_render.geometry.directions import normalised
from wlr_render.geometry.transforms import rigid, rotation_about
from wlr_render.io.file_records import LENGTH, MM, POINT, VECTOR, Key, Keys, Place, Quantity, Rule
from wlr_render.io.input_files import LIMITS, shown
from wlr_render.io.toml_files import Table
from wlr_render.mappings import EyeBox, FieldOfView
from wlr_render.numerics.arrays import FloatArray

FAR_MM = 2000.0
"""Largest distance of a part of a headset from the origin."""
FLAT_MM = 1e12
"""Largest radius: the surface is practically flat."""
MOST_POWER = 20
"""Highest total power of the coordinates in a term of a shape."""

_MIRROR_Y = np.diag([1.0, -1.0, 1.0])
_NOT_0 = Rule("a length other than 0", bool)
_CURVATURE = Quantity(lambda radius, _: 1.0 / (MM * radius), lambda curvature, _: 1.0 / curvature / MM)

distance_key = partial(Key, quantity=LENGTH, most=FAR_MM, rule=_NOT_0)
radius_key = partial(Key, quantity=LENGTH, most=FLAT_MM, rule=_NOT_0)
curvature_key = partial(Key, quantity=_CURVATURE, most=FLAT_MM, rule=_NOT_0)
"""Forms of a distance and of a radius in metres, and of a curvature in 1/m by its radius."""


def _axes(a: FloatArray, b: FloatArray, names: str) -> FloatArray:
    """Return right-handed unit axes as columns: along `a`, along `b` made orthogonal to it, and their cross product."""
    size = np.linalg.norm(a) * np.linalg.norm(b)
    if size == 0 or abs(a @ b) > 1e-3 * size:
        raise BadInputError(f"{names} must be perpendicular and not zero.")
    a = normalised(a)
    b = normalised(b - (a @ b) * a)
    return np.stack([a, b, np.cross(a, b)], axis=1)


_point = partial(Key, quantity=POINT, shape=(3,), most=FAR_MM)
_axis = partial(Key, quantity=VECTOR, shape=(3,))
_ORIGIN = _point("origin_mm")
_SURFACE_AXES = Keys(
    (_axis("z_axis"), _axis("x_axis")),
    lambda z, x: _axes(z, x, "'z_axis' and 'x_axis'")[:, [1, 2, 0]],
    lambda rotation: (rotation[:, 2], rotation[:, 0]),
)
PANEL_POSE = Keys(
    (_point("centre_mm"), _axis("u_axis"), _axis("v_axis")),
    lambda centre, u, v: rigid(_axes(u, v, "'u_axis' and 'v_axis'"), centre),
    lambda pose: (pose[:3, 3], pose[:3, 0], pose[:3, 1]),
)
"""Form of the pose of a panel."""


@dataclass(frozen=True)
class SurfacePose(Key):
    """Pose by `origin_mm`, the axes by `rotate_x_deg` or by the vectors `x_axis` and `z_axis`, and `mirrored`."""

    def read(self, table: Table, place: Place) -> FloatArray:
        """Return the pose (4, 4) in the device."""
        if table.has("z_axis"):
            rotation = _SURFACE_AXES.read(table, place)
        else:
            rotation = place.axes @ rotation_about("x", np.deg2rad(table.number("rotate_x_deg", default=0.0)))
        mirror = _MIRROR_Y if table.flag("mirrored", default=False) else np.eye(3)
        return rigid(rotation @ mirror, _ORIGIN.read(table, place))

    def keys(self, value: FloatArray, place: Place) -> dict[str, Any]:
        """Return the keys of a pose (4, 4)."""
        rotation = value[:3, :3]
        mirrored = {"mirrored": True} if np.linalg.det(rotation) < 0 else {}
        return _ORIGIN.keys(value[:3, 3], place) | _SURFACE_AXES.keys(rotation, place) | mirrored


_OF_ANGLES = Quantity(
    lambda angles, _: FieldOfView(*np.tan(np.deg2rad(angles)).reshape(2, 2).T),
    lambda field, _: np.rad2deg(np.arctan(np.stack([field.low, field.high], axis=-1))).ravel(),
)
_PAIRS = Rule(
    "left, right, down, up, each pair ascending; right and up are positive",
    lambda angles: bool(angles[0] < angles[1] and angles[2] < angles[3]),
)
_MILLIMETRES = Rule("0.1 or more on some axis, in millimetres", lambda size: bool(size.max() >= 0.1))
_SIZE = Key("size_mm", LENGTH, shape=(3,), above=0, most=1e3 * LIMITS.eye_box_m, rule=_MILLIMETRES)
EYE_BOX = Keys((_point("centre_mm"), _SIZE), EyeBox, lambda box: (box.centre, box.size))
FIELD = Key("field_deg", _OF_ANGLES, shape=(4,), most=89, rule=_PAIRS)
"""Forms of the eye box and of the field of view, in angles from the wearer's view, whatever the file's axes."""


@dataclass(frozen=True)
class SagTerms(Key):
    """Coefficients of powers of millimetres in a table, such as x2y = 0.1.

    Attributes:
        variables: names of the variables.
        least: least order of a term.
    """

    _: KW_ONLY
    variables: str
    least: int = 0

    def read(self, table: Table, place: Place) -> Any:
        """Return the coefficients by their powers, in metres."""
        sag = table.table(self.name)
        powers = {key: self._powers(sag, key) for key in sag.keys()}  # noqa: SIM118 (a Table is no dictionary)
        if not powers:
            raise sag.fail(f"the coefficients are missing; give at least one, such as {self.variables[0]}4.")
        coefficients = np.zeros(np.max(list(powers.values()), axis=0) + 1)
        for key, power in powers.items():
            coefficients[power] = sag.number(key) * MM ** (1 - sum(power))
        return self.quantity.of_file(coefficients, place.axes)

    def keys(self, value: Any, place: Place) -> dict[str, Any]:
        """Return the coefficients that are not 0, or a single 0 if all are."""
        coefficients = self.quantity.to_file(value, place.axes)
        terms = {}
        for powers in map(tuple, np.argwhere(coefficients).tolist()):
            key = "".join(f"{name}{power}" for name, power in zip(self.variables, powers, strict=True) if power)
            terms[key or "x0"] = float(coefficients[powers]) / MM ** (1 - sum(powers))
        return {self.name: terms or {f"{self.variables[0]}{self.least}": 0.0}}

    def _powers(self, sag: Table, key: str) -> tuple[int, ...]:
        """Return the powers in a key such as "x2y" or "y3"."""
        match = re.fullmatch("".join(rf"(?:{name}(\d*))?" for name in self.variables), key)
        powers = tuple(0 if power is None else int((power or "1")[:9]) for power in match.groups()) if match else ()
        if not key or match is None or not self.least <= sum(powers) <= MOST_POWER:
            names, first = " and ".join(self.variables), self.variables[0]
            raise sag.fail(
                f"{shown(key)} is not a term in {names} of order {self.least} to {MOST_POWER}; write {first}2, "
                f"{first}3 and so on."
            )
        return powers


XY_TERMS = SagTerms("sag_mm", variables="xy")
R_TERMS = SagTerms(
    "sag_mm",
    Quantity(lambda by_power, _: tuple(by_power[2:].tolist()), lambda terms, _: np.array([0.0, 0.0, *terms])),
    variables="r",
    least=2,
)
"""Forms of the coefficients of x^m y^n, and of the coefficients of r^2, r^3 and so on."""
