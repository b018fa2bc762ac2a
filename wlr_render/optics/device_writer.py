"""Write device prescriptions in the format that `device_file` reads (devices/README.md), in device axes."""

from dataclasses import replace
from pathlib import Path as FilePath
from typing import Any

import numpy as np

from wlr_render.io.file_records import Place, record_keys
from wlr_render.io.toml_files import write_toml
from wlr_render.optics.device import (
    Device,
    EyeOptics,
    Interaction,
    Path,
    PlacedSurface,
    mirrored,
)
from wlr_render.optics.device_keys import EYE_BOX, FIELD, SurfacePose
from wlr_render.optics.device_media import medium_content
from wlr_render.optics.device_shapes import shape_content
from wlr_render.optics.media import AIR, Medium
from wlr_render.optics.raised import FormError, Offset, base_of, nesting
from wlr_render.optics.surfaces import Shape


def save_device(device: Device, path: str | FilePath) -> FilePath:
    """Write a device that `load_device` reads back, to the rounding of its numbers.

    Media of one name that differ between the eyes get the side added to the name. A displaced surface gets a separate
    base if its base has another pose or is not in a path.
    """
    return write_toml(path, device_content(device))


def device_content(device: Device) -> dict[str, Any]:
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


def _eyes(device: Device, names: dict[Medium, str]) -> list[dict[str, Any]]:
    """Return one table for both eyes if one is the mirror image of the other, else one for each."""
    first, *others = device.eyes
    tables = {side: _eye(eye, names) for side, eye in device.eyes.items()}
    if others and tables[others[0]] == _eye(mirrored(device.eyes[first]), names):
        return [{"side": first, "also_mirrored": True} | tables[first]]
    return [{"side": side} | table for side, table in tables.items()]


def _eye(eye: EyeOptics, names: dict[Medium, str]) -> dict[str, Any]:
    return {
        "display_path": _path(eye.display, names),
        "see_through_path": _path(eye.see_through, names),
        **({} if eye.field is None else FIELD.keys(eye.field, Place())),
        "eye_box": EYE_BOX.keys(eye.eye_box, Place()),
        "panel": record_keys(eye.panel),
        **_surfaces(eye.surfaces()),
    }


def _path(path: Path, names: dict[Medium, str]) -> list[dict[str, Any]]:
    return [
        {"at": step.surface.name, "do": str(step.interaction)}
        | ({"into": names[step.medium]} if step.interaction is Interaction.REFRACT else {})
        for step in path.steps
    ]


def _surfaces(surfaces: tuple[PlacedSurface, ...]) -> dict[str, Any]:
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


def _surface(surface: PlacedSurface, bases: dict[str, str]) -> dict[str, Any]:
    shape, keys = surface.shape, record_keys(surface)
    if not isinstance(shape, Offset):
        return {"name": surface.name} | shape_content(shape) | keys
    content: dict[str, Any] = {"name": surface.name, "shape": "offset", "of": bases[surface.name]}
    if shape.errors:
        content |= {"shape": "raised", "error": [_error(surface, each) for each in shape.errors]}
    else:
        content |= record_keys(shape)
    return content | {key: keys[key] for key in keys if key.startswith("aperture")}


def _error(surface: PlacedSurface, error: FormError) -> dict[str, Any]:
    pose = surface.device_from_surface @ error.surface_from_error
    return shape_content(error.sag) | SurfacePose().keys(pose, Place())
