"""Views written here in the foreign format come back as they were."""

from collections.abc import Iterable, Sequence
from pathlib import Path

import numpy as np

from benchmarks.published_data import itoh_seethrough
from benchmarks.published_data.itoh_seethrough import SeeThroughPairs, read_itoh_seethrough
from wlr_render.geometry import transforms
from wlr_render.numerics.arrays import FloatArray

DOTS = np.array([[0, 0, 0], [0.08, 0, 0], [0.04, 0.05, 0], [0.12, 0.05, 0], [0.02, 0.2, 0.0]])
TIME_NS = 1418587733287467791


def archive(time_ns: int, tokens: Sequence[float]) -> str:
    return " ".join(["22 serialization::archive 9 0 0", str(time_ns), *[str(token) for token in tokens]]) + "\n"


def points(values: FloatArray) -> list[float]:
    return [0, 0, len(values), 0, 0, 0, *np.ravel(values)]


def pose(quaternion: Iterable[float], translation: Iterable[float]) -> list[float]:
    return [0, 0, 0, 0, *quaternion, 0, 0, *translation]


def matrix(quaternion: FloatArray, translation: Sequence[float]) -> FloatArray:
    return transforms.rigid(transforms.rotation_of_quaternion(np.array(quaternion)), np.array(translation))


def quaternion_about(axis: str, angle: float) -> FloatArray:
    return np.append(np.sin(angle / 2) * np.eye(3)["xyz".index(axis)], np.cos(angle / 2))


CAMERA = (quaternion_about("y", 0.1), [-0.03, -0.08, 0.12])  # of the headset's camera, OpenGL axes
TARGET = (quaternion_about("x", np.pi), [-0.1, 0.1, -1.3])  # of the eye's camera


def write_view(folder: Path, **replaced: str) -> None:
    """A view through nothing: both photographs show the dots where the poses put them, rows counted from the bottom."""
    device_from_target = matrix(*CAMERA) @ matrix(*TARGET)
    # The product turns about y, then by half a turn about x: i sin(b) terms vanish but for these two.
    half = 0.05
    target_of_headset = ([np.cos(half), 0, -np.sin(half), 0], device_from_target[:3, 3])
    seen = transforms.apply(matrix(*TARGET), DOTS)
    focal = np.array(itoh_seethrough.FOCAL_PX)
    from_bottom = itoh_seethrough.CENTRE_FROM_BOTTOM_PX + focal * seen[:, :2] / -seen[:, 2:]
    files = {
        "3dPointsOnGrid": archive(TIME_NS, points(DOTS)),
        "2dPointsOnViewPoint": archive(TIME_NS + 20_000_000_000, points(from_bottom)),
        "2dPointsOnViewPointThroughHMD": archive(TIME_NS, points(from_bottom + [1.0, 2.0])),
        "P_HMDCam2IDS": archive(TIME_NS, pose(*CAMERA)),
        "P_IDS2Marker": archive(TIME_NS, pose(*TARGET)),
        "P_HMDCam2Marker": archive(TIME_NS, pose(*target_of_headset)),
    }
    folder.mkdir(parents=True)
    for name, text in {**files, **replaced}.items():
        if text is not None:
            (folder / f"{name}.txt").write_text(text)


def projected(pairs: SeeThroughPairs) -> FloatArray:
    """Where each camera sees the dots without optics, our pixels (v, n, 2)."""
    pixels = []
    for device_from_camera, device_from_target in zip(pairs.device_from_camera, pairs.device_from_target, strict=True):
        camera_from_target = transforms.inverse(device_from_camera) @ device_from_target
        seen = transforms.apply(camera_from_target, pairs.dot_in_target)
        assert (seen[:, 2] > 0).all()
        pixels.append(pairs.centre_px + pairs.focal_px * seen[:, :2] / seen[:, 2:])
    return np.array(pixels)


def test_poses_and_pixels_agree_in_our_conventions(tmp_path: Path) -> None:
    for name in ("2", "10"):
        write_view(tmp_path / name)
    (tmp_path / "notes").mkdir()
    pairs = read_itoh_seethrough(tmp_path)
    assert pairs.view == ("2", "10")
    np.testing.assert_allclose(projected(pairs), pairs.bare_px, atol=1e-9)
    # Two rows up in the file's image is two rows less in ours.
    np.testing.assert_allclose(pairs.through_px - pairs.bare_px, np.broadcast_to([1.0, -2.0], (2, 5, 2)), atol=1e-9)
    np.testing.assert_allclose(pairs.bare_time_s, 20.0)
    np.testing.assert_allclose(pairs.through_time_s, 0.0)


def test_outer_corner_of_the_top_left_pixel_is_the_origin(tmp_path: Path) -> None:
    middle_of_top_left_pixel = np.tile([0.0, 1023.0], (len(DOTS), 1))
    write_view(tmp_path / "1", **{"2dPointsOnViewPoint": archive(TIME_NS, points(middle_of_top_left_pixel))})
    np.testing.assert_allclose(read_itoh_seethrough(tmp_path).bare_px, 0.5)
