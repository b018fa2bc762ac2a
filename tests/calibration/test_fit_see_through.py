from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from calibration.toy_device import (
    EYE_BOX,
    PLANE,
    bend_of,
    grid_in_plane,
    places_among,
    positions_in_plane,
    see_through_captures,
)
from numpy.typing import NDArray
from present import narrowed

from wlr_render.calibration.fit_see_through import fit_see_through
from wlr_render.calibration.smooth_prior import NOISE_FLOOR_ARCMIN
from wlr_render.captures.correspondences import SeeThroughCaptures, concatenate, select
from wlr_render.errors import BadInputError
from wlr_render.geometry.directions import arcmin_between, dir_of_tangents, normalised
from wlr_render.geometry.planes import BasePlane
from wlr_render.geometry.rays import at_z, distance_to_point, split
from wlr_render.models.see_through_model import SeeThroughModel
from wlr_render.numerics.arrays import FloatArray

RNG = np.random.default_rng(9)
BASE = places_among(positions_in_plane(12), 40, seed=8)
TANGENTS = RNG.uniform([-0.38, -0.28], [0.38, 0.28], (40, 2))


def truth_at(depth: float, height: float) -> tuple[NDArray[Any], NDArray[Any], FloatArray]:
    """Points, viewpoints off the plane and view directions of the toy itself, (40, 3) each."""
    a, b = bend_of(BASE, TANGENTS)
    point = np.column_stack([BASE + b + depth * (TANGENTS + a), np.full(40, PLANE.z - depth)])
    viewpoint = np.column_stack([BASE - height * TANGENTS, np.full(40, PLANE.z + height)])
    return point, viewpoint, dir_of_tangents(TANGENTS)


def straight(base: FloatArray, tangents: object) -> tuple[FloatArray, FloatArray]:
    return np.zeros_like(base), np.zeros_like(base)


@pytest.mark.parametrize("tilt", [0.0, 0.3])
@pytest.mark.parametrize("height", [0.0, 0.004])
def test_planar_fit_recovers_a_device_of_its_own_kind_at_every_depth(tilt: float, height: float) -> None:
    found = fit_see_through(see_through_captures(positions_in_plane(12), tilt=tilt), "planar", 2)
    mapping, report = found.mapping, found.report
    for depth in (0.3, 1.0, 10.0):
        point, viewpoint, view_dir = truth_at(depth, height)
        seen = mapping.view_dir_of_real_point(point, viewpoint)
        assert seen.usable.all()
        np.testing.assert_allclose(seen.value, view_dir, atol=1e-10)
        ray = mapping.real_ray_of_view_dir(view_dir, viewpoint).value
        assert distance_to_point(ray, point).max() < 1e-9
    assert report.residual_arcmin.maximum < 1e-3 * NOISE_FLOOR_ARCMIN
    assert report.residual_px is None


def test_any_number_of_target_poses_goes_into_one_fit() -> None:
    captures = see_through_captures(positions_in_plane(12), depths=(0.4, 0.7, 1.5, 3.0))
    shuffled = select(captures, RNG.permutation(len(captures))[: len(captures) // 2])
    mapping = fit_see_through(shuffled, "planar", 2).mapping
    point, viewpoint, view_dir = truth_at(0.5, 0.0)
    np.testing.assert_allclose(mapping.view_dir_of_real_point(point, viewpoint).value, view_dir, atol=1e-10)


@pytest.mark.parametrize("kind", ["planar", "volumetric", "static"])
def test_no_optics_is_no_deviation(kind: str) -> None:
    levels = EYE_BOX.centre[2] + np.linspace(-0.002, 0.002, 12)
    captures = see_through_captures(positions_in_plane(12), bend=straight)
    viewpoint = np.column_stack([captures.viewpoint[:, :2], levels[captures.capture]])
    view_dir = normalised(captures.point - viewpoint)
    captures = replace(captures, viewpoint=viewpoint, view_dir=view_dir)
    mapping = narrowed(fit_see_through(captures, kind, 1).mapping, SeeThroughModel)
    np.testing.assert_allclose(mapping.deviation.coefficients, 0.0, atol=1e-15)


def test_volumetric_fit_comes_close_to_a_device_that_is_polynomial_on_a_plane() -> None:
    positions = positions_in_plane(30)
    captures = concatenate(
        [raised(see_through_captures(positions), height) for height in (-0.003, -0.001, 0.001, 0.003)]
    )
    mapping = fit_see_through(captures, "volumetric", 3).mapping
    point, viewpoint, view_dir = truth_at(1.0, 0.002)
    seen = mapping.view_dir_of_real_point(point, viewpoint).value
    assert arcmin_between(seen, view_dir).max() < 0.02
    ray = mapping.real_ray_of_view_dir(view_dir, viewpoint).value
    assert distance_to_point(ray, point).max() < 1e-5


def raised(captures: SeeThroughCaptures, height: float) -> SeeThroughCaptures:
    """The same rays, each seen from `height` metres behind the plane."""
    along = height / -captures.view_dir[:, 2:]
    moved = captures.viewpoint - along * captures.view_dir
    return replace(captures, viewpoint=moved, sigma_arcmin=np.zeros(len(captures)))


def test_static_fit_knows_the_nominal_viewpoint_and_bends_about_the_actual_one() -> None:
    captures = see_through_captures(np.vstack([positions_in_plane(5), EYE_BOX.centre[:2]]))
    found = fit_see_through(captures, "static", 2)
    mapping, report = found.mapping, found.report
    assert report.viewpoints == 1
    a, b = bend_of(np.broadcast_to(EYE_BOX.centre[:2], (40, 2)), TANGENTS)
    for viewpoint in EYE_BOX.at(np.array([[0.0, 0, 0], [1, 1, -1]])):
        origin, direction = split(mapping.real_ray_of_view_dir(dir_of_tangents(TANGENTS), viewpoint).value)
        np.testing.assert_allclose(direction, dir_of_tangents(TANGENTS + a), atol=1e-11)
        np.testing.assert_allclose(origin[:, :2], viewpoint[:2] + b, atol=1e-11)
        np.testing.assert_allclose(origin[:, 2], viewpoint[2])


@pytest.mark.parametrize(
    ("kind", "depths", "sentence"),
    [
        ("planar", (0.7,), "all real points are of one target pose, and it needs two depths"),
        ("static", (0.7, 0.7), "or at one depth; spread them over the field, and photograph the target nearer"),
    ],
)
def test_targets_at_one_depth_are_refused_with_the_remedy(kind: str, depths: tuple[float, ...], sentence: str) -> None:
    with pytest.raises(BadInputError, match=sentence):
        fit_see_through(see_through_captures(positions_in_plane(12), depths=depths), kind)


def test_a_fit_on_a_tilted_base_plane_recovers_a_lens() -> None:
    """A thin lens of -2 m, 0.05 m in front of the camera positions: of degree 3 on any plane, of 2 on theirs."""

    def bend(base: FloatArray, tangents: FloatArray) -> tuple[FloatArray, FloatArray]:
        bent = (base + 0.05 * tangents - EYE_BOX.centre[:2]) / 2.0
        return bent, -0.05 * bent

    captures = see_through_captures(positions_in_plane(40), bend=bend)
    tilted = BasePlane(PLANE.z - 0.2 * EYE_BOX.centre[0], (0.2, -0.3))
    upright = fit_see_through(captures, "planar", 2).mapping
    fitted = fit_see_through(captures, "planar", 3, tilted)
    mapping, report = narrowed(fitted.mapping, SeeThroughModel), fitted.report
    assert mapping.place == tilted
    assert report.residual_arcmin.maximum < 0.1 * NOISE_FLOOR_ARCMIN
    viewpoint = EYE_BOX.at(np.random.default_rng(2).uniform(-1, 1, (40, 3)))
    view_dir = dir_of_tangents(TANGENTS)
    expected, found = (each.real_ray_of_view_dir(view_dir, viewpoint).value for each in (upright, mapping))
    assert distance_to_point(found, split(at_z(expected, -2.0))[0]).max() < 1e-8


def test_base_plane_beyond_the_target_and_unknown_kinds_are_refused() -> None:
    captures = see_through_captures(positions_in_plane(6))
    with pytest.raises(BadInputError, match="lies beyond some target points"):
        fit_see_through(captures, "planar", 1, BasePlane(-0.5))
    with pytest.raises(BadInputError, match="'point-per-pixel' is unknown"):
        fit_see_through(captures, "point-per-pixel", 1)


def test_a_base_plane_does_not_matter_to_a_model_that_has_none() -> None:
    captures = see_through_captures(positions_in_plane(6))
    behind, usual = (
        narrowed(fit_see_through(captures, "static", 1, *plane).mapping, SeeThroughModel)
        for plane in ((BasePlane(-0.5),), ())
    )
    assert np.array_equal(behind.deviation.coefficients, usual.deviation.coefficients)


def test_noise_is_found_and_straight_rays_stay_straight() -> None:
    found = fit_see_through(see_through_captures(positions_in_plane(25), bend=straight, sigma_arcmin=1.0, seed=2))
    assert found.report.noise_arcmin == pytest.approx(1.0, rel=0.03)
    point, viewpoint, _ = truth_at(1.0, 0.0)
    seen = found.mapping.view_dir_of_real_point(point, viewpoint).value
    assert np.sqrt(np.mean(arcmin_between(seen, normalised(point - viewpoint)) ** 2)) < 0.1


def pole(base: object, tangents: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Optics whose coefficients fall slowly with the order in the direction: by 2.2 along x, by 2.9 along y."""
    u, v = (tangents / [0.4, 0.3]).T
    a = 3e-3 * np.stack([1.0 / (1.33 - u), 1.0 / (1.62 - v)], axis=-1)
    return a, 0.1 * a


def test_terms_that_the_optics_need_are_found_and_the_predicted_error_is_the_true_one() -> None:
    exact = see_through_captures(places_among(positions_in_plane(12), 40, seed=8), depths=(0.7,), bend=pole)
    fitted = fit_see_through(see_through_captures(grid_in_plane(4, 4), bend=pole, sigma_arcmin=0.1))
    assert fitted.smooth.readings.limits.pixel > 6
    seen = fitted.mapping.view_dir_of_real_point(exact.point, exact.viewpoint).value
    true = np.sqrt(np.mean(arcmin_between(seen, exact.view_dir) ** 2))
    predicted = np.sqrt(np.mean(fitted.mapping.sigma(exact.point, exact.viewpoint) ** 2))
    print(f"true over predicted {true / predicted:.2f}")
    assert 0.8 < true / predicted < 1.25


def test_precise_captures_outweigh_imprecise_ones() -> None:
    """Half the rows have 200 times the noise: a fit weighted by 1 / sigma hardly notices them."""
    positions = positions_in_plane(15)
    precise = see_through_captures(positions, sigma_arcmin=0.1, seed=1)
    imprecise = see_through_captures(positions, sigma_arcmin=20.0, seed=2)
    both = concatenate([precise, imprecise])
    point, viewpoint, view_dir = truth_at(1.0, 0.0)

    def error_arcmin(captures: SeeThroughCaptures) -> float:
        mapping = fit_see_through(captures, "planar", 3).mapping
        seen = mapping.view_dir_of_real_point(point, viewpoint).value
        return float(np.sqrt(np.mean(arcmin_between(seen, view_dir) ** 2)))

    alone = error_arcmin(precise)
    assert error_arcmin(both) < 1.2 * alone
    assert error_arcmin(replace(both, sigma_arcmin=np.ones(len(both)))) > 3 * alone
