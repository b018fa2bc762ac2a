import base64
import json
import struct
import zlib
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from glb_writer import save_glb

from wlr_render.errors import BadInputError
from wlr_render.rendering.mesh_file import load_meshes
from wlr_render.rendering.scene import Instance, LightSource, Mesh, Scene, world_positions
from wlr_render.rendering.shapes import construction, objects
from wlr_render.rendering.shapes.construction import turn

CORNERS = np.array([[255, 0, 0], [0, 255, 0], [0, 0, 255], [255, 255, 0]], np.uint8).reshape(2, 2, 3)
"""Red and green above, blue and yellow below."""


def png(image):
    """A PNG by hand, so that the reader is not tested against itself."""
    height, width = image.shape[:2]
    rows = b"".join(b"\0" + row.tobytes() for row in image)

    def chunk(kind, content):
        return struct.pack(">I", len(content)) + kind + content + struct.pack(">I", zlib.crc32(kind + content))

    header = struct.pack(">IIBBBBB", width, height, 8, 2, 0, 0, 0)
    return b"\x89PNG\r\n\x1a\n" + chunk(b"IHDR", header) + chunk(b"IDAT", zlib.compress(rows)) + chunk(b"IEND", b"")


def gltf(folder: Path, positions=((0, 0, 0), (1, 0, 0), (0, 1, 0)), indices=(0, 1, 2), **changes) -> Path:
    """One triangle as glTF; uv (0, 0), (1, 0), (0, 1); `changes` replace or add top-level keys."""
    uv = np.array([[0, 0], [1, 0], [0, 1]], np.float32).tobytes()
    blob = np.array(positions, np.float32).tobytes() + np.array(indices, np.uint32).tobytes() + uv
    starts, lengths = (0, 36, 48), (36, 12, 24)
    content = {
        "asset": {"version": "2.0"},
        "scene": 0,
        "scenes": [{"nodes": [0]}],
        "nodes": [{"mesh": 0, "name": "here"}],
        "meshes": [
            {
                "name": "wedge",
                "primitives": [{"attributes": {"POSITION": 0, "TEXCOORD_0": 2}, "indices": 1, "material": 0}],
            }
        ],
        "materials": [{"pbrMetallicRoughness": {"baseColorFactor": [0.2, 0.4, 0.6, 1]}}],
        "accessors": [
            {"bufferView": 0, "componentType": 5126, "count": 3, "type": "VEC3"},
            {"bufferView": 1, "componentType": 5125, "count": 3, "type": "SCALAR"},
            {"bufferView": 2, "componentType": 5126, "count": 3, "type": "VEC2"},
        ],
        "bufferViews": [{"buffer": 0, "byteOffset": s, "byteLength": n} for s, n in zip(starts, lengths, strict=True)],
        "buffers": [
            {"byteLength": 72, "uri": "data:application/octet-stream;base64," + base64.b64encode(blob).decode()}
        ],
    }
    path = folder / "wedge.gltf"
    path.write_text(json.dumps(content | changes))
    return path


def obj(folder: Path, faces="f 1/1 2/2 3/3\n", mtl="newmtl m\nKd 0.5 0.25 1\nmap_Kd t.png\n", texture=True) -> Path:
    path = folder / "wedge.obj"
    vertices = "v 0 0 0\nv 1 0 0\nv 0 1 0\nvt 0 0\nvt 1 0\nvt 0 1\n"
    path.write_text("mtllib wedge.mtl\n" + vertices + "usemtl m\n" + faces)
    if mtl:
        (folder / "wedge.mtl").write_text(mtl)
    if texture:
        (folder / "t.png").write_bytes(png(CORNERS))
    return path


def ply(folder: Path, vertices=("0 0 0 255 188 0", "1 0 0 0 0 0", "0 1 0 0 0 0"), face="0 1 2") -> Path:
    header = "ply\nformat ascii 1.0\nelement vertex 3\n" + "".join(f"property float {a}\n" for a in "xyz")
    header += "".join(f"property uchar {a}\n" for a in ("red", "green", "blue"))
    header += "element face 1\nproperty list uchar int vertex_indices\nend_header\n"
    path = folder / "wedge.ply"
    path.write_text(header + "\n".join(vertices) + f"\n3 {face}\n")
    return path


def nearest_texel(mesh: Mesh, vertex_position) -> list[int]:
    """The texel at the vertex nearest to a position, uv pulled a little inwards."""
    vertex = np.argmin(np.linalg.norm(mesh.position - vertex_position, axis=1))
    height, width = mesh.texture.shape[:2]
    u, v = np.clip(mesh.uv[vertex], 0.01, 0.99)
    return mesh.texture[int(v * height), int(u * width)].tolist()


@pytest.fixture
def scene():
    board = replace(construction.plane(0.4, 0.3, colour=(0.2, 0.4, 0.6)), name="board", texture=CORNERS)
    matrix = np.eye(4)
    matrix[:3, :3] = turn(0.3, 0.5, -0.2) * [1.0, 2.0, 0.5]
    matrix[:3, 3] = [0.1, -0.2, -1]
    shifted = np.eye(4)
    shifted[:3, 3] = [1, 2, 3]
    return Scene(
        "test",
        (board, objects.mug()),
        (Instance("one", 0, np.eye(4)), Instance("two", 0, matrix), Instance("cup", 1, shifted)),
        (
            LightSource("point", np.array([0.1, 0.5, -0.3]), np.array([2.0, 1.0, 0.5], np.float32)),
            LightSource("directional", np.array([0.48, -0.8, -0.36]), np.array([0.3, 0.6, 0.9], np.float32)),
        ),
    )


@pytest.fixture
def loaded(scene, tmp_path):
    return load_meshes(save_glb(scene, tmp_path / "scene.glb"))


def test_glb_keeps_meshes_once_and_places_them_where_they_were(scene, loaded):
    assert len(loaded.meshes) == 2
    assert len(loaded.instances) == 3
    by_name = {instance.name.split(" ", 1)[1]: instance for instance in loaded.instances}
    for instance in scene.instances:
        again = by_name[instance.name]
        mesh, before = loaded.meshes[again.mesh], scene.mesh_of(instance)
        np.testing.assert_allclose(again.world_from_mesh, instance.world_from_mesh, atol=1e-12)
        np.testing.assert_allclose(world_positions(mesh, again), world_positions(before, instance), atol=1e-6)
        np.testing.assert_array_equal(mesh.triangles, before.triangles)
        np.testing.assert_allclose(mesh.normal, before.normal, atol=1e-6)


def test_glb_keeps_colours_and_textures(scene, loaded):
    board, mug = (next(m for m in loaded.meshes if name in m.name) for name in ("board", "mug"))
    np.testing.assert_array_equal(board.texture, CORNERS)
    np.testing.assert_allclose(board.uv, scene.meshes[0].uv, atol=1e-6)
    np.testing.assert_allclose(board.base_colour, [0.2, 0.4, 0.6], atol=0.5 / 255)
    np.testing.assert_allclose(mug.vertex_colour, scene.meshes[1].vertex_colour, atol=0.51 / 255)
    assert mug.texture is None


def test_glb_keeps_lights(scene, loaded):
    lights = {light.kind: light for light in loaded.lights}
    assert len(loaded.lights) == 2
    for light in scene.lights:
        np.testing.assert_allclose(lights[light.kind].vector, light.vector, atol=1e-12)
        np.testing.assert_allclose(lights[light.kind].colour, light.colour, rtol=1e-5)


def test_gltf_uv_has_its_origin_at_the_top_left(tmp_path):
    (tmp_path / "my texture.png").write_bytes(png(CORNERS))
    material = {"pbrMetallicRoughness": {"baseColorTexture": {"index": 0}}}
    path = gltf(tmp_path, materials=[material], textures=[{"source": 0}], images=[{"uri": "my%20texture.png"}])
    mesh = load_meshes(path).meshes[0]
    assert nearest_texel(mesh, [0, 0, 0]) == [255, 0, 0]
    assert nearest_texel(mesh, [1, 0, 0]) == [0, 255, 0]
    assert nearest_texel(mesh, [0, 1, 0]) == [0, 0, 255]


def test_obj_uv_has_its_origin_at_the_bottom_left_and_is_turned(tmp_path):
    mesh = load_meshes(obj(tmp_path)).meshes[0]
    assert nearest_texel(mesh, [0, 0, 0]) == [0, 0, 255]
    assert nearest_texel(mesh, [1, 0, 0]) == [255, 255, 0]
    assert nearest_texel(mesh, [0, 1, 0]) == [255, 0, 0]
    np.testing.assert_allclose(mesh.base_colour, [0.5, 0.25, 1])


def test_ply_vertex_colours_are_made_linear(tmp_path):
    colour = load_meshes(ply(tmp_path)).meshes[0].vertex_colour
    np.testing.assert_allclose(colour[0], [1, 0.5028865, 0], atol=1e-6)


def test_normals_are_computed_where_the_file_has_none(tmp_path):
    np.testing.assert_allclose(load_meshes(gltf(tmp_path)).meshes[0].normal, np.tile([0, 0, 1], (3, 1)), atol=1e-7)


def test_a_child_node_is_placed_through_its_parents(tmp_path):
    nodes = [{"children": [1], "scale": [2, 2, 2]}, {"mesh": 0, "name": "here", "translation": [1, 0, 0]}]
    instance = load_meshes(gltf(tmp_path, nodes=nodes)).instances[0]
    np.testing.assert_allclose(instance.world_from_mesh, [[2, 0, 0, 2], [0, 2, 0, 0], [0, 0, 2, 0], [0, 0, 0, 1]])


def test_a_light_shines_along_the_minus_z_of_its_node_with_intensity_over_pi(tmp_path):
    lights = {"KHR_lights_punctual": {"lights": [{"type": "directional", "intensity": 3.0, "color": [1, 0.5, 0]}]}}
    nodes = [{"mesh": 0}, {"rotation": [0, 0.6, 0, 0.8], "extensions": {"KHR_lights_punctual": {"light": 0}}}]
    light = load_meshes(gltf(tmp_path, nodes=nodes, scenes=[{"nodes": [0, 1]}], extensions=lights)).lights[0]
    np.testing.assert_allclose(light.vector, [-0.96, 0, -0.28], atol=1e-12)
    np.testing.assert_allclose(light.colour, np.array([3, 1.5, 0]) / np.pi, rtol=1e-6)


def test_triangles_without_area_are_dropped(tmp_path):
    mesh = load_meshes(obj(tmp_path, faces="f 1/1 2/2 3/3\nf 1/1 1/1 2/2\n")).meshes[0]
    assert len(mesh.triangles) == 1


SPOT = {"KHR_lights_punctual": {"lights": [{"type": "spot"}]}}
SPOT_NODES = [{"mesh": 0, "name": "bulb", "extensions": {"KHR_lights_punctual": {"light": 0}}}]
TEXTURED = {"materials": [{"pbrMetallicRoughness": {"baseColorTexture": {"index": 0}}}], "textures": [{"source": 0}]}


@pytest.mark.parametrize(
    ("make", "complaint"),
    [
        (lambda d: d / "none.glb", "there is no such file"),
        (lambda d: d / "model.fbx", "cannot read '.fbx' files"),
        (lambda d: gltf(d, positions=[[0, 0, 0], [1, 0, 0], [0, np.nan, 0]]), "mesh 'wedge' has a vertex that is not"),
        (lambda d: gltf(d, positions=[[0, 0, 0], [1, 0, 0], [0, np.inf, 0]]), "mesh 'wedge' has a vertex that is not"),
        (lambda d: gltf(d, indices=[0, 1, 7]), "mesh 'wedge' refers to a vertex beyond its 3"),
        (lambda d: gltf(d, indices=[0, 1, 1]), "mesh 'wedge' has no triangles with an area"),
        (lambda d: gltf(d, meshes=[], nodes=[{}]), "holds no triangles"),
        (lambda d: gltf(d, images=[{"uri": "gone.png"}], **TEXTURED), "its file gone.png is missing"),
        (lambda d: gltf(d, extensionsRequired=["KHR_draco_mesh_compression"]), "extension KHR_draco_mesh_compression"),
        (lambda d: gltf(d, nodes=SPOT_NODES, extensions=SPOT), "light 'bulb' is of kind 'spot'"),
        (lambda d: gltf(d, buffers=[{"byteLength": 72, "uri": "gone.bin"}]), "its file gone.bin is missing"),
        (lambda d: obj(d, texture=False), "its file t.png is missing"),
        (lambda d: obj(d, mtl=""), "its file wedge.mtl is missing"),
        (lambda d: obj(d, faces="f 1/1 2/2 9/3\n"), "cannot be read"),
        (lambda d: obj(d, faces=""), "holds no triangles"),
        (lambda d: ply(d, face="0 1 7"), "refers to a vertex beyond its 3"),
        (lambda d: ply(d, vertices=("0 0 0 0 0 0", "1 0 nan 0 0 0", "0 1 0 0 0 0")), "a vertex that is not finite"),
    ],
)
def test_a_faulty_file_is_refused_with_its_name(tmp_path, make, complaint):
    path = make(tmp_path)
    with pytest.raises(BadInputError) as caught:
        load_meshes(path)
    assert path.name in str(caught.value)
    assert complaint in str(caught.value)


@pytest.mark.parametrize("suffix", [".glb", ".gltf", ".obj", ".ply"])
def test_rubbish_and_empty_files_are_refused(tmp_path, suffix):
    for content in (b"", b"rubbish", bytes(range(256))):
        path = tmp_path / f"rubbish{suffix}"
        path.write_bytes(content)
        with pytest.raises(BadInputError, match="rubbish"):
            load_meshes(path)


def test_a_broken_texture_is_refused(tmp_path):
    path = obj(tmp_path)
    (tmp_path / "t.png").write_bytes(b"not a picture")
    with pytest.raises(BadInputError, match=r"t\.png is missing or broken"):
        load_meshes(path)
