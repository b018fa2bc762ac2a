"""The sentences and tables of real diagnoses state what their records hold."""

import tomllib
from dataclasses import replace

import pytest

from wlr_render.calibration.fit_report import HeldOut
from wlr_render.diagnosis import tables
from wlr_render.diagnosis.diagnosis import DegenerateCause, ParameterValue, RankedCandidate
from wlr_render.diagnosis.explain import advice, value_text, values_to_type, verdict_sentence, warnings
from wlr_render.diagnosis.fit import HeldOutImprovement
from wlr_render.diagnosis.improvement import ImprovementInUse, Refitted, Rendered
from wlr_render.evaluation.metrics import Summary
from wlr_render.report.blocks import cell_text
from wlr_render.simulation.bench_file import load_bench, save_bench

OTHER = "tracking_translation"


def test_the_sentence_names_causes_values_and_the_change(explained):
    sentence = verdict_sentence(explained)
    assert sentence.startswith("Explained: combiner tilted (combiner_tilt: tilt_y -0.")
    assert "and 2 more values); printed size of the target (target_scale: scale_" in sentence
    before, after, noise = (
        cell_text(each.see_through_rms_arcmin) for each in (explained.before, explained.after, explained.noise)
    )
    assert f"see-through residual {before}' -> {after}', noise {noise}'" in sentence


def test_a_part_that_no_cause_touches_is_not_in_the_sentence(explained):
    alone = replace(explained, after=replace(explained.after, display_rms_px=explained.before.display_rms_px))
    assert "display" not in verdict_sentence(alone)


def test_other_verdicts_have_their_own_sentences(unexplained, nothing, explained):
    assert verdict_sentence(nothing).startswith("No effect found: the bench as described predicts the session")
    assert advice(nothing) == [
        "Keep using the bench file; effects below the detection limits would not have been seen."
    ]
    sentence = verdict_sentence(unexplained)
    assert sentence.startswith("Unexplained: no cause in the list explains the residual")
    assert sentence.endswith("times the noise and depends on panel pixels.")
    assert any("render with models fitted to the session" in step for step in advice(unexplained))
    partly = replace(explained, verdict="partly explained", unexplained=unexplained.unexplained)
    assert verdict_sentence(partly).startswith("Partly explained: combiner tilted")


def test_the_values_to_type_make_the_bench_file_that_of_the_corrected_bench(explained, tmp_path):
    (line,) = values_to_type(explained)
    assert any(line in step for step in advice(explained))
    table, keys = line.split("] ", 1)
    typed = tomllib.loads(f"{table}]\n" + keys)
    path = save_bench(explained.observations.nominal, tmp_path / "bench.toml")
    path.write_text(path.read_text() + f"\n{table}]\n{keys}\n")
    assert load_bench(path).target.scale == pytest.approx(explained.corrected.target.scale, abs=1e-6)
    assert typed["target"]["scale"] == pytest.approx([1.003, 1.003], abs=2e-4)


def test_excluded_captures_and_wrong_noise_are_warned_of(explained, unexplained):
    assert [str(each.capture) for each in explained.excluded] == ["display capture 3"]
    assert any("Captures that moved were excluded (1)" in each for each in warnings(explained))
    assert advice(explained)[-1] == "Take again, or leave out: display capture 3."
    told = [each for each in warnings(unexplained) if "stated noise" in each]
    assert len(told) == 2
    assert "The stated noise of the display readings, 0.1 px, is wrong: they scatter by 0." in told[0]


def test_a_degenerate_cause_is_measured_against_only_where_the_session_does_not_decide(explained):
    def against(log10_odds):
        cause = replace(
            explained.causes[0],
            degenerate=(DegenerateCause(OTHER, 0.9876, "a nearer target"),),
            ranking=(RankedCandidate(OTHER, "as a whole", 3.2, log10_odds),),
        )
        return replace(explained, causes=(cause,))

    decided, doubtful = against(176.0), against(0.4)
    for each in (decided, doubtful):
        told = next(sentence for sentence in warnings(each) if OTHER in sentence)
        assert "a nearer target" in told
        assert ("The session decides" in told) == (each is decided)
    assert not any("Before acting" in step for step in advice(decided))
    assert f"separate it from {OTHER}" in advice(doubtful)[0]
    odds = (
        [row[-1] for row in tables.ranking_table(decided).rows],
        [row[-1] for row in tables.ranking_table(doubtful).rows],
    )
    assert odds == (["> 20"], [0.4])


def test_a_value_far_beyond_its_usual_size_is_warned_of(explained):
    odd = replace(explained.causes[0], parameters=(ParameterValue("tilt_x", 9.0, 0.1, "deg", 1.0),))
    assert any("9 times its usual size" in each for each in warnings(replace(explained, causes=(odd,))))
    assert not any("usual size" in each for each in warnings(explained))


@pytest.mark.parametrize(
    ("parameter", "text"),
    [
        (ParameterValue("scale", -0.304421, 0.000604, "%", 0.3), "scale -0.30442 +- 0.00060 %"),
        (ParameterValue("index", 0.01234, 0.0011, "1", 0.01), "index 0.0123 +- 0.0011"),
        (ParameterValue("moment", 1290.0, 0.0, "s", 1000.0), "moment 1290 s"),
        (ParameterValue("a", 123.0, 45.0, "s", 1.0), "a 123 +- 45 s"),
    ],
)
def test_values_have_two_digits_of_their_error(parameter, text):
    assert value_text(parameter) == text


def test_tables_hold_the_numbers_of_the_record(explained, unexplained, nothing):
    rows = tables.causes_table(explained).text_rows()
    assert [row[0] for row in rows] == [cause.name for cause in explained.causes]
    assert f"{explained.causes[0].improvement.percent:.1f} +- " in rows[0][-1]
    captures = tables.captures_table(explained).rows
    assert [row[0] for row in captures if row[-1]] == ["display capture 3"]
    assert len(captures) == len(explained.observations.captures)
    assert tables.unexplained_table(unexplained).rows[0][0] == "panel pixels"
    assert not tables.unexplained_table(explained).rows
    assert len(tables.limits_table(nothing).rows) == len(nothing.detection_limits) > 0
    assert [row[-1] for row in tables.noise_table(unexplained).rows] == ["no", "no"]
    residuals = {row[0]: row for row in tables.residuals_table(explained).rows}
    assert residuals["all readings (sigma)"][1:3] == [explained.before.over_noise, explained.after.over_noise]


def test_improvement_in_use_is_tabulated_where_there_is_some():
    own = HeldOut("one capture in four", 9, 0.4, 0.4)
    refitted = Refitted(own, own, 1.06, 0.347, HeldOutImprovement(67.2, 0.7, 30.0))
    before, after = (Summary(rms, 0.1, 0.2, 0.3, 9, 0) for rms in (0.99, 0.169))
    table = tables.in_use_table(
        ImprovementInUse(None, refitted, Rendered(before, after), None, ("s: no display table.",))
    )
    assert [row[1:] for row in table.text_rows()] == [["1.06", "0.347", "67.2 +- 0.7"], ["0.99", "0.169", "82.9"]]
    assert table.notes[-1] == "s: no display table."
