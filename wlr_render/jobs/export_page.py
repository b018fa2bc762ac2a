"""Page of an export, with everything that a user of its files must know."""

from pathlib import Path

from wlr_render.exports.check_pictures import CHECK_PANEL, CHECK_SOURCE
from wlr_render.exports.export_view import ExportedView
from wlr_render.exports.facts import depth_words, losses
from wlr_render.exports.format import Format
from wlr_render.jobs.budget import source_table
from wlr_render.jobs.export_options import ExportOptions
from wlr_render.jobs.options import eyes_of
from wlr_render.numerics.arrays import FloatArray
from wlr_render.report.blocks import Block, Cell, Columns, Number, Picture, Report, ReportTable, Section, Text, table

_LISTED = 30
"""Views that the page lists."""


def export_page(
    options: ExportOptions, form: Format, views: list[ExportedView], files: list[Path], inputs: list[Path], kept: int
) -> Report:
    """Return the page of views written in a format, with its check pictures.

    Args:
        options: options of the job.
        form: format of the files.
        views: all views.
        files: written files; the check pictures use the first one.
        inputs: input files.
        kept: number of views whose files an earlier run has written.
    """
    first = views[0]
    depth = "every depth" if form.holds.every_depth else f"points {depth_words(first.depth_m)}"
    eyes = f"{' and '.join(eyes_of(options.eye))} eye{'s' if options.eye == 'both' else ''}"
    keeping = f" ({kept} kept from an earlier run)" if kept else ""
    files_of_first = form.files(first)
    checked = " and ".join(name for name in files_of_first if not name.endswith(".json")) or files_of_first[0]
    exactness = "to rounding" if form.holds.every_pixel else "within the error of interpolation of the table above"
    check_depth = "at infinity" if form.holds.every_depth else depth_words(first.depth_m)
    blocks: list[Block] = [
        Text(
            "An augmented-reality headset bends the light of its panel and of the world. An ordinary pinhole camera "
            "draws a picture of the virtual scene; the files give, for each pixel of the panel, the position in this "
            "picture that the pixel must show, so that the wearer sees the scene in its place in the world. The tables "
            "below state the camera and the pupil for which this is correct."
        ),
        Section("What the numbers mean"),
        Text("In every file:", form.convention),
        Text(f"Axes and pixels: {_AXES}"),
        Section("How to use the files"),
        Text(f"Step by step; NAME is {first.stem} for the first view:", [_filled(step, first) for step in form.use]),
        Text("To lock the picture to the world:", [*_POSE, _EVERY_PUPIL if form.holds.every_pupil else _PUPIL]),
        _source_cameras(views),
        Section("What a map loses"),
        _loss_table(options, form, views),
        *_predicted_table(options, views),
        Section("How to check your program"),
        Text(
            f"Take the first picture as the source picture of the {first.eye} eye and warp it with {checked} as above: "
            f"the result must equal the second picture, {exactness}. That one was drawn by wlr_render's sampling, "
            f"{'bilinear in linear light' if form.holds.between_pixels else 'nearest pixel'}, for points {check_depth}."
        ),
        Picture("Source picture", options.out / CHECK_SOURCE, "u to the right in red, v downwards in green"),
        Picture("Picture for the panel", options.out / CHECK_PANEL, f"the {first.eye} panel, pixel by pixel"),
        Section("Files"),
        _views_table(form, views),
    ]
    return Report(
        f"Export of {first.origin.name}: {form.title}",
        f"{len(views)} view{'s' if len(views) > 1 else ''} of the {eyes}, for {depth}{keeping}. The files and this "
        "page are all that a reader needs.",
        blocks=blocks,
        inputs=inputs,
        files=files,
    )


_AXES = (
    "the device frame has x to the right, y up, and looks along -z, in metres. The source camera has such axes too. A "
    "point (x, y, z) there has the depth -z and the tangents tx = x / -z, ty = y / -z. In a picture (0, 0) is the outer"
    " corner of the top left pixel, u runs right and v down, and pixel centres lie at +0.5: "
    "`u = (tx - left) / (right - left) * width`, `v = (top - ty) / (top - bottom) * height`, with the borders of the "
    "table of source cameras."
)
_POSE = (
    "The source camera is fixed in the device frame, the frame of the headset's file. Its pose in this frame is the "
    "matrix `device_from_camera_4x4 = [[R, p], [0 0 0 1]]`, with R = device_from_camera of the first table and p = the "
    "position of the source camera in the last table.",
    "Draw the source picture with `camera_from_world = inverse(world_from_device @ device_from_camera_4x4)`, where "
    "world_from_device is the pose of this device frame, not the pose of your tracker's frame.",
    "A world point is then at `camera_from_world @ (x, y, z, 1)`. The panel pixel that shows it is the one with "
    "its position (u, v) in the source picture.",
)
_PUPIL = "The eye's pupil must be at the viewpoint of the last table."
_EVERY_PUPIL = "The eye's pupil may be anywhere in the eye box."


def _filled(step: str, view: ExportedView) -> str:
    """Fill the names of a view's files and the size of its panel into a step."""
    return step.replace("NAME", view.stem).replace("WxH", "{}x{}".format(*view.panel_size_px))


def _source_cameras(views: list[ExportedView]) -> ReportTable:
    by_eye = {view.eye: view for view in reversed(views)}
    rows: list[list[Cell]] = []
    for eye, view in sorted(by_eye.items()):
        camera = view.source.camera
        (left, bottom), (right, top) = camera.tangent_min.tolist(), camera.tangent_max.tolist()
        axes = "; ".join(" ".join(f"{value:.6f}" for value in row) for row in view.source.device_from_camera)
        tangents = [Number(value, ".6f") for value in (left, right, bottom, top)]
        panel, picture = (f"{width} x {height}" for width, height in (view.panel_size_px, camera.size_px))
        rows.append([eye, panel, picture, *tangents, axes])
    columns = [
        "eye",
        "panel (px)",
        "source picture (px)",
        "left",
        "right",
        "bottom",
        "top",
        "device from camera, row by row",
    ]
    notes = [
        "left, right, bottom, top: tangents of the picture's borders, an off-axis frustum. The camera's position is in "
        "the last table, and all digits are in the files."
    ]
    return ReportTable("Source cameras", columns, rows, notes)


def _loss_table(options: ExportOptions, form: Format, views: list[ExportedView]) -> ReportTable:
    first = [next(each for each in views if each.eye == eye) for eye in eyes_of(options.eye)]
    lost = [(view.stem, loss) for view in first for loss in losses(view, form, view.middle_colour)]
    columns = {"used for": "case", "rms (arcmin)": "rms_arcmin", "max (arcmin)": "max_arcmin"}
    notes = [
        "Against this headset's own mappings, over the panel, in green light unless another colour is named; pupils "
        "moved to the right, left, top and bottom end of the eye box. Of several pupils, the first of each eye."
    ]
    return table("Misalignment by a map", lost, columns, notes, name="map")


def _predicted_table(options: ExportOptions, views: list[ExportedView]) -> list[ReportTable]:
    """Return the table of predicted errors by source; none for headsets without predicted errors."""
    found = {}
    for eye in eyes_of(options.eye):
        view = next(each for each in views if each.eye == eye)
        if (record := view.predicted_error(view.middle_colour)) is not None:
            found[view.stem] = record
    notes = [
        "Registration error that the calibration of the headset predicts for points "
        f"{depth_words(views[0].depth_m)}, rms over the field of view as far as the captures reach, without the errors "
        "of your trackers and of your drawing. Of several pupils, the first of each eye; of three colours, green."
    ]
    return [source_table("Predicted error by source", found, "map", notes)] if found else []


def _views_table(form: Format, views: list[ExportedView]) -> ReportTable:
    columns: Columns = {
        "files": lambda view: ", ".join(form.files(view)),
        "eye": "eye",
        "time (s)": "time_s",
        "viewpoint (mm)": lambda view: _millimetres(view.viewpoint),
        "source camera (mm)": lambda view: _millimetres(view.source.position_in_device),
    }
    more = [f"The first {_LISTED} of {len(views)}."] if len(views) > _LISTED else []
    return table("Views", views[:_LISTED], columns, ["Positions x, y, z in the device frame.", *more])


def _millimetres(place: FloatArray) -> str:
    return ", ".join(f"{1e3 * value:.3f}" for value in place)
