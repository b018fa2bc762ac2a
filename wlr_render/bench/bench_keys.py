"""Schema of bench files: keys, unit, frame and rule of every attribute of a bench.

Reading, writing and docs/bench-session.md follow these tables. A key may be left out where the attribute has a default,
and is left out in writing where the attribute equals it.
"""

from collections.abc import Callable
from dataclasses import MISSING, dataclass, fields
from typing import Any

import numpy as np

from wlr_render.bench import bench as parts
from wlr_render.captures.session_schema import CAMERA_PIXEL, MM, Quantity
from wlr_render.geometry.transforms import is_rotation
from wlr_render.io.input_files import LIMITS
from wlr_render.io.toml_files import Table
from wlr_render.numerics.arrays import FloatArray

# `axes` is device_from_file (3, 3), as in session_schema.
PLAIN = Quantity()
LENGTH = Quantity(lambda value, _: MM * value, lambda value, _: value / MM)
POINT = Quantity(lambda value, axes: MM * axes @ value, lambda value, axes: axes.T @ value / MM)
TURN = Quantity(lambda value, axes: axes @ np.deg2rad(value), lambda value, axes: axes.T @ np.rad2deg(value))
MATRIX = Quantity(lambda value, axes: axes @ value @ axes.T, lambda value, axes: axes.T @ value @ axes)
BOW = Quantity(lambda value, axes: axes[2, 2] * value, lambda value, axes: axes[2, 2] * value)


@dataclass(frozen=True)
class Rule:
    """Constraint on the numbers of a key.

    Attributes:
        demand: the constraint in words, after "must be".
        holds: whether a value satisfies it.
    """

    demand: str
    holds: Callable[[FloatArray], bool]


POSITIVE = Rule("above 0", lambda value: bool(np.all(value > 0)))
COUNT = Rule("a whole number above 0", lambda value: bool(np.all((value > 0) & (value == np.round(value)))))
INVERTIBLE = Rule("a matrix of determinant 0.1 or more", lambda value: bool(abs(np.linalg.det(value)) >= 0.1))
WAVELENGTH = Rule("0.2 to 2 micrometres", lambda value: bool(np.all((value >= 0.2) & (value <= 2))))
ROTATION = Rule("a rotation matrix (orthogonal to 1e-6, determinant +1)", is_rotation)


@dataclass(frozen=True)
class Entry:
    """One attribute of a part.

    Attributes:
        attribute: its name.
        keys: one key, or one for each element of a pair.
        meaning: description for the documentation and for errors.
        shape: shape of one key's value: a number, n numbers, or n (-1: any number of) lists of m numbers.
        quantity: unit and frame.
        rule: constraint on each key, if any.
        largest: plausible absolute value; None: 10 m of lengths, a million of others.
        least: smallest plausible absolute value besides 0.
    """

    attribute: str
    keys: tuple[str, ...]
    meaning: str
    shape: tuple[int, ...] = ()
    quantity: Quantity = PLAIN
    rule: Rule | None = None
    largest: float | None = None
    least: float = 0.0

    def read(self, table: Table, axes: FloatArray) -> FloatArray | float:
        """Return the attribute from its keys, in the units and the frame of the bench."""
        values = [self._value(table, key) for key in self.keys]
        value: FloatArray = self.quantity.of_file(values[0] if len(values) == 1 else np.stack(values), axes)
        return value if value.ndim else float(value)

    def written(self, value: FloatArray | float, axes: FloatArray) -> dict[str, Any]:
        """Return the keys of a value, the inverse of `read`."""
        in_file: FloatArray = self.quantity.to_file(np.asarray(value), axes) + 0.0  # turns -0.0 into 0.0
        if self.rule is COUNT:
            in_file = in_file.astype(np.int64)
        return {self.keys[0]: in_file} if len(self.keys) == 1 else dict(zip(self.keys, in_file, strict=True))

    def _value(self, table: Table, key: str) -> FloatArray:
        match self.shape:
            case ():
                value = np.array(table.number(key))
            case (size,):
                value = table.vector(key, size)
            case _:
                value = table.vectors(key, self.shape[1])
        if self.shape and self.shape[0] not in (-1, len(value)):
            raise table.fail(f"'{key}' must be {self.shape[0]} lists of {self.shape[1]} numbers, not {len(value)}.")
        largest = self.largest or (1e4 if self.quantity in (LENGTH, POINT) else 1e6)
        if np.any(np.abs(value) > largest):
            raise table.fail(f"'{key}' is {value.tolist()}; {largest:g} is the most ({self.meaning}): check its unit.")
        if np.any((value != 0) & (np.abs(value) < self.least)):
            raise table.fail(
                f"'{key}' is {value.tolist()}; {self.least:g} is the least ({self.meaning}): check its unit."
            )
        if self.rule is not None and not self.rule.holds(value):
            raise table.fail(f"'{key}' is {value.tolist()}; it must be {self.rule.demand} ({self.meaning}).")
        return value


@dataclass(frozen=True)
class BenchSection:
    """One [table] of the file.

    Attributes:
        part: dataclass of the section.
        entries: its attributes.
    """

    part: type
    entries: tuple[Entry, ...]

    def read(self, table: Table, axes: FloatArray) -> dict[str, Any]:
        """Return the attributes that the table states; others keep their defaults."""
        stated = {}
        for entry in self.entries:
            default = self.default(entry)
            if default is MISSING or table.has(entry.keys[0]):
                value = entry.read(table, axes)
                stated[entry.attribute] = tuple(np.asarray(value).tolist()) if isinstance(default, tuple) else value
        table.finish()
        return stated

    def written(self, value: Any, axes: FloatArray) -> dict[str, Any]:
        """Return the keys that differ from the defaults."""
        keys: dict[str, Any] = {}
        for entry in self.entries:
            attribute, default = getattr(value, entry.attribute), self.default(entry)
            if default is MISSING or not np.array_equal(attribute, default):
                keys |= entry.written(attribute, axes)
        return keys

    def default(self, entry: Entry) -> Any:
        """Return the value of the attribute if the file does not state it; MISSING if the file must."""
        field = next(each for each in fields(self.part) if each.name == entry.attribute)
        return field.default if field.default_factory is MISSING else field.default_factory()


_WARM_UP = "time constant: at time t the fraction 1 - exp(-t / warm_up_s) of the creep is done"
_GAZE_RADIUS = "pupil motion with gaze that tracking misses: this radius * (gaze - straight ahead), mm"
_AXES = "true displacement from `origin` = axes @ displacement read"

SECTIONS = {
    "camera": BenchSection(
        parts.EyeballCamera,
        (
            Entry("size_px", ("width", "height"), "image size, pixels", rule=COUNT, largest=LIMITS.picture_side),
            Entry("focal_px", ("fx", "fy"), "focal length, pixels", rule=POSITIVE),
            Entry("centre_px", ("cx", "cy"), "principal point, pixels", (), CAMERA_PIXEL),
            Entry(
                "point_sigma_px",
                ("point_sigma_px",),
                "standard deviation of a reading per axis (noise), camera pixels",
                rule=POSITIVE,
                largest=100.0,
                least=1e-6,
            ),
            Entry(
                "distortion",
                ("distortion",),
                "k1, k2: distorted tangents = true tangents * (1 + k1 r^2 + k2 r^4)",
                (2,),
            ),
            Entry("device_from_camera", ("rotation",), "camera rotation device_from_camera", (3, 3), MATRIX, ROTATION),
            Entry("pupil_offset", ("pupil_offset_mm",), "true minus nominal centre of projection, mm", (3,), POINT),
        ),
    ),
    "stage": BenchSection(
        parts.Stage,
        (
            Entry("origin", ("origin",), "stage reading at which `axes` changes nothing, mm", (3,), POINT),
            Entry("axes", ("axes",), _AXES, (3, 3), MATRIX, INVERTIBLE, largest=2.0),
            Entry(
                "backlash",
                ("backlash_mm",),
                "true minus read x after a move towards +x, and towards -x, mm",
                (2,),
                LENGTH,
            ),
        ),
    ),
    "target": BenchSection(
        parts.Target,
        (
            Entry("scale", ("scale",), "true size divided by stated size, in x and y", (2,), rule=POSITIVE),
            Entry(
                "bow",
                ("bow_per_m",),
                "one [bx, by], or one per target pose: z = bx x^2 + by y^2 in metres",
                (-1, 2),
                BOW,
            ),
        ),
    ),
    "mount": BenchSection(
        parts.Mount,
        (
            Entry("panel_creep", ("panel_creep_mm",), "total creep of the panel along u and v, mm", (2,), LENGTH),
            Entry("warm_up_s", ("warm_up_s",), _WARM_UP, rule=POSITIVE),
            Entry("slip_time_s", ("slip_time_s",), "time at which the headset slips, s"),
            Entry("slip", ("slip_mm",), "displacement of the camera in the device frame from then on", (3,), POINT),
            Entry(
                "slip_rotation", ("slip_rotation_deg",), "rotation of the camera about x, y, z from then on", (3,), TURN
            ),
        ),
    ),
    "readout": BenchSection(
        parts.PanelReadout,
        (
            Entry("origin_px", ("origin_px",), "decoded minus true panel position", (2,)),
            Entry("channel_scale", ("channel_scale",), "magnification of red, green, blue", (3,), rule=POSITIVE),
        ),
    ),
    "eye_tracking": BenchSection(
        parts.EyeTracking,
        (
            Entry("bias", ("bias_mm",), "true minus tracked position of the pupil, mm", (3,), POINT),
            Entry("gaze_radius", ("gaze_radius_mm",), _GAZE_RADIUS, (), LENGTH),
        ),
    ),
    "clock": BenchSection(
        parts.Clock,
        (
            Entry(
                "latency_s",
                ("latency_s",),
                "delay from the time a frame is drawn for to the display of its first row, s",
            ),
            Entry("scanout_s", ("scanout_s",), "time from the display of the panel's first row to its last, s"),
        ),
    ),
    "light": BenchSection(
        parts.Bench,
        (
            Entry(
                "wavelengths_um",
                ("channels_um",),
                "wavelengths of red, green and blue, micrometres",
                (3,),
                rule=WAVELENGTH,
            ),
            Entry(
                "target_wavelength_um",
                ("target_um",),
                "wavelength in which targets are observed, micrometres",
                rule=WAVELENGTH,
            ),
        ),
    ),
}
"""Sections by the name of the table; [target] without its poses, [light] for attributes of the bench itself."""
