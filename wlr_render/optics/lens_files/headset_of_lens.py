"""Build a headset from a sequential prescription: choose eye and panel, and add the data that the file lacks."""

from dataclasses import dataclass, replace
from pathlib import Path
from typing import Literal

import numpy as np

from wlr_render.errors import BadInputError
from wlr_render.geometry.directions import dir_of_tangents
from wlr_render.geometry.transforms import rigid
from wlr_render.mappings import EyeBox, Panel
from wlr_render.numerics.arrays import FloatArray
from wlr_render.optics.device import ClearAperture, Device, EyeOptics, Interaction, PlacedPanel, PlacedSurface, Step
from wlr_render.optics.device import Path as RayPath
from wlr_render.optics.lens_files.sequence import Ignored, LensFile, LensSurface, box_aperture
from wlr_render.optics.media import AIR, GREEN_UM
from wlr_render.optics.surfaces import Conic
from wlr_render.optics.tracer import trace

_MM = 1e-3
_PROBE = 0.01  # tangent of the rays that test whether the image on the panel is upright
_MOST_SURFACES = 100  # most surfaces of a device file
_SAME_UM = 0.1  # difference between two forms of a panel below which no note is written


@dataclass(frozen=True, kw_only=True)
class HeadsetChoices:
    """Choices about a headset that a lens file does not state, named as the options of `import-lens`.

    Attributes:
        name: name of the device.
        source: source of its numbers.
        starts_at: where the light of the file begins.
        pupil_surface: number of the surface at the eye's pupil; None for the aperture stop.
        eye_relief_mm: distance of the pupil from the first surface that bends rays, in place of `pupil_surface`.
        panel_surface: number of the panel's surface; None for the image, or for the object if the light starts there.
        panel_mm: (width, height) of the lit area.
        panel: pixels of the panel.
        eye_box_mm: (3,) along right, up and back.
        eye_centre_mm: (3,) the pupil in the device.
        eye: side of the eye.
        semi_diameters: True to use the semi-diameters of drawn surfaces as clear apertures.
    """

    name: str
    source: str
    starts_at: Literal["eye", "panel"]
    pupil_surface: int | None
    eye_relief_mm: float | None
    panel_surface: int | None
    panel_mm: tuple[float, float]
    panel: tuple[int, int]
    eye_box_mm: tuple[float, float, float]
    eye_centre_mm: tuple[float, float, float]
    eye: str
    semi_diameters: bool


@dataclass(frozen=True, eq=False)
class ImportedHeadset:
    """A headset, and the choices that were made on import.

    Attributes:
        device: the headset, of one eye, which sees the real world without the optics.
        path: numbers of the surfaces that the display path passes, from the eye to the panel.
        passed_over: surfaces between eye and panel without effect on rays.
        ignored: keys of the file, and the panel's form, that the device does not have.
        panel_number: surface of the panel.
        pupil_text: description of the pupil's position.
        is_reached: True if rays from the middle of the pupil meet the panel, which then defines its upright
            orientation.
    """

    device: Device
    path: tuple[int, ...]
    passed_over: tuple[int, ...]
    ignored: tuple[Ignored, ...]
    panel_number: int
    pupil_text: str
    is_reached: bool


def headset_of_lens(path: Path, lens: LensFile, choices: HeadsetChoices) -> ImportedHeadset:
    """Build a headset of one eye from a sequential prescription.

    Args:
        path: path of the lens file, for messages.
        lens: content of the file.
        choices: choices that the file does not state.

    Raises:
        BadInputError: the pupil or the panel cannot be determined, or nothing lies between them.
    """
    places = {surface.number: place for place, surface in enumerate(lens.surfaces)}
    from_eye = choices.starts_at == "eye"
    panel_place = _panel_place(path, lens, choices, places)
    bending = [place for place in range(len(lens.surfaces)) if lens.bends_rays(place) and place != panel_place]
    bending = [place for place in bending if (place < panel_place) == from_eye]
    if not bending:
        raise BadInputError(
            f"{path}: no mirror or glass lies between the eye and the panel; check --starts-at{_unread_types(lens)}."
        )
    if len(bending) > _MOST_SURFACES:
        raise BadInputError(f"{path}: {len(bending)} surfaces bend rays; a device file has at most {_MOST_SURFACES}.")
    at_eye = lens.medium_before(bending[0]) if from_eye else lens.surfaces[bending[-1]].medium
    if at_eye != AIR:
        raise BadInputError(f"{path}: the eye would be in {at_eye.name}; in a headset it is in air: check --starts-at.")
    file_from_pupil, pupil_text = _pupil(path, lens, choices, places, bending)
    device_from_file = _device_from_pupil(choices) @ np.linalg.inv(file_from_pupil)
    ordered = bending if from_eye else bending[::-1]
    steps = []
    for place in ordered:
        surface = lens.surfaces[place]
        placed = PlacedSurface(
            _name(surface),
            surface.shape,
            device_from_file @ surface.file_from_surface,
            _aperture(surface, choices.semi_diameters),
        )
        medium = surface.medium if from_eye or surface.reflects else lens.medium_before(place)
        steps.append(Step(placed, Interaction.REFLECT if surface.reflects else Interaction.REFRACT, medium))
    display = RayPath(tuple(steps))
    panel_surface = lens.surfaces[panel_place]
    eye_box = EyeBox(_MM * np.array(choices.eye_centre_mm), _MM * np.array(choices.eye_box_mm))
    panel, is_reached = _panel(device_from_file @ panel_surface.file_from_surface, display, eye_box.centre, choices)
    panel, notes = _bowed(panel, panel_surface, device_from_file)
    device = Device(choices.name, choices.source, {choices.eye: EyeOptics(display, RayPath(), panel, eye_box)})
    between = range(min(*ordered, panel_place), max(*ordered, panel_place) + 1)
    passed_over = tuple(lens.surfaces[place].number for place in between if place not in (*ordered, panel_place))
    return ImportedHeadset(
        device,
        tuple(lens.surfaces[place].number for place in ordered),
        passed_over,
        (*lens.ignored, *notes),
        panel_surface.number,
        pupil_text,
        is_reached,
    )


def _unread_types(lens: LensFile) -> str:
    """Return a clause on surfaces that bend rays and have an unsupported type; may be empty."""
    unread = [f"surface {note.surface} ({note.value})" for note in lens.ignored if note.part == "shape"]
    return f" and the types that are not read: {', '.join(unread[:5])}" if unread else ""


def _panel_place(path: Path, lens: LensFile, choices: HeadsetChoices, places: dict[int, int]) -> int:
    if choices.panel_surface is not None:
        place = _place(path, places, choices.panel_surface, "--panel-surface")
    else:
        place = len(lens.surfaces) - 1 if choices.starts_at == "eye" else 0
    if not np.isfinite(lens.surfaces[place].file_from_surface).all():
        raise BadInputError(
            f"{path}: surface {lens.surfaces[place].number}, the panel, lies at infinity; name another with "
            "--panel-surface, or leave out --starts-at panel if the light of the file starts at the eye."
        )
    return place


def _place(path: Path, places: dict[int, int], number: int, option: str) -> int:
    if number not in places:
        raise BadInputError(
            f"{path}: {option} is {number}; the surfaces are {min(places)} to {max(places)}, without coordinate breaks."
        )
    return places[number]


def _pupil(
    path: Path, lens: LensFile, choices: HeadsetChoices, places: dict[int, int], bending: list[int]
) -> tuple[FloatArray, str]:
    """Return the frame of the pupil in the file, with the eye looking along z, and a description of its position."""
    from_eye = choices.starts_at == "eye"
    nearest = bending[0] if from_eye else bending[-1]
    mirrors = sum(lens.surfaces[place].reflects for place in bending)
    look = 1.0 if from_eye else -1.0 if mirrors % 2 == 0 else 1.0
    turned = np.eye(4) if look > 0 else np.diag([-1.0, 1.0, -1.0, 1.0])
    first = lens.surfaces[nearest]
    if choices.eye_relief_mm is not None:
        axes = lens.surfaces[1 if from_eye else len(lens.surfaces) - 1].file_from_surface
        pose = rigid(axes[:3, :3], first.file_from_surface[:3, 3]) @ turned
        text = f"{choices.eye_relief_mm:g} mm before surface {first.number}, as --eye-relief-mm says"
        return pose @ rigid(np.eye(3), np.array([0.0, 0.0, -_MM * choices.eye_relief_mm])), text
    if choices.pupil_surface is not None:
        place = _place(path, places, choices.pupil_surface, "--pupil-surface")
        text = f"at surface {choices.pupil_surface}"
    else:
        stops = [place for place, surface in enumerate(lens.surfaces) if surface.is_stop]
        if not stops:
            raise BadInputError(
                f"{path}: names no aperture stop; say where the eye is: --pupil-surface, --eye-relief-mm."
            )
        place, text = stops[0], f"at surface {lens.surfaces[stops[0]].number}, the aperture stop"
    between = [each for each in bending if (each <= place if from_eye else each >= place)]
    if between or not np.isfinite(lens.surfaces[place].file_from_surface).all():
        listed = ", ".join(str(lens.surfaces[each].number) for each in between[:5]) or "infinity"
        raise BadInputError(
            f"{path}: the eye's pupil cannot stand at surface {lens.surfaces[place].number}: the optics of surface "
            f"{listed} would be behind the eye or at it; give --eye-relief-mm, --pupil-surface, or --starts-at."
        )
    return lens.surfaces[place].file_from_surface @ turned, text


def _device_from_pupil(choices: HeadsetChoices) -> FloatArray:
    """Return the rotation from the pupil's frame (looking along z) to the device (looking along -z)."""
    return rigid(np.diag([-1.0, 1.0, -1.0]), _MM * np.array(choices.eye_centre_mm))


def _name(surface: LensSurface) -> str:
    words = "".join(each if each.isascii() and each.isalnum() else "_" for each in surface.label.lower())
    return f"s{surface.number}_{words}".strip("_")[:60]


def _aperture(surface: LensSurface, use_semi_diameters: bool) -> ClearAperture:
    half = surface.semi_diameter
    if use_semi_diameters and not np.isfinite(surface.aperture.low).any() and half > 0:
        return box_aperture((-half, -half), (half, half))
    return surface.aperture


def _panel(
    device_from_surface: FloatArray, display: RayPath, viewpoint: FloatArray, choices: HeadsetChoices
) -> tuple[PlacedPanel, bool]:
    """Return the panel in its surface's plane, upright by a turn in steps of 90 degrees, and whether rays meet it."""
    flat = PlacedPanel(device_from_surface, np.ones(2), Panel(1, 1))
    tangents = _PROBE * np.array([[1.0, 0.0], [-1.0, 0.0], [0.0, 1.0], [0.0, -1.0]])
    traced = trace(display, viewpoint, dir_of_tangents(tangents), GREEN_UM)
    right, left, up, down = flat.pixel_of_ray(traced.origin, traced.direction)
    jacobian = np.stack([right - left, up - down], axis=-1)
    is_reached = bool(np.isfinite(jacobian).all())
    if not is_reached:
        jacobian = np.diag([-1.0, 1.0])  # the orientation in the file
    along = int(np.argmax(np.abs(jacobian[:, 0])))
    axes = np.zeros((3, 3))
    axes[along, 0] = np.copysign(1.0, jacobian[along, 0])
    axes[1 - along, 1] = -np.copysign(1.0, jacobian[1 - along, 1])
    axes[:, 2] = np.cross(axes[:, 0], axes[:, 1])
    pose = device_from_surface @ rigid(axes, np.zeros(3))
    return PlacedPanel(pose, _MM * np.array(choices.panel_mm), Panel(*choices.panel)), is_reached


def _bowed(panel: PlacedPanel, surface: LensSurface, device_from_file: FloatArray) -> tuple[PlacedPanel, list[Ignored]]:
    """Return the panel with the curvature of its surface, as the paraboloid of a device file."""
    shape = surface.shape
    if not isinstance(shape, Conic):
        note = Ignored(
            surface.number, "shape", type(shape).__name__, "a panel is flat or a paraboloid: taken flat", True
        )
        return panel, [note]
    if shape.curvature == 0.0:
        return panel, []
    towards = panel.device_from_panel[:3, 2] @ (device_from_file @ surface.file_from_surface)[:3, 2]
    r_squared = 0.25 * float(np.sum(panel.size**2))
    root = np.sqrt(max(1.0 - (1.0 + shape.conic) * shape.curvature**2 * r_squared, 0.0))
    off_um = 1e6 * abs(shape.curvature * r_squared * (1.0 / (1.0 + root) - 0.5))
    bowed = replace(panel, curvature=np.full(2, np.copysign(shape.curvature, shape.curvature * towards)))
    if off_um < _SAME_UM:
        return bowed, []
    value = f"radius {1e3 / shape.curvature:g} mm"
    reason = f"a bowed panel is a paraboloid in a device file: off by {off_um:.2g} um at its corners"
    return bowed, [Ignored(surface.number, "CURV", value, reason, True)]
