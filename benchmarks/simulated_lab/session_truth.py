"""Compare a calibration from simulated photographs with the truth, and with a calibration from exact numbers.

The exact calibration has the same camera positions, camera pixels and dots, and readings with the noise that the
photographs' readings state; but its lenses, stage and target are exact, and it has no other error.
"""

from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from benchmarks.simulated_lab import exact_views
from benchmarks.simulated_lab.bench_truth import BenchTruth, true_values
from benchmarks.simulated_lab.faults import Faults
from wlr_render.calibration.calibrate_session import SessionCalibration
from wlr_render.calibration.fit_eye import Calibration, calibrate
from wlr_render.calibration.photograph_captures import (
    panel_captures,
    target_captures,
    within_field,
)
from wlr_render.calibration.poses import motion_between
from wlr_render.captures.correspondences import Captures, DisplayCaptures, SeeThroughCaptures, concatenate
from wlr_render.captures.decoded import DecodedSamples
from wlr_render.evaluation.truth_tests import TruthTests
from wlr_render.geometry import transforms
from wlr_render.geometry.directions import ARCMIN
from wlr_render.jobs.options import seed_of
from wlr_render.mappings import Eye
from wlr_render.optics.traced_mappings import traced_eye
from wlr_render.report.blocks import Cell, ReportTable
from wlr_render.simulation.photographs.photo_bench import PhotoBench
from wlr_render.simulation.photographs.photo_plan import plan_photographs, true_camera_poses


@dataclass(frozen=True, eq=False)
class SessionTruth:
    """Comparison of a session's calibration with the truth.

    Attributes:
        truth: true values of the bench at each photograph.
        found: the calibration from photographs.
        measured: the fit to its captures, moved to the true device frame: the error of the tracking camera's stated
            pose moves everything together.
        ideal: the fit to exact correspondences with the same noise.
    """

    truth: BenchTruth
    found: SessionCalibration
    measured: Calibration
    ideal: Calibration


def compare_with_truth(bench: PhotoBench, found: SessionCalibration, seed: int) -> SessionTruth:
    """Make the exact calibration that corresponds to a calibration from photographs, and compare."""
    session = found.session
    visits = true_camera_poses(bench, plan_photographs(bench, len(session.display)))
    truth = true_values(session, bench, visits, Faults())
    captures = _exact_captures(truth, found, np.random.default_rng([seed, 3]))
    moved = _in_true_frame(found.eyes[bench.eye].captures, truth)
    return SessionTruth(truth, found, calibrate(moved, "planar"), calibrate(captures, "planar"))


def truth_tables(compared: SessionTruth, seed: int) -> tuple[ReportTable, ReportTable]:
    """Tabulate errors of the models, from photographs and from exact numbers, and errors of the station's poses."""
    bench = compared.truth.bench
    truth = traced_eye(bench.device, bench.eye)
    return _model_table(compared, truth, seed), _station_table(compared)


def _in_true_frame(captures: Captures, truth: BenchTruth) -> Captures:
    true_from_stated = truth.bench.device_from_tracking @ transforms.inverse(truth.bench.stated_device_from_tracking)

    def moved(each: DisplayCaptures | SeeThroughCaptures) -> dict[str, Any]:
        return {
            "viewpoint": transforms.apply(true_from_stated, each.viewpoint),
            "view_dir": transforms.rotate(true_from_stated, each.view_dir),
        }

    display, see_through = captures.display, captures.see_through
    assert display is not None  # simulated sessions have a display
    assert see_through is not None
    point = transforms.apply(true_from_stated, see_through.point)
    return Captures(
        replace(display, **moved(display)),
        replace(see_through, **moved(see_through), point=point),
    )


def _exact_captures(truth: BenchTruth, found: SessionCalibration, rng: np.random.Generator) -> Captures:
    session, bench, camera = found.session, truth.bench, truth.bench.eyeball.camera
    poses = dict(zip((each.folder for each in session.display), truth.display, strict=True))
    poses |= dict(zip((each.path for each in session.see_through), truth.see_through, strict=True))
    panels: list[DisplayCaptures] = []
    for each, panel in found.reading.panels_of(session.display):
        pose, samples = poses[each.folder], panel.samples
        seen = exact_views.panel_position(bench.optics, camera, pose, samples.camera_pixel)
        noise = rng.normal(size=seen.value.shape) * samples.sigma_px[:, None]
        whole = DecodedSamples(samples.camera_pixel, seen.value + noise, samples.sigma_px, samples.scale)
        shown = _rows(whole, seen.usable)
        panels.append(panel_captures(session, camera, pose, shown, capture=len(panels)))
    targets = []
    places: dict[str, int] = {}
    for photograph, observation in found.reading.views_of(session.see_through):
        pose, target = poses[photograph.path], bench.device_from_target[photograph.target_pose]
        on_target = bench.printed.point_of(observation.index)
        point = transforms.apply(target, on_target)
        pixel = exact_views.pixel_of_real_point(bench.optics, camera, pose, point)
        pixel = pixel + rng.normal(size=pixel.shape) * observation.sigma_px[:, None]
        sound = np.asarray(np.isfinite(pixel).all(axis=-1))
        whole_observation = replace(observation, pixel=pixel).only(sound)
        known = {
            "capture": places.setdefault(photograph.place, len(places)),
            "target_pose": photograph.target_pose,
        }
        targets.append(target_captures(session, camera, pose, target, whole_observation, on_target[sound], **known))
    display = concatenate(panels)
    return Captures(display, within_field(concatenate(targets), display))


def _rows(samples: DecodedSamples, kept: NDArray[np.bool_]) -> DecodedSamples:
    return replace(
        samples,
        camera_pixel=samples.camera_pixel[kept],
        panel_pixel=samples.panel_pixel[kept],
        sigma_px=samples.sigma_px[kept],
        scale=samples.scale[kept],
    )


def _model_table(compared: SessionTruth, truth: Eye, seed: int) -> ReportTable:
    tests = TruthTests.of(truth, seed_of(seed, truth.eye, 1))
    measured, ideal = (
        tests.errors(compared.measured.mappings),
        tests.errors(compared.ideal.mappings),
    )
    rows: list[list[Cell]] = [
        [name, from_photographs.rms, from_numbers.rms, from_photographs.rms / from_numbers.rms, from_photographs.median]
        for (name, from_photographs), (_, from_numbers) in zip(measured.items(), ideal.items(), strict=True)
    ]
    title = (
        "Models from photographs, and models from exact correspondences with the same noise, "
        f"{compared.measured.both[0].report.viewpoints} places"
    )
    columns = ["error", "from photographs, rms", "from exact numbers, rms", "ratio", "from photographs, median"]
    notes = ("Without the error of the tracking camera's stated pose, which moves display and world together.",)
    return ReportTable(title, columns, rows, notes)


def _station_table(compared: SessionTruth) -> ReportTable:
    found, truth = compared.found.bench, compared.truth
    first = compared.found.session.display[0]
    poses = [("eyeball camera at the first panel photographs", found.camera_pose(first), truth.display[0])]
    poses += [
        (f"target pose {number}", pose, truth.bench.device_from_target[number])
        for number, pose in found.targets.items()
    ]
    rows: list[list[Cell]] = []
    for name, pose, true in poses:
        motion = motion_between(true, pose.b_from_a)
        place = 1e3 * (pose.b_from_a[:3, 3] - true[:3, 3])
        rows.append(
            [
                name,
                float(np.linalg.norm(place)),
                float(np.linalg.norm(pose.sigma_mm)),
                float(np.linalg.norm(motion[:3])) / ARCMIN,
                float(np.linalg.norm(pose.sigma_arcmin)),
            ]
        )
    columns = ["pose", "off by (mm)", "stated sigma (mm)", "turned by (arcmin)", "stated sigma (arcmin)"]
    return ReportTable("Calibrated and true bench", columns, rows, ("Lengths of vectors; sigma likewise.",))
