from pathlib import Path

import numpy as np
import pytest

from wlr_render.errors import BadInputError
from wlr_render.geometry import transforms
from wlr_render.tracking import synthetic
from wlr_render.tracking.eye_model import RotatingEye
from wlr_render.tracking.eye_trajectory_file import read_eye_trajectory, write_eye_trajectory
from wlr_render.tracking.head_trajectory_file import read_head_trajectory, write_head_trajectory_tum
from wlr_render.tracking.trajectory import EyeTrajectory, GazeTrack, ViewpointTrack

EYE_HEADER = "# format: wlr-eye-trajectory 1\n# kind: viewpoint\n# frame: openxr-device\n# units: s m\n"
GAZE_HEADER = EYE_HEADER.replace("viewpoint", "gaze") + "# rotation_centre_left_m: -0.03 0 -0.02\n"


def written(folder: Path, text: str) -> Path:
    path = folder / "track.txt"
    path.write_text(text, encoding="utf-8")
    return path


def test_tum_round_trip(tmp_path):
    head = synthetic.head_motion(3, duration_s=1.0)
    back = read_head_trajectory(write_head_trajectory_tum(tmp_path / "head.tum", head))
    np.testing.assert_array_equal(back.time_s, head.time_s)
    np.testing.assert_array_equal(back.position_in_world, head.position_in_world)
    np.testing.assert_allclose(back.world_from_device_xyzw, head.world_from_device_xyzw, atol=1e-15)


def test_tum_and_euroc_of_one_motion_agree(tmp_path):
    tum = written(tmp_path, "# comment\n\n1.0 1 2 3 0 0.6 0 0.8\n1.5\t2 2 3 0 0 0 1\n")
    first = read_head_trajectory(tum)
    biases = ",0" * 9
    euroc = written(
        tmp_path,
        "#timestamp [ns],p_RS_R_x [m],...\n"
        f"1000000000, 1, 2, 3, 0.8, 0, 0.6, 0{biases}\n1500000000,2,2,3,1,0,0,0{biases}\n",
    )
    second = read_head_trajectory(euroc)
    np.testing.assert_allclose(second.at([1.0, 1.2, 1.5]), first.at([1.0, 1.2, 1.5]), atol=1e-15)
    quarter = transforms.apply(first.at(1.0), np.array([0, 0, -1.0])) - [1, 2, 3]
    np.testing.assert_allclose(quarter, [-0.96, 0, -0.28], atol=1e-15)


def test_euroc_as_monado_writes_it_is_read(tmp_path):
    """Its recorder ends lines with CR LF, and pads nothing."""
    path = tmp_path / "data.csv"
    rows = "#timestamp [ns],p_RS_R_x [m]\r\n1000000000,1,2,3,0.8,0,0.6,0\r\n1500000000,2,2,3,1,0,0,0\r\n"
    path.write_bytes(rows.encode())
    np.testing.assert_allclose(read_head_trajectory(path).position_in_world, [[1, 2, 3], [2, 2, 3]])


def test_a_quaternion_rounded_in_print_is_normalised(tmp_path):
    head = read_head_trajectory(written(tmp_path, "0 0 0 0 0 0.6004 0 0.8\n1 0 0 0 0 0 0 1\n"))
    np.testing.assert_allclose(np.linalg.norm(head.world_from_device_xyzw, axis=1), 1, atol=1e-15)


GOOD = "0 0 0 0 0 0 0 1\n"


@pytest.mark.parametrize(
    ("text", "complaint"),
    [
        ("", "no rows"),
        ("# only a comment\n", "no rows"),
        (GOOD + "1 0 0 0 0 0 1\n", "line 2: 7 columns where 8 are expected"),
        ("0,0,0,0,1,0,0,0,9\n", "line 1: 9 columns where 8 or 17"),
        (GOOD + "\n1 0 nan 0 0 0 0 1\n", "line 3: column 3 is nan"),
        (GOOD + "1 0 inf 0 0 0 0 1\n", "line 2: column 3 is inf"),
        (GOOD + "1 0 x 0 0 0 0 1\n", "line 2: column 3 is 'x', not a number"),
        (GOOD + "1 0 0 0 0 0 0 0.9\n", "line 2: the quaternion has length 0.9, not 1"),
        (GOOD + "1 0 0 0 0 0 0 0\n", "line 2: the quaternion has length 0"),
        (GOOD + "0 0 0 0 0 0 0 1\n", "line 2: time 0 does not come after"),
        (GOOD + "-1 0 0 0 0 0 0 1\n", "line 2: time -1 does not come after"),
        (GOOD, "at least two samples"),
        (GOOD + "1 0 0 1600 0 0 0 1\n", "a position has a length of 1600 m, more than the plausible 1000 m"),
        (GOOD + "1e308 0 0 0 0 0 0 1\n", "a time is 1e+308 s, more than 1e+11 s"),
        (GOOD + "1 0 0 300 0 0 0 1\n", "moves at 300 m/s, faster than"),
        (GOOD + "".join(f"{t} 0 0 0 0 0 0 1\n" for t in (33, 67, 100, 133)), "has a row every 33 s, more than"),
        (GOOD + "1 0 0 " + 9000 * "x" + " 0 0 0 1\n", "...xxxxxxxx"),
        (2_000_001 * "\n", "has 2000001 lines, more than 2000000"),
        ("1.5,0,0,0,1,0,0,0\n", "line 1: time '1.5' is not in integer nanoseconds"),
    ],
)
def test_a_faulty_head_file_is_refused_with_its_line(tmp_path, text, complaint):
    path = written(tmp_path, text)
    with pytest.raises(BadInputError, match=r"track\.txt") as caught:
        read_head_trajectory(path)
    assert complaint in str(caught.value)


def test_a_missing_or_binary_file_is_refused(tmp_path):
    with pytest.raises(BadInputError, match=r"none\.tum: there is no such file"):
        read_head_trajectory(tmp_path / "none.tum")
    (tmp_path / "binary.tum").write_bytes(bytes([0xFF, 0xFE, 0x80]))
    with pytest.raises(BadInputError, match="line 1 is not UTF-8 text, so this is not a trajectory"):
        read_head_trajectory(tmp_path / "binary.tum")


def test_gaze_round_trip(tmp_path):
    eyes = synthetic.eye_motion({"left": np.array([-0.03, 0, -0.02]), "right": np.array([0.03, 0, -0.02])}, 5, 1.0)
    back = read_eye_trajectory(write_eye_trajectory(tmp_path / "gaze.txt", eyes))
    moment = np.linspace(0, 1, 77)
    for eye in ("left", "right"):
        np.testing.assert_allclose(back.viewpoint_at(eye, moment), eyes.viewpoint_at(eye, moment), atol=1e-17)


def test_viewpoint_round_trip_of_eyes_sampled_at_different_times(tmp_path):
    rng = np.random.default_rng(6)
    left = ViewpointTrack(np.array([0.0, 0.3, 1.0]), 0.01 * rng.normal(size=(3, 3)))
    right = ViewpointTrack(np.array([0.1, 0.3]), 0.01 * rng.normal(size=(2, 3)))
    back = read_eye_trajectory(
        write_eye_trajectory(tmp_path / "eyes.txt", EyeTrajectory({"right": right, "left": left}))
    )
    np.testing.assert_array_equal(back.viewpoint_at("left", [0.0, 0.5]), left.viewpoint_at([0.0, 0.5]))
    np.testing.assert_array_equal(back.viewpoint_at("right", [0.1, 0.2]), right.viewpoint_at([0.1, 0.2]))


def test_a_gaze_file_states_its_eye_model(tmp_path):
    rows = "0 left 0 0 -1\n1 left 0 0 -1\n"
    default = read_eye_trajectory(written(tmp_path, GAZE_HEADER + rows))
    np.testing.assert_allclose(default.viewpoint_at("left", 0.5), [-0.03, 0, -0.0305], atol=1e-17)
    stated = read_eye_trajectory(written(tmp_path, GAZE_HEADER + "# pupil_distance_m: 0.012\n" + rows))
    np.testing.assert_allclose(stated.viewpoint_at("left", 0.5), [-0.03, 0, -0.032], atol=1e-17)


@pytest.mark.parametrize(
    ("text", "complaint"),
    [
        (EYE_HEADER, "no rows"),
        (EYE_HEADER + "0 left 0 0\n", "line 5: 4 columns where 5"),
        (EYE_HEADER + "0 middle 0 0 0\n", "line 5: unknown eye 'middle'"),
        (EYE_HEADER + "0 left 0 nan 0\n", "line 5: column 4 is nan"),
        (EYE_HEADER + "0 left -32 0 0\n", "a position has a length of 32 m, more than the plausible 0.5 m"),
        (GAZE_HEADER.replace("0.03", "30") + "0 left 0 0 -1\n", "rotation_centre_left_m:' has a length of 30 m"),
        (GAZE_HEADER + "# pupil_distance_m: -0.01\n0 left 0 0 -1\n", "is -0.01; it must lie between 0 and 0.03"),
        (EYE_HEADER + "0 left 0 0 0\n1 right 0 0 0\n0 left 0 0 0\n", "line 7: time 0 does not come after"),
        (EYE_HEADER.replace("1\n", "2\n", 1) + "0 left 0 0 0\n", "header '# format:' is 'wlr-eye-trajectory 2'"),
        (EYE_HEADER.replace("openxr", "opencv") + "0 left 0 0 0\n", "header '# frame:' is 'opencv-device'"),
        (EYE_HEADER.replace("s m", "s mm") + "0 left 0 0 0\n", "header '# units:' is 's mm'"),
        (EYE_HEADER.replace("# kind: viewpoint\n", "") + "0 left 0 0 0\n", "header '# kind:' is missing"),
        (GAZE_HEADER + "0 left 0 0 -1.1\n", "line 6: the gaze has length 1.1"),
        (GAZE_HEADER + "0 left 0 0 1\n", "line 6: the gaze looks backwards"),
        (GAZE_HEADER + "0 right 0 0 -1\n1 right 0 0 -1\n", "header '# rotation_centre_right_m:' must state 3"),
        (GAZE_HEADER + "# pupil_distance_m: far\n0 left 0 0 -1\n1 left 0 0 -1\n", "header '# pupil_distance_m:' must"),
    ],
)
def test_a_faulty_eye_file_is_refused(tmp_path, text, complaint):
    path = written(tmp_path, text)
    with pytest.raises(BadInputError, match=r"track\.txt") as caught:
        read_eye_trajectory(path)
    assert complaint in str(caught.value)


def test_one_file_cannot_hold_two_kinds_of_eye(tmp_path):
    time_s, xyz = np.array([0.0, 1.0]), np.array([[0, 0, -1.0], [0, 0, -1.0]])
    mixed = {"left": ViewpointTrack(time_s, xyz), "right": GazeTrack(time_s, xyz, RotatingEye(np.zeros(3)))}
    with pytest.raises(BadInputError, match="of one kind"):
        write_eye_trajectory(tmp_path / "eyes.txt", EyeTrajectory(mixed))
