"""Write the warp maps of a headset as files for other programs, and a page that explains them."""

import itertools
import math
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import replace
from functools import partial
from pathlib import Path

import numpy as np

from wlr_render import __version__
from wlr_render.budget.error_map import predicted_error
from wlr_render.budget.error_sizes import ErrorSizes, Truncation
from wlr_render.budget.registration_budget import has_covariance
from wlr_render.exports.check_pictures import write_check
from wlr_render.exports.export_view import (
    ALL_COLOURS,
    ExportedView,
    Origin,
    Predictor,
    has_ray,
    view_from_centre,
    with_symmetric_camera,
)
from wlr_render.exports.facts import not_held
from wlr_render.exports.formats import format_of
from wlr_render.io.atomic_files import output_folder
from wlr_render.io.input_files import hashes_of_inputs
from wlr_render.io.kept import LEDGER, Kept, recipe_of, signatures_of
from wlr_render.jobs.export_options import ExportOptions
from wlr_render.jobs.export_page import export_page
from wlr_render.jobs.frame_plan import Motion, gap_warnings, held_warnings, planned_frames
from wlr_render.jobs.headset import (
    PRIMARIES_UM,
    effect_warnings,
    headset_path,
    is_factory,
    is_model,
    open_channels,
    open_colours,
    require_in_eye_box,
)
from wlr_render.jobs.job import job
from wlr_render.jobs.options import ProgressArgument, eyes_of
from wlr_render.mappings import COLOURS, Eye, EyeChannels, middle_channel
from wlr_render.models.model_file import load_eye_model
from wlr_render.numerics.arrays import FloatArray
from wlr_render.optics.media import GREEN_UM
from wlr_render.report.blocks import Report
from wlr_render.scene.exr_file import require_exr
from wlr_render.tracking.eye_trajectory_file import read_eye_trajectory
from wlr_render.tracking.trajectory import EyeTrajectory
from wlr_render.work.progress import SILENT

_NO_RAY, _OUTSIDE = "have no ray", "lie outside the source picture"


@job
def export(options: ExportOptions, *, progress: ProgressArgument = SILENT) -> Report:
    """Write the maps missing from `options.out`, and their page; remove the files of another export there.

    Raises:
        BadInputError: faulty files, a pupil outside the eye box, or content that the format does not support.
        MissingExtraError: a library that the format needs is not installed.
    """
    form = format_of(options.format)
    if form.holds.is_exr:
        require_exr(f"The format {form.name}")
    with hashes_of_inputs() as inputs:
        channels = _open_channels(options)
        track = read_eye_trajectory(options.eye_track) if options.eye_track else None
    views, warnings = _planned(options, channels, track, inputs)
    folder = output_folder(options.out)
    stated = options.recipe_values({"headset": ""}) | {"version": __version__}  # its file is an input
    finished = Kept(folder, recipe_of("export", stated, inputs), replaces=True)
    missing = [view for view in views if finished.unfinished([folder / name for name in form.files(view)])]
    first_of_eye = {view.eye: view for view in reversed(views)}
    lost: list[tuple[str, str, float]] = []
    solved = _solved(progress(missing, len(missing), "views"), first_of_eye, lost)
    for path in form.write(solved, folder):
        finished.add(signatures_of([path]), {"lost": lost.copy()} if lost else {})
        lost.clear()
    maps = [folder / name for name in dict.fromkeys(name for view in views for name in form.files(view))]
    check = write_check(folder, views[0], form.holds)
    finished.add(signatures_of(check))
    removed, changed = finished.remove_replaced()
    warnings = [
        *not_held(views[0], form),
        *effect_warnings(options.headset),
        *warnings,
        *_lost_pixels([each for path in maps for each in finished.facts(path).get("lost", ())]),
        *([f"{removed} files of an earlier export were removed from {folder}."] if removed else []),
        *(f"{each}: was changed after an earlier export, and is left; remove it." for each in changed),
    ]
    read = [*_headset_files(options).values(), *filter(None, [options.eye_track])]
    page = export_page(options, form, views, [*maps, *check, folder / LEDGER], read, len(views) - len(missing))
    return replace(page, warnings=warnings)


def _solved(
    shown: Iterable[ExportedView], first_of_eye: Mapping[str, ExportedView], lost: list[tuple[str, str, float]]
) -> Iterator[ExportedView]:
    """Yield the views to write; append kind, stem and share of the panel pixels without a source of each map to `lost`.

    The page needs the maps of each eye's first view. The other views are copies; their maps are freed with the copy.
    """
    for planned in shown:
        view = planned if planned is first_of_eye[planned.eye] else replace(planned)
        for colour, stem in zip(view.colours, view.stems, strict=True):
            position = view.source_px(colour)
            is_solved, is_inside = has_ray(position), view.source.camera.contains(position)
            for kind, lacks in ((_NO_RAY, ~is_solved), (_OUTSIDE, is_solved & ~is_inside)):
                if lacks.any():
                    lost.append((kind, stem, float(lacks.mean())))
        yield view


def _lost_pixels(lost: Sequence[tuple[str, str, float]]) -> list[str]:
    """Return a sentence per kind of lost pixels, on its only map, or on the number of maps and the worst one."""
    found = []
    for kind in (_NO_RAY, _OUTSIDE):
        shares = [(share, stem) for of, stem, share in lost if of == kind]
        if shares:
            share, stem = max(shares, key=lambda each: round(each[0], 5))
            others = f" It is the worst of {len(shares)} such maps." if len(shares) > 1 else ""
            found.append(f"{stem}: {share:.3%} of the panel pixels {kind}.{others}")
    return found


def _open_channels(options: ExportOptions) -> dict[str, EyeChannels]:
    eyes, colours = eyes_of(options.eye), (options.red_model, options.blue_model)
    return open_channels(options.headset, eyes, options.has_colours, *colours)


def _headset_files(options: ExportOptions) -> dict[str, Path]:
    """Return the headset's files by their names in the facts; models of three colours have three names."""
    middle = headset_path(options.headset)
    if options.red_model is None or options.blue_model is None:
        return {middle.name: middle}
    paths = dict(zip(COLOURS, (options.red_model, middle, options.blue_model), strict=True))
    return {f"{colour}: {path.name}": path for colour, path in paths.items()}


def _planned(
    options: ExportOptions, channels: dict[str, EyeChannels], track: EyeTrajectory | None, inputs: Mapping[str, str]
) -> tuple[list[ExportedView], list[str]]:
    """Return all views, and warnings about the trajectory."""
    views: list[ExportedView] = []
    greens = {eye: middle_channel(each) for eye, each in channels.items()}
    motion = Motion(None, track, options.frames_per_second, options.frame_limit)
    planned = planned_frames(motion, greens) if track else []
    for eye, first in views_from_centres(options, channels, inputs).items():
        pupils: list[tuple[str, FloatArray, float | None]]
        if track:
            pupils = [(frame.stem, frame.viewpoint, frame.time_s) for frame in planned if frame.eye == eye]
        else:
            pupils = [(stem, pupil, None) for stem, pupil in _still_pupils(options, greens[eye])]
        views += [first.moved_to(pupil, stem, time_s) for stem, pupil, time_s in pupils]
    return views, [*gap_warnings(motion, greens), *held_warnings(motion, planned)]


def views_from_centres(
    options: ExportOptions, channels: dict[str, EyeChannels] | None = None, inputs: Mapping[str, str] | None = None
) -> dict[str, ExportedView]:
    """Return the view of each eye from the centre of its eye box, without writing files: for scripts.

    Args:
        options: options of the export.
        channels, inputs: mappings of each eye, and hashes of their files by path; read by default.

    Raises:
        BadInputError: faulty files, or an eye that the headset does not have.
    """
    if channels is None or inputs is None:
        with hashes_of_inputs() as inputs:
            channels = _open_channels(options)
    files = _headset_files(options)
    sha256 = {name: inputs[str(path)] for name, path in files.items() if str(path) in inputs}
    origin = Origin(next(iter(channels.values()))[0].name, sha256, _wavelengths(options, channels))
    views = {eye: _view_from_centre(options, of_eye, origin) for eye, of_eye in channels.items()}
    has_own_cameras = format_of(options.format).holds.asymmetric_field
    return views if has_own_cameras else with_symmetric_camera(views, options.source_size)


def _wavelengths(options: ExportOptions, channels: dict[str, EyeChannels]) -> dict[str, float]:
    """Return the wavelength in nanometres of each map of a device; empty for fitted models and factory calibrations."""
    if is_model(options.headset) or is_factory(options.headset):
        return {}
    if options.has_colours:
        return {colour: 1e3 * um for colour, um in zip(COLOURS, PRIMARIES_UM, strict=True)}
    return {ALL_COLOURS: 1e3 * GREEN_UM}


def _view_from_centre(options: ExportOptions, channels: EyeChannels, origin: Origin) -> ExportedView:
    return view_from_centre(
        channels,
        origin,
        is_turned=options.source_axes != "device" and format_of(options.format).holds.asymmetric_field,
        resolution=options.resolution,
        source_size=options.source_size,
        source_camera=options.source_camera,
        depth_m=options.depth_m or math.inf,
        other_light=_other_light(options, channels[0].eye),
        predictors=_predictors(options, channels),
    )


def _predictors(options: ExportOptions, channels: EyeChannels) -> tuple[Predictor, ...]:
    """Return functions that predict the model errors of each channel; empty unless all models have a covariance."""
    if not all(map(has_covariance, channels)):
        return ()
    reports = [load_eye_model(path, channels[0].eye).report for path in _headset_files(options).values()]
    return tuple(
        partial(predicted_error, mappings, ErrorSizes(truncation=Truncation.from_report(report)))
        for mappings, report in zip(channels, reports, strict=True)
    )


def _other_light(options: ExportOptions, eye: str) -> dict[str, Eye]:
    """Return a device's mappings in red and blue light if one map serves all colours, else an empty mapping."""
    if options.has_colours or is_model(options.headset):
        return {}
    red, _, blue = open_colours(options.headset, eye)
    names = [f"{colour} light, {1e3 * PRIMARIES_UM[k]:.0f} nm" for colour, k in (("red", 0), ("blue", 2))]
    return dict(zip(names, (red, blue), strict=True))


def _still_pupils(options: ExportOptions, mappings: Eye) -> Iterator[tuple[str, FloatArray]]:
    """Yield the file stem and the viewpoint of each pupil that does not move."""
    box, eye = mappings.eye_box, mappings.eye
    chosen = options.viewpoint_m(eye)
    if chosen is not None:
        require_in_eye_box(mappings, chosen, "--viewpoint-mm")
        yield eye, chosen
    elif options.pupils is None:
        yield eye, box.centre
    else:
        steps = np.linspace(-1.0, 1.0, options.pupils)
        for (row, y), (column, x) in itertools.product(enumerate(steps[::-1]), enumerate(steps)):
            yield f"{eye}-row{row}-column{column}", box.at(np.array([x, y, 0.0]))
