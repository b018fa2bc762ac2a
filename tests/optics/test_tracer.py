"""The laws of reflection and refraction, statuses, and systems with closed-form answers."""

import numpy as np
import pytest
from optics.test_optics_shapes import SHAPES, random_rays

from wlr_render.geometry.transforms import apply, rigid, rotate, rotation_about
from wlr_render.mappings import Status
from wlr_render.numerics.arrays import FloatArray
from wlr_render.optics.device import ClearAperture, Interaction, Path, PlacedSurface, Step
from wlr_render.optics.media import AIR, Medium
from wlr_render.optics.surfaces import Conic, Ellipsoid, Shape
from wlr_render.optics.tracer import Trace, trace

GLASS = Medium.constant("glass", 1.5)
OPEN = ClearAperture(np.full(3, -np.inf), np.full(3, np.inf))
POSE = rigid(rotation_about("y", 0.7) @ rotation_about("x", -2.1), np.array([0.03, -0.2, 0.11]))


def placed(shape: Shape, pose: FloatArray = POSE, aperture: ClearAperture = OPEN, name: str = "s") -> PlacedSurface:
    return PlacedSurface(name, shape, pose, aperture)


def rays_in_device(rng: np.random.Generator, count: int) -> tuple[FloatArray, FloatArray]:
    origin, direction = random_rays(rng, count)
    return apply(POSE, origin.T), rotate(POSE, direction.T)


def normals_at(surface: PlacedSurface, point: FloatArray) -> FloatArray:
    local = apply(surface.surface_from_device, point)
    return rotate(surface.device_from_surface, surface.shape.normal(local.T).T)


@pytest.mark.parametrize("name", SHAPES)
def test_snells_law_and_coplanarity(name: str) -> None:
    """n d x N is the same before and after: both the sines and the plane of incidence."""
    surface = placed(SHAPES[name][0])
    origin, direction = rays_in_device(np.random.default_rng(5), 10_000)
    traced = trace(Path((Step(surface, Interaction.REFRACT, GLASS),)), origin, direction, 0.55)
    assert (traced.status == Status.OK).all()
    normal = normals_at(surface, traced.origin)
    np.testing.assert_allclose(1.5 * np.cross(traced.direction, normal), np.cross(direction, normal), atol=1e-14)
    np.testing.assert_allclose(np.linalg.norm(traced.direction, axis=-1), 1.0, atol=1e-15)
    assert np.all(np.sum(traced.direction * normal, -1) * np.sum(direction * normal, -1) > 0)
    np.testing.assert_allclose(np.cross(traced.origin - origin, direction), 0.0, atol=1e-16)


@pytest.mark.parametrize("name", SHAPES)
def test_law_of_reflection(name: str) -> None:
    """The part along the normal turns round, the part across it stays."""
    surface = placed(SHAPES[name][0])
    origin, direction = rays_in_device(np.random.default_rng(6), 10_000)
    traced = trace(Path((Step(surface, Interaction.REFLECT, AIR),)), origin, direction, 0.55)
    normal = normals_at(surface, traced.origin)
    np.testing.assert_allclose(np.cross(traced.direction - direction, normal), 0.0, atol=1e-14)
    np.testing.assert_allclose(np.sum((traced.direction + direction) * normal, -1), 0.0, atol=1e-14)
    assert (traced.status == Status.OK).all()


@pytest.mark.parametrize("lead", [(), (1,), (3, 1, 2)])
def test_batch_shapes_and_broadcasting(lead: tuple[int, ...]) -> None:
    steps = tuple(Step(placed(Conic(c)), Interaction.REFRACT, m) for c, m in ((3.0, GLASS), (-4.0, AIR)))
    origin, direction = rays_in_device(np.random.default_rng(7), 6)
    count = int(np.prod(lead))
    traced = trace(Path(steps), origin[0], direction[:count].reshape(*lead, 3), 0.55)
    assert traced.points.shape == (*lead, 2, 3)
    assert traced.origin.shape == traced.direction.shape == (*lead, 3)
    assert traced.status.shape == lead
    one_by_one = [trace(Path(steps), origin[0], direction[i], 0.55).direction for i in range(count)]
    np.testing.assert_array_equal(traced.direction.reshape(-1, 3), one_by_one)


def test_many_rays_are_what_they_are_one_chunk_at_a_time() -> None:
    path = Path((Step(placed(Conic(5.0, -2.0)), Interaction.REFRACT, GLASS),))
    origin, direction = rays_in_device(np.random.default_rng(8), 20_001)
    whole = trace(path, origin, direction, 0.55)
    part = trace(path, origin[-3:], direction[-3:], 0.55)
    np.testing.assert_allclose(whole.direction[-3:], part.direction, atol=1e-16)


def test_aperture_chooses_the_root_and_clips() -> None:
    """A ray crosses a sphere twice: the aperture says which crossing is the surface, or that neither is."""
    axis = np.array([0.0, 0.0, -1.0]), np.array([0.0, 0.0, 1.0])

    def met(low: float, high: float) -> Trace:
        aperture = ClearAperture(np.array([-1, -1, low]), np.array([1, 1, high]))
        surface = placed(Ellipsoid(np.full(3, 0.1)), np.eye(4), aperture)
        return trace(Path((Step(surface, Interaction.REFRACT, AIR),)), *axis, 0.55)

    for low, high, z, status in (
        (-1, 1, -0.1, Status.OK),
        (0, 1, 0.1, Status.OK),
        (-1, 0, -0.1, Status.OK),
        (0.2, 1, 0.1, Status.CLIPPED),
        (-1, -0.2, -0.1, Status.CLIPPED),
    ):
        result = met(low, high)
        assert result.status == status
        np.testing.assert_allclose(result.origin, [0, 0, z], atol=1e-16)


def test_surface_behind_the_ray_is_missed() -> None:
    path = Path((Step(placed(Conic(0.0), np.eye(4)), Interaction.REFLECT, AIR),))
    traced = trace(path, np.array([0.0, 0.0, 1.0]), np.array([0.0, 0.0, 1.0]), 0.55)
    assert traced.status == Status.MISS
    assert np.isnan(traced.direction).all()


@pytest.mark.parametrize(("degrees", "total"), [(41.7, False), (41.9, True)])
def test_critical_angle(degrees: float, total: bool) -> None:
    """Glass of 1.5 against air: 41.81 degrees."""
    angle = np.deg2rad(degrees)
    start = np.array([0.0, 0.0, -1.0]), np.array([np.sin(angle), 0.0, np.cos(angle)])
    centred = rigid(np.eye(3), np.array([0.0, 0.0, -1.0]))
    inside = Step(placed(Ellipsoid(np.full(3, 0.1)), centred), Interaction.REFRACT, GLASS)  # met head-on
    face = placed(Conic(0.0), np.eye(4))
    out = trace(Path((inside, Step(face, Interaction.REFRACT, AIR))), *start, 0.55)
    held = trace(Path((inside, Step(face, Interaction.TOTAL_REFLECT, GLASS))), *start, 0.55)
    assert out.status == (Status.TOTAL_REFLECTION if total else Status.OK)
    assert np.isnan(out.direction).all() == total
    assert held.status == (Status.OK if total else Status.CLIPPED)
    np.testing.assert_allclose(held.direction, start[1] * [1, 1, -1], atol=1e-15)


def test_first_failure_is_kept_and_nan_never_passes_for_a_ray() -> None:
    missed = Step(placed(Ellipsoid(np.full(3, 0.1)), np.eye(4)), Interaction.REFRACT, GLASS)
    path = Path((missed, Step(placed(Conic(0.0), np.eye(4)), Interaction.REFRACT, AIR)))
    traced = trace(path, np.array([[5.0, 0, -1], [np.nan, 0, 0]]), np.array([0.0, 0.0, 1.0]), 0.55)
    assert (traced.status == Status.MISS).all()
    assert trace(Path(), np.array([np.nan, 0, 0]), np.array([0.0, 0.0, 1.0]), 0.55).status == Status.MISS


def test_dispersion_turns_blue_more_than_red() -> None:
    pmma = Medium("pmma", ((1.1819, 0.011313),))
    path = Path((Step(placed(Conic(0.0), np.eye(4)), Interaction.REFRACT, pmma),))
    slanted = np.array([0.6, 0.0, 0.8])
    blue, red = (trace(path, np.array([0.0, 0, -1]), slanted, um).direction[0] for um in (0.45, 0.65))
    assert blue == pytest.approx(0.6 / 1.50061, abs=1e-5)
    assert blue < red


def test_tilting_a_mirror_up_moves_the_spot_up_by_twice_the_angle() -> None:
    """A mirror at z = -1 facing the eye; a negative turn about x tips its face from +z towards +y."""
    spots = []
    for angle in (0.0, -1e-3):
        pose = rigid(rotation_about("x", angle), np.array([0.0, 0.0, -1.0]))
        path = Path((Step(placed(Conic(0.0), pose), Interaction.REFLECT, AIR),))
        spots.append(trace(path, np.zeros(3), np.array([0.0, 0.0, -1.0]), 0.55).direction)
    assert spots[1][1] - spots[0][1] == pytest.approx(np.sin(2e-3), abs=1e-12)
