"""Figures lie in a file that has the renderer's name."""

import pytest

from benchmarks.speed.record import record
from wlr_render.errors import BadInputError
from wlr_render.report.blocks import ReportTable


def test_the_file_is_named_after_the_renderer_and_holds_all_tables(tmp_path):
    tables = [ReportTable("First", ("what", "time"), [["warp", 1.5]]), ReportTable("Second", ("x",), [[2.0]])]
    path = record(tables, tmp_path / "benchmarks", "llvmpipe (LLVM 15.0.6, 256 bits)")
    assert path.relative_to(tmp_path).as_posix() == "benchmarks/llvmpipe-llvm-15-0-6-256-bits.md"
    text = path.read_text(encoding="utf-8")
    assert text.startswith("# Measured on llvmpipe (LLVM 15.0.6, 256 bits)\n\n### First\n")
    assert "| warp | 1.5 |" in text
    assert "### Second" in text


def test_a_second_run_replaces_the_first(tmp_path):
    table = ReportTable("Times", ("what",), [["old"]])
    record([table], tmp_path, "GPU 1")
    record([ReportTable("Times", ("what",), [["new"]])], tmp_path, "GPU 1")
    (path,) = tmp_path.iterdir()
    assert "old" not in path.read_text(encoding="utf-8")


def test_a_name_without_letters_is_refused(tmp_path):
    with pytest.raises(BadInputError, match="gives no file name"):
        record([], tmp_path, "/../")
