"""Reads device prescriptions (devices/README.md has the format). Millimetres and degrees become metres and radians."""

from pathlib import Path as FilePath

import numpy as np

from wlr_render.files import Table, named_or_path, read_toml
from wlr_render.geometry.transforms import OPENXR_FROM_OPENCV, rigid
from wlr_render.mappings import EyeBox, Field, Panel
from wlr_render.numerics.arrays import FloatArray
from wlr_render.optics.device import Device, EyeOptics, Interaction, Path, PlacedPanel, PlacedSurface, Step, mirrored
from wlr_render.optics.media import AIR, FORMULAS, Medium
from wlr_render.optics.surface_file import MM, axes, named, offset_chain, placed_surface, positive

FRAMES = {"openxr": np.eye(3), "opencv": OPENXR_FROM_OPENCV}
"""Rotation from the axes that a file states to the device frame's, by their name."""
_GREEN_UM = 0.55
_OTHER_SIDE = {"right": "left", "left": "right"}


def load_device(spec: str | FilePath) -> Device:
    """Read a device by its shipped name or by the path of its file.

    Raises:
        BadInputError: the file does not exist, is not TOML, or breaks the format; the sentence says where.
    """
    return device_of(read_toml(device_path(spec)))


def device_path(spec: str | FilePath) -> FilePath:
    """Path of a device file, given a shipped device's name or a path.

    Raises:
        BadInputError: there is no such device.
    """
    return named_or_path("devices", spec)


def device_of(file: Table) -> Device:
    """Build a device from an opened file; every key must be known."""
    frame = FRAMES[file.text("frame", choices=sorted(FRAMES))]
    media = _media(file)
    eyes: dict[str, EyeOptics] = {}
    for table in file.tables("eye"):
        side = table.text("side", choices=sorted(_OTHER_SIDE))
        wanted = [side, _OTHER_SIDE[side]] if table.flag("also_mirrored", default=False) else [side]
        for name in wanted:
            if name in eyes:
                raise table.fail(f"the {name} eye is already given; give each side once.")
        eye = _eye(table, frame, media)
        eyes.update(zip(wanted, [eye, mirrored(eye)], strict=False))
    if not eyes:
        raise file.fail("there is no [[eye]]; give at least one.")
    device = Device(file.file_stem("name"), file.text("source"), eyes)
    file.finish()
    return device


def _media(file: Table) -> dict[str, Medium]:
    media = {AIR.name: AIR}
    for table in file.tables("medium", required=False):
        name = table.text("name")
        if name in media:
            raise table.fail(f"there is already a medium '{name}'; choose another name.")
        media[name] = _medium(table, name)
        table.finish()
    return media


def _medium(table: Table, name: str) -> Medium:
    if table.has("formula"):
        medium = Medium(name, FORMULAS[table.text("formula", choices=sorted(FORMULAS))])
    else:
        medium = Medium.constant(name, positive(table, "index"))
    medium = medium.shifted(table.number("index_shift", default=0.0))
    if medium.index(_GREEN_UM) <= 0:
        raise table.fail("'index_shift' makes the refractive index negative; it must stay positive.")
    return medium


def _eye(table: Table, frame: FloatArray, media: dict[str, Medium]) -> EyeOptics:
    surfaces: dict[str, PlacedSurface] = {}
    for entry in table.tables("surface", required=False):
        surface = placed_surface(entry, frame, surfaces)
        surfaces[surface.name] = surface
    display = _path(table.tables("display_path"), surfaces, media)
    see_through = _path(table.tables("see_through_path"), surfaces, media)
    if see_through.steps and see_through.steps[-1].medium is not AIR:
        raise table.fail("'see_through_path' must end in air.")
    panel, eye_box = _panel(table.table("panel"), frame), _eye_box(table.table("eye_box"), frame)
    eye = EyeOptics(display, see_through, panel, eye_box, _field(table))
    used = [shape for surface in eye.surfaces() for shape in offset_chain(surface.shape)]
    for name, surface in surfaces.items():
        if not any(shape is surface.shape for shape in used):
            raise table.fail(f"surface '{name}' is in no path; remove it or use it.")
    table.finish()
    return eye


def _path(entries: list[Table], surfaces: dict[str, PlacedSurface], media: dict[str, Medium]) -> Path:
    """Steps written as { at = surface, do = interaction, into = medium }; `into` belongs to refractions only."""
    medium = AIR
    steps = []
    for entry in entries:
        surface = surfaces[named(entry, "at", "surface", surfaces)]
        interaction = Interaction(entry.text("do", choices=[str(each) for each in Interaction]))
        if interaction is Interaction.REFRACT:
            medium = media[named(entry, "into", "medium", media)]
        entry.finish()
        steps.append(Step(surface, interaction, medium))
    return Path(tuple(steps))


def _panel(table: Table, frame: FloatArray) -> PlacedPanel:
    counts = table.vector("pixels", 2)
    if not np.all((counts >= 1) & (counts == np.round(counts))):
        raise table.fail("'pixels' must be two whole numbers of at least 1, width and height.")
    size = MM * table.vector("size_mm", 2)
    if not np.all(size > 0):
        raise table.fail("'size_mm' must be positive.")
    pose = rigid(frame @ axes(table, "u_axis", "v_axis"), frame @ (MM * table.vector("centre_mm", 3)))
    panel = PlacedPanel(pose, size, Panel(int(counts[0]), int(counts[1])))
    table.finish()
    return panel


def _field(table: Table) -> Field | None:
    """Angles as the wearer has them, right and up positive, whatever the file's axes."""
    if not table.has("field_deg"):
        return None
    left, right, down, up = np.tan(np.deg2rad(table.vector("field_deg", 4)))
    if not (left < right and down < up):
        raise table.fail("'field_deg' must be left, right, down, up, each pair ascending; right and up are positive.")
    return Field(np.array([left, down]), np.array([right, up]))


def _eye_box(table: Table, frame: FloatArray) -> EyeBox:
    box = EyeBox(frame @ (MM * table.vector("centre_mm", 3)), MM * table.vector("size_mm", 3))
    if not np.all(box.size > 0):
        raise table.fail("'size_mm' must be positive.")
    table.finish()
    return box
