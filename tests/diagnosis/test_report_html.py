"""The page is whole in itself, and its pictures show the residuals."""

import re
from dataclasses import replace
from html.parser import HTMLParser

import faked_diagnosis as fake
import numpy as np
import pytest

from wlr_render.diagnosis import pictures
from wlr_render.diagnosis.report_html import report_html
from wlr_render.diagnosis.report_parts import report_parts

CAUSES = ("combiner_tilt", "target_scale")


@pytest.fixture(scope="module")
def diagnosis(tmp_path_factory):
    return fake.explained(*fake.measured(tmp_path_factory.mktemp("session"), *CAUSES), *CAUSES)


@pytest.fixture(scope="module")
def page(diagnosis):
    return report_html(fake.partly(diagnosis))


class Outline(HTMLParser):
    """Tags that are open, and every attribute."""

    def __init__(self):
        super().__init__()
        self.open, self.attributes, self.text = [], [], []

    def handle_starttag(self, tag, attrs):
        self.attributes += attrs
        if tag not in ("meta", "img"):
            self.open.append(tag)

    def handle_endtag(self, tag):
        assert self.open.pop() == tag

    def handle_data(self, data):
        self.text.append(data)


def test_the_page_needs_no_other_file_and_is_well_formed(page):
    outline = Outline()
    outline.feed(page)
    assert outline.open == []
    named = dict(outline.attributes)
    assert "href" not in named
    sources = [value for name, value in outline.attributes if name == "src"]
    assert len(sources) == 4
    assert all(value.startswith("data:image/png;base64,") for value in sources)
    assert "http" not in re.sub(r"base64,[^\"]*", "", page)
    assert not re.search(r"@import|url\(|<script|<link", page)
    assert len(page) < 3e6


def test_the_page_tells_verdict_causes_outliers_and_how_to_go_on(page, diagnosis):
    outline = Outline()
    outline.feed(page)
    text = " ".join(outline.text)
    for words in (
        "partly explained",
        *CAUSES,
        *(f"{p.name} {p.value:.3f}" for p in diagnosis.causes[0].parameters[:1]),
        "display capture 3",
        "goes with panel pixels",
        fake.RIVAL,
        fake.SEPARATED_BY,
        "is not believable",
        "calibrate --captures",
        "render extended/device.toml",
    ):
        assert words in text, words


def test_names_are_escaped_and_an_unchanged_device_is_not_rendered_with(diagnosis):
    observations = diagnosis.observations
    renamed = replace(observations, session=replace(observations.session, name="<b>&amp"))
    page = report_html(replace(diagnosis, observations=renamed, extended=observations.nominal))
    assert "<b>" not in page
    assert "Diagnosis of &lt;b&gt;&amp;amp" in page
    assert "render extended/device.toml" not in page


def test_parts_hold_the_residuals_that_count_in_their_units(diagnosis):
    aside = fake.partly(diagnosis)
    display, see_through = report_parts(aside)
    assert [state.name for state in display.states] == ["bench as described", "extended bench"]
    before, after = display.states
    assert np.sqrt(np.nanmean(before.on_map[aside.used[: len(before.on_map)]] ** 2)) == pytest.approx(
        diagnosis.before.display_rms_px, rel=0.02
    )
    assert np.sqrt(np.nanmean(after.seen**2)) == pytest.approx(display.sigma_arcmin, rel=0.05)
    own = aside.observations.session.plan.display
    assert np.isnan(before.seen[own.capture == 3]).all()
    assert np.isfinite(before.seen[own.capture != 3]).all()
    assert not any("capture 3\n" in field.title for field in display.maps)
    assert len(display.maps) == 4
    assert [field.title.split(" at")[0] for field in see_through.maps] == [f"target pose {pose}" for pose in range(3)]
    names = [variable.name for variable in (*display.variables, *see_through.variables)]
    for name in ("time", "stage x", "stage y", "stage z", "distance", "radius on panel", "radius on camera"):
        assert any(each.startswith(name) for each in names), name
    # One colour is no variable.
    assert not any(each.startswith("colour") for each in names)


def test_maps_show_single_captures_from_places_far_apart(diagnosis):
    plan = diagnosis.observations.session.plan
    for part, side in zip(report_parts(diagnosis), (plan.display, plan.see_through), strict=True):
        places = [np.unique(side.stage[field.rows], axis=0) for field in part.maps]
        assert all(len(place) == 1 for place in places)
        gaps = [np.linalg.norm(a - b) for n, a in enumerate(places) for b in places[:n]]
        assert min(gaps) > 0.3 * np.ptp(side.stage, axis=0).max()


def test_without_an_effect_there_is_one_state_to_show(diagnosis):
    assert all(len(part.states) == 1 for part in report_parts(fake.nothing(diagnosis)))


def test_a_radial_residual_is_outwards_everywhere(diagnosis):
    """A target printed too large: dots are seen farther out, and nothing goes around."""
    see_through = report_parts(diagnosis)[1]
    radius = next(variable for variable in see_through.variables if variable.name.startswith("radius on camera"))
    assert radius.outwards is not None
    seen = 0.001 * radius.values[:, None] * radius.outwards
    figure = pictures.residual_curves(replace(see_through, states=(replace(see_through.states[0], seen=seen),)))
    axis = next(each for each in figure.axes if each.get_xlabel() == radius.name)
    lines = {line.get_label(): line.get_xydata() for line in axis.lines}
    np.testing.assert_allclose(lines["mean, right or outwards"][:, 1], 1e-3 * lines["mean, right or outwards"][:, 0])
    np.testing.assert_allclose(lines["mean, down or around"][:, 1], 0.0, atol=1e-12)


def test_maps_average_the_readings_of_a_cell(diagnosis):
    display = report_parts(diagnosis)[0]
    constant = np.broadcast_to([2.0, -1.0], display.place.shape)
    states = (replace(display.states[0], on_map=constant),)
    figure = pictures.residual_maps(replace(display, states=states))
    arrows = figure.axes[0].collections[0]
    np.testing.assert_allclose([arrows.U.min(), arrows.U.max()], 2.0)
    np.testing.assert_allclose(arrows.V, -1.0)
    assert "rms 1.58 panel px" in figure.axes[0].get_title()
    assert pictures.png(figure).startswith(b"\x89PNG")


def test_a_run_time_session_is_drawn(diagnosis):
    nominal = diagnosis.observations.nominal
    found = fake.explained(nominal, fake.ran(nominal), "latency")
    (part,) = report_parts(found)
    rate = next(variable for variable in part.variables if variable.name.startswith("head turns left"))
    # The dot is drawn where it was; by the time it is seen, a head turning left has carried it to the left.
    before, after = (np.polyfit(rate.values, state.seen[:, 0], 1)[0] for state in part.states)
    assert before == pytest.approx(-11e-3 * 60, rel=0.1)
    assert abs(after) < 0.02 * abs(before)
    page = report_html(found)
    assert "latency" in page
    # There are no captures to calibrate by.
    assert "diagnose extended --out again" in page
    assert "calibrate" not in page


def test_curves_show_what_averages_out_and_nothing_where_there_is_noise_alone(diagnosis):
    part = report_parts(diagnosis)[0]
    rng = np.random.default_rng(4)
    noise = rng.normal(0, part.sigma_arcmin, part.place.shape)
    # Half of the readings to the right, half to the left: no mean, but an rms.
    sides = np.where(rng.random(len(noise)) < 0.5, 1.0, -1.0)[:, None] * [3 * part.sigma_arcmin, 0.0]
    for residual, low, high in ((noise, 0.0, 0.5), (noise + sides, 1.9, 2.2)):
        figure = pictures.residual_curves(replace(part, states=(replace(part.states[0], seen=residual),)))
        lines = {line.get_label(): line.get_ydata() for line in figure.axes[0].lines}
        excess = lines["rms beyond the noise"] / part.sigma_arcmin
        assert np.median(excess) == pytest.approx(0.5 * (low + high), abs=0.5 * (high - low))
        assert np.abs(lines["mean, down or around"]).max() < 4 * part.sigma_arcmin / np.sqrt(len(noise) / len(excess))
