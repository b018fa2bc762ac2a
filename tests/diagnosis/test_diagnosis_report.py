"""The report of a real diagnosis: its blocks, its files, and what its plots show."""

import json
import re
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from browser import needs_browser, open_page
from present import present

from wlr_render.diagnosis import diagnosis_plots as plots
from wlr_render.diagnosis.report import Diagnosis, diagnosis_report
from wlr_render.diagnosis.residual_views import part_views
from wlr_render.report.blocks import Plot, Report, Section, Text
from wlr_render.report.save import save_report


@pytest.fixture(scope="module")
def report(explained: Diagnosis) -> Report:
    return diagnosis_report(explained)


def test_notebooks_show_the_verdict_the_advice_and_the_causes(explained: Diagnosis) -> None:
    fragment = explained._repr_html_()
    for words in ("Diagnosis of small (northstar, right eye)", "Explained: combiner tilted", "[target] scale = [1.00"):
        assert words in fragment
    assert "value +- one sigma" in fragment
    assert len(fragment) < 50_000
    hostile = replace(explained, session="<img src=x>")._repr_html_()
    assert "<img" not in hostile
    assert "Diagnosis of &lt;img src=x&gt;" in hostile


def titles(report: Report, kind: type[Section | Plot]) -> list[str]:
    return [block.title for block in report.blocks if isinstance(block, kind)]


def test_the_report_has_the_verdict_the_values_to_type_and_the_evidence(report: Report, explained: Diagnosis) -> None:
    assert report.title == "Diagnosis of small (northstar, right eye)"
    assert report.verdict.startswith("Explained: combiner tilted")
    assert any("[target] scale = [1.00" in each for each in report.advice)
    assert titles(report, Section) == [
        "Result",
        "Display residual",
        "See-through residual",
        "Captures",
        "Evidence",
        "Noise",
    ]
    tables = [table.title for table in report.tables]
    for title in (
        "Simulation against measurement",
        "Causes",
        "Parameters",
        "Ranking of candidates",
        "Captures",
        "Noise",
    ):
        assert title in tables
    assert "Captures that moved" in tables
    items = [item for block in report.blocks if isinstance(block, Text) for item in block.items]
    assert "wlr-render render corrected/device.toml desk" in items
    assert set(explained.reasons) <= set(items)


def test_the_files_hold_the_record(report: Report, explained: Diagnosis, tmp_path: Path) -> None:
    saved = save_report(report, tmp_path, "diagnosis")
    assert [path.name for path in saved.files] == ["diagnosis.html", "diagnosis.md", "diagnosis.json"]
    record = json.loads((tmp_path / "diagnosis.json").read_text())
    assert record["verdict"] == "explained"
    cause = next(each for each in record["causes"] if each["name"] == "target_scale")
    found = next(each for each in explained.causes if each.name == "target_scale")
    first = found.parameters[0]
    assert cause["parameters"][first.name] | {"prior_sigma": 0} == {
        "name": first.name,
        "value": first.value,
        "sigma": first.sigma,
        "unit": first.unit,
        "prior_sigma": 0,
        "prior_mean": 0.0,
    }
    assert (cause["held_out_gain"], cause["gain_sigma"]) == (found.improvement.percent, found.improvement.sigma)
    assert cause["overlaps_with"] == [other.name for other in found.degenerate]
    assert record["outliers"] == [3]
    assert record["after"]["seethrough_noise_floor_arcmin"] == explained.noise.see_through_rms_arcmin
    assert record["before"]["display_rms_px"] == explained.before.display_rms_px
    assert cause["improvement"]["percent"] == found.improvement.percent
    assert record["excluded"][0]["capture"]["capture"] == 3
    assert record["noise_floors"][0]["is_believable"] is True
    assert [each["part"] for each in record["motions"]] == ["display", "see-through"]
    assert record["motions"][0]["shift_um"] == explained.motions[0].shift_um
    assert record["expected"]["over_noise"] == explained.expected.over_noise
    assert cause["log10_odds"] == found.log10_odds > 20
    assert record["excluded"][0]["log10_odds"] > 20
    assert record["after"]["rms_over_noise"] == pytest.approx(1.0, abs=0.05)
    assert not {"observations", "residual_before", "used", "corrected", "fit", "readings"} & set(record)
    page = (tmp_path / "diagnosis.html").read_text()
    assert "Session session" not in page
    assert len(page) < 8e6


def test_a_diagnosis_without_causes_has_limits_and_one_state(nothing: Diagnosis) -> None:
    report = diagnosis_report(nothing)
    assert "Detection limits" in [table.title for table in report.tables]
    assert "Correlations between the values found" not in titles(report, Plot)
    assert all(len(part.seen) == 1 for part in part_views(nothing))


def test_a_run_time_session_is_drawn(late: Diagnosis) -> None:
    (part,) = part_views(late)
    rate = next(variable for variable in part.variables if variable.name.startswith("head turns left"))
    # The dot is drawn where it was; by the time it is seen, a head turning left has carried it to the left.
    before, after = (np.polyfit(rate.values, seen[:, 0], 1)[0] for seen in part.seen.values())
    assert before == pytest.approx(-11e-3 * 60, rel=0.1)
    assert abs(after) < 0.02 * abs(before)
    items = [item for block in diagnosis_report(late).blocks if isinstance(block, Text) for item in block.items]
    assert "wlr-render diagnose corrected --out again" in items
    own = diagnosis_report(late, add_causes=("my causes.py", "my_lab.causes"))
    items = [item for block in own.blocks if isinstance(block, Text) for item in block.items]
    assert "wlr-render diagnose corrected --out again --add-causes 'my causes.py' my_lab.causes" in items
    assert not any("calibrate" in item for item in items)
    assert "[clock] latency_s = 0.01" in " ".join(items)


def test_parts_hold_the_residuals_that_count_in_their_units(explained: Diagnosis) -> None:
    display, see_through = part_views(explained)
    before, after = display.seen.values()
    assert np.sqrt(np.nanmean(display.on_map["bench as described"] ** 2)) == pytest.approx(
        explained.before.display_rms_px
    )
    assert np.sqrt(np.nanmean(after**2)) == pytest.approx(display.sigma_arcmin, rel=0.05)
    own = explained.observations.session.plan.display
    assert own is not None
    assert np.isnan(before[own.capture == 3]).all()
    assert np.isfinite(before[own.capture != 3]).all()
    assert not any("capture 3 " in title for title in display.maps)
    assert [title.split(" at")[0] for title in see_through.maps] == ["target pose 0", "target pose 1"]


def test_maps_show_single_captures_from_places_far_apart(explained: Diagnosis) -> None:
    display, plan = part_views(explained)[0], explained.observations.session.plan.display
    places = [np.unique(present(plan).stage[rows], axis=0) for rows in display.maps.values()]
    assert all(len(place) == 1 for place in places)
    assert len(np.unique(np.concatenate(places), axis=0)) == len(places)


def test_maps_have_a_panel_for_each_bench_and_begin_with_the_largest_residual(explained: Diagnosis) -> None:
    part = part_views(explained)[0]
    title, last = list(part.maps.items())[-1]
    size = {"bench as described": 3.0, "corrected bench": 1.0}
    # Downwards, and in one map twice as far.
    far = 1.0 + last[:, None]
    on_map = {n: np.where(np.isnan(each), np.nan, far * [0.0, size[n]]) for n, each in part.on_map.items()}
    plot = plots.residual_maps(replace(part, on_map=on_map))
    assert [each["text"] for each in plot.layout["annotations"]] == list(size)
    labels = [button["label"] for button in plot.layout["updatemenus"][0]["buttons"]]
    assert labels[0] == title
    assert sorted(labels) == sorted(part.maps)
    before, after = (plot.data[number]["y"][1] - plot.data[number]["y"][0] for number in (0, 2))
    assert before == pytest.approx(3 * after, rel=0.02)
    assert after > 0.0  # the axis points down


def test_a_radial_residual_is_outwards_everywhere(explained: Diagnosis) -> None:
    see_through = part_views(explained)[1]
    radius = next(variable for variable in see_through.variables if variable.name.startswith("radius on camera"))
    seen = 0.001 * radius.values[:, None] * present(radius.outwards)
    found = plots.binned(radius, seen, see_through)
    np.testing.assert_allclose(found.means[0], 1e-3 * found.middle)
    np.testing.assert_allclose(found.means[1], 0.0, atol=1e-12)


def test_curves_leave_the_band_where_there_is_more_than_noise(explained: Diagnosis) -> None:
    part = part_views(explained)[0]
    part = replace(part, motion=0.0 * part.motion)
    rng, sigma = np.random.default_rng(4), part.sigma_arcmin
    noise = rng.normal(0, sigma, part.place.shape)
    for offset in (0.0, 1.0):
        found = plots.binned(part.variables[0], noise + [offset * sigma, 0.0], part)
        errors = sigma / np.sqrt(len(noise) / len(found.middle))
        np.testing.assert_allclose(found.band, 2 * errors, rtol=0.3)
        np.testing.assert_allclose(found.means, [[offset * sigma], [0.0]] * np.ones(len(found.middle)), atol=4 * errors)


def test_the_histogram_shows_noise_that_sigma_does_not_cover(explained: Diagnosis) -> None:
    wide = replace(explained, fit=replace(explained.fit, residual=2.0 * explained.fit.residual))
    for diagnosis, slope in ((explained, 1.0), (wide, 2.0)):
        quantiles = plots.normality_plot(diagnosis).data[2]
        assert np.polyfit(quantiles["x"], quantiles["y"], 1)[0] == pytest.approx(slope, rel=0.05)


def test_correlations_are_those_of_the_values(explained: Diagnosis) -> None:
    plot = plots.correlations_plot(explained)
    matrix = np.array(plot.data[0]["z"])
    assert plot.data[0]["x"] == explained.correlations.names
    assert len(matrix) == sum(len(cause.parameters) for cause in explained.causes)
    np.testing.assert_allclose(np.diag(matrix), 1.0)
    np.testing.assert_allclose(matrix, matrix.T, atol=1e-9)
    assert np.linalg.cond(matrix) == pytest.approx(explained.correlations.condition, rel=1e-6)


def test_curves_have_one_scale_and_a_plot_for_each_variable(explained: Diagnosis) -> None:
    part = part_views(explained)[0]
    layout = plots.residual_curves(part).layout
    axes = [name for name in layout if name.startswith("yaxis")]
    assert len(axes) == len(part.variables)
    assert all(layout[name].get("matches") == "y" for name in axes if name != "yaxis")
    assert layout["xaxis"]["title"]["text"] == part.variables[0].name


def test_an_effect_is_drawn_by_its_components_and_coordinates(located: Diagnosis) -> None:
    """Arrows over pixels, colours where a component has no direction in the plane, curves over one coordinate."""
    effect, rng = located.effects[0], np.random.default_rng(3)
    place, one, pose = rng.normal(size=(40, 2)), rng.normal(size=(40, 1)), rng.normal(size=(40, 6))
    for coordinates, at, moved, traces in (
        ("panel pixels", place, place, ["scatter"] * 3),
        ("place on the combiner", place, one, ["scattergl"]),
        ("stage", np.append(place, 0.0 * one, axis=1), pose, ["scattergl"]),
        ("time", one, pose, ["scatter"] * 6),
    ):
        plot = plots.effect_map(replace(effect, coordinates=coordinates, map_place=at, map_displacement=moved))
        assert [trace["type"] for trace in plot.data] == traces
    on_target: dict[str, Any] = {
        "coordinates": "place on the target",
        "map_place": place,
        "map_displacement": pose[:, :3],
    }
    colours = plots.effect_map(replace(effect, **on_target)).data[0]["marker"]["color"]
    np.testing.assert_allclose(colours, np.linalg.norm(pose[:, :3], axis=1))


@needs_browser
def test_the_map_of_a_located_effect_is_drawn_in_a_browser(located: Diagnosis, tmp_path: Path) -> None:
    report = diagnosis_report(located)
    page = open_page(save_report(report, tmp_path, "diagnosis").files[0], tmp_path)
    assert (page.console, page.plots) == ([], len(titles(report, Plot)))
    drawn = page.dom.partition("Effect on the panel: shift")[2].partition("<h2")[0]
    assert re.search(r'class="xtitle"[^>]*>panel u \(px\)<', drawn)
    arrows = plots.effect_map(located.effects[0]).data[1]["x"]
    assert drawn.count('class="point"') == len(arrows) > 50
