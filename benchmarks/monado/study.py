"""Monado's compositor as a reader of `export --format monado`: its window against our own map."""

import os
import shutil
import subprocess
from dataclasses import KW_ONLY, dataclass
from pathlib import Path
from typing import Annotated

import numpy as np

from benchmarks.monado.comparison import PositionErrors, position_errors
from wlr_render.errors import BadInputError
from wlr_render.exports.monado import Monado
from wlr_render.io.atomic_files import output_folder
from wlr_render.jobs import limits
from wlr_render.jobs.export import views_from_centres
from wlr_render.jobs.export_options import ExportOptions
from wlr_render.jobs.options import Options, ProgressArgument, described
from wlr_render.numerics.arrays import FloatArray
from wlr_render.report.blocks import Cell, Report, ReportTable
from wlr_render.report.save import save_report
from wlr_render.work.progress import SILENT

GOAL_CODES = 0.4
_HERE = Path(__file__).parent
_INSIDE = Path("opt/session")
"""Folder of our files in the Debian system, from its root."""


@dataclass(frozen=True)
class MonadoOptions(Options):
    """Options of `monado`."""

    debian: Annotated[
        Path, described("Folder of a Debian 13 with Monado; made first if it is not there (ten minutes, 2.5 GB).")
    ]
    model: Annotated[str, described("A device or a model file of both eyes.")] = "northstar"
    _: KW_ONLY
    depth_m: Annotated[
        float | None, described("Depth in metres for which the distortion is made (default: infinity)."), limits.DEPTH_M
    ] = None
    out: Annotated[Path, described("Output folder.")] = Path("out/benchmarks/monado")


def run(options: MonadoOptions, *, progress: ProgressArgument = SILENT) -> Report:
    """Run Monado with an export; write monado.html, .md and .json into `options.out`.

    Raises:
        BadInputError: a user who is not root, a step that fails, or an error of `export`.
    """
    if os.geteuid() or shutil.which("debootstrap") is None:
        raise BadInputError("monado: runs as root, on a Debian that has debootstrap: apt-get install debootstrap")
    folder = output_folder(options.out)
    views = views_from_centres(ExportOptions(options.model, format="monado", eye="both", depth_m=options.depth_m))
    if not any(options.debian.glob("opt/monado/*/build/src/xrt/targets/service/monado-service")):
        progress.say(f"making a Debian 13 with Monado in {options.debian}")
        _completed([str(_HERE / "prepare.sh"), str(options.debian)])
    inside = options.debian / _INSIDE
    inside.mkdir(exist_ok=True)
    shutil.copy(_HERE / "session.py", inside)
    (configuration,) = Monado().write(views.values(), inside)
    progress.say("Monado shows the pictures")
    files = (str(Path("/", _INSIDE, name)) for name in ("session.py", configuration.name, "result.npz"))
    _completed([str(_HERE / "enter.sh"), str(options.debian), "python3", *files])
    with np.load(inside / "result.npz") as result:
        screen, fov, poses = (result[name] for name in ("screen", "fov", "poses"))
    by_eye = dict(zip(("left", "right"), fov, strict=True))
    errors = [each for eye, view in views.items() for each in position_errors(screen, by_eye[eye], view)]
    title = f"Monado's window against our map of {next(iter(views.values())).origin.name}"
    return save_report(Report(title, _verdict(errors), blocks=[_table(errors), _eyes(fov, poses)]), folder, "monado")


def _completed(command: list[str]) -> None:
    """Run a command to its end.

    Raises:
        BadInputError: the command failed; the message has its last lines of output.
    """
    done = subprocess.run(command, stdout=subprocess.PIPE, stderr=subprocess.STDOUT, text=True)
    if done.returncode:
        last = "\n".join(done.stdout.splitlines()[-20:])
        raise BadInputError(f"{command[0]}: ended with status {done.returncode}; correct what it names:\n{last}")


def _verdict(errors: list[PositionErrors]) -> str:
    worst = max(each.rms for each in errors)
    return (
        f"Positions in Monado's window differ from ours by {worst:.2f} codes of 255 rms at most (goal: "
        f"{GOAL_CODES:g}); rounding to whole codes alone is 0.29."
    )


def _table(errors: list[PositionErrors]) -> ReportTable:
    columns = (
        "eye",
        "axis",
        "window (px)",
        "rms",
        "mean",
        "max",
        "max of block means",
        "without colours",
        "rms, rows reversed",
    )
    rows: list[list[Cell]] = [
        [
            each.eye,
            each.axis,
            "{} x {}".format(*each.window_px),
            each.rms,
            each.mean,
            each.largest,
            each.largest_block_mean,
            each.same_without_colours,
            each.reversed_rms,
        ]
        for each in errors
    ]
    notes = (
        "A client submits pictures whose red is the position from the left border, and green from the top border, in "
        "255 codes. Expected are the positions of the exact rays of the panel, at the centres of the window's pixels.",
        "Blocks have 40 x 40 pixels: rounding averages out, and the means are errors of map and colours.",
        "Without colours: after the mean error of each code is subtracted. The software renderer's conversion between "
        "sRGB and linear light errs by the code alone; what is left is the map's.",
        "With its rows reversed the window is wrong; the last column shows that the comparison notices it.",
    )
    return ReportTable("Errors in codes", columns, rows, notes)


def _eyes(fov: FloatArray, poses: FloatArray) -> ReportTable:
    columns = ("eye", "x (mm)", "y (mm)", "z (mm)", "left (deg)", "right (deg)", "up (deg)", "down (deg)")
    rows: list[list[Cell]] = [
        [eye, *(1e3 * pose[:3]).tolist(), *np.rad2deg(borders).tolist()]
        for eye, pose, borders in zip(("left", "right"), poses, fov, strict=True)
    ]
    return ReportTable("Eyes as the OpenXR client sees them, in the space of the head", columns, rows)
