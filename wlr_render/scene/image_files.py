"""Pictures, float maps and videos on disk. Every file is written atomically.

OpenCV stores colours as BGR; this is the only module that converts them.
"""

import contextlib
from collections.abc import Iterable
from pathlib import Path
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from wlr_render.errors import BadInputError
from wlr_render.io.atomic_files import write_image, written_whole
from wlr_render.io.input_files import read_image

_FASTEST_FPS = 1000


def write_png(path: str | Path, image: NDArray[np.uint8]) -> Path:
    """Write (height, width, 3) RGB or (height, width) grey uint8.

    Raises:
        BadInputError: an array of another type or shape, or a file that cannot be written.
    """
    _require_image(path, image, np.uint8, (2, 3))
    return write_image(path, _reversed_channels(image))


def read_png(path: str | Path) -> NDArray[np.uint8]:
    """Read an 8-bit picture as (height, width, 3) RGB.

    Raises:
        BadInputError: the file is missing or not a picture.
    """
    image = read_image(path, cv2.IMREAD_COLOR)
    return np.asarray(_reversed_channels(image), np.uint8)


def write_map(path: str | Path, values: NDArray[np.float32]) -> Path:
    """Write a float32 map (height, width, 3) exactly, as .tiff or .pfm by its suffix; NaN stays NaN.

    The file has the array's channel order: red is channel 0.

    Raises:
        BadInputError: an array of another type or shape, another suffix, or a file that cannot be written.
    """
    _require_image(path, values, np.floating, (3,))
    if Path(path).suffix not in (".tiff", ".tif", ".pfm"):
        raise BadInputError(f"{path}: a float map is written as .tiff or .pfm.")
    return write_image(path, _reversed_channels(values.astype(np.float32)))


def read_map(path: str | Path) -> NDArray[np.float32]:
    """Read a map that `write_map` wrote, (height, width, 3) float32.

    Raises:
        BadInputError: the file is missing, or is not a picture of three floats per pixel.
    """
    values = read_image(path, cv2.IMREAD_UNCHANGED, "name a float map (.tiff or .pfm)")
    if values.dtype != np.float32 or values.shape[2:] != (3,):
        raise BadInputError(f"{path}: is not a float map of three channels; name what `render` wrote (.tiff or .pfm).")
    return np.asarray(_reversed_channels(values), np.float32)


def write_video(path: str | Path, frames: Iterable[NDArray[np.uint8]], frames_per_second: float) -> Path:
    """Write RGB frames of one size as an .mp4 in VP9, which browsers play.

    The frames are counted in the closed file, since OpenCV hides write errors.

    Raises:
        BadInputError: this OpenCV has no VP9 encoder, `frames` is empty, a frame has another size or type, a
            rate is not above 0 and at most 1000, or the file lacks some frames.
    """
    if not 0 < frames_per_second <= _FASTEST_FPS:
        raise BadInputError(
            f"{path}: a video of {frames_per_second:g} frames per second cannot be written; give a rate above 0 and at "
            f"most {_FASTEST_FPS}."
        )
    with written_whole(path) as temporary:
        with contextlib.ExitStack() as opened:
            writer, count, size = None, 0, (0, 0)
            for frame in frames:
                _require_image(path, frame, np.uint8, (3,))
                if writer is None:
                    size = (frame.shape[1], frame.shape[0])
                    writer = cv2.VideoWriter(str(temporary), cv2.VideoWriter.fourcc(*"vp09"), frames_per_second, size)
                    opened.callback(writer.release)
                    if not writer.isOpened():
                        why = "VP9 needs 2 or more each way" if min(size) < 2 else "this OpenCV has no encoder for it"
                        raise BadInputError(
                            f"{path}: a video of {size[0]} x {size[1]} pixels cannot be encoded, for {why}; the PNG "
                            "frames are complete."
                        )
                if (frame.shape[1], frame.shape[0]) != size:
                    raise BadInputError(
                        f"{path}: frame {count} has another size than the first; give frames of one size."
                    )
                writer.write(_reversed_channels(frame))
                count += 1
        if writer is None:
            raise BadInputError(f"{path}: there are no frames to make a video of.")
        readable = _frame_count(temporary)
        if readable != count:
            raise BadInputError(
                f"{path}: only {readable} of {count} frames could be written; free space on this disk or choose "
                "another folder. The PNG frames are complete."
            )
    return Path(path)


def _require_image(path: str | Path, image: Any, kind: type[np.generic], axes: tuple[int, ...]) -> None:
    """Refuse an image that OpenCV would convert silently, or crash on."""
    shape = np.shape(image)
    is_picture = isinstance(image, np.ndarray) and np.issubdtype(image.dtype, kind) and image.size > 0
    if not is_picture or len(shape) not in axes or shape[2:] not in ((), (3,)):
        found = getattr(image, "dtype", type(image).__name__)
        raise BadInputError(
            f"{path}: a picture of {found} {shape} cannot be written; give {kind.__name__} (height, width, 3)."
        )


def _frame_count(path: Path) -> int:
    """Count the frames that can be decoded from a video; 0 if it cannot be opened."""
    video, count = cv2.VideoCapture(str(path)), 0
    while video.grab():
        count += 1
    video.release()
    return count


def _reversed_channels(image: NDArray[np.generic]) -> NDArray[np.generic]:
    """Return a copy with red and blue exchanged; on bytes, OpenCV is 50 times as fast as copying a NumPy view."""
    return np.asarray(cv2.cvtColor(image, cv2.COLOR_RGB2BGR)) if image.ndim == 3 else image
