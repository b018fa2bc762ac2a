"""Write device prescriptions in the format that `device_file` reads (devices/README.md), in device axes."""

from dataclasses import replace
from pathlib import Path as FilePath

import numpy as np

from wlr_render.io.toml_files import write_toml
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
from wlr_render.optics.device_media import medium_content
from wlr_render.optics.device_shapes import MM, Content, in_mm, shape_content
from wlr_render.optics.media import AIR, Medium
from wlr_render.optics.raised import Offset, base_of, nesting
from wlr_render.optics.surfaces import Shape


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
    media = [medium_content(name, medium) for medium, name in names.items() if medium != AIR]
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
        "eye_box": {"centre_mm": in_mm(eye.eye_box.centre), "size_mm": in_mm(eye.eye_box.size)},
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
        "centre_mm": in_mm(panel.device_from_panel[:3, 3]),
        "size_mm": in_mm(panel.size),
        "pixels": [panel.pixels.width_px, panel.pixels.height_px],
        "u_axis": panel.device_from_panel[:3, 0].tolist(),
        "v_axis": panel.device_from_panel[:3, 1].tolist(),
        **({"curvature_per_m": panel.curvature.tolist()} if panel.curvature.any() else {}),
    }


def _surfaces(surfaces: tuple[PlacedSurface, ...]) -> Content:
    """Return all surfaces and the bases that displaced ones need, each base before the surfaces that refer to it."""
    placed, bases = list(surfaces), dict[str, str]()
    for surface in placed:  # grows by the bases, which may be displaced too
        if (shape := base_of(surface.shape)) is None:
            continue
        base = _placed_base(surface, shape, placed)
        bases[surface.name] = base.name
        if base not in placed:
            placed.append(base)
    ordered = sorted(placed, key=lambda surface: nesting(surface.shape))
    return {"surface": [_surface(surface, bases) for surface in ordered]} if placed else {}


def _placed_base(surface: PlacedSurface, shape: Shape, placed: list[PlacedSurface]) -> PlacedSurface:
    """Return the surface that is the base of a displaced one: an existing surface in its place, or a new one."""
    for other in placed:
        if other.shape == shape and np.array_equal(other.device_from_surface, surface.device_from_surface):
            return other
    name = f"{surface.name}_base"
    while any(name == other.name for other in placed):
        name += "_base"
    return replace(surface, name=name, shape=shape)


def _surface(surface: PlacedSurface, bases: dict[str, str]) -> Content:
    shape = surface.shape
    if not isinstance(shape, Offset):
        content = shape_content(shape) | _pose(surface.device_from_surface)
    elif not shape.errors:
        content = {"shape": "offset", "of": bases[surface.name], "distance_mm": shape.distance / MM}
    else:
        errors = [
            shape_content(each.sag) | _pose(surface.device_from_surface @ each.surface_from_error)
            for each in shape.errors
        ]
        content = {"shape": "raised", "of": bases[surface.name], "error": errors}
    return {"name": surface.name} | content | _aperture(surface.aperture)


def _pose(device_from_surface: FloatArray) -> Content:
    rotation = device_from_surface[:3, :3]
    return {
        "origin_mm": in_mm(device_from_surface[:3, 3]),
        "z_axis": rotation[:, 2].tolist(),
        "x_axis": rotation[:, 0].tolist(),
        **({"mirrored": True} if np.linalg.det(rotation) < 0 else {}),
    }


def _aperture(aperture: ClearAperture) -> Content:
    """Return a pair (low, high) for each axis on which the aperture is bounded."""
    sides = zip("xyz", aperture.low, aperture.high, strict=True)
    return {f"aperture_{axis}_mm": in_mm(np.array(side)) for axis, *side in sides if np.isfinite(side).any()}
