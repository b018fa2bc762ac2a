import dataclasses
from collections.abc import Callable, Sequence
from typing import Any, TypeVar

import numpy as np
import pytest
from fitted_eyes import fitted_eye, fitted_terms
from present import narrowed
from warps.composing import programs_compiled

from wlr_render.errors import BadInputError
from wlr_render.geometry.directions import ARCMIN, arcmin_between, dir_of_tangents
from wlr_render.geometry.planes import BasePlane
from wlr_render.gl import gl
from wlr_render.gl.context import GlContext
from wlr_render.mappings import Eye, Status
from wlr_render.models.display_model import DisplayModel
from wlr_render.models.moved_panel import MovedPanelDisplay
from wlr_render.models.see_through_model import SeeThroughModel
from wlr_render.numerics.arrays import FloatArray
from wlr_render.numerics.polynomial import Box, Polynomial
from wlr_render.warp.gl_ray_maps import GlNodeSolver, GlPlanarSolver
from wlr_render.warp.grid import WarpGrid
from wlr_render.warp.ray_map import NEAREST_M, RayMap, RayMapPlan, choose_plan, middle_axes, solve_every_pixel

pytestmark = pytest.mark.gl

Model = TypeVar("Model", DisplayModel, SeeThroughModel)

SIZE = 45, 50
DEVICES = "northstar", "freeform40", "birdbath28"
PLACES = [0, 0, 0], [1, 1, 1], [-1, 0.6, -1], [0.3, -1, 0.9]


def models_of(eye: Eye) -> tuple[DisplayModel, SeeThroughModel]:
    return narrowed(eye.display, DisplayModel), narrowed(eye.see_through, SeeThroughModel)


def picture(eye: Eye) -> WarpGrid:
    """The warp grid of a picture of SIZE that covers the panel."""
    return WarpGrid.of_pixels(eye.display.panel, SIZE)


def gl_solve(context: GlContext, eye: Eye) -> GlPlanarSolver:
    return GlPlanarSolver(context, eye, picture(eye), middle_axes(eye))


def float64_field(eye: Eye, viewpoint: FloatArray, warp_grid: WarpGrid | None = None) -> RayMap:
    return solve_every_pixel(eye, viewpoint, middle_axes(eye), (warp_grid or picture(eye)).panel_pixel())


def at(eye: Eye, unit: Sequence[float]) -> FloatArray:
    return eye.eye_box.at(np.array(unit, dtype=float))


def worst_arcmin(field: RayMap, exact: RayMap) -> float:
    """Largest angle between rays, and by their offsets at the nearest depth, where both fields are OK."""
    both = (field.status == Status.OK) & (exact.status == Status.OK)
    ours, theirs = (np.moveaxis(f.slope_offset.astype(float), 0, -1)[both] for f in (field, exact))
    angle = arcmin_between(dir_of_tangents(ours[:, :2]), dir_of_tangents(theirs[:, :2])).max()
    return float(angle + np.linalg.norm(ours[:, 2:] - theirs[:, 2:], axis=1).max() / NEAREST_M / ARCMIN)


def assert_same(field: RayMap, expected: RayMap) -> None:
    """Equal but for the rounding of a solution that was found from elsewhere."""
    np.testing.assert_array_equal(field.status, expected.status)
    assert worst_arcmin(field, expected) < 0.003


def with_planes_apart(eye: Eye) -> Eye:
    """The same display with a see-through whose base plane lies elsewhere: another mapping, not a better one."""
    see_through = narrowed(eye.see_through, SeeThroughModel)
    plane = BasePlane(narrowed(see_through.place, BasePlane).z - 0.001)
    return dataclasses.replace(eye, see_through=dataclasses.replace(see_through, place=plane))


def with_planes_tilted(eye: Eye) -> Eye:
    """The same polynomials on tilted base planes through the eye box's centre: another mapping, not a better one."""

    def tilted(mapping: Model, slope: tuple[float, float]) -> Model:
        plane = BasePlane(eye.eye_box.centre[2] - np.dot(slope, eye.eye_box.centre[:2]), slope)
        return dataclasses.replace(mapping, place=plane)

    display, see_through = models_of(eye)
    display, see_through = tilted(display, (0.3, -0.2)), tilted(see_through, (-0.1, 0.25))
    return dataclasses.replace(eye, display=display, see_through=see_through)


def with_panel_moved(eye: Eye) -> Eye:
    """The panel shifted and grown, as self-calibration finds it."""
    return dataclasses.replace(eye, display=MovedPanelDisplay(eye.display, np.array([2.0, -1.5]), 2e-3))


def part_of(polynomial: Polynomial, low: FloatArray, high: FloatArray) -> Polynomial:
    """The same polynomial over a part of its box, given in box coordinates -1..1 (4,)."""
    centre, half = 0.5 * (polynomial.box.low + polynomial.box.high), 0.5 * (polynomial.box.high - polynomial.box.low)
    return fitted_terms(polynomial, Box(centre + low * half, centre + high * half), polynomial.orders)


@pytest.mark.parametrize(("device", "degree"), [("northstar", 5), ("freeform40", 3), ("birdbath28", 5)])
def test_rays_are_those_of_the_float64_solve(gl_context: GlContext, device: str, degree: int) -> None:
    eye = fitted_eye(device, degree)
    usual = (eye, with_planes_apart(eye), with_panel_moved(eye))
    for case, most_arcmin in (*((case, 0.004) for case in usual), (with_planes_tilted(eye), 0.007)):
        solve = gl_solve(gl_context, case)
        for unit in PLACES:
            field, exact = solve.solve(at(case, unit)).read(), float64_field(case, at(case, unit))
            assert (exact.status == Status.OK).mean() > 0.7
            np.testing.assert_array_equal(field.status, exact.status)
            assert worst_arcmin(field, exact) < most_arcmin


def test_orders_of_the_place_above_those_of_usual_models_are_kept(gl_context: GlContext) -> None:
    eye = fitted_eye("birdbath28", 3)
    display, _ = models_of(eye)
    ripple = Polynomial(np.array([[0, 0, 6, 0], [1, 0, 3, 3]]), display.forward.box, np.full((2, 2), 5 * ARCMIN))
    eye = dataclasses.replace(eye, display=dataclasses.replace(display, forward=display.forward.plus(ripple)))
    for unit in PLACES:
        field, exact = gl_solve(gl_context, eye).solve(at(eye, unit)).read(), float64_field(eye, at(eye, unit))
        np.testing.assert_array_equal(field.status, exact.status)
        assert worst_arcmin(field, exact) < 0.004


@pytest.mark.parametrize("orders", [[6, 0, 0, 0], [4, 2, 0, 0], [5, 0, 1, 0]])
def test_orders_of_the_deviation_above_those_of_usual_models_are_kept(gl_context: GlContext, orders: list[int]) -> None:
    eye = fitted_eye("northstar", 3)
    _, see_through = models_of(eye)
    ripple = Polynomial(np.array([orders]), see_through.deviation.box, np.array([[ARCMIN, ARCMIN, 0, 0]]))
    bent = dataclasses.replace(see_through, deviation=see_through.deviation.plus(ripple))
    eye = dataclasses.replace(eye, see_through=bent)
    for unit in PLACES:
        field, exact = gl_solve(gl_context, eye).solve(at(eye, unit)).read(), float64_field(eye, at(eye, unit))
        assert worst_arcmin(field, exact) < 0.008


def test_eyes_and_calibrations_share_one_program(gl_context: GlContext, monkeypatch: pytest.MonkeyPatch) -> None:
    compiled = programs_compiled(monkeypatch)
    with gl.open_context(gl_context.backend) as context:
        for device in DEVICES:
            eye = fitted_eye(device, 3)
            assert np.isfinite(gl_solve(context, eye).solve(eye.eye_box.centre).read_slope_offset()).any()
    assert len(compiled) == 1


@pytest.mark.parametrize("make", [WarpGrid.edge_to_edge, lambda panel, *size: WarpGrid.of_pixels(panel, size)])
def test_the_points_are_those_of_the_warp_grid(gl_context: GlContext, make: Callable[..., Any]) -> None:
    eye = fitted_eye("freeform40", 5)
    warp_grid, viewpoint = make(eye.display.panel, 23, 31), at(eye, [0.4, -0.6, 0.8])
    solved = GlPlanarSolver(gl_context, eye, warp_grid, middle_axes(eye)).solve(viewpoint)
    exact = float64_field(eye, viewpoint, warp_grid)
    np.testing.assert_array_equal(solved.read_status(), exact.status)
    assert np.isfinite(exact.slope_offset).all()
    assert solved.warp_grid is warp_grid
    np.testing.assert_allclose(solved.read_slope_offset(), exact.slope_offset, atol=2e-6)


@pytest.mark.parametrize("which", ["display", "see_through", "eye_box"])
def test_status_is_that_of_the_float64_solve_where_the_fit_is_left(gl_context: GlContext, which: str) -> None:
    eye = fitted_eye("birdbath28", 3)
    share = np.array([-0.61, -1, -1, -0.83]), np.array([1, 0.57, 1, 0.71])
    display, see_through = models_of(eye)
    if which == "display":
        display = dataclasses.replace(display, forward=part_of(display.forward, *share))
    if which == "see_through":
        see_through = dataclasses.replace(see_through, deviation=part_of(see_through.deviation, *share))
    eye = dataclasses.replace(eye, display=display, see_through=see_through)
    viewpoint = at(eye, [2.2, -1.8, 0.9] if which == "eye_box" else [0.4, 0.2, 0.8])
    field, exact = gl_solve(gl_context, eye).solve(viewpoint).read(), float64_field(eye, viewpoint)
    np.testing.assert_array_equal(field.status, exact.status)
    outside = (field.status == Status.OUTSIDE_FIT).mean()
    assert outside == 1 if which == "eye_box" else 0.1 < outside < 0.9
    # There, too, the shader continues the polynomials as they are.
    np.testing.assert_allclose(field.slope_offset, exact.slope_offset, atol=0.004 * ARCMIN)


@pytest.mark.parametrize("away", [[0, 0, 0.3], [0.5, -0.2, 0.1], [0, 1e4, 1e6]])
def test_a_viewpoint_far_away_gives_statuses_and_spoils_nothing(gl_context: GlContext, away: list[float]) -> None:
    eye = fitted_eye("northstar", 5)
    solve, viewpoint = gl_solve(gl_context, eye), at(eye, [0.6, 0.3, 0.9])
    expected = solve.solve(viewpoint).read()
    far = solve.solve(viewpoint + away).read()
    assert (far.status != Status.OK).all()
    np.testing.assert_array_equal(np.isfinite(far.slope_offset).all(axis=0), far.status == Status.OUTSIDE_FIT)
    np.testing.assert_array_equal(np.isnan(far.slope_offset).any(axis=0), far.status > Status.OUTSIDE_FIT)
    assert_same(solve.solve(viewpoint).read(), expected)


@pytest.mark.parametrize("viewpoint", [[np.nan, 0, 0], [0, np.inf, 0], [0, 0]])
def test_a_viewpoint_that_is_none_is_refused_and_the_next_frame_is_right(
    gl_context: GlContext, viewpoint: Sequence[float]
) -> None:
    eye = fitted_eye("freeform40", 3)
    solve = gl_solve(gl_context, eye)
    expected = solve.solve(at(eye, [0.6, 0.3, 0.9])).read()
    with pytest.raises(BadInputError, match="; give three finite numbers"):
        solve.solve(np.array(viewpoint))
    again = solve.solve(at(eye, [0.6, 0.3, 0.9]))
    assert_same(again.read(), expected)


def test_two_solvers_and_other_drawing_do_not_disturb_each_other(gl_context: GlContext) -> None:
    eyes = [fitted_eye(device, 3) for device in DEVICES[:2]]
    solves = [gl_solve(gl_context, eye) for eye in eyes]
    alone = [solve.solve(at(eye, [0, 0, 1])).read() for solve, eye in zip(solves, eyes, strict=True)]
    together = [solve.solve(at(eye, [0, 0, 1])) for solve, eye in zip(solves, eyes, strict=True)]
    with gl_context.drawing() as ctx:
        ctx.enable_only(ctx.BLEND)
    for solved, expected in zip(together, alone, strict=True):
        assert_same(solved.read(), expected)


def test_mappings_without_a_formula_are_refused(gl_context: GlContext, toy_headset: Eye) -> None:
    with pytest.raises(BadInputError, match="toy: only planar models can be solved in a shader; use the node grid"):
        GlPlanarSolver(gl_context, toy_headset, picture(toy_headset), np.eye(3))


def plan_of(eye: Eye, columns: int = 21, rows: int = 31, count: int | None = None) -> RayMapPlan:
    axes = middle_axes(eye)
    warp_grid = WarpGrid.edge_to_edge(eye.display.panel, columns, rows)
    return RayMapPlan.onto_grid(warp_grid, count or choose_plan(eye).node_count, axes)


def test_the_texture_holds_the_exact_rays_at_the_points(gl_context: GlContext, toy_headset: Eye) -> None:
    plan = plan_of(toy_headset)
    nodes = GlNodeSolver(gl_context, toy_headset, plan)
    for unit in ([0.0, 0.0, 0.0], [0.7, -0.9, 0.8]):
        viewpoint = toy_headset.eye_box.at(np.array(unit))
        field = nodes.solve(viewpoint)
        exact = solve_every_pixel(toy_headset, viewpoint, plan.device_from_camera, plan.warp_grid.panel_pixel())
        np.testing.assert_allclose(field.read_slope_offset(), exact.slope_offset, atol=2e-5)
        np.testing.assert_array_equal(field.read().slope_offset, field.read_slope_offset())
        assert (field.read_status() == Status.OK).all()
        assert field.warp_grid is plan.warp_grid
        np.testing.assert_array_equal(field.viewpoint_in_device, viewpoint)


def test_nodes_without_an_answer_are_filled_and_the_hole_stays(
    gl_context: GlContext, toy_headset: Eye, toy_headset_with_hole: Eye
) -> None:
    eye = toy_headset_with_hole
    plan = plan_of(eye, 49, 41, 9)
    solver = GlNodeSolver(gl_context, eye, plan)
    for unit in ([0, 0, 0], [0.8, -0.7, 0.9], [1.4, 1.2, -1]):
        viewpoint = eye.eye_box.at(np.array(unit, float))
        whole = solve_every_pixel(toy_headset, viewpoint, plan.device_from_camera, plan.warp_grid.panel_pixel())
        in_hole = solve_every_pixel(eye, viewpoint, plan.device_from_camera, plan.warp_grid.panel_pixel()).status > 0
        assert 0 < in_hole.sum() < 50
        field = solver.solve(viewpoint)
        found = field.read_slope_offset()
        np.testing.assert_array_equal(np.isnan(found).all(axis=0), in_hole)
        np.testing.assert_allclose(found[:, ~in_hole], whole.slope_offset[:, ~in_hole], atol=2e-4)
        status = field.read_status()
        assert (status[in_hole] == Status.MISS).all()
        # Points around filled nodes are counted too.
        assert in_hole.sum() <= (status == Status.MISS).sum() < 0.2 * status.size


def test_a_viewpoint_that_is_none_is_refused_and_the_field_stays(gl_context: GlContext, toy_headset: Eye) -> None:
    nodes = GlNodeSolver(gl_context, toy_headset, plan_of(toy_headset))
    field = nodes.solve(toy_headset.eye_box.centre)
    before = field.read_slope_offset()
    with pytest.raises(BadInputError, match=r"is \[0.0, nan, 0.0\]; give three finite numbers"):
        nodes.solve(np.array([0.0, np.nan, 0.0]))
    np.testing.assert_array_equal(field.read_slope_offset(), before)
