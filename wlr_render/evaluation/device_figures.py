"""Optical figures of one eye of a headset, computed from traced or fitted mappings."""

from dataclasses import dataclass

import numpy as np

from wlr_render.geometry.directions import ARCMIN, arcmin_between, dir_of_tangents
from wlr_render.mappings import DisplayMapping, Eye, EyeBox
from wlr_render.numerics.arrays import FloatArray
from wlr_render.report.blocks import Cell, ReportTable

_COLUMNS, _ROWS = 25, 21  # sampled directions in the nominal field, or pixels on the panel
_BOX_STEPS = 5  # sampled viewpoints per axis of the eye box
_NEAR_M = 0.3  # distance of near points
_MOVE_M = 1e-3  # motion of the viewpoint; pupil swim is stated per millimetre
_SEARCH_DEG = np.arange(-85.0, 85.0, 0.05)  # angles at which the field's limits are searched


@dataclass(frozen=True)
class AngleSpread:
    """Summary of angles in arcminutes; NaN if none is finite."""

    mean: float
    rms: float
    maximum: float

    @classmethod
    def of(cls, arcmin: FloatArray) -> "AngleSpread":
        """Summarise all finite entries."""
        kept = arcmin[np.isfinite(arcmin)]
        if kept.size == 0:
            return cls(np.nan, np.nan, np.nan)
        return cls(float(kept.mean()), float(np.sqrt(np.mean(kept**2))), float(kept.max()))


@dataclass(frozen=True)
class FieldAngles:
    """Field of view from the nominal viewpoint, along the horizontal and the vertical through straight ahead.

    Degrees, positive to the right and up; NaN if the panel is not visible along that line.
    """

    left_deg: float
    right_deg: float
    down_deg: float
    up_deg: float


@dataclass(frozen=True)
class DeviceFigures:
    """Optical figures of one eye.

    Except for the field angles, they are averaged over the nominal field, or over the whole panel if the headset states
    no field, and at the nominal viewpoint unless they mention the eye box.

    Attributes:
        field_angles: field of view of the display.
        panel_share: share of the sampled directions that hit the panel.
        pixel_arcmin: side of a square with the mean solid angle of a pixel.
        swim: change of a pixel's direction when the viewpoint moves by 1 mm, half to either side, along x, y and z.
        ignoring_viewpoint: error, over the eye box, of using the pixel directions of the nominal viewpoint everywhere.
        deviation_far: angle between the apparent and the true direction of a point at infinity.
        deviation_near: angle between the apparent and the true direction of a point 0.3 m away.
        deviation_change: change of `deviation_far` over the eye box with its corners, for the same view direction.
        colour: angle between the blue and the red real ray of the same view direction.
    """

    field_angles: FieldAngles
    panel_share: float
    pixel_arcmin: float
    swim: tuple[AngleSpread, AngleSpread, AngleSpread]
    ignoring_viewpoint: AngleSpread
    deviation_far: AngleSpread
    deviation_near: AngleSpread
    deviation_change: AngleSpread
    colour: AngleSpread

    @property
    def parallax_distance_m(self) -> tuple[float, float]:
        """Distance of a point without optics whose parallax equals the mean pupil swim in x, and in y.

        Without aberrations it is the distance of the virtual image.
        """
        x, y = (_MOVE_M / (swim.mean * ARCMIN) if swim.mean > 0 else np.inf for swim in self.swim[:2])
        return x, y


def device_figures(mappings: Eye, blue: Eye, red: Eye) -> DeviceFigures:
    """Compute all figures.

    Args:
        mappings: the eye in the colour of all figures except `colour`.
        blue, red: the same eye at the two ends of the spectrum (Fraunhofer's F and C lines, 486.1 and 656.3 nm).
    """
    display, see_through, box = mappings.display, mappings.see_through, mappings.eye_box
    pixel = judged_pixels(mappings, _COLUMNS, _ROWS)
    viewpoint = _over_box(box, np.arange(1.0 - _BOX_STEPS, _BOX_STEPS, 2.0) / _BOX_STEPS)
    with_corners = _over_box(box, np.linspace(-1.0, 1.0, _BOX_STEPS))
    seen = display.view_dir_of_pixel(pixel, box.centre).value
    from_box = display.view_dir_of_pixel(pixel, viewpoint).value
    far = _far(mappings, seen, box.centre)
    point = box.centre + _NEAR_M * seen
    near = see_through.view_dir_of_real_point(point, box.centre).value
    swim_x, swim_y, swim_z = (_swim(display, pixel, box.centre, axis) for axis in np.eye(3))
    return DeviceFigures(
        field_angles=_field_angles(display, box.centre),
        panel_share=len(pixel) / (_COLUMNS * _ROWS),
        pixel_arcmin=_pixel_arcmin(display, pixel, box.centre),
        swim=(swim_x, swim_y, swim_z),
        ignoring_viewpoint=AngleSpread.of(arcmin_between(from_box, seen)),
        deviation_far=AngleSpread.of(arcmin_between(far, seen)),
        deviation_near=AngleSpread.of(arcmin_between(near, seen)),
        deviation_change=AngleSpread.of(arcmin_between(_far(mappings, seen, with_corners), far)),
        colour=AngleSpread.of(arcmin_between(_far(blue, seen, box.centre), _far(red, seen, box.centre))),
    )


def figures_table(mappings: Eye, figures: DeviceFigures) -> ReportTable:
    """Return the figures of an eye as a table in arcminutes, with field and image distance in the notes."""
    box_mm = " x ".join(f"{1e3 * side:g}" for side in mappings.eye_box.size)
    rows: list[list[Cell]] = [["one pixel", figures.pixel_arcmin, None, None]]
    spreads = [
        *((f"pupil swim per mm in {axis}", swim) for axis, swim in zip("xyz", figures.swim, strict=True)),
        ("error of ignoring the viewpoint", figures.ignoring_viewpoint),
        ("see-through deviation at infinity", figures.deviation_far),
        (f"see-through deviation at {_NEAR_M:g} m", figures.deviation_near),
        ("change of the deviation at infinity over the eye box", figures.deviation_change),
        ("see-through colour, blue to red", figures.colour),
    ]
    rows += [[name, spread.mean, spread.rms, spread.maximum] for name, spread in spreads]
    angles = figures.field_angles
    judged = f"the nominal field, {mappings.field}" if mappings.field else "the whole panel"
    notes = (
        f"Field through straight ahead: {_extent(angles.left_deg, angles.right_deg)} horizontally,"
        f" {_extent(angles.down_deg, angles.up_deg)} vertically.",
        f"Eye box {box_mm} mm, {_BOX_STEPS**3} viewpoints; {_COLUMNS} x {_ROWS} directions over {judged},"
        f" of which {figures.panel_share:.0%} meet the panel.",
        "Mean parallax distance {:.2f} m in x, {:.2f} m in y: a point there would swim by the mean pupil swim. Pixels "
        "are seen through other parts of the optics when the pupil moves, so aberrations shift this figure as well as "
        "the distance of the virtual image does.".format(*figures.parallax_distance_m),
    )
    columns = ("figure", "mean (arcmin)", "rms (arcmin)", "max (arcmin)")
    return ReportTable(f"{mappings.name}, {mappings.eye} eye", columns, rows, notes)


def _extent(low: float, high: float) -> str:
    return f"{low:.1f} to {high:+.1f} degrees" if np.isfinite(low) else "not seen"


def judged_pixels(mappings: Eye, columns: int, rows: int) -> FloatArray:
    """Return pixels (n, 2) spaced evenly in tangents over the nominal field; without a field, evenly over the panel."""
    if mappings.field is None:
        return mappings.display.panel.grid(columns, rows).reshape(-1, 2)
    answer = mappings.display.pixel_of_view_dir(mappings.field.directions(columns, rows), mappings.eye_box.centre)
    return answer.value[answer.usable]


def _over_box(box: EyeBox, side: FloatArray) -> FloatArray:
    """Return the viewpoints (n, 1, 3) at all combinations of box coordinates from `side` (-1..1)."""
    return box.at(np.stack(np.meshgrid(side, side, side), axis=-1).reshape(-1, 1, 3))


def _swim(display: DisplayMapping, pixel: FloatArray, centre: FloatArray, axis: FloatArray) -> AngleSpread:
    low, high = (display.view_dir_of_pixel(pixel, centre + sign * 0.5 * _MOVE_M * axis).value for sign in (-1, 1))
    return AngleSpread.of(arcmin_between(low, high))


def _far(mappings: Eye, view_dir: FloatArray, viewpoint: FloatArray) -> FloatArray:
    """Return the directions (..., 3) of the real rays beyond the optics."""
    return mappings.see_through.real_ray_of_view_dir(view_dir, viewpoint).value[..., 3:]


def _pixel_arcmin(display: DisplayMapping, pixel: FloatArray, centre: FloatArray) -> float:
    """Return the square root of the mean solid angle of a pixel, from differences of half a pixel to each side."""
    u, v = (
        display.view_dir_of_pixel(pixel + half, centre).value - display.view_dir_of_pixel(pixel - half, centre).value
        for half in np.diag([0.5, 0.5])
    )
    solid_angle = np.linalg.norm(np.cross(u, v), axis=-1)
    kept = solid_angle[np.isfinite(solid_angle)]
    return float(np.sqrt(kept.mean()) / ARCMIN) if kept.size else np.nan


def _field_angles(display: DisplayMapping, centre: FloatArray) -> FieldAngles:
    ends = []
    for axis in np.eye(2):
        view_dir = dir_of_tangents(np.tan(np.deg2rad(_SEARCH_DEG))[:, None] * axis)
        answer = display.pixel_of_view_dir(view_dir, centre)
        # A fitted model may extrapolate beyond the panel.
        seen = _SEARCH_DEG[answer.ok & display.panel.contains(answer.value)]
        ends += [float(seen[0]), float(seen[-1])] if seen.size else [np.nan, np.nan]
    return FieldAngles(*ends)
