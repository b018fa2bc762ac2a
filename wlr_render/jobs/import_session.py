"""Convert third-party data sets into bench sessions or capture files: one function for each format."""

from collections.abc import Callable
from dataclasses import KW_ONLY, dataclass, replace
from pathlib import Path
from typing import Annotated, Literal

import numpy as np

from wlr_render.atomic_files import output_folder
from wlr_render.bench.bench import Bench, EyeballCamera, Stage, Target
from wlr_render.bench.session_folder import save_session
from wlr_render.captures.capture_file import save_captures
from wlr_render.captures.correspondences import DisplayCaptures, EyeCaptures
from wlr_render.captures.importers.itoh_seethrough import SeeThroughPairs, read_itoh_seethrough
from wlr_render.captures.importers.northstar_vcam import read_northstar_vcam
from wlr_render.captures.importers.osvr_hdk13 import PIXEL_MM, read_osvr_captures
from wlr_render.captures.session import Readings, SeeThroughPlan, Session, SessionPlan
from wlr_render.jobs.job import job
from wlr_render.jobs.options import Options, ProgressArgument, described
from wlr_render.numerics.arrays import FloatArray
from wlr_render.numerics.polynomial import Box, basis, total_degree
from wlr_render.optics.device_file import load_device
from wlr_render.progress import SILENT
from wlr_render.report.blocks import Report
from wlr_render.report.save import save_report

_SMOOTH_DEGREE = 3  # of the surface that a view's dots are scattered about
_BASELINE_AGREES = 5e-3  # of it: what the printed monitor and the camera model leave open
_MEDIAN_LENGTH = np.sqrt(2.0 * np.log(2.0))  # of a two-vector of unit normal components


Format = Literal["itoh-seethrough", "northstar-vcam", "osvr-hdk13"]


@dataclass(frozen=True)
class ImportOptions(Options):
    """Options of `import`."""

    format: Annotated[Format, described("Format of the data set (docs/measured-data.md).")]
    folder: Annotated[Path, described("Folder of the data set.")]
    _: KW_ONLY
    out: Annotated[Path, described("Folder of the session, or of the capture files.")] = Path("out/import")


@job
def import_session(options: ImportOptions, *, progress: ProgressArgument = SILENT) -> Report:
    """Convert a third-party data set into a bench session, or into capture files, in `options.out`.

    Raises:
        BadInputError: the set is faulty, or the folder cannot be written or holds another session.
    """
    progress.say("reading the data set")
    report = FORMATS[options.format](options.folder, options.out)
    report = replace(report, title=f"Import of {options.folder.resolve().name}", inputs=[options.folder])
    return save_report(report, options.out)


def see_through_session(pairs: SeeThroughPairs) -> tuple[Bench, Session]:
    """Pairs of photographs as a session, and the bench without optics that it is compared with.

    A capture has its view's number, and a pose of the target to itself. Its time is that of the photograph through the
    headset, after the first of the set. What the bench states as a point's scatter is that of both photographs.
    """
    views, dots = pairs.through_px.shape[:2]
    camera = EyeballCamera(np.array(pairs.size_px, dtype=float), pairs.focal_px, pairs.centre_px, scatter_px(pairs))
    position = pairs.device_from_camera[:, :3, 3]
    gaps = np.linalg.norm(pairs.dot_in_target[:, None] - pairs.dot_in_target, axis=-1)
    pitch = np.full(views, gaps[gaps > 0].min())
    bench = Bench(
        load_device("no_optics"),
        "right",
        camera,
        Stage(position.mean(axis=0)),
        Target(pairs.device_from_target, pitch),
    )

    def of_view(values: FloatArray) -> FloatArray:
        return np.repeat(values, dots, axis=0)

    turn_from_opencv = np.diag([1.0, -1.0, -1.0])
    plan = SeeThroughPlan(
        capture=np.repeat([int(view) for view in pairs.view], dots),
        time_s=of_view(pairs.through_time_s),
        travel=np.ones(views * dots),
        stage=of_view(position),
        target_pose=np.repeat(np.arange(views), dots),
        dot=np.tile(pairs.dot_in_target[:, :2], (views, 1)),
        orientation=of_view(pairs.device_from_camera[:, :3, :3] @ turn_from_opencv),
        bare_pixel=pairs.bare_px.reshape(-1, 2),
    )
    return bench, Session(
        "itoh-seethrough", SessionPlan(see_through=plan), Readings(dot_pixel=pairs.through_px.reshape(-1, 2))
    )


def scatter_px(pairs: SeeThroughPairs) -> float:
    """Scatter per axis of a dot's displacement by the headset about a smooth surface over its view.

    It is taken from the median length in each view, and of the views the median, so that a few misdetected dots count
    little.
    """
    sigmas = []
    for bare, through in zip(pairs.bare_px, pairs.through_px, strict=True):
        design = basis(bare, total_degree(2, _SMOOTH_DEGREE), Box.around(bare))
        displacement = through - bare
        left = displacement - design @ np.linalg.lstsq(design, displacement, rcond=None)[0]
        freedom = len(bare) / (len(bare) - design.shape[1])
        sigmas.append(np.sqrt(freedom) * np.median(np.linalg.norm(left, axis=1)) / _MEDIAN_LENGTH)
    return float(np.median(sigmas))


def _itoh_seethrough(source: Path, out: Path) -> Report:
    pairs = read_itoh_seethrough(source)
    bench, session = see_through_session(pairs)
    folder = output_folder(out)
    save_session(folder, bench, session)
    views, dots = pairs.through_px.shape[:2]
    sigma_px = bench.camera.point_sigma_px
    return Report(
        "",
        verdict=f"{views} captures, {views * dots} readings; they scatter by {sigma_px:.3f} px per axis.",
        advice=[f"Diagnose the session: wlr-render diagnose {folder}"],
        files=[folder],
    )


def _northstar_vcam(source: Path, out: Path) -> Report:
    found = read_northstar_vcam(source)
    files = _saved(out, found.left, found.right)
    down, up = (f"{1e3 * each:.2f}" for each in found.baseline_m)
    lifts = (f"{1e3 * np.linalg.norm(each.eye_box.size):.1f} mm ({each.eye})" for each in (found.left, found.right))
    apart = f"By the monitor, the two cameras are {down} mm (rig down) and {up} mm (up) apart"
    warnings = []
    if found.stated_baseline_m is not None:
        off = float(np.mean(found.baseline_m)) / found.stated_baseline_m - 1.0
        apart += f"; the rig states {1e3 * found.stated_baseline_m:.2f} mm ({100 * off:+.2f} %)"
        if abs(off) > _BASELINE_AGREES:
            warnings.append(
                f"The cameras' distance differs by {100 * off:+.2f} % from the stated one: the monitor's stated size "
                "or the cameras' focal lengths are off by as much, and with them all camera positions."
            )
    return Report(
        "",
        verdict=f"Two viewpoints of each eye, {' and '.join(lifts)} apart. {apart}.",
        warnings=warnings,
        advice=[f"Fit one point per pixel: wlr-render calibrate captures {files[0]} --kind point-per-pixel"],
        files=files,
    )


def _osvr_hdk13(source: Path, out: Path) -> Report:
    captures = read_osvr_captures(source)
    files = _saved(out, captures)
    reliefs = len(np.unique(captures.capture))
    return Report(
        "",
        verdict=f"{reliefs} eye reliefs, {len(captures)} field angles; a pixel of these captures is {PIXEL_MM:g} mm.",
        warnings=["All viewpoints lie on the lens axis: of sideways movements of the eye, the set says nothing."],
        advice=[f"Fit a model over the eye relief: wlr-render calibrate captures {files[0]} --kind volumetric"],
        files=files,
    )


def _saved(out: Path, *eyes: DisplayCaptures) -> list[Path]:
    folder = output_folder(out)
    return [save_captures(folder / f"captures-{each.eye}.npz", EyeCaptures(each, None)) for each in eyes]


FORMATS: dict[Format, Callable[[Path, Path], Report]] = {
    "itoh-seethrough": _itoh_seethrough,
    "northstar-vcam": _northstar_vcam,
    "osvr-hdk13": _osvr_hdk13,
}
"""By format: reads a folder, writes into another, and returns what the report says."""
