"""Laws that every model honours, whatever its kind."""

from typing import Any

import numpy as np
import pytest
from models.toy_models import DISPLAYS, EYE_BOX, SEE_THROUGHS, bundle_display, bundle_see_through
from present import present

from wlr_render.errors import BadInputError
from wlr_render.geometry.directions import dir_of_tangents
from wlr_render.geometry.rays import distance_to_point, split
from wlr_render.mappings import EYE_BOX_MARGIN, Status
from wlr_render.models import fitted_model
from wlr_render.models.see_through_model import SeeThroughModel

RNG = np.random.default_rng(2)
PIXEL = RNG.uniform([100, 100], [900, 700], (30, 2))
VIEWPOINT = EYE_BOX.at(RNG.uniform(-1, 1, (30, 3)))
POINT = np.column_stack([VIEWPOINT[:, :2] + RNG.uniform(-0.1, 0.1, (30, 2)), RNG.uniform(-3, -0.3, 30)])
LEADS = [(), (1,), (3, 1, 2)]

displays = pytest.mark.parametrize("display", [make() for make in DISPLAYS.values()], ids=DISPLAYS)
see_throughs = pytest.mark.parametrize("see_through", [make() for make in SEE_THROUGHS.values()], ids=SEE_THROUGHS)


@displays
def test_pixel_to_direction_and_back(display: Any) -> None:
    seen = display.view_dir_of_pixel(PIXEL, VIEWPOINT)
    assert seen.ok.all()
    np.testing.assert_allclose(np.linalg.norm(seen.value, axis=1), 1.0)
    back = display.pixel_of_view_dir(seen.value, VIEWPOINT)
    assert back.ok.all()
    np.testing.assert_allclose(back.value, PIXEL, atol=1e-7)


@see_throughs
def test_the_ray_of_the_direction_in_which_a_point_is_seen_meets_the_point(see_through: SeeThroughModel) -> None:
    seen = see_through.view_dir_of_real_point(POINT, VIEWPOINT)
    assert seen.ok.all()
    ray = see_through.real_ray_of_view_dir(seen.value, VIEWPOINT)
    assert ray.ok.all()
    np.testing.assert_allclose(np.linalg.norm(split(ray.value)[1], axis=1), 1.0)
    distance = np.linalg.norm(POINT - VIEWPOINT, axis=1)
    assert (distance_to_point(ray.value, POINT) / distance).max() < 1e-11


@pytest.mark.parametrize("lead", LEADS)
@displays
def test_display_takes_any_leading_axes(display: Any, lead: tuple[int, ...]) -> None:
    pixel = RNG.uniform([100, 100], [900, 700], (*lead, 2))
    flat = display.view_dir_of_pixel(pixel.reshape(-1, 2), EYE_BOX.centre)
    whole = display.view_dir_of_pixel(pixel, EYE_BOX.centre)
    assert whole.value.shape == (*lead, 3)
    assert whole.status.shape == lead
    np.testing.assert_array_equal(whole.value.reshape(-1, 3), flat.value)
    assert display.pixel_of_view_dir(whole.value, EYE_BOX.centre).value.shape == (*lead, 2)
    viewpoint = np.broadcast_to(EYE_BOX.centre, (*lead, 3))
    one_pixel = display.view_dir_of_pixel(PIXEL[0], viewpoint)
    assert one_pixel.value.shape == (*lead, 3)
    if one_pixel.warm_start is not None:
        assert one_pixel.warm_start.shape == (*lead, 2)


@pytest.mark.parametrize("lead", LEADS)
@see_throughs
def test_see_through_takes_any_leading_axes(see_through: SeeThroughModel, lead: tuple[int, ...]) -> None:
    view_dir = dir_of_tangents(RNG.uniform(-0.3, 0.3, (*lead, 2)))
    ray = see_through.real_ray_of_view_dir(view_dir, EYE_BOX.centre)
    assert ray.value.shape == (*lead, 6)
    assert ray.status.shape == lead
    point = split(ray.value)[0] + split(ray.value)[1]
    seen = see_through.view_dir_of_real_point(point, EYE_BOX.centre)
    assert seen.value.shape == (*lead, 3)


@displays
def test_pixels_and_viewpoints_broadcast(display: Any) -> None:
    table = display.view_dir_of_pixel(PIXEL[:, None], VIEWPOINT[None, :4])
    assert table.value.shape == (30, 4, 3)
    np.testing.assert_allclose(
        table.value[7, 2], display.view_dir_of_pixel(PIXEL[7], VIEWPOINT[2]).value, rtol=0, atol=1e-14
    )


@displays
def test_extrapolations_keep_their_value_and_are_outside_fit(display: Any) -> None:
    far = EYE_BOX.centre + [0.5 * EYE_BOX.size[0] + 2 * EYE_BOX_MARGIN, 0, 0]
    near = EYE_BOX.centre + [0.5 * EYE_BOX.size[0] + 0.5 * EYE_BOX_MARGIN, 0, 0]
    assert display.view_dir_of_pixel(PIXEL[0], far).status == Status.OUTSIDE_FIT
    assert display.view_dir_of_pixel(PIXEL[0], near).status == Status.OK
    off_panel = display.view_dir_of_pixel(np.array([1100.0, 400.0]), EYE_BOX.centre)
    assert off_panel.status == Status.OUTSIDE_FIT
    back = display.pixel_of_view_dir(off_panel.value, EYE_BOX.centre)
    assert back.status == Status.OUTSIDE_FIT
    np.testing.assert_allclose(back.value, [1100, 400], atol=1e-6)


@see_throughs
def test_directions_outside_the_fitted_field_say_so(see_through: SeeThroughModel) -> None:
    wide = dir_of_tangents(np.array([0.6, 0.0]))
    ray = see_through.real_ray_of_view_dir(wide, EYE_BOX.centre)
    assert ray.status == Status.OUTSIDE_FIT
    assert np.isfinite(ray.value).all()
    origin, direction = split(ray.value)
    assert see_through.view_dir_of_real_point(origin + direction, EYE_BOX.centre).status == Status.OUTSIDE_FIT


def test_directions_and_points_behind_the_eye_are_a_miss_beside_good_ones() -> None:
    behind = np.array([[0.0, 0.0, 1.0], [0.0, 0.0, -1.0], [np.nan, 0.0, -1.0]])
    expected = [Status.MISS, Status.OK, Status.MISS]
    for answer in (
        bundle_display().pixel_of_view_dir(behind, EYE_BOX.centre),
        bundle_see_through().real_ray_of_view_dir(behind, EYE_BOX.centre),
        bundle_see_through().view_dir_of_real_point(EYE_BOX.centre + behind, EYE_BOX.centre),
    ):
        np.testing.assert_array_equal(answer.status, expected)
        np.testing.assert_array_equal(np.isnan(answer.value).any(axis=1), [True, False, True])


def test_chunks_join_to_what_one_block_would_give(monkeypatch: pytest.MonkeyPatch) -> None:
    display = bundle_display()
    whole = display.view_dir_of_pixel(PIXEL, VIEWPOINT)
    monkeypatch.setattr(fitted_model, "_CHUNK", 7)
    parts = display.view_dir_of_pixel(PIXEL, VIEWPOINT, whole.warm_start)
    np.testing.assert_allclose(parts.value, whole.value, rtol=0, atol=1e-14)
    np.testing.assert_array_equal(parts.status, whole.status)
    assert present(parts.warm_start).shape == (30, 2)


def test_an_empty_batch_has_an_empty_answer() -> None:
    answer = bundle_display().view_dir_of_pixel(np.empty((0, 2)), EYE_BOX.centre)
    assert (answer.value.shape, answer.status.shape) == ((0, 3), (0,))


def test_a_warm_start_of_another_shape_is_refused() -> None:
    display = bundle_display()
    start = display.view_dir_of_pixel(PIXEL, EYE_BOX.centre).warm_start
    with pytest.raises(BadInputError, match=r"warm_start has shape \(30, 2\); this query needs \(2,\)"):
        display.view_dir_of_pixel(PIXEL[0], EYE_BOX.centre, start)
