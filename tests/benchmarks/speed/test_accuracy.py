"""The judge of composed frames: right where nothing moved, wrong by what moved, row by row."""

from collections.abc import Iterator

import numpy as np
import pytest
from present import as_number

from benchmarks.speed import accuracy_tables
from benchmarks.speed.accuracy import ScanOutPose, Subject, Truth, landing, near_silhouettes, subject, truth
from wlr_render.geometry import transforms
from wlr_render.geometry.pinhole import Pinhole
from wlr_render.gl.context import GlContext
from wlr_render.mappings import Eye
from wlr_render.scene.scene_file import load_scene
from wlr_render.warp.choose_grid import TOLERANCE_ARCMIN

PLACE = np.array([0.6, -0.5, 0.4])
TURN = transforms.rigid(transforms.rotation_about("y", np.deg2rad(0.5)), np.zeros(3))


@pytest.fixture(scope="module")
def on(small_panel_model: Eye, scene_file: str) -> Iterator[Subject]:
    ready = subject(small_panel_model, load_scene(scene_file))
    yield ready
    ready.compositor.release()


@pytest.fixture(scope="module")
def scan_out(on: Subject) -> ScanOutPose:
    return ScanOutPose(on.mappings.eye_box.at(PLACE), np.eye(4))


@pytest.fixture(scope="module")
def seen(on: Subject, scan_out: ScanOutPose) -> Truth:
    return truth(on, scan_out)


def test_a_frame_composed_for_its_scan_out_lands(on: Subject, scan_out: ScanOutPose, seen: Truth) -> None:
    landed = landing(on, seen, scan_out, scan_out)
    assert landed.pixels > 4000
    assert landed.rms_arcmin < 0.05
    assert landed.one_sided == 0


def test_a_head_that_turned_is_off_by_its_turn_until_corrected(on: Subject, scan_out: ScanOutPose) -> None:
    """30 arcmin seen from the axis, less towards the pole of the turn; and what the optics magnify."""
    turned = ScanOutPose(scan_out.viewpoint, TURN)
    after = truth(on, turned)
    assert landing(on, after, scan_out, scan_out).rms_arcmin == pytest.approx(30, rel=0.15)
    assert landing(on, after, scan_out, turned).rms_arcmin < 0.05


def test_rows_need_their_own_poses(on: Subject, scan_out: ScanOutPose) -> None:
    rolling = ScanOutPose(scan_out.viewpoint, np.eye(4), TURN)
    after = truth(on, rolling)
    assert landing(on, after, scan_out, rolling).rms_arcmin < 0.05
    # 0 at the first row, 30 at the last one: over sqrt(3), were there as many pixels to judge in all rows.
    assert 10 < landing(on, after, scan_out, rolling.at_once).rms_arcmin < 20


@pytest.mark.gl
def test_the_table_of_ray_maps_has_the_bound_of_the_warp_grid(gl_context: GlContext, small_panel_model: Eye) -> None:
    (row,) = accuracy_tables.ray_map_table({"northstar": small_panel_model}, "auto").rows
    assert 0 <= as_number(row[1]) <= TOLERANCE_ARCMIN
    assert as_number(row[3]) <= TOLERANCE_ARCMIN


def test_silhouettes_are_where_distance_jumps_and_not_where_it_slopes() -> None:
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
