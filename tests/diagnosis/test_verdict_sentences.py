"""The sentences and tables of real diagnoses state what their records hold."""

import re
import tomllib
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from diagnosis.small_session import SIGMA_PX, diagnosed, measured, with_motions, with_moved_capture
from present import present

from wlr_render.bench.bench import Bench
from wlr_render.bench.bench_file import load_bench, save_bench
from wlr_render.captures.session import SessionPlan
from wlr_render.diagnosis import diagnosis_plots as plots
from wlr_render.diagnosis import tables
from wlr_render.diagnosis.cause import Perturb
from wlr_render.diagnosis.causes import CAUSES
from wlr_render.diagnosis.diagnosis import DegenerateCause, ParameterValue, RankedCandidate, Unexplained
from wlr_render.diagnosis.held_out import HeldOutImprovement
from wlr_render.diagnosis.improvement import ImprovementInUse, Refitted, Rendered
from wlr_render.diagnosis.report import Diagnosis
from wlr_render.diagnosis.report_warnings import warnings
from wlr_render.diagnosis.residual_views import part_views
from wlr_render.diagnosis.verdict_sentences import advice, bench_sentence, value_text, values_to_type, verdict_sentence
from wlr_render.errors import BadInputError
from wlr_render.evaluation.metrics import Summary
from wlr_render.numerics.arrays import FloatArray
from wlr_render.report.blocks import cell_text

OTHER = "tracking_translation"


def test_the_sentence_names_causes_values_and_the_change(explained: Diagnosis) -> None:
    sentence = verdict_sentence(explained)
    assert sentence.startswith("Explained: combiner tilted (combiner_tilt: tilt_y -0.")
    assert " more value" in sentence.partition("; ")[0]
    assert "); printed size of the target (target_scale: scale_" in sentence
    before, after, noise = (
        cell_text(each.see_through_rms_arcmin) for each in (explained.before, explained.after, explained.expected)
    )
    assert f"see-through residual {before}' -> {after}', expected {noise}'" in sentence


def test_a_part_that_no_cause_touches_is_not_in_the_sentence(explained: Diagnosis) -> None:
    alone = replace(explained, after=replace(explained.after, display_rms_px=explained.before.display_rms_px))
    assert "display" not in verdict_sentence(alone)


def test_other_verdicts_have_their_own_sentences(located: Diagnosis, nothing: Diagnosis, explained: Diagnosis) -> None:
    assert verdict_sentence(nothing).startswith("No effect found: the bench as described predicts the session")
    assert advice(nothing) == [
        "Keep using the bench file; effects below the detection limits would not have been seen."
    ]
    sentence = verdict_sentence(located)
    assert sentence.startswith(
        "Effect located: an effect on the panel that no listed cause has: shift, a smooth function "
    )
    assert re.search(r"panel pixels, 2\.\d+ \+- 0\.0\d+ panel px rms \(log10 odds > 20\)", sentence)
    assert any("often come from a panel warped by its bonding" in step for step in advice(located))
    assert any("render with models fitted to the session" in step for step in advice(located))
    twice = replace(located, effects=(*located.effects, replace(located.effects[0], size=0.1)))
    assert advice(twice) == advice(located)
    left = (Unexplained("display", 0.5, 1.3), Unexplained("see-through", 0.4, 1.2))
    partly = replace(explained, verdict="partly explained", unexplained_parts=left)
    assert verdict_sentence(partly).startswith("Partly explained: combiner tilted")
    unexplained = replace(located, verdict="unexplained", effects=(), unexplained_parts=left)
    sentence = verdict_sentence(unexplained)
    assert "no cause, and no effect at any station, explains the residual" in sentence
    assert re.search(r"display residual is \S+ times the noise and the see-through residual is \S+ times", sentence)
    assert "of the display part and of the see-through part" in advice(unexplained)[0]


def test_an_effect_is_stated_with_its_place_its_rival_station_and_what_it_leaves(located: Diagnosis) -> None:
    effect = located.effects[0]
    unsure = replace(located, effects=(replace(effect, next_station="camera", odds_against_next_station=0.4),))
    assert "; the session hardly tells it from an effect in the camera" in verdict_sentence(unsure)
    assert any("To tell the panel from the camera: a photograph of the bare panel" in step for step in advice(unsure))
    shape: dict[str, Any] = {"form": "fine", "size": 310.0, "size_sigma": 20.0, "place": (-3.8, 2.8), "length": 2.4}
    spot = replace(effect, station="combiner", **shape, unit="urad", length_unit="mm")
    said = verdict_sentence(replace(located, effects=(spot,)))
    assert "a spot of 310 +- 20 urad, 2.4 mm wide, 3.8 mm left of and 2.8 mm above the line of sight" in said
    on_panel = replace(spot, station="panel", unit="panel px", length_unit="px")
    assert "2.4 px wide, at (-3.8, 2.8) px" in verdict_sentence(replace(located, effects=(on_panel,)))
    follows, does_not = (" ".join(advice(replace(located, effects=(each,)))) for each in (effect, spot))
    assert "render with models fitted to the session (`calibrate`): they absorb" in follows
    assert "Models fitted to the session (`calibrate`) are too smooth to follow it" in does_not
    assert "they absorb" not in does_not
    assert "a fine pattern of 310 +- 20 urad rms" in verdict_sentence(
        replace(located, effects=(replace(spot, place=None),))
    )
    left = verdict_sentence(replace(located, verdict="partly explained"))
    assert ". The effects remove less than half of the excess of captures left out" in left
    assert "less than half" not in verdict_sentence(located)


def test_noise_far_above_the_stated_one_is_said_before_the_residuals(nothing: Diagnosis, explained: Diagnosis) -> None:
    noisier = [replace(each, measured_px=2.0 * each.stated_px) for each in explained.noise_floors]
    head, noise, *_ = verdict_sentence(replace(explained, noise_floors=tuple(noisier))).split(". ")
    assert explained.causes[0].title in head.lower()
    assert (
        noise
        == "The display readings are 2 times and the see-through readings are 2 times as noisy as the bench states"
    )
    first, *others = nothing.noise_floors
    unmeasured = replace(first, measured_px=float("nan"))
    noisy = [replace(each, measured_px=2.0 * each.stated_px) for each in others]
    said = verdict_sentence(replace(nothing, noise_floors=(unmeasured, *noisy)))
    assert said.startswith("No effect found, but the see-through readings are 2 times as noisy as the bench states")


def test_repeatability_that_no_stage_has_and_parts_that_differ_are_warned_of(nothing: Diagnosis) -> None:
    """Two parts on one stage must repeat alike; a size within its error is no finding."""
    display, see_through = nothing.motions
    alike = replace(
        nothing,
        motions=(
            replace(display, shift_um=9.0, shift_error_um=1.0),
            replace(see_through, shift_um=8.0, shift_error_um=1.0),
        ),
    )
    assert not any("repeat" in each for each in warnings(alike))
    far = replace(display, shift_um=80.0, shift_error_um=8.0)
    told = warnings(replace(alike, motions=(far, alike.motions[1])))
    assert any("display part repeat to 80 um only; ordinary stages repeat to 30 um" in each for each in told)
    assert any("with one stage: one of the parts has an effect that looks like motion" in each for each in told)
    unsure = warnings(replace(alike, motions=(replace(far, shift_error_um=75.0), alike.motions[1])))
    assert not any("um only" in each or "looks like motion" in each for each in unsure)


def test_the_values_to_type_make_the_bench_file_that_of_the_corrected_bench(
    explained: Diagnosis, tmp_path: Path
) -> None:
    (line,) = values_to_type(explained)
    assert any(line in step for step in advice(explained))
    table, keys = line.split("] ", 1)
    typed = tomllib.loads(f"{table}]\n" + keys)
    path = save_bench(explained.observations.nominal, tmp_path / "bench.toml")
    path.write_text(path.read_text() + f"\n{table}]\n{keys}\n")
    assert load_bench(path).target.scale == pytest.approx(explained.corrected.target.scale, abs=1e-6)
    assert typed["target"]["scale"] == pytest.approx([1.003, 1.003], abs=2e-4)


@pytest.mark.parametrize("fails", ["above", "beside"])
def test_a_cause_that_fails_beside_its_value_leaves_the_report(explained: Diagnosis, fails: str) -> None:
    """A cause of the user's own may be valid up to a limit; digits then follow from the other side, or all are kept."""
    explanation = explained.fit.explanation
    place = explanation.names.index("target_scale")
    hypothesis, found = explanation.hypotheses[place], explanation.values[place]

    def refusing(perturb: Perturb) -> Perturb:
        def limited(bench: Bench, values: FloatArray) -> Bench:
            if np.any(values > found) or (fails == "beside" and np.any(values < found)):
                raise BadInputError("cause 'target_scale' fails in its variant 'as a whole' (ValueError: limit).")
            return perturb(bench, values)

        return limited

    variants = {name: refusing(perturb) for name, perturb in hypothesis.cause.variants.items()}
    hypotheses = list(explanation.hypotheses)
    hypotheses[place] = replace(hypothesis, cause=replace(hypothesis.cause, variants=variants))
    at = replace(explained.fit.at, explanation=replace(explanation, hypotheses=tuple(hypotheses)))
    limited = replace(explained, fit=replace(explained.fit, at=at))
    (line,) = values_to_type(limited)
    full = ", ".join(f"{value:.7g}" for value in explained.corrected.target.scale)
    assert line == (values_to_type(explained)[0] if fails == "above" else f"[target] scale = [{full}]")
    assert any(line in step for step in advice(limited))


def test_excluded_captures_and_wrong_noise_are_warned_of(explained: Diagnosis, located: Diagnosis) -> None:
    assert [str(each.capture) for each in explained.excluded] == ["display capture 3"]
    assert any("Captures that moved were excluded (1)" in each for each in warnings(explained))
    assert advice(explained)[-1] == "Take again, or leave out: display capture 3."
    (told,) = [each for each in warnings(located) if "point_sigma_px" in each]
    assert re.fullmatch(
        r"The noise differs from point_sigma_px by (9|10)\d %: type point_sigma_px = 0\.(19|20)\d\.", told
    )
    display, see_through = located.noise_floors
    parts = (display, replace(see_through, is_believable=True))
    (told,) = [each for each in warnings(replace(located, noise_floors=parts)) if "The noise" in each]
    assert re.search(r"differs from the stated one: display by 10\d %\.", told)


def test_a_degenerate_cause_is_measured_against_only_where_the_session_does_not_decide(explained: Diagnosis) -> None:
    def against(log10_odds: float) -> Diagnosis:
        cause = replace(
            explained.causes[0],
            degenerate=(DegenerateCause(OTHER, 0.9876, "a nearer target"),),
            ranking=(RankedCandidate(OTHER, "as a whole", 3.2, log10_odds),),
        )
        return replace(explained, causes=(cause,))

    decided, doubtful = against(176.0), against(0.4)
    for each in (decided, doubtful):
        told = next(sentence for sentence in warnings(each) if OTHER in sentence)
        assert ("a nearer target" in told) == (each is doubtful)
        assert ("The session decides" in told) == (each is decided)
    assert not any("Before acting" in step for step in advice(decided))
    assert f"separate it from {OTHER}" in advice(doubtful)[0]
    assert "(log10 odds against it 0.4): a nearer target" in advice(doubtful)[0]
    odds = [tables.ranking_table(each).text_rows()[0][-1] for each in (decided, doubtful)]
    assert odds == ["> 20", "0.4"]


def test_a_value_is_compared_with_its_usual_size_or_the_prior_that_the_bench_states(explained: Diagnosis) -> None:
    nominal = replace(explained.observations.nominal, priors={"combiner_tilt": {"tilt_x": (9.1, 0.1)}})

    def stated(value: float) -> Diagnosis:
        odd = replace(explained.causes[0], parameters=(ParameterValue("tilt_x", value, 0.05, "deg", 0.1, 9.1),))
        return replace(explained, causes=(odd,), observations=replace(explained.observations, nominal=nominal))

    assert explained.causes[0].name == "combiner_tilt"
    usual = replace(explained.causes[0], parameters=(ParameterValue("tilt_x", 9.0, 0.1, "deg", 1.0),))
    assert any("9 times its usual size" in each for each in warnings(replace(explained, causes=(usual,))))
    assert not any("usual size" in each for each in warnings(explained))
    assert not any("prior" in each or "usual size" in each for each in warnings(stated(9.0)))
    (told,) = [each for each in warnings(stated(8.3)) if "prior" in each]
    assert "tilt_x 8.300 +- 0.050 deg is 8 sigma from the prior in bench.toml ([9.1, 0.1])" in told
    table = tables.parameters_table(stated(9.0))
    assert table.text_rows()[0][table.columns.index("prior (mean, sigma)")] == "9.1, 0.1"
    assert "usual size" in tables.parameters_table(explained).columns
    assert tables.parameters_table(explained).notes[-1].startswith("Parameters are in OpenXR axes")


def test_the_motions_of_a_part_with_a_residual_left_are_no_repeatability(located: Diagnosis) -> None:
    """Where something of a part is unexplained, neither sentence nor table states them."""
    left = (Unexplained("display", 0.5, 1.3),)
    found = replace(located, verdict="partly explained", unexplained_parts=left)
    text = bench_sentence(found)
    assert "Repeatability of the display is not determined, as no cause explains its residual." in text
    assert "See-through: positions repeat to " in text
    # The part that the effect's correction changes, without what would be expected of it.
    assert re.search(r"\. Display residual \S+ panel px -> \S+ panel px\. The display", verdict_sentence(found))
    assert [row[0] for row in tables.repeatability_table(found).rows] == ["display (not determined)", "see-through"]
    residuals = tables.residuals_table(found)
    expected = {row[0]: row[residuals.columns.index("expected")] for row in residuals.rows}
    assert expected["display (panel px)"] is None is expected["all readings (sigma)"]
    assert expected["see-through (arcmin)"] == found.expected.see_through_rms_arcmin
    display = next(row for row in residuals.rows if row[0] == "display (panel px)")
    times = display[residuals.columns.index("corrected bench / noise")]
    alone = replace(found, verdict="unexplained", effects=())
    assert f"The display residual is {cell_text(times)} times the noise" in verdict_sentence(alone)


def test_a_part_that_is_noisier_than_stated_has_a_repeatability(located: Diagnosis) -> None:
    """What exceeds the stated noise is noise where photographs show it: nothing of the part is unexplained."""
    noisy = replace(located.fit.scatter, noise=1.5 * np.ones_like(located.fit.scatter.noise))
    found = replace(located, fit=replace(located.fit, scatter=noisy))
    assert found.unexplained_parts == ()
    assert "not determined" not in bench_sentence(found)
    assert "expected" in verdict_sentence(found)


def test_values_have_two_digits_of_their_error() -> None:
    scale, index = ParameterValue("scale", -0.304421, 0.000604, "%", 0.3), ParameterValue("index", 0.01234, 0.0, "1", 1)
    assert [value_text(scale), value_text(index)] == ["scale -0.30442 +- 0.00060 %", "index 0.0123"]


def test_tables_hold_the_numbers_of_the_record(explained: Diagnosis, located: Diagnosis, nothing: Diagnosis) -> None:
    rows = tables.causes_table(explained).text_rows()
    assert [row[0] for row in rows] == [cause.name for cause in explained.causes]
    assert f"{explained.causes[0].improvement.percent:.1f} +- " in rows[0][-1]
    assert rows[0][-2] == "> 20"
    captures = tables.captures_table(explained).rows
    assert [row[0] for row in captures if row[-1]] == ["display capture 3"]
    assert len(captures) == len(explained.observations.captures)
    assert tables.effects_table(located).rows[0][:2] == ["panel", "panel pixels"]
    assert tables.fields_table(located).rows[0][0] == "panel"
    assert not tables.fields_table(explained).rows
    assert len(tables.limits_table(nothing).rows) == len(nothing.detection_limits) > 0
    noise = tables.noise_table(located)
    assert [row[noise.columns.index("stated agrees")] for row in noise.rows] == ["no", "no"]
    residuals = {row[0]: row for row in tables.residuals_table(explained).rows}
    assert residuals["all readings (sigma)"][1:3] == [explained.before.over_noise, explained.after.over_noise]
    moved = tables.excluded_table(explained).text_rows()
    assert [(row[0], row[-1]) for row in moved] == [("display capture 3", "> 20")]


def test_expected_residuals_are_those_of_noise_and_motions(bench: Bench, plan: SessionPlan) -> None:
    """A clean bench whose captures repeat to 80 um has the residual that is expected of it, and more than its noise."""
    observations = measured(bench, plan, SIGMA_PX, seed=8)
    motions = np.zeros((len(observations.captures), 6))
    motions[:, :3] = 80.0 * np.random.default_rng(8).uniform(-np.sqrt(3.0), np.sqrt(3.0), (len(motions), 3))
    found = diagnosed(with_motions(observations, bench, motions), ("target_scale",))
    assert found.verdict == "no effect"
    for name in ("display_rms_px", "see_through_rms_arcmin", "over_noise"):
        after, expected, noise = (getattr(each, name) for each in (found.after, found.expected, found.noise))
        assert after > 1.2 * noise
        assert after == pytest.approx(expected, rel=0.15)
    display = part_views(found)[0]
    time = next(variable for variable in display.variables if variable.name == "time (s)")
    curve = plots.binned(time, display.seen["bench as described"], display)
    assert np.mean(np.abs(curve.means) < curve.band) > 0.85
    still = plots.binned(time, display.seen["bench as described"], replace(display, motion=0.0 * display.motion))
    assert np.mean(np.abs(still.means) < still.band) < 0.5


def test_too_many_captures_that_stand_out_are_listed_and_not_excluded(bench: Bench, plan: SessionPlan) -> None:
    observations = measured(bench, plan, SIGMA_PX, seed=9)
    for number in (1, 4, 5, 8, 10, 13, 16):
        observations = with_moved_capture(observations, bench, number)
    found = diagnosed(observations, ("target_scale",))
    assert found.verdict == "unexplained"
    assert found.excluded == ()
    assert [each.capture.capture for each in found.too_many_moved] == [1, 4, 5, 8, 10, 13, 16]
    assert found.used.all()
    assert ". 7 of 18 captures stand out, too many to tell which of them moved." in verdict_sentence(found)
    (step,) = [each for each in advice(found) if "none of them was excluded" in each]
    assert "display capture 1, display capture 4, display capture 5" in step
    assert len(tables.excluded_table(found).rows) == 7


def test_causes_of_one_remedy_share_its_sentence(explained: Diagnosis) -> None:
    target = next(cause for cause in explained.causes if cause.name == "target_scale")
    two = replace(explained, causes=(target, replace(target, name="target_bow", title="bowed target")))
    remedy, values, *_ = advice(two)
    assert remedy.startswith(f"{target.title.capitalize()} and bowed target: enter")
    assert values.startswith("In bench.toml: [target] scale")
    assert values.endswith("The corrected device is device.toml in the corrected session.")


def test_improvement_in_use_is_tabulated_where_there_is_some() -> None:
    refitted = Refitted(1.06, 0.347, HeldOutImprovement(67.2, 0.7, 30.0))
    before, after = (Summary(rms, 0.1, 0.2, 0.3, 9, 0) for rms in (0.99, 0.169))
    table = tables.in_use_table(
        ImprovementInUse(None, refitted, Rendered(before, after), None, ("s: no display table.",))
    )
    assert [row[1:] for row in table.text_rows()] == [["1.06", "0.347", "67.2 +- 0.7"], ["0.99", "0.169", "82.9"]]
    assert table.notes[-1] == "s: no display table."


def test_sentences_judge_by_the_settings_of_the_diagnosis(explained: Diagnosis, located: Diagnosis) -> None:
    """With higher odds asked for, what the residual depends on, and what is undecided, is another matter."""

    def strict(diagnosis: Diagnosis, **changes: Any) -> Diagnosis:
        return replace(diagnosis, settings=replace(diagnosis.settings, **changes))

    cause = replace(
        explained.causes[0],
        degenerate=(DegenerateCause(OTHER, 0.99, "a nearer target"),),
        ranking=(RankedCandidate(OTHER, "as a whole", 3.2, 6.0),),
    )
    decided = replace(explained, causes=(cause,))
    assert any("The session decides" in each for each in warnings(decided))
    assert any("does not decide" in each for each in warnings(strict(decided, decisive_odds=8.0)))
    assert located.settings.subsample == 1200  # as `diagnose` was given


def test_a_rotation_is_typed_in_full_but_in_no_sentence(explained: Diagnosis) -> None:
    turned = CAUSES["camera_rotation"].perturb(explained.observations.nominal, np.array([0.2, -0.1, 0.3]))
    diagnosis = replace(explained, corrected=turned)
    (line,) = values_to_type(diagnosis)
    rotation = np.array(tomllib.loads(line.split("] ", 1)[1])["rotation"])
    np.testing.assert_allclose(rotation @ rotation.T, np.eye(3), atol=1e-6)
    assert "The corrected session's bench.toml has [camera] rotation." in advice(diagnosis)
    assert not any("[[" in step for step in advice(diagnosis))


def test_values_to_type_have_the_digits_that_their_errors_allow(late: Diagnosis) -> None:
    """Two digits of the standard error."""
    (line,) = values_to_type(late)
    (latency,) = late.causes[0].parameters
    typed = present(re.fullmatch(r"\[clock\] latency_s = (0\.\d+)", line))[1]
    decimals = len(typed.partition(".")[2])
    assert 10 <= 1e-3 * latency.sigma * 10**decimals < 100
    assert float(typed) == pytest.approx(1e-3 * latency.value, abs=10.0**-decimals)
