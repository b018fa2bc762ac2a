"""OpenEXR files."""

from pathlib import Path
from typing import Any

import numpy as np
import pytest

from wlr_render.errors import BadInputError
from wlr_render.scene.exr_file import read_exr, write_exr


def test_what_is_written_is_read(tmp_path: Path) -> None:
    pytest.importorskip("OpenEXR")
    depth = np.array([[1.5, np.nan, np.inf], [-0.0, 2e-30, 7.0]], np.float32)
    channels: dict[str, Any] = {"depth.Z": depth, "instance": np.arange(6, dtype=np.uint32).reshape(2, 3) << 29}
    path = write_exr(tmp_path / "frame.exr", channels, {"viewpoint": "0.03 0 0"})
    read, texts = read_exr(path)
    assert texts == {"viewpoint": "0.03 0 0"}
    assert {name: each.dtype for name, each in read.items()} == {"depth.Z": np.float32, "instance": np.uint32}
    for name, values in channels.items():
        np.testing.assert_array_equal(read[name], values)


@pytest.mark.parametrize(
    ("channels", "named"),
    [
        ({}, "not none"),
        ({"a": np.zeros((2, 3), np.float32), "b": np.zeros((3, 2), np.float32)}, "a (2, 3), b (3, 2)"),
        ({"a": np.zeros((2, 3))}, "channel 'a', float64 (2, 3)"),
    ],
)
def test_what_no_exr_file_holds_is_refused(tmp_path: Path, channels: dict[str, Any], named: str) -> None:
    pytest.importorskip("OpenEXR")
    with pytest.raises(BadInputError) as refused:
        write_exr(tmp_path / "frame.exr", channels)
    assert named in str(refused.value)
    assert not list(tmp_path.iterdir())


def test_a_full_disk_is_named(tmp_path: Path, file_size_limit: Any) -> None:
    pytest.importorskip("OpenEXR")
    noise = np.random.default_rng(1).normal(size=(300, 300)).astype(np.float32)
    with file_size_limit(1000), pytest.raises(BadInputError, match=r"frame\.exr: cannot be written \(.*\); free space"):
        write_exr(tmp_path / "frame.exr", {"depth.Z": noise})
    assert not list(tmp_path.iterdir())


def test_a_file_of_another_kind_is_named(tmp_path: Path) -> None:
    pytest.importorskip("OpenEXR")
    (tmp_path / "frame.exr").write_text("no picture")
    with pytest.raises(BadInputError, match=r"frame\.exr: cannot be read as an OpenEXR file"):
        read_exr(tmp_path / "frame.exr")
    with pytest.raises(BadInputError, match=r"absent\.exr: there is no such file"):
        read_exr(tmp_path / "absent.exr")
