import dataclasses
from typing import Any, NoReturn

import numpy as np
import pytest
from calibration.toy_device import (
    EYE_BOX,
    PANEL,
    PLANE,
    display_captures,
    grid_in_plane,
    places_among,
    positions_in_plane,
    tangents_of,
)
from numpy.typing import NDArray
from present import narrowed, present

from wlr_render.calibration import model_kinds
from wlr_render.calibration.fit_display import fit_display
from wlr_render.captures.correspondences import DisplayCaptures, concatenate
from wlr_render.errors import BadInputError
from wlr_render.geometry.directions import arcmin_between, dir_of_tangents
from wlr_render.mappings import EyeBox
from wlr_render.models.display_model import DisplayModel
from wlr_render.models.fitted_model import FittedDisplay
from wlr_render.numerics.arrays import FloatArray

UNSEEN = np.random.default_rng(7).uniform([50, 50], [950, 750], (40, 2))


def unseen_viewpoints(height: float) -> tuple[NDArray[Any], FloatArray]:
    """Viewpoints off the plane with the toy's own answer at `UNSEEN`: viewpoint (40, 3), view_dir (40, 3)."""
    base = places_among(positions_in_plane(12), 40, seed=8)
    tangents = tangents_of(UNSEEN, base)
    viewpoint = np.column_stack([base - height * tangents, np.full(40, PLANE.z + height)])
    return viewpoint, dir_of_tangents(tangents)


def rms_arcmin(mapping: FittedDisplay, height: float = 0.0) -> float:
    viewpoint, view_dir = unseen_viewpoints(height)
    seen = mapping.view_dir_of_pixel(UNSEEN, viewpoint).value
    return float(np.sqrt(np.mean(arcmin_between(seen, view_dir) ** 2)))


@pytest.mark.parametrize("height", [0.0, 0.003, -0.002])
def test_planar_fit_recovers_a_device_of_its_own_kind_from_any_distance(height: float) -> None:
    found = fit_display(display_captures(positions_in_plane(12), height=height), "planar", 2, PLANE)
    mapping, report = found.mapping, found.report
    for query_height in (0.0, 0.004):
        viewpoint, view_dir = unseen_viewpoints(query_height)
        seen = mapping.view_dir_of_pixel(UNSEEN, viewpoint)
        assert seen.usable.all()
        np.testing.assert_allclose(seen.value, view_dir, atol=1e-11)
        np.testing.assert_allclose(mapping.pixel_of_view_dir(view_dir, viewpoint).value, UNSEEN, atol=1e-8)
    assert report.residual_arcmin.maximum < 1e-7
    assert present(report.residual_px).maximum < 1e-8
    assert report.unsolved == 0
    assert report.coefficients == 30


def test_base_plane_may_be_chosen() -> None:
    base_plane = dataclasses.replace(PLANE, z=PLANE.z + 0.001)
    mapping = fit_display(display_captures(positions_in_plane(30)), "planar", 5, base_plane).mapping
    assert narrowed(mapping, DisplayModel).place == base_plane
    assert rms_arcmin(mapping) < 0.01


def test_base_plane_is_that_of_the_camera_positions() -> None:
    captures = display_captures(positions_in_plane(30))
    moved = EyeBox(EYE_BOX.centre + [0.0, 0.0, 0.001], EYE_BOX.size)
    mapping = fit_display(dataclasses.replace(captures, eye_box=moved), "planar", 2).mapping
    assert narrowed(mapping, DisplayModel).place == PLANE


def folded_captures(bulge: float) -> DisplayCaptures:
    """Tangents that grow with the square of p~: a viewpoint 3 mm behind the plane sees some pixels from two places."""
    captures = display_captures(positions_in_plane(30))
    x = captures.viewpoint[:, :1] - EYE_BOX.centre[0]
    folded = captures.tangents + bulge * x**2 * [1.0, 0.0]
    return dataclasses.replace(captures, view_dir=dir_of_tangents(folded))


def test_a_model_that_may_have_two_solutions_is_refused_with_the_remedy() -> None:
    sentence = (
        r"the planar display model may have two solutions at one viewpoint: its contraction over the eye box is 2\.\d "
        "and must stay below 1; add camera positions, move the base plane to the middle of the eye box, or make the box"
    )
    captures = folded_captures(3e4)
    with pytest.raises(BadInputError, match=sentence):
        fit_display(captures, "planar", 2)
    shallow = EyeBox(EYE_BOX.centre, EYE_BOX.size * [1.0, 1.0, 0.1])
    report = fit_display(dataclasses.replace(captures, eye_box=shallow), "planar", 2).report
    assert 0.3 < report.contraction < 1.0


def test_readings_without_an_inverse_are_refused_with_the_remedy(monkeypatch: pytest.MonkeyPatch) -> None:
    """Two camera positions whose motions explain all that they see come to this, or not, by rounding."""

    def singular(*_: object) -> NoReturn:
        raise np.linalg.LinAlgError

    monkeypatch.setattr(model_kinds, "fit_within", singular)
    sentence = "the display captures of toy do not determine a planar model .*; add camera positions."
    with pytest.raises(BadInputError, match=sentence):
        fit_display(display_captures(positions_in_plane(2)), "planar")


def test_point_per_pixel_recovers_an_image_that_crosses_infinity() -> None:
    pixels = PANEL.grid(9, 7).reshape(-1, 2)
    position = EYE_BOX.at(np.random.default_rng(3).uniform(-1, 1, (6, 3)))
    capture = np.repeat(np.arange(6), len(pixels))
    pixel, viewpoint = np.tile(pixels, (6, 1)), position[capture]

    def seen(pixel: FloatArray, viewpoint: FloatArray) -> FloatArray:
        nominal = (pixel - 0.5 * PANEL.size_px) * [6e-4, -6e-4]
        inverse_depth = 0.004 * (pixel[:, :1] - 400)  # 1/m, zero along a column of pixels
        shift = viewpoint - EYE_BOX.centre
        return dir_of_tangents((nominal - inverse_depth * shift[:, :2]) / (1 + inverse_depth * shift[:, 2:]))

    captures = dataclasses.replace(
        display_captures(position[:, :2]), viewpoint=viewpoint, view_dir=seen(pixel, viewpoint)
    )
    found = fit_display(captures, "point-per-pixel", 1)
    mapping, report = found.mapping, found.report
    elsewhere = EYE_BOX.at(np.random.default_rng(4).uniform(-1, 1, (40, 3)))
    truth = seen(UNSEEN, elsewhere)
    np.testing.assert_allclose(mapping.view_dir_of_pixel(UNSEEN, elsewhere).value, truth, atol=1e-12)
    np.testing.assert_allclose(mapping.pixel_of_view_dir(truth, elsewhere).value, UNSEEN, atol=1e-7)
    assert present(report.residual_px).maximum < 1e-7


def test_volumetric_fit_recovers_directions_polynomial_in_all_three_coordinates() -> None:
    position = EYE_BOX.at(np.random.default_rng(3).uniform(-1, 1, (14, 3)))
    captures = display_captures(position[:, :2])
    viewpoint = position[captures.capture]

    def tangents(pixel: FloatArray, viewpoint: FloatArray) -> FloatArray:
        return tangents_of(pixel, viewpoint[:, :2]) + 20.0 * (viewpoint[:, 2:] - PLANE.z) * (viewpoint[:, :2] - 0.02)

    captures = dataclasses.replace(
        captures, viewpoint=viewpoint, view_dir=dir_of_tangents(tangents(captures.pixel, viewpoint))
    )
    mapping = fit_display(captures, "volumetric", 2).mapping
    elsewhere = np.random.default_rng(4).uniform(position.min(axis=0), position.max(axis=0), (40, 3))
    view_dir = dir_of_tangents(tangents(UNSEEN, elsewhere))
    np.testing.assert_allclose(mapping.view_dir_of_pixel(UNSEEN, elsewhere).value, view_dir, atol=1e-12)
    np.testing.assert_allclose(mapping.pixel_of_view_dir(view_dir, elsewhere).value, UNSEEN, atol=1e-8)


def test_static_fit_is_the_view_from_the_camera_nearest_the_centre() -> None:
    nearest = EYE_BOX.centre[:2] + [1e-4, -1e-4]
    captures = display_captures(np.vstack([positions_in_plane(5), nearest]))
    found = fit_display(captures, "static", 1)
    mapping, report = found.mapping, found.report
    assert report.viewpoints == 1
    truth = dir_of_tangents(tangents_of(UNSEEN, np.broadcast_to(nearest, (40, 2))))
    for viewpoint in EYE_BOX.at(np.array([[0, 0, 0], [1, -1, 1]])):
        np.testing.assert_allclose(mapping.view_dir_of_pixel(UNSEEN, viewpoint).value, truth, atol=1e-12)
        np.testing.assert_allclose(mapping.pixel_of_view_dir(truth, viewpoint).value, UNSEEN, atol=1e-9)


@pytest.mark.parametrize(
    ("kind", "count", "sentence"),
    [
        (
            "point-per-pixel",
            1,
            "a point in space needs two camera positions at least and there is 1: add one",
        ),
        ("planar", 12, "panel pixels that were decoded lie on one line: decode pixels all over the panel"),
    ],
)
def test_what_nothing_determines_is_refused_with_what_would_help(kind: str, count: int, sentence: str) -> None:
    line = np.linspace([100, 100], [900, 700], 30)
    with pytest.raises(BadInputError, match=sentence):
        fit_display(display_captures(positions_in_plane(count), line if kind == "planar" else None), kind)


def test_few_positions_are_not_refused_but_leave_the_model_unsure() -> None:
    few, many = (fit_display(display_captures(grid_in_plane(n, n), sigma_arcmin=1.0, seed=3)).report for n in (2, 5))
    assert few.predicted_arcmin > 2 * many.predicted_arcmin
    assert few.one_more is not None
    assert few.one_more.predicted_arcmin < 0.9 * few.predicted_arcmin
    assert few.one_more.positions.startswith(("a row of 3 camera positions", "a column of 3 camera positions"))


def test_unknown_kind_is_refused() -> None:
    with pytest.raises(BadInputError, match="'planr' is unknown; choose one of planar"):
        fit_display(display_captures(positions_in_plane(3)), "planr", 1)


def test_held_out_rows_and_columns_are_missed_by_noise_as_the_fit_expects() -> None:
    report = fit_display(display_captures(grid_in_plane(5, 5), sigma_arcmin=2.0, seed=5)).report
    assert [each.left_out for each in report.held_out] == [
        f"{noun} {number} of 5" for noun in ("column", "row") for number in range(1, 6)
    ]
    found, expected = present(report.held_out_arcmin)
    assert found == pytest.approx(expected, rel=0.1)
    # A residual vector has two components of sigma each.
    assert found == pytest.approx(2.0 * np.sqrt(2.0), rel=0.1)
    assert report.noise_arcmin == pytest.approx(2.0, rel=0.03)


def test_one_position_has_nothing_to_hold_out() -> None:
    report = fit_display(display_captures(positions_in_plane(6)), "static").report
    assert (report.held_out, report.held_out_arcmin, report.one_more) == ((), None, None)


def test_a_degree_limits_the_orders() -> None:
    found = fit_display(display_captures(positions_in_plane(12), sigma_arcmin=1.0), "planar", 2)
    assert narrowed(found.mapping, DisplayModel).forward.orders.sum(axis=1).max() == 2
    assert found.report.orders == "total 2"


def test_weights_follow_sigma() -> None:
    good = display_captures(positions_in_plane(10), sigma_arcmin=0.1, seed=1)
    poor = display_captures(positions_in_plane(10), sigma_arcmin=20.0, seed=2)
    weighted = fit_display(concatenate([good, poor]), "planar", 2).mapping
    both = concatenate([good, poor])
    unweighted = fit_display(dataclasses.replace(both, sigma_arcmin=np.ones(len(both))), "planar", 2).mapping
    assert rms_arcmin(weighted) < 0.1
    assert rms_arcmin(unweighted) > 5 * rms_arcmin(weighted)


def test_error_shrinks_with_the_root_of_the_number_of_samples() -> None:
    few, many = PANEL.grid(4, 3).reshape(-1, 2), PANEL.grid(16, 12).reshape(-1, 2)

    def error(pixels: FloatArray) -> float:
        captures = [display_captures(positions_in_plane(12), pixels, sigma_arcmin=3.0, seed=s) for s in range(8)]
        return float(np.sqrt(np.mean([rms_arcmin(fit_display(c, "planar", 2).mapping) ** 2 for c in captures])))

    assert error(few) / error(many) == pytest.approx(4.0, rel=0.3)


@pytest.mark.parametrize(("scale", "shift"), [(1.0, 0.1), (1e3, 0.0)])
def test_captures_far_from_the_eye_box_are_refused_with_both_places(scale: float, shift: float) -> None:
    """Swapped axes or millimetres: such a model has nothing to say in the eye box."""
    captures = display_captures(positions_in_plane(12))
    moved = scale * captures.viewpoint + [0.0, shift, 0.0]
    with pytest.raises(BadInputError, match=r"were taken at x .* mm, far from the eye box at x .*: check order, sign"):
        fit_display(dataclasses.replace(captures, viewpoint=moved))


def test_positions_in_a_row_say_nothing_across_it_and_the_stage_s_errors_are_not_taken_for_an_answer() -> None:
    along = np.linspace(-0.005, 0.005, 7)
    rng = np.random.default_rng(3)
    row = EYE_BOX.centre[:2] + np.stack([along, 0.007 * along + 2e-6 * rng.normal(size=7)], axis=-1)
    captures = display_captures(row, PANEL.grid(20, 16).reshape(-1, 2), sigma_arcmin=0.1)
    mapping = fit_display(captures).mapping
    pixel = np.array([500.0, 400.0])
    found, beside = (
        mapping.view_dir_of_pixel(pixel, PLANE.lift(at[None])).value for at in (row[3], row[3] + [0, 2e-3])
    )
    assert arcmin_between(found, dir_of_tangents(tangents_of(pixel[None], row[3:4]))) < 0.1
    assert arcmin_between(found, beside) < 60.0
    on, off = (mapping.sigma(pixel, PLANE.lift(at)) for at in (row[3], row[3] + [0, 4e-3]))
    assert off > 20.0 * on
