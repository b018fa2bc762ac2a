import inspect
from typing import Any

import numpy as np
import pytest
from present import present

from wlr_render.errors import BadInputError
from wlr_render.numerics.arrays import FloatArray
from wlr_render.scene.scene import Mesh
from wlr_render.scene.shapes import construction, objects
from wlr_render.scene.shapes.objects import SHAPES

SOLID = ("ball", "box", "sphere", "sculpture")


@pytest.fixture(scope="module", params=sorted(SHAPES))
def shape(request: pytest.FixtureRequest) -> tuple[Any, Mesh]:
    return request.param, SHAPES[request.param]()


def corners(mesh: Mesh) -> FloatArray:
    return mesh.position.astype(np.float64)[mesh.triangles]


def signed_volume(mesh: Mesh) -> float:
    a, b, c = np.moveaxis(corners(mesh), 1, 0)
    return float(np.einsum("ij,ij->", a, np.cross(b, c)) / 6)


def test_every_shape_is_a_sound_mesh(shape: tuple[Any, Mesh]) -> None:
    _, mesh = shape
    count = len(mesh.position)
    assert mesh.position.dtype == mesh.normal.dtype == np.float32
    assert mesh.triangles.dtype == np.uint32
    assert mesh.triangles.max() < count
    for array, width in ((mesh.normal, 3), (mesh.uv, 2), (mesh.vertex_colour, 3)):
        assert array is None or (array.shape == (count, width) and np.isfinite(array).all())
    np.testing.assert_allclose(np.linalg.norm(mesh.normal, axis=1), 1, atol=1e-6)
    assert mesh.texture is None or (mesh.texture.dtype == np.uint8 and mesh.uv is not None)


def test_triangles_turn_the_way_their_normals_point(shape: tuple[Any, Mesh]) -> None:
    _, mesh = shape
    a, b, c = np.moveaxis(corners(mesh), 1, 0)
    face = np.cross(b - a, c - a)
    face /= np.linalg.norm(face, axis=1, keepdims=True)
    assert np.einsum("ijk,ik->ij", mesh.normal[mesh.triangles], face).min() > 0.8


def test_solids_face_outwards(shape: tuple[Any, Mesh]) -> None:
    name, mesh = shape
    if name in SOLID:
        assert signed_volume(mesh) > 0


def test_every_argument_has_a_default_that_a_scene_file_can_state(shape: tuple[Any, Mesh]) -> None:
    for key, parameter in inspect.signature(SHAPES[shape[0]]).parameters.items():
        assert isinstance(parameter.default, int | float | tuple), key


def test_box_and_sphere_have_their_volumes() -> None:
    assert signed_volume(construction.box((0.1, 0.2, 0.3))) == pytest.approx(0.006, rel=1e-6)
    assert signed_volume(construction.sphere(0.1, segments=256)) == pytest.approx(4 / 3 * np.pi * 1e-3, rel=1e-3)


def test_a_box_stands_on_its_origin_with_upright_textures() -> None:
    box = construction.box((0.1, 0.2, 0.3))
    np.testing.assert_allclose(box.position.min(axis=0), [-0.05, 0, -0.15], atol=1e-7)
    np.testing.assert_allclose(box.position.max(axis=0), [0.05, 0.2, 0.15], atol=1e-7)
    for outward, right in (([0, 0, 1], [1, 0, 0]), ([1, 0, 0], [0, 0, -1]), ([0, 0, -1], [-1, 0, 0])):
        side = box.normal @ outward > 0.9
        assert box.uv is not None
        assert (box.uv[side, 1] == (box.position[side, 1] < 0.1)).all()
        assert (box.uv[side, 0] == (box.position[side] @ right > 0)).all()


def test_the_sculpture_is_fine_closed_and_stands_on_its_origin() -> None:
    mesh = objects.sculpture(height_m=0.25)
    assert len(mesh.triangles) >= 100_000
    low, high = mesh.position.min(axis=0), mesh.position.max(axis=0)
    np.testing.assert_allclose([low[1], high[1]], [0, 0.25], atol=1e-6)
    np.testing.assert_allclose(low[[0, 2]], -high[[0, 2]], atol=1e-6)
    mesh = objects.sculpture(around=60, along=120)
    # Joined at its seams, every edge has two triangles.
    _, joined = np.unique(np.round(mesh.position, 6), axis=0, return_inverse=True)
    triangle = joined.ravel()[mesh.triangles]
    edges = np.sort(np.concatenate([triangle[:, [0, 1]], triangle[:, [1, 2]], triangle[:, [2, 0]]]), axis=1)
    _, uses = np.unique(edges, axis=0, return_counts=True)
    assert (uses == 2).all()


def test_the_skin_of_the_sculpture_joins_at_its_seams() -> None:
    around, along = 8, 16
    mesh = objects.sculpture(around=around, along=along)
    uv = present(mesh.uv).reshape(around + 1, along + 1, 2)
    for jump in (uv[:, -1] - uv[:, 0], uv[-1] - uv[0]):
        np.testing.assert_allclose(jump, np.round(jump), atol=1e-5)
        assert np.abs(jump).max() >= 1


def test_dots_are_painted_on_a_centred_grid() -> None:
    columns, rows, pitch = 7, 5, 0.02
    board = construction.dot_board(columns, rows, pitch, diameter_m=0.009, marker_diameter_m=0.013)
    darkness = 1 - present(board.texture)[..., 0] / 255.0
    height, width = darkness.shape
    extent = np.ptp(board.position, axis=0)[:2]
    x = ((np.arange(width) + 0.5) / width - 0.5) * extent[0]
    y = (0.5 - (np.arange(height) + 0.5) / height) * extent[1]
    texel_area = np.prod(extent) / darkness.size
    for row, column in ((0, 0), (rows // 2, columns // 2), (rows - 1, columns - 1)):
        centre = pitch * (column - 3), pitch * (2 - row)
        near = (np.abs(x - centre[0]) < pitch / 2) & (np.abs(y - centre[1]) < pitch / 2)[:, None]
        weight = np.where(near, darkness, 0)
        found = [(weight.sum(axis=0) @ x) / weight.sum(), (weight.sum(axis=1) @ y) / weight.sum()]
        np.testing.assert_allclose(found, centre, atol=1e-6)
        diameter = 0.013 if row == rows // 2 else 0.009
        assert weight.sum() * texel_area == pytest.approx(np.pi / 4 * diameter**2, rel=0.01)


def test_the_markers_point_up_and_right() -> None:
    plain, marked = construction.dot_board(7, 5), construction.dot_board(7, 5, marker_diameter_m=0.013)
    rows, columns = np.nonzero((present(plain.texture) != present(marked.texture)).any(axis=-1))
    height, width = present(plain.texture).shape[:2]
    assert rows.mean() < height / 2
    assert columns.mean() > width / 2


def test_a_board_too_small_for_markers_is_refused() -> None:
    with pytest.raises(BadInputError, match="no room for markers"):
        construction.dot_board(3, 3, marker_diameter_m=0.013)
