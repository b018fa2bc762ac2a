"""Recordings of OpenXR poses."""

import json
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from wlr_render.errors import BadInputError
from wlr_render.geometry import transforms
from wlr_render.geometry.directions import arcmin_between, normalised
from wlr_render.numerics.arrays import FloatArray
from wlr_render.tracking.eye_trajectory_file import read_eye_trajectory
from wlr_render.tracking.head_trajectory_file import read_head_trajectory

HEADER = {"format": "wlr-openxr-recording", "version": 1}
DEVICE_FROM_VIEW = transforms.rigid(transforms.rotation_about("x", 0.2), np.array([0.001, -0.02, 0.03]))


def line(
    time_ns: int,
    space: str,
    base: str,
    position: tuple[float, float, float] = (0.0, 0.0, 0.0),
    turn: FloatArray | None = None,
    flags: int = 15,
) -> dict[str, Any]:
    xyzw = [0.0, 0.0, 0.0, 1.0] if turn is None else Rotation.from_matrix(turn).as_quat().tolist()
    pose = {"orientation": dict(zip("xyzw", xyzw, strict=True)), "position": dict(zip("xyz", position, strict=True))}
    return {"time": time_ns, "space": space, "base_space": base, "locationFlags": flags, "pose": pose}


def head(
    time_ns: int, position: tuple[float, float, float] = (0.0, 1.6, 0.0), turn: FloatArray | None = None, **others: Any
) -> dict[str, Any]:
    return line(time_ns, "view", "stage", position, turn, **others)


def eyes(time_ns: int) -> list[dict[str, Any]]:
    return [
        line(time_ns, f"{eye}_view", "view", (side * 0.0315, 0.0, 0.0)) for eye, side in (("left", -1), ("right", 1))
    ]


def recorded(folder: Path, *lines: object, **header: Any) -> Path:
    path = folder / "recording.jsonl"
    path.write_text("\n".join(map(json.dumps, [HEADER | header, *lines])) + "\n", encoding="utf-8")
    return path


def test_poses_of_the_head_are_those_of_view_space_moved_to_the_device(tmp_path: Path) -> None:
    turns = [transforms.rotation_about("y", angle) for angle in (0.0, 0.3)]
    places = [(0.1, 1.6, -0.2), (0.12, 1.61, -0.2)]
    lines = [head(10**9 * k, place, turn) for k, (place, turn) in enumerate(zip(places, turns, strict=True), start=5)]
    lines.insert(1, head(5_500_000_000, (9.0, 9.0, 9.0), flags=12))  # tracked, but not valid
    lines.insert(1, line(5_400_000_000, "left_hand", "stage"))
    found = read_head_trajectory(recorded(tmp_path, *lines, device_from_view=DEVICE_FROM_VIEW.tolist()))
    np.testing.assert_array_equal(found.time_s, [5.0, 6.0])
    for time, place, turn in zip((5.0, 6.0), places, turns, strict=True):
        view = transforms.apply(found.at(time), transforms.apply(DEVICE_FROM_VIEW, np.array([0.01, 0.02, -1.0])))
        expected = transforms.apply(transforms.rigid(turn, np.array(place)), np.array([0.01, 0.02, -1.0]))
        np.testing.assert_allclose(view, expected, atol=1e-12)


def test_a_recording_without_a_mounting_has_the_poses_of_tum_text(tmp_path: Path) -> None:
    turn = transforms.rotation_about("y", 0.3)
    found = read_head_trajectory(recorded(tmp_path, head(0, turn=turn), head(10**9)))
    (tmp_path / "head.tum").write_text(f"0 0 1.6 0 0 {np.sin(0.15)} 0 {np.cos(0.15)}\n1 0 1.6 0 0 0 0 1\n")
    np.testing.assert_allclose(
        found.at([0.0, 0.5, 1.0]), read_head_trajectory(tmp_path / "head.tum").at([0.0, 0.5, 1.0])
    )


def test_without_gaze_the_pupils_are_at_the_views(tmp_path: Path) -> None:
    path = recorded(tmp_path, *eyes(0), *eyes(10**9), device_from_view=DEVICE_FROM_VIEW.tolist())
    found = read_eye_trajectory(path)
    right = transforms.apply(DEVICE_FROM_VIEW, np.array([0.0315, 0.0, 0.0]))
    np.testing.assert_allclose(found.viewpoint_at("right", [0.0, 0.7]), [right, right], atol=1e-15)
    assert sorted(found.tracks) == ["left", "right"]


def test_with_gaze_each_eye_turns_to_the_point_a_metre_along_it(tmp_path: Path) -> None:
    turn = transforms.rotation_about("y", -0.3)
    gazes = [line(10**9 * k, "gaze", "view", (0.0, 0.01, 0.0), turn) for k in (0, 1)]
    found = read_eye_trajectory(recorded(tmp_path, *eyes(0), *eyes(10**9), *gazes))
    fixated = np.array([np.sin(0.3), 0.01, -np.cos(0.3)])
    for eye, side in (("left", -1), ("right", 1)):
        place = np.array([side * 0.0315, 0.0, 0.0])
        centre = place + [0.0, 0.0, 0.0105]
        pupil = found.viewpoint_at(eye, 0.5)
        assert np.linalg.norm(pupil - centre) == pytest.approx(0.0105)
        assert arcmin_between(normalised(pupil - centre), normalised(fixated - centre)) < 1e-6
        assert pupil[0] > place[0] + 0.002


def test_each_eye_turns_along_its_own_gaze(tmp_path: Path) -> None:
    """To the left eye's right and to the right eye's left: eyes that converge. The gaze of both eyes is not used."""
    gazes = [line(10**9 * k, "gaze", "view", turn=transforms.rotation_about("x", 0.4)) for k in (0, 1)]
    for eye, angle in (("left", -0.1), ("right", 0.2)):
        turn = transforms.rotation_about("y", angle)
        gazes += [line(10**9 * k, f"{eye}_gaze", "view", (0.3, 0.3, 0.3), turn) for k in (0, 1)]
    path = recorded(tmp_path, *eyes(0), *eyes(10**9), *gazes, device_from_view=DEVICE_FROM_VIEW.tolist())
    found = read_eye_trajectory(path)
    for eye, x, angle in (("left", -0.0315, 0.1), ("right", 0.0315, -0.2)):
        centre = transforms.apply(DEVICE_FROM_VIEW, np.array([x, 0.0, 0.0])) + [0.0, 0.0, 0.0105]
        pupil = centre + 0.0105 * DEVICE_FROM_VIEW[:3, :3] @ [np.sin(angle), 0.0, -np.cos(angle)]
        np.testing.assert_allclose(found.viewpoint_at(eye, 0.5), pupil, atol=1e-12)


def test_pupils_are_taken_as_they_are(tmp_path: Path) -> None:
    """Whatever their orientation, and without use of gaze or views; an eye that is shut makes a gap."""
    turn = transforms.rotation_about("y", -0.3)
    lines = [*eyes(0), *eyes(10**9), *(line(10**9 * k, "gaze", "view") for k in (0, 1))]
    for k in range(6):
        place = (0.033, 0.001 * k, -0.012)
        lines.append(line(10_000_000 * k, "right_pupil", "view", place, turn, 0 if k == 3 else 3))
    found = read_eye_trajectory(recorded(tmp_path, *lines, device_from_view=DEVICE_FROM_VIEW.tolist()))
    assert not found.unread
    expected = [transforms.apply(DEVICE_FROM_VIEW, np.array([0.033, 0.001 * k, -0.012])) for k in (0, 1.5, 5)]
    np.testing.assert_allclose(found.viewpoint_at("right", [0.0, 0.015, 0.05]), expected, atol=1e-12)
    np.testing.assert_allclose(found.gaps_at("right", np.array([0.015, 0.025])).length_s, [0, 0.02], atol=1e-12)
    assert sorted(found.tracks) == ["left", "right"]


@pytest.mark.parametrize(
    ("lines", "complaint"),
    [
        ([], "has no valid pose of 'view'"),
        ([head(0), head(0)], r"line 3: 'time' does not come after"),
        ([head(0), line(10**9, "view", "local")], "line 3: 'base_space' changes from local to stage"),
        ([head(0, flags=1), head(10**9, flags=12)], "has no valid pose of 'view'"),
        ([head(0), {**head(10**9), "time": "soon"}], "line 3: 'time' must be a number"),
        ([head(0), {**head(10**9), "pose": {}}], r"line 3 \[pose\]: key 'position' is missing"),
        ([head(0), head(10**9, (3000.0, 0, 0))], "3000"),
        ([head(0), head(10**9, (0.0, float("nan"), 0))], "line 3 .*'y' must be finite"),
        ([line(0, "gaze", "stage"), head(0)], "line 2: 'base_space' is 'stage'; it must be one of view"),
        (
            [head(0), {**head(1), "pose": {**head(1)["pose"], "orientation": dict.fromkeys("xyzw", 1.0)}}],
            "length 2, not 1",
        ),
    ],
)
def test_faults_name_the_line(tmp_path: Path, lines: Sequence[dict[str, Any]], complaint: str) -> None:
    with pytest.raises(BadInputError, match=complaint) as got:
        read_head_trajectory(recorded(tmp_path, *lines))
    assert "recording.jsonl" in str(got.value)


@pytest.mark.parametrize(
    ("lines", "header", "complaint"),
    [
        ([head(0), head(10**9)], {}, "has no pose of 'left_view' or 'right_view'"),
        ([*eyes(0), *eyes(10**9), line(0, "gaze", "view", turn=transforms.rotation_about("y", 3.0))], {}, "backwards"),
        (
            [*eyes(0), line(0, "left_gaze", "view", turn=transforms.rotation_about("x", 2.0)), *eyes(10**9)],
            {},
            "'left_gaze' looks backwards",
        ),
        ([*eyes(0), *eyes(10**9)], {"version": 2}, "has version 2; this program reads version 1"),
        ([*eyes(0), *eyes(10**9)], {"format": "other"}, "'format' is 'other'"),
        ([*eyes(0), *eyes(10**9)], {"device_from_view": [[2, 0, 0, 0]] * 4}, "must be a rigid transform"),
        ([*eyes(0), *eyes(10**9)], {"device_from_view": (np.eye(4) + np.eye(4, k=3) * 31).tolist()}, "31"),
    ],
)
def test_faults_of_eyes_and_header_are_named(
    tmp_path: Path, lines: Sequence[dict[str, Any]], header: dict[str, Any], complaint: str
) -> None:
    with pytest.raises(BadInputError, match=complaint):
        read_eye_trajectory(recorded(tmp_path, *lines, **header))


def test_what_is_no_json_is_named_by_its_line(tmp_path: Path) -> None:
    path = recorded(tmp_path, head(0))
    path.write_text(path.read_text() + "time, x, y, z\n")
    with pytest.raises(BadInputError, match=r"recording\.jsonl line 3: cannot be read as an OpenXR recording"):
        read_head_trajectory(path)
    path.write_text("\n")
    with pytest.raises(BadInputError, match="has no lines"):
        read_head_trajectory(path)


def test_invalid_poses_make_gaps(tmp_path: Path) -> None:
    lines = [head(k * 10_000_000, flags=1 if k == 3 else 15) for k in range(6)]
    lines += [each for k in range(6) for each in eyes(k * 10_000_000)]
    path = recorded(tmp_path, *lines)
    moments = np.array([0.015, 0.025, 0.035, 0.045])
    np.testing.assert_allclose(read_head_trajectory(path).gaps_at(moments).length_s, [0, 0.02, 0.02, 0], atol=1e-12)
    assert not read_eye_trajectory(path).gaps_at("left", moments).length_s.any()


def test_a_gaze_that_is_never_valid_is_named(tmp_path: Path) -> None:
    gazes = [line(10**9 * k, "gaze", "view", flags=0) for k in (0, 1)]
    found = read_eye_trajectory(recorded(tmp_path, *eyes(0), *eyes(10**9), *gazes))
    assert found.unread == ("gaze (no valid pose)",)
    np.testing.assert_allclose(found.viewpoint_at("left", 0.5), [-0.0315, 0, 0], atol=1e-12)  # its view's place


@pytest.mark.parametrize(("tracked", "expected"), [(15, [0, 1, 1, 1, 1, 0]), (7, [0] * 6)])
def test_valid_poses_that_are_not_tracked_are_inferred(tmp_path: Path, tracked: int, expected: list[int]) -> None:
    """They are kept. A runtime that never sets the bits, as for a simulated headset, tells nothing by them."""
    flags = [tracked, tracked, 3, 7, tracked, tracked]
    path = recorded(tmp_path, *(head(k * 10_000_000, (0.001 * k, 0, 0), flags=each) for k, each in enumerate(flags)))
    found = read_head_trajectory(path)
    moments = np.array([0.01 + 1e-9, 0.015, 0.02, 0.03, 0.035, 0.04 - 1e-9])  # nearly at samples that are tracked
    np.testing.assert_array_equal(found.is_inferred_at(moments), expected)
    np.testing.assert_allclose(found.at(moments)[:, 0, 3], 0.1 * moments, atol=1e-12)
    assert not found.gaps_at(moments).length_s.any()
