from pathlib import Path

import numpy as np
import pytest
from present import narrowed

from wlr_render.errors import BadInputError
from wlr_render.geometry import transforms
from wlr_render.io.delimited_text import cells_of
from wlr_render.tracking import synthetic
from wlr_render.tracking.eye_model import RotatingEye
from wlr_render.tracking.eye_trajectory_file import read_eye_trajectory, write_eye_trajectory
from wlr_render.tracking.head_trajectory_file import read_head_trajectory, write_head_trajectory_tum
from wlr_render.tracking.trajectory import EyeTrack, EyeTrajectory, GazeTrack, ViewpointTrack

EYE_HEADER = "# format: wlr-eye-trajectory 1\n# kind: viewpoint\n# frame: openxr-device\n# units: s m\n"
GAZE_HEADER = EYE_HEADER.replace("viewpoint", "gaze") + "# rotation_centre_left_m: -0.03 0 -0.02\n"


def written(folder: Path, text: str) -> Path:
    path = folder / "track.txt"
    path.write_text(text, encoding="utf-8")
    return path


def test_tum_round_trip(tmp_path: Path) -> None:
    head = synthetic.head_motion(3, duration_s=1.0)
    back = read_head_trajectory(write_head_trajectory_tum(tmp_path / "head.tum", head))
    np.testing.assert_array_equal(back.time_s, head.time_s)
    np.testing.assert_array_equal(back.position_in_world, head.position_in_world)
    np.testing.assert_allclose(back.world_from_device_xyzw, head.world_from_device_xyzw, atol=1e-15)


def test_tum_and_euroc_of_one_motion_agree(tmp_path: Path) -> None:
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


def test_euroc_as_monado_writes_it_is_read(tmp_path: Path) -> None:
    """Its recorder ends lines with CR LF, and pads nothing."""
    path = tmp_path / "data.csv"
    rows = "#timestamp [ns],p_RS_R_x [m]\r\n1000000000,1,2,3,0.8,0,0.6,0\r\n1500000000,2,2,3,1,0,0,0\r\n"
    path.write_bytes(rows.encode())
    np.testing.assert_allclose(read_head_trajectory(path).position_in_world, [[1, 2, 3], [2, 2, 3]])


def test_a_quaternion_rounded_in_print_is_normalised(tmp_path: Path) -> None:
    head = read_head_trajectory(written(tmp_path, "0 0 0 0 0 0.6004 0 0.8\n1 0 0 0 0 0 0 1\n"))
    np.testing.assert_allclose(np.linalg.norm(head.world_from_device_xyzw, axis=1), 1, atol=1e-15)


POSES = [[0, 0.01, 2, 3, 0, 0.6, 0, 0.8], [0.5, 0.02, 2, 3, 0, 0, 0, 1]]
"""Time, position and quaternion xyzw."""
NAMES = ("time", "x", "y", "z", "qx", "qy", "qz", "qw")


def table(
    header: str,
    separator: str = ",",
    order: range | tuple[int, ...] = range(8),
    scale: tuple[float, int] = (1, 1),
    lead: str = "",
    comma: bool = False,
    ends: str = "\n",
) -> str:
    """POSES as a table with a header; `order` of the columns, `scale` of times and lengths."""
    rows = (np.array(POSES) * [scale[0], *[scale[1]] * 3, 1, 1, 1, 1]).tolist()
    lines = [separator.join(f"{row[column]:.12g}" for column in order) for row in rows]
    return lead + header + ends + ends.join(line.replace(".", ",") if comma else line for line in lines) + ends


WXYZ = (0, 1, 2, 3, 7, 4, 5, 6)
EUROC = "timestamp [ns],p_RS_R_x [m],p_RS_R_y [m],p_RS_R_z [m],q_RS_w [],q_RS_x [],q_RS_y [],q_RS_z []"
NS = (10**9, 1)


@pytest.mark.parametrize(
    "text",
    [
        table("#timestamp [ns],tx [m],ty [m],tz [m],qx,qy,qz,qw", scale=NS),
        table("timestamp_ns,x,y,z,qx,qy,qz,qw", scale=NS),
        table("#" + EUROC, order=WXYZ, scale=NS),
        table("#" + EUROC.replace(" [ns]", ""), order=WXYZ, scale=NS),
        table("time_ms,head_x,head_y,head_z,head_qw,head_qx,head_qy,head_qz", order=WXYZ, scale=(1000, 1)),
        table(EUROC, order=WXYZ, scale=NS),
        table(EUROC.replace(",", ", "), order=WXYZ, scale=NS),
        table("time,x,y,z,qx,qy,qz,qw"),
        table('"Time (s)","Pos.X (mm)","Pos.Y (mm)","Pos.Z (mm)","Rot.X","Rot.Y","Rot.Z","Rot.W"', scale=(1, 1000)),
        table("qw,qx,qy,qz,z_cm,y_cm,x_cm,t_us", order=(7, 4, 5, 6, 3, 2, 1, 0), scale=(1e6, 100)),
        table("t [ms] tx ty tz qw qx qy qz", " ", WXYZ, (1e3, 1)),
        table("# timestamp tx ty tz qw qx qy qz", " ", WXYZ, lead="# ground truth\n"),
        table("# time_s, x_m, y_m, z_m, qw, qx, qy, qz", "\t", WXYZ),
        table("# time, x, y, z, qw, qx, qy, qz", " ", WXYZ),
        table("# time; x; y; z; qw; qx; qy; qz", " ", WXYZ),
        table("# Columns: time x y z qw qx qy qz", " ", WXYZ),
        table("# format: `time x y z qw qx qy qz`", " ", WXYZ),
        table("# format: time tx ty tz qw qx qy qz", " ", WXYZ),
        table("# Poses (time [x y z] [qw qx qy qz]), in metres.", " ", WXYZ),
        table("# time_s, x_mm, y_mm, z_mm, qx, qy, qz, qw", " ", scale=(1, 1000)),
        table("# time_s x_mm y_mm z_mm qx qy qz qw; poses of the device", " ", scale=(1, 1000)),
        table("time_s ,x_m ,y_m ,z_m ,qx ,qy ,qz ,qw", " ,"),
        table("time_s;x_m;y_m;z_m;qx;qy;qz;qw", ";", comma=True, lead="\ufeff", ends="\r\n"),
        table("time_s;x_m;y_m;z_m;qx;qy;qz;qw", ";", comma=True, lead="sep=;\n"),
        table("time_s\tx_m\ty_m\tz_m\tqx\tqy\tqz\tqw", "\t", comma=True),
        table("time_s x_m y_m z_m qx qy qz qw", " ", comma=True),
        table("%time,pose.position.x,pose.position.y,pose.position.z,pose.orientation.x,pose.orientation.y,"
              "pose.orientation.z,pose.orientation.w", lead="\n\n"),
        'time_s,x,y,z,qx,qy,qz,qw\n0,"0,01",2,3,0,"0,6",0,"0,8"\n"0,5","0,02",2,3,0,0,0,1\n',
        "time_s,frame,x,y,z,qx,qy,qz,qw\n0,7,1e-2,+2,3.,0,.6,0,8E-1,\n.5,8,0.02,2,3,-0,0,0,-1,\n",
    ],
)  # fmt: skip
def test_a_header_decides_what_the_columns_are(tmp_path: Path, text: str) -> None:
    path = tmp_path / "track.txt"
    path.write_bytes(text.encode())
    head = read_head_trajectory(path)
    np.testing.assert_allclose(head.time_s, [0, 0.5], rtol=1e-12)
    np.testing.assert_allclose(head.position_in_world, np.array(POSES)[:, 1:4], rtol=1e-12)
    again = head.world_from_device_xyzw * [[1], [np.sign(head.world_from_device_xyzw[1, 3])]]
    np.testing.assert_allclose(again, np.array(POSES)[:, 4:], atol=1e-12)


def test_an_eye_track_of_ours_may_have_decimal_commas(tmp_path: Path) -> None:
    for row in (
        "{},5;right;0,0300;0,0001;-0,03\n",
        "{},5 right 0,0300 0,0001 -0,03\n",
        "{}.5\tright\t0.03\t1e-4\t-.03\n",
    ):
        eyes = read_eye_trajectory(written(tmp_path, EYE_HEADER + row.format(0) + row.format(1)))
        np.testing.assert_allclose(eyes.viewpoint_at("right", 1.0), [0.03, 0.0001, -0.03])


def test_columns_that_are_not_read_are_named(tmp_path: Path) -> None:
    row = "0,1,2,3,0,0,0,1,9,9\n"
    header = "time_s,x,y,z,qx,qy,qz,qw,confidence,v_RS_R_x [m s^-1]\n"
    assert read_head_trajectory(written(tmp_path, header + row + "1" + row[1:])).unread == ("confidence",)
    text = "time_s,eye,x_m,y_m,z_m,pupil_diameter_mm\n0,left,0,0,0,4\n1,left,0,0,0,4\n"
    assert read_eye_trajectory(written(tmp_path, text)).unread == ("pupil_diameter_mm",)
    assert read_head_trajectory(written(tmp_path, GOOD + "1" + GOOD[1:])).unread == ()


def test_nanoseconds_since_1970_are_not_rounded_before_they_are_divided(tmp_path: Path) -> None:
    stamps = [1403715273262142976, 1403715273267142976, 1403715273272142976]
    for header in ("#timestamp_ns,x,y,z,qx,qy,qz,qw", "timestamp,x,y,z,qx,qy,qz,qw"):
        rows = "".join(f"{stamp},0,0,0,0,0,0,1\n" for stamp in stamps)
        head = read_head_trajectory(written(tmp_path, f"{header}\n{rows}"))
        assert head.time_s.tolist() == [stamp / 10**9 for stamp in stamps]


def test_of_two_times_the_stamp_or_the_finer_unit_is_read(tmp_path: Path) -> None:
    pose = ",0,0,0,0,0,0,1\n"
    names = [f"field.pose.position.{axis}" for axis in "xyz"] + [f"field.pose.orientation.{axis}" for axis in "xyzw"]
    ros = ",".join(("%time,field.header.seq,field.header.stamp,field.header.frame_id", *names))
    rows = [f"{2 * 10**18 + n * 10**9},{n},{10**18 + n * 10**9},map{pose}" for n in (1, 2)]
    head = read_head_trajectory(written(tmp_path, ros + "\n" + "".join(rows)))
    assert head.time_s.tolist() == [1e9 + 1, 1e9 + 2]
    assert head.unread == ("%time", "field.header.seq", "field.header.frame_id")
    for first, second in (("time_s", "time_ns"), ("time_ns", "time_s")):
        pairs = [
            (f"{n}" if first == "time_s" else f"{n}250000000", f"{n}250000000" if first == "time_s" else f"{n}")
            for n in (1, 2)
        ]
        text = f"{first},{second},x,y,z,qx,qy,qz,qw\n" + "".join(",".join(pair) + pose for pair in pairs)
        head = read_head_trajectory(written(tmp_path, text))
        assert head.time_s.tolist() == [1.25, 2.25]
        assert head.unread == ("time_s",)


@pytest.mark.parametrize("names", ["stamp_sec,stamp_nsec", "time_s,time_ns", "system_time_s,device_time_s"])
def test_of_two_times_that_are_not_the_same_moments_none_is_chosen(tmp_path: Path, names: str) -> None:
    rows = "".join(f"{100 + n},{n}00000000,0,0,0,0,0,0,1\n" for n in (1, 2))
    with pytest.raises(BadInputError, match="are both time; keep one"):
        read_head_trajectory(written(tmp_path, f"{names},x,y,z,qx,qy,qz,qw\n{rows}"))


def test_quotes_that_no_table_has_are_refused_with_their_line(tmp_path: Path) -> None:
    text = 'time_s,x,y,z,qx,qy,qz,qw\n0,0,0,0,0,0,0,"' + 200_000 * "1"
    with pytest.raises(BadInputError, match=r"track\.txt line 2: "):
        read_head_trajectory(written(tmp_path, text))
    assert cells_of('0,"1"\r,2', ",") == ("0", "1", "2")


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
        ("time_s,x,y,z,qx,qy,qz\n0,0,0,0,0,0,0\n", "the columns time_s, x, y, z, qx, qy, qz lack qw; name them as"),
        ("#time_s,x,y,z,qx,qy,qz,angle\n0,0,0,0,0,0,0,1\n", "lack qw"),
        ("time_s,x,y,z,qx,qy,qz,qw,q_w\n0,0,0,0,0,0,0,1,1\n", "the columns 'qw' and 'q_w' are both qw; keep one"),
        ("time_h,x,y,z,qx,qy,qz,qw\n0,0,0,0,0,0,0,1\n", "column 'time_h' is in h, which is not read; convert it"),
        ("time_s,x_in,y,z,qx,qy,qz,qw\n0,0,0,0,0,0,0,1\n", "column 'x_in' is in in, which is not read"),
        ("time_s,x,y,z,qx,qy,qz,qw\n0,0,0,0,0,0,1\n", "line 2: 7 columns where 8 are expected (as its header names)"),
        ("time_s,x,y,z,qx,qy,qz,qw\n0,0,0,0,0,0,0,1\n0,0,0,0,0,0,0,1\n", "line 3: time 0 does not come after"),
        ("qx,qy,qz,qw,x,y,z,t_s\n0,0,0,1,0,0,0,5\n0,0,0,1,0,0,0,4\n", "line 3: time 4 does not come after"),
        ("time_s,x,y,z,qx,qy,qz,qw\n0,0,0,0,0,0,0,1.1\n", "line 2: the quaternion has length 1.1, not 1"),
        ("time_s,x,y,z,qx,qy,qz,qw\n0,0,,0,0,0,0,1\n", "line 2: column 3 is '', not a number"),
        ("timestamp_ns,x,y,z,qx,qy,qz,qw\n0.5,0,0,0,0,0,0,1\n", "line 2: time '0.5' is not in integer nanoseconds, as"),
        ("timestamp,x,y,z,qx,qy,qz,qw\n1403715273262,0,0,0,0,0,0,1\n1403715273267,0,0,0,0,0,0,1\n", "a time is 1.4"),
        ("1 0 0 0 0 1 0 0 0 0 1 0\n", "line 1: 12 columns, as KITTI's poses, which have no times; write TUM"),
        ("1,0,0,0,0,1,0,0,0,0,1,0\n", "line 1: 12 columns, as KITTI's poses"),
        (
            "# time x y z, then qw qx qy qz\n0 0 0 0 1 0 0 0\n",
            "the comment 'time x y z then qw qx qy qz' names parts of",
        ),
        (
            "# quaternions are qw qx qy qz\n0 0 0 0 1 0 0 0\n",
            "but not each of the 8 columns; name them all in one line",
        ),
        ("# t x y z q0 q1 q2 q3\n0 0 0 0 1 0 0 0\n", "lack qx, qy, qz, qw"),
        ("time_s,x,y,z,qx,qy,qz,qw\n", "no rows"),
    ],
)
def test_a_faulty_head_file_is_refused_with_its_line(tmp_path: Path, text: str, complaint: str) -> None:
    path = written(tmp_path, text)
    with pytest.raises(BadInputError, match=r"track\.txt") as caught:
        read_head_trajectory(path)
    assert complaint in str(caught.value)


def test_a_missing_or_binary_file_is_refused(tmp_path: Path) -> None:
    with pytest.raises(BadInputError, match=r"none\.tum: there is no such file"):
        read_head_trajectory(tmp_path / "none.tum")
    (tmp_path / "binary.tum").write_bytes(bytes([0xFF, 0xFE, 0x80]))
    with pytest.raises(BadInputError, match="line 1 is not UTF-8 text, so this is not a trajectory"):
        read_head_trajectory(tmp_path / "binary.tum")


def test_gaze_round_trip(tmp_path: Path) -> None:
    eyes = synthetic.eye_motion({"left": np.array([-0.03, 0, -0.02]), "right": np.array([0.03, 0, -0.02])}, 5, 1.0)
    back = read_eye_trajectory(write_eye_trajectory(tmp_path / "gaze.txt", eyes))
    moment = np.linspace(0, 1, 77)
    for eye in ("left", "right"):
        np.testing.assert_allclose(back.viewpoint_at(eye, moment), eyes.viewpoint_at(eye, moment), atol=1e-17)


def test_viewpoint_round_trip_of_eyes_sampled_at_different_times(tmp_path: Path) -> None:
    rng = np.random.default_rng(6)
    left = ViewpointTrack(np.array([0.0, 0.3, 1.0]), 0.01 * rng.normal(size=(3, 3)))
    right = ViewpointTrack(np.array([0.1, 0.3]), 0.01 * rng.normal(size=(2, 3)))
    back = read_eye_trajectory(
        write_eye_trajectory(tmp_path / "eyes.txt", EyeTrajectory({"right": right, "left": left}))
    )
    np.testing.assert_array_equal(back.viewpoint_at("left", [0.0, 0.5]), left.viewpoint_at([0.0, 0.5]))
    np.testing.assert_array_equal(back.viewpoint_at("right", [0.1, 0.2]), right.viewpoint_at([0.1, 0.2]))


def test_a_gaze_file_states_its_eye_model(tmp_path: Path) -> None:
    rows = "0 left 0 0 -1\n1 left 0 0 -1\n"
    default = read_eye_trajectory(written(tmp_path, GAZE_HEADER + rows))
    np.testing.assert_allclose(default.viewpoint_at("left", 0.5), [-0.03, 0, -0.0305], atol=1e-17)
    stated = read_eye_trajectory(written(tmp_path, GAZE_HEADER + "# pupil_distance_m: 0.012\n" + rows))
    np.testing.assert_allclose(stated.viewpoint_at("left", 0.5), [-0.03, 0, -0.032], atol=1e-17)


PUPILS = "time_s,left_x_mm,left_y_mm,left_z_mm,right_x_mm,right_y_mm,right_z_mm"


@pytest.mark.parametrize(
    "text",
    [
        PUPILS + "\n0,-32,1,-30,32,1,-30\n0.5,-33,1,-30,32,1,-30\n",
        "# " + PUPILS + "\n0,-32,1,-30,32,1,-30\n0.5,-33,1,-30,32,1,-30\n",
        PUPILS.replace(",", ";") + "\n0,0;-32,0;1;-30;32;1;-30\n0,5;-33;1;-30;32;1;-30\n",
        PUPILS + "\n0,-32,1,-30,32,1,-30\n0.25,nan,nan,nan,,,\n0.5,-33,1,-30,32,1,-30\n",
        PUPILS.replace("time_s", "frame,timestamp_ns") + "\n7,0,-32,1,-30,32,1,-30\n8,500000000,-33,1,-30,32,1,-30\n",
        "time_s,eye,x_m,y_m,z_m\n0,L,-.032,.001,-.03\n0,R,.032,.001,-.03\n.5,L,-.033,.001,-.03\n.5,R,.032,.001,-.03\n",
        "time_s,x_left_mm,y_left_mm,z_left_mm,x_right_mm,y_right_mm,z_right_mm\n0,-32,1,-30,32,1,-30\n0.5,-33,1,-30,32,1,-30\n",
        "t_ms,eye,x_m,y_m,z_m\n0,left,-.032,.001,-.03\n0,right,.032,.001,-.03\n500,Left,-.033,.001,-.03\n"
        "500,right,.032,.001,-.03\n",
        "Time (s),Left Pupil X (cm),Left Pupil Y (cm),Left Pupil Z (cm),right_pupil_x [m],right_pupil_y [m],"
        "right_pupil_z [m]\n0,-3.2,.1,-3,.032,.001,-.03\n.5,-3.3,.1,-3,.032,.001,-.03\n",
    ],
)
def test_a_pupil_table_with_named_columns_is_read(tmp_path: Path, text: str) -> None:
    eyes = read_eye_trajectory(written(tmp_path, text))
    np.testing.assert_allclose(eyes.viewpoint_at("left", [0, 0.5]), [[-0.032, 0.001, -0.03], [-0.033, 0.001, -0.03]])
    np.testing.assert_allclose(eyes.viewpoint_at("right", 0.5), [0.032, 0.001, -0.03])


def test_an_eye_of_which_no_position_is_named_is_not_asked_for(tmp_path: Path) -> None:
    text = "time_s,left_x_mm,left_y_mm,left_z_mm,right_confidence\n0,-32,1,-30,0.5\n1,-32,1,-30,0.5\n"
    eyes = read_eye_trajectory(written(tmp_path, text))
    assert list(eyes.tracks) == ["left"]
    assert eyes.unread == ("right_confidence",)


def test_an_eye_without_numbers_was_not_tracked(tmp_path: Path) -> None:
    row = ",-32,1,-30,32,1,-30\n"
    text = f"{PUPILS}\n0{row}0.1,,,,32,1,-30\n0.2{row}0.3{row}"
    eyes = read_eye_trajectory(written(tmp_path, text))
    assert narrowed(eyes.tracks["left"], ViewpointTrack).invalid_s.tolist() == [0.1]
    assert eyes.tracks["left"].time_s.tolist() == [0, 0.2, 0.3]
    assert eyes.tracks["right"].time_s.tolist() == [0, 0.1, 0.2, 0.3]


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
        (PUPILS[:-5] + "\n0,-32,1,-30,32,1,-30\n", "lack right_z; name them as docs/files.md does"),
        (PUPILS.replace("left_x_mm", "left_x") + "\n0,0,0,0,0,0,0\n", "'left_x' has no unit; name it left_x_m, or"),
        (PUPILS.replace("time_s", "time") + "\n0,0,0,0,0,0,0\n", "'time' has no unit; name it time_s, or"),
        ("time_s,x_mm,y_mm,z_mm\n0,0,0,0\n", "lack eye"),
        ("time_s,eye,x_mm,y_mm,z_mm\n0,middle,0,0,0\n", "line 2: unknown eye 'middle'"),
        (PUPILS + "\n0,1,,3,4,5,6\n", "line 2: column 3 is '', not a number"),
        (PUPILS.replace("mm", "m") + "\n0,-32,0,0,0,0,0\n1,-32,0,0,0,0,0\n", "a position has a length of 32 m"),
        (PUPILS + "\n0,,,,,,\n", "has no position of an eye"),
        (PUPILS + "\n1,0,0,0,0,0,0\n0,0,0,0,0,0,0\n", "line 3: time 0 does not come after"),
        ("0,1,2,3\n", "or name its columns in the first line, such as time_s,left_x_mm,left_y_mm,left_z_mm"),
    ],
)
def test_a_faulty_eye_file_is_refused(tmp_path: Path, text: str, complaint: str) -> None:
    path = written(tmp_path, text)
    with pytest.raises(BadInputError, match=r"track\.txt") as caught:
        read_eye_trajectory(path)
    assert complaint in str(caught.value)


def test_one_file_cannot_hold_two_kinds_of_eye(tmp_path: Path) -> None:
    time_s, xyz = np.array([0.0, 1.0]), np.array([[0, 0, -1.0], [0, 0, -1.0]])
    mixed: dict[str, EyeTrack] = {
        "left": ViewpointTrack(time_s, xyz),
        "right": GazeTrack(time_s, xyz, RotatingEye(np.zeros(3))),
    }
    with pytest.raises(BadInputError, match="of one kind"):
        write_eye_trajectory(tmp_path / "eyes.txt", EyeTrajectory(mixed))


def test_a_comment_with_the_usual_order_of_the_quaternion_is_no_header(tmp_path: Path) -> None:
    path = tmp_path / "head.tum"
    path.write_text("# position, then quaternion: qx qy qz qw\n0 1 2 3 1 0 0 0\n1 1 2 3 1 0 0 0\n")
    np.testing.assert_array_equal(read_head_trajectory(path).world_from_device_xyzw[0], [1, 0, 0, 0])
