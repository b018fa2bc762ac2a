import numpy as np
import pytest

from wlr_render.calibration.model_kinds import choose_base_plane
from wlr_render.geometry.planes import BasePlane
from wlr_render.mappings import EyeBox
from wlr_render.numerics.arrays import FloatArray

EYE_BOX = EyeBox(np.array([0.03, -0.01, 0.02]), np.array([0.010, 0.008, 0.006]))
CENTRE_PLANE = BasePlane(0.02)


def positions(
    count: int = 25, slope: tuple[float, float] = (0.0, 0.0), noise: float = 0.0, z: float = 0.022
) -> FloatArray:
    """Scattered over the eye box on a plane through its middle at `z`, with noise along z: (count, 3)."""
    rng = np.random.default_rng(3)
    away = rng.uniform(-0.5, 0.5, (count, 2)) * EYE_BOX.size[:2]
    return np.column_stack([EYE_BOX.centre[:2] + away, z + away @ slope + noise * rng.normal(size=count)])


@pytest.mark.parametrize("noise", [0.0, 1e-5])
@pytest.mark.parametrize("slope", [(0.1, -0.05), (0.0, 0.3)])
def test_tilted_positions_give_their_plane(slope: tuple[float, float], noise: float) -> None:
    repeated = np.repeat(positions(slope=slope, noise=noise), np.arange(1, 26), axis=0)
    plane = choose_base_plane(repeated, EYE_BOX)
    np.testing.assert_allclose(plane.slope, slope, atol=1e-12 + 120 * noise)
    np.testing.assert_allclose(plane.z_at(EYE_BOX.centre[:2]), 0.022, atol=1e-12 + noise)


@pytest.mark.parametrize(
    "viewpoint",
    [positions(), positions(slope=(1e-4, 0.0)), positions(slope=(0.002, 0.0), noise=5e-5)],
    ids=["untilted", "less than matters", "less than the noise shows"],
)
def test_positions_without_a_tilt_that_matters_give_a_plane_of_constant_z(viewpoint: FloatArray) -> None:
    plane = choose_base_plane(viewpoint, EYE_BOX)
    assert plane.slope == (0.0, 0.0)
    np.testing.assert_allclose(plane.z, 0.022, atol=2e-5)


def test_equal_coordinates_are_kept_exactly() -> None:
    assert choose_base_plane(positions(z=-0.03), EYE_BOX) == BasePlane(-0.03)


ALONG = np.linspace(-0.004, 0.004, 5)[:, None]


@pytest.mark.parametrize(
    "viewpoint",
    [
        EYE_BOX.at(np.random.default_rng(1).uniform(-1, 1, (25, 3))),
        positions(slope=(0.5, 0.0)),
        EYE_BOX.centre + ALONG * [1.0, 0.3, 0.2],
        EYE_BOX.centre + [[0.0, 0.0, 0.001]],
    ],
    ids=["spread in depth", "steeper than 20 degrees", "along a rising line", "one position"],
)
def test_positions_that_fix_no_plane_give_that_of_the_middle_of_the_eye_box(viewpoint: FloatArray) -> None:
    assert choose_base_plane(viewpoint, EYE_BOX) == CENTRE_PLANE


def test_positions_along_a_level_line_give_its_z() -> None:
    assert choose_base_plane(EYE_BOX.centre + ALONG * [1.0, 0.3, 0.0] + [0, 0, 0.002], EYE_BOX).z == 0.022
