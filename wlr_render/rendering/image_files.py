"""Pictures, float maps and videos on disk. Every file is written atomically.

OpenCV stores colours as BGR; this is the only module that turns them round.
"""

from collections.abc import Iterable
from pathlib import Path

import cv2
import numpy as np
from numpy.typing import NDArray

from wlr_render.errors import BadInputError
from wlr_render.files import write_image, written_whole


def write_png(path: str | Path, image: NDArray[np.uint8]) -> Path:
    """Write (height, width, 3) RGB or (height, width) grey uint8."""
    return write_image(path, _reversed_channels(image))


def read_png(path: str | Path) -> NDArray[np.uint8]:
    """Read an 8-bit picture as (height, width, 3) RGB.

    Raises:
        BadInputError: the file is missing or not a picture.
    """
    image = cv2.imread(str(path), cv2.IMREAD_COLOR)
    if image is None:
        raise BadInputError(f"{path}: cannot be read as a picture.")
    return np.ascontiguousarray(image[..., ::-1], dtype=np.uint8)


def write_map(path: str | Path, values: NDArray[np.float32]) -> Path:
    """Write a float32 map (height, width, 3) exactly, as .tiff or .pfm by its suffix; NaN stays NaN.

    Channel order in the file is that of the array: red is channel 0.
    """
    if Path(path).suffix not in (".tiff", ".tif", ".pfm"):
        raise BadInputError(f"{path}: a float map is written as .tiff or .pfm.")
    return write_image(path, _reversed_channels(values.astype(np.float32)))


def read_map(path: str | Path) -> NDArray[np.float32]:
    """Read what `write_map` wrote, (height, width, 3) float32."""
    values = cv2.imread(str(path), cv2.IMREAD_UNCHANGED)
    if values is None or values.dtype != np.float32:
        raise BadInputError(f"{path}: cannot be read as a float map (.tiff or .pfm).")
    return np.ascontiguousarray(values[..., ::-1], dtype=np.float32)


def write_video(path: str | Path, frames: Iterable[NDArray[np.uint8]], frames_per_second: float) -> Path:
    """Write RGB frames of one size as an .mp4 in VP9, which browsers play.

    The frames are counted in the closed file, since OpenCV hides write errors.

    Raises:
        BadInputError: this OpenCV has no encoder for it, there are no frames, or the file lacks some of them.
    """
    with written_whole(path) as temporary:
        writer, count = None, 0
        for frame in frames:
            if writer is None:
                size = (frame.shape[1], frame.shape[0])
                writer = cv2.VideoWriter(str(temporary), cv2.VideoWriter.fourcc(*"vp09"), frames_per_second, size)
                if not writer.isOpened():
                    raise BadInputError(f"{path}: this OpenCV cannot encode video; the PNG frames are complete.")
            writer.write(_reversed_channels(frame))
            count += 1
        if writer is None:
            raise BadInputError(f"{path}: there are no frames to make a video of.")
        writer.release()
        readable = _frame_count(temporary)
        if readable != count:
            raise BadInputError(
                f"{path}: only {readable} of {count} frames could be written; free space on this disk or choose "
                "another folder. The PNG frames are complete."
            )
    return Path(path)


def _frame_count(path: Path) -> int:
    """Frames that can be decoded from a video; 0 if it cannot be opened."""
    video, count = cv2.VideoCapture(str(path)), 0
    while video.grab():
        count += 1
    video.release()
    return count


def _reversed_channels(image: NDArray[np.generic]) -> NDArray[np.generic]:
    return np.ascontiguousarray(image[..., ::-1]) if image.ndim == 3 else image
