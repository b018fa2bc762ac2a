"""Contraction against differences of the fixed-point map itself, and a model that has two solutions."""

import dataclasses

import numpy as np
import pytest
from models.toy_models import (
    EYE_BOX,
    IN_PLANE,
    PIXELS,
    PLANE,
    SEE_THROUGHS,
    TANGENTS,
    box,
    bundle_display,
    bundle_see_through,
    point_per_pixel_display,
    polynomial,
    static_display,
    volumetric_display,
)

from wlr_render.errors import BadInputError
from wlr_render.geometry.directions import dir_of_tangents
from wlr_render.geometry.planes import BasePlane
from wlr_render.geometry.rays import at_z
from wlr_render.mappings import EYE_BOX_MARGIN
from wlr_render.models.contraction import NEAREST_POINT_M, require_unique
from wlr_render.models.display_model import DisplayModel
from wlr_render.models.fitted_model import FittedDisplay
from wlr_render.numerics.arrays import FloatArray

RNG = np.random.default_rng(4)
COUNT = 20_000
STEP = 1e-6
PLANES = [PLANE, BasePlane(0.02 - 0.3 * 0.03, (0.3, -0.2))]


def viewpoints() -> FloatArray:
    """Half of them at corners of the eye box as far as it counts, (COUNT, 3)."""
    unit = RNG.uniform(-1, 1, (COUNT, 3))
    unit[::2] = np.sign(unit[::2])
    return EYE_BOX.centre + unit * (0.5 * EYE_BOX.size + EYE_BOX_MARGIN)


def small_steps() -> FloatArray:
    angle = RNG.uniform(0, 2 * np.pi, COUNT)
    return STEP * np.column_stack([np.cos(angle), np.sin(angle)])


@pytest.mark.parametrize("plane", PLANES, ids=["untilted", "tilted"])
def test_display_contraction_is_that_of_the_projection(plane: BasePlane) -> None:
    display = dataclasses.replace(bundle_display(), place=plane)
    viewpoint, step = viewpoints(), small_steps()
    place = RNG.uniform(*IN_PLANE, (COUNT, 2))
    pixel = np.where(RNG.random((COUNT, 2)) < 0.5, PIXELS[0], PIXELS[1])

    def projected(place: FloatArray) -> FloatArray:
        return plane.carry(viewpoint, display.forward(np.hstack([pixel, place])))

    shrunk = np.linalg.norm(projected(place + step) - projected(place), axis=1) / STEP
    assert 0.85 * display.contraction() < shrunk.max() < 1.01 * display.contraction()


@pytest.mark.parametrize("plane", PLANES, ids=["untilted", "tilted"])
@pytest.mark.parametrize("kind", SEE_THROUGHS)
def test_see_through_contraction_is_that_of_its_rays(kind: str, plane: BasePlane) -> None:
    see_through = SEE_THROUGHS[kind]()
    if kind == "planar":
        see_through = dataclasses.replace(see_through, place=plane)
    viewpoint, step = viewpoints(), small_steps()
    tangents = RNG.uniform(*TANGENTS, (COUNT, 2))
    depth = NEAREST_POINT_M * np.where(RNG.random(COUNT) < 0.5, 1.0, 1e6)

    def corrected(tangents: FloatArray) -> FloatArray:
        """Less the ray's lateral miss over the depth of a point on the axis."""
        ray = see_through.real_ray_of_view_dir(dir_of_tangents(tangents), viewpoint).value
        return tangents - (at_z(ray, viewpoint[:, 2] - depth)[:, :2] - viewpoint[:, :2]) / depth[:, None]

    inside = see_through.real_ray_of_view_dir(dir_of_tangents(tangents), viewpoint).usable
    shrunk = np.linalg.norm(corrected(tangents + step) - corrected(tangents), axis=1)[inside] / STEP
    assert 0.85 * see_through.contraction() < shrunk.max() < 1.01 * see_through.contraction()


@pytest.mark.parametrize("plane", PLANES, ids=["untilted", "tilted"])
def test_derivative_of_the_apparent_displacement_is_that_of_differences(plane: BasePlane) -> None:
    def seen_at(tangents: FloatArray) -> tuple[FloatArray, FloatArray]:
        return see_through.displacement_at(tangents, viewpoint, np.full(COUNT, 4.0))

    deviation, viewpoint, step = bundle_see_through().deviation, viewpoints(), small_steps()
    # As strong as A at large, so that the motion of the plane's depth counts.
    coefficients = deviation.coefficients + 0.5 * (deviation.orders == 0).all(1)[:, None]
    deviation = dataclasses.replace(deviation, coefficients=coefficients)
    see_through = dataclasses.replace(bundle_see_through(), place=plane, deviation=deviation)
    tangents = RNG.uniform(-0.4, 0.4, (COUNT, 2))
    (before, _), (after, _), (_, slope) = seen_at(tangents - step), seen_at(tangents + step), seen_at(tangents)
    expected = (after - before) / (2 * STEP)
    np.testing.assert_allclose((slope @ step[:, :, None])[..., 0] / STEP, expected, atol=1e-7)


@pytest.mark.parametrize("display", [volumetric_display(), static_display(), point_per_pixel_display()])
def test_closed_forms_have_no_contraction_to_state(display: FittedDisplay) -> None:
    assert display.contraction() == 0.0


BULGE = 1e5 / 3


def folded_display() -> DisplayModel:
    """t_x = BULGE (x - 0.03)^2, so that a viewpoint 3 mm behind the plane solves d = w + 100 d^2 for d = x - 0.03."""

    def folded(inputs: FloatArray) -> FloatArray:
        return np.stack([BULGE * (inputs[:, 2] - 0.03) ** 2, 0.0 * inputs[:, 0]], axis=-1)

    return dataclasses.replace(bundle_display(), forward=polynomial(folded, box(PIXELS, IN_PLANE), 2))


def test_a_model_with_two_solutions_is_found_out() -> None:
    display = folded_display()
    viewpoint, pixel = np.array([[0.0316, 0.0, 0.023]] * 2), np.array([[500.0, 400.0]] * 2)
    assert EYE_BOX.contains(viewpoint).all()
    root = display.solve_place(PLANE, pixel, viewpoint, np.array([[0.0315, 0.0], [0.0385, 0.0]]))
    assert root.converged.all()
    np.testing.assert_allclose(root.unknown[:, 0], [0.032, 0.038], atol=1e-9)
    assert display.forward.box.contains(np.hstack([pixel, root.unknown])).all()
    assert display.contraction() == pytest.approx(2 * BULGE * 0.01 * (0.003 + EYE_BOX_MARGIN))
    with pytest.raises(BadInputError, match=r"may have two solutions at one viewpoint: its contraction .* is 2.3 and"):
        require_unique(display.contraction(), "planar", "display")


def test_a_contraction_that_is_not_a_number_is_refused() -> None:
    with pytest.raises(BadInputError, match=r"the static see-through model may have .* add camera positions"):
        require_unique(np.nan, "static", "see-through")
    assert require_unique(bundle_see_through().contraction(), "planar", "see-through") < 0.5
