"""The main job: draw one scene four ways for one headset, look through its true optics, measure the misalignment.

    naive        the panel as a flat picture in space (a linear map), without refraction in the combiner
    static       the best map for one viewpoint, used at all viewpoints
    raster+warp  planar models, intermediate image from a raster camera away from the viewpoint, per-frame warp map
    ray traced   planar models, world rays as primary rays

Without OpenGL, raster+warp is left out.

The models are fitted to a simulated calibration of the device; the device's exact optics are the truth. The error of
the planar models is also predicted, from their fit and its left-out camera positions, without these optics.
"""

import contextlib
from collections.abc import Collection, Iterator, Mapping
from dataclasses import KW_ONLY, dataclass
from functools import partial
from operator import itemgetter
from pathlib import Path
from typing import Annotated

import numpy as np
from numpy.typing import NDArray

from wlr_render.budget.error_map import predicted_error
from wlr_render.budget.error_sizes import Drawing, ErrorSizes, Truncation
from wlr_render.budget.registration_budget import registration_covariance
from wlr_render.budget.statement import variance
from wlr_render.calibration.fit_display import fit_display
from wlr_render.calibration.fit_eye import Calibration, calibrate
from wlr_render.captures.correspondences import Captures
from wlr_render.draw.painters import Frame, Painter, TracedPainter, blank_warnings, is_blank, saturation_warnings
from wlr_render.draw.raster_painter import WarpedPainter, traced_instead
from wlr_render.draw.ray_tracing import EyeView, RayRenderer, eye_view
from wlr_render.draw.scene_raster import SceneRaster, open_scene_raster
from wlr_render.errors import BadInputError
from wlr_render.evaluation.metrics import Summary, summary
from wlr_render.evaluation.misalignment import misalignment_arcmin
from wlr_render.exports.export_view import Origin, view_from_centre
from wlr_render.exports.page import Page
from wlr_render.geometry import directions
from wlr_render.geometry.pinhole import Pinhole
from wlr_render.io.atomic_files import output_folder
from wlr_render.jobs.budget_options import BudgetOptions
from wlr_render.jobs.demo_picture import (
    Panorama,
    busiest_place,
    close_up_camera,
    misalignment_caption,
    overview_camera,
    save_picture,
)
from wlr_render.jobs.job import job
from wlr_render.jobs.options import (
    Against,
    Backend,
    Eyes,
    Options,
    ProgressArgument,
    Range,
    Seed,
    described,
    eyes_of,
    folder_of_eye,
    seed_of,
)
from wlr_render.jobs.render_options import RenderOptions
from wlr_render.mappings import Eye
from wlr_render.models.see_through_model import undeviated
from wlr_render.numerics.arrays import FloatArray
from wlr_render.numerics.srgb import decode_srgb, encode_srgb
from wlr_render.optics.device_file import device_path, load_device
from wlr_render.optics.traced_mappings import traced_eye
from wlr_render.report.blocks import Block, Picture, Plot, Report, ReportTable, Section, cell_text, table
from wlr_render.report.plots import curves
from wlr_render.scene.image_files import write_png
from wlr_render.scene.scene import Scene
from wlr_render.scene.scene_file import load_scene, scene_path
from wlr_render.simulation import viewpoints as stage
from wlr_render.simulation.capture_setup import CaptureSetup
from wlr_render.simulation.simulate_captures import simulate_display, simulate_see_through
from wlr_render.usual import CAMERA_NOISE_ARCMIN
from wlr_render.work.progress import SILENT

METHODS = ("naive", "static", "raster + warp", "ray traced")
"""Methods without OpenGL: all except the third."""
CAMERA_POSITIONS = 49
HEAD_POSE = np.eye(4)
CAPTION = "The real object and, in green, its virtual twin by each method."
_PICTURED = 1
"""Viewpoint of the picture, off the centre of the eye box; of later ones only the geometry is needed."""
_GRID = (48, 54)
"""Pixels of each frame, across and down, at which the misalignment is taken."""


@dataclass(frozen=True)
class DemoOptions(Options):
    """Options of `demo`."""

    device: Annotated[str, described("A shipped device or a device file (.toml).")] = "northstar"
    _: KW_ONLY
    scene: Annotated[str, described("A shipped scene, a scene file or a mesh.")] = "sculpture"
    eye: Annotated[Eyes, described("Eyes to judge.")] = "right"
    viewpoints: Annotated[
        int, described("Number of viewpoints; the first is the centre of the eye box."), Range(at_least=5, at_most=1000)
    ] = 7
    seed: Seed = 1
    backend: Backend = "auto"
    out: Annotated[Path, described("Output folder; each eye has a subfolder if both are judged.")] = Path("out/demo")
    against: Against = None


@dataclass(frozen=True, eq=False)
class _View:
    """One viewpoint: the panel image of each method, and its misalignment at the judged pixels.

    Misalignment and its predicted rms (of the method that `_planar_of` returns) are (54, 48) arcmin, NaN where a pixel
    shows nothing of the scene.
    """

    viewpoint: FloatArray
    shown: dict[str, NDArray[np.uint8]]
    misalignment: dict[str, FloatArray]
    predicted: FloatArray

    @property
    def place_mm(self) -> str:
        return ", ".join(f"{each:.1f}" for each in 1e3 * self.viewpoint)


@job
def demo(options: DemoOptions = DemoOptions(), *, progress: ProgressArgument = SILENT) -> Report:
    """Fit models to a simulated calibration, draw with each method, look through the exact optics and judge.

    Writes the frames, the views, the picture and the report into `options.out`.

    Raises:
        BadInputError: a faulty device or scene, or an output folder that cannot be written.
    """
    device = load_device(options.device)
    eyes = {eye: traced_eye(device, eye) for eye in eyes_of(options.eye)}
    scene = load_scene(options.scene)
    if all(np.all(scene.bounds[:, 2] >= truth.eye_box.centre[2]) for truth in eyes.values()):
        raise BadInputError(f"The scene '{scene.name}' lies wholly behind the head; place it at negative z, in front.")
    raster, renderer = open_scene_raster(scene, options.backend), RayRenderer(scene)
    folder = output_folder(options.out)
    verdicts: list[str] = []
    blank: list[str] = []
    frames: list[NDArray[np.uint8]] = []
    blocks: list[Block] = []
    files: list[Path] = []
    with raster.context if raster else contextlib.nullcontext():
        for eye, truth in eyes.items():
            progress.say(f"calibrating the {eye} eye")
            fit, painters = _painters(truth, renderer, raster, options)
            places = judged_viewpoints(truth, options.viewpoints)
            seen = list(progress(_views(truth, fit, painters, places), len(places), f"viewpoints, {eye} eye"))
            if any(is_blank(colour) for view in seen for colour in view.shown.values()):
                blank.append(f"a frame of the {eye} eye")
            frames += seen[0].shown.values()
            own = output_folder(folder_of_eye(folder, eye, options.eye))
            files += _save_page(own, device.name, fit)
            files += _save_views(own, device.name, truth, renderer, seen[_PICTURED])
            errors = {method: summary(each) for method, each in _misalignments(seen).items()}
            verdicts.append(_verdict(errors, f"{scene.name} on {device.name}, {eye} eye"))
            blocks += [
                Section(f"The {eye} eye"),
                Picture("What the eye sees", files[-1], CAPTION),
                _overall(truth, scene, len(seen), errors),
                _by_viewpoint(seen),
                _predictions(seen),
                _distribution(seen),
            ]
    return Report(
        f"Simulated alignment of {scene.name} on {device.name}",
        " ".join(verdicts),
        warnings=[
            *scene.warnings,
            *traced_instead(raster, options.backend),
            *blank_warnings(blank, scene.name),
            *saturation_warnings(scene, frames),
        ],
        advice=_advice(files),
        blocks=blocks,
        inputs=[device_path(options.device), scene_path(options.scene)],
        files=files,
    )


def _advice(files: list[Path]) -> list[str]:
    pictures, pages = (
        " and ".join(str(path) for path in files if path.name.endswith(end)) for end in ("alignment.png", "-page.html")
    )
    return [
        f"Look at {pictures}.",
        f"Open {pages} in a browser: move the pupil, turn the head, choose the method.",
    ]


def _verdict(errors: Mapping[str, Summary], what: str) -> str:
    planar, static, naive = (
        [cell_text(each) for each in (errors[method].median, errors[method].p95, errors[method].maximum)]
        for method in (_planar_of(errors), "static", "naive")
    )
    return (
        f"{what}: misalignment with planar models is {planar[0]}' in the median ({planar[1]}' at 95 %, {planar[2]}' at "
        f"most); with one static map {static[0]}' ({static[1]}', {static[2]}'), with a naive flat picture {naive[0]}' "
        f"({naive[1]}', {naive[2]}')."
    )


def judged_viewpoints(truth: Eye, count: int) -> FloatArray:
    """Return viewpoints (count, 3): the eye box's centre, one near a corner, then fixed pseudo-random ones."""
    rng = np.random.default_rng(5)
    unit = np.concatenate([np.zeros((1, 3)), [[0.8, 0.8, -0.8]], rng.uniform(-1, 1, (count - 2, 3))])
    return truth.eye_box.at(unit)


def _painters(
    truth: Eye, renderer: RayRenderer, raster: SceneRaster | None, options: DemoOptions
) -> tuple[Calibration, dict[str, Painter]]:
    captures = simulated_captures(truth, options.seed)
    fit = calibrate(captures, "planar")
    planar = fit.mappings
    static = calibrate(captures, "static").mappings
    flat = fit_display(captures.both[0], "static", 1).mapping
    naive = Eye("naive", truth.eye, flat, undeviated(truth.eye_box), truth.eye_box)
    eyes = {"naive": naive, "static": static, "ray traced": planar}
    painters: dict[str, Painter] = {
        method: TracedPainter(mappings, renderer, RenderOptions.supersample) for method, mappings in eyes.items()
    }
    if raster is not None:
        painters["raster + warp"] = WarpedPainter(planar, raster, RenderOptions.resolution)
    return fit, {method: painters[method] for method in METHODS if method in painters}


def _planar_of(methods: Collection[str]) -> str:
    """Return the method whose figures represent the planar models."""
    return METHODS[2] if METHODS[2] in methods else METHODS[3]


def simulated_captures(truth: Eye, seed: int) -> Captures:
    """Simulate a planar calibration with camera noise, plus one position at the centre for the static map."""
    rng = np.random.default_rng(seed_of(seed, truth.eye))
    setup = CaptureSetup(truth, camera_noise_arcmin=CAMERA_NOISE_ARCMIN.value)
    planar = stage.planar(truth.eye_box, setup.field.reach, CAMERA_POSITIONS)
    positions = np.concatenate([planar, stage.nominal(truth.eye_box)])
    return Captures(simulate_display(setup, positions, rng), simulate_see_through(setup, positions, rng))


def _views(truth: Eye, fit: Calibration, painters: dict[str, Painter], places: FloatArray) -> Iterator[_View]:
    pixel = np.floor(truth.display.panel.grid(*_GRID)) + 0.5
    planar = _planar_of(painters)
    # The measured error of raster frames includes the warp grid's; adding its bound would count it twice.
    drawing = Drawing(raster_arcmin=BudgetOptions.raster_arcmin if planar == METHODS[2] else 0.0)
    sizes = ErrorSizes(drawing=drawing, truncation=Truncation.from_report(fit.model().report))
    for index, viewpoint in enumerate(places):
        view = _View(viewpoint, {}, {}, np.full(pixel.shape[:2], np.nan))
        for method, painter in painters.items():
            frame = painter.paint(viewpoint, HEAD_POSE, with_geometry=True)
            if index <= _PICTURED:
                view.shown[method] = frame.colour
            point = _shown_points(frame, pixel)
            kept = np.isfinite(point[..., 0])
            misalignment = np.full(kept.shape, np.nan)
            misalignment[kept] = misalignment_arcmin(truth, viewpoint, pixel[kept], point[kept])
            view.misalignment[method] = misalignment
            if method == planar:
                depth_m = viewpoint[2] - point[kept][:, 2]
                expected = registration_covariance(fit.mappings, pixel[kept], viewpoint, depth_m, sizes).total
                view.predicted[kept] = np.sqrt(variance(expected))
        yield view


def _shown_points(frame: Frame, pixel: FloatArray) -> FloatArray:
    """Return the points (..., 3) that pixels (..., 2) show, NaN for the background: world and device frame coincide."""
    assert frame.position is not None
    return np.asarray(frame.position[pixel[..., 1].astype(int), pixel[..., 0].astype(int)], np.float64)


def _misalignments(seen: list[_View]) -> dict[str, FloatArray]:
    """Return the misalignments (n, 48) of all viewpoints, by method."""
    return {method: np.concatenate([view.misalignment[method] for view in seen]) for method in seen[0].misalignment}


def _overall(truth: Eye, scene: Scene, viewpoints: int, errors: Mapping[str, Summary]) -> ReportTable:
    columns = {"median (arcmin)": "median", "95 % (arcmin)": "p95", "max (arcmin)": "maximum", "points": "count"}
    title = f"Misalignment of {scene.name} on {truth.name}, {viewpoints} viewpoints in the eye box"
    return table(title, errors.items(), columns, name="method")


def _by_viewpoint(seen: list[_View]) -> ReportTable:
    medians = [
        (view.place_mm, {method: summary(each).median for method, each in view.misalignment.items()}) for view in seen
    ]
    columns = {method: itemgetter(method) for method in seen[0].misalignment}
    return table("Median misalignment (arcmin) by viewpoint", medians, columns, name="viewpoint (mm)")


def _predictions(seen: list[_View]) -> ReportTable:
    planar = _planar_of(seen[0].misalignment)
    groups = [(view.place_mm, _predicted_and_true([view])) for view in seen] + [("all", _predicted_and_true(seen))]
    note = (
        f"For '{planar}', at the same pixels. Predicted from the calibration alone: covariance and truncation error of "
        "both models, and the error of raster frames. True: through the device's exact optics."
    )
    title = "Predicted and true misalignment of the planar models, rms (arcmin)"
    return table(title, groups, {"predicted": itemgetter(0), "true": itemgetter(1)}, [note], name="viewpoint (mm)")


def _predicted_and_true(seen: list[_View]) -> tuple[float, float]:
    """Return the predicted and the true rms misalignment over all pixels that have both, arcminutes."""
    planar = _planar_of(seen[0].misalignment)
    predicted, true = (
        np.stack(each) for each in zip(*((e.predicted, e.misalignment[planar]) for e in seen), strict=True)
    )
    both = np.isfinite(predicted + true)
    return summary(predicted[both]).rms, summary(true[both]).rms


def _distribution(seen: list[_View]) -> Plot:
    percent = np.linspace(0, 100, 201)
    lines = {method: (np.nanpercentile(each, percent), percent) for method, each in _misalignments(seen).items()}
    axes = ("misalignment (arcmin)", "points with less (%)")
    return curves("Distribution of misalignment", lines, axes, log_x=True, caption="All viewpoints.")


def _save_views(folder: Path, device: str, truth: Eye, renderer: RayRenderer, view: _View) -> list[Path]:
    """Write each method's panel picture and its view through the true optics; the last file shows all of them."""

    def look(camera: Pinhole) -> EyeView:
        return eye_view(truth, renderer, view.viewpoint, HEAD_POSE, camera)

    overview = overview_camera(_content_tangents(truth, renderer.scene, view.viewpoint))
    far = look(overview)
    close_up = close_up_camera(overview, busiest_place(overview, far.real))
    near = look(close_up)
    written = [write_png(folder / "eye-display-off.png", far.real)]
    panoramas = [Panorama("display off", far.real, near.real, "the real object")]
    for method, shown in view.shown.items():
        stem = method.replace(" + ", "-").replace(" ", "-")
        prediction = _predicted_and_true([view]) if method == _planar_of(view.shown) else None
        caption = misalignment_caption(summary(view.misalignment[method]), prediction)
        panorama = Panorama(method, _blended(far, shown), _blended(near, shown), caption)
        written.append(write_png(folder / f"panel-{stem}.png", shown))
        written.append(write_png(folder / f"eye-{stem}.png", panorama.overview))
        panoramas.append(panorama)
    heading = f"What the eye sees through {device}: the real {renderer.scene.name} and its virtual twin, in green"
    return [*written, save_picture(folder / "alignment.png", panoramas, (overview, close_up), heading)]


def _save_page(folder: Path, device: str, fit: Calibration) -> list[Path]:
    """Write the animated page of the planar models."""
    sizes = ErrorSizes(truncation=Truncation.from_report(fit.model().report))
    predictors = (partial(predicted_error, fit.mappings, sizes),)
    view = view_from_centre((fit.mappings,), Origin(device, {}, {}), is_turned=True, predictors=predictors)
    return list(Page().write([view], folder))


def _content_tangents(truth: Eye, scene: Scene, viewpoint: FloatArray) -> FloatArray:
    """Return the tangent limits of the content: the overlap of panel and scene, with a margin."""
    panel = truth.display.panel
    edge = truth.display.view_dir_of_pixel(panel.grid(9, 9).reshape(-1, 2), viewpoint)
    field = directions.tangents_of_dir(edge.value[edge.usable])
    corners = np.stack(np.meshgrid(*scene.bounds.T, indexing="ij"), axis=-1).reshape(-1, 3)
    content = directions.tangents_of_dir(corners - viewpoint)
    low, high = np.nanmin(content, axis=0), np.nanmax(content, axis=0)
    margin = 0.05 * (high - low)
    return np.stack([np.maximum(low - margin, field.min(axis=0)), np.minimum(high + margin, field.max(axis=0))])


def _blended(view: EyeView, shown: NDArray[np.uint8]) -> NDArray[np.uint8]:
    """Draw the virtual twin over the real object as a glow in one colour, which distinguishes the two."""
    luminance = decode_srgb(shown) @ np.array([0.2126, 0.7152, 0.0722], np.float32)
    tint = decode_srgb(np.array([38, 255, 115], np.uint8))
    return view.with_display(encode_srgb(luminance[..., None] * tint), gain=0.6, see_through=0.5)
