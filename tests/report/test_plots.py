from pathlib import Path

import numpy as np
from browser import driven_page, needs_browser, open_page

from wlr_render.report.blocks import Report
from wlr_render.report.plots import arrow_map, bars, curves, heat_map, small_heat_maps
from wlr_render.report.save import save_report


def test_grouped_curves_share_colours_by_group_and_dashes_by_kind() -> None:
    points = ([1, 2], [3.0, 4.0])
    plot = curves("Error", dict.fromkeys(("a, x", "a, y", "b, x"), points), ("N", "rms"), grouped=True)
    (ax, ay, bx) = (trace["line"] for trace in plot.data)
    assert ax["color"] == ay["color"] != bx["color"]
    assert ax["dash"] == bx["dash"] != ay["dash"]


def test_arrow_maps_have_one_scale_for_all_groups_and_a_reference_arrow() -> None:
    place = np.array([[0.0, 0.0], [100.0, 50.0], [20.0, 10.0]])
    small, large = np.array([[0.0, 1.0], [0.0, 1.0], [np.nan, 0.0]]), np.array([[4.0, 0.0], [0.0, 4.0], [0.0, 0.0]])
    plot = arrow_map(
        "Residual", {"a": (place, small), "b": (place, large)}, "arcmin", ("u (px)", "v (px)"), y_down=True
    )
    shaft_a, tip_a, shaft_b, tip_b, reference = plot.data
    assert [trace.get("visible", True) for trace in plot.data] == [True, True, False, False, True]
    length = np.ptp(reference["x"]) / float(reference["text"][1].split()[0])  # axis units per arcminute
    assert len(tip_a["x"]) == 2  # without the arrow that is not known
    # Up is towards smaller v; a group's own arrows are drawn in the common scale.
    np.testing.assert_allclose(tip_a["y"], [0.0 - length, 50.0 - length], rtol=1e-2)
    np.testing.assert_allclose(tip_b["x"], [4 * length, 100.0, 20.0], rtol=1e-2)
    np.testing.assert_allclose(shaft_b["x"][:2], [0.0, 4 * length], rtol=1e-2)
    assert np.isnan(shaft_a["x"][2])
    shown = [button["args"][0]["visible"] for button in plot.layout["updatemenus"][0]["buttons"]]
    assert shown == [[True, True, False, False, True], [False, False, True, True, True]]


def test_panels_of_an_arrow_map_share_axes_and_menu() -> None:
    place = np.array([[0.0, 0.0], [100.0, 50.0]])
    groups = {name: (place, size * np.ones((2, 2)), np.ones((2, 2))) for name, size in (("a", 4.0), ("b", 2.0))}
    plot = arrow_map("Residual", groups, "px", ("u", "v"), panels=("before", "after"))
    assert [trace.get("xaxis") for trace in plot.data] == [*["x", "x", "x2", "x2"] * 2, None]
    # Two bars of colours would be drawn over each other.
    assert [trace["marker"]["showscale"] for trace in plot.data[1::2]] == [True, False, True, False]
    assert (plot.layout["xaxis2"]["matches"], plot.layout["annotations"][1]["text"]) == ("x", "after")
    shown = [button["args"][0]["visible"] for button in plot.layout["updatemenus"][0]["buttons"]]
    assert shown == [[True] * 4 + [False] * 4 + [True], [False] * 4 + [True] * 5]
    tips = [plot.data[number]["x"][0] for number in (1, 3, 5)]
    np.testing.assert_allclose(np.divide(tips, tips[1]), [4.0, 1.0, 2.0], rtol=1e-2)


@needs_browser
def test_plots_of_every_kind_open_in_a_browser(tmp_path: Path) -> None:
    place = np.random.default_rng(1).uniform(0, 100, (30, 2))
    arrows = {name: (place, np.ones((30, 2))) for name in "ab"}
    plots = [
        curves("Curve", {"a": ([1, 10], [0.1, np.nan]), "b": ([1, 10], [2, 3])}, ("x (px)", "y"), log_x=True),
        heat_map("Map", np.array([[0.1, np.nan], [2.0, np.inf]]), "arcmin", limits=(0.1, 10)),
        bars("Sigma", ["one", "two"], {"x": [1.0, np.nan], "y": [2.0, 3.0]}, "mm"),
        arrow_map("Residual", arrows, "px", ("u", "v")),
        arrow_map("Panels", {"a": (place, place, -place)}, "px", ("u", "v"), panels=("before", "after")),
    ]
    page = open_page(save_report(Report("Plots", blocks=plots), tmp_path, "report").files[0], tmp_path)
    assert (page.console, page.plots) == ([], 5)


@needs_browser
def test_the_title_of_an_axis_lies_beside_its_numbers(tmp_path: Path) -> None:
    panel = heat_map("Map", np.ones((27, 24)), "arcmin", cell=60.0)
    path = save_report(Report("Plots", blocks=[panel]), tmp_path, "report").files[0]
    edges = "[...document.querySelectorAll('SELECTOR')].map(each => each.getBoundingClientRect().SIDE)"
    with driven_page(tmp_path) as page:
        page.open(path, "document.querySelector('.ytitle') !== null")
        (title,) = page.value(edges.replace("SELECTOR", ".ytitle").replace("SIDE", "right"))
        numbers = page.value(edges.replace("SELECTOR", ".ytick text").replace("SIDE", "left"))
    assert len(numbers) > 5
    assert title < min(numbers)


def test_small_heat_maps_share_one_logarithmic_scale() -> None:
    maps = {"large": np.array([[1.0, 10.0], [np.nan, 0.0]]), "small": np.full((2, 2), 1e-6)}
    plot = small_heat_maps("Sources", maps, "arcmin")
    assert [trace["coloraxis"] for trace in plot.data] == ["coloraxis", "coloraxis"]
    scale = plot.layout["coloraxis"]
    assert (scale["cmin"], scale["cmax"]) == (-2.0, 1.0)  # three decades: less shows nothing
    assert plot.data[0]["z"][0] == [0.0, 1.0]
    assert plot.data[1]["z"] == [[-2.0, -2.0]] * 2
    assert plot.data[1]["customdata"] == [[1e-6, 1e-6]] * 2
    first, second = (plot.layout[axis]["domain"] for axis in ("xaxis", "xaxis2"))
    assert first[1] < second[0]
