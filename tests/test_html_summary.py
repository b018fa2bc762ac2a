"""What Jupyter shows of the objects that users hold: numbers with units, and names as plain text."""

from collections.abc import Mapping
from dataclasses import replace
from html.parser import HTMLParser
from pathlib import Path
from typing import Any, Protocol

import numpy as np
import pytest
from fitted_eyes import captures, fitted_eye
from present import narrowed, present

from wlr_render.calibration.fit_eye import calibrate
from wlr_render.captures.session import DisplayPlan, Readings, SeeThroughPlan, Session, SessionPlan
from wlr_render.html_summary import MOST_ROWS, SummaryTable, html_summary
from wlr_render.mappings import Eye
from wlr_render.models.absent import ABSENT_DISPLAY, ABSENT_SEE_THROUGH
from wlr_render.models.display_model import DisplayModel
from wlr_render.models.model_file import EyeModel
from wlr_render.optics.device_file import load_device
from wlr_render.report.blocks import Report, ReportTable

HOSTILE = "a</td><img src=x onerror=f()><script>g()</script>\"'&amp;\x1b\u202e"
SHOWN = "a</td><img src=x onerror=f()><script>g()</script>\"'&amp;\\x1b\\u202e"
TAGS = {"div", "p", "b", "table", "tr", "th", "td"}


class Shown(HTMLParser):
    """Text of each element, and the elements that are not those of a summary."""

    def __init__(self, fragment: str) -> None:
        super().__init__()
        self.texts: list[str] = []
        self.foreign: list[tuple[str, list[tuple[str, str | None]]]] = []
        self.feed(fragment)

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        if tag not in TAGS or [attr for attr in attrs if attr != ("style", "text-align: left")]:
            self.foreign.append((tag, attrs))

    def handle_data(self, data: str) -> None:
        if data.strip():
            self.texts.append(data)


class InNotebooks(Protocol):
    def _repr_html_(self) -> str: ...


def shown(value: InNotebooks | None) -> list[str]:
    seen = Shown(present(value)._repr_html_())
    assert seen.foreign == []
    return seen.texts


@pytest.fixture(scope="module")
def eye() -> Eye:
    return fitted_eye("northstar", 3)


def model(eye: Eye, report: Mapping[Any, Any] | None = None) -> EyeModel:
    sides = {"display": {"viewpoints": 25, "noise_arcmin": 0.251234, "predicted_arcmin": 0.031234}}
    return EyeModel(eye, "northstar", sides if report is None else report)


def test_a_model_states_what_it_was_fitted_to_and_how_well(eye: Eye) -> None:
    texts = shown(model(eye))
    assert texts[0].startswith("Model of northstar, right eye")
    for name, value in (("panel", "1440 x 1600 px"), ("eye box, width x height x depth", "10 x 8 x 6 mm")):
        assert texts[texts.index(name) + 1] == value
    first = texts.index("display")
    assert texts[first + 1 : first + 6] == [
        "planar",
        str(len(narrowed(eye.display, DisplayModel).forward.orders)),
        "25",
        "0.251",
        "0.0312",
    ]
    assert texts[-3:] == ["-", "-", "-"]  # the report has no see-through


def test_a_model_of_one_side_or_with_a_strange_report_is_shown_too(eye: Eye) -> None:
    absent = replace(eye, display=ABSENT_DISPLAY, see_through=ABSENT_SEE_THROUGH)
    assert shown(model(absent)).count("not calibrated") == 3
    assert shown(model(eye, {"display": [1], "see_through": {"viewpoints": HOSTILE}})).count("-") == 6


def test_a_fit_states_its_kinds_and_predicted_errors_and_prints_as_one_line() -> None:
    fit = calibrate(captures("northstar"), "planar", 3, 2)
    texts = shown(fit)
    assert texts[0].startswith("Fit of northstar")
    first = texts.index("display")
    assert texts[first + 1].startswith("planar, ")
    assert max(len(repr(each)) for each in (fit, fit.mappings)) < 80


def test_a_device_states_its_panels_and_paths() -> None:
    device = load_device("prism5701202")
    texts = shown(device)
    assert texts[0] == "Device prism5701202"
    assert texts[texts.index("panel") + 1].startswith("1280 x 960 px, ")
    assert texts[texts.index("display path, from the eye") + 1].startswith("refract at S1, reflect at S2, ")
    assert len(repr(device)) < 80


def test_captures_state_their_numbers_and_ranges() -> None:
    found = captures("northstar")
    texts = shown(found)
    first = texts.index("display")
    assert found.display is not None
    low, high = 1e3 * found.display.viewpoint[:, 0].min(), 1e3 * found.display.viewpoint[:, 0].max()
    assert texts[first + 1 : first + 3] == [str(len(found.display)), "25"]
    assert texts[first + 3].startswith(f"{low:.3g} to {high:.3g}, ")
    assert "2 at 0.4 to 3 m" in texts
    assert shown(found.see_through)[-6:] == texts[-6:]


def session(name: str = "bench") -> Session:
    index, place, zeros = np.array([0, 0, 1]), np.zeros((3, 3)), np.zeros(3)
    display = DisplayPlan(index, zeros, zeros, place, np.zeros(3, np.int64), np.zeros((3, 2)))
    see_through = SeeThroughPlan(index, zeros, zeros, place, np.array([0, 1, 1]), np.zeros((3, 2)))
    return Session(name, SessionPlan(display, see_through), Readings(np.zeros((3, 2)), np.zeros((3, 2))))


def test_a_bench_session_states_its_parts() -> None:
    assert shown(session())[-8:] == ["display", "3", "2", "-", "see-through", "3", "3", "2"]


def test_a_report_states_its_verdict_steps_tables_and_files(tmp_path: Path) -> None:
    table = ReportTable("Errors", ["name", "rms (arcmin)"], [["a", 0.24321], ["b", None]], ["A note."])
    texts = shown(Report("T", "It works.", ["Type it."], ["Few captures."], [table], files=[tmp_path / "r.html"]))
    assert texts[:4] == ["T", "It works.", "Few captures.", "1. Type it."]
    assert texts[4:] == [f"Written: {tmp_path / 'r.html'}", "Errors", "name", "rms (arcmin)", "a", "0.243", "b", "-"]
    assert "A note." in shown(table)


def test_long_tables_are_cut_and_say_so() -> None:
    seen = Shown(html_summary("T", [], [SummaryTable([], [[str(row)] for row in range(MOST_ROWS + 2)])]))
    assert seen.texts[-2:] == [str(MOST_ROWS - 1), "2 more rows are not shown."]


def test_hostile_names_are_text(eye: Eye) -> None:
    found = captures("northstar")
    table = ReportTable(HOSTILE, [HOSTILE], [[HOSTILE]], [HOSTILE])
    named = Eye(HOSTILE, HOSTILE, eye.display, eye.see_through, eye.eye_box)
    expected: list[tuple[InNotebooks, int]] = [
        (replace(model(named), device=HOSTILE), 3),
        (named, 2),
        (replace(present(found.display), device=HOSTILE), 1),
        (session(HOSTILE), 1),
        (Report(HOSTILE, HOSTILE, [HOSTILE], [HOSTILE], [table], files=[Path(HOSTILE)]), 8),
        (table, 4),
    ]
    for value, times in expected:
        assert "".join(shown(value)).count(SHOWN) == times
