"""The option --against: every verb that writes a report compares it with an earlier one."""

import inspect
import json
import typing
from pathlib import Path
from typing import Any

import pytest
from command_line import refused
from present import present

from wlr_render.cli import VERBS, main, make_app
from wlr_render.jobs.options import Against, NoEffect

WITHOUT_REPORT = {"board", "pattern", "simulate"}


def figures(folder: Path) -> dict[str, Any]:
    """The tables of the comparison, by title."""
    record = json.loads((folder / "report.json").read_text())
    return {table["title"]: table["rows"] for table in record["comparison"]["tables"]}


@pytest.mark.parametrize("verb", [verb.words for verb in VERBS])
def test_every_verb_with_a_report_compares_it(verb: str) -> None:
    job = present(make_app()[verb].default_command)
    hints = typing.get_type_hints(
        inspect.signature(job, eval_str=True).parameters["options"].annotation, include_extras=True
    )
    assert (verb in WITHOUT_REPORT) != (hints.get("against") == Against)
    assert NoEffect() in typing.get_args(Against)


def test_a_run_is_compared_with_the_run_before_it_in_the_same_folder(
    tmp_path: Path, straight_device: str, capsys: pytest.CaptureFixture[str]
) -> None:
    out = tmp_path / "out"
    assert main(["trace", straight_device, "--out", str(out)]) == 0
    first = json.loads((out / "report.json").read_text())
    assert "comparison" not in first
    assert first["provenance"]["options"]["--eye"] == "right"
    assert main(["trace", straight_device, "--eye", "left", "--out", str(out), "--against", str(out)]) == 0
    second = json.loads((out / "report.json").read_text())
    assert second["comparison"]["date"] == first["provenance"]["date"]
    (report, eye) = figures(out)["Options and inputs that differ"]
    assert list(eye.values()) == ["--eye", "right", "left"]
    assert report["before"].startswith(str(out))
    assert "Only in the earlier report: table" in capsys.readouterr().out
    assert second["tables"][0]["section"] == "The left eye"
    third = ["trace", straight_device, "--eye", "left", "--out", str(out), "--against", str(out)]
    assert main(third) == 0
    assert list(figures(out)) == ["Options and inputs that differ"]
    assert json.loads((out / "report.json").read_text())["tables"] == second["tables"]


def test_other_reports_are_refused_before_work_begins(
    tmp_path: Path, straight_device: str, capsys: pytest.CaptureFixture[str]
) -> None:
    out, other = tmp_path / "out", tmp_path / "other"
    assert main(["trace", straight_device, "--out", str(other)]) == 0
    capsys.readouterr()
    budget = ["budget", straight_device, "--out", str(out), "--against", str(other)]
    assert "other/report.json: is a report of trace; name a report of budget, or run" in refused(budget, capsys)
    trace = ["trace", straight_device, "--out", str(out), "--against", str(other / "report.html")]
    (other / "report.json").write_text('{"format": "wlr-report", "vers')
    assert "other/report.json: cannot be read as a report" in refused(trace, capsys)
    assert "there is no such file" in refused([*trace[:-1], str(tmp_path / "none.json")], capsys)
    assert not out.exists()
