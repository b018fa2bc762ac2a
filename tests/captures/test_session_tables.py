"""Tables of a bench session: written and read alike, turned into our conventions, and faults named with their line."""

import gzip
from collections.abc import Callable, Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from wlr_render.captures import session_tables
from wlr_render.captures.session_schema import (
    CHANNEL,
    DISPLAY,
    INDEX,
    NUMBER,
    POSITIVE,
    RUN_TIME,
    SCHEMAS,
    SEE_THROUGH,
    SIGN,
    Schema,
)
from wlr_render.captures.session_tables import read_table, write_table
from wlr_render.errors import BadInputError
from wlr_render.geometry.transforms import OPENXR_FROM_OPENCV
from wlr_render.io.file_records import Rule
from wlr_render.io.input_files import LIMITS
from wlr_render.numerics.arrays import FloatArray

DOCUMENT = Path(__file__).parents[2] / "docs" / "bench-session.md"
ROWS_PER_CAPTURE = 3
ROWS = """\
capture,time_s,travel,stage_x_mm,stage_y_mm,stage_z_mm,channel,camera_u,camera_v,pixel_u,pixel_v
0,0.0,1,32,0,33,1,40.0,50.0,100.0,200.0
0,0.0,1,32,0,33,1,60.0,50.0,120.0,200.0
1,40.0,-1,30,0,33,1,40.0,50.0,101.0,201.0
"""


def random_columns(schema: Schema, rng: np.random.Generator, captures: int = 4) -> dict[Any, Any]:
    """Columns of a session as a bench could deliver them."""
    count = captures * ROWS_PER_CAPTURE
    of_kind: dict[Rule, Callable[[], NDArray[np.floating[Any]]]] = {
        NUMBER: lambda: rng.uniform(-20.0, 20.0, count),
        INDEX: lambda: np.arange(count) // ROWS_PER_CAPTURE + 0.0,
        SIGN: lambda: rng.choice([-1.0, 1.0], count),
        POSITIVE: lambda: rng.uniform(0.05, 0.3, count),
        CHANNEL: lambda: rng.integers(0, 3, count) + 0.0,
    }
    columns = {column.name: of_kind[column.kind]() for column in schema.columns}
    for vector in schema.unit_vectors:
        length = np.linalg.norm([columns[name] for name in vector], axis=0)
        columns |= {name: columns[name] / length for name in vector}
    return columns | {name: np.repeat(columns[name][::ROWS_PER_CAPTURE], ROWS_PER_CAPTURE) for name in schema.setup}


def assert_columns(found: Mapping[str, FloatArray], expected: Mapping[str, Any]) -> None:
    assert set(found) == set(expected)
    for name, value in expected.items():
        np.testing.assert_allclose(found[name], value, rtol=1e-12, atol=1e-12, err_msg=name)


@pytest.mark.parametrize("suffix", [".csv", ".csv.gz"])
@pytest.mark.parametrize("schema", SCHEMAS, ids=lambda schema: schema.name)
def test_what_is_written_is_read(tmp_path: Path, schema: Schema, suffix: str) -> None:
    columns = random_columns(schema, np.random.default_rng(3))
    path = write_table(tmp_path / f"{schema.name}{suffix}", schema, columns)
    assert (path.read_bytes()[:2] == b"\x1f\x8b") == (suffix == ".csv.gz")
    assert_columns(read_table(path, schema), columns)


@pytest.mark.parametrize(("separator", "comma"), [(";", True), (";", False), ("\t", True), ("\t", False), (",", False)])
@pytest.mark.parametrize("quotes", ["", '"'])
def test_tables_of_spreadsheets_are_read(tmp_path: Path, separator: str, comma: bool, quotes: str) -> None:
    """Semicolons and decimal commas, tabs, quotes, a byte order mark and CR LF."""
    columns = random_columns(SEE_THROUGH, np.random.default_rng(5))
    path = write_table(tmp_path / "seethrough.csv", SEE_THROUGH, columns)
    lines = [[quotes + cell + quotes for cell in line.split(",")] for line in path.read_text().splitlines()]
    rows = [separator.join(cells) for cells in lines]
    rows[1:] = [row.replace(".", ",") if comma else row for row in rows[1:]]
    path.write_bytes(("\ufeff" + "\r\n".join(rows) + "\r\n").encode())
    assert_columns(read_table(path, SEE_THROUGH), columns)
    path.write_text("\n".join([*rows[:3], rows[3][:-2] + "x" + quotes]), encoding="utf-8")
    with pytest.raises(BadInputError, match=r"seethrough.csv line 4: '\w+' is '.*x', not a number"):
        read_table(path, SEE_THROUGH)


def test_columns_may_come_in_any_order_and_optional_groups_be_absent(tmp_path: Path) -> None:
    columns = random_columns(SEE_THROUGH, np.random.default_rng(4))
    required = [column.name for column in SEE_THROUGH.columns if not column.group]
    rows = np.stack([columns[name] for name in reversed(required)], axis=1)
    path = tmp_path / "seethrough.csv"
    np.savetxt(path, rows, "%.15g", ",", header=",".join(reversed(required)), comments="")
    absent = {"travel": np.ones(len(rows)), "time_s": np.zeros(len(rows))}
    assert_columns(read_table(path, SEE_THROUGH), {name: columns[name] for name in required} | absent)


def test_without_times_a_place_may_be_visited_twice(tmp_path: Path) -> None:
    path = tmp_path / "display.csv"
    rows = np.loadtxt(ROWS.splitlines()[1:], delimiter=",")
    header = ROWS.splitlines()[0].split(",")
    rows = np.concatenate([rows, rows])
    rows[len(rows) // 2 :, header.index("capture")] += 100
    for kept, message in ((slice(None), "has the same setup"), ([n for n in header if n != "time_s"], None)):
        names = header[kept] if isinstance(kept, slice) else kept
        columns = rows[:, [header.index(name) for name in names]]
        np.savetxt(path, columns, "%.15g", ",", header=",".join(names), comments="")
        if message is None:
            assert not read_table(path, DISPLAY)["time_s"].any()
        else:
            with pytest.raises(BadInputError, match=message):
                read_table(path, DISPLAY)


@pytest.mark.parametrize("axes", [np.eye(3), OPENXR_FROM_OPENCV], ids=["openxr", "opencv"])
@pytest.mark.parametrize("schema", SCHEMAS, ids=lambda schema: schema.name)
def test_plans_and_readings_become_the_columns_they_came_from(schema: Schema, axes: FloatArray) -> None:
    columns = random_columns(schema, np.random.default_rng(5))
    found = schema.to_file(*schema.of_file(columns, axes), axes)
    for quaternion in schema.unit_vectors:  # q and -q are one rotation
        sign = np.sign(sum(found[name] * columns[name] for name in quaternion))
        found |= {name: sign * found[name] for name in quaternion}
    assert_columns(found, columns)


def test_frame_unit_and_pixel_become_ours() -> None:
    rng = np.random.default_rng(6)
    columns = random_columns(DISPLAY, rng) | {
        f"stage_{axis}_mm": np.full(12, v) for axis, v in zip("xyz", (1, 2, 3), strict=True)
    }
    plan, pixel = DISPLAY.of_file(columns, OPENXR_FROM_OPENCV)
    np.testing.assert_allclose(plan.stage[0], [0.001, -0.002, -0.003], atol=1e-15)
    np.testing.assert_allclose(plan.camera_pixel[:, 0], columns["camera_u"] + 0.5)
    np.testing.assert_array_equal(pixel[:, 1], columns["pixel_v"])

    columns = random_columns(SEE_THROUGH, rng)
    plan, pixel = SEE_THROUGH.of_file(columns, OPENXR_FROM_OPENCV)
    np.testing.assert_allclose(plan.dot, np.stack([columns["target_x_mm"], -columns["target_y_mm"]], axis=1) / 1000)
    np.testing.assert_allclose(pixel[:, 1], columns["camera_v"] + 0.5)
    in_file = Rotation.from_quat(np.stack([columns[f"camera_q{axis}"] for axis in "xyzw"], axis=1)).as_rotvec()
    np.testing.assert_allclose(Rotation.from_matrix(plan.orientation).as_rotvec(), in_file * [1, -1, -1], atol=1e-12)

    columns = random_columns(RUN_TIME, rng)
    plan, _ = RUN_TIME.of_file(columns, OPENXR_FROM_OPENCV)
    np.testing.assert_allclose(plan.head_rate[:, 2], -columns["head_rate_z_rad_s"])
    np.testing.assert_allclose(plan.head_velocity[:, 1], -columns["head_velocity_y_mm_s"] / 1000)
    np.testing.assert_allclose(plan.gaze[:, 2], -columns["gaze_z"])
    np.testing.assert_allclose(plan.world_from_device[:, :3, 3] * 1000 @ [0, 0, -1], columns["head_z_mm"])


FAULTS = {
    "column missing": ("travel,", "", "column 'travel' is missing"),
    "mistyped column": ("pixel_u", "pixel_uu", "unknown column 'pixel_uu'; did you mean 'pixel_u'?"),
    "column of no axis": ("pixel_u", "pixel_w", "unknown column 'pixel_w'; remove it"),
    "strange column": ("pixel_v\n", "pixel_v,weather\n", "unknown column 'weather'; remove it"),
    "column twice": ("pixel_v\n", "pixel_v,time_s\n", "column 'time_s' occurs twice"),
    "other unit": ("stage_x_mm", "stage_x_m", "column 'stage_x_m' has another unit than 'stage_x_mm' (mm)"),
    "other time": ("time_s", "time_ms", "column 'time_ms' has another unit than 'time_s' (s)"),
    "no rows": (ROWS[ROWS.index("\n") :], "\n", "has no rows"),
    "empty cell": ("120.0,200.0", ",200.0", "line 3: 'pixel_u' is '', not a number"),
    "nan": ("120.0,200.0", "nan,200.0", "line 3: 'pixel_u' is nan"),
    "infinite": ("120.0,200.0", "120.0,-inf", "line 3: 'pixel_v' is -inf"),
    "text": ("101.0", "n/a", "line 4: 'pixel_u' is 'n/a'"),
    "short row": ("101.0,201.0", "101.0", "line 4: 10 cells where the header has 11"),
    "travel": ("40.0,-1", "40.0,0", "line 4: 'travel' is 0; it must be +1 or -1"),
    "channel": ("33,1,60.0", "33,3,60.0", "line 3: 'channel' is 3; it must be 0, 1 or 2"),
    "fraction": ("\n1,40.0", "\n1.5,40.0", "line 4: 'capture' is 1.5"),
    "capture moved": ("\n1,40.0", "\n0,40.0", "line 4: capture 0 has another setup"),
    "capture twice": ("1,40.0,-1,30", "1,0.0,1,32", "line 4: the capture in line 2 has the same setup"),
    "metres of micrometres": (
        "\n1,40.0,-1,30",
        "\n1,40.0,-1,30000",
        "'stage_x_mm' is 30000; it must be 10000 mm at most: ch",
    ),
    "milliseconds": ("\n1,40.0", "\n1,4e11", "line 4: 'time_s' is 4e+11; it must be 1e+11 s at most: check its unit"),
    "huge index": ("\n1,40.0", "\n1e9,40.0", "line 4: 'capture' is 1e+09; it must be 1e+06 at most"),
    "beyond floats": ("101.0", "1e999", "line 4: 'pixel_u' is inf"),
    "huge": ("101.0", "1e308", "line 4: 'pixel_u' is 1e+308"),
    "control characters": ("101.0", "\x1b[31m" + "9" * 99, r"line 4: 'pixel_u' is '\x1b[31m999"),
    "many columns": ("capture,", "capture," + "," * 20_000, "line 1: has 2009"),
    "row twice": ("60.0,50.0,120.0", "40.0,50.0,100.0", "line 3: is the same row as line 2"),
}


@pytest.mark.parametrize("fault", FAULTS)
def test_faults_are_one_sentence_that_names_file_and_place(tmp_path: Path, fault: str) -> None:
    old, new, sentence = FAULTS[fault]
    assert ROWS.count(old) == 1
    path = tmp_path / "display.csv"
    path.write_text(ROWS.replace(old, new), encoding="utf-8")
    with pytest.raises(BadInputError) as caught:
        read_table(path, DISPLAY)
    assert str(caught.value).startswith(str(path))
    assert sentence in str(caught.value)


def test_the_table_that_faults_are_made_from_has_none(tmp_path: Path) -> None:
    path = tmp_path / "display.csv"
    path.write_text(ROWS.replace("\n", "\r\n\r\n"), encoding="utf-8-sig")
    np.testing.assert_array_equal(read_table(path, DISPLAY)["pixel_u"], [100.0, 120.0, 101.0])


def test_part_of_a_quaternion_and_a_wrong_length_are_refused(tmp_path: Path) -> None:
    columns = random_columns(SEE_THROUGH, np.random.default_rng(7))
    path = write_table(tmp_path / "seethrough.csv", SEE_THROUGH, {k: v for k, v in columns.items() if k != "camera_qy"})
    with pytest.raises(BadInputError, match="column 'camera_qy' is missing"):
        read_table(path, SEE_THROUGH)
    write_table(path, SEE_THROUGH, columns | {"camera_qw": columns["camera_qw"] + 1.0})
    with pytest.raises(BadInputError, match=r"line 2: camera_qx, .* have length"):
        read_table(path, SEE_THROUGH)


@pytest.mark.parametrize("sigma", ["0", "-0.1", "nan", "inf"])
def test_a_sigma_that_is_not_positive_is_refused_with_its_line(tmp_path: Path, sigma: str) -> None:
    sigmas = iter(["sigma_px", "0.1", "0.2", sigma])
    path = tmp_path / "display.csv"
    path.write_text("\n".join(f"{line},{next(sigmas)}" for line in ROWS.splitlines()), encoding="utf-8")
    demand = "above 0" if np.isfinite(float(sigma)) else "finite"
    with pytest.raises(BadInputError, match=rf"display\.csv line 4: 'sigma_px' is {sigma}; it must be .*{demand}"):
        read_table(path, DISPLAY)


def test_a_table_has_a_largest_number_of_rows_and_size_decompressed(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    path = tmp_path / "display.csv"
    path.write_text(ROWS, encoding="utf-16")
    with pytest.raises(BadInputError, match="is not UTF-8 text, so this is not a table"):
        read_table(path, DISPLAY)
    path = tmp_path / "display.csv.gz"
    path.write_bytes(gzip.compress(bytes(2_000_000)))
    limits = replace(LIMITS, table_bytes=1_000_000, rows=3)
    monkeypatch.setattr(session_tables, "LIMITS", limits)
    with pytest.raises(BadInputError, match="decompresses to more than 1 MB"):
        read_table(path, DISPLAY)
    path.write_bytes(gzip.compress(ROWS.encode()))
    with pytest.raises(BadInputError, match="has more than 3 rows"):
        read_table(path, DISPLAY)


@pytest.mark.parametrize("content", [b"", b"capture", gzip.compress(ROWS.encode())[:60]], ids=["empty", "text", "cut"])
def test_a_broken_gzip_file_is_named(tmp_path: Path, content: bytes) -> None:
    path = tmp_path / "display.csv.gz"
    path.write_bytes(content)
    with pytest.raises(BadInputError, match=r"display\.csv\.gz"):
        read_table(path, DISPLAY)


@pytest.mark.parametrize("schema", SCHEMAS, ids=lambda schema: schema.name)
def test_the_documentation_has_the_schema(schema: Schema) -> None:
    text = DOCUMENT.read_text(encoding="utf-8")
    documented = text[text.index(f"\n## {schema.name}.csv\n") :].split("\n## ")[1].splitlines()
    rows = [line for line in documented if line.startswith("| `")]
    kinds = [each.kind.demand + (", optional" if each.group else "") for each in schema.columns]
    stated = zip(schema.columns, kinds, strict=True)
    assert rows == [f"| `{column.name}` | {column.unit} | {kind} | {column.meaning} |" for column, kind in stated]
