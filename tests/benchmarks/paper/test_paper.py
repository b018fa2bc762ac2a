import numpy as np
from present import narrowed, present

from benchmarks.moved_observations import moved_back, self_inconsistency_arcmin
from benchmarks.paper.along_rays import (
    DepthMeasure,
    pixel_inconsistency_px,
    real_point_inconsistency_arcmin,
    see_through_moved_back,
    world_ray_inconsistency,
)
from benchmarks.paper.experiments import (
    structure,
)
from benchmarks.trial_study import Study
from benchmarks.trials import EvaluatedEye, Outcome, Trial
from wlr_render.evaluation import mapping_error
from wlr_render.evaluation.metrics import summary
from wlr_render.mappings import Eye
from wlr_render.optics.device_file import load_device
from wlr_render.optics.traced_mappings import traced_eye
from wlr_render.report.blocks import ReportTable

SEED = 3
BOX = (10.0, 8.0, 6.0)


def eye(name: str) -> EvaluatedEye:
    return EvaluatedEye(name, "right", BOX, name=name)


def test_structure_shows_every_query_of_both_samplings_in_its_unit() -> None:
    size = {"planar": 1.0, "volumetric": 2.0}
    study = Study(
        (eye("a"),), lambda t: Outcome({measure: summary([size[narrowed(t, Trial).kind]]) for measure in DepthMeasure})
    )
    (table,) = structure(study).blocks
    assert isinstance(table, ReportTable)
    assert [row[2] for row in table.rows] == ["arcmin", "px", "arcmin", "mm", "arcmin"]
    assert all(row[3:] == [1.0, 2.0] for row in table.rows)


def test_true_optics_answer_alike_along_a_ray() -> None:
    eye = traced_eye(load_device("freeform40"))
    rng = np.random.default_rng(SEED)
    viewpoint = eye.eye_box.at(rng.uniform(-1, 1, (40, 3)))
    view_dir = present(eye.field).directions(5, 8)
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


def test_a_true_display_is_unchanged_along_its_rays(flat_image_headset: Eye) -> None:
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
