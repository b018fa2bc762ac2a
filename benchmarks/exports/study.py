"""Differences between other programs that read exports and our own maps."""

import shutil
import tempfile
from collections.abc import Iterator
from dataclasses import KW_ONLY, dataclass, replace
from importlib.util import find_spec
from pathlib import Path
from typing import Annotated

import cv2
import numpy as np

from benchmarks.exports.readers import (
    drawn_by_ffmpeg,
    has_mrcal,
    our_warp,
    points_of_pixels,
    projected_by_mrcal,
    read_by_openimageio,
    smooth_picture,
    warped_by_openimageio,
)
from benchmarks.speed.workload import bench_model
from wlr_render.exports.export_view import ExportedView
from wlr_render.exports.mrcal import Mrcal
from wlr_render.exports.pixel_maps import Ffmpeg, FloatMap, StMap
from wlr_render.geometry.directions import arcmin_between, dir_of_tangents
from wlr_render.io.atomic_files import output_folder, write_text
from wlr_render.jobs.export import views_from_centres
from wlr_render.jobs.export_options import ExportOptions
from wlr_render.jobs.options import Options, ProgressArgument, described
from wlr_render.mappings import Eye
from wlr_render.numerics.arrays import FloatArray
from wlr_render.report.blocks import Cell, Report, ReportTable
from wlr_render.report.save import markdown, save_report
from wlr_render.warp.raster_camera import ray_map_plans
from wlr_render.work.progress import SILENT

_FAR_M = 1e4
_JUDGED_PIXELS = 3000
_TERMS = {5: 0, 8: cv2.CALIB_RATIONAL_MODEL, 12: cv2.CALIB_RATIONAL_MODEL | cv2.CALIB_THIN_PRISM_MODEL}
"""OpenCV's camera models, by number of distortion terms."""


@dataclass(frozen=True)
class ExportsOptions(Options):
    """Options of `exports`."""

    _: KW_ONLY
    devices: Annotated[tuple[str, ...], described("Devices, one or more.", many=True)] = (
        "northstar",
        "freeform40",
        "birdbath28",
    )
    record: Annotated[Path | None, described("Folder in which exports.md is kept, too.")] = None
    out: Annotated[Path, described("Output folder.")] = Path("out/benchmarks/exports")


def run(options: ExportsOptions = ExportsOptions(), *, progress: ProgressArgument = SILENT) -> Report:
    """Let each installed program read exports of each device; write exports.html, .md and .json."""
    rows: list[list[Cell]] = []
    with tempfile.TemporaryDirectory() as folder:
        for device in options.devices:
            view = views_from_centres(ExportOptions(device, format="stmap"))["right"]
            progress.say(f"exports of {device}")
            rows += [[device, *row] for row in _rows(view, Path(folder))]
            fitted = bench_model(device=device)
            of_model = replace(view, channels=(fitted,), plans=ray_map_plans((fitted,), view.source.device_from_camera))
            rows += [[device, *row] for row in _seen(of_model, view.channels[0], Path(folder), "of a fitted model")]
    table = ReportTable("Differences", ["headset", "reader", "what", "unit", "rms", "largest"], rows, _NOTES)
    absent = [name for name, is_there in _readers().items() if not is_there]
    verdict = f"Not installed: {', '.join(absent)}." if absent else "Every reader is installed."
    report = Report("Exports in other programs", verdict, blocks=[table])
    if options.record is not None:
        write_text(options.record / "exports.md", markdown(report, options.record))
    return save_report(report, output_folder(options.out), "exports")


_NOTES = [
    "Pictures: a random picture with detail of some pixels, against our own bilinear sampling (ffmpeg: the nearest "
    "pixel), inside the picture. Directions: where OpenImageIO's reading of the file puts points at infinity, against "
    "where the exact optics show the pixel. Maps of a fitted model: as `calibrate` fits simulated captures with noise. "
    "Camera models: at pixels that were not fitted (mrcal), or that were (OpenCV)."
]


def _readers() -> dict[str, bool]:
    return {
        "OpenImageIO": find_spec("OpenImageIO") is not None,
        "ffmpeg": shutil.which("ffmpeg") is not None,
        "mrcal": has_mrcal(),
    }


def _rows(view: ExportedView, folder: Path) -> Iterator[list[Cell]]:
    """Yield name, quantity, unit, rms and largest difference of each installed reader."""
    there, picture = _readers(), smooth_picture(view.source.camera.size_px)
    ours, inside = our_warp(picture, view)
    if there["OpenImageIO"]:
        (stmap,) = StMap().write([view], folder)
        warped = warped_by_openimageio(picture, stmap, view.panel_size_px)
        yield ["OpenImageIO st_warp", "stmap", "codes of 255", *_summary((warped - ours)[inside].astype(np.float64))]
        yield from _seen(view, view.channels[0], folder, "")
    path, _ = FloatMap("pfm").write([view], folder)
    positions = np.nan_to_num(np.asarray(cv2.imread(str(path), cv2.IMREAD_UNCHANGED)))
    warped = cv2.remap(picture, positions[..., 2] - 0.5, positions[..., 1] - 0.5, cv2.INTER_LINEAR)
    yield ["OpenCV remap", "pfm", "codes of 255", *_summary((warped - ours)[inside].astype(np.float64))]
    if there["ffmpeg"]:
        list(Ffmpeg().write([view], folder))
        codes, program = picture.astype(np.uint8), shutil.which("ffmpeg")
        assert program is not None
        pair = ["-i", "right-x.pgm", "-i", "right-y.pgm", "-lavfi", "remap=fill=black"]
        column, row = np.moveaxis(np.floor(np.nan_to_num(view.source_px("all"))).astype(int), -1, 0)
        difference = drawn_by_ffmpeg(folder, codes, pair, program).astype(np.float64) - codes[row, column]
        yield ["ffmpeg remap", "ffmpeg", "codes of 255", *_summary(difference[inside])]
    if there["mrcal"]:
        (model,) = Mrcal().write([view], folder)
        pixel, points = points_of_pixels(view, _FAR_M)
        found, _ = projected_by_mrcal(model, points, folder)
        yield ["mrcal project", "mrcal", "px", *_summary(np.linalg.norm(found - pixel, axis=-1))]
    for terms, flags in _TERMS.items():
        yield [
            f"OpenCV, {terms} terms",
            "no export: the best such camera",
            "px",
            *_summary(_opencv_errors(view, flags)),
        ]


def _seen(view: ExportedView, truth: Eye, folder: Path, words: str) -> Iterator[list[Cell]]:
    """Yield errors of points at the positions that a reader of the file finds, seen through the exact optics."""
    if find_spec("OpenImageIO") is None:
        return
    (path,) = StMap().write([view], folder)
    s, t, _ = np.moveaxis(read_by_openimageio(path).astype(float), -1, 0)
    camera, rng = view.source.camera, np.random.default_rng(1)
    row, column = (rng.integers(0, size, _JUDGED_PIXELS) for size in s.shape)
    position = np.stack([s[row, column], 1 - t[row, column]], axis=-1) * camera.size_px
    direction = dir_of_tangents(camera.tangents_of_pixel(position)) @ view.source.device_from_camera.T
    point = view.source.position_in_device + _FAR_M * direction
    real = truth.see_through.view_dir_of_real_point(point, view.viewpoint).value
    shown = truth.display.view_dir_of_pixel(
        0.5 + np.stack([column, row], axis=-1).astype(np.float64), view.viewpoint
    ).value
    errors = arcmin_between(real, shown)
    what = f"stmap {words}, through the exact optics" if words else "stmap, through the exact optics"
    yield ["OpenImageIO", what, "arcmin", *_summary(errors[np.isfinite(errors)])]


def _opencv_errors(view: ExportedView, flags: int) -> FloatArray:
    """Return errors (n,) in pixels of an OpenCV camera that is fitted to the pixels' directions."""
    pixel, points = points_of_pixels(view, _FAR_M)
    in_camera = (points - view.source.position_in_device) @ view.source.device_from_camera
    tangents = in_camera[:, :2] / -in_camera[:, 2:] * [1, -1]
    plane = np.concatenate([tangents, np.zeros((len(tangents), 1))], axis=-1).astype(np.float32)
    seen, size = pixel.astype(np.float32)[:, None], view.panel_size_px
    start = np.array([[size[0], 0, size[0] / 2], [0, size[1], size[1] / 2], [0, 0, 1.0]])
    guess = flags | cv2.CALIB_USE_INTRINSIC_GUESS
    _, matrix, terms, turn, shift = cv2.calibrateCamera([plane], [seen], size, start, None, flags=guess)
    found, _ = cv2.projectPoints(plane, turn[0], shift[0], matrix, terms)
    return np.asarray(np.linalg.norm(found[:, 0] - seen[:, 0], axis=-1), dtype=np.float64)


def _summary(values: FloatArray) -> tuple[float, float]:
    """Return rms and largest magnitude."""
    return float(np.sqrt(np.mean(np.square(values, dtype=np.float64)))), float(np.abs(values).max())
