"""Effects at the stations of a bench: displacements that no key of the bench's parts describes and a diagnosis locates.

An effect is a function of the station's coordinates: a polynomial, cells, waves, or the function of a user-defined
cause. Coordinates and displacements are in the units of the bench file; `displacement` converts between these and
metres and radians.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import partial

import numpy as np

from wlr_render.errors import BadInputError
from wlr_render.numerics.arrays import FloatArray, IntArray
from wlr_render.numerics.cells import Cells
from wlr_render.numerics.polynomial import HIGHEST_ORDER, Box, Polynomial, basis, total_degree
from wlr_render.numerics.waves import LocalWaves, Wave
from wlr_render.optics.combiner_form import SURFACES, SmoothSag, surfaces_raised
from wlr_render.optics.device import EyeOptics

_ROUNDS = 6  # fixed-point iterations; effects change little from one coordinate to the next

_UM, _URAD, _MM = 1e-6, 1e-6, 1e-3
_POSE = (_UM, _UM, _UM, _URAD, _URAD, _URAD)
_ON_COMBINER = "place right of and above the line of sight straight ahead, mm"
_PX, _AS_IS, _MRAD = (1.0, 1.0), (1.0, 1.0, 1.0), (1e-3, 1e-3, 1e-3)
_STEP = 1e-4  # step of finite differences, in scaled coordinates
_DEGREES = {1: HIGHEST_ORDER, 2: 24, 3: 10, 4: 6, 5: 5}  # polynomial degree for a function of 1 to 5 coordinates
_NODES = 20  # number of places at which a function is tested for the coordinates that it depends on
DISPLAY, SEE_THROUGH = PARTS = ("display", "see-through")
"""Parts of a session that an effect may be limited to."""


@dataclass(frozen=True)
class EffectKind:
    """Kind of an effect: its coordinates at a station and the displacement there.

    Attributes:
        coordinates: names of the coordinates, with the unit in the file.
        per_coordinate: unit of each coordinate in metres, seconds or pixels.
        displacement: names of the displacement's components, with the unit in the file.
        per_displacement: unit of each component in metres, radians or pixels.
        limit: attribute of `BenchEffect` that limits effects of this kind to some readings; empty without a limit.
    """

    coordinates: str
    per_coordinate: tuple[float, ...]
    displacement: str
    per_displacement: tuple[float, ...]
    limit: str = ""


_DECODED, _IMAGED = "decoded position u, v, panel px", "image u, v, camera px"
_POSE_OF_CAMERA = "camera's shift x, y, z, um, and turn x, y, z, urad"

BENCH_KINDS = {
    ("panel", "shift"): EffectKind("panel pixel u, v", _PX, _DECODED, _PX, "channel"),
    ("panel", "shift by viewpoint"): EffectKind(
        "panel pixel u, v, and viewpoint x, y, z, mm", (*_PX, _MM, _MM, _MM), _DECODED, _PX, "channel"
    ),
    ("camera", "shift"): EffectKind("camera pixel u, v", _PX, _IMAGED, _PX, "part"),
    ("camera", "shift by time"): EffectKind("camera pixel u, v, and time, s", (*_PX, 1.0), _IMAGED, _PX, "part"),
    ("target", "shift"): EffectKind(
        "place on the target x, y, in pitches",
        _PX,
        "dot x, y, z in the target's axes, mm",
        (_MM, _MM, _MM),
        "target_pose",
    ),
    ("stage", "pose"): EffectKind("stage reading x, y, z, mm", (_MM, _MM, _MM), _POSE_OF_CAMERA, _POSE, "part"),
    ("stage", "pose by travel"): EffectKind(
        "direction of travel, +1 or -1, and stage reading x, y, z, mm",
        (1.0, _MM, _MM, _MM),
        _POSE_OF_CAMERA,
        _POSE,
        "part",
    ),
    ("time", "pose"): EffectKind("time, s", (1.0,), _POSE_OF_CAMERA, _POSE, "part"),
    ("time", "shift"): EffectKind("time, s", (1.0,), _DECODED, _PX, "channel"),
    **{
        ("combiner", surfaces): EffectKind(_ON_COMBINER, (_MM, _MM), "height away from the eye, um", (_UM,))
        for surfaces in SURFACES
    },
    ("combiner", "view"): EffectKind(
        _ON_COMBINER, (_MM, _MM), "apparent direction right and up, in tangents, 1e-6", (_URAD, _URAD), "part"
    ),
}
"""Kinds of a bench session by (station, displaces)."""

DOT, TURN, LATE, PUPIL = (
    "image of the virtual dot u, v, camera px",
    "turn of the picture about x, y, z, mrad",
    "delay of the picture, ms",
    "true pupil from the tracked one x, y, z, mm",
)
"""Displacements by effects of a run-time session."""

_IMAGE, _PANEL, _RATE = "camera pixel u, v", "panel pixel u, v", "rate of the head x, y, z, rad/s"

RUN_TIME_KINDS = {
    ("camera", "picture"): EffectKind(_IMAGE, _PX, DOT, _PX),
    ("camera", "delay"): EffectKind(_IMAGE, _PX, LATE, (1e-3,)),
    ("panel", "picture"): EffectKind(_PANEL, _PX, DOT, _PX),
    ("panel", "delay"): EffectKind(_PANEL, _PX, LATE, (1e-3,)),
    ("head motion", "picture by gravity"): EffectKind("direction of gravity x, y, z", _AS_IS, TURN, _MRAD),
    ("head motion", "picture by rate"): EffectKind(_RATE, _AS_IS, TURN, _MRAD),
    ("head motion", "delay by rate"): EffectKind(_RATE, _AS_IS, LATE, (1e-3,)),
    ("eye tracking", "picture by pupil"): EffectKind("tracked pupil x, y, z, m", _AS_IS, DOT, _PX),
    ("eye tracking", "pupil by pupil"): EffectKind("tracked pupil x, y, z, m", _AS_IS, PUPIL, (_MM, _MM, _MM)),
    ("eye tracking", "pupil by gaze"): EffectKind("tangents of the gaze right and up", _PX, PUPIL, (_MM, _MM, _MM)),
    ("time", "picture"): EffectKind("time, s", (1.0,), TURN, _MRAD),
    ("time", "delay"): EffectKind("time, s", (1.0,), LATE, (1e-3,)),
}
"""Kinds of a run-time session; all axes are the device's."""

KINDS = {**BENCH_KINDS, **RUN_TIME_KINDS}
"""Kinds by (station, displaces)."""


@dataclass(frozen=True, eq=False)
class AnyFunction:
    """A smooth function of a user-defined cause.

    Attributes:
        function: maps coordinates (n, variables) to displacements (n, components).
        box: range of coordinates in which a file states the function.
    """

    function: Callable[[FloatArray], FloatArray]
    box: Box

    def __call__(self, inputs: FloatArray) -> FloatArray:
        """Return the displacements (n, components)."""
        return np.asarray(self.function(inputs), dtype=np.float64)

    def with_jacobian(self, inputs: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Return the displacements (n, components) and their derivatives (n, components, variables)."""
        steps = np.diag(_STEP / self.box.per_unit)
        slopes = [(self(inputs + step) - self(inputs - step)) / (2.0 * step.sum()) for step in steps]
        return self(inputs), np.stack(slopes, axis=-1)

    def as_polynomial(self) -> Polynomial:
        """Return the polynomial through the values at Chebyshev nodes of the box, for bench files."""
        places = self.box.places(_NODES)
        value, axes = self(places), []
        for axis in range(len(self.box.low)):
            others = places.copy()
            others[:, axis] = places[::-1, axis]
            if not np.array_equal(self(others), value):
                axes.append(axis)
        degree = _DEGREES.get(len(axes), 0)
        nodes = np.cos(np.pi * (np.arange(degree + 1) + 0.5) / (degree + 1))
        scaled = np.zeros((len(nodes) ** len(axes), len(self.box.low)))
        scaled[:, axes] = np.stack(np.meshgrid(*[nodes] * len(axes)), axis=-1).reshape(len(scaled), len(axes))
        orders = np.zeros((len(total_degree(len(axes), degree)), len(self.box.low)), dtype=np.int64)
        orders[:, axes] = total_degree(len(axes), degree)
        values = self(self.box.low + 0.5 * (scaled + 1.0) * (self.box.high - self.box.low))
        design = basis(scaled, orders, Box(-np.ones(len(self.box.low)), np.ones(len(self.box.low))))
        return Polynomial(orders, self.box, np.asarray(np.linalg.lstsq(design, values, rcond=None)[0], np.float64))


@dataclass(frozen=True, eq=False)
class BenchEffect:
    """A displacement at a station.

    Attributes:
        station, displaces: the kind, a key of `KINDS`.
        function: displacement as a function of the station's coordinates, in the units of the file; OpenXR axes.
        target_pose: pose of the target with the effect; -1 for all.
        part: part of the session with the effect, one of `PARTS`; empty for all.
        channel: colour with the effect: 0 red, 1 green, 2 blue; -1 for all.
        meeting: for a view, the number of the surface along the display's path that has the coordinates.
        covariance: (p, p) covariance of the coefficients, row by row, in the units of the file; None if unknown.
    """

    station: str
    displaces: str
    function: Polynomial | Cells | Wave | LocalWaves | AnyFunction
    target_pose: int = -1
    part: str = ""
    covariance: FloatArray | None = None
    meeting: int = 0
    channel: int = -1

    @classmethod
    def of_function(
        cls,
        station: str,
        displaces: str,
        function: Callable[[FloatArray], FloatArray],
        low: Sequence[float],
        high: Sequence[float],
        part: str = "",
    ) -> "BenchEffect":
        """Return the effect of any smooth function, for a user-defined cause.

        Args:
            station, displaces: as in an `[[effect]]` of bench.toml.
            function: maps coordinates (n, variables) to displacements (n, components), in the units of the file.
            low, high: bounds of the coordinates, between which a corrected bench.toml states the function as a
                polynomial.
            part: part of the session with the effect, "display" or "see-through"; empty for both.

        Raises:
            BadInputError: the station is unknown, or the bounds or the function do not fit it.

        Example:
            >>> import numpy as np
            >>> from wlr_render.files import BenchEffect
            >>> ripple = BenchEffect.of_function(
            ...     "combiner", "all surfaces", lambda place: 0.2 * np.sin(place[:, :1]), (-20, -20), (20, 20)
            ... )
        """
        kind, box = KINDS.get((station, displaces)), Box(np.asarray(low, float), np.asarray(high, float))
        if kind is None:
            kinds = ", ".join(f"{station} ({displaces})" for station, displaces in KINDS)
            raise BadInputError(f"There is no station '{station}' with a displacement '{displaces}'; choose {kinds}.")
        if not len(box.low) == len(box.high) == len(kind.per_coordinate) or not np.all(box.low < box.high):
            raise BadInputError(
                f"The bounds {list(low)} and {list(high)} of an effect of the {station} are not lower and upper ones "
                f"of {kind.coordinates}."
            )
        corners = np.stack([box.low, box.high])
        shape, components = np.shape(function(corners)), len(kind.per_displacement)
        if shape != (2, components):
            raise BadInputError(
                f"The function of an effect of the {station} returns shape {shape} for 2 places; it must return "
                f"(2, {components}): {kind.displacement}."
            )
        return cls(station, displaces, AnyFunction(function, box), part=part)


def displacement(
    effects: Sequence[BenchEffect],
    station: str,
    displaces: str,
    coordinates: FloatArray,
    part: str = "",
    **numbers: IntArray,
) -> FloatArray | None:
    """Return the sum of the effects of one kind, (n, components) in metres, radians or pixels; None without any.

    Args:
        effects: effects of the bench.
        station, displaces: the kind of effect.
        coordinates: (n, v) coordinates in metres, seconds or pixels.
        part: part of the session with these rows, if effects may be limited to one part.
        numbers: (n,) value of each row for an attribute, such as `channel`, to which effects may be limited.
    """
    of_kind = [each for each in effects if (each.station, each.displaces) == (station, displaces)]
    of_kind = [each for each in of_kind if not part or each.part in ("", part)]
    if not of_kind:
        return None
    kind = KINDS[station, displaces]
    total = np.zeros((len(coordinates), len(kind.per_displacement)))
    for effect in of_kind:
        value = effect.function(coordinates / np.array(kind.per_coordinate))
        for name, number in numbers.items():
            if getattr(effect, name) >= 0:
                value = np.where((number == getattr(effect, name))[:, None], value, 0.0)
        total += value
    return np.asarray(total * kind.per_displacement)


def optics_with_effects(optics: EyeOptics, effects: tuple[BenchEffect, ...]) -> EyeOptics:
    """Return an eye's optics with the effects' heights added to its combiner."""
    for effect in effects:
        if effect.displaces in SURFACES and not isinstance(effect.function, Cells):
            error = partial(SmoothSag, effect.function)
            optics = surfaces_raised(optics, SURFACES[effect.displaces](optics), error)
    return optics


def before_shift(after: FloatArray, shift: Callable[[FloatArray], FloatArray | None]) -> FloatArray:
    """Return the places (n, k) from which a shift, a function of the place, leads to the places `after` (n, k)."""
    place = after
    for _ in range(_ROUNDS):
        moved = shift(place)
        if moved is None:
            return after
        place = after - moved
    return place
