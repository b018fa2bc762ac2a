"""Errors of models from a calibrated bench, and from the same readings with exact poses, lenses and board."""

from dataclasses import replace

import numpy as np
from scipy.spatial.transform import Rotation

from benchmarks.simulated_lab.simulate_readings import SimulatedReadings
from wlr_render.calibration.bench.board_views import TRACKING
from wlr_render.calibration.bench.calibrate_bench import CalibratedBench
from wlr_render.calibration.fit_eye import calibrate
from wlr_render.calibration.photograph_captures import (
    panel_captures,
    sound_captures,
    target_captures,
    within_field,
)
from wlr_render.captures.correspondences import Captures, SeeThroughCaptures, concatenate
from wlr_render.evaluation.truth_tests import PIXEL_DIRECTION, POINT_DIRECTION, TruthTests
from wlr_render.geometry import transforms
from wlr_render.geometry.directions import ARCMIN
from wlr_render.jobs.options import seed_of
from wlr_render.lenses.lens import Lens
from wlr_render.models.fitted_model import FittedModel
from wlr_render.numerics.arrays import FloatArray
from wlr_render.optics.traced_mappings import traced_eye
from wlr_render.simulation.photographs.camera import SimulatedLens

CALIBRATED, EXACT, NOMINAL = "calibrated", "exact", "exact, stage's random motion unknown"
"""Sources of the captures that models are fitted to."""
PREDICTED = "predicted"
"""Source name of the errors that the calibrated models predict for themselves."""


def model_errors(bench: CalibratedBench, simulated: SimulatedReadings, seed: int) -> dict[str, dict[str, float]]:
    """Return rms errors against the traced headset, by source of the captures (or `PREDICTED`) and name of the error.

    Captures of all sources have the same readings. Exact captures have the true lenses, board and target poses, and
    either the true camera poses or the poses of the stage without its random errors. The calibrated model is compared
    in the frame of the tracking camera by its calibrated lens: errors of the stated extrinsics, and of the axis of the
    lens, move display, world and eye together.
    """
    truth = traced_eye(simulated.truth.bench.device, simulated.truth.bench.eye)
    tests = TruthTests.of(truth, seed_of(seed, truth.eye, 1))
    stated, true = simulated.truth.bench.stated_device_from_tracking, simulated.truth.bench.device_from_tracking
    turn = true_to_found(bench.adjustment.state.lens[TRACKING], simulated.truth.bench.tracking)
    captures, _ = sound_captures(simulated.session, simulated.reading, bench)
    sources = {
        CALIBRATED: (captures, _moved(tests, stated @ turn @ transforms.inverse(true))),
        EXACT: (_exact(simulated, simulated.truth.display, simulated.truth.see_through), tests),
        NOMINAL: (_exact(simulated, *_nominal(simulated)), tests),
    }
    fits = {name: calibrate(captures, "planar") for name, (captures, _) in sources.items()}
    errors = {
        name: {error: each.rms for error, each in own.errors(fits[name].mappings).items()}
        for name, (_, own) in sources.items()
    }
    shown, seen = tests.display, tests.see_through
    display, see_through = (each.mapping for each in fits[CALIBRATED].both)
    predicted = {
        PIXEL_DIRECTION: _predicted(display, shown.pixel, shown.viewpoint),
        POINT_DIRECTION: _predicted(see_through, seen.point, seen.viewpoint),
    }
    return errors | {PREDICTED: predicted}


def true_to_found(found: Lens, true: SimulatedLens) -> FloatArray:
    """Return the rotation (4, 4) from a camera's true frame to the frame of a fitted lens with the same directions."""
    pixel = np.stack(np.meshgrid(*(np.linspace(0.1, 0.9, 15) * side for side in found.size_px)), -1).reshape(-1, 2)
    directions = true.ray_of_pixel(pixel, np.zeros(2))[:, 3:]
    turn, _ = Rotation.align_vectors(found.dir_of_pixel(pixel), directions)
    return transforms.rigid(turn.as_matrix(), np.zeros(3))


def _predicted(model: FittedModel, subject: FloatArray, viewpoint: FloatArray) -> float:
    """Return the predicted rms error, arcminutes, in the tracking camera's frame, without its stated pose's error."""
    errors = model.direction_errors(subject, viewpoint, model.view_dir(subject, viewpoint).value)
    counted = np.array([source != "tracking camera" for source in errors.sources], dtype=np.bool_)
    square = np.trace(errors.unshared, axis1=-2, axis2=-1) + np.sum(errors.shared[..., counted] ** 2, axis=(-2, -1))
    return float(np.sqrt(np.nanmean(square)) / ARCMIN)


def _nominal(simulated: SimulatedReadings) -> tuple[FloatArray, FloatArray]:
    """Return camera poses of display and see-through photographs from readings and smooth errors of the stage alone."""
    camera_at = simulated.truth.bench.camera_at
    session = simulated.session
    shown = [camera_at(np.asarray(each.stage)) for each in session.display]
    return np.array(shown), np.array([camera_at(np.asarray(each.stage)) for each in session.see_through])


def _exact(simulated: SimulatedReadings, display: FloatArray, see_through: FloatArray) -> Captures:
    """Return captures with the true lenses, board and targets, and the given camera poses (n, 4, 4)."""
    session, truth, reading = simulated.session, simulated.truth, simulated.reading
    camera = truth.bench.eyeball.camera
    decoded = [
        (pose, reading.panels[each.folder].samples)
        for each, pose in zip(session.display, display, strict=True)
        if each.folder in reading.panels
    ]
    panels = [
        panel_captures(session, camera, pose, samples, capture=number) for number, (pose, samples) in enumerate(decoded)
    ]
    index = {tuple(each): k for k, each in enumerate(session.board.indices())}
    places: dict[str, int] = {}
    targets: list[SeeThroughCaptures] = []
    for number, (each, pose) in enumerate(zip(session.see_through, see_through, strict=True)):
        if (seen := reading.boards.get(each.path)) is not None:
            point = truth.bench.printed.points[[index[tuple(one)] for one in seen.index]]
            known = {"capture": places.setdefault(each.place, len(places)), "target_pose": each.target_pose}
            lens, target = truth.eyeball_at_target[each.target_pose], truth.see_through_targets[number]
            targets.append(target_captures(session, lens, pose, target, seen, point, visit=len(targets), **known))
    shown = concatenate(panels)
    return Captures(shown, within_field(concatenate(targets), shown))


def _moved(tests: TruthTests, motion: FloatArray) -> TruthTests:
    """Return the same observations in another device frame; `motion` (4, 4) transforms the true frame to it."""
    shown, seen = tests.display, tests.see_through
    ray = np.concatenate(
        [transforms.apply(motion, seen.real_ray[:, :3]), transforms.rotate(motion, seen.real_ray[:, 3:])], axis=1
    )
    return TruthTests(
        replace(
            shown,
            viewpoint=transforms.apply(motion, shown.viewpoint),
            view_dir=transforms.rotate(motion, shown.view_dir),
        ),
        replace(
            seen,
            viewpoint=transforms.apply(motion, seen.viewpoint),
            view_dir=transforms.rotate(motion, seen.view_dir),
            real_ray=ray,
            point=transforms.apply(motion, seen.point),
        ),
    )
