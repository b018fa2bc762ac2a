"""Lateral colour of a headset: the error of using one map for all colours."""

from collections.abc import Sequence
from dataclasses import dataclass

from wlr_render.evaluation.device_figures import judged_pixels
from wlr_render.evaluation.metrics import summary
from wlr_render.geometry import directions, rays
from wlr_render.mappings import Eye, EyeChannels
from wlr_render.numerics.arrays import FloatArray
from wlr_render.report.blocks import Cell, ReportTable

DEPTH_M = 2.0
"""Distance of the real points, close to the distance of virtual images in headsets."""
_COLUMNS, _ROWS = 41, 31  # sampled directions in the nominal field, or pixels on the panel


@dataclass(frozen=True, eq=False)
class LateralColour:
    """Angles between one colour and green, (n,) arcminutes; NaN where either is not visible.

    Attributes:
        display: angle between the view directions of a pixel.
        see_through: angle between the view directions of a real point.
        world_ray: angle at the viewpoint between the points at `DEPTH_M` on a pixel's rays: the image error if one map
            serves both colours.
    """

    display: FloatArray
    see_through: FloatArray
    world_ray: FloatArray


def lateral_colour(green: Eye, other: Eye, viewpoint: FloatArray, pixel: FloatArray) -> LateralColour:
    """Compare one colour with green at pixels (n, 2) from a viewpoint (3,).

    The real points are at `DEPTH_M` on the green rays of the pixels.
    """
    seen = [colour.display.view_dir_of_pixel(pixel, viewpoint).value for colour in (green, other)]
    points = [_point_along(colour, view_dir, viewpoint) for colour, view_dir in zip((green, other), seen, strict=True)]
    through = [colour.see_through.view_dir_of_real_point(points[0], viewpoint).value for colour in (green, other)]
    places = [directions.normalised(point - viewpoint) for point in points]
    return LateralColour(*(directions.arcmin_between(*pair) for pair in (seen, through, places)))


def _point_along(mappings: Eye, view_dir: FloatArray, viewpoint: FloatArray) -> FloatArray:
    """Return the points (n, 3) at `DEPTH_M` in front of the viewpoint that are visible in directions (n, 3)."""
    real = mappings.see_through.real_ray_of_view_dir(view_dir, viewpoint).value
    return rays.split(rays.at_z(real, viewpoint[2] - DEPTH_M))[0]


def lateral_colour_table(headsets: Sequence[EyeChannels]) -> ReportTable:
    """Tabulate rms and largest angles over the field from the eye box's centre, for headsets in red, green and blue."""
    rows: list[list[Cell]] = []
    for red, green, blue in headsets:
        pixel = judged_pixels(green, _COLUMNS, _ROWS)
        for name, other in (("red", red), ("blue", blue)):
            angles = lateral_colour(green, other, green.eye_box.centre, pixel)
            figures = map(summary, (angles.display, angles.see_through, angles.world_ray))
            rows.append([green.name, name, *(value for kind in figures for value in (kind.rms, kind.maximum))])
    kinds = ("display", "see-through", "world ray")
    columns = ("headset", "against green", *(f"{kind} {what}" for kind in kinds for what in ("rms", "max")))
    notes = (
        f"Arcminutes; {_COLUMNS} x {_ROWS} directions over the nominal field, or pixels where none is stated.",
        f"The world is at {DEPTH_M:g} m.",
        "A device file that gives a medium one constant index has no colour in it, whatever its glass has.",
    )
    return ReportTable("Lateral colour", columns, rows, notes)
