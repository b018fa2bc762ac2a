"""Read Gray-code photographs of a projector: github.com/kamino410/procam-calibration (MIT), folder `sample_data`.

One capture is a folder of 42 photographs `graycode_00.png` to `graycode_41.png`, in the order of the project's
`gen_graycode_imgs.py`: OpenCV's `GrayCodePattern` (bits of u from coarse to fine, each followed by its inverse, then
bits of v), white, black. The stripe width is 1, as in its README; in the photographs decoded v ends sharply at 767. The
folder of the captures also has `calibration_result.xml` with camera and projector. `camera_config.json` is not read: it
is an example for another camera (1280 x 960).
"""

from dataclasses import dataclass
from pathlib import Path

import cv2
import numpy as np

from wlr_render.captures.camera_lens_file import check_nesting, require_plausible_lens
from wlr_render.captures.photographs import photographs_in
from wlr_render.errors import BadInputError
from wlr_render.io.input_files import as_bad_input, read_text
from wlr_render.lenses.lens_camera import DISTORTION_TERMS, OPENCV_PIXEL_SHIFT, LensCamera
from wlr_render.mappings import Panel
from wlr_render.numerics.arrays import FloatArray

PANEL = Panel(1024, 768)
"""The projector of the sample data."""

_COUNT = 42
_WHITE_AND_BLACK = (40, 41)
_CALIBRATION = "calibration_result.xml"
_SIZES = {
    "img_shape": 2,
    "cam_int": 9,
    "cam_dist": 5,
    "proj_int": 9,
    "proj_dist": 5,
}  # count of numbers of each key that is read


@dataclass(frozen=True, eq=False)
class ProcamCapture:
    """Photographs of one scene, lit by a projector.

    Attributes:
        photographs: 42 paths in the order in which our Gray code is shown: white, black, bits of u, bits of v.
        panel: panel of the projector.
        camera: camera that took the photographs.
        projector: the projector as a camera with the panel as its image.
    """

    photographs: tuple[Path, ...]
    panel: Panel
    camera: LensCamera
    projector: LensCamera


def read_procam_graycode(folder: str | Path) -> ProcamCapture:
    """Read a capture, or a set that holds a single capture. Photographs are only listed.

    Raises:
        BadInputError: a photograph or the calibration is missing, or there are extra photographs or several captures.
    """
    capture = _capture_of(Path(folder))
    listed = photographs_in(capture)
    found = {path.stem: path for path in listed}
    names = [f"graycode_{number:02d}" for number in range(_COUNT)]
    missing = [name for name in names if name not in found]
    if missing:
        raise BadInputError(
            f"{capture}: {missing[0]} is missing ({len(missing)} of {_COUNT} photographs are); copy the capture again."
        )
    extra = [path for path in listed if path.stem not in names or found[path.stem] is not path]
    if extra:
        raise BadInputError(
            f"{extra[0]}: is none of the {_COUNT} photographs of a capture, {names[0]} to {names[-1]}, or one of them "
            "twice; move it away."
        )
    bits = [number for number in range(_COUNT) if number not in _WHITE_AND_BLACK]
    camera, projector = _read_calibration(capture.parent / _CALIBRATION)
    return ProcamCapture(tuple(found[names[number]] for number in (*_WHITE_AND_BLACK, *bits)), PANEL, camera, projector)


def _capture_of(folder: Path) -> Path:
    captures = sorted(path for path in folder.glob("capture_*") if path.is_dir())
    if len(captures) > 1:
        raise BadInputError(f"{folder}: holds {len(captures)} captures; name one of them, such as {captures[0]}.")
    return captures[0] if captures else folder


def _read_calibration(file: Path) -> tuple[LensCamera, LensCamera]:
    """Read camera and projector."""
    text = read_text(file, "a calibration", remedy="copy it from the set, next to its captures")
    check_nesting(file, text)
    with as_bad_input(file, "a calibration", "copy it from the set again"):
        storage = cv2.FileStorage(text, cv2.FILE_STORAGE_READ | cv2.FILE_STORAGE_MEMORY)
        found = {key: np.asarray(storage.getNode(key).mat(), dtype=np.float64).ravel() for key in _SIZES}
    for key, values in found.items():
        if values.shape != (_SIZES[key],) or not np.isfinite(values).all():
            raise BadInputError(f"{file}: '{key}' must be {_SIZES[key]} finite numbers; copy it from the set again.")
    height, width = found["img_shape"]
    camera = _lens_camera((int(width), int(height)), found["cam_int"], found["cam_dist"])
    projector = _lens_camera((PANEL.width_px, PANEL.height_px), found["proj_int"], found["proj_dist"])
    for lens in (camera, projector):
        require_plausible_lens(str(file), lens)
    return camera, projector


def _lens_camera(size_px: tuple[int, int], matrix: FloatArray, distortion: FloatArray) -> LensCamera:
    """Convert OpenCV's matrix (9,) and coefficients (5,)."""
    (fx, _, cx), (_, fy, cy), _ = matrix.reshape(3, 3)
    centre = np.array([cx, cy]) - OPENCV_PIXEL_SHIFT
    return LensCamera(size_px, np.array([fx, fy]), centre, distortion.reshape(len(DISTORTION_TERMS)))
