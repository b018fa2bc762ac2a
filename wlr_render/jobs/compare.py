"""The error that rasterisation brings: the same frame rastered and ray traced, compared pixel by pixel."""

from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from wlr_render.evaluation.disocclusion import disoccluded
from wlr_render.evaluation.metrics import summary
from wlr_render.evaluation.raster_error import RasterError, raster_error
from wlr_render.files import output_folder, write_figure, write_text
from wlr_render.geometry import transforms
from wlr_render.jobs.headset import open_eye, require_in_eye_box
from wlr_render.numerics.arrays import FloatArray
from wlr_render.progress import SILENT, Progress
from wlr_render.rendering.image_files import write_map, write_png
from wlr_render.rendering.painters import Frame, MeshWarpedPainter, Painter, TracedPainter, WarpedPainter
from wlr_render.rendering.raster_backends import open_raster_backend
from wlr_render.rendering.ray_intersections import SceneTracer
from wlr_render.rendering.ray_tracing import RayRenderer
from wlr_render.rendering.scene_file import load_scene
from wlr_render.report.blocks import Cell, ReportTable, tables_as_json

HEAD_POSE = np.eye(4)


@dataclass(frozen=True)
class Options:
    """What to compare.

    Attributes:
        headset: a device or a model file.
        scene: a shipped scene, a scene file or a mesh.
        eye: "left" or "right".
        viewpoint_offset_mm: (x, y, z) from the eye box's centre, device frame.
        backend: who rasterises.
        out: folder.
    """

    headset: str
    scene: str
    eye: str = "right"
    viewpoint_offset_mm: tuple[float, float, float] = (0.0, 0.0, 0.0)
    backend: str = "auto"
    out: Path = Path("out/compare")


@dataclass(frozen=True, eq=False)
class Result:
    """Figures by way of rasterising, and the map of the plain one's error."""

    table: ReportTable
    picture: Path


def run(options: Options, progress: Progress = SILENT) -> Result:
    """Draw both ways and compare; writes both frames, the error map (.tiff), a picture and the table.

    Raises:
        BadInputError: faulty headset or scene, or a viewpoint outside the eye box.
    """
    mappings = open_eye(options.headset, options.eye)
    viewpoint = mappings.eye_box.centre + 1e-3 * np.asarray(options.viewpoint_offset_mm)
    require_in_eye_box(mappings, viewpoint, "--viewpoint-offset-mm")
    scene = load_scene(options.scene)
    raster_backend = open_raster_backend(scene, options.backend)
    renderer = RayRenderer(scene)
    folder = output_folder(options.out)
    traced = TracedPainter(mappings, renderer).paint(viewpoint, HEAD_POSE, with_geometry=True)
    ways: dict[str, Painter] = {
        "raster + warp": WarpedPainter(mappings, raster_backend),
        "raster camera at the viewpoint": WarpedPainter(mappings, raster_backend, at_viewpoint=True),
        "twice the raster resolution": WarpedPainter(mappings, raster_backend, resolution=2.0),
        "map from the mesh": MeshWarpedPainter(mappings, raster_backend, renderer),
    }
    rows: list[list[Cell]] = []
    plain: tuple[Frame, _Compared] | None = None
    for way, painter in progress(iter(ways.items()), len(ways), "ways to rasterise"):
        frame = painter.paint(viewpoint, HEAD_POSE, with_geometry=True)
        compared = _compared(frame, traced, renderer.tracer)
        rows.append(_row(way, compared, frame.colour, traced.colour))
        plain = plain or (frame, compared)
    assert plain is not None
    frame, compared = plain
    write_png(folder / "raster.png", frame.colour)
    write_png(folder / "raytrace.png", traced.colour)
    write_map(folder / "error.tiff", _map_of(compared))
    title = f"Raster against ray tracing: {scene.name} on {mappings.name}, {options.eye} eye"
    table = ReportTable(title, _COLUMNS, rows, _NOTES)
    write_text(folder / "compare.md", table.markdown())
    write_text(folder / "compare.json", tables_as_json([table], viewpoint_in_device_m=viewpoint.tolist()))
    picture = _draw(folder / "compare.png", frame, traced, compared, title)
    return Result(table, picture)


_COLUMNS = (
    "way",
    "median (arcmin)",
    "95 % (arcmin)",
    "max (arcmin)",
    "disoccluded (%)",
    "only in one (%)",
    "colour difference (8 bit)",
)
_NOTES = (
    "Errors are angles at the eye between the world points that the two frames show at a pixel, over pixels that are "
    "not disoccluded. Disoccluded: something hides what the bent ray meets from where the intermediate image is drawn "
    "(found with the scene itself); share of pixels that show anything.",
)


@dataclass(frozen=True, eq=False)
class _Compared:
    """A rasterised frame beside the ray-traced one; masks and angles per display pixel."""

    error: RasterError
    disoccluded: NDArray[np.bool_]


def _compared(frame: Frame, traced: Frame, tracer: SceneTracer) -> _Compared:
    assert frame.view is not None
    assert frame.position is not None
    assert traced.position is not None
    eye_in_world = transforms.apply(HEAD_POSE, frame.field.viewpoint_in_device)
    hidden = disoccluded(tracer, frame.view.viewpoint_in_world, traced.field, HEAD_POSE, traced.position)
    return _Compared(raster_error(frame.position, traced.position, eye_in_world), hidden)


def _row(way: str, compared: _Compared, drawn: NDArray[np.uint8], truth: NDArray[np.uint8]) -> list[Cell]:
    error = compared.error
    s = summary(error.registration_arcmin[~compared.disoccluded])
    shown = max(1, int(np.isfinite(error.registration_arcmin).sum() + error.only_one.sum()))
    difference = float(np.abs(drawn.astype(np.int16) - truth).mean())
    hidden, single = (100.0 * float(mask.sum()) / shown for mask in (compared.disoccluded, error.only_one))
    return [way, s.median, s.p95, s.maximum, hidden, single, difference]


def _map_of(compared: _Compared) -> NDArray[np.float32]:
    """Channels: error in arcmin, 1 where disoccluded, 1 where only one frame shows something."""
    layers = [compared.error.registration_arcmin, compared.disoccluded, compared.error.only_one]
    return np.stack([np.asarray(layer, np.float32) for layer in layers], axis=-1)


def _draw(path: Path, frame: Frame, traced: Frame, compared: _Compared, title: str) -> Path:
    from matplotlib.colors import LogNorm
    from matplotlib.figure import Figure

    figure = Figure(figsize=(15, 6), dpi=110, layout="constrained")
    axes = figure.subplots(1, 3)
    for place, picture, name in ((axes[0], traced.colour, "ray traced"), (axes[1], frame.colour, "raster + warp")):
        place.imshow(picture)
        place.set_title(name)
    angle: FloatArray = np.clip(compared.error.registration_arcmin, 1e-3, None)
    drawn = axes[2].imshow(angle, norm=LogNorm(1e-3, 10.0), cmap="viridis", interpolation="nearest")
    row, column = np.nonzero(compared.disoccluded)
    axes[2].scatter(column, row, s=0.5, c="red", marker="s", linewidths=0)
    axes[2].set_title("registration error; red: disoccluded")
    figure.colorbar(drawn, ax=axes[2], label="arcmin", extend="both")
    for place in axes:
        place.set_xticks([])
        place.set_yticks([])
    figure.suptitle(title)
    return write_figure(path, figure)
