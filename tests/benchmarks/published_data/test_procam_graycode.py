"""White and black photographs in front, and the lenses' numbers; and the photographs themselves."""

from collections.abc import Callable
from pathlib import Path

import cv2
import numpy as np
import pytest
from present import as_number

from benchmarks.published_data.procam_graycode import read_procam_graycode
from benchmarks.published_data.study import PublishedDataOptions, run
from wlr_render.captures.decoded import Rejection

CAMERA = np.array([[3000.0, 0, 600.0], [0, 3100.0, 500.0], [0, 0, 1]])


@pytest.fixture
def capture(tmp_path: Path) -> Path:
    """A capture as the project writes it; only white and black are readable pictures."""
    folder = tmp_path / "capture_0"
    folder.mkdir()
    for number in range(42):
        (folder / f"graycode_{number:02d}.png").touch()
    storage = cv2.FileStorage(str(tmp_path / "calibration_result.xml"), cv2.FILE_STORAGE_WRITE)
    storage.write("img_shape", np.array([[1024.0], [1280.0]]))
    for name in ("cam", "proj"):
        storage.write(f"{name}_int", CAMERA)
        storage.write(f"{name}_dist", np.array([[0.1, -0.2, 0.001, 0.002, 0.3]]))
    storage.release()
    return folder


@pytest.mark.parametrize("whole_set", [False, True])
def test_white_and_black_are_moved_to_the_front(capture: Path, whole_set: bool) -> None:
    found = read_procam_graycode(capture.parent if whole_set else capture)
    assert [path.stem[-2:] for path in found.photographs] == ["40", "41", *(f"{number:02d}" for number in range(40))]
    assert (found.panel.width_px, found.panel.height_px) == (1024, 768)


def test_lenses_see_what_opencv_sees_with_its_numbers(capture: Path) -> None:
    found = read_procam_graycode(capture)
    assert found.camera.size_px == (1280, 1024)
    assert found.projector.size_px == (1024, 768)
    point = np.array([[0.1, -0.05, 1.0], [-0.02, 0.07, 0.9]])
    distortion = np.array([0.1, -0.2, 0.001, 0.002, 0.3])
    expected = cv2.projectPoints(point, np.zeros(3), np.zeros(3), CAMERA, distortion)[0][:, 0]
    np.testing.assert_allclose(found.camera.pixel_of_point(point), expected + 0.5, atol=1e-9)


@pytest.mark.slow
def test_a_projectors_photographs_lie_on_flat_surfaces(measured_data: Callable[[str], Path], tmp_path: Path) -> None:
    options = PublishedDataOptions("procam-graycode", measured_data("procam_graycode"), out=tmp_path)
    tables = {table.title: table for table in run(options).tables}
    fates = {row[0]: row[2] for row in tables["Camera pixels"].rows}
    accepted = as_number(fates[Rejection.ACCEPTED.sentence])
    assert accepted > 65
    bits = {row[0]: row for row in tables["Strength of the bits"].rows}
    assert [name for name, row in bits.items() if row[-1] == "weak"] == ["u bit 0", "v bit 0"]
    board = tables["Homographies of flat surfaces"].rows[:2]
    assert sum(as_number(row[1]) for row in board) * accepted > 50 * 100
    assert all(as_number(row[2]) < 0.2 and as_number(row[-1]) < 0.1 for row in board)
