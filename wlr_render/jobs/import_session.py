"""Convert third-party data sets into bench sessions: one function for each format."""

from collections.abc import Callable
from dataclasses import KW_ONLY, dataclass
from pathlib import Path
from typing import Annotated, Literal

import numpy as np

from wlr_render.captures.importers.itoh_seethrough import SeeThroughPairs, read_itoh_seethrough
from wlr_render.captures.session import Readings, SeeThroughPlan, Session, SessionPlan
from wlr_render.files import output_folder
from wlr_render.jobs.options import Options, ProgressArgument, described
from wlr_render.numerics.arrays import FloatArray
from wlr_render.numerics.polynomial import Box, basis, total_degree
from wlr_render.optics.device_file import load_device
from wlr_render.progress import SILENT
from wlr_render.report.blocks import Report
from wlr_render.report.save import save_report
from wlr_render.simulation.bench import Bench, EyeballCamera, Stage, Target
from wlr_render.simulation.session_folder import save_session

_SMOOTH_DEGREE = 3  # of the surface that a view's dots are scattered about
_MEDIAN_LENGTH = np.sqrt(2.0 * np.log(2.0))  # of a two-vector of unit normal components


Format = Literal["itoh-seethrough"]


@dataclass(frozen=True)
class ImportOptions(Options):
    """Options of `import`."""

    format: Annotated[Format, described("Format of the data set (docs/measured-data.md).")]
    folder: Annotated[Path, described("Folder of the data set.")]
    _: KW_ONLY
    out: Annotated[Path, described("Folder of the session.")] = Path("out/import")


def import_session(options: ImportOptions, *, progress: ProgressArgument = SILENT) -> Report:
    """Convert a third-party data set into a bench session in `options.out`.

    Raises:
        BadInputError: the set is faulty, or the folder cannot be written or holds another session.
    """
    progress.say("reading the data set")
    bench, session = FORMATS[options.format](options.folder)
    folder = output_folder(options.out)
    save_session(folder, bench, session)
    plan = session.plan.see_through
    captures, readings = (0, 0) if plan is None else (len(np.unique(plan.capture)), len(plan.capture))
    sigma_px = bench.camera.point_sigma_px
    report = Report(
        f"Import of {options.folder.resolve().name}",
        verdict=f"{captures} captures, {readings} readings; they scatter by {sigma_px:.3f} px per axis.",
        advice=[f"Diagnose the session: wlr-render diagnose {folder}"],
        inputs=[options.folder],
        files=[folder],
    )
    return save_report(report, folder)


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


def _itoh_seethrough(source: Path) -> tuple[Bench, Session]:
    return see_through_session(read_itoh_seethrough(source))


FORMATS: dict[Format, Callable[[Path], tuple[Bench, Session]]] = {"itoh-seethrough": _itoh_seethrough}
"""Converters from a folder, by format."""
