import numpy as np
import pytest

from benchmarks.__main__ import main
from benchmarks.moved_observations import moved_back, self_inconsistency_arcmin
from benchmarks.paper.along_rays import (
    DepthMeasure,
    DepthTrial,
    pixel_inconsistency_px,
    real_point_inconsistency_arcmin,
    see_through_moved_back,
    world_ray_inconsistency,
)
from benchmarks.paper.experiments import (
    COUNTS,
    DISPLAY,
    KINDS,
    SEE_THROUGH,
    dense,
    see_through_positions,
    structure,
)
from benchmarks.trial_study import Study
from benchmarks.trials import EvaluatedEye, Measure, Outcome
from wlr_render.evaluation import mapping_error
from wlr_render.evaluation.metrics import summary
from wlr_render.optics.device_file import load_device
from wlr_render.optics.traced_mappings import traced_eye

SEED = 3
BOX = (10.0, 8.0, 6.0)


def eye(name):
    return EvaluatedEye(name, "right", BOX, name=name)


def outcome(forward):
    return Outcome({Measure.FORWARD: summary([forward]), Measure.BACKWARD: summary([0.1])})


def test_static_and_planar_models_never_contradict_themselves_along_a_ray_and_a_volumetric_one_does():
    trials = [DepthTrial("birdbath28", kind, 3, 25, BOX) for kind in ("static", "planar", "volumetric")]
    along = [trial.run(SEED).errors[DepthMeasure.ALONG_RAY].p95 for trial in trials]
    assert along[0] < 1e-6
    assert along[1] < 1e-6
    assert along[2] > 0.1


def test_all_four_mappings_of_planar_models_answer_alike_along_a_ray_and_volumetric_ones_do_not():
    along = {
        (side, kind): side.trial("freeform40", kind, 3, 25, BOX).run(SEED).errors
        for side in (DISPLAY, SEE_THROUGH)
        for kind in KINDS
    }
    for side in (DISPLAY, SEE_THROUGH):
        for _, measure, _ in side.queries:
            assert along[side, "planar"][measure].p95 < 1e-5, measure
            assert along[side, "volumetric"][measure].p95 > 1e-3, measure
            assert along[side, "volumetric"][measure].missing == 0


def test_structure_shows_every_query_of_both_samplings_in_its_unit():
    size = {"planar": 1.0, "volumetric": 2.0}
    study = Study((eye("a"),), lambda t: Outcome({measure: summary([size[t.kind]]) for measure in DepthMeasure}))
    (table,) = structure(study).blocks
    assert [row[2] for row in table.rows] == ["arcmin", "px", "arcmin", "mm", "arcmin"]
    assert all(row[3:] == [1.0, 2.0] for row in table.rows)


def test_see_through_positions_are_compared_at_equal_numbers():
    study = Study((eye("a"),), lambda t: Outcome({Measure.REAL_POINT: summary([t.viewpoints])}))
    table, plot = see_through_positions(study).blocks
    assert table.rows == [["a (right)", kind, *map(float, COUNTS)] for kind in KINDS]
    assert [trace["x"] for trace in plot.data] == [list(COUNTS)] * 2


def test_true_optics_answer_alike_along_a_ray():
    eye = traced_eye(load_device("freeform40"))
    rng = np.random.default_rng(SEED)
    viewpoint = eye.eye_box.at(rng.uniform(-1, 1, (40, 3)))
    view_dir = eye.field.directions(5, 8)
    through = np.full(len(view_dir), 0.006)
    seen = mapping_error.see_through_observations(eye.see_through, viewpoint, view_dir, through + 0.5)
    angle, offset = world_ray_inconsistency(eye.see_through, seen, through)
    np.testing.assert_allclose(angle, 0.0, atol=1e-6)
    np.testing.assert_allclose(offset, 0.0, atol=1e-12)
    np.testing.assert_allclose(real_point_inconsistency_arcmin(eye.see_through, seen, through), 0.0, atol=1e-6)
    back = mapping_error.see_through_error(eye.see_through, see_through_moved_back(seen, 0.010))
    np.testing.assert_allclose(back.backward_arcmin, 0.0, atol=1e-6)
    shown = mapping_error.observations_of_dirs(eye.display, viewpoint, view_dir)
    assert len(shown.pixel) > 30
    np.testing.assert_allclose(pixel_inconsistency_px(eye.display, shown, through[:1]), 0.0, atol=1e-6)


def test_moved_back_along_its_rays_planar_sampling_is_as_accurate_as_in_the_eye_box():
    # Found once with an independent program in the same eye box, as the figures in tests/benchmarks/test_trials.py.
    errors = DepthTrial("northstar", "planar", 5, 25, BOX).run(SEED)
    np.testing.assert_allclose(errors.rms(DepthMeasure.MOVED_BACK), 0.23, rtol=0.2)


def test_the_verdict_on_dense_captures_follows_the_numbers():
    forward = {("a", "planar"): 1.0, ("a", "volumetric"): 2.0, ("b", "planar"): 1.0, ("b", "volumetric"): 0.5}
    study = Study((eye("a"), eye("b")), lambda t: outcome(forward[t.device, t.kind]))
    table, plot = dense(DISPLAY, (3,), study).blocks
    assert "in 1 of 2 cases" in table.notes[0]
    assert "b (right) N=3 (0.50)" in table.notes[0]
    assert [row[-1] for row in table.rows] == [2.0, 0.5]
    assert [(trace["name"], list(trace["y"])) for trace in plot.data] == [
        (f"{name} (right), {kind}", [value]) for (name, kind), value in forward.items()
    ]


def test_a_true_display_is_unchanged_along_its_rays(flat_image_headset):
    box = flat_image_headset.eye_box
    viewpoint = box.at(np.random.default_rng(3).uniform(-1, 1, (20, 3)))
    display_observations = mapping_error.observations_of_pixels(
        flat_image_headset.display, viewpoint, np.full((20, 2), [70.0, 50.0])
    )
    assert len(display_observations.pixel) > 10
    back = moved_back(display_observations, 0.010)
    error = mapping_error.display_error(flat_image_headset.display, back)
    np.testing.assert_allclose(error.forward_arcmin, 0.0, atol=1e-9)
    inconsistency = self_inconsistency_arcmin(
        flat_image_headset.display, display_observations.viewpoint, display_observations.pixel, np.array(0.003)
    )
    np.testing.assert_allclose(inconsistency, 0.0, atol=1e-9)


@pytest.mark.parametrize(
    ("arguments", "words"),
    [(["--degrees", "13"], "--degrees is 13"), (["no-such-device"], "no-such-device")],
)
def test_impossible_studies_are_refused_before_they_start(arguments, words, tmp_path, capsys):
    assert main(["paper", *arguments, "--out", str(tmp_path / "out")]) == 2
    assert words in capsys.readouterr().err
    assert not (tmp_path / "out").exists()
