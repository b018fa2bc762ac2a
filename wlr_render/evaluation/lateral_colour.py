"""Lateral colour of a headset: the error of using one map for all colours."""

from wlr_render.evaluation.device_figures import judged_pixels
from wlr_render.evaluation.metrics import summary
from wlr_render.geometry import directions, rays
from wlr_render.mappings import Eye, EyeChannels
from wlr_render.numerics.arrays import FloatArray
from wlr_render.report.blocks import Cell, ReportTable

DEPTH_M = 2.0
"""Distance of the real points, close to the distance of virtual images in headsets."""
_COLUMNS, _ROWS = 41, 31  # sampled directions in the nominal field, or pixels on the panel


def lateral_colour(green: Eye, other: Eye, viewpoint: FloatArray, pixel: FloatArray) -> dict[str, FloatArray]:
    """Return angles between one colour and green (n,) by name, arcminutes; NaN where either is not visible.

    Args:
        green, other: the eye in both colours.
        viewpoint: (3,) device frame, metres.
        pixel: (n, 2) panel pixels.

    Returns:
        display: between the view directions of a pixel. see-through: between the view directions of a real point, at
        `DEPTH_M` on the pixel's green ray. world ray: at the viewpoint between the points at `DEPTH_M` on the pixel's
        rays, the image error if one map serves both colours.
    """
    seen = [colour.display.view_dir_of_pixel(pixel, viewpoint).value for colour in (green, other)]
    points = [_point_along(colour, view_dir, viewpoint) for colour, view_dir in zip((green, other), seen, strict=True)]
    through = [colour.see_through.view_dir_of_real_point(points[0], viewpoint).value for colour in (green, other)]
    places = [directions.normalised(point - viewpoint) for point in points]
    pairs = {"display": seen, "see-through": through, "world ray": places}
    return {name: directions.arcmin_between(*pair) for name, pair in pairs.items()}


def _point_along(mappings: Eye, view_dir: FloatArray, viewpoint: FloatArray) -> FloatArray:
    """Return the points (n, 3) at `DEPTH_M` in front of the viewpoint that are visible in directions (n, 3)."""
    real = mappings.see_through.real_ray_of_view_dir(view_dir, viewpoint).value
    return rays.split(rays.at_z(real, viewpoint[2] - DEPTH_M))[0]


def lateral_colour_table(channels: EyeChannels) -> ReportTable:
    """Tabulate rms and largest angles over the field from the eye box's centre, for an eye in red, green and blue."""
    red, green, blue = channels
    pixel = judged_pixels(green, _COLUMNS, _ROWS)
    found = {
        name: {kind: summary(each) for kind, each in lateral_colour(green, other, green.eye_box.centre, pixel).items()}
        for name, other in (("red", red), ("blue", blue))
    }
    rows: list[list[Cell]] = [
        [green.name, name, *(value for each in kinds.values() for value in (each.rms, each.maximum))]
        for name, kinds in found.items()
    ]
    heads = (f"{kind} {what}" for kind in found["red"] for what in ("rms", "max"))
    notes = (
        f"Arcminutes; {_COLUMNS} x {_ROWS} directions over the nominal field, or pixels where none is stated.",
        f"The world is at {DEPTH_M:g} m.",
        "A device file that gives a medium one constant index has no colour in it, whatever its glass has.",
    )
    return ReportTable("Lateral colour", ("headset", "against green", *heads), rows, notes)
