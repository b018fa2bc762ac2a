import numpy as np
import pytest

from wlr_render.geometry import directions
from wlr_render.numerics.arrays import FloatArray
from wlr_render.tracking.eye_model import RotatingEye

VIEWPOINT = np.array([0.032, 0.001, -0.03])


def test_the_eye_looking_ahead_has_its_pupil_at_the_viewpoint_and_turns_about_a_point_behind_it() -> None:
    model = RotatingEye.looking_ahead_from(VIEWPOINT)
    np.testing.assert_allclose(model.viewpoint_of_gaze(np.array([0, 0, -1.0])), VIEWPOINT, atol=1e-17)
    np.testing.assert_allclose(model.rotation_centre_in_device - VIEWPOINT, [0, 0, 0.0105], atol=1e-17)


@pytest.mark.parametrize("lead", [(), (1,), (3, 1, 2)])
def test_the_pupil_keeps_its_distance_and_follows_the_gaze(lead: tuple[int, ...]) -> None:
    model = RotatingEye(VIEWPOINT, pupil_distance_m=0.011)
    gaze_dir = directions.dir_of_tangents(np.random.default_rng(1).uniform(-1, 1, (*lead, 2)))
    offset = model.viewpoint_of_gaze(gaze_dir) - VIEWPOINT
    np.testing.assert_allclose(np.linalg.norm(offset, axis=-1), 0.011, atol=1e-16)
    np.testing.assert_allclose(np.sum(offset * gaze_dir, axis=-1), 0.011, atol=1e-16)


def test_looking_20_degrees_to_the_right_moves_the_pupil_3_6_mm_to_the_right() -> None:
    model = RotatingEye.looking_ahead_from(VIEWPOINT)
    angle = np.deg2rad(20)
    moved = model.viewpoint_of_gaze(np.array([np.sin(angle), 0, -np.cos(angle)])) - VIEWPOINT
    np.testing.assert_allclose(moved, [0.00359121, 0, 0.00063323], atol=1e-8)


# Surfaces of the cornea from the inside, and the iris: place of the vertex (m, forward), radius (m), conic constant,
# index behind it; then the iris and the index of the aqueous humour.
NAVARRO = (((-0.55e-3, 6.5e-3, 0.0, 1.376), (0.0, 7.72e-3, -0.26, 1.0)), -3.6e-3, 1.3374)
"""Escudero-Sanz and Navarro, J. Opt. Soc. Am. A 16, 1881 (1999): an aspheric cornea of two surfaces."""
LE_GRAND = (((-0.55e-3, 6.5e-3, 0.0, 1.3771), (0.0, 7.8e-3, 0.0, 1.0)), -3.6e-3, 1.3374)
"""Le Grand and El Hage, Physiological Optics (1980): two spheres."""
ALMALENCE = (((0.0, 7.75e-3, 0.0, 1.0),), -3.3e-3, 1.3375)
"""One sphere, in TruePupilFromRefraction.m of github.com/almalence/eyetracking at c472825."""
SchematicEye = tuple[tuple[tuple[float, float, float, float], ...], float, float]


def chief_rays(eye: SchematicEye, inside: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Angles (n,) outside the eye of rays that leave the middle of the iris at `inside`, and where they meet the axis.

    Traced surface by surface in the plane of the axis and the ray.
    """
    surfaces, iris, index = eye
    x, y = np.full_like(inside, iris), np.zeros_like(inside)
    along, across = np.cos(inside), np.sin(inside)
    for vertex, radius, conic, behind in surfaces:
        depth = vertex - x  # y^2 + (1 + Q) depth^2 = 2 R depth
        a = across**2 + (1 + conic) * along**2
        half = y * across - (1 + conic) * depth * along + radius * along
        c = y**2 + (1 + conic) * depth**2 - 2 * radius * depth
        step = (-half + np.sqrt(half**2 - a * c)) / a
        x, y = x + step * along, y + step * across
        normal = np.stack([radius - (1 + conic) * (vertex - x), y])
        normal /= np.linalg.norm(normal, axis=0)
        cosine, ratio = normal[0] * along + normal[1] * across, index / behind
        turned = np.sqrt(1 - ratio**2 * (1 - cosine**2)) - ratio * cosine
        along, across, index = ratio * along + turned * normal[0], ratio * across + turned * normal[1], behind
    return np.arctan2(across, along), x - y * along / across


@pytest.mark.parametrize(("schematic", "tolerance_m"), [(NAVARRO, 5e-6), (LE_GRAND, 2e-6), (ALMALENCE, 4e-6)])
def test_the_cornea_shows_the_pupil_where_traced_schematic_eyes_do(schematic: SchematicEye, tolerance_m: float) -> None:
    """Up to 42 degrees from the gaze; the shift of the eye of Navarro is 0.08 mm there."""
    angle, place = chief_rays(schematic, np.linspace(1e-3, np.deg2rad(38.0), 20))
    assert angle[-1] > np.deg2rad(40.0)
    gaze = np.array([0.0, 0.0, -1.0])
    view_dir = np.stack([np.sin(angle), np.zeros_like(angle), -np.cos(angle)], axis=-1)
    model = RotatingEye(np.zeros(3))
    shift = model.viewpoint_of_gaze(gaze, view_dir) - model.viewpoint_of_gaze(gaze)
    np.testing.assert_allclose(np.sum(shift * view_dir, axis=-1), 0.0, atol=1e-17)
    ahead = (place - place[0])[:, None] * gaze  # on the axis, where the light aims
    np.testing.assert_allclose(
        shift, ahead - np.sum(ahead * view_dir, axis=-1, keepdims=True) * view_dir, atol=tolerance_m
    )


def test_the_apparent_pupil_lies_beside_the_iris_as_published() -> None:
    """Offset from the middle of the iris across the line of sight, mm; Zemax, by Almalence (as `ALMALENCE`).

    Its iris lies 0.54 mm behind the entrance pupil; its pupil of 4 mm has its own centre, 3 um beside the chief ray.
    """
    angle = np.deg2rad([10.0, 20.0, 30.0, 40.0])
    view_dir = np.stack([np.sin(angle), np.zeros_like(angle), -np.cos(angle)], axis=-1)
    pupil = RotatingEye(np.zeros(3)).viewpoint_of_gaze(np.array([0.0, 0.0, -1.0]), view_dir)
    iris = np.array([0.0, 0.0, -(0.0105 - 0.000536)])
    across = np.linalg.norm(np.cross(pupil - iris, view_dir), axis=-1)
    np.testing.assert_allclose(1e3 * across, [0.094, 0.193, 0.299, 0.419], atol=0.006)


def test_a_camera_in_line_with_the_gaze_sees_no_shift_and_gazes_broadcast() -> None:
    gaze = directions.dir_of_tangents(np.random.default_rng(2).uniform(-0.5, 0.5, (3, 1, 2)))
    model = RotatingEye(VIEWPOINT)
    np.testing.assert_allclose(model.viewpoint_of_gaze(gaze, gaze), model.viewpoint_of_gaze(gaze), atol=1e-18)
    assert model.viewpoint_of_gaze(gaze, directions.dir_of_tangents(np.zeros((4, 2)))).shape == (3, 4, 3)
