"""Maps of the predicted error against the covariance that they interpolate."""

from collections.abc import Iterator
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from fitted_eyes import fitted_eye, with_source

from wlr_render.budget.error_map import ErrorMap, predicted_error
from wlr_render.budget.error_sizes import ErrorSizes, EyeTracker, HeadTracker
from wlr_render.budget.registration_budget import registration_covariance
from wlr_render.budget.statement import variance
from wlr_render.mappings import Eye, FieldOfView
from wlr_render.numerics.arrays import FloatArray

TRACKERS = ErrorSizes(EyeTracker(4e-5, 1.3e-4, 0.045, (0.0027, 0.0027, 0.0)), HeadTracker(3.5e-4, 5e-4, 0.002, 0.26))


@pytest.fixture(scope="module")
def eye() -> Eye:
    return fitted_eye("northstar", 5)


@pytest.fixture(scope="module")
def error_map(eye: Eye) -> ErrorMap:
    return ErrorMap(eye, TRACKERS, 9, 8)


def exact_rms(eye: Eye, pixel: FloatArray, viewpoint: FloatArray, depth_m: float, sizes: ErrorSizes) -> FloatArray:
    return np.sqrt(variance(registration_covariance(eye, pixel, viewpoint, depth_m, sizes).total))


def places(eye: Eye, count: int = 6) -> Iterator[Any]:
    """Viewpoints all over the eye box, with depths from 0.2 to 50 m."""
    rng = np.random.default_rng(8)
    return zip(eye.eye_box.at(rng.uniform(-1, 1, (count, 3))), 1.0 / rng.uniform(0.02, 5.0, count), strict=True)


def test_a_map_is_the_covariance_at_its_viewpoint_and_depth(eye: Eye, error_map: ErrorMap) -> None:
    for viewpoint, depth_m in places(eye):
        found = error_map.at(viewpoint, depth_m)
        exact = registration_covariance(eye, error_map.pixel, viewpoint, depth_m, TRACKERS).total
        np.testing.assert_allclose(found.covariance, exact, atol=2e-3 * exact.max())


def test_sources_are_named_and_their_squares_add_up(eye: Eye) -> None:
    """Of a headset with a large error of one source, at a viewpoint and depth between those that are computed."""
    printed = with_source(eye, "printing errors of the board")
    viewpoint = eye.eye_box.at(np.array([0.4, -0.7, 0.2]))
    interpolated = ErrorMap(printed, TRACKERS)
    found, exact = interpolated.at(viewpoint, 0.7), predicted_error(printed, TRACKERS, viewpoint, 0.7)
    for each in (found, exact):
        assert each.sources[0].name == "model: printing errors of the board"
        sizes = [source.rms_arcmin for source in each.sources]
        assert sizes == sorted(sizes, reverse=True)
        assert np.linalg.norm(sizes) == pytest.approx(each.rms_arcmin)
        assert each.record["sources"][0] == {"name": each.sources[0].name, "rms_arcmin": sizes[0]}
    far = predicted_error(printed, TRACKERS, viewpoint, np.inf).rms_arcmin
    assert interpolated.at(viewpoint, np.inf).rms_arcmin == pytest.approx(far, rel=0.03)
    stated = {each.name: each.rms_arcmin for each in exact.sources}
    assert {each.name: each.rms_arcmin for each in found.sources} == pytest.approx(stated, rel=0.03)
    assert stated["model: truncation"] == 0  # nothing is left to explain
    assert "drawing: whole pixels" not in stated
    by_source = registration_covariance(printed, exact.panel.grid(18, 16), viewpoint, 0.7, TRACKERS).by_source
    assert stated["head tracker: noise"] == pytest.approx(np.sqrt(np.mean(variance(by_source["head tracker: noise"]))))


def test_between_its_nodes_a_map_is_bilinear(eye: Eye, error_map: ErrorMap) -> None:
    pixel = np.random.default_rng(9).uniform(0.0, 1.0, (40, 2)) * eye.display.panel.size_px
    for viewpoint, depth_m in places(eye):
        exact = exact_rms(eye, pixel, viewpoint, depth_m, TRACKERS)
        np.testing.assert_allclose(error_map.at(viewpoint, depth_m).at_pixel(pixel), exact, rtol=0.04)


def test_the_models_own_part_is_within_six_per_cent_at_the_nodes(eye: Eye) -> None:
    own = ErrorMap(eye, ErrorSizes(), 4, 4)
    for viewpoint, depth_m in places(eye):
        exact = exact_rms(eye, own.pixel, viewpoint, depth_m, ErrorSizes())
        np.testing.assert_allclose(own.at(viewpoint, depth_m).rms_map_arcmin, exact, rtol=0.06)


def test_each_node_has_its_own_depth_and_nothing_is_predicted_without_one(eye: Eye, error_map: ErrorMap) -> None:
    viewpoint, depth_m = eye.eye_box.centre, np.full(error_map.pixel.shape[:2], 0.4)
    depth_m[2, 3], depth_m[4, 5], depth_m[0, 0] = 3.0, np.inf, np.nan
    found = error_map.at(viewpoint, depth_m).rms_map_arcmin
    near, far, farthest = (error_map.at(viewpoint, each).rms_map_arcmin for each in (0.4, 3.0, np.inf))
    assert (found[2, 3], found[4, 5], found[3, 3]) == (far[2, 3], farthest[4, 5], near[3, 3])
    assert np.isnan(found[0, 0])
    assert far[2, 3] < 0.7 * near[2, 3]


def test_another_viewpoint_has_another_map_and_one_outside_counts_as_the_nearest(eye: Eye, error_map: ErrorMap) -> None:
    centre, corner, beyond = (error_map.at(eye.eye_box.at(np.full(3, each)), 1.0).covariance for each in (0, 1, 1.6))
    assert np.abs(corner - centre).max() > 0.02 * centre.max()
    np.testing.assert_allclose(beyond, corner, rtol=1e-12)


def test_figures_are_those_of_the_field_of_view(eye: Eye, error_map: ErrorMap) -> None:
    whole = error_map.at(eye.eye_box.centre, 1.0)
    assert whole.rms_arcmin == pytest.approx(np.sqrt(np.mean(whole.rms_map_arcmin.astype(float) ** 2)))
    assert 1.5 < whole.radius_arcmin / whole.rms_arcmin < 2.0  # Rayleigh: 1.73
    view = np.sort(eye.display.view_dir_of_pixel(error_map.pixel, eye.eye_box.centre).value[..., 0].ravel())
    left = FieldOfView(np.array([-5.0, -5.0]), np.array([view[len(view) // 2], 5.0]))
    half = ErrorMap(replace(eye, field=left), TRACKERS, 9, 8).at(eye.eye_box.centre, 1.0)
    seen = left.contains(eye.display.view_dir_of_pixel(error_map.pixel, eye.eye_box.centre).value)
    np.testing.assert_array_equal(half.in_field, seen)
    assert 0 < seen.sum() < seen.size
    assert half.rms_arcmin == pytest.approx(np.sqrt(np.mean(whole.rms_map_arcmin[seen].astype(float) ** 2)))
    nothing = error_map.at(eye.eye_box.centre, np.nan)
    assert np.isnan([nothing.rms_arcmin, nothing.radius_arcmin]).all()
    assert nothing.record == {"rms_arcmin": None, "radius_arcmin": None, "sources": []}


def test_the_three_channels_are_right_up_and_length(eye: Eye, error_map: ErrorMap) -> None:
    right, up, length = np.moveaxis(error_map.at(eye.eye_box.centre, 1.0).map_arcmin.astype(float), -1, 0)
    np.testing.assert_allclose(np.hypot(right, up), length, rtol=1e-5)
    assert np.all(right > 0)
