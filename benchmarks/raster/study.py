"""Measure the error of rasterisation against ray tracing, pixel by pixel."""

from dataclasses import KW_ONLY, dataclass
from pathlib import Path
from typing import Annotated

import numpy as np
from numpy.typing import NDArray

from benchmarks.raster.disocclusion import disoccluded
from benchmarks.raster.mesh_painter import MeshWarpedPainter
from benchmarks.raster.raster_error import RasterError, raster_error
from wlr_render.draw.painters import Frame, Painter, TracedPainter, blank_warnings, is_blank, saturation_warnings
from wlr_render.draw.raster_painter import WarpedPainter
from wlr_render.draw.ray_intersections import SceneTracer
from wlr_render.draw.ray_tracing import RayRenderer
from wlr_render.draw.scene_raster import SceneRaster, open_scene_raster
from wlr_render.errors import BadInputError, MissingGlError
from wlr_render.evaluation.metrics import Summary, summary
from wlr_render.geometry import transforms
from wlr_render.io.atomic_files import output_folder, write_figure
from wlr_render.jobs.headset import headset_path, open_eye, require_in_eye_box
from wlr_render.jobs.options import (
    Backend,
    Eyes,
    Options,
    ProgressArgument,
    Range,
    described,
    eyes_of,
    folder_of_eye,
)
from wlr_render.mappings import Eye
from wlr_render.numerics.arrays import FloatArray
from wlr_render.report.blocks import Block, Picture, Report, Section, cell_text, table
from wlr_render.report.save import save_report
from wlr_render.scene.image_files import write_map, write_png
from wlr_render.scene.scene_file import load_scene, scene_path
from wlr_render.warp.raster_camera import RasterPlace
from wlr_render.work.progress import SILENT, Progress

HEAD_POSE = np.eye(4)
COLUMNS = {
    "median (arcmin)": "angle.median",
    "95 % (arcmin)": "angle.p95",
    "max (arcmin)": "angle.maximum",
    "disoccluded (%)": "disoccluded",
    "only in one (%)": "only_one",
    "colour difference (8 bit)": "colour",
}
NOTES = (
    "Errors are angles at the eye between the world points that the two frames show at a pixel, over pixels that are "
    "not disoccluded. Disoccluded: from where the intermediate image is drawn, something hides the point that the "
    "world ray meets (found with the scene itself); share of pixels that show anything.",
)
METHODS: dict[str, tuple[RasterPlace, bool, float]] = {
    "raster + warp": ("nearest", False, 1.0),
    "raster camera at the viewpoint": ("viewpoint", False, 1.0),
    "twice the raster resolution": ("nearest", False, 2.0),
    "map from the mesh": ("nearest", True, 1.0),
    "camera at the viewpoint, map from the mesh (paper)": ("viewpoint", True, 1.0),
}
"""Rows of the table: raster camera, whether the warp map comes from the mesh, resolution; the first row is drawn."""
_FIRST = next(iter(METHODS))
ERROR_LIMITS_ARCMIN = (1e-3, 10.0)
"""Errors of the first and last colour of the error maps."""


@dataclass(frozen=True)
class RasterOptions(Options):
    """Options of `raster`."""

    headset: Annotated[str, described("A device or a model file.")]
    scene: Annotated[str, described("A shipped scene, a scene file or a mesh.")]
    _: KW_ONLY
    eye: Annotated[Eyes, described("Eyes to compare.")] = "right"
    viewpoint_offset_mm: Annotated[
        tuple[float, float, float],
        described("Viewpoint from the centre of the eye box, device frame: X Y Z in mm."),
        Range(at_least=-100, at_most=100),
    ] = (0.0, 0.0, 0.0)
    backend: Backend = "auto"
    out: Annotated[Path, described("Output folder; each eye has a subfolder if both are compared.")] = Path(
        "out/benchmarks/raster"
    )


def run(options: RasterOptions, *, progress: ProgressArgument = SILENT) -> Report:
    """Draw a frame by rasterisation and by ray tracing and compare them; write both, and the error map as .tiff.

    The table has a row for each of `METHODS`; the verdict, the frame and the error map are of the first.

    Raises:
        BadInputError: faulty headset or scene, or a viewpoint outside the eye box.
        MissingGlError: no OpenGL, hence no raster frames.
    """
    eyes = {eye: open_eye(options.headset, eye) for eye in eyes_of(options.eye)}
    viewpoints = {eye: each.eye_box.centre + 1e-3 * np.array(options.viewpoint_offset_mm) for eye, each in eyes.items()}
    for eye, mappings in eyes.items():
        require_in_eye_box(mappings, viewpoints[eye], "--viewpoint-offset-mm")
    scene = load_scene(options.scene)
    raster, renderer = open_scene_raster(scene, options.backend), RayRenderer(scene)
    if raster is None:
        if options.backend == "cpu":
            raise BadInputError(
                "There are no raster frames to compare with --backend cpu, which ray traces; leave --backend out."
            )
        raise MissingGlError(
            "There are no raster frames to compare: without OpenGL frames are ray traced; install libegl1 and libgl1, "
            "or libosmesa6, and choose --backend auto."
        )
    folder = output_folder(options.out)
    verdicts: list[str] = []
    blank: list[str] = []
    frames: list[NDArray[np.uint8]] = []
    blocks: list[Block] = []
    files: list[Path] = []
    with raster.context:
        for eye, mappings in eyes.items():
            compared = _compare_eye(mappings, viewpoints[eye], raster, renderer, progress)
            title = f"Raster against ray tracing: {scene.name} on {mappings.name}, {eye} eye"
            drawn = compared.write(output_folder(folder_of_eye(folder, eye, options.eye)), title)
            picture = Picture(f"Both frames and their difference, {eye} eye", drawn[-1], "Red: disoccluded.")
            figures = table(title, compared.figures.items(), COLUMNS, NOTES, name="method")
            blocks += [Section(f"The {eye} eye"), figures, picture]
            files += drawn
            verdicts.append(compared.verdict(eye))
            blank += [f"the frame of the {eye} eye"] if is_blank(compared.traced) else []
            frames.append(compared.traced)
    report = Report(
        f"Rasterisation error of {scene.name} on {Path(options.headset).stem}",
        " ".join(verdicts),
        warnings=[*scene.warnings, *blank_warnings(blank, scene.name), *saturation_warnings(scene, frames)],
        blocks=blocks,
        inputs=[headset_path(options.headset), scene_path(options.scene)],
        files=files,
        record={"viewpoint_in_device_m": viewpoints},
    )
    return save_report(report, folder, "raster")


def _compare_eye(
    mappings: Eye,
    viewpoint: FloatArray,
    raster: SceneRaster,
    renderer: RayRenderer,
    progress: Progress,
) -> "_Compared":
    traced = TracedPainter(mappings, renderer).paint(viewpoint, HEAD_POSE, with_geometry=True)
    figures: dict[str, _Figures] = {}
    first: tuple[Frame, _Error] | None = None
    for method in progress(iter(METHODS), len(METHODS), f"{mappings.eye} eye, methods"):
        raster_camera, from_mesh, resolution = METHODS[method]
        painter: Painter = (
            MeshWarpedPainter(mappings, raster, renderer, resolution, raster_camera)
            if from_mesh
            else WarpedPainter(mappings, raster, resolution, raster_camera)
        )
        frame = painter.paint(viewpoint, HEAD_POSE, with_geometry=True)
        error = _error(frame, traced, renderer.tracer)
        figures[method] = _Figures.of(error, frame.colour, traced.colour)
        first = first or (frame, error)
    assert first is not None
    return _Compared(first[0].colour, traced.colour, first[1], figures)


@dataclass(frozen=True, eq=False)
class _Error:
    """Difference of a rasterised frame from the ray-traced one; masks and angles per display pixel."""

    raster: RasterError
    disoccluded: NDArray[np.bool_]


@dataclass(frozen=True)
class _Figures:
    """Errors of the pixels that are not disoccluded, shares of pixels in percent, and mean difference in colour."""

    angle: Summary
    disoccluded: float
    only_one: float
    colour: float

    @classmethod
    def of(cls, error: _Error, drawn: NDArray[np.uint8], truth: NDArray[np.uint8]) -> "_Figures":
        angle, only_one = error.raster.registration_arcmin, error.raster.only_one
        shown = max(1, int(np.isfinite(angle).sum() + only_one.sum()))
        difference = float(np.abs(drawn.astype(np.int16) - truth).mean())
        hidden, single = (100.0 * float(mask.sum()) / shown for mask in (error.disoccluded, only_one))
        return cls(summary(angle[~error.disoccluded]), hidden, single, difference)


@dataclass(frozen=True, eq=False)
class _Compared:
    """Both frames of an eye, the error of the first method, and the figures of each method."""

    rastered: NDArray[np.uint8]
    traced: NDArray[np.uint8]
    error: _Error
    figures: dict[str, _Figures]

    def verdict(self, eye: str) -> str:
        """Return the result of the first method in one sentence."""
        first = self.figures[_FIRST]
        values = (first.angle.median, first.angle.p95, first.angle.maximum, first.disoccluded)
        median, p95, maximum, hidden = map(cell_text, values)
        return (
            f"The rastered frame of the {eye} eye shows world points {median}' off in the median ({p95}' at 95 %, "
            f"{maximum}' at most) against ray tracing; {hidden} % of its pixels are disoccluded."
        )

    def write(self, folder: Path, title: str) -> list[Path]:
        """Write both frames, the error map and the comparison picture."""
        written = [folder / "raster.png", folder / "raytrace.png", folder / "error.tiff"]
        write_png(written[0], self.rastered)
        write_png(written[1], self.traced)
        # Channels: error in arcmin, 1 where disoccluded, 1 where only one frame shows something.
        layers = (self.error.raster.registration_arcmin, self.error.disoccluded, self.error.raster.only_one)
        write_map(written[2], np.stack([np.asarray(layer, np.float32) for layer in layers], axis=-1))
        return [*written, self._draw(folder / "compare.png", title)]

    def _draw(self, path: Path, title: str) -> Path:
        from matplotlib.colors import LogNorm
        from matplotlib.figure import Figure

        figure = Figure(figsize=(15, 6), dpi=110, layout="constrained")
        axes = figure.subplots(1, 3)
        for place, picture, name in ((axes[0], self.traced, "ray traced"), (axes[1], self.rastered, _FIRST)):
            place.imshow(picture, interpolation="none")
            place.set_title(name)
        low, high = ERROR_LIMITS_ARCMIN
        angle: FloatArray = np.clip(self.error.raster.registration_arcmin, low, None)
        drawn = axes[2].imshow(angle, norm=LogNorm(low, high), cmap="viridis", interpolation="nearest")
        row, column = np.nonzero(self.error.disoccluded)
        axes[2].scatter(column, row, s=0.5, c="red", marker="s", linewidths=0)
        axes[2].set_title("registration error; red: disoccluded")
        figure.colorbar(drawn, ax=axes[2], label="arcmin", extend="both")
        for place in axes:
            place.set_xticks([])
            place.set_yticks([])
        figure.suptitle(title)
        return write_figure(path, figure)


def _error(frame: Frame, traced: Frame, tracer: SceneTracer) -> _Error:
    assert frame.view is not None
    assert frame.position is not None
    assert traced.position is not None
    eye_in_world = transforms.apply(HEAD_POSE, frame.ray_map.viewpoint_in_device)
    hidden = disoccluded(tracer, frame.view.position_in_world, traced.ray_map, HEAD_POSE, traced.position)
    return _Error(raster_error(frame.position, traced.position, eye_in_world), hidden)
