import base64
import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import trimesh
from matplotlib.tri import LinearTriInterpolator, Triangulation

from wlr_render.exports.check_pictures import write_check
from wlr_render.exports.export_view import ExportedView
from wlr_render.exports.mesh import TOLERANCE_ARCMIN, GltfMesh
from wlr_render.geometry.directions import arcmin_between, dir_of_tangents
from wlr_render.numerics.arrays import Float32Array, FloatArray


def read(view: ExportedView, folder: Path) -> tuple[Path, trimesh.Trimesh, FloatArray]:
    """The mesh as trimesh reads it: vertices, triangles and texture coordinates with v downwards."""
    write_check(folder, view, GltfMesh.holds)
    (path,) = GltfMesh().write([view], folder)
    mesh = trimesh.load(path, process=False, force="mesh")
    return path, mesh, np.asarray(mesh.visual.uv) * [1, -1] + [0, 1]  # trimesh turns v round


def error_arcmin(
    view: ExportedView, position: Any, triangles: Any, uv: Float32Array | FloatArray, colour: str = "all"
) -> float:
    """Largest error of linear interpolation at panel pixels, in another program's triangles."""
    pixel = np.random.default_rng(5).uniform(1, np.array(view.panel_size_px) - 1, (4000, 2))
    x, y = (2 * pixel / view.panel_size_px - 1).T * [[1], [-1]]
    inside = Triangulation(position[:, 0], position[:, 1], triangles)
    texture = np.stack([LinearTriInterpolator(inside, each)(x, y) for each in uv.T], axis=-1)
    camera = view.source.camera
    shown = camera.tangents_of_pixel(np.asarray(texture) * camera.size_px)
    due = view.tangents(np.moveaxis(view.rays_at(colour, pixel), -1, 0))
    return float(np.max(arcmin_between(dir_of_tangents(shown), dir_of_tangents(due))))


@pytest.fixture(scope="module")
def northstar_mesh(
    northstar_view: ExportedView, tmp_path_factory: pytest.TempPathFactory
) -> tuple[Path, trimesh.Trimesh, FloatArray]:
    return read(northstar_view, tmp_path_factory.mktemp("mesh"))


def test_interpolation_between_the_vertices_is_within_the_tolerance_of_the_page(
    view: ExportedView, northstar_mesh: tuple[Path, trimesh.Trimesh, FloatArray]
) -> None:
    _, mesh, uv = northstar_mesh
    assert error_arcmin(view, mesh.vertices, mesh.faces, uv) < TOLERANCE_ARCMIN
    assert len(mesh.vertices) < 180 * 200


def test_mesh_covers_the_panel_once_and_faces_the_viewer(
    northstar_mesh: tuple[Path, trimesh.Trimesh, FloatArray],
) -> None:
    _, mesh, _ = northstar_mesh
    np.testing.assert_allclose(mesh.bounds, [[-1, -1, 0], [1, 1, 0]], atol=1e-6)
    assert np.isclose(mesh.area, 4)
    assert (mesh.face_normals[:, 2] > 0).all()


def test_each_colour_has_its_texture_coordinates(coloured_view: ExportedView, tmp_path: Path) -> None:
    path, mesh, _ = read(coloured_view, tmp_path)
    gltf = json.loads(path.read_text(encoding="utf-8"))
    for number, colour in enumerate(coloured_view.colours):
        uv = accessor(gltf, f"TEXCOORD_{number}")
        assert error_arcmin(coloured_view, mesh.vertices, mesh.faces, uv, colour) < TOLERANCE_ARCMIN
    assert np.abs(accessor(gltf, "TEXCOORD_0") - accessor(gltf, "TEXCOORD_2")).max() > 1e-4


def accessor(gltf: dict[str, Any], name: str) -> Float32Array:
    """Values of an attribute; trimesh keeps the first texture coordinates only."""
    chosen = gltf["accessors"][gltf["meshes"][0]["primitives"][0]["attributes"][name]]
    at = gltf["bufferViews"][chosen["bufferView"]]
    content = base64.b64decode(gltf["buffers"][0]["uri"].partition(",")[2])
    return np.frombuffer(content, "<f4", at["byteLength"] // 4, at["byteOffset"]).reshape(chosen["count"], -1)


def test_no_triangle_has_a_corner_without_a_ray(view_of_half_a_panel: ExportedView, tmp_path: Path) -> None:
    _, mesh, uv = read(view_of_half_a_panel, tmp_path)
    assert np.isfinite(uv).all()
    assert 0.3 < mesh.area / 4 < 0.7
