"""Write the warp maps of a headset as files that other programs read, and a page that explains them."""

import itertools
import math
from collections.abc import Callable, Iterator
from dataclasses import KW_ONLY, dataclass, replace
from pathlib import Path
from typing import Annotated, Literal

import numpy as np

from wlr_render.errors import BadInputError
from wlr_render.exports.check_pictures import CHECK_PANEL, CHECK_SOURCE, write_check
from wlr_render.exports.facts import losses
from wlr_render.exports.format import Format
from wlr_render.exports.formats import FormatName, format_of
from wlr_render.exports.view import ExportedView, Origin, ray_map_plans
from wlr_render.files import output_folder
from wlr_render.geometry.pinhole import Pinhole
from wlr_render.input_files import hashes_of_inputs
from wlr_render.jobs import limits
from wlr_render.jobs.frame_plan import gap_warnings, held_warnings, planned_frames
from wlr_render.jobs.headset import headset_path, open_channels, require_in_eye_box
from wlr_render.jobs.job import job
from wlr_render.jobs.options import (
    Eye,
    Eyes,
    Options,
    ProgressArgument,
    Range,
    described,
    described_size,
    eyes_of,
)
from wlr_render.mappings import EyeChannels, EyeMappings, middle_channel
from wlr_render.numerics.arrays import FloatArray
from wlr_render.progress import SILENT
from wlr_render.rendering.raster_camera import RasterPosition, intermediate_camera
from wlr_render.rendering.ray_map import middle_axes
from wlr_render.rendering.view import View
from wlr_render.report.blocks import Block, Cell, Picture, Report, ReportTable, Section, Text
from wlr_render.report.save import save_report
from wlr_render.tracking.eye_trajectory_file import read_eye_trajectory
from wlr_render.tracking.trajectory import EyeTrajectory

_LISTED = 30
"""Views that the page lists; report.json has all."""


@dataclass(frozen=True)
class ExportOptions(Options):
    """Options of `export`."""

    format: Annotated[FormatName, described("File format.")]
    model: Annotated[str, described("A device or a model file (with --red-model: the model fitted in green light).")]
    _: KW_ONLY
    eye: Annotated[Eyes, described("Eyes to export.")] = "right"
    depth_m: Annotated[
        float | None,
        described("Depth from the source camera, in metres, for which the maps are right (default: infinity)."),
        limits.DEPTH_M,
    ] = None
    viewpoint_mm: Annotated[
        tuple[float, float, float] | None,
        described("Pupil position x y z in the device frame, in mm (default: centre of the eye box)."),
        Range(at_least=-1000, at_most=1000),
    ] = None
    pupils: Annotated[
        int | None,
        described("A grid of N x N pupil positions, over the width and height of the eye box."),
        Range(at_least=2, at_most=31),
    ] = None
    eye_track: Annotated[Path | None, described("Eye trajectory: a map for each frame.")] = None
    frames_per_second: Annotated[
        float, described("Frames per second of --eye-track.", name="--fps"), Range(above=0, at_most=1000)
    ] = 30.0
    frame_limit: Annotated[
        int | None,
        described("Maximum number of frames along --eye-track (default: all).", name="--frames"),
        Range(at_least=1, at_most=limits.FRAMES),
    ] = None
    per_colour: Annotated[
        bool, described("Separate maps for red, green and blue; a device is traced in all three.", flag=True)
    ] = False
    red_model: Annotated[Path | None, described("Model file in red light; needs --blue-model.")] = None
    blue_model: Annotated[Path | None, described("Model file in blue light; needs --red-model.")] = None
    resolution: Annotated[
        float, described("Resolution of the source picture; 1: about the panel's."), Range(above=0, at_most=4)
    ] = 1.0
    source_size: Annotated[
        tuple[int, int] | None,
        described_size("Pixels of the source picture, e.g. 1920x1080, in place of --resolution.", optional=True),
        limits.PIXELS,
    ] = None
    source_axes: Annotated[
        Literal["field", "device"],
        described(
            "Axes of the source camera: towards the middle of the field of view, or the device's own (monado: always)."
        ),
    ] = "field"
    raster_camera: Annotated[
        Literal["viewpoint", "nearest"],
        described("Position of the source camera: the viewpoint, or the point nearest to the bent rays."),
    ] = "viewpoint"
    out: Annotated[Path, described("Output folder.")] = Path("out/export")

    def __post_init__(self) -> None:
        """Check that the options go together, and that the format holds what they ask for."""
        super().__post_init__()
        moving = [
            flag
            for flag, value in (
                ("--viewpoint-mm", self.viewpoint_mm),
                ("--pupils", self.pupils),
                ("--eye-track", self.eye_track),
            )
            if value is not None
        ]
        if len(moving) > 1:
            raise BadInputError(f"{' and '.join(moving)} exclude each other; give one of them.")
        if self.viewpoint_mm is not None and self.eye == "both":
            raise BadInputError("--viewpoint-mm is of one eye; give --eye left or --eye right.")
        if self.frame_limit is not None and self.eye_track is None:
            raise BadInputError("--frames is used with --eye-track only; leave it out, or give a trajectory.")
        if (self.red_model is None) != (self.blue_model is None):
            raise BadInputError("--red-model and --blue-model go together; give both or neither.")
        if self.source_size is not None and self.resolution != 1.0:
            raise BadInputError("--resolution has no use with --source-size; leave out one of them.")
        _require_held(self)

    @property
    def head(self) -> None:
        """A map does not depend on the head's pose."""
        return None

    @property
    def has_colours(self) -> bool:
        """Whether red, green and blue have maps of their own."""
        return self.per_colour or self.red_model is not None


def _require_held(options: ExportOptions) -> None:
    """Refuse what the format would lose.

    Raises:
        BadInputError: the sentence names the option.
    """
    carries = format_of(options.format).carries
    if carries.every_depth and options.depth_m is not None:
        raise BadInputError(
            f"--depth-m has no use with {options.format}: its files hold rays, which serve every depth; leave it out."
        )
    if options.has_colours and not carries.colours:
        raise BadInputError(
            f"{options.format} has one map for all colours; leave out --per-colour, --red-model and --blue-model, or "
            "choose a format with maps by colour, e.g. stmap."
        )
    if not carries.pupils and (options.pupils or options.eye_track):
        raise BadInputError(
            f"{options.format} has one pupil position; leave out --pupils and --eye-track, or choose a format that "
            "holds several, e.g. stmap."
        )


@job
def export(options: ExportOptions, *, progress: ProgressArgument = SILENT) -> Report:
    """Write the maps and their page into `options.out`.

    Raises:
        BadInputError: faulty files, a pupil outside the eye box, or what the format does not hold.
        MissingExtraError: a library that the format needs is not installed.
    """
    form = format_of(options.format)
    with hashes_of_inputs() as inputs:
        channels = _opened(options)
        track = read_eye_trajectory(options.eye_track) if options.eye_track else None
    views, warnings = _planned(options, channels, track, _own_hashes(options, inputs))
    folder = output_folder(options.out)
    files = list(form.write(_solved(progress(views, len(views), "views"), warnings), folder))
    files += write_check(folder, replace(views[0]), form.carries)
    return save_report(replace(_report(options, form, views, files), warnings=warnings), folder)


def _solved(views: Iterator[ExportedView], warnings: list[str]) -> Iterator[ExportedView]:
    """A copy of each view, whose maps are large and go with it; warns of panel pixels that a map serves nothing."""
    for planned in views:
        view = replace(planned)
        yield view
        source = view.source_px(view.middle_colour)
        has_ray = np.isfinite(source).all(axis=-1)
        with np.errstate(invalid="ignore"):
            is_inside = ((source >= 0) & (source <= view.source.camera.size_px)).all(axis=-1)
        for count, what in ((np.sum(~has_ray), "have no ray"), (np.sum(has_ray & ~is_inside), "lead past the picture")):
            if count:
                warnings.append(f"{view.stem}: {count} of {has_ray.size} panel pixels {what}.")


def _opened(options: ExportOptions) -> dict[str, EyeChannels]:
    eyes = eyes_of(options.eye)
    return open_channels(options.model, eyes, options.has_colours, options.red_model, options.blue_model)


def _headset_files(options: ExportOptions) -> list[Path]:
    return [headset_path(options.model), *filter(None, (options.red_model, options.blue_model))]


def _planned(
    options: ExportOptions, channels: dict[str, EyeChannels], track: EyeTrajectory | None, sha256: dict[str, str]
) -> tuple[list[ExportedView], list[str]]:
    """All views, and warnings about the trajectory."""
    views: list[ExportedView] = []
    greens = {eye: middle_channel(each) for eye, each in channels.items()}
    planned = planned_frames(options, greens, None, track) if track else []
    for eye, first in _first_views(options, channels, sha256).items():
        place_of = _source_place(options, greens[eye], first.source.device_from_camera)
        pupils: list[tuple[str, FloatArray, float | None]]
        if track:
            pupils = [(frame.stem, frame.viewpoint, frame.time_s) for frame in planned if frame.eye == eye]
        else:
            pupils = [(stem, pupil, None) for stem, pupil in _still_pupils(options, greens[eye])]
        for stem, pupil, time_s in pupils:
            source = replace(first.source, position_in_device=place_of(pupil))
            views.append(replace(first, stem=stem, viewpoint=pupil, source=source, time_s=time_s))
    if track is None:
        return views, []
    return views, [*gap_warnings(options, None, track), *held_warnings(options, planned)]


def first_view(options: ExportOptions, eye: Eye) -> ExportedView:
    """The view of one eye from the centre of its eye box, without writing anything: for scripts.

    Raises:
        BadInputError: faulty files, or an eye that the headset does not have.
    """
    return first_views(replace(options, eye=eye))[eye]


def first_views(options: ExportOptions) -> dict[str, ExportedView]:
    """The same of all eyes of the options.

    Raises:
        BadInputError: faulty files, or an eye that the headset does not have.
    """
    with hashes_of_inputs() as inputs:
        channels = _opened(options)
    return _first_views(options, channels, _own_hashes(options, inputs))


def _first_views(
    options: ExportOptions, channels: dict[str, EyeChannels], sha256: dict[str, str]
) -> dict[str, ExportedView]:
    views = {eye: _central_view(options, of_eye, sha256) for eye, of_eye in channels.items()}
    has_own_cameras = format_of(options.format).carries.asymmetric_field
    return views if has_own_cameras else _with_symmetric_camera(options, views)


def _own_hashes(options: ExportOptions, inputs: dict[str, str]) -> dict[str, str]:
    """SHA-256 of the headset's files by their names; files of one name have that of their folder before it."""
    files = _headset_files(options)
    names = [path.name for path in files]
    return {
        path.name if names.count(path.name) == 1 else f"{path.parent.name}/{path.name}": inputs[str(path)]
        for path in files
        if str(path) in inputs
    }


def _central_view(options: ExportOptions, channels: EyeChannels, sha256: dict[str, str]) -> ExportedView:
    """A view from the centre of the eye box, with the camera that serves all of the box."""
    middle = middle_channel(channels)
    panel, centre = middle.display.panel, middle.eye_box.centre
    is_turned = options.source_axes == "field" and format_of(options.format).carries.asymmetric_field
    axes = middle_axes(middle) if is_turned else np.eye(3)
    camera = intermediate_camera(channels, axes, options.resolution, (panel.width_px, panel.height_px), 0.0)
    if options.source_size:
        camera = Pinhole(*options.source_size, camera.tangent_min, camera.tangent_max)
    source = View(camera, _source_place(options, middle, axes)(centre), np.eye(4), axes)
    origin, depth_m = Origin(middle.name, sha256), options.depth_m or math.inf
    return ExportedView(origin, middle.eye, channels, ray_map_plans(channels, axes), source, centre, depth_m)


def _source_place(
    options: ExportOptions, mappings: EyeMappings, device_from_camera: FloatArray
) -> Callable[[FloatArray], FloatArray]:
    """Place of the source camera as a function of the viewpoint."""
    return RasterPosition(mappings, device_from_camera).at if options.raster_camera == "nearest" else np.array


def _with_symmetric_camera(options: ExportOptions, views: dict[str, ExportedView]) -> dict[str, ExportedView]:
    """Views whose pictures have the same borders for each eye, as far to the left as to the right, and up as down."""
    cameras = [view.source.camera for view in views.values()]
    half = np.max([np.abs([camera.tangent_min, camera.tangent_max]) for camera in cameras], axis=(0, 1))
    density = np.max([camera.focal_px for camera in cameras], axis=0)
    width, height = options.source_size or np.ceil(2 * half * density).astype(int).tolist()
    camera = Pinhole(width, height, -half, half)
    return {eye: replace(view, source=replace(view.source, camera=camera)) for eye, view in views.items()}


def _still_pupils(options: ExportOptions, mappings: EyeMappings) -> Iterator[tuple[str, FloatArray]]:
    """Stem of the files and viewpoint of each pupil that does not move."""
    box, eye = mappings.eye_box, mappings.eye
    if options.viewpoint_mm is not None:
        pupil = 1e-3 * np.array(options.viewpoint_mm)
        require_in_eye_box(mappings, pupil, "--viewpoint-mm")
        yield eye, pupil
    elif options.pupils is None:
        yield eye, box.centre
    else:
        steps = np.linspace(-1.0, 1.0, options.pupils)
        for (row, y), (column, x) in itertools.product(enumerate(steps[::-1]), enumerate(steps)):
            yield f"{eye}-row{row}-column{column}", box.at(np.array([x, y, 0.0]))


def _report(options: ExportOptions, form: Format, views: list[ExportedView], files: list[Path]) -> Report:
    first = views[0]
    depth = "every depth" if form.carries.every_depth else _depth_words(first.depth_m)
    eyes = f"{' and '.join(eyes_of(options.eye))} eye{'s' if options.eye == 'both' else ''}"
    blocks: list[Block] = [
        Text(
            "An augmented-reality headset bends the light of its panel and of the world. For each pixel of the panel a "
            "file says what of a picture of the virtual scene, drawn by an ordinary pinhole camera, this pixel must "
            "show, so that the wearer sees the scene in its place in the world. The camera and the pupil for which "
            "this is right stand below."
        ),
        Section("What the numbers mean"),
        Text("In every file:", form.convention),
        Text(f"Frames and pixels: {_FRAMES}"),
        Section("How to use the files"),
        Text("Step by step:", form.use),
        _source_cameras(views),
        Section("What the files do not hold"),
        Text("Of what the headset does:", _not_held(form)),
        _loss_table(options, form, views),
        Section("How to check your program"),
        Text(
            f"Warp the first picture with {files[0].name}: the second one must come out. It was drawn by our own "
            f"sampling, {'bilinear' if form.carries.between_pixels else 'nearest pixel'}, of the codes as they are "
            "stored, for points at the depth above (infinity if the files hold every depth)."
        ),
        Picture("Source picture", options.out / CHECK_SOURCE, "u to the right in red, v downwards in green"),
        Picture("Picture for the panel", options.out / CHECK_PANEL, f"the {first.eye} panel, pixel by pixel"),
        Section("Files"),
        _views_table(views),
    ]
    return Report(
        f"Export of {first.origin.name}: {form.title}",
        f"{len(views)} view{'s' if len(views) > 1 else ''} of the {eyes}, for {depth}. The files and this page are all "
        "that a reader needs.",
        blocks=blocks,
        inputs=[*_headset_files(options), *filter(None, [options.eye_track])],
        files=files,
    )


_FRAMES = (
    "the device frame has x to the right, y up, and looks along -z, in metres. The source camera has such axes too; "
    "tangents are x / -z and y / -z. In a picture (0, 0) is the outer corner of the top left pixel, u runs right and v "
    "down, and pixel centres lie at +0.5."
)


def _depth_words(depth_m: float) -> str:
    return f"points {depth_m:g} m deep" if math.isfinite(depth_m) else "points at infinity"


def _not_held(form: Format) -> list[str]:
    carries = form.carries
    lost = [
        "A moving pupil: a map is right for its own pupil position alone; the table below says what another one costs."
    ]
    if not carries.every_depth:
        lost.append(
            "Depth: a map is right at one depth from the source camera, everywhere in the picture. The format rays "
            "holds all."
        )
    if not carries.colours:
        lost.append("Colour: one map serves all colours.")
    if not carries.asymmetric_field:
        lost.append(
            "An asymmetric field of view, or a turned camera: the source pictures of both eyes reach as far to the "
            "left as to the right, and up as down, in the device's axes; the rest of them is not used."
        )
    if not carries.between_pixels:
        lost.append("Positions between pixels: each panel pixel shows one pixel of the source, up to half a pixel off.")
    return lost


def _source_cameras(views: list[ExportedView]) -> ReportTable:
    by_eye = {view.eye: view for view in reversed(views)}
    rows: list[list[Cell]] = []
    for eye, view in sorted(by_eye.items()):
        camera = view.source.camera
        (left, bottom), (right, top) = camera.tangent_min.tolist(), camera.tangent_max.tolist()
        axes = "; ".join(" ".join(f"{value:.6f}" for value in row) for row in view.source.device_from_camera)
        tangents = [f"{value:.6f}" for value in (left, right, bottom, top)]
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
    rows: list[list[Cell]] = []
    for eye in eyes_of(options.eye):
        view = replace(next(each for each in views if each.eye == eye))
        rows += [
            [view.stem, loss.case, loss.rms_arcmin, loss.max_arcmin]
            for loss in losses(view, form.carries, view.middle_colour)
        ]
    columns = ["map", "used for", "rms (arcmin)", "max (arcmin)"]
    notes = [
        "Against this headset's own mappings, over the panel; pupils moved to the right, left, up and down as far as "
        "the eye box allows."
    ]
    return ReportTable("Misalignment of what a map shows", columns, rows, notes)


def _views_table(views: list[ExportedView]) -> ReportTable:
    rows: list[list[Cell]] = [
        [view.stem, view.time_s, _millimetres(view.viewpoint), _millimetres(view.source.position_in_device)]
        for view in views[:_LISTED]
    ]
    columns = ["files start with", "time (s)", "viewpoint (mm)", "source camera (mm)"]
    more = [f"The first {_LISTED} of {len(views)}."] if len(views) > _LISTED else []
    return ReportTable("Views", columns, rows, ["Positions x, y, z in the device frame.", *more])


def _millimetres(place: FloatArray) -> str:
    return ", ".join(f"{1e3 * value:.3f}" for value in place)
