"""Write the warp maps of a headset as files that other programs read, and a page that explains them."""

import itertools
import math
from collections.abc import Callable, Iterable, Iterator, Mapping
from dataclasses import replace
from pathlib import Path

import numpy as np

from wlr_render import __version__
from wlr_render.exports.check_pictures import write_check
from wlr_render.exports.formats import format_of
from wlr_render.exports.view import ExportedView, Origin, has_ray, ray_map_plans
from wlr_render.files import output_folder
from wlr_render.finished_files import LIST, FinishedFiles, digest_of
from wlr_render.geometry.pinhole import Pinhole
from wlr_render.input_files import hashes_of_inputs
from wlr_render.jobs.export_options import ExportOptions
from wlr_render.jobs.export_page import export_page
from wlr_render.jobs.frame_plan import gap_warnings, held_warnings, planned_frames
from wlr_render.jobs.headset import headset_path, open_channels, require_in_eye_box
from wlr_render.jobs.job import job
from wlr_render.jobs.options import Eye, ProgressArgument, eyes_of
from wlr_render.mappings import EyeChannels, EyeMappings, middle_channel
from wlr_render.numerics.arrays import FloatArray
from wlr_render.progress import SILENT
from wlr_render.rendering.raster_camera import RasterPosition, intermediate_camera
from wlr_render.rendering.ray_map import middle_axes
from wlr_render.rendering.view import View
from wlr_render.report.blocks import Report
from wlr_render.report.save import save_report
from wlr_render.tracking.eye_trajectory_file import read_eye_trajectory
from wlr_render.tracking.trajectory import EyeTrajectory

_KIND = "export "
"""Start of the digests of exports, in the list of finished files."""
_WITHOUT_EFFECT = ("out", "model", "red_model", "blue_model", "eye_track")


@job
def export(options: ExportOptions, *, progress: ProgressArgument = SILENT) -> Report:
    """Write the maps that `options.out` does not hold yet, and their page; files of another export there are removed.

    Raises:
        BadInputError: faulty files, a pupil outside the eye box, or what the format does not hold.
        MissingExtraError: a library that the format needs is not installed.
    """
    form = format_of(options.format)
    with hashes_of_inputs() as inputs:
        channels = _open_channels(options)
        track = read_eye_trajectory(options.eye_track) if options.eye_track else None
    views, warnings = _planned(options, channels, track, _own_hashes(options, inputs))
    folder = output_folder(options.out)
    finished = FinishedFiles(
        folder, _KIND + digest_of(_stated(options), list(inputs.values()), __version__), kind=_KIND
    )
    missing = [view for view in views if finished.not_whole([folder / name for name in form.files(view)])]
    first_of_eye = {view.eye: view for view in reversed(views)}
    lost: list[str] = []
    solved = _solved(progress(missing, len(missing), "views"), first_of_eye, lost)
    for path in form.write(solved, folder):
        finished.add([path], "\n".join(lost))
        lost.clear()
    maps = [folder / name for name in dict.fromkeys(name for view in views for name in form.files(view))]
    check = write_check(folder, views[0], form.carries)
    finished.add(check)
    warnings += [sentence for path in maps for sentence in finished.remark(path).splitlines()]
    warnings += [
        f"{path}: was changed after an earlier export, and is left; remove it." for path in finished.remove_replaced()
    ]
    read = [*_headset_files(options), *filter(None, [options.eye_track])]
    page = export_page(options, form, views, [*maps, *check, folder / LIST], read, len(views) - len(missing))
    return save_report(replace(page, warnings=warnings), folder)


def _stated(options: ExportOptions) -> dict[str, str]:
    """The options that decide what the files hold; input files count by their content."""
    return {name: str(value) for name, value in vars(options).items() if name not in _WITHOUT_EFFECT}


def _solved(
    shown: Iterable[ExportedView], first_of_eye: Mapping[str, ExportedView], lost: list[str]
) -> Iterator[ExportedView]:
    """Views to write; appends a sentence to `lost` for panel pixels that a map serves nothing.

    The page needs the maps of the first view of each eye. The others are copied, so that their maps go with the copy.
    """
    for planned in shown:
        view = planned if planned is first_of_eye[planned.eye] else replace(planned)
        position = view.source_px(view.middle_colour)
        is_solved, is_inside = has_ray(position), view.source.camera.contains(position)
        for count, what in (
            (np.sum(~is_solved), "have no ray"),
            (np.sum(is_solved & ~is_inside), "lead past the picture"),
        ):
            if count:
                lost.append(f"{view.stem}: {count} of {is_solved.size} panel pixels {what}.")
        yield view


def _open_channels(options: ExportOptions) -> dict[str, EyeChannels]:
    eyes, colours = eyes_of(options.eye), (options.red_model, options.blue_model)
    return open_channels(options.model, eyes, options.has_colours, *colours)


def _headset_files(options: ExportOptions) -> list[Path]:
    return [headset_path(options.model), *filter(None, (options.red_model, options.blue_model))]


def _planned(
    options: ExportOptions, channels: dict[str, EyeChannels], track: EyeTrajectory | None, sha256: dict[str, str]
) -> tuple[list[ExportedView], list[str]]:
    """All views, and warnings about the trajectory."""
    views: list[ExportedView] = []
    greens = {eye: middle_channel(each) for eye, each in channels.items()}
    planned = planned_frames(options, greens, None, track) if track else []
    for eye, first in _views_from_centres(options, channels, sha256).items():
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


def view_from_centre(options: ExportOptions, eye: Eye) -> ExportedView:
    """The view of one eye from the centre of its eye box, without writing anything: for scripts.

    Raises:
        BadInputError: faulty files, or an eye that the headset does not have.
    """
    return views_from_centres(replace(options, eye=eye))[eye]


def views_from_centres(options: ExportOptions) -> dict[str, ExportedView]:
    """The same of all eyes of the options.

    Raises:
        BadInputError: faulty files, or an eye that the headset does not have.
    """
    with hashes_of_inputs() as inputs:
        channels = _open_channels(options)
    return _views_from_centres(options, channels, _own_hashes(options, inputs))


def _views_from_centres(
    options: ExportOptions, channels: dict[str, EyeChannels], sha256: dict[str, str]
) -> dict[str, ExportedView]:
    views = {eye: _view_from_centre(options, of_eye, sha256) for eye, of_eye in channels.items()}
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


def _view_from_centre(options: ExportOptions, channels: EyeChannels, sha256: dict[str, str]) -> ExportedView:
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
