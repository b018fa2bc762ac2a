"""Read and write the cameras in session.toml (docs/photo-session.md has the format)."""

from pathlib import Path
from typing import Any

import numpy as np

from wlr_render.captures.camera_lens_file import KIND_OF_COUNT, lens_of_opencv, load_lens, require_plausible_lens
from wlr_render.captures.photo_session import SessionCamera
from wlr_render.captures.photograph_format import PhotographFormat
from wlr_render.captures.photographs import photographs_in
from wlr_render.geometry.lens_camera import LENS_KINDS, OPENCV_PIXEL_SHIFT, LensCamera
from wlr_render.io.input_files import require_pixels
from wlr_render.io.toml_files import Table, stated
from wlr_render.numerics.arrays import FloatArray

_MOST_SIGMA = 1e6  # largest sigma: it says that nothing is known
_SOURCES = ("intrinsics", "focal_px", "lens_file")


def read_camera(table: Table, folder: Path) -> SessionCamera:
    """Read the keys of a camera; other keys of its table are left to the caller.

    Args:
        table: [eyeball_camera] or [tracking_camera].
        folder: folder of the session.

    Raises:
        BadInputError: a key is missing, faulty or contradicts another; the sentence names it.
    """
    size, form = (table.whole("width_px", 1), table.whole("height_px", 1)), PhotographFormat.from_table(table, folder)
    require_pixels(table.where, size, "correct 'width_px' and 'height_px'")
    lens = table.text("lens", "auto", ("auto", *LENS_KINDS))
    if sum(table.has(key) for key in _SOURCES) != 1:
        raise table.fail(
            "give either 'intrinsics', a folder of pictures of the board, or 'focal_px' and 'opencv_centre_px', or "
            "'lens_file', a calibration by another program."
        )
    if table.has("intrinsics"):
        return SessionCamera(size, form, tuple(photographs_in(table.path("intrinsics", folder))), lens=lens)
    if table.has("lens_file"):
        file = table.path("lens_file", folder)
        calibrated = load_lens(file)
        if table.has("lens"):
            raise table.fail("'lens' is given as well as 'lens_file', which states the kind of lens; remove 'lens'.")
        if calibrated.size_px != size:
            raise table.fail(
                f"its pictures have {_by(size)} pixels, but the lens in {file} was calibrated for "
                f"{_by(calibrated.size_px)}; give a lens of this size."
            )
    else:
        file, calibrated = None, _stated_camera(table, size, lens)
    return SessionCamera(
        size, form, calibrated=calibrated, calibrated_sigma=_sigma(table, len(calibrated.values)), lens_file=file
    )


def _by(size: tuple[int, int]) -> str:
    return f"{size[0]} x {size[1]}"


def _stated_camera(table: Table, size: tuple[int, int], lens: str) -> LensCamera:
    """Return the camera that a table states; the number of distortion terms tells the kind of an "auto" lens."""
    core = np.concatenate([table.vector("focal_px", 2, above=0), table.vector("opencv_centre_px", 2)])
    terms = table.numbers("distortion") if table.has("distortion") else np.zeros(0)
    if lens == "auto":
        if len(terms) == 4:
            raise table.fail('\'distortion\' has 4 terms; state their kind by lens = "brown" or lens = "fisheye".')
        lens = KIND_OF_COUNT.get(len(terms), "brown")
    wanted = len(LENS_KINDS[lens])
    if len(terms) not in {0, 4, wanted}:
        raise table.fail(
            f"'distortion' has {len(terms)} terms, but a lens of kind '{lens}' has {wanted}: "
            f"{', '.join(LENS_KINDS[lens])}."
        )
    camera = lens_of_opencv(size, core, terms, lens)
    require_plausible_lens(table.where, camera)
    return camera


def _sigma(table: Table, count: int) -> FloatArray | None:
    """Return the standard deviations (count,) of fx, fy, cx, cy and the distortion; None if not stated."""
    several = [key for key in ("focal_sigma_px", "centre_sigma_px") if table.has(key)]
    if table.has("sigma") and several:
        raise table.fail(f"give either 'sigma' or '{several[0]}', not both.")
    if table.has("sigma"):
        sigma = table.vector("sigma", count, least=0, most=_MOST_SIGMA)
    elif several:
        focal, centre = (table.number(f"{name}_sigma_px", least=0, most=_MOST_SIGMA) for name in ("focal", "centre"))
        sigma = np.array([focal, focal, centre, centre, *[0.0] * (count - 4)])
    else:
        return None
    if not np.any(sigma):
        raise table.fail("one standard deviation must be above 0; leave them out for an exact lens.")
    return sigma


def written_camera(camera: SessionCamera, folder: Path) -> dict[str, Any]:
    """Return the keys of a camera that `read_camera` reads back."""
    keys = {"width_px": camera.size_px[0], "height_px": camera.size_px[1]} | camera.format.keys()
    keys |= stated(sigma=None if camera.calibrated_sigma is None else camera.calibrated_sigma.tolist())
    if camera.lens_file is not None:
        return keys | {"lens_file": str(camera.lens_file.relative_to(folder))}
    lens = camera.calibrated
    if lens is None:
        pictures = str(camera.intrinsics[0].parent.relative_to(folder))
        return keys | stated(lens=None if camera.lens == "auto" else camera.lens, intrinsics=pictures)
    if not isinstance(lens, LensCamera):
        raise TypeError(f"a {type(lens).__name__} is written as its 'lens_file' only")
    return keys | stated(
        lens=None if lens.kind == "brown" else lens.kind,
        focal_px=lens.focal_px.tolist(),
        opencv_centre_px=(lens.centre_px + OPENCV_PIXEL_SHIFT).tolist(),
        distortion=lens.distortion.tolist(),
    )
