import base64
import json
import re
import struct
import zlib
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from glb_writer import save_glb
from numpy import integer, number
from numpy.typing import NDArray
from present import present

from wlr_render.errors import BadInputError
from wlr_render.io.input_files import InputLimits, outside_references
from wlr_render.scene import gltf_document
from wlr_render.scene.mesh_file import MeshFile, load_meshes
from wlr_render.scene.scene import Instance, LightSource, Mesh, Scene, world_positions
from wlr_render.scene.shapes import construction
from wlr_render.scene.shapes.construction import turn

CORNERS = np.array([[255, 0, 0], [0, 255, 0], [0, 0, 255], [255, 255, 0]], np.uint8).reshape(2, 2, 3)
"""Red and green above, blue and yellow below."""


def png(rows: Iterable[bytes], size: tuple[int, int], depth: int = 8, kind: int = 2, gamma: bool = False) -> bytes:
    """A PNG by hand, so that the reader is not tested against itself; it claims a size, and may claim another."""

    def chunk(name: bytes, content: bytes) -> bytes:
        return struct.pack(">I", len(content)) + name + content + struct.pack(">I", zlib.crc32(name + content))

    content = chunk(b"IHDR", struct.pack(">IIBBBBB", *size, depth, kind, 0, 0, 0))
    content += chunk(b"gAMA", struct.pack(">I", 100_000)) if gamma else b""
    content += chunk(b"IDAT", zlib.compress(b"".join(b"\0" + row for row in rows)))
    return b"\x89PNG\r\n\x1a\n" + content + chunk(b"IEND", b"")


def four_texels(width: int = 2, height: int = 2) -> bytes:
    """A PNG of `CORNERS` that claims to have this size."""
    return png((row.tobytes() for row in CORNERS), (width, height))


def stored(*parts: NDArray[Any]) -> dict[str, Any]:
    """Keys of `gltf`: a buffer of these parts, with a view of each."""
    starts, blob = np.cumsum([0, *(each.nbytes for each in parts)]).tolist(), b"".join(each.tobytes() for each in parts)
    views = [{"buffer": 0, "byteOffset": at, "byteLength": n.nbytes} for at, n in zip(starts, parts, strict=False)]
    uri = "data:application/octet-stream;base64," + base64.b64encode(blob).decode()
    return {"bufferViews": views, "buffers": [{"byteLength": len(blob), "uri": uri}]}


def accessor(view: int, kind: str, count: int = 3, component: int = 5126) -> dict[str, Any]:
    """Numbers of a view, floats if no other component is named."""
    return {"bufferView": view, "componentType": component, "count": count, "type": kind}


def accessors(**changes: Any) -> list[Any]:
    """Positions, indices and texture coordinates of `gltf`, the first one changed."""
    return [accessor(0, "VEC3") | changes, accessor(1, "SCALAR", component=5125), accessor(2, "VEC2")]


TRIANGLE = np.array([[0, 0, 0], [1, 0, 0], [0, 1, 0]], np.float32)
UV = ((0, 0), (1, 0), (0, 1))


def gltf(
    folder: Path,
    positions: Any = TRIANGLE,
    indices: Sequence[int] = (0, 1, 2),
    uv: Sequence[Sequence[float]] = UV,
    **changes: Any,
) -> Path:
    """One triangle as glTF; `changes` replace or add top-level keys."""
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
        "accessors": accessors(),
        **stored(np.array(positions, np.float32), np.array(indices, np.uint32), np.array(uv, np.float32)),
    }
    path = folder / "wedge.gltf"
    path.write_text(json.dumps(content | changes))
    return path


def obj(
    folder: Path,
    faces: str = "f 1/1 2/2 3/3\n",
    mtl: str = "newmtl m\nKd 0.5 0.25 1\nmap_Kd t.png\n",
    texture: bool = True,
) -> Path:
    path = folder / "wedge.obj"
    vertices = "v 0 0 0\nv 1 0 0\nv 0 1 0\nvt 0 0\nvt 1 0\nvt 0 1\n"
    path.write_text("mtllib wedge.mtl\n" + vertices + "usemtl m\n" + faces)
    if mtl:
        (folder / "wedge.mtl").write_text(mtl)
    if texture:
        (folder / "t.png").write_bytes(four_texels())
    return path


def ply(folder: Path) -> Path:
    header = "ply\nformat ascii 1.0\nelement vertex 3\n" + "".join(f"property float {a}\n" for a in "xyz")
    header += "".join(f"property uchar {a}\n" for a in ("red", "green", "blue"))
    header += "element face 1\nproperty list uchar int vertex_indices\nend_header\n"
    path = folder / "wedge.ply"
    path.write_text(header + "0 0 0 255 188 0\n1 0 0 0 0 0\n0 1 0 0 0 0\n3 0 1 2\n")
    return path


def nearest_texel(mesh: Mesh, vertex_position: Sequence[Any]) -> list[int]:
    """The texel at the vertex nearest to a position, uv pulled a little inwards."""
    vertex = np.argmin(np.linalg.norm(mesh.position - vertex_position, axis=1))
    assert mesh.texture is not None
    height, width = mesh.texture.shape[:2]
    u, v = np.clip(present(mesh.uv)[vertex], 0.01, 0.99)
    texel: list[int] = mesh.texture[int(v * height), int(u * width)].tolist()
    return texel


@pytest.fixture
def scene() -> Scene:
    board = replace(construction.plane(0.4, 0.3, colour=(0.2, 0.4, 0.6)), name="board", texture=CORNERS)
    cup = construction.sphere(0.04, segments=8)
    cup = replace(cup, name="cup", vertex_colour=np.random.default_rng(1).random(cup.position.shape, np.float32))
    matrix = np.eye(4)
    matrix[:3, :3] = turn(0.3, 0.5, -0.2) * [1.0, 2.0, 0.5]
    matrix[:3, 3] = [0.1, -0.2, -1]
    shifted = np.eye(4)
    shifted[:3, 3] = [1, 2, 3]
    return Scene(
        "test",
        (board, cup),
        (Instance("one", 0, np.eye(4)), Instance("two", 0, matrix), Instance("cup", 1, shifted)),
        (
            LightSource("point", np.array([0.1, 0.5, -0.3]), np.array([2.0, 1.0, 0.5], np.float32)),
            LightSource("directional", np.array([0.48, -0.8, -0.36]), np.array([0.3, 0.6, 0.9], np.float32)),
        ),
    )


@pytest.fixture
def loaded(scene: Scene, tmp_path: Path) -> MeshFile:
    return load_meshes(save_glb(scene, tmp_path / "scene.glb"))


def test_glb_keeps_meshes_once_and_places_them_where_they_were(scene: Scene, loaded: MeshFile) -> None:
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


def test_glb_keeps_colours_and_textures(scene: Scene, loaded: MeshFile) -> None:
    board, cup = (next(m for m in loaded.meshes if name in m.name) for name in ("board", "cup"))
    np.testing.assert_array_equal(board.texture, CORNERS)
    np.testing.assert_allclose(present(board.uv), present(scene.meshes[0].uv), atol=1e-6)
    np.testing.assert_allclose(board.base_colour, [0.2, 0.4, 0.6], atol=0.5 / 255)
    np.testing.assert_allclose(present(cup.vertex_colour), present(scene.meshes[1].vertex_colour), atol=0.51 / 255)
    assert cup.texture is None


def test_glb_keeps_lights(scene: Scene, loaded: MeshFile) -> None:
    lights = {light.kind: light for light in loaded.lights}
    assert len(loaded.lights) == 2
    for light in scene.lights:
        np.testing.assert_allclose(lights[light.kind].vector, light.vector, atol=1e-12)
        np.testing.assert_allclose(lights[light.kind].colour, light.colour, rtol=1e-5)


def test_gltf_uv_has_its_origin_at_the_top_left(tmp_path: Path) -> None:
    (tmp_path / "my texture.png").write_bytes(four_texels())
    material = {"pbrMetallicRoughness": {"baseColorTexture": {"index": 0}}}
    path = gltf(tmp_path, materials=[material], textures=[{"source": 0}], images=[{"uri": "my%20texture.png"}])
    mesh = load_meshes(path).meshes[0]
    assert nearest_texel(mesh, [0, 0, 0]) == [255, 0, 0]
    assert nearest_texel(mesh, [1, 0, 0]) == [0, 255, 0]
    assert nearest_texel(mesh, [0, 1, 0]) == [0, 0, 255]


def test_obj_uv_has_its_origin_at_the_bottom_left_and_is_turned(tmp_path: Path) -> None:
    mesh = load_meshes(obj(tmp_path)).meshes[0]
    assert nearest_texel(mesh, [0, 0, 0]) == [0, 0, 255]
    assert nearest_texel(mesh, [1, 0, 0]) == [255, 255, 0]
    assert nearest_texel(mesh, [0, 1, 0]) == [255, 0, 0]
    np.testing.assert_allclose(mesh.base_colour, [0.5, 0.25, 1])


def test_ply_vertex_colours_are_made_linear(tmp_path: Path) -> None:
    colour = load_meshes(ply(tmp_path)).meshes[0].vertex_colour
    np.testing.assert_allclose(present(colour)[0], [1, 0.5028865, 0], atol=1e-6)


def test_a_gltf_without_normals_is_flat(tmp_path: Path) -> None:
    corners = np.array([[0, 0, 0], [1, 0, 0], [0, 1, 0], [0, 0, 1]], np.float32)
    faces = np.array([[0, 1, 2], [0, 2, 3], [0, 3, 1]], np.uint32)
    meshes = [{"primitives": [{"attributes": {"POSITION": 0}, "indices": 1}]}]
    read = [accessor(0, "VEC3", 4), accessor(1, "SCALAR", 9, 5125)]
    mesh = load_meshes(gltf(tmp_path, meshes=meshes, accessors=read, **stored(corners, faces))).meshes[0]
    expected = np.repeat([[0, 0, 1], [1, 0, 0], [0, 1, 0]], 3, axis=0)
    np.testing.assert_allclose(mesh.normal[mesh.triangles.ravel()], expected, atol=1e-7)


def test_a_child_node_is_placed_through_its_parents(tmp_path: Path) -> None:
    nodes = [{"children": [1], "scale": [2, 2, 2]}, {"mesh": 0, "name": "here", "translation": [1, 0, 0]}]
    instance = load_meshes(gltf(tmp_path, nodes=nodes)).instances[0]
    np.testing.assert_allclose(instance.world_from_mesh, [[2, 0, 0, 2], [0, 2, 0, 0], [0, 0, 2, 0], [0, 0, 0, 1]])


def test_a_light_shines_along_the_minus_z_of_its_node_with_intensity_over_pi(tmp_path: Path) -> None:
    lights = {"KHR_lights_punctual": {"lights": [{"type": "directional", "intensity": 3.0, "color": [1, 0.5, 0]}]}}
    nodes = [{"mesh": 0}, {"rotation": [0, 0.6, 0, 0.8], "extensions": {"KHR_lights_punctual": {"light": 0}}}]
    light = load_meshes(gltf(tmp_path, nodes=nodes, scenes=[{"nodes": [0, 1]}], extensions=lights)).lights[0]
    np.testing.assert_allclose(light.vector, [-0.96, 0, -0.28], atol=1e-12)
    np.testing.assert_allclose(light.colour, np.array([3, 1.5, 0]) / np.pi, rtol=1e-6)


@pytest.mark.parametrize(
    ("material", "keys"),
    [
        ({}, ""),
        ({"pbrMetallicRoughness": {"metallicFactor": 0.0, "roughnessFactor": 1}, "alphaMode": "OPAQUE"}, ""),
        ({"emissiveFactor": [0, 0, 0], "doubleSided": True, "extras": {"a": 1}, "alphaCutoff": 0.5}, ""),
        ({"pbrMetallicRoughness": {"baseColorFactor": [1, 1, 1, 1]}}, "metallicFactor"),  # its default is 1
        ({"pbrMetallicRoughness": {"metallicFactor": 0, "roughnessFactor": 0.4}}, "roughnessFactor"),
        ({"alphaMode": "BLEND", "emissiveFactor": [1, 0.5, 0]}, "alphaMode, emissiveFactor"),
        ({"alphaMode": "MASK", "normalTexture": {"index": 0}}, "alphaMode, normalTexture"),
        ({"extensions": {"KHR_materials_transmission": {"transmissionFactor": 1}}}, "KHR_materials_transmission"),
    ],
)
def test_properties_of_gltf_that_are_not_drawn_are_named(tmp_path: Path, material: dict[str, Any], keys: str) -> None:
    path = gltf(tmp_path, materials=[{"name": "steel"} | material, {"alphaMode": "MASK"}])  # no mesh has the second
    assert load_meshes(path).not_drawn == ((f"{keys} of 'steel' in wedge.gltf",) if keys else ())


@pytest.mark.parametrize(
    ("transform", "first", "second", "third"),
    [
        ({"scale": [2, 3]}, [0, 0], [2, 0], [0, 3]),
        ({"offset": [0, 1], "rotation": np.pi / 2, "scale": [0.5, 0.5]}, [0, 1], [0, 0.5], [0.5, 1]),  # of its document
        ({"offset": [0, 1], "scale": [1, -1], "texCoord": 0}, [0, 1], [1, 1], [0, 0]),
    ],
)
def test_texture_coordinates_are_moved_as_the_material_states(
    tmp_path: Path, transform: dict[str, Any], first: Sequence[int], second: Sequence[float], third: Sequence[float]
) -> None:
    (tmp_path / "t.png").write_bytes(four_texels())
    texture = {"index": 0, "texCoord": 0, "extensions": {"KHR_texture_transform": transform}}
    surface = {"pbrMetallicRoughness": {"baseColorTexture": texture, "metallicFactor": 0}}
    path = gltf(
        tmp_path,
        materials=[surface],
        textures=[{"source": 0}],
        images=[{"uri": "t.png"}],
        extensionsRequired=["KHR_texture_transform"],
    )
    loaded = load_meshes(path)
    mesh = loaded.meshes[0]
    assert loaded.not_drawn == ()
    for place, uv in (([0, 0, 0], first), ([1, 0, 0], second), ([0, 1, 0], third)):
        found = present(mesh.uv)[np.argmin(np.linalg.norm(mesh.position - place, axis=1))]
        np.testing.assert_allclose(found, uv, atol=1e-6)


@pytest.mark.parametrize(
    ("lines", "keys"),
    [("d 1.0\nKe 0.0 0 0\nTr 0\n", ""), ("d 0.3\n", "d"), ("d -halo 1\nKe 0 0 2\n", "d, ke"), ("Pm 1\n", "pm")],
)
def test_properties_of_obj_that_are_not_drawn_are_named(tmp_path: Path, lines: str, keys: str) -> None:
    path = obj(tmp_path, mtl=f"newmtl m\nKd 0.5 0.25 1\nKs 0.5 0.5 0.5\n{lines}map_Kd t.png\n")
    assert load_meshes(path).not_drawn == ((f"{keys} of 'm' in wedge.obj",) if keys else ())


def chain(count: int) -> list[Any]:
    return [{"children": [i + 1]} for i in range(count)] + [{"mesh": 0}]


def sparse(indices: Sequence[Any]) -> dict[Any, Any]:
    """The sparse part of the positions, with its indices and values in the last two views of `moved_corner`."""
    stated = {"indices": {"bufferView": 3, "componentType": 5125}, "values": {"bufferView": 4}}
    return {"count": len(indices), **stated}


def moved_corner(indices: Sequence[Any]) -> dict[Any, Any]:
    """Keys of `gltf` with sparse positions: the corners with these indices are (5, 6, 7)."""
    corners = np.tile(np.array([5, 6, 7], np.float32), len(indices))
    parts = np.array([0, 1, 2], np.uint32), np.array(UV, np.float32), np.array(indices, np.uint32), corners
    return {"accessors": accessors(sparse=sparse(indices)), **stored(TRIANGLE, *parts)}


def binary_ply(folder: Path, corners: tuple[int, ...]) -> Path:
    """A PLY of one triangle, whose faces say that they have so many corners."""
    header = ply(folder).read_bytes().partition(b"end_header\n")[0].replace(b"ascii", b"binary_little_endian")
    header = re.sub(rb"property uchar \w+\n", b"", header).replace(b"face 1", b"face %d" % len(corners))
    faces = b"".join(bytes([count]) + struct.pack("<4i", 0, 1, 2, 0)[: 4 * min(count, 4)] for count in corners)
    path = folder / "wedge.ply"
    path.write_bytes(header + b"end_header\n" + np.array([0, 0, 0, 1, 0, 0, 0, 1, 0], np.float32).tobytes() + faces)
    return path


def changed(path: Path, old: bytes, new: bytes) -> Path:
    content = path.read_bytes()
    assert old in content
    path.write_bytes(content.replace(old, new))
    return path


def glb(folder: Path, length: int) -> Path:
    """That of `gltf`, its buffer of a stated length."""
    content = json.loads(gltf(folder).read_text())
    blob = base64.b64decode(content["buffers"][0]["uri"].partition(",")[2])
    text = json.dumps(content | {"buffers": [{"byteLength": length}]}).encode()
    text += b" " * (-len(text) % 4)
    chunks = struct.pack("<I4s", len(text), b"JSON") + text + struct.pack("<I4s", len(blob), b"BIN\0") + blob
    path = folder / "wedge.glb"
    path.write_bytes(struct.pack("<4sII", b"glTF", 2, 12 + len(chunks)) + chunks)
    return path


HALF = "data:image/png;base64," + base64.b64encode(four_texels(height=4)).decode()
PLACE = [1, 0, 0, 0, 0, 1, 0, 0, 0, 0, 1, 0, 0, 0, 0, 1]
LAST_LIGHT = {"KHR_lights_punctual": {"light": -1}}
GLOSSY = {"KHR_materials_pbrSpecularGlossiness": {"diffuseFactor": [5, 0, 0, 1]}}
BOMB = "data:image/png;base64," + base64.b64encode(four_texels(50_000, 50_000)).decode()
SPOT = {"KHR_lights_punctual": {"lights": [{"type": "spot"}]}}
SPOT_NODES = [{"mesh": 0, "name": "bulb", "extensions": {"KHR_lights_punctual": {"light": 0}}}]
PICTURE = "data:image/png;base64," + base64.b64encode(four_texels()).decode()
MATT: list[dict[str, Any]] = [{}]
TEXTURED: dict[str, Any] = {
    "materials": [{"pbrMetallicRoughness": {"baseColorTexture": {"index": 0}}}],
    "textures": [{"source": 0}],
}


@pytest.mark.parametrize(
    ("make", "complaint"),
    [
        (lambda d: d / "none.glb", "there is no such file"),
        (lambda d: d / "model.fbx", "cannot read '.fbx' files"),
        (lambda d: gltf(d, positions=[[0, 0, 0], [1, 0, 0], [0, np.nan, 0]]), "mesh 'wedge' has a vertex that is not"),
        (lambda d: gltf(d, indices=[0, 1, 7]), "mesh 'wedge' refers to a vertex beyond its 3"),
        (lambda d: gltf(d, indices=[0, 1, 1]), "mesh 'wedge' has no triangles with an area"),
        (lambda d: gltf(d, meshes=[], nodes=[{}]), "holds no triangles"),
        (
            lambda d: gltf(d, meshes=wedge(mode=0)),
            "holds no triangles (not drawn: points of mesh 'wedge'); export it again with faces.",
        ),
        (
            lambda d: gltf(d, **textured(extensions={"KHR_texture_transform": {"scale": [2]}})),
            "'scale' of its base texture is [2], not 2 finite numbers",
        ),
        (
            lambda d: gltf(d, **textured(extensions={"KHR_texture_transform": {"rotation": [1, 2]}})),
            "'rotation' of its base texture is [1, 2], not a finite",
        ),
        (lambda d: gltf(d, images=[{"uri": "gone.png"}], **TEXTURED), "its file gone.png is missing"),
        (lambda d: gltf(d, extensionsRequired=["KHR_draco_mesh_compression"]), "extension KHR_draco_mesh_compression"),
        (
            lambda d: gltf(d, nodes=SPOT_NODES, extensions={"KHR_lights_punctual": {"lights": [{"type": "magic"}]}}),
            "light 'bulb' is of kind 'magic'",
        ),
        (lambda d: gltf(d, meshes=wedge(mode=7)), "mesh 'wedge' has primitives of mode 7, which are not read"),
        (
            lambda d: gltf(d, **textured(texCoord=1)),
            "mesh 'wedge': its base texture uses TEXCOORD_1, which the mesh lacks; export it with texture coordinates.",
        ),
        (lambda d: gltf(d, buffers=[{"byteLength": 72, "uri": "gone.bin"}]), "its file gone.bin is missing"),
        (lambda d: gltf(d, nodes=[{"mesh": 0, "children": [0]}]), "nodes 0 is its own child"),
        (lambda d: gltf(d, nodes=chain(300)), "nests its nodes more than 200 deep"),
        (lambda d: gltf(d, nodes=[{"mesh": 7}]), "refers to number 7 of 'meshes', which has 1 entries"),
        (lambda d: gltf(d, nodes=[{"mesh": -1}]), "refers to number -1 of 'meshes'"),
        (lambda d: gltf(d, nodes=[{"mesh": 0, "matrix": [1e30] * 16}]), "nodes 0: 'matrix' is [1e+30,"),
        (
            lambda d: gltf(d, nodes=[{"mesh": 0, "translation": [0, 0, float("nan")]}]),
            "nodes 0: 'translation' is [0, 0, nan], not 3",
        ),
        (lambda d: gltf(d, nodes=[{"mesh": 0, "rotation": [0, 0, 0, 0]}]), "nodes 0: 'rotation' has length 0, not 1"),
        (lambda d: gltf(d, nodes=[{"mesh": 0, "scale": [1, 0, 1]}]), "has no size or no finite place"),
        (lambda d: gltf(d, nodes=[{"mesh": 0, "scale": [1e8, 1, 1]}]), "has no size or no finite place"),
        (lambda d: gltf(d, positions=[[0, 0, 0], [1, 0, 0], [0, 1e30, 0]]), "a vertex that is not finite in 32 bits"),
        (
            lambda d: gltf(d, accessors=[{"componentType": 5126, "count": 10**8, "type": "VEC3"}]),
            "for more than 512 MB",
        ),
        (lambda d: gltf(d, accessors=accessors(count=4)), "accessors 0 ends at byte 48, beyond bufferViews 0"),
        (lambda d: gltf(d, accessors=accessors(count=10**10)), "accessors 0: 'count' is 10000000000, not a whole"),
        (lambda d: gltf(d, accessors=accessors(sparse={"count": 1})), "accessors 0, sparse: lacks 'indices'"),
        (
            lambda d: gltf(d, accessors=accessors(sparse=sparse([0]) | {"count": 4})),
            "accessors 0, sparse: has 4 indices of component 5125 for 3 entries",
        ),
        (lambda d: gltf(d, **moved_corner([7])), "accessors 0: its sparse indices reach 7, beyond its 3"),
        (lambda d: gltf(d, asset={"version": "1.0"}), "is of glTF version '1.0'; version 2 is read"),
        (
            lambda d: gltf(d, **TEXTURED | {"textures": [{"extensions": {"KHR_texture_basisu": {"source": 0}}}]}),
            "mesh 'wedge': its base texture has no picture that is read (KHR_texture_basisu); export PNG or JPEG",
        ),
        (lambda d: gltf(d, accessors=accessors(componentType=5125)), "POSITION is not of type VEC3 in floats"),
        (
            lambda d: gltf(d, accessors=[accessors()[0], accessors()[0], accessors()[2]]),
            "its indices are not of type SCALAR",
        ),
        (lambda d: glb(d, 80), "buffers 0 has 72 bytes, not 80"),
        (lambda d: glb(d, 60), "bufferViews 2 ends at byte 72, beyond buffers 0"),
        (lambda d: gltf(d, nodes=[{"mesh": 0, "matrix": [1, 0, 0, 0.5, *PLACE[4:]]}]), "the last row of 'matrix'"),
        (lambda d: gltf(d, nodes=[{"mesh": 0, "extensions": LAST_LIGHT}], extensions=SPOT), "'light' is -1"),
        (lambda d: gltf(d, materials=[{"extensions": GLOSSY}]), "its 'diffuseFactor' is [5, 0, 0, 1]"),
        (lambda d: gltf(d, images=[{"uri": HALF}], **TEXTURED), "texture of mesh 'wedge': cannot be read"),
        (
            lambda d: gltf(d, materials=[{"pbrMetallicRoughness": {"baseColorFactor": [-1, 0, 0, 1]}}]),
            "'baseColorFactor'",
        ),
        (lambda d: gltf(d, images=[{"uri": "../t.png"}], **TEXTURED), "'../t.png' leads out of the folder"),
        (
            lambda d: gltf(d, images=[{"uri": "data:image/png;base64,AAAA"}], **TEXTURED),
            "images 0: cannot be read as",
        ),
        (lambda d: gltf(d, images=[{"uri": BOMB}], **TEXTURED), "it has more than 134 million pixels"),
        (lambda d: gltf(d, **TEXTURED), "refers to number 0 of 'images', which has 0 entries"),
        (lambda d: obj(d, mtl="newmtl m\nmap_Kd ../t.png\n"), "'../t.png' leads out of the folder"),
        (lambda d: obj(d, mtl="newmtl n\n"), "uses the material 'm', which 'wedge.mtl' lacks"),
        (lambda d: gltf(d, buffers=[{"byteLength": 72, "uri": "data:,base64,AAAA"}]), "has 11 bytes, not 72"),
        (lambda d: obj(d, faces="f 1/1 2/2 0/3\n"), "line 9: has vertex 0, but they are counted from 1"),
        (lambda d: obj(d, mtl="newmtl m\nKd nan 0 0\n"), "'Kd' is 'nan 0 0', not three numbers"),
        (lambda d: obj(d, faces="f 1/1 2/2\n"), "line 9: has fewer than three numbers"),
        (lambda d: obj(d, faces="f 1/1 2/2 3/9\n"), "refers to 'vt' number 9 of 3"),
        (lambda d: obj(d, faces="f 1//1 2//1 3//1\n"), "refers to 'vn' number 1 of 0"),
        (lambda d: obj(d, faces="v\nf 1 2 3\n"), "line 9: has fewer than three numbers"),
        (lambda d: obj(d, faces="f 1 2 3\n"), "has a texture but no texture coordinates"),
        (lambda d: changed(ply(d), b"face 1", b"face 2"), "promises 5 rows but has 4"),
        (lambda d: changed(ply(d), b"vertex 3", b"vertex -3"), "'element vertex -3' has no count"),
        (lambda d: changed(ply(d), b"0 1 0 0", b"0 x 0 0"), "has 'x' among its numbers"),
        (lambda d: changed(ply(d), b"end_header", b"end"), "no 'end_header'"),
        (
            lambda d: changed(changed(ply(d), b"ascii", b"binary_little_endian"), b"vertex 3", b"vertex 1000000000"),
            "promises at least 15000000000 bytes but has",
        ),
        (lambda d: binary_ply(d, (3, 9)), "ends within the 2 rows of 'face' that it promises"),
        (lambda d: changed(ply(d), b"255 188 0", b"300 188 0"), "row 1 of 'vertex': 'red' is '300', not a byte"),
        (lambda d: changed(ply(d), b"3 0 1 2", b"3 0 1 2 2"), "row 1 of 'face' has 5 numbers"),
        (lambda d: changed(ply(d), b"0 255 188 0", b"0 1 255 188 0"), "row 1 of 'vertex' has 7 numbers"),
        (lambda d: changed(ply(d), b"property uchar green\nproperty uchar blue\n", b""), "'vertex' has red alone"),
        (lambda d: obj(d, texture=False), "its file t.png is missing"),
        (lambda d: obj(d, mtl=""), "its file wedge.mtl is missing"),
        (lambda d: obj(d, faces="f 1/1 2/2 9/3\n"), "refers to 'v' number 9 of 3"),
        (lambda d: obj(d, faces="p 1\nl 1 2\n"), "holds no triangles (not drawn: points, lines); export it again"),
    ],
)
def test_a_faulty_file_is_refused_with_its_name(tmp_path: Path, make: Callable[..., Any], complaint: str) -> None:
    path = make(tmp_path)
    with pytest.raises(BadInputError) as caught:
        load_meshes(path)
    assert path.name in str(caught.value)
    assert complaint in str(caught.value)


def wedge(*more: object, **changes: Any) -> list[Any]:
    """The mesh of `gltf` with a changed primitive, and `more` primitives."""
    primitive = {"attributes": {"POSITION": 0, "TEXCOORD_0": 2}, "indices": 1, "material": 0}
    return [{"name": "wedge", "primitives": [primitive | changes, *more]}]


def textured(sampler: Mapping[str, int] | None = None, **changes: Any) -> dict[Any, Any]:
    """Keys of `gltf` for a matt material 'm' with a texture."""
    surface = {"metallicFactor": 0, "baseColorTexture": {"index": 0} | changes}
    texture = {"source": 0} | ({} if sampler is None else {"sampler": 0})
    return {
        "materials": [{"name": "m", "pbrMetallicRoughness": surface}],
        "textures": [texture],
        "samplers": [sampler or {}],
        "images": [{"uri": PICTURE}],
    }


SHEEN = {"pbrMetallicRoughness": {"metallicFactor": 0}, "extensions": {"KHR_materials_sheen": {}}}
MORPHED = wedge(targets=[{"POSITION": 0}])[0]
WEIGHTED = {"weights": [0.5]}
MOVING = {"mesh": 0, "name": "here", "skin": 0, "extensions": {"EXT_mesh_gpu_instancing": {}}}
ABSENT = {"textures": [{"source": 0}], "images": [{"uri": "gone.png"}]}


@pytest.mark.parametrize(
    ("changes", "named"),
    [
        ({"materials": [SHEEN]}, ["KHR_materials_sheen of 'material 0'"]),
        ({"materials": [{"name": "m", "normalTexture": {"index": 0}}], **ABSENT}, ["normalTexture of 'm'"]),
        ({"meshes": wedge({"attributes": {"POSITION": 0}, "mode": 0})}, ["points of mesh 'wedge'"]),
        *(
            ({"meshes": wedge({"attributes": {"POSITION": 0}, "mode": mode})}, ["lines of mesh 'wedge'"])
            for mode in (1, 2, 3)
        ),
        ({"meshes": wedge({"attributes": {}})}, ["primitives without positions of mesh 'wedge'"]),
        ({"meshes": [MORPHED | WEIGHTED]}, ["morph targets of mesh 'wedge'"]),
        ({"meshes": [MORPHED], "nodes": [{"mesh": 0} | WEIGHTED]}, ["morph targets of mesh 'wedge'"]),
        ({"meshes": [MORPHED]}, []),
        ({"meshes": [MORPHED | WEIGHTED], "nodes": [{"mesh": 0, "weights": [0]}]}, []),
        ({"nodes": [MOVING]}, ["skin of node 'here'", "EXT_mesh_gpu_instancing of node 'here'"]),
        ({"animations": [{"name": "walk"}, {}]}, ["animation 'walk', 'animation 1'"]),
    ],
)
def test_what_is_not_drawn_is_named(tmp_path: Path, changes: dict[str, Any], named: list[str]) -> None:
    content = load_meshes(gltf(tmp_path, **{"materials": MATT} | changes))
    assert content.not_drawn == tuple(f"{each} in wedge.gltf" for each in named)
    assert [len(mesh.triangles) for mesh in content.meshes] == [1]


def test_what_hangs_on_a_mesh_of_points_or_on_a_camera_is_drawn(tmp_path: Path) -> None:
    points = {"name": "dust", "primitives": [{"attributes": {"POSITION": 0}, "mode": 0}]}
    nodes = [{"mesh": 1, "children": [1]}, {"camera": 0, "children": [2]}, {"mesh": 0, "name": "here"}]
    camera = {"type": "perspective", "perspective": {"yfov": 1, "znear": 0.1, "aspectRatio": 1}}
    content = load_meshes(gltf(tmp_path, meshes=[*wedge(), points], nodes=nodes, cameras=[camera]))
    assert [instance.name for instance in content.instances] == ["here"]


@pytest.mark.parametrize(
    ("sampler", "v", "keys"),
    [
        ({"wrapS": 33071, "wrapT": 33648}, 1.5, "wrapT MIRRORED_REPEAT"),
        ({"wrapS": 33071, "wrapT": 33071}, -0.5, "wrapT CLAMP_TO_EDGE"),
        ({"wrapS": 33071, "wrapT": 33071}, 1.0, ""),
        ({"wrapS": 10497, "magFilter": 9729}, 1.5, ""),
        ({"magFilter": 9728}, 1.0, "magFilter NEAREST"),
    ],
)
def test_samplers_that_differ_from_what_is_drawn_are_named(
    tmp_path: Path, sampler: Mapping[str, int], v: float, keys: str
) -> None:
    path = gltf(tmp_path, uv=(*UV[:2], (0, v)), **textured(sampler))
    assert load_meshes(path).not_drawn == ((f"{keys} of 'm' in wedge.gltf",) if keys else ())


def test_materials_that_lose_the_same_are_named_together_without_a_limit(tmp_path: Path) -> None:
    materials = [{"name": f"glass {n}", "alphaMode": "BLEND"} for n in range(30)]
    primitive = wedge()[0]["primitives"][0]
    meshes = [{"primitives": [primitive | {"material": n} for n in range(30)]}]
    (text,) = load_meshes(gltf(tmp_path, meshes=meshes, materials=materials)).not_drawn
    assert text == f"alphaMode of {', '.join(repr(each['name']) for each in materials)} in wedge.gltf"


def test_a_spot_light_is_left_out_and_named(tmp_path: Path) -> None:
    lights = {"KHR_lights_punctual": {"lights": [{"type": "spot"}, {"type": "point"}]}}
    nodes = [*SPOT_NODES, {"extensions": {"KHR_lights_punctual": {"light": 1}}}]
    scenes = [{"nodes": [0, 1]}]
    content = load_meshes(gltf(tmp_path, materials=MATT, nodes=nodes, scenes=scenes, extensions=lights))
    assert [light.kind for light in content.lights] == ["point"]
    assert content.not_drawn == ("spot light 'bulb' in wedge.gltf",)


def test_a_light_on_a_mesh_of_two_primitives_shines_once(tmp_path: Path) -> None:
    lights = {"KHR_lights_punctual": {"lights": [{"type": "point"}]}}
    path = gltf(tmp_path, meshes=wedge(*wedge()[0]["primitives"]), nodes=SPOT_NODES, extensions=lights)
    assert len(load_meshes(path).lights) == 1


@pytest.mark.parametrize("binary", [False, True])
def test_instances_have_the_order_of_the_nodes_depth_first(tmp_path: Path, binary: bool) -> None:
    names, children = ("root", "texbox", "ball", "lid", "pane"), {0: [1, 2, 4], 2: [3]}
    nodes = [
        {"mesh": 0, "name": name} | ({"children": children[n]} if n in children else {}) for n, name in enumerate(names)
    ]
    path = gltf(tmp_path, nodes=nodes)
    if binary:
        (tmp_path / "in").mkdir()
        content = json.loads(path.read_text())
        text = json.dumps(content).encode()
        text += b" " * (-len(text) % 4)
        path = tmp_path / "in" / "wedge.glb"
        path.write_bytes(struct.pack("<4sIII4s", b"glTF", 2, 20 + len(text), len(text), b"JSON") + text)
    assert [instance.name for instance in load_meshes(path).instances] == list(names)


def test_primitives_of_a_mesh_are_instances_with_names_that_do_not_change(tmp_path: Path) -> None:
    path = gltf(tmp_path, meshes=wedge(*wedge()[0]["primitives"]))
    assert [instance.name for instance in load_meshes(path).instances] == ["here/wedge", "here/wedge_1"]


def test_a_base_texture_uses_its_own_coordinates(tmp_path: Path) -> None:
    keys = textured(texCoord=1)
    # TEXCOORD_0 reads numbers of the positions.
    other = [*accessors(), accessor(0, "VEC2")]
    attributes = {"POSITION": 0, "TEXCOORD_0": 3, "TEXCOORD_1": 2}
    mesh = load_meshes(gltf(tmp_path, meshes=wedge(attributes=attributes), accessors=other, **keys)).meshes[0]
    np.testing.assert_allclose(present(mesh.uv), [[0, 0], [1, 0], [0, 1]])
    np.testing.assert_array_equal(mesh.texture, CORNERS)


@pytest.mark.parametrize("rough", [None, {"baseColorFactor": [1, 1, 1, 1]}])
def test_the_diffuse_texture_of_specular_glossiness_is_drawn(
    tmp_path: Path, rough: dict[str, list[int]] | None
) -> None:
    glossy = {"diffuseFactor": [0.2, 0.4, 0.6, 1], "diffuseTexture": {"index": 0}, "glossinessFactor": 0.5}
    material = {"name": "m", "extensions": {"KHR_materials_pbrSpecularGlossiness": glossy}}
    material |= {} if rough is None else {"pbrMetallicRoughness": rough | {"metallicFactor": 0}}
    content = load_meshes(gltf(tmp_path, **(textured() | {"materials": [material]})))
    np.testing.assert_array_equal(content.meshes[0].texture, CORNERS)
    np.testing.assert_allclose(content.meshes[0].base_colour, [0.2, 0.4, 0.6], atol=0.5 / 255)
    assert content.not_drawn == ("KHR_materials_pbrSpecularGlossiness of 'm' in wedge.gltf",)


def test_bytes_that_are_used_many_times_are_refused(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(gltf_document, "LIMITS", InputLimits(mesh_bytes=100))
    load_meshes(gltf(tmp_path))
    with pytest.raises(BadInputError, match=r"wedge\.gltf: uses the same bytes for more than 0\.0001 MB"):
        load_meshes(gltf(tmp_path, accessors=2 * accessors()))


def test_a_file_elsewhere_is_read_if_the_user_trusts_the_mesh(tmp_path: Path) -> None:
    (tmp_path / "t.png").write_bytes(four_texels())
    (tmp_path / "in").mkdir()
    path = gltf(tmp_path / "in", images=[{"uri": "../t.png"}], **TEXTURED)
    with outside_references():
        assert present(load_meshes(path).meshes[0].texture).shape == (2, 2, 3)


def test_a_broken_texture_is_refused(tmp_path: Path) -> None:
    path = obj(tmp_path)
    (tmp_path / "t.png").write_bytes(b"not a picture")
    with pytest.raises(BadInputError, match=r"wedge\.obj: its file t\.png: cannot be read as a picture"):
        load_meshes(path)


@pytest.mark.parametrize("indexed", [True, False])
@pytest.mark.parametrize(
    ("mode", "faces"),
    [(5, [[0, 1, 2], [1, 3, 2], [2, 3, 4]]), (6, [[1, 2, 0], [2, 3, 0], [3, 4, 0]]), (4, [[0, 1, 2]])],
)
def test_strips_and_fans_become_triangles(tmp_path: Path, mode: int, faces: Sequence[list[int]], indexed: bool) -> None:
    corners = np.array([[0, 0, 0], [1, 0, 0], [0, 1, 0], [1, 1, 0], [0.2, 2, 0]], np.float32)
    meshes = [{"primitives": [{"attributes": {"POSITION": 0}, "mode": mode} | ({"indices": 1} if indexed else {})]}]
    read = [accessor(0, "VEC3", 5), accessor(1, "SCALAR", 5, 5121)]
    path = gltf(tmp_path, meshes=meshes, accessors=read, **stored(corners, np.arange(5, dtype=np.uint8)))
    mesh = load_meshes(path).meshes[0]
    np.testing.assert_array_equal(mesh.position[mesh.triangles], corners[faces])


def test_sparse_positions_replace_stored_ones(tmp_path: Path) -> None:
    mesh = load_meshes(gltf(tmp_path, **moved_corner([1]))).meshes[0]
    assert sorted(mesh.position.tolist()) == [[0, 0, 0], [0, 1, 0], [5, 6, 7]]
    stated = moved_corner([0, 1, 2])
    del stated["accessors"][0]["bufferView"]
    with pytest.raises(BadInputError, match="has no triangles with an area"):
        load_meshes(gltf(tmp_path, **stated))


def typed(
    folder: Path,
    position: NDArray[Any],
    normal: NDArray[np.integer],
    colour: NDArray[Any],
    extensions: Sequence[str] = ("KHR_mesh_quantization",),
    **flags: Any,
) -> Path:
    """A triangle with attributes of any type, interleaved in rows of 4-byte steps, beside a texture of coordinates."""
    kinds = {"i1": 5120, "u1": 5121, "i2": 5122, "u2": 5123, "f4": 5126}
    arrays = [np.asarray(each) for each in (position, normal, colour)]
    rows = [b"".join(a[row].tobytes() + bytes(-len(a[row].tobytes()) % 4) for a in arrays) for row in range(3)]
    blob = b"".join(rows)
    starts = np.cumsum([0] + [-(-a[0].nbytes // 4) * 4 for a in arrays]).tolist()
    named = ("POSITION", "NORMAL", "COLOR_0")
    return gltf(
        folder,
        extensionsUsed=list(extensions),
        extensionsRequired=list(extensions),
        meshes=[{"primitives": [{"attributes": {name: at for at, name in enumerate(named)}}]}],
        accessors=[
            {"bufferView": 0, "byteOffset": start, "componentType": kinds[a.dtype.str[1:]], "count": 3,
             "type": f"VEC{a.shape[1]}", "normalized": flags.get(name, a.dtype.kind != "f")}
            for name, a, start in zip(named, arrays, starts, strict=False)
        ],
        bufferViews=[{"buffer": 0, "byteLength": len(blob), "byteStride": len(rows[0])}],
        buffers=[{"byteLength": len(blob), "uri": "data:;base64," + base64.b64encode(blob).decode()}],
    )  # fmt: skip


@pytest.mark.parametrize(
    ("position", "scale", "normalised"),
    [(np.int8, 1 / 127, True), (np.uint16, 1 / 65535, True), (np.uint8, 1, False), (np.int16, 1, False)],
)
@pytest.mark.parametrize("colour", [np.uint8, np.uint16, np.float32])
def test_quantised_and_interleaved_attributes_are_read(
    tmp_path: Path, position: type[integer], scale: float, normalised: bool, colour: type[number]
) -> None:
    corners = np.array([[0, 0, 0], [100, 0, 0], [0, 50, 0]], position)
    white = np.iinfo(colour).max if issubclass(colour, integer) else 1
    colours = (np.array([[1, 0.5, 0, 1]] * 3) * white).astype(colour)
    normals = np.array([[0, 0, 127]] * 3, np.int8)
    mesh = load_meshes(typed(tmp_path, corners, normals, colours, POSITION=normalised)).meshes[0]
    np.testing.assert_allclose(mesh.position, corners.astype(float) * scale, rtol=1e-6)
    np.testing.assert_allclose(mesh.normal, [[0, 0, 1]] * 3)
    np.testing.assert_allclose(present(mesh.vertex_colour), (colours / white)[:, :3], rtol=1e-6)
    with pytest.raises(BadInputError, match="POSITION is not of type VEC3 in floats"):
        load_meshes(typed(tmp_path, corners, normals, colours, extensions=()))


def test_data_of_a_uri_may_be_percent_encoded(tmp_path: Path) -> None:
    """RFC 2397: without ;base64 the data are text."""
    blob = base64.b64decode(json.loads(gltf(tmp_path).read_text())["buffers"][0]["uri"].partition(",")[2])
    text = "".join(f"%{byte:02x}" for byte in blob)
    image = "data:image/png," + "".join(f"%{byte:02X}" for byte in four_texels())
    buffers = [{"byteLength": 72, "uri": f"data:application/octet-stream,{text}"}]
    mesh = load_meshes(gltf(tmp_path, buffers=buffers, images=[{"uri": image}], **TEXTURED)).meshes[0]
    np.testing.assert_array_equal(mesh.texture, CORNERS)


def test_an_optional_extension_of_primitives_is_ignored(tmp_path: Path) -> None:
    draco = {"KHR_draco_mesh_compression": {"bufferView": 0, "attributes": {"POSITION": 0}}}
    assert len(load_meshes(gltf(tmp_path, meshes=wedge(extensions=draco))).meshes) == 1


def test_things_of_the_same_name_get_numbers(tmp_path: Path) -> None:
    nodes = [{"mesh": 0, "name": "pin"}] * 3 + [{"mesh": 1, "name": "pin_7"}, {"mesh": 0, "name": "pin_7"}, {"mesh": 1}]
    nodes += [{"mesh": 1, "name": ""}] * 2
    found = load_meshes(gltf(tmp_path, meshes=2 * wedge(), nodes=nodes, scenes=[{"nodes": list(range(8))}]))
    assert [mesh.name for mesh in found.meshes] == ["wedge", "wedge_1"]
    assert [each.name for each in found.instances] == [
        "pin",
        "pin_1",
        "pin_2",
        "pin_7",
        "pin_7_1",
        "5",
        "geometry",
        "geometry_1",
    ]
    assert [each.mesh for each in found.instances] == [0, 0, 0, 1, 0, 1, 1, 1]


def test_only_the_stated_scene_is_drawn(tmp_path: Path) -> None:
    nodes = [{"mesh": 0, "name": "here"}, {"mesh": 0, "name": "there"}]
    path = gltf(tmp_path, nodes=nodes, scene=1, scenes=[{"nodes": [0]}, {"nodes": [1]}])
    assert [each.name for each in load_meshes(path).instances] == ["there"]


def test_a_base_colour_keeps_its_digits(tmp_path: Path) -> None:
    colour = [0.123456, 0.5, 1.0]
    path = gltf(tmp_path, materials=[{"pbrMetallicRoughness": {"baseColorFactor": [*colour, 1]}}])
    np.testing.assert_array_equal(load_meshes(path).meshes[0].base_colour, np.array(colour, np.float32))


@pytest.mark.parametrize(
    ("diffuse", "specular", "expected"),
    [
        ([0.5, 0.2, 0.1], [0.04] * 3, [0.5, 0.2, 0.1]),  # a dielectric
        ([0, 0, 0], [0.9, 0.7, 0.3], [0.9, 0.7, 0.3]),  # a metal
    ],
)
def test_specular_glossiness_without_textures_has_the_equivalent_base_colour(
    tmp_path: Path, diffuse: list[float], specular: list[float], expected: list[float]
) -> None:
    glossy = {"KHR_materials_pbrSpecularGlossiness": {"diffuseFactor": [*diffuse, 1], "specularFactor": specular}}
    mesh = load_meshes(gltf(tmp_path, materials=[{"extensions": glossy}])).meshes[0]
    np.testing.assert_allclose(mesh.base_colour, expected, atol=2e-3)


def test_a_primitive_without_area_is_left_out(tmp_path: Path) -> None:
    meshes = [{"primitives": [{"attributes": {"POSITION": 0}, "indices": 1}, {"attributes": {"POSITION": 3}}]}]
    flat = {"componentType": 5126, "count": 3, "type": "VEC3"}
    found = load_meshes(gltf(tmp_path, meshes=meshes, accessors=[*accessors(), flat]))
    assert [len(mesh.triangles) for mesh in found.meshes] == [1]
    assert [instance.mesh for instance in found.instances] == [0]


def test_a_glb_may_have_chunks_of_other_kinds(tmp_path: Path) -> None:
    path = glb(tmp_path, 72)
    content = path.read_bytes() + struct.pack("<I4s", 8, b"XYZW") + bytes(8)
    path.write_bytes(content[:8] + struct.pack("<I", len(content)) + content[12:])
    assert len(load_meshes(path).meshes[0].triangles) == 1
