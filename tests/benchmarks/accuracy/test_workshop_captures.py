from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from benchmarks.accuracy.lab_errors import LAB_SWITCHES, OF_NOISE, LabWorkshop
from benchmarks.accuracy.workshop_captures import LabBoard, LabSweep, display_captures, see_through_captures
from wlr_render.captures.correspondences import DisplayCaptures, SeeThroughCaptures
from wlr_render.geometry.directions import arcmin_between
from wlr_render.mappings import Eye
from wlr_render.numerics.arrays import FloatArray
from wlr_render.simulation.capture_setup import CaptureSetup

WORKSHOP = LabWorkshop(3)


@pytest.fixture
def setup(flat_image_headset: Eye) -> CaptureSetup:
    return CaptureSetup(flat_image_headset, grid=(7, 6), target_depths_m=(0.6, 1.0))


def captured(setup: CaptureSetup, workshop: LabWorkshop) -> tuple[DisplayCaptures, SeeThroughCaptures]:
    at, rng = setup.camera_positions("planar", 4), np.random.default_rng(7)
    return display_captures(setup, workshop, at, rng), see_through_captures(setup, workshop, at, rng)


def errors(setup: CaptureSetup, display: Any, see_through: Any) -> tuple[FloatArray, FloatArray]:
    """Return the angles between captured and exact directions of panel and points, arcminutes."""
    shown = setup.truth.display.view_dir_of_pixel(display.pixel, display.viewpoint).value
    seen = setup.truth.see_through.view_dir_of_real_point(see_through.point, see_through.viewpoint).value
    return arcmin_between(shown, display.view_dir), arcmin_between(seen, see_through.view_dir)


def test_captures_of_a_perfect_workshop_are_exact(setup: CaptureSetup) -> None:
    shown, seen = errors(setup, *captured(setup, LabWorkshop(3, 0.0)))
    assert max(shown.max(), seen.max()) < 1e-6


@pytest.mark.parametrize("name", [name for name in LAB_SWITCHES if name not in OF_NOISE])
def test_each_error_reaches_the_captures_that_it_concerns(setup: CaptureSetup, name: str) -> None:
    shown, seen = errors(setup, *captured(setup, WORKSHOP.only(name)))
    assert (shown.max() > 1e-3) == (name not in ("print", "bow"))
    assert seen.max() > 1e-3


def test_captures_record_what_a_lab_records(setup: CaptureSetup) -> None:
    display, see_through = captured(replace(setup, camera_noise_arcmin=0.5), WORKSHOP)
    for part in (display, see_through):
        np.testing.assert_allclose(part.viewpoint, setup.truth.eye_box.centre + part.stage)
        assert part.has_visits
        assert np.isfinite(part.time_s).all()
        assert set(np.unique(part.travel)) <= {-1.0, 1.0}
        assert np.all(part.sigma_arcmin == 0.5)
        np.testing.assert_allclose(
            part.device_from_camera @ np.swapaxes(part.device_from_camera, 1, 2),
            np.eye(3)[None].repeat(len(part), 0),
            atol=1e-12,
        )
    first = see_through.target_pose == 0
    assert set(see_through.visit[first]) == set(display.visit)  # the panel is decoded in the first sweep
    assert see_through.time_s[~first].min() > see_through.time_s[first].max()
    board = LabBoard.of(setup)
    for pose in (0, 1):
        rows = see_through.target_pose == pose
        placed = see_through.target_point[rows] @ board.device_from_target[pose][:3, :3].T
        np.testing.assert_allclose(placed + board.device_from_target[pose][:3, 3], see_through.point[rows])
    both = [set(map(tuple, np.round(see_through.target_point[see_through.target_pose == k], 6))) for k in (0, 1)]
    assert both[1] & both[0]  # the same dots at both poses


def test_noise_has_the_stated_sigma(setup: CaptureSetup) -> None:
    noisy = replace(setup, grid=(25, 21), camera_noise_arcmin=0.5)
    for part in errors(noisy, *captured(noisy, LabWorkshop(3, 0.0))):
        np.testing.assert_allclose(np.sqrt(np.mean(part**2)), 0.5 * np.sqrt(2.0), rtol=0.05)


def test_rays_and_views_of_points_are_inverse(setup: CaptureSetup) -> None:
    """A point on the true ray of a camera pixel is seen at this pixel, whatever the errors."""
    at = setup.camera_positions("planar", 4)
    sweep = LabSweep.driven(setup, WORKSHOP, at, 1, np.random.default_rng(1))
    view_dir = setup.camera_dirs()[10:11]
    origin, direction = sweep.rays_of_dirs(view_dir)
    world = setup.truth.see_through.real_ray_of_view_dir(direction, origin).value[0, 0]
    stated, _ = sweep.views_of_points((world[:3] + 0.8 * world[3:])[None])
    assert arcmin_between(stated[0, 0], view_dir[0]) < 1e-4
