"""Measured sets of others as bench sessions: one function a set, from what its importer read to a folder."""

from dataclasses import dataclass
from pathlib import Path

import numpy as np

from wlr_render.captures.importers.itoh_seethrough import SeeThroughPairs, read_itoh_seethrough
from wlr_render.captures.session import Readings, SeeThroughPlan, Session, SessionPlan
from wlr_render.files import output_folder
from wlr_render.numerics.arrays import FloatArray
from wlr_render.numerics.polynomial import Box, basis
from wlr_render.optics.device_file import load_device
from wlr_render.simulation.bench import Bench, EyeballCamera, Stage, Target
from wlr_render.simulation.session_folder import save_session

_SMOOTH_DEGREE = 3  # of the surface that a view's dots are scattered about
_MEDIAN_LENGTH = np.sqrt(2.0 * np.log(2.0))  # of a two-vector of unit normal components


@dataclass(frozen=True)
class Imported:
    """What was written.

    Attributes:
        folder: of the session.
        captures, readings: how many it has.
        sigma_px: scatter of a reading per axis, as the bench states it.
    """

    folder: Path
    captures: int
    readings: int
    sigma_px: float


def import_itoh_seethrough(source: Path, folder: Path) -> Imported:
    """Write the see-through captures that `read_itoh_seethrough` reads from `source` as a bench session.

    Raises:
        BadInputError: the set is faulty, or the folder cannot be written or holds another session.
    """
    pairs = read_itoh_seethrough(source)
    bench, session = see_through_session(pairs)
    save_session(output_folder(folder), bench, session)
    return Imported(folder, len(pairs.view), pairs.through_px[..., 0].size, bench.camera.point_sigma_px)


FORMATS = {"itoh-seethrough": import_itoh_seethrough}
"""Sets that can be imported, by name."""


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
        design = basis(bare, _SMOOTH_DEGREE, Box.around(bare))
        displacement = through - bare
        left = displacement - design @ np.linalg.lstsq(design, displacement, rcond=None)[0]
        freedom = len(bare) / (len(bare) - design.shape[1])
        sigmas.append(np.sqrt(freedom) * np.median(np.linalg.norm(left, axis=1)) / _MEDIAN_LENGTH)
    return float(np.median(sigmas))
