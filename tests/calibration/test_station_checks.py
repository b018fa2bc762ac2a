from dataclasses import replace

import numpy as np
import pytest
from synthetic_station import SHIFT, TRACKING, Faults, bench, station_of

from wlr_render.calibration.board_poses import poses_of
from wlr_render.calibration.check import refuse_contradictions
from wlr_render.calibration.poses import small_motion
from wlr_render.calibration.station_checks import lens_check
from wlr_render.errors import BadInputError
from wlr_render.geometry.lens_camera import LensCamera

SLIGHT = small_motion(np.array([2e-4, -2e-4, 0.0, 1e-4, 0.0, 1e-4]))


def failed(faults, **arrangement):
    return [check for check in station_of(bench(1, faults, **arrangement)).checks if not check.ok]


def only(faults, **arrangement):
    checks = failed(faults, **arrangement)
    assert len(checks) == 1, [check.sentence for check in checks]
    return checks[0]


@pytest.mark.parametrize("motion", [SHIFT, SLIGHT])
@pytest.mark.parametrize("target", [0, 2])
def test_a_target_that_moved_before_its_tracking_photograph_is_named_among_three(motion, target):
    check = only(Faults(target_moved_before_tracking={target: motion}), bare_targets=(0, 1, 2), targets=(0, 1, 2))
    assert check.step == f"target pose {target}"
    assert "between its photographs without the headset and its tracking photographs" in check.sentence


def test_of_two_target_poses_both_are_suspected():
    check = only(Faults(target_moved_before_tracking={1: SHIFT}))
    assert check.step == "target pose 0 or 1"


@pytest.mark.parametrize("motion", [SHIFT, SLIGHT])
@pytest.mark.parametrize(
    ("fault", "said"),
    [
        ("target_moved_in_sweep", "the target moved between tracking/1a.png and tracking/1b.png"),
        ("headset_shifted_in_sweep", "the headset shifted between tracking/1a.png and tracking/1b.png"),
        ("camera_moved_in_sweep", "the camera or its stage moved between through/1a.png and through/1b.png"),
    ],
)
def test_what_moved_during_a_sweep_is_named(fault, said, motion):
    check = only(Faults(**{fault: {1: motion}}))
    assert check.step == "sweep at target pose 1"
    assert said in check.sentence


def test_without_a_repeated_photograph_target_and_headset_cannot_be_told_apart():
    made = bench(1, Faults(headset_shifted_in_sweep={0: SHIFT}))
    station = station_of(replace(made, photos=replace(made.photos, repeated=())))
    (check,) = (check for check in station.checks if not check.ok)
    assert "the target moved or the headset shifted" in check.sentence


def test_without_a_tracking_photograph_after_the_sweep_three_things_may_have_moved():
    made = bench(1, Faults(target_moved_in_sweep={0: SHIFT}))
    before = [photo for photo in made.photos.tracking if photo.name.endswith("a.png")]
    station = station_of(replace(made, photos=replace(made.photos, tracking=before)))
    (check,) = (check for check in station.checks if not check.ok)
    assert "the target, the camera or its stage moved" in check.sentence


def test_a_photograph_that_moved_is_named():
    check = only(Faults(moved_photograph=7))
    assert check.step == "bare/07.png"
    assert "the target or the camera moved at bare/07.png" in check.sentence
    assert not check.contradictory


def test_a_bowed_stage_is_named():
    check = only(Faults(bow_m=3e-4))
    assert "does not move in a straight line or plane" in check.sentence
    assert "out of its plane" in check.sentence
    assert not check.contradictory
    assert check.value > 5 * check.sigma


def test_a_stage_that_rotates_the_camera_is_named():
    check = only(Faults(random_rotation_rad=2e-4))
    assert "the stage rotates the camera by" in check.sentence
    assert "microradians per axis" in check.sentence
    assert not check.contradictory
    assert check.value > 5 * check.sigma


def test_a_stage_that_rotates_the_camera_by_ten_arcminutes_stops():
    with pytest.raises(BadInputError, match="photographs without the headset: the stage rotates the camera by"):
        refuse_contradictions(station_of(bench(1, Faults(random_rotation_rad=4e-3))).checks)


@pytest.mark.parametrize(("factor", "said"), [(1e-3, "1000 times too small"), (1e3, "1000 times too large")])
def test_a_wrong_unit_is_named_and_refused(factor, said):
    station = station_of(bench(1, Faults(reading_factor=factor)))
    off = [check for check in station.checks if not check.ok]
    assert all(said in check.sentence for check in off)
    with pytest.raises(BadInputError, match=f"photographs without the headset: .*{said}"):
        refuse_contradictions(station.checks)


@pytest.mark.parametrize(("scale", "refused"), [(1.004, False), (0.97, True)])
def test_a_board_printed_at_another_scale_is_named(scale, refused):
    checks = failed(Faults(printed_scale=scale))
    assert [check.value for check in checks] == pytest.approx([scale - 1, scale - 1], abs=5e-4)
    assert all("printed pitch" in check.sentence for check in checks)
    assert [check.contradictory for check in checks] == [refused, refused]


def test_slight_faults_warn_and_large_ones_stop():
    refuse_contradictions(station_of(bench(1, Faults(target_moved_in_sweep={0: SLIGHT}))).checks)
    with pytest.raises(BadInputError, match=r"sweep at target pose 0: the target moved between tracking/0a.png"):
        refuse_contradictions(station_of(bench(1, Faults(target_moved_in_sweep={0: SHIFT}))).checks)


def test_a_lens_that_is_not_this_cameras_is_named():
    made = bench(1)
    other = LensCamera(TRACKING.size_px, TRACKING.focal_px, TRACKING.centre_px, TRACKING.distortion + [0.2, 0, 0, 0, 0])
    check = lens_check("photographs by the tracking camera", poses_of(other, made.tracking))
    assert not check.ok
    assert "are not this camera's" in check.sentence
