"""The header of the format `c`, compiled by this machine's compilers, against the mappings in Python."""

import math
import shutil
import struct
import subprocess
import zlib
from collections.abc import Iterator
from dataclasses import replace
from functools import lru_cache, partial
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from fitted_eyes import fitted_eye

from wlr_render.budget.error_map import predicted_error
from wlr_render.budget.error_sizes import ErrorSizes
from wlr_render.errors import BadInputError
from wlr_render.exports.c_model import HEADER, CModel, model_bytes
from wlr_render.exports.export_view import ExportedView, Origin, view_from_centre
from wlr_render.geometry.planes import BasePlane
from wlr_render.mappings import Eye, Status
from wlr_render.numerics.arrays import FloatArray

DEVICES = ("northstar", "birdbath28")
STRICT = ["-O1", "-Wall", "-Wextra", "-Wconversion", "-pedantic", "-Werror", "-lm"]
CHECKED = ["-fsanitize=address,undefined", "-fno-sanitize-recover=all"]
TANGENTS = 1e-7
CANNOT_READ, NOT_A_MODEL, OTHER_VERSION, DAMAGED = 1, 2, 3, 4

pytestmark = pytest.mark.skipif(not shutil.which("cc"), reason="needs a C compiler (cc)")


def eye_sides(eye: Eye) -> tuple[Any, Any]:
    return eye.display, eye.see_through


@lru_cache
def view_of(device: str) -> ExportedView:
    eye = fitted_eye("birdbath28" if device == "tilted planes" else device, 5)
    if device == "tilted planes":  # the same polynomials of points on other planes
        planes = [BasePlane(0.004, (0.2, -0.3)), BasePlane(-0.003, (-0.1, 0.25))]
        display, see_through = (replace(side, place=p) for side, p in zip(eye_sides(eye), planes, strict=True))
        eye = replace(eye, display=display, see_through=see_through)
    predictors = (partial(predicted_error, eye, ErrorSizes()),)
    return view_from_centre((eye,), Origin(device, {}, {}), is_turned=True, predictors=predictors)


content = lru_cache(lambda device: model_bytes(view_of(device), "all"))


def sanitizers(compiler: str, folder: Path) -> list[str]:
    """CHECKED where programs that are compiled so run: the libraries are packages of their own on some systems."""
    source, made = folder / "nothing.c", folder / "nothing"
    source.write_text("int main(void) { return 0; }\n", encoding="utf-8")
    compiled = subprocess.run([compiler, *CHECKED, str(source), "-o", str(made)], capture_output=True).returncode == 0
    return CHECKED if compiled and subprocess.run([str(made)], capture_output=True).returncode == 0 else []


def compiled(compiler: str, language: str, standard: str, folder: Path) -> str:
    list(CModel().write([view_of("northstar")], folder))
    source = shutil.copy(Path(__file__).with_name("c_answers.c"), folder)
    command = [compiler, f"-std={standard}", *sanitizers(compiler, folder), f"-I{folder}", "-x", language, str(source)]
    subprocess.run([*command, "-x", "none", *STRICT, "-o", str(folder / "answers")], check=True)
    return str(folder / "answers")


@pytest.fixture(scope="module")
def program(tmp_path_factory: pytest.TempPathFactory) -> str:
    return compiled("cc", "c", "c99", tmp_path_factory.mktemp("c"))


@pytest.fixture(params=[*DEVICES, "tilted planes"])
def model(request: pytest.FixtureRequest, tmp_path: Path) -> tuple[ExportedView, Path]:
    path = tmp_path / "right.wlr"
    path.write_bytes(content(request.param))
    return view_of(request.param), path


def answers(program: str, path: Path, verb: str, viewpoint: FloatArray, rows: FloatArray, *more: float) -> list[str]:
    arguments = [program, str(path), verb, *map(repr, viewpoint.tolist()), *map(str, more)]
    text = "\n".join(" ".join(map(repr, row)) for row in rows.tolist())
    return subprocess.run(arguments, input=text, text=True, capture_output=True, check=True).stdout.splitlines()


def table(lines: list[str]) -> FloatArray:
    return np.array([line.split() for line in lines], dtype=np.float64)


def places(view: ExportedView, reach: float, beyond: float) -> Iterator[tuple[FloatArray, FloatArray]]:
    """Viewpoints of up to `reach` half eye boxes, and pixels up to a share `beyond` outside the panel."""
    rng = np.random.default_rng(3)
    for _ in range(4):
        pixel = rng.uniform(-beyond, 1 + beyond, (300, 2)) * view.panel_size_px
        yield view.channels[0].eye_box.at(rng.uniform(-reach, reach, 3)), pixel


@pytest.mark.parametrize(("reach", "beyond"), [(1.0, 0.0), (1.5, 0.1)])
def test_rays_are_those_of_python(program: str, model: tuple[ExportedView, Path], reach: float, beyond: float) -> None:
    view, path = model
    eye = view.channels[0]
    for viewpoint, pixel in places(view, reach, beyond):
        shown = eye.display.view_dir_of_pixel(pixel, viewpoint)
        due = eye.see_through.real_ray_of_view_dir(shown.value, viewpoint)
        got = table(answers(program, path, "rays", viewpoint, pixel))
        np.testing.assert_allclose(got[:, [0, 2, 4]], due.value[:, :3], atol=1e-9)
        np.testing.assert_allclose(got[:, [1, 3, 5]], due.value[:, 3:], atol=TANGENTS)
        np.testing.assert_array_equal(got[:, 7], np.maximum(shown.status, due.status))
        assert Status.OUTSIDE_FIT in got[:, 7] or reach == 1.0
    assert Status.OK in got[:, 7] or reach > 1.0


@pytest.mark.skipif(not shutil.which("c++"), reason="needs a C++ compiler (c++)")
def test_the_header_is_also_cpp(program: str, tmp_path: Path) -> None:
    path = tmp_path / "right.wlr"
    path.write_bytes(content("northstar"))
    other = compiled("c++", "c++", "c++11", tmp_path)
    for viewpoint, pixel in places(view_of("northstar"), 1.5, 0.1):
        ours, theirs = (table(answers(each, path, "rays", viewpoint, pixel)) for each in (program, other))
        np.testing.assert_allclose(theirs, ours, rtol=1e-12)


def test_pixels_of_points_are_those_of_python(program: str, model: tuple[ExportedView, Path]) -> None:
    view, path = model
    eye = view.channels[0]
    for viewpoint, pixel in places(view, 1.0, 0.1):
        shown = eye.display.view_dir_of_pixel(pixel, viewpoint)
        ray = eye.see_through.real_ray_of_view_dir(shown.value, viewpoint).value
        point = ray[:, :3] + ray[:, 3:] * np.geomspace(0.3, 30, len(ray))[:, None]
        seen = eye.see_through.view_dir_of_real_point(point, viewpoint)
        due = eye.display.pixel_of_view_dir(seen.value, viewpoint)
        got = table(answers(program, path, "pixels", viewpoint, point))
        np.testing.assert_allclose(got[:, :2], due.value, atol=1e-6)  # px: 1e-9 tangents
        np.testing.assert_array_equal(got[:, 3], np.maximum(seen.status, due.status))
        behind = table(answers(program, path, "pixels", viewpoint, viewpoint + [[0, 0, 0.1], [np.nan, 0, -1]]))
        assert np.isnan(behind[:, :3]).all()
        assert (behind[:, 3] == Status.MISS).all()


@pytest.mark.parametrize("depth_m", [math.inf, 0.5])
def test_mesh_is_that_of_python(program: str, model: tuple[ExportedView, Path], depth_m: float) -> None:
    view, path = model
    eye, (columns, rows) = view.channels[0], (12, 9)
    viewpoint = eye.eye_box.at(np.array([0.6, -0.4, 0.5]))
    moved = view.moved_to(viewpoint, "right", None)
    x, y = np.meshgrid(np.linspace(0, 1, columns + 1), np.linspace(0, 1, rows + 1))
    rays = np.moveaxis(moved.rays_at("all", np.stack([x, y], axis=-1) * view.panel_size_px), -1, 0)
    camera = view.source.camera
    due = moved.tangents(rays, depth_m).reshape(-1, 2)
    *lines, last = answers(program, path, "mesh", viewpoint, np.empty((0, 2)), depth_m, columns, rows)
    got, corner = table(lines), np.array(last.split(), int).reshape(-1, 3)
    np.testing.assert_allclose(camera.tangents_of_pixel(got[:, 2:4] * camera.size_px), due, atol=TANGENTS)
    np.testing.assert_allclose(got[:, :2], np.stack([2 * x - 1, 1 - 2 * y], axis=-1).reshape(-1, 2), atol=1e-12)
    first, second = got[corner[:, 1], :2] - got[corner[:, 0], :2], got[corner[:, 2], :2] - got[corner[:, 0], :2]
    area = 0.5 * (first[:, 0] * second[:, 1] - first[:, 1] * second[:, 0])
    np.testing.assert_allclose(area, 2 / (columns * rows))  # counter-clockwise, and all of the panel


@pytest.mark.parametrize("model", DEVICES, indirect=True)
def test_predicted_errors_are_those_of_python(program: str, model: tuple[ExportedView, Path]) -> None:
    view, path = model
    for viewpoint, pixel in places(view, 0.9, 0.0):
        got = table(answers(program, path, "rays", viewpoint, pixel))[:, 6]
        due = predicted_error(view.channels[0], ErrorSizes(), viewpoint, math.inf).at_pixel(pixel)
        assert np.sqrt(np.mean((got / due - 1) ** 2)) < 0.1
        assert np.ptp(due) > 0.1 * due.mean()


def test_headsets_without_covariance_have_no_predicted_error(program: str, tmp_path: Path) -> None:
    eye = fitted_eye("northstar", 3)
    view = view_from_centre((eye,), Origin("northstar", {}, {}), is_turned=True)
    (tmp_path / "right.wlr").write_bytes(model_bytes(view, "all"))
    centre = eye.display.panel.size_px[None] / 2
    got = table(answers(program, tmp_path / "right.wlr", "rays", eye.eye_box.centre, centre))
    assert np.isnan(got[0, 6])
    assert got[0, 7] == Status.OK


def opened(program: str, folder: Path, damaged: bytes, *, sealed: bool = True) -> int:
    """Result of wlr_open; `sealed` repairs the check sum, so that the numbers themselves are checked."""
    if sealed:
        damaged = damaged[:12] + struct.pack("<I", zlib.crc32(damaged[16:])) + damaged[16:]
    (folder / "broken.wlr").write_bytes(damaged)
    return subprocess.run([program, str(folder / "broken.wlr")], check=False).returncode


def test_broken_files_have_an_error(program: str, tmp_path: Path) -> None:
    whole = content("northstar")
    assert opened(program, tmp_path, whole) == 0
    for length in (16, 20, 28, 100, 228, 300, 700, len(whole) // 2, len(whole) - 8, len(whole) - 1):
        assert opened(program, tmp_path, whole[:length]) == DAMAGED, length
    assert [opened(program, tmp_path, whole[:length], sealed=False) for length in (0, 15)] == [NOT_A_MODEL] * 2
    assert opened(program, tmp_path, whole + b"\0") == DAMAGED
    assert opened(program, tmp_path, b"wlrMODEL" + whole[8:]) == NOT_A_MODEL
    assert opened(program, tmp_path, whole[:8] + struct.pack("<I", 2) + whole[12:]) == OTHER_VERSION
    assert opened(program, tmp_path, whole[:-1] + bytes([whole[-1] ^ 1]), sealed=False) == DAMAGED
    assert subprocess.run([program, str(tmp_path / "absent.wlr")], check=False).returncode == CANNOT_READ


@pytest.mark.parametrize("number", [math.nan, math.inf, -math.inf])
def test_numbers_that_are_not_finite_are_refused(number: float, program: str, tmp_path: Path) -> None:
    whole = content("northstar")
    for at in (28, 76, 124, 228 + 8, len(whole) - 27 * 8 * 18 * 16 - 16, len(whole) - 8):
        assert opened(program, tmp_path, whole[:at] + struct.pack("<d", number) + whole[at + 8 :]) == DAMAGED, at


@pytest.mark.parametrize("count", [0, 161, 65_536, 2**31, 2**32 - 1])
def test_counts_that_the_file_cannot_have_are_refused(count: int, program: str, tmp_path: Path) -> None:
    whole = content("northstar")
    for at in (20, 228, 232, 300, len(whole) - 27 * 8 * 18 * 16 - 8):
        if at != 300 or count:  # an order may be 0
            found = opened(program, tmp_path, whole[:at] + struct.pack("<I", count) + whole[at + 4 :])
            assert found == DAMAGED or (at == 20 and 0 < count < 1_000_000), at


def test_devices_are_refused(northstar_view: ExportedView, tmp_path: Path) -> None:
    with pytest.raises(BadInputError, match="the formats c and page hold planar models only; calibrate the headset"):
        list(CModel().write([northstar_view], tmp_path))
    assert not list(tmp_path.iterdir())


def test_header_lies_beside_the_model(tmp_path: Path) -> None:
    view = view_of("northstar")
    assert [path.name for path in CModel().write([view], tmp_path)] == CModel().files(view) == ["right.wlr", HEADER]
