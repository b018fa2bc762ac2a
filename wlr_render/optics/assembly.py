"""Assembly errors of a headset: poses of the combiner and the panel that differ from the prescription.

The code uses metres and radians in the device frame; values of errors are in millimetres and degrees, as in
prescriptions.
"""

from dataclasses import dataclass, replace

import numpy as np

from wlr_render.geometry.transforms import rigid, rotations_of_vectors
from wlr_render.numerics.arrays import FloatArray
from wlr_render.optics.device import EyeOptics, Path
from wlr_render.optics.media import GREEN_UM
from wlr_render.optics.tracer import trace

_FORWARD = np.array([0.0, 0.0, -1.0])


@dataclass(frozen=True)
class AssemblyError:
    """One rigid motion of the combiner or of the panel, given by three numbers.

    Attributes:
        name: name in reports.
        axes: names of the numbers.
        unit: "deg" or "mm".
        plausible_size: (3,) standard deviations of real headsets, in that unit.
    """

    name: str
    axes: tuple[str, str, str]
    unit: str
    plausible_size: tuple[float, float, float]


SOURCE = "spread (1.48 MAD) of 16 calibrated Project North Star units about their CAD"
# Plausible sizes; the comments give the measured spreads.
COMBINER_TILT = AssemblyError("combiner_tilt", ("x", "y", "z"), "deg", (1.0, 1.0, 1.0))  # relative to panel: 1.3-2.4
COMBINER_SHIFT = AssemblyError("combiner_shift", ("x", "y", "z"), "mm", (1.5, 1.5, 1.5))  # 1.0, 2.0, 1.6
PANEL_SHIFT = AssemblyError("panel_shift", ("u", "v", "normal"), "mm", (1.0, 1.0, 0.5))  # 0.7, 2.5, 0.5
PANEL_ROTATION = AssemblyError("panel_rotation", ("u", "v", "roll"), "deg", (1.0, 1.0, 1.0))  # its normal: 1.3 to 2.4
ASSEMBLY_ERRORS = (COMBINER_TILT, COMBINER_SHIFT, PANEL_SHIFT, PANEL_ROTATION)

ASSEMBLY_NAMES = tuple(f"{error.name}_{axis}_{error.unit}" for error in ASSEMBLY_ERRORS for axis in error.axes)
"""Names of the twelve values of `assembled`, with their units."""
ASSEMBLY_SIZES = np.concatenate([error.plausible_size for error in ASSEMBLY_ERRORS])
"""(12,) plausible sizes of these values, standard deviations."""


def assembled(optics: EyeOptics, values: FloatArray) -> EyeOptics:
    """Return the optics with assembly errors `values` (12,), in the order of `ASSEMBLY_NAMES`.

    Zeros leave the optics unchanged. All surfaces move together: they are turned about the combiner's middle, then
    shifted. The panel moves in its own frame: it is shifted along its axes, then turned about its centre.
    """
    tilt, shift, panel_shift, panel_rotation = np.asarray(values, dtype=np.float64).reshape(4, 3)
    combiner = combiner_shifted(combiner_turned(optics, tilt), shift)
    return panel_turned(panel_shifted(combiner, panel_shift), panel_rotation)


def combiner_middle(optics: EyeOptics) -> FloatArray:
    """Return the point (3,) where the nominal line of sight meets the first surface, or the surface's origin."""
    if not optics.display.steps:
        return optics.eye_box.centre
    first = trace(Path(optics.display.steps[:1]), optics.eye_box.centre, _FORWARD, GREEN_UM)
    origin = optics.display.steps[0].surface.device_from_surface[:3, 3]
    return np.where(np.isfinite(first.origin), first.origin, origin)


def combiner_turned(optics: EyeOptics, tilt_deg: FloatArray) -> EyeOptics:
    """Return all surfaces turned together about the combiner's middle by angles (3,) about x, y and z."""
    rotation, pivot = rotations_of_vectors(np.deg2rad(tilt_deg)), combiner_middle(optics)
    return _surfaces_moved(optics, rigid(rotation, pivot - rotation @ pivot))


def combiner_shifted(optics: EyeOptics, shift_mm: FloatArray) -> EyeOptics:
    """Return all surfaces shifted together along x, y and z (3,)."""
    return _surfaces_moved(optics, rigid(np.eye(3), 1e-3 * shift_mm))


def panel_shifted(optics: EyeOptics, shift_mm: FloatArray) -> EyeOptics:
    """Return the panel shifted along its u axis, its v axis and its normal (3,)."""
    return _panel_moved(optics, rigid(np.eye(3), 1e-3 * shift_mm))


def panel_turned(optics: EyeOptics, rotation_deg: FloatArray) -> EyeOptics:
    """Return the panel turned about its centre by angles (3,) about its u axis, its v axis and its normal."""
    return _panel_moved(optics, rigid(rotations_of_vectors(np.deg2rad(rotation_deg)), np.zeros(3)))


def as_a_whole(optics: EyeOptics, moved_from_device: FloatArray) -> EyeOptics:
    """Return the optics with all surfaces and the panel, but not the eye box, moved by a rigid transform (4, 4)."""
    panel = optics.panel
    moved = replace(panel, device_from_panel=moved_from_device @ panel.device_from_panel)
    return replace(_surfaces_moved(optics, moved_from_device), panel=moved)


def _surfaces_moved(optics: EyeOptics, moved_from_device: FloatArray) -> EyeOptics:
    return optics.with_surfaces(lambda s: replace(s, device_from_surface=moved_from_device @ s.device_from_surface))


def _panel_moved(optics: EyeOptics, panel_from_moved: FloatArray) -> EyeOptics:
    panel = optics.panel
    return replace(optics, panel=replace(panel, device_from_panel=panel.device_from_panel @ panel_from_moved))
