"""The sentences and the tables tell what the record holds."""

import re
from dataclasses import replace

import faked_diagnosis as fake
import pytest

from wlr_render.diagnosis.diagnosis import NO_EFFECT, UNEXPLAINED, ParameterValue
from wlr_render.diagnosis.gain import Gains, Rendered
from wlr_render.diagnosis.held_out import HeldOutGain
from wlr_render.diagnosis.refit import Refitted
from wlr_render.diagnosis.report_tables import gains_table, tables
from wlr_render.diagnosis.report_text import advice, value_text, verdict_sentence, warnings
from wlr_render.evaluation.metrics import Summary
from wlr_render.report.blocks import cell_text


@pytest.fixture(scope="module")
def diagnosis(tmp_path_factory):
    return fake.explained(*fake.measured(tmp_path_factory.mktemp("session"), "target_scale"), "target_scale")


def cells(diagnosis):
    """Text of all tables, by title."""
    return {table.title: [" ".join(row) for row in table.text_rows()] for table in tables(diagnosis)}


def test_the_sentence_names_the_cause_its_size_and_the_change(diagnosis):
    sentence = verdict_sentence(diagnosis)
    assert sentence.startswith("Explained: printed size of the target (target_scale: scale_")
    before, after, noise = (
        cell_text(figures.see_through_rms_arcmin) for figures in (diagnosis.before, diagnosis.after, diagnosis.noise)
    )
    assert f"see-through residual {before}' -> {after}', noise {noise}'" in sentence
    # The display is not touched by the target.
    assert "display" not in sentence


def test_other_verdicts_have_their_own_sentences(diagnosis):
    none = fake.nothing(diagnosis)
    assert verdict_sentence(none).startswith("No effect found")
    assert len(advice(none)) == 1
    part = fake.partly(diagnosis)
    assert verdict_sentence(part).startswith("Partly explained: printed size")
    assert verdict_sentence(part).endswith(
        "in the display part 2.37 times the noise is left, and it goes with panel pixels."
    )
    unknown = replace(part, verdict=UNEXPLAINED, causes=())
    assert verdict_sentence(unknown).startswith("Unexplained: no cause in the list accounts for")
    assert any("panel pixels" in sentence for sentence in advice(unknown))


def test_a_look_alike_is_warned_of_and_measured_against_only_where_the_session_does_not_decide(diagnosis):
    decided, doubtful = diagnosis, fake.partly(diagnosis)
    for each in (decided, doubtful):
        told = next(sentence for sentence in warnings(each) if fake.RIVAL in sentence)
        assert fake.SEPARATED_BY in told
        assert ("The session decides" in told) == (each is decided)
    assert not any("Before acting" in sentence for sentence in advice(decided))
    assert f"tell it from {fake.RIVAL}" in advice(doubtful)[0]
    assert fake.SEPARATED_BY in advice(doubtful)[0]


def test_a_stated_noise_that_is_not_believable_and_moved_captures_are_warned_of(diagnosis):
    told = " ".join(warnings(fake.partly(diagnosis)))
    assert "The stated noise of the display readings, 0.05 px, is not believable: they scatter by 0.0931 px" in told
    assert "Captures that moved were set aside (1)" in told
    assert "believable" not in " ".join(warnings(diagnosis))
    assert any("display capture 3" in sentence for sentence in advice(fake.partly(diagnosis)))


@pytest.mark.parametrize(
    ("value", "sigma", "unit", "text"),
    [
        (0.20213, 0.00031, "%", "a 0.20213 +- 0.00031 %"),
        (-1234.5678, 12.0, "um", "a -1235 +- 12 um"),
        (1.5, 0.25, "1", "a 1.50 +- 0.25"),
        (812.25, 0.0, "s", "a 812.25 s"),
    ],
)
def test_a_value_has_the_digits_of_its_error(value, sigma, unit, text):
    assert value_text(ParameterValue("a", value, sigma, unit, 1.0)) == text


def test_tables_tell_the_numbers_of_the_record(diagnosis):
    told = cells(fake.partly(diagnosis))
    assert list(told) == [
        "Simulation against measurement",
        "Causes",
        "Look-alikes",
        "Captures that moved",
        "What is left in the display part, 2.37 times the noise",
        "Ranking",
        "Noise",
    ]
    figures = told["Simulation against measurement"]
    assert cell_text(diagnosis.before.see_through_rms_arcmin) in figures[1]
    assert cell_text(diagnosis.before.over_noise) in figures[2]
    (cause,) = told["Causes"]
    assert all(value_text(parameter) in cause for parameter in diagnosis.causes[0].parameters)
    assert "5.25 80.9 +- 1.2" in cause
    assert told["Look-alikes"] == [f"target_scale {fake.RIVAL} 0.9876 {fake.SEPARATED_BY}"]
    assert told["Captures that moved"] == ["display capture 3 +0.410 -0.720 +0.130 +0.050 +0.260 -0.070 9.5 1.02"]
    assert told["What is left in the display part, 2.37 times the noise"][0] == "panel pixels smooth 9 31.4 +- 2.2 8.6"
    assert f"1: target_scale {fake.RIVAL} as a whole 3.21 1.5" in told["Ranking"]
    assert told["Noise"][0] == "display 0.05 0.0931 - 0.0931 no"


def test_without_an_effect_the_detection_limits_are_told_and_no_extended_bench(diagnosis):
    none = fake.nothing(diagnosis)
    assert none.verdict == NO_EFFECT
    told = cells(none)
    assert told["What would have been found"] == ["target_scale scale_x 0.0123 %", "latency latency 0.456 ms"]
    assert "Causes" not in told
    assert not any("extended" in column for column in tables(none)[0].columns)


def test_what_the_extension_is_worth_is_told_where_it_could_be_measured():
    refitted = Refitted(3, None, None, 1.06, 0.347, HeldOutGain(67.2, 0.7, 30.0))
    before, after = (Summary(rms, 0.1, 0.2, 0.3, 9, 0) for rms in (0.99, 0.169))
    table = gains_table(Gains(None, refitted, Rendered(before, after), None, ("s: has no display table.",)))
    rows = [" ".join(row) for row in table.text_rows()]
    assert len(rows) == 2
    assert re.fullmatch(r"see-through model .* 1\.06 0\.347 67\.2 \+- 0\.7", rows[0])
    assert re.fullmatch(r"picture rendered with the refitted models 0\.99 0\.169 82\.9", rows[1])
    assert table.notes[-1] == "s: has no display table."
