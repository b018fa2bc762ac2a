"""The warp maps of one eye in the files of another program."""

import math
from pathlib import Path

from wlr_render.errors import BadInputError
from wlr_render.exports.export_view import Origin, view_from_centre, with_symmetric_camera
from wlr_render.exports.formats import FORMATS, FormatName, format_of
from wlr_render.io.atomic_files import output_folder
from wlr_render.mappings import Eye
from wlr_render.numerics.arrays import FloatArray
from wlr_render.scene.exr_file import require_exr
from wlr_render.warp.ray_map import checked_viewpoint


def export(
    eye: Eye,
    folder: str | Path,
    format: FormatName = "stmap",
    viewpoint: FloatArray | None = None,
    depth_m: float = math.inf,
) -> list[Path]:
    """Write the warp maps of one eye, for one pupil position, as files that another program reads.

    The command `wlr-render export` also writes maps along an eye trajectory, in three colours and for both eyes, with a
    page that states the errors of each format.

    Args:
        eye: an eye of a headset, from `open_eye` or `calibrate`.
        folder: output folder; created if missing.
        format: "stmap", "rays", "pfm", "tiff", "ffmpeg", "npz", "mesh", "mrcal", "c" or "page"; docs/exports.md
            describes them.
        viewpoint: (3,) centre of the entrance pupil in the device frame, metres; the centre of the eye box by default.
        depth_m: depth from the source camera at which the maps are correct; infinite by default. The files of "rays"
            serve every depth.

    Returns:
        The files, named after the eye.

    Raises:
        BadInputError: an unknown format, or one that needs both eyes ("monado", "steamvr"); a viewpoint that is not
            three finite numbers; or a folder that cannot be written.
        MissingExtraError: a library that the format needs is not installed.

    Example:
        >>> import wlr_render as wlr
        >>> wlr.export(wlr.open_eye("northstar"), "maps", "rays")
    """
    if format not in [form.name for form in FORMATS if not form.holds.both_eyes]:
        names = ", ".join(form.name for form in FORMATS if not form.holds.both_eyes)
        raise BadInputError(f"format is '{format}'; choose from {names}, or use wlr-render export for both eyes.")
    form = format_of(format)
    if form.holds.is_exr:
        require_exr(f"The format {form.name}")
    origin = Origin(eye.name, {}, {})
    view = view_from_centre((eye,), origin, is_turned=form.holds.asymmetric_field, depth_m=depth_m)
    if not form.holds.asymmetric_field:
        view = with_symmetric_camera({eye.eye: view})[eye.eye]
    if viewpoint is not None:
        view = view.moved_to(checked_viewpoint(viewpoint), eye.eye, None)
    return list(form.write([view], output_folder(folder)))
