"""A headset for the ray tracer: placed surfaces, ray paths, panel and eye box. Metres, device frame."""

from collections.abc import Callable
from dataclasses import dataclass, field, replace
from enum import StrEnum
from functools import cached_property, partial
from typing import Annotated

import numpy as np

from wlr_render.errors import BadInputError
from wlr_render.geometry.transforms import inverse
from wlr_render.html_summary import SummaryTable, html_summary
from wlr_render.io.file_records import LENGTH, Key, Keys, Quantity, Rule
from wlr_render.mappings import EyeBox, FieldOfView, Panel
from wlr_render.numerics.arrays import FloatArray
from wlr_render.optics.device_keys import FAR_MM, PANEL_POSE, SurfacePose
from wlr_render.optics.media import AIR, Medium
from wlr_render.optics.surfaces import Shape

_COUNTS = Quantity(lambda counts, _: Panel(*map(int, counts)), lambda panel, _: (panel.width_px, panel.height_px))
_WHOLE = Rule(
    "two whole numbers of at least 1, width and height", lambda counts: bool(np.all((counts >= 1) & (counts % 1 == 0)))
)
MIRROR_X = np.diag([-1.0, 1.0, 1.0, 1.0])
"""Mirror image that maps one eye's half of the device to the other's."""


class Interaction(StrEnum):
    """Interaction of a ray with a surface."""

    REFRACT = "refract"
    REFLECT = "reflect"
    TOTAL_REFLECT = "total_reflect"


@dataclass(frozen=True, eq=False)
class ClearAperture:
    """Clear aperture of a surface: a box in local axes, in metres; infinite where unlimited."""

    low: FloatArray
    high: FloatArray


_SIDE = partial(Key, quantity=LENGTH, shape=(2,), most=FAR_MM)
_ASCENDING = Rule("[low, high] with low below high", lambda side: bool(side[0] < side[1]))
_APERTURE = Keys(
    tuple(_SIDE(f"aperture_{axis}_mm", rule=_ASCENDING) for axis in "xyz"),
    lambda *sides: ClearAperture(*np.stack(sides, axis=1)),
    lambda aperture: np.stack([aperture.low, aperture.high], axis=1),
    absent=np.array([-np.inf, np.inf]),
)


@dataclass(frozen=True, eq=False)
class PlacedSurface:
    """A surface with its pose in the device.

    Attributes:
        name: unique within an eye.
        shape: the surface in local axes.
        device_from_surface: (4, 4); orthogonal, and improper (a reflection) in a mirrored eye.
        aperture: the clear aperture; it also selects one of several intersections.
    """

    name: str
    shape: Shape
    device_from_surface: Annotated[FloatArray, SurfacePose()]
    aperture: Annotated[ClearAperture, _APERTURE]

    @cached_property
    def surface_from_device(self) -> FloatArray:
        """Inverse of `device_from_surface`, (4, 4)."""
        return inverse(self.device_from_surface)


@dataclass(frozen=True)
class Step:
    """One surface interaction along a path.

    Attributes:
        surface: the surface.
        interaction: refraction or reflection.
        medium: medium after the step; only a refraction changes it.
    """

    surface: PlacedSurface
    interaction: Interaction
    medium: Medium


@dataclass(frozen=True)
class Path:
    """Surface interactions of a ray in order, from the eye outwards, starting in air. No steps: a straight line."""

    steps: tuple[Step, ...] = ()


@dataclass(frozen=True, eq=False)
class PlacedPanel:
    """A panel with its pose in the device.

    Attributes:
        device_from_panel: (4, 4) rigid; origin in the panel's centre, x along u, y along v (down the image).
        size: (2,) metres, width and height of the lit area, measured in its plane z = 0.
        pixels: its pixel counts.
        curvature: (2,) 1/m; a bowed panel is z = (curvature_u x^2 + curvature_v y^2) / 2, a flat one has zeros.
    """

    device_from_panel: Annotated[FloatArray, PANEL_POSE]
    size: Annotated[FloatArray, Key("size_mm", LENGTH, shape=(2,), least=0.5, most=FAR_MM)]
    pixels: Annotated[Panel, Key("pixels", _COUNTS, shape=(2,), rule=_WHOLE)]
    curvature: Annotated[FloatArray, Key("curvature_per_m", shape=(2,))] = field(default_factory=partial(np.zeros, 2))

    @cached_property
    def panel_from_device(self) -> FloatArray:
        """Inverse of `device_from_panel`, (4, 4)."""
        return inverse(self.device_from_panel)

    def pixel_of_local(self, point_in_panel: FloatArray) -> FloatArray:
        """Return the pixels (..., 2) of points (..., 2) in the panel's frame, metres."""
        return np.asarray((point_in_panel / self.size + 0.5) * self.pixels.size_px)

    def point_of_pixel(self, pixel: FloatArray) -> FloatArray:
        """Return the points (..., 3) of pixels (..., 2), metres, device frame."""
        flat = (pixel / self.pixels.size_px - 0.5) * self.size
        local = np.concatenate([flat, 0.5 * (flat * flat @ self.curvature)[..., None]], axis=-1)
        return np.asarray(local @ self.device_from_panel[:3, :3].T + self.device_from_panel[:3, 3])

    def pixel_of_ray(self, origin: FloatArray, direction: FloatArray) -> FloatArray:
        """Return pixels (..., 2) where rays (..., 3), (..., 3) in the device frame meet the panel or its continuation.

        NaN where a ray does not meet it ahead. Of two intersections, the one nearer to the plane z = 0 counts.
        """
        pose = self.panel_from_device
        start, along = origin @ pose[:3, :3].T + pose[:3, 3], direction @ pose[:3, :3].T
        flat, across = start[..., :2], along[..., :2]
        # a t^2 + 2 half_b t + c = 0, by the root that is -c / (2 half_b) on a flat panel
        a = 0.5 * (across * across) @ self.curvature
        half_b = 0.5 * ((flat * across) @ self.curvature - along[..., 2])
        c = 0.5 * (flat * flat) @ self.curvature - start[..., 2]
        with np.errstate(divide="ignore", invalid="ignore"):
            distance = -c / (half_b + np.copysign(np.sqrt(half_b * half_b - a * c), half_b))
        distance = np.where(np.isfinite(distance) & (distance > 0.0), distance, np.nan)
        return self.pixel_of_local(flat + distance[..., None] * across)


@dataclass(frozen=True, eq=False)
class EyeOptics:
    """Optics, panel and eye box of one eye.

    Attributes:
        display: path from the eye to the panel.
        see_through: path from the eye to the world.
        panel: the display panel.
        eye_box: box of valid viewpoints; its centre is the nominal viewpoint.
        field: the nominal field of view, over which errors are stated; None for the whole panel.
    """

    display: Path
    see_through: Path
    panel: PlacedPanel
    eye_box: EyeBox
    field: FieldOfView | None = None

    def surfaces(self) -> tuple[PlacedSurface, ...]:
        """Return all surfaces of both paths, each once, in the order of the first intersection."""
        steps = self.display.steps + self.see_through.steps
        return tuple({step.surface.name: step.surface for step in steps}.values())

    def with_surfaces(self, change: Callable[[PlacedSurface], PlacedSurface]) -> "EyeOptics":
        """Return a copy with every surface changed in both paths."""
        changed = {surface.name: change(surface) for surface in self.surfaces()}
        return self._with_steps(lambda step: replace(step, surface=changed[step.surface.name]))

    def with_media(self, change: Callable[[Medium], Medium]) -> "EyeOptics":
        """Return a copy with every medium except air changed in both paths."""
        return self._with_steps(lambda step: step if step.medium == AIR else replace(step, medium=change(step.medium)))

    def _with_steps(self, change: Callable[[Step], Step]) -> "EyeOptics":
        display, see_through = (Path(tuple(map(change, path.steps))) for path in (self.display, self.see_through))
        return replace(self, display=display, see_through=see_through)


@dataclass(frozen=True, eq=False)
class Device:
    """A headset.

    Attributes:
        name: short name.
        source: source of the numbers.
        eyes: eyes by name, "left" and "right"; a device may have only one.
    """

    name: str
    source: str
    eyes: dict[str, EyeOptics]

    def optics(self, eye: str) -> EyeOptics:
        """Return the optics of an eye.

        Raises:
            BadInputError: the device has no such eye.
        """
        if eye not in self.eyes:
            raise BadInputError(
                f"Device '{self.name}' has no {eye} eye; choose {' or '.join(self.eyes)}, or add it: also_mirrored = "
                "true in a device file makes the other eye of one."
            )
        return self.eyes[eye]

    def __repr__(self) -> str:
        return f"Device({self.name!r}, eyes: {', '.join(self.eyes)})"

    def _repr_html_(self) -> str:
        tables = []
        for eye, optics in self.eyes.items():
            width, height = (f"{1e3 * size:.3g}" for size in optics.panel.size)
            pixels = optics.panel.pixels
            path = [f"{step.interaction} at {step.surface.name}".replace("_", " ") for step in optics.display.steps]
            rows = [
                ("panel", f"{pixels.width_px} x {pixels.height_px} px, {width} x {height} mm"),
                ("display path, from the eye", ", ".join(path) or "straight to the panel"),
                ("nominal field of view", "not stated" if optics.field is None else str(optics.field)),
            ]
            tables.append(SummaryTable((), rows, f"The {eye} eye"))
        return html_summary(f"Device {self.name}", [self.source], tables)


def mirrored(eye: EyeOptics) -> EyeOptics:
    """Return the optics of the other eye: mirrored in x = 0.

    u of the panel still runs to the wearer's right, so pixel (u, v) of one eye is (width - u, v) of the other.
    """
    reflected = eye.with_surfaces(lambda s: replace(s, device_from_surface=MIRROR_X @ s.device_from_surface))
    # Two reflections make the panel's pose rigid again, and reverse u.
    device_from_panel = MIRROR_X @ eye.panel.device_from_panel @ MIRROR_X
    box, field = eye.eye_box, eye.field
    turned = np.array([-1.0, 1.0])
    return replace(
        reflected,
        panel=replace(eye.panel, device_from_panel=device_from_panel),
        eye_box=EyeBox(MIRROR_X[:3, :3] @ box.centre, box.size),
        field=field
        and FieldOfView(
            np.minimum(turned * field.low, turned * field.high), np.maximum(turned * field.low, turned * field.high)
        ),
    )
