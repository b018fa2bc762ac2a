"""The judge of composed frames: right where nothing moved, wrong by what moved, row by row."""

import numpy as np
import pytest

from benchmarks.speed import accuracy_tables
from benchmarks.speed.accuracy import ScanOutPose, disoccluded_at_pupil, landing, near_silhouettes, subject, truth
from benchmarks.speed.workload import bench_model
from wlr_render.geometry import transforms
from wlr_render.geometry.pinhole import Pinhole
from wlr_render.mappings import Panel
from wlr_render.rendering.choose_warp_grid import TOLERANCE_ARCMIN, warp_grid_error_arcmin
from wlr_render.rendering.gl_ray_maps import GlPlanarSolver
from wlr_render.rendering.ray_map import middle_axes
from wlr_render.rendering.scene_file import load_scene
from wlr_render.rendering.warp_grid import WarpGrid

PLACE = np.array([0.6, -0.5, 0.4])
TURN = transforms.rigid(transforms.rotation_about("y", np.deg2rad(0.5)), np.zeros(3))


@pytest.fixture(scope="module")
def on(small_panel_model, scene_file):
    ready = subject(small_panel_model, load_scene(scene_file))
    yield ready
    ready.compositor.release()


@pytest.fixture(scope="module")
def scan_out(on):
    return ScanOutPose(on.mappings.eye_box.at(PLACE), np.eye(4))


@pytest.fixture(scope="module")
def seen(on, scan_out):
    return truth(on, scan_out)


def test_a_frame_composed_for_its_scan_out_lands(on, scan_out, seen):
    landed = landing(on, seen, scan_out, scan_out)
    assert landed.pixels > 4000
    assert landed.rms_arcmin < 0.05
    assert landed.one_sided == 0


def test_a_head_that_turned_is_off_by_its_turn_until_corrected(on, scan_out):
    """30 arcmin seen from the axis, less towards the pole of the turn; and what the optics magnify."""
    turned = ScanOutPose(scan_out.viewpoint, TURN)
    after = truth(on, turned)
    assert landing(on, after, scan_out, scan_out).rms_arcmin == pytest.approx(30, rel=0.15)
    assert landing(on, after, scan_out, turned).rms_arcmin < 0.05


def test_a_wrong_pupil_is_found(on, scan_out, seen):
    aside = ScanOutPose(scan_out.viewpoint + [0.001, 0, 0], scan_out.pose)
    assert landing(on, seen, scan_out, aside).rms_arcmin > 1


def test_each_row_is_traced_from_its_own_pose(on, scan_out):
    rolling = ScanOutPose(scan_out.viewpoint, np.eye(4), TURN)
    poses, found = rolling.row_poses(100), truth(on, rolling)
    np.testing.assert_allclose(poses[[0, -1]], [np.eye(4), TURN], atol=1e-12)
    for row in (0, 41, 99):
        alone = truth(on, ScanOutPose(scan_out.viewpoint, poses[row]))
        np.testing.assert_array_equal(found.position[row], alone.position[row])
        np.testing.assert_array_equal(found.direction[row], alone.direction[row])


def test_rows_need_their_own_poses(on, scan_out):
    rolling = ScanOutPose(scan_out.viewpoint, np.eye(4), TURN)
    after = truth(on, rolling)
    assert landing(on, after, scan_out, rolling).rms_arcmin < 0.05
    # 0 at the first row, 30 at the last one: over sqrt(3), were there as many pixels to judge in all rows.
    assert 10 < landing(on, after, scan_out, rolling.at_once).rms_arcmin < 20


@pytest.mark.slow
def test_less_is_hidden_from_where_the_rays_come():
    eye = bench_model(Panel(320, 180), device="birdbath28")
    name, rms, worst, at_pupil, at_rays, cut = accuracy_tables.landing_row("birdbath28", eye, "sculpture", "auto")
    assert name == "birdbath28, sculpture"
    assert 0 < rms <= worst
    assert at_pupil > at_rays
    assert cut == pytest.approx(100 * (1 - at_rays / at_pupil))


def test_what_the_pupil_cannot_see_is_counted(on, seen, scan_out):
    view = on.compositor.plan("right").view(scan_out.viewpoint, scan_out.pose)
    at_rays = landing(on, seen, scan_out, scan_out).disoccluded
    assert disoccluded_at_pupil(on, seen) >= at_rays
    assert (view.position_in_device != scan_out.viewpoint).any()


def test_late_rows_are_of_each_movement(on):
    rows = accuracy_tables.late_rows(on)
    assert len(rows) == 6
    late, corrected = (np.array([row[column] for row in rows]) for column in (1, 2))
    first_row = ["first row" in row[0] for row in rows]
    assert sum(first_row) == 1
    assert (late > 3).all()
    np.testing.assert_array_equal(corrected > 1, first_row)


@pytest.mark.gl
def test_the_shaders_error_is_that_of_its_lattice(gl_context, small_panel_model):
    """At pixels next to nothing; between few points what the choice of warp grids measures without a shader."""
    eye, axes = small_panel_model, middle_axes(small_panel_model)
    pixels, few = WarpGrid.of_pixels(eye.display.panel), WarpGrid.edge_to_edge(eye.display.panel, 10, 11)
    at_pixels, between = (
        accuracy_tables.ray_map_error_arcmin(GlPlanarSolver(gl_context, eye, warp_grid, axes), eye, warp_grid)
        for warp_grid in (pixels, few)
    )
    assert np.nanmax(at_pixels) < 0.01
    centres = eye.display.panel.pixel_centres().reshape(-1, 2)
    expected = [
        np.nanmax(warp_grid_error_arcmin(eye, axes, few, viewpoint, centres))
        for viewpoint in eye.eye_box.at(accuracy_tables.JUDGED_PLACES)
    ]
    np.testing.assert_allclose(np.nanmax(between, axis=1), expected, rtol=1e-3)
    assert min(expected) > 1


@pytest.mark.gl
def test_the_table_of_ray_maps_has_the_bound_of_the_warp_grid(gl_context, small_panel_model):
    (row,) = accuracy_tables.ray_map_table({"northstar": small_panel_model}, "auto").rows
    assert 0 <= row[1] <= TOLERANCE_ARCMIN
    assert row[3] <= TOLERANCE_ARCMIN


def test_goals_of_composed_frames_are_for_the_worst():
    good, bad = ["a", 0.003, 0.1, 1000, 100, 90.0], ["b", 0.006, 0.1, 1000, 200, 80.0]
    assert [each.is_reached for each in accuracy_tables.landing_figures([good])] == [True, True]
    rms, cut = accuracy_tables.landing_figures([good, bad])
    assert (rms.ours, cut.ours) == ("0.003' to 0.006'", "80 % to 90 %")
    assert not rms.is_reached
    assert not cut.is_reached


def test_silhouettes_are_where_distance_jumps_and_not_where_it_slopes():
    depth = np.full((80, 100, 1), 2.0)
    depth[:, :40] = 1.0
    depth *= np.linspace(1.0, 1.2, 80)[:, None, None]  # a slope of a fifth of a percent per row
    tangents = Pinhole(100, 80, np.array([-0.5, -0.4]), np.array([0.5, 0.4])).pixel_centre_tangents()
    eye = np.array([1.0, 1.6, -0.2])
    points = eye + np.insert(tangents, 2, -1.0, axis=-1) * depth
    points[:10] = np.nan
    expected = np.zeros((80, 100), bool)
    expected[:, 37:43] = True  # the two columns at the edge, and two more on each side
    expected[:10] = False
    expected[7:13] = True
    np.testing.assert_array_equal(near_silhouettes(points, eye, 2), expected)
