"""Causes in the headset: combiner, panel, their shapes, media, a plate in front, and the panel's readout.

Device frame; metres and radians unless stated otherwise. Shapes: x points right and y up from the combiner's middle,
where the line of sight straight ahead meets it; surfaces are raised away from the eye.
"""

from collections.abc import Callable, Sequence
from dataclasses import replace
from functools import partial
from typing import Literal

import numpy as np

from wlr_render.bench.bench import Bench, PanelReadout
from wlr_render.diagnosis.cause import Cause, Parameter, Perturb, Role, changed
from wlr_render.geometry.transforms import rigid, rotation_about, rotations_of_vectors
from wlr_render.numerics.arrays import FloatArray
from wlr_render.optics import assembly
from wlr_render.optics.combiner_form import SURFACES, outward, surfaces_raised
from wlr_render.optics.device import (
    ClearAperture,
    EyeOptics,
    Interaction,
    Path,
    PlacedSurface,
    Step,
)
from wlr_render.optics.glass_files import shipped_glasses
from wlr_render.optics.media import AIR, Medium
from wlr_render.optics.raised import Offset
from wlr_render.optics.sag_surfaces import GaussianBump, XYPolynomial
from wlr_render.optics.surfaces import Conic

_PLATE_AHEAD = 0.15  # metres from the eye to a plane plate, beyond all optics; its exact distance has no effect
_PLATE_APART = 0.05  # metres from one added plate to the next
_PLATE_HALF_SIZE = 0.2  # half width of a plate, metres
_FORWARD = np.array([0.0, 0.0, -1.0])
FORM_RADIUS_MM = 20.0
"""Radius about the combiner's middle at which its form errors are stated."""

_NARROWEST_MM = 0.5  # smallest width of a bump: a step of the fit may go below zero
_TOLERANCES = (
    "tolerances of injection-moulded optics (Apollo Optical Systems): 10 fringes of power and 6 of irregularity over "
    "25 mm, that is 8 and 5 um over 40 mm"
)


def of_optics(change: Callable[[EyeOptics, FloatArray], EyeOptics]) -> Perturb:
    """Return a `Perturb` of the eye's optics: `change` maps the optics and the parameters to new optics."""
    return lambda bench, values: _with_optics(bench, change(bench.optics, values))


def _with_optics(bench: Bench, optics: EyeOptics) -> Bench:
    """Return the bench with the optics of its eye replaced."""
    device = replace(bench.device, eyes={**bench.device.eyes, bench.eye: optics})
    return replace(bench, device=device)


def _sizes(error: assembly.AssemblyError, names: Sequence[str], first: int = 0) -> tuple[Parameter, ...]:
    """Return parameters, from axis `first` on, with the plausible sizes that the fit of a prescription also uses."""
    return tuple(
        Parameter(name, error.unit, size)
        for name, size in zip(names, error.plausible_size[first : first + len(names)], strict=True)
    )


def _panel_scaled(optics: EyeOptics, scale_percent: FloatArray) -> EyeOptics:
    return replace(optics, panel=replace(optics.panel, size=optics.panel.size * (1.0 + 1e-2 * scale_percent)))


def _frame_bent(bench: Bench, deg: FloatArray) -> Bench:
    """Turn the optics of the two eyes in opposite directions about the middle between them, as a bent frame does.

    The right eye turns to the nose and up, the left eye to the nose and down.
    """
    toe_in, twist = np.deg2rad(deg)
    pivot = bench.optics.eye_box.centre * [0.0, 1.0, 1.0]
    eyes = {}
    for side, optics in bench.device.eyes.items():
        sign = 1.0 if side == "right" else -1.0
        rotation = rotations_of_vectors(sign * np.array([twist, toe_in, 0.0]))
        eyes[side] = assembly.as_a_whole(optics, rigid(rotation, pivot - rotation @ pivot))
    return replace(bench, device=replace(bench.device, eyes=eyes))


def _index_shifted(optics: EyeOptics, index: FloatArray) -> EyeOptics:
    """Add a number to the index of all media but air."""
    return optics.with_media(lambda medium: medium.shifted(float(index[0])))


def _combiner_thickened(
    optics: EyeOptics, thickness_mm: FloatArray, *, face: Literal["inner", "outer"], along_axis: bool = False
) -> EyeOptics:
    """Thicken the substrate by moving the first or the last surface of the see-through path.

    The surface moves along its normals, or as a whole along the axis of its frame, as the halves of a mould do.
    """
    steps, by = optics.see_through.steps, 1e-3 * float(thickness_mm[0])
    if len(steps) < 2:
        return optics
    chosen = steps[0 if face == "inner" else -1].surface
    offset = outward(chosen, assembly.combiner_middle(optics), along_axis) * (-by if face == "inner" else by)

    def thickened(surface: PlacedSurface) -> PlacedSurface:
        if surface.name != chosen.name or offset == 0.0:
            return surface
        if along_axis:
            along = rigid(np.eye(3), np.array([0.0, 0.0, offset]))
            return replace(surface, device_from_surface=surface.device_from_surface @ along)
        shape = surface.shape
        if isinstance(shape, Offset) and not shape.errors:
            return replace(surface, shape=replace(shape, distance=shape.distance + offset))
        return replace(surface, shape=Offset(shape, offset))

    return optics.with_surfaces(thickened)


def _plate_added(bench: Bench, thickness: float, tilt_deg: FloatArray, wedge_deg: FloatArray) -> Bench:
    """Add a PMMA plate between the optics and the world; tilt turns both faces about x and y, wedge only the far one.

    A negative thickness displaces rays the other way, so that a fit can pass through zero.
    """
    if thickness == 0.0:
        return bench
    pmma = replace(shipped_glasses()["pmma_sultanova_2009"], name="added_plate")
    index = pmma.index(bench.target_wavelength_um)
    medium = pmma if thickness > 0.0 else Medium.constant("added_plate", 1.0 / (2.0 - 1.0 / index))
    near = _tilt(tilt_deg)
    far = near @ _tilt(wedge_deg)
    standing = sum(surface.name.startswith("added_plate") for surface in bench.optics.surfaces()) // 2
    centre = bench.optics.eye_box.centre + (_PLATE_AHEAD + standing * _PLATE_APART) * _FORWARD
    reach = _PLATE_HALF_SIZE * np.array([1.0, 1.0, np.inf])
    aperture = ClearAperture(-reach, reach)
    steps = []
    number = len(bench.optics.surfaces())  # makes the name unique
    for side, rotation, along, into in (("near", near, 0.0, medium), ("far", far, abs(thickness), AIR)):
        face = PlacedSurface(
            f"added_plate_{number}_{side}", Conic(0.0), rigid(rotation, centre + along * near @ _FORWARD), aperture
        )
        steps.append(Step(face, Interaction.REFRACT, into))
    path = Path(bench.optics.see_through.steps + tuple(steps))
    return _with_optics(bench, replace(bench.optics, see_through=path))


def _tilt(tilt_deg: FloatArray) -> FloatArray:
    return rotation_about("x", np.deg2rad(tilt_deg[0])) @ rotation_about("y", np.deg2rad(tilt_deg[1]))


def _colours_apart(readout: PanelReadout, values: FloatArray) -> PanelReadout:
    """Scale and shift red and blue relative to green: percent of red and blue, then pixels (u, v) of red and blue."""
    red, blue = 1e-2 * values[:2]
    shift = np.insert(values[2:].reshape(2, 2), 1, 0.0, axis=0)
    return PanelReadout(
        readout.origin_px,
        readout.channel_scale * (1.0 + np.array([red, 0.0, blue])),
        readout.channel_shift_px + shift,
    )


OPTICS = (
    Cause(
        "combiner_tilt",
        "combiner tilted",
        "device",
        _sizes(assembly.COMBINER_TILT, ("tilt_x", "tilt_y", "tilt_z")),
        source=f"{assembly.SOURCE}: 1.3 to 2.4 deg to the screen",
        separated_by="see-through captures of a near target: a shift of the panel leaves them alone, a tilt does not",
        variants={"about its middle": of_optics(assembly.combiner_turned)},
    ),
    Cause(
        "combiner_shift",
        "combiner displaced",
        "device",
        _sizes(assembly.COMBINER_SHIFT, ("shift_x", "shift_y", "shift_z")),
        source=f"{assembly.SOURCE}: 1.0, 2.0, 1.6 mm",
        separated_by="see-through captures of a near target, and display captures farther off the base plane",
        variants={"as a whole": of_optics(assembly.combiner_shifted)},
    ),
    Cause(
        "panel_shift",
        "panel displaced in its plane",
        "device",
        _sizes(assembly.PANEL_SHIFT, ("shift_u", "shift_v")),
        source=f"{assembly.SOURCE}: 0.7 and 2.5 mm",
        separated_by="a photograph of the bare panel against its frame; display captures farther off the base plane",
        variants={"along u and v": of_optics(lambda optics, mm: assembly.panel_shifted(optics, np.append(mm, 0.0)))},
        own_station="panel",
    ),
    Cause(
        "panel_axial_shift",
        "panel displaced along its normal",
        "device",
        _sizes(assembly.PANEL_SHIFT, ("shift",), first=2),
        source=f"{assembly.SOURCE}: 0.5 mm",
        separated_by="display captures over a deeper eye box: a magnified panel swims differently from a displaced one",
        variants={
            "along the normal": of_optics(lambda optics, mm: assembly.panel_shifted(optics, np.append([0.0, 0.0], mm)))
        },
        own_station="panel",
    ),
    Cause(
        "panel_rotation",
        "panel turned about its centre",
        "device",
        _sizes(assembly.PANEL_ROTATION, ("about_u", "about_v", "roll")),
        source=f"{assembly.SOURCE}: 1.3 to 2.4 deg of the normal",
        separated_by="a photograph of the bare panel against its frame",
        variants={"about its centre": of_optics(assembly.panel_turned)},
        own_station="panel",
    ),
    Cause(
        "panel_scale",
        "panel larger than stated",
        "device",
        (Parameter("scale_u", "%", 0.3), Parameter("scale_v", "%", 0.3)),
        source="rounding of a pixel pitch in a data sheet, a few parts in a thousand; heat is ten times less. Focal "
        "lengths along u and v of factory calibrations differ by 0.1 to 1.1 %",
        separated_by="a photograph of the bare panel with a ruler",
        variants={"about its centre": of_optics(_panel_scaled)},
        own_station="panel",
    ),
    Cause(
        "frame_bend",
        "frame bent between the eyes",
        "device",
        (Parameter("toe_in", "deg", 0.3), Parameter("twist", "deg", 0.3)),
        source="factory calibrations of two glasses: displays turned to each other by 52 and 74 arcmin, up and down by "
        "0 and 26; that they bend by half as much in wear is our estimate",
        separated_by="a session of the other eye, which turns the other way; what it sees of a distant target through "
        "its display against the first eye's",
        variants={"both eyes, as mirror images": _frame_bent},
        remedy="measure both eyes again with the headset held as it is worn, or use the corrected headset",
    ),
    Cause(
        "substrate_index",
        "refractive index of the substrate",
        "device",
        (Parameter("index", "1", 0.01),),
        source="PMMA grades differ by 0.002, PMMA and polycarbonate by 0.09; a moulded part lies between",
        separated_by="the index of a witness piece; a second wavelength",
        variants={"of all media": of_optics(_index_shifted)},
    ),
    Cause(
        "substrate_thickness",
        "thickness of the combiner",
        "device",
        (Parameter("thickness", "mm", 0.1),),
        source="usual tolerance of moulded plastic optics, 0.05 to 0.1 mm",
        separated_by="a calliper",
        variants={
            "its outer face moves along its normals": of_optics(partial(_combiner_thickened, face="outer")),
            "its outer face moves along its axis": of_optics(
                partial(_combiner_thickened, face="outer", along_axis=True)
            ),
            "its inner face moves along its normals": of_optics(partial(_combiner_thickened, face="inner")),
        },
    ),
    Cause(
        "see_through_plate",
        "thick plate in the see-through path",
        "device",
        (
            Parameter("thickness", "mm", 5.0, minimum=0.0),
            Parameter("angle_x", "deg", 20.0, Role.SHAPE),
            Parameter("angle_y", "deg", 20.0, Role.SHAPE),
        ),
        source="cover and prism plates of optical see-through headsets, 1 to 20 mm",
        separated_by="the target at more distances: the offset by a plate goes with 1 / distance, a lens's does not",
        variants={
            "plane-parallel, tilted by the angles": lambda bench, v: _plate_added(
                bench, 1e-3 * float(v[0]), v[1:], np.zeros(2)
            ),
            "facing the eye, a wedge of the angles": lambda bench, v: _plate_added(
                bench, 1e-3 * float(v[0]), np.zeros(2), v[1:]
            ),
        },
    ),
)
READOUT = (
    Cause(
        "lateral_colour",
        "lateral colour",
        "device",
        (
            *(Parameter(colour, "%", 0.3) for colour in ("red", "blue")),
            *(Parameter(f"{colour}_{axis}", "px", 2.0) for colour in ("red", "blue") for axis in "uv"),
        ),
        source="2.4 arcmin at 14 deg in a see-through headset, 20 arcmin at 44 deg in a lens of virtual reality; "
        "centres of red and blue 1 to 4 px from green's in factory calibrations of three headsets",
        separated_by="captures in all three colours from the same positions",
        variants={
            "about the panel's centre": lambda bench, v: replace(bench, readout=_colours_apart(bench.readout, v))
        },
        own_station="panel",
    ),
    Cause(
        "pixel_origin",
        "wrong pixel origin",
        "device",
        (Parameter("offset_u", "px", 0.5), Parameter("offset_v", "px", 0.5)),
        source="conventions put the origin at the centre or at the corner of the first pixel",
        separated_by="a single lit pixel at a known place, decoded by the same software",
        variants={
            "of the panel": changed("readout", "origin_px", lambda old, px: old + px),
            "of the camera": changed("camera", "centre_px", lambda old, px: old + px),
        },
        whole_steps=0.5,
        own_station="panel",
    ),
)


def _panel_bowed(optics: EyeOptics, sag_mm: FloatArray) -> EyeOptics:
    """Curve the panel along u and v by the sags (2,) at its edges, in millimetres."""
    panel = optics.panel
    curvature = 2.0 * 1e-3 * sag_mm / (0.5 * panel.size) ** 2
    return replace(optics, panel=replace(panel, curvature=panel.curvature + curvature))


def _form_coefficients(values_um: FloatArray) -> FloatArray:
    """Return coefficients (4, 4) of x^m y^n, metres, for Zernike power (without piston), astigmatism and coma."""
    power, astigmatism, oblique, coma_x, coma_y = 1e-6 * values_um
    radius = 1e-3 * FORM_RADIUS_MM
    coefficients = np.zeros((4, 4))
    coefficients[2, 0], coefficients[0, 2] = power + astigmatism, power - astigmatism
    coefficients[1, 1] = 2.0 * oblique
    coefficients[1, 0], coefficients[0, 1] = -2.0 * coma_x, -2.0 * coma_y
    coefficients[3, 0] = coefficients[1, 2] = 3.0 * coma_x
    coefficients[0, 3] = coefficients[2, 1] = 3.0 * coma_y
    m, n = np.indices(coefficients.shape)
    return np.asarray(coefficients * radius ** -(m + n).astype(float))


def _of_form(optics: EyeOptics, values: FloatArray, *, of_mirrors_only: bool = False) -> EyeOptics:
    """Add form errors (5,) in micrometres to all surfaces of the combiner, or only to the reflecting ones."""
    if not values.any():
        return optics
    names = SURFACES["reflecting surfaces" if of_mirrors_only else "all surfaces"](optics)
    coefficients = _form_coefficients(values)
    return surfaces_raised(optics, names, lambda sign: XYPolynomial(sign * coefficients))


def _dented(optics: EyeOptics, values: FloatArray) -> EyeOptics:
    """Add a local bump to all surfaces of the combiner: depth (um), x, y and width (mm)."""
    depth_um, *place_mm, width_mm = values
    if depth_um == 0.0:
        return optics
    width = 1e-3 * max(float(width_mm), _NARROWEST_MM)
    names = SURFACES["all surfaces"](optics)
    return surfaces_raised(
        optics, names, lambda sign: GaussianBump(sign * 1e-6 * float(depth_um), width), 1e-3 * np.array(place_mm)
    )


FORM = (
    Cause(
        "panel_bow",
        "panel bowed",
        "device",
        (Parameter("sag_u", "mm", 0.3), Parameter("sag_v", "mm", 0.3)),
        source="our estimate for panels in plastic frames, 0.1 to 0.5 mm at the edge",
        separated_by="a straight edge on the panel's face, or the reflection of a grid in it",
        variants={"along its normal, u cross v": of_optics(_panel_bowed)},
        remedy="let the panel's frame hold it flat, or use the corrected headset",
        own_station="panel",
    ),
    Cause(
        "combiner_form",
        "form error of the combiner",
        "device",
        (
            Parameter("power", "um", 8.0),
            *(Parameter(name, "um", 5.0) for name in ("astigmatism", "oblique_astigmatism", "coma_x", "coma_y")),
        ),
        source=_TOLERANCES,
        separated_by="display captures from more camera positions; an interferogram or a coordinate measurement of it",
        variants={
            "in all its surfaces": of_optics(_of_form),
            "in the reflecting surfaces": of_optics(partial(_of_form, of_mirrors_only=True)),
        },
    ),
    Cause(
        "combiner_dent",
        "dent in the combiner",
        "device",
        (
            Parameter("depth", "um", 5.0),
            Parameter("x", "mm", 8.0, Role.SHAPE, (0.0, -7.0, 7.0)),
            Parameter("y", "mm", 8.0, Role.SHAPE, (0.0, -7.0, 7.0)),
            Parameter("width", "mm", 2.0, Role.SHAPE, (5.0,), minimum=_NARROWEST_MM),
        ),
        source=f"{_TOLERANCES}, the same locally",
        separated_by="a straight line reflected in the combiner while it moves across the field",
        variants={"Gaussian, in all its surfaces": of_optics(_dented)},
        remedy="replace the combiner, or use the corrected headset",
    ),
)
