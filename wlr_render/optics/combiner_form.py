"""Form errors of a combiner: heights added to its surfaces, as functions of the position from its middle.

Heights raise a surface away from the eye. Positions are measured right and up from the point where the straight-ahead
line of sight meets the combiner, in the device frame.
"""

from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Protocol

import numpy as np

from wlr_render.geometry.transforms import rigid
from wlr_render.numerics.arrays import FloatArray
from wlr_render.optics.assembly import combiner_middle
from wlr_render.optics.device import EyeOptics, Interaction, Path, PlacedSurface
from wlr_render.optics.media import GREEN_UM
from wlr_render.optics.raised import FormError, raised
from wlr_render.optics.sag_surfaces import SagSurface
from wlr_render.optics.tracer import trace

_FORWARD = np.array([0.0, 0.0, -1.0])
_MM, _UM = 1e-3, 1e-6


def _all(optics: EyeOptics) -> set[str]:
    return {surface.name for surface in optics.surfaces()}


def _reflecting(optics: EyeOptics) -> set[str]:
    return {step.surface.name for step in optics.display.steps if step.interaction is not Interaction.REFRACT}


def _outermost(optics: EyeOptics) -> set[str]:
    return {step.surface.name for step in optics.see_through.steps[-1:]}


SURFACES = {"all surfaces": _all, "reflecting surfaces": _reflecting, "outer surface": _outermost}
"""Choices of surfaces to which a height is added: functions of an eye's optics that return the names."""


class Differentiable(Protocol):
    """A function with derivatives, such as a polynomial."""

    def with_jacobian(self, inputs: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Return the values (n, outputs) and derivatives (n, outputs, variables) at inputs (n, variables)."""


@dataclass(frozen=True, eq=False)
class SmoothSag(SagSurface):
    """A height in micrometres as a smooth function of the position in millimetres.

    Attributes:
        function: has one output; a polynomial continues to first order outside its box.
        sign: sign of the height along the surface's normal.
    """

    function: Differentiable
    sign: float

    def sag_and_slopes(self, x: FloatArray, y: FloatArray) -> tuple[FloatArray, FloatArray, FloatArray]:
        """Return the sag and slopes; see `SagSurface`."""
        height, slopes = self.function.with_jacobian(np.stack([x, y], axis=-1) / _MM)
        unit = self.sign * _UM
        return unit * height[:, 0], unit / _MM * slopes[:, 0, 0], unit / _MM * slopes[:, 0, 1]


def places_on_combiner(
    optics: EyeOptics,
    viewpoint: FloatArray,
    direction: FloatArray,
    meeting: int = 0,
    path: Path | None = None,
    wavelength_um: float = GREEN_UM,
) -> FloatArray:
    """Return where lines of sight meet a surface, (n, 2) metres right and up of the combiner's middle.

    NaN for lines that miss, and without a combiner.

    Args:
        optics: the optics.
        viewpoint, direction: (n, 3) origin and direction of each line, device frame.
        meeting: number of the surface along the path.
        path: path of the lines of sight; the display path by default.
        wavelength_um: vacuum wavelength in micrometres.
    """
    steps = (path or optics.display).steps
    if meeting >= len(steps):
        return np.full((len(direction), 2), np.nan)
    met = trace(Path(steps[: meeting + 1]), viewpoint, direction, wavelength_um)
    return np.asarray((met.origin - combiner_middle(optics))[:, :2])


def surfaces_raised(
    optics: EyeOptics, names: set[str], error: Callable[[float], SagSurface], place: FloatArray | None = None
) -> EyeOptics:
    """Return the optics with a height added to some surfaces.

    Args:
        optics: the optics.
        names: names of the surfaces.
        error: maps the side of a surface's normal (+1: away from the eye) to the height to be added.
        place: (2,) origin of the error from the combiner's middle, metres.
    """
    middle = combiner_middle(optics)
    device_from_error = rigid(np.eye(3), middle + np.append(np.zeros(2) if place is None else place, 0.0))

    def with_error(surface: PlacedSurface) -> PlacedSurface:
        if surface.name not in names:
            return surface
        added = FormError(error(outward(surface, middle)), surface.surface_from_device @ device_from_error)
        return replace(surface, shape=raised(surface.shape, added))

    return optics.with_surfaces(with_error)


def outward(surface: PlacedSurface, middle: FloatArray, along_axis: bool = False) -> float:
    """Return +1 if a surface's normal, or its axis, points into the world where the eye looks through it, else -1.

    `middle` (3,) is the point that the eye looks through, see `assembly.combiner_middle`.
    """
    pose = surface.surface_from_device
    local = (pose[:3, :3] @ middle + pose[:3, 3])[:, None]
    normal = surface.shape.normal(local)[:, 0]
    ahead = surface.device_from_surface[:3, :3] @ normal @ _FORWARD
    return float(np.sign(ahead * normal[2] if along_axis else ahead)) or 1.0
