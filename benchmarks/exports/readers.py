"""Other programs that read exports, and a source picture with our own warp for comparison."""

import subprocess
from pathlib import Path

import cv2
import numpy as np
from numpy.typing import NDArray

from wlr_render.draw.sampling import remap
from wlr_render.errors import BadInputError
from wlr_render.exports.export_view import ExportedView
from wlr_render.numerics.arrays import BoolArray, Float32Array, FloatArray

DEBIAN_PYTHON = "/usr/bin/python3"
"""Path of Debian's Python, because python3-mrcal is not installed for the Python that runs the tests."""
_PROJECT = """
import sys, numpy as np, mrcal
file, points, pixels = sys.argv[1:]
model = mrcal.cameramodel(file)
in_camera = mrcal.transform_point_rt(model.extrinsics_rt_fromref(), np.load(points))
np.save(pixels, mrcal.project(in_camera, *model.intrinsics()))
print(*(int(size) for size in model.imagersize()))
"""
_HELD_OUT_COLUMNS, _HELD_OUT_ROWS, _BORDER_PX = 37, 41, 3


def smooth_picture(size_px: tuple[int, int], seed: int = 3) -> Float32Array:
    """Return a picture (height, width, 3) of codes 0 to 255, with details a few pixels wide."""
    width, height = size_px
    noise = np.random.default_rng(seed).uniform(size=(height, width, 3)).astype(np.float32)
    blurred = cv2.GaussianBlur(noise, (0, 0), 2.0)
    return np.ascontiguousarray(255 * (blurred - blurred.min()) / np.ptp(blurred), dtype=np.float32)


def our_warp(picture: Float32Array, view: ExportedView, colour: str = "all") -> tuple[Float32Array, BoolArray]:
    """Warp the panel's picture with our own sampling; also return which pixels have a ray into the source picture."""
    warped, is_inside = remap(picture, view.source_px(colour))
    return warped, is_inside


def warped_by_openimageio(picture: Float32Array, stmap: Path, size_px: tuple[int, int]) -> Float32Array:
    """Warp the panel's picture with OpenImageIO's st_warp, (height, width, 3)."""
    import OpenImageIO as oiio

    source = oiio.ImageBuf(oiio.ImageSpec(picture.shape[1], picture.shape[0], 3, "float"))
    source.set_pixels(oiio.ROI(), picture)
    region = oiio.ROI(0, size_px[0], 0, size_px[1], 0, 1, 0, 3)
    warped = oiio.ImageBufAlgo.st_warp(source, oiio.ImageBuf(str(stmap)), "triangle", 0.0, 0, 1, False, True, region)
    return np.asarray(warped.get_pixels())[..., :3]


def read_by_openimageio(path: Path) -> Float32Array:
    """Return all channels of a picture, (height, width, channels)."""
    import OpenImageIO as oiio

    return np.asarray(oiio.ImageBuf(str(path)).get_pixels())


def drawn_by_ffmpeg(folder: Path, source: NDArray[np.uint8], arguments: list[str], program: str) -> NDArray[np.uint8]:
    """Let ffmpeg draw a picture (height, width, 3) from `source`, with arguments between input and output."""
    cv2.imwrite(str(folder / "source.png"), source[..., ::-1])
    command = [program, "-v", "error", "-y", "-i", "source.png", *arguments, "panel.png"]
    subprocess.run(command, cwd=folder, check=True, timeout=120)
    return np.asarray(cv2.imread(str(folder / "panel.png")))[..., ::-1]


def has_mrcal() -> bool:
    """Return whether Debian's Python has mrcal."""
    try:
        return subprocess.run([DEBIAN_PYTHON, "-c", "import mrcal"], capture_output=True).returncode == 0
    except FileNotFoundError:
        return False


def projected_by_mrcal(model: Path, points: FloatArray, folder: Path) -> tuple[FloatArray, list[int]]:
    """Return mrcal's pixels (n, 2) of points (n, 3) in the device frame, and the size of the picture.

    Raises:
        BadInputError: mrcal refuses the model.
    """
    np.save(folder / "points.npy", points)
    files = [str(model), str(folder / "points.npy"), str(folder / "pixels.npy")]
    run = subprocess.run([DEBIAN_PYTHON, "-c", _PROJECT, *files], capture_output=True, text=True)
    if run.returncode:
        raise BadInputError(f"{model}: mrcal does not read it ({run.stderr[-300:]}).")
    return np.load(folder / "pixels.npy"), [int(word) for word in run.stdout.split()]


def points_of_pixels(view: ExportedView, distance_m: float) -> tuple[NDArray[np.int64], FloatArray]:
    """Return mrcal's pixels (n, 2) all over the panel, off the nodes of any fit, and their device points (n, 3)."""
    across, down = (
        np.arange(_BORDER_PX, size - _BORDER_PX, size // count)
        for size, count in zip(view.panel_size_px, (_HELD_OUT_COLUMNS, _HELD_OUT_ROWS), strict=True)
    )
    pixel = np.stack(np.meshgrid(across, down), axis=-1).reshape(-1, 2)
    rays = view.rays_at(view.middle_colour, pixel.astype(np.float64) + 0.5)
    in_camera = np.concatenate([rays[:, :2] * distance_m + rays[:, 2:], np.full((len(rays), 1), -distance_m)], axis=-1)
    known = np.isfinite(in_camera).all(axis=-1)
    in_device = in_camera @ view.source.device_from_camera.T + view.source.position_in_device
    return pixel[known], in_device[known]
