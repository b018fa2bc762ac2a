"""Convert, decode or judge published data sets: one function for each."""

from collections.abc import Callable
from dataclasses import KW_ONLY, dataclass, replace
from pathlib import Path
from typing import Annotated, Literal

import numpy as np

from benchmarks.published_data.board_photographs import compare_detectors
from benchmarks.published_data.flat_surfaces import Lenses, find_planes, fit_planes, flatness_table
from benchmarks.published_data.itoh_seethrough import read_itoh_seethrough, see_through_session
from benchmarks.published_data.northstar_vcam import read_northstar_vcam
from benchmarks.published_data.opencv_decoder import compared_with_opencv, has_opencv_decoder
from benchmarks.published_data.osvr_hdk13 import PIXEL_MM, read_osvr_captures
from benchmarks.published_data.procam_graycode import read_procam_graycode
from benchmarks.published_data.two_view_tables import tables, verdict
from benchmarks.published_data.viewpoint_evidence import viewpoint_evidence
from wlr_render.bench.session_folder import save_session
from wlr_render.captures.code_files import CodeFiles
from wlr_render.captures.correspondences import Captures, DisplayCaptures
from wlr_render.captures.patterns.catalogue import GrayCode
from wlr_render.captures.photograph_format import PhotographFormat
from wlr_render.captures.photographs import read_each, read_photograph
from wlr_render.io.atomic_files import output_folder
from wlr_render.jobs.decode import CodePhotographs, decode_and_assess
from wlr_render.jobs.options import Options, ProgressArgument, described
from wlr_render.report.blocks import Report
from wlr_render.report.save import save_report
from wlr_render.work.progress import SILENT, Progress

_BASELINE_AGREES = 5e-3  # relative uncertainty of baselines due to the stated monitor size and the camera model


DataSet = Literal["itoh-seethrough", "northstar-vcam", "two-views", "osvr-hdk13", "procam-graycode", "boards"]


@dataclass(frozen=True)
class PublishedDataOptions(Options):
    """Options of `published-data`."""

    data_set: Annotated[
        DataSet,
        described(
            "Data set (docs/measured-data.md); two-views: display models on that of northstar-vcam; boards: detectors "
            "of boards on its photographs.",
            name="dataset",
        ),
    ]
    path: Annotated[Path, described("Folder of the data set.")]
    _: KW_ONLY
    out: Annotated[Path, described("Output folder.")] = Path("out/benchmarks/published-data")


def run(options: PublishedDataOptions, *, progress: ProgressArgument = SILENT) -> Report:
    """Convert, decode or judge a set; write into `options.out`.

    Raises:
        BadInputError: the set is faulty, or the folder cannot be written or holds another session.
    """
    progress.say("reading the data set")
    report = DATA_SETS[options.data_set](options.path, options.out, progress)
    report = replace(report, title=f"{options.data_set}: {options.path.resolve().name}", inputs=[options.path])
    return save_report(report, options.out, "published-data")


def _itoh_seethrough(source: Path, out: Path, _: Progress) -> Report:
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


def _northstar_vcam(source: Path, out: Path, _: Progress) -> Report:
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
        advice=[f"Fit one point per pixel: wlr-render calibrate {files[0]} --kind point-per-pixel"],
        files=files,
    )


def _two_views(source: Path, _: Path, progress: Progress) -> Report:
    captures = read_northstar_vcam(source)
    progress.say("fitting the models")
    evidence = viewpoint_evidence([captures.left, captures.right])
    return Report("", verdict(evidence), blocks=tables(evidence))


def _boards(source: Path, _: Path, progress: Progress) -> Report:
    progress.say("finding the boards")
    return compare_detectors(source)


def _osvr_hdk13(source: Path, out: Path, _: Progress) -> Report:
    captures = read_osvr_captures(source)
    files = _saved(out, captures)
    reliefs = len(np.unique(captures.capture))
    return Report(
        "",
        verdict=f"{reliefs} eye reliefs, {len(captures)} field angles; a pixel of these captures is {PIXEL_MM:g} mm.",
        warnings=["All viewpoints lie on the lens axis: of sideways movements of the eye, the set says nothing."],
        advice=[f"Fit a model over the eye relief: wlr-render calibrate {files[0]} --kind volumetric"],
        files=files,
    )


def _procam_graycode(source: Path, out: Path, progress: Progress) -> Report:
    capture = read_procam_graycode(source)
    kind = PhotographFormat(bits=8 * read_photograph(capture.photographs[0]).itemsize)
    files = CodeFiles(tuple((path,) for path in capture.photographs))
    codes = CodePhotographs(source, files, GrayCode(capture.panel), kind)
    camera, both = Lenses(capture.camera), Lenses(capture.camera, capture.projector)
    report, decoded = decode_and_assess(codes, out, progress)
    progress.say("fitting flat surfaces")
    survey = fit_planes(decoded, find_planes(decoded, camera), camera)
    tables = [
        flatness_table(survey, "Homographies of flat surfaces"),
        flatness_table(fit_planes(decoded, survey.label), "Homographies, as photographed"),
        flatness_table(fit_planes(decoded, survey.label, both), "Homographies, camera and projector undistorted"),
    ]
    if has_opencv_decoder():
        progress.say("decoding with OpenCV")
        tables.append(compared_with_opencv(decoded, read_each(capture.photographs), capture.panel, survey, camera))
    return replace(report, blocks=[*report.blocks, *tables])


def _saved(out: Path, *eyes: DisplayCaptures) -> list[Path]:
    folder = output_folder(out)
    return [Captures(each, None).save(folder / f"captures-{each.eye}.npz") for each in eyes]


DATA_SETS: dict[DataSet, Callable[[Path, Path, Progress], Report]] = {
    "itoh-seethrough": _itoh_seethrough,
    "northstar-vcam": _northstar_vcam,
    "two-views": _two_views,
    "osvr-hdk13": _osvr_hdk13,
    "procam-graycode": _procam_graycode,
    "boards": _boards,
}
"""For each data set, the function that reads a folder, writes into another, and returns the report."""
