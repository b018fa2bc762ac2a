"""OBJ, MTL, PLY and STL: the forms that their documents declare legal, and pictures of all kinds as textures."""

import struct
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray
from PIL import Image
from present import present
from scene.test_mesh_file import png

from wlr_render.errors import BadInputError
from wlr_render.scene.mesh_file import load_meshes
from wlr_render.scene.scene import Mesh

TRIANGLE = "v 0 0 0\nv 1 0 0\nv 0 1 0\nvt 0 0\nvt 1 0\nvt 0 1\n"
FACE = "f 1/1 2/2 3/3\n"


def obj(
    folder: Path, text: str, mtl: str | None = None, texture: str = "tex.png", picture: NDArray[Any] | None = None
) -> Path:
    if mtl is not None:
        (folder / "a.mtl").write_text(mtl)
        Image.fromarray(np.full((2, 2, 3), 78, np.uint8) if picture is None else picture).save(folder / texture)
        text = f"mtllib a.mtl\nusemtl m\n{text}"
    path = folder / "model.obj"
    path.write_text(text)
    return path


def only(path: Path) -> Mesh:
    (mesh,) = load_meshes(path).meshes
    return mesh


def faces_of(mesh: Mesh) -> list[Any]:
    """Positions of the corners of each triangle, each from its least corner on, sorted."""
    corners = mesh.position[mesh.triangles].tolist()
    return sorted(tuple(map(tuple, each[(k := each.index(min(each))) :] + each[:k])) for each in corners)


def area(mesh: Mesh) -> float:
    corners = mesh.position[mesh.triangles].astype(np.float64)
    double = np.linalg.norm(np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]), axis=1)
    return float(double.sum() / 2)


def test_texture_coordinates_without_a_texture_are_no_fault(tmp_path: Path) -> None:
    mesh = only(obj(tmp_path, TRIANGLE + FACE))
    assert mesh.texture is None
    np.testing.assert_array_equal(mesh.base_colour, 1)


@pytest.mark.parametrize(
    "text",
    [
        "\tv 0 0 0\n v\t1  0 0 # second\r\nv 0 1 0 1.0\nf 1 2 3 # face",
        "v 0 0 0\nv 1 0 0\nv 0 1 0\n# C:\\models\\\nf 1 \\\n2 3\n",
        "v 0 0 0\nv 1 0 0\nv 0 1 0\nf 1 \\ \n2 \\\t\n3\n",
        "v +0e0 0 0\nv 1.0E+0 0 0\nv 0 100e-2 0\nvn 0 0 1\nf 1//1 2//1 3//1\n",
        "v 0 0 0\nv 1 0 0\nv 0 1 0\nf -3 -2 -1\nv 9 9 9\n",
        "v 0 0 0\rv 1 0 0\rv 0 1 0\rfo 1 2 3\r",
    ],
)
def test_the_ways_of_writing_a_triangle_are_one(tmp_path: Path, text: str) -> None:
    (tmp_path / "model.obj").write_bytes(text.encode())
    assert faces_of(only(tmp_path / "model.obj")) == [((0, 0, 0), (1, 0, 0), (0, 1, 0))]


def test_an_obj_in_utf_16_is_refused(tmp_path: Path) -> None:
    (tmp_path / "model.obj").write_bytes((TRIANGLE + FACE).encode("utf-16"))
    with pytest.raises(BadInputError, match=r"model.obj: has null characters; is it binary, or UTF-16"):
        load_meshes(tmp_path / "model.obj")


def test_corners_with_and_without_texture_coordinates_may_mix(tmp_path: Path) -> None:
    path = obj(tmp_path, TRIANGLE + "v 1 1 0\nvn 0 0 -1\n" + FACE + "f 2//1 4//1 3//1\n")
    mesh = only(path)
    assert len(mesh.triangles) == 2
    np.testing.assert_allclose(mesh.normal[mesh.triangles[1]], [[0, 0, -1]] * 3)


@pytest.mark.parametrize("turn", range(6))
def test_concave_polygons_keep_their_outline(tmp_path: Path, turn: int) -> None:
    outline = np.roll([[0, 0], [2, 0], [2, 1], [1, 1], [1, 2], [0, 2]], turn, axis=0)
    corners = "".join(f"v {x} 0 {-y}\n" for x, y in outline)
    mesh = only(obj(tmp_path, corners + "f 1 2 3 4 5 6\n"))
    assert area(mesh) == pytest.approx(3.0)
    first, second = (mesh.position[mesh.triangles[:, k]] - mesh.position[mesh.triangles[:, 0]] for k in (1, 2))
    normal = np.cross(first, second)
    assert (normal[:, 1] > 0).all()


def test_normals_of_a_corner_are_those_of_all_faces_around_it(tmp_path: Path) -> None:
    text = "v 0 0 0\nv 1 0 0\nv 0 1 0\nv 0 0 1\nvt 0 0\nvt 1 1\nf 1/1 2/1 3/1\nf 1/2 3/2 4/2\nf 1 4 2\n"
    mesh = only(obj(tmp_path, text))
    here = np.flatnonzero((mesh.position == 0).all(axis=1))
    np.testing.assert_allclose(mesh.normal[here], np.tile([3**-0.5] * 3, (len(here), 1)), atol=1e-6)


def test_what_is_no_triangle_is_named(tmp_path: Path) -> None:
    path = obj(tmp_path, TRIANGLE + FACE + "p 1\nl 1 2\ncurv 0 1 1 2\nscmod 3\nusemtl wood\nf 1 2 3\n")
    named = ("points", "lines", "free-form curves and surfaces", "lines 'scmod'", "material 'wood', of no mtllib")
    assert load_meshes(path).not_drawn == tuple(f"{each} in model.obj" for each in named)


@pytest.mark.parametrize(
    ("text", "colour"),
    [("0 0 0 1 0 0", [1, 0, 0]), ("0 0 0 255 0 0", [1, 0, 0]), ("0 0 0 0.5 0.5 0.5", [0.2158605] * 3)],
)
def test_vertex_colours_of_obj_are_srgb(tmp_path: Path, text: str, colour: Sequence[float]) -> None:
    mesh = only(obj(tmp_path, f"v {text}\nv 1 0 0 0 0 0\nv 0 1 0 0 0 0\nf 1 2 3\n"))
    np.testing.assert_allclose(present(mesh.vertex_colour)[np.argmin(mesh.position.sum(axis=1))], colour, atol=1e-6)


@pytest.mark.parametrize(
    ("lines", "colour"),
    [
        ("Kd 0.8", [0.8, 0.8, 0.8]),
        ("kd 0.1 0.2 0.3 # red", [0.1, 0.2, 0.3]),
        ("Kd 0.1 \\\n0.2 0.3", [0.1, 0.2, 0.3]),
        ("# C:\\models\\\nKd 0.1 \\ \n0.2 0.3", [0.1, 0.2, 0.3]),
        ("Kd 0.1 0.2 0.3\nmap_Kd\n", [0.1, 0.2, 0.3]),
        ("Kd 0.1 0.2 0.3\nmap_Kd -s 1 1 1\nmap_Kd -clamp\nmap_Kd # none\n", [0.1, 0.2, 0.3]),
        ("", [1, 1, 1]),
    ],
)
def test_diffuse_colours_of_mtl(tmp_path: Path, lines: str, colour: Sequence[float]) -> None:
    path = obj(tmp_path, TRIANGLE + FACE, mtl=f"# library\nnewmtl m\n{lines}\n")
    np.testing.assert_allclose(only(path).base_colour, colour, rtol=1e-6)


@pytest.mark.parametrize(
    ("line", "texture", "lost"),
    [
        ("map_Kd -s 1 1 1 tex.png", "tex.png", ""),
        ("map_Kd -o 0 0 -s 1 -mm 0 1 -clamp off -blendu on -texres 512 tex.png", "tex.png", ""),
        ("map_kd -s 2 2 -clamp on tex.png", "tex.png", "map_Kd -s, map_Kd -clamp"),
        ("map_Kd -o 0.5 0 0 -t 0.1 -mm 0.1 2 -bm 2 tex.png", "tex.png", "map_Kd -o, map_Kd -t, map_Kd -mm"),
        ("map_Kd .\\maps\\tex.png", "maps/tex.png", ""),
        ('map_Kd "my tex.png"', "my tex.png", ""),
        ("map_Kd my #1 tex.png", "my #1 tex.png", ""),
        ("map_Kd tex.png # albedo", "tex.png", ""),
        ("Kd spectral ident.rfl 1\nmap_Kd tex.png", "tex.png", "Kd spectral"),
        ("Kd xyz 0.3 0.3 0.3\nmap_Kd tex.png\nmap_d tex.png", "tex.png", "Kd xyz, map_d"),
    ],
)
def test_textures_of_mtl(tmp_path: Path, line: str, texture: str, lost: str) -> None:
    (tmp_path / "maps").mkdir()
    path = obj(tmp_path, TRIANGLE + FACE, mtl=f"newmtl m\n{line}\n", texture=texture)
    found = load_meshes(path)
    assert (present(found.meshes[0].texture) == 78).all()
    assert found.not_drawn == ((f"{lost} of 'm' in model.obj",) if lost else ())


def test_colours_of_mtl_outside_0_to_1_are_clipped_and_named(tmp_path: Path) -> None:
    found = load_meshes(obj(tmp_path, TRIANGLE + FACE, mtl="newmtl m\nKd 1.5 -1 1\n"))
    np.testing.assert_array_equal(found.meshes[0].base_colour, [1, 0, 1])
    assert found.not_drawn == ("Kd outside 0 to 1 of 'm' in model.obj",)


def test_faces_without_texture_coordinates_are_a_mesh_without_texture(tmp_path: Path) -> None:
    mtl = "newmtl m\nKd 0.5 1 1\nmap_Kd tex.png\n"
    found = load_meshes(obj(tmp_path, TRIANGLE + "v 1 1 0\n" + FACE + "f 2 4 3\n", mtl=mtl))
    with_texture, without = found.meshes
    assert faces_of(with_texture) == [((0, 0, 0), (1, 0, 0), (0, 1, 0))]
    assert (present(with_texture.texture) == 78).all()
    assert faces_of(without) == [((0, 1, 0), (1, 0, 0), (1, 1, 0))]
    assert without.texture is None
    np.testing.assert_array_equal(without.base_colour, [0.5, 1, 1])
    assert found.not_drawn == ("the texture of 'm' on faces without texture coordinates in model.obj",)


def test_a_material_whose_faces_have_no_area_is_left_out(tmp_path: Path) -> None:
    mesh = only(obj(tmp_path, TRIANGLE + "f 1 1 2\nusemtl other\n" + FACE))
    assert faces_of(mesh) == [((0, 0, 0), (1, 0, 0), (0, 1, 0))]


def test_a_concave_polygon_of_too_many_corners_is_refused_with_the_file(tmp_path: Path) -> None:
    corners = "".join(f"v {x} {x * x} 0\n" for x in range(1000)) + "v 500 260000 0\n"
    path = obj(tmp_path, corners + f"f {' '.join(map(str, range(1, 1002)))}\n")
    with pytest.raises(
        BadInputError, match=r"model.obj: cannot be .*1001 corners, more than 1000\); triangulate it .*\.$"
    ):
        load_meshes(path)


@pytest.mark.parametrize("lines", ["mtllib red.mtl green.mtl", "mtllib red.mtl\nmtllib green.mtl", "mtllib two of.mtl"])
def test_several_material_libraries(tmp_path: Path, lines: str) -> None:
    (tmp_path / "red.mtl").write_text("newmtl r\nKd 1 0 0\nnewmtl both\nKd 1 0 0\n")
    (tmp_path / "green.mtl").write_text("newmtl g\nKd 0 1 0\nnewmtl both\nKd 0 1 0\n")
    (tmp_path / "two of.mtl").write_text("newmtl g\nKd 0 1 0\nnewmtl both\nKd 1 0 0\n")
    text = f"usemtl g\n{lines}\n{TRIANGLE}f 1 2 3\nusemtl both\nf 1 2 3\n"
    green, both = load_meshes(obj(tmp_path, text)).meshes
    np.testing.assert_array_equal(green.base_colour, [0, 1, 0])
    np.testing.assert_array_equal(both.base_colour, [1, 0, 0])


def picture(mode: str, code: int = 78) -> Image.Image:
    """A picture of 4 x 4 pixels of one code, or of one as near as the mode has."""
    if mode == "P":
        image = Image.new("P", (4, 4), 1)
        image.putpalette([0, 0, 0, code, code, code])
        return image
    if mode == "I;16":
        return Image.fromarray(np.full((4, 4), 257 * code, np.uint16))
    fill = {"1": 1, "L": code, "LA": (code, 9), "RGB": (code,) * 3, "RGBA": (code, code, code, 9)}
    return Image.new(mode, (4, 4), (0, 0, 0, 255 - code) if mode == "CMYK" else fill[mode])


@pytest.mark.parametrize(
    ("mode", "suffix", "options", "code"),
    [
        ("1", "png", {}, 255),
        ("L", "png", {"bits": 8}, 78),
        ("LA", "png", {}, 78),
        ("P", "png", {"bits": 2}, 78),
        ("P", "png", {"transparency": 0}, 78),
        ("I;16", "png", {}, 78),
        ("I;16", "tif", {}, 78),
        ("RGB", "png", {}, 78),
        ("RGBA", "png", {}, 78),
        ("RGB", "jpg", {"progressive": True}, 78),
        ("L", "jpg", {}, 78),
        ("CMYK", "jpg", {}, 78),
        ("RGB", "bmp", {}, 78),
        ("RGB", "tga", {"compression": "tga_rle"}, 78),
        ("L", "tga", {}, 78),
        ("RGBA", "tif", {"compression": "tiff_lzw"}, 78),
        ("P", "gif", {}, 78),
        ("RGB", "webp", {"lossless": True}, 78),
        ("I;16", "pgm", {}, 78),
    ],
)
def test_pictures_of_every_mode_are_textures(
    tmp_path: Path, mode: str, suffix: str, options: Mapping[str, Any], code: int
) -> None:
    path = obj(tmp_path, TRIANGLE + FACE, mtl=f"newmtl m\nmap_Kd tex.{suffix}\n")
    picture(mode).save(tmp_path / f"tex.{suffix}", **options)
    assert np.unique(present(only(path).texture)).tolist() == [code]


def test_grey_pictures_of_two_bits_and_sixteen_bits_per_colour(tmp_path: Path) -> None:
    path = obj(tmp_path, TRIANGLE + FACE, mtl="newmtl m\nmap_Kd tex.png\n")
    for (depth, kind, row), code in (
        ((2, 0, b"\x40"), 85),
        ((4, 0, b"\x50"), 85),
        ((16, 2, struct.pack(">3H", *[20000] * 3)), 78),
        ((16, 4, struct.pack(">2H", 20000, 5)), 78),
    ):
        (tmp_path / "tex.png").write_bytes(png([row], (1, 1), depth, kind, gamma=True))
        assert present(only(path).texture).tolist() == [[[code] * 3]]


@pytest.mark.parametrize(("mode", "code"), [("F", 0.5), ("I", 70000)])
def test_pictures_without_a_stated_white_are_refused(tmp_path: Path, mode: str, code: float) -> None:
    path = obj(tmp_path, TRIANGLE + FACE, mtl="newmtl m\nmap_Kd tex.tif\n")
    Image.new(mode, (4, 4), code).save(tmp_path / "tex.tif")
    with pytest.raises(BadInputError, match=r"mesh 'model.obj' is a picture of floats or 32-bit integers; store it"):
        load_meshes(path)


def test_orientation_is_ignored(tmp_path: Path) -> None:
    exif = Image.Exif()
    exif[0x0112] = 6
    path = obj(tmp_path, TRIANGLE + FACE, mtl="newmtl m\nmap_Kd tex.jpg\n")
    Image.new("RGB", (4, 2)).save(tmp_path / "tex.jpg", exif=exif)
    assert present(only(path).texture).shape == (2, 4, 3)


QUAD = [[-1, -1, 0], [1, -1, 0], [1, 1, 0], [-1, 1, 0], [0, 2, 0]]
FACES = [[0, 1, 2, 3], [3, 2, 4]]


def ply(
    folder: Path,
    form: str = "ascii",
    length: str = "uchar",
    index: str = "int",
    extra: Sequence[tuple[str, str]] = (),
    vertices: Sequence[Any] | None = None,
    comments: str = "",
    faces: Sequence[Any] = FACES,
    **face: Any,
) -> Path:
    """A house of a quad and a triangle; `extra` are (type, name) of vertex properties after x, y and z."""
    vertices = QUAD if vertices is None else vertices
    properties = [("float", axis) for axis in "xyz"] + list(extra)
    header = f"ply\nformat {form} 1.0\n{comments}element vertex {len(vertices)}\n"
    header += "".join(f"property {kind} {name}\n" for kind, name in properties)
    header += f"element face {len(faces)}\nproperty list {length} {index} vertex_indices\n"
    header += "".join(f"property {name.replace('__', ' ')}\n" for name in face)
    content = (header + "end_header\n").encode()
    order = ">" if "big" in form else "<"
    codes = {
        "uchar": "B",
        "int": "i",
        "uint": "I",
        "ushort": "H",
        "short": "h",
        "float": "f",
        "double": "d",
        "char": "b",
    }
    if form == "ascii":
        rows = [" ".join(map(str, row)) for row in vertices]
        rows += [
            " ".join(map(str, [len(f), *f, *(v for each in face.values() for v in each[n])]))
            for n, f in enumerate(faces)
        ]
        content += "\n".join(rows).encode() + b"\n"
    else:
        kinds = order + "".join(codes[kind] for kind, _ in properties)
        content += b"".join(struct.pack(kinds, *row) for row in vertices)
        content += b"".join(struct.pack(f"{order}{codes[length]}{len(f)}{codes[index]}", len(f), *f) for f in faces)
    path = folder / "house.ply"
    path.write_bytes(content)
    return path


@pytest.mark.parametrize("form", ["ascii", "binary_little_endian", "binary_big_endian"])
@pytest.mark.parametrize(
    ("length", "index"), [("uchar", "int"), ("int", "uint"), ("ushort", "ushort"), ("char", "short")]
)
def test_polygons_of_different_sizes_are_read_from_every_form_of_ply(
    tmp_path: Path, form: str, length: str, index: str
) -> None:
    mesh = only(ply(tmp_path, form, length, index))
    assert len(mesh.triangles) == 3
    assert area(mesh) == pytest.approx(5.0)
    np.testing.assert_allclose(mesh.normal, np.tile([0, 0, 1], (len(mesh.normal), 1)), atol=1e-7)


@pytest.mark.parametrize("names", [("s", "t"), ("u", "v"), ("texture_u", "texture_v")])
def test_texture_coordinates_of_ply(tmp_path: Path, names: tuple[str, str]) -> None:
    vertices = [[*row, (row[0] + 1) / 2, (row[1] + 1) / 2] for row in QUAD]
    extra = [("float", name) for name in names]
    assert only(ply(tmp_path, extra=extra, vertices=vertices)).texture is None
    Image.fromarray(np.array([[[9, 9, 9]], [[78, 78, 78]]], np.uint8)).save(tmp_path / "my tex.png")
    mesh = only(ply(tmp_path, extra=extra, vertices=vertices, comments="comment TextureFile my tex.png\n"))
    assert present(mesh.texture)[:, 0, 0].tolist() == [9, 78]
    corner = int(np.argmin(mesh.position.sum(axis=1)))
    np.testing.assert_allclose(present(mesh.uv)[corner], [0, 1])


def test_faces_of_ply_may_have_texture_coordinates_and_colours_of_their_own(tmp_path: Path) -> None:
    Image.new("RGB", (2, 2), (78, 78, 78)).save(tmp_path / "t.png")
    own: dict[str, Any] = {"list__uchar__float__texcoord": [[8, *range(8)], [6, *range(6)]]}
    mesh = only(ply(tmp_path, comments="comment TextureFile t.png\n", **own))
    np.testing.assert_array_equal(present(mesh.uv)[:4], [[0, 0], [2, -2], [4, -4], [6, -6]])
    colours: dict[str, Any] = {
        f"uchar__{name}": [[255], [value]] for name, value in zip(("red", "green", "blue"), (0, 0, 255), strict=True)
    }
    mesh = only(ply(tmp_path, **colours))
    np.testing.assert_array_equal(present(mesh.vertex_colour)[4:], np.tile([0, 0, 1], (3, 1)))


@pytest.mark.parametrize(
    ("kind", "white"), [("uchar", 255), ("ushort", 65535), ("int", 255), ("uint", 255), ("float", 1.0)]
)
def test_vertex_colours_of_ply_of_every_type(tmp_path: Path, kind: str, white: float) -> None:
    extra = [(kind, name) for name in ("red", "green", "blue")]
    mesh = only(ply(tmp_path, extra=extra, vertices=[[*row, white, 0, 0] for row in QUAD]))
    np.testing.assert_array_equal(mesh.vertex_colour, np.tile([1, 0, 0], (len(present(mesh.vertex_colour)), 1)))


@pytest.mark.parametrize(("alpha", "named"), [(255, ()), (128, ("opacity (alpha) of 'vertex' in house.ply",))])
def test_opacity_of_ply_is_named(tmp_path: Path, alpha: int, named: tuple[str]) -> None:
    extra = [("uchar", name) for name in ("red", "green", "blue", "alpha")]
    path = ply(tmp_path, extra=extra, vertices=[[*row, 9, 9, 9, alpha] for row in QUAD])
    assert load_meshes(path).not_drawn == named


def test_each_texture_of_ply_is_a_mesh_of_its_own(tmp_path: Path) -> None:
    for name, code in (("a.png", 10), ("b.png", 78)):
        Image.new("RGB", (2, 2), (code,) * 3).save(tmp_path / name)
    vertices = [[*row, 0, 0] for row in QUAD]
    arguments: dict[str, Any] = {
        "extra": [("float", "s"), ("float", "t")],
        "vertices": vertices,
        "comments": "comment TextureFile a.png\ncomment TextureFile b.png\n",
    }
    meshes = load_meshes(ply(tmp_path, **arguments, int__texnumber=[[1], [0]])).meshes
    assert {len(mesh.triangles): int(present(mesh.texture)[0, 0, 0]) for mesh in meshes} == {2: 78, 1: 10}
    with pytest.raises(BadInputError, match=r"house.ply: has 2 textures and faces without 'texnumber'"):
        load_meshes(ply(tmp_path, **arguments))


def test_a_colour_of_ply_above_white_is_refused(tmp_path: Path) -> None:
    extra = [("int", name) for name in ("red", "green", "blue")]
    with pytest.raises(BadInputError, match=r"house.ply: a colour of 'vertex' is not from 0 to 255; correct it\."):
        load_meshes(ply(tmp_path, extra=extra, vertices=[[*row, 256, 0, 0] for row in QUAD]))


@pytest.mark.parametrize("end", [b"\r", b"\r\n"])
@pytest.mark.parametrize("form", ["ascii", "binary_little_endian"])
def test_lines_of_ply_may_end_in_carriage_returns(tmp_path: Path, form: str, end: bytes) -> None:
    Image.new("RGB", (2, 2), (78, 78, 78)).save(tmp_path / "t.png")
    extra = [("float", "s"), ("float", "t")]
    # The first byte of the body is a line feed.
    vertices = [[np.float32(-1.0000012), *row[1:], 0, 0] if at == 0 else [*row, 0, 0] for at, row in enumerate(QUAD)]
    path = ply(tmp_path, form, extra=extra, vertices=vertices, comments="comment TextureFile t.png\n")
    header, mark, body = path.read_bytes().partition(b"end_header\n")
    assert form == "ascii" or body[:1] == b"\n"
    body = body.replace(b"\n", end) if form == "ascii" else body
    path.write_bytes((header + mark).replace(b"\n", end) + body)
    mesh = only(path)
    assert len(mesh.triangles) == 3
    assert (present(mesh.texture) == 78).all()


@pytest.mark.parametrize("faces", [b"", b"element face 0\nproperty list uchar int vertex_indices\n"])
def test_triangle_strips_of_ply_are_read(tmp_path: Path, faces: bytes) -> None:
    path = ply(tmp_path, faces=[])
    strips = faces + b"element tristrips 1\nproperty list int int vertex_indices\n"
    content = path.read_bytes().replace(b"element face 0\nproperty list uchar int vertex_indices\n", strips)
    path.write_bytes(content + b"8 0 1 3 2 -1 3 2 4\n")
    mesh = only(path)
    assert area(mesh) == pytest.approx(5.0)
    np.testing.assert_allclose(mesh.normal[mesh.triangles.ravel()], np.tile([0, 0, 1], (9, 1)), atol=1e-7)


def test_a_ply_without_faces_names_what_it_has(tmp_path: Path) -> None:
    path = ply(tmp_path, faces=[])
    edges = b"element edge 1\nproperty int vertex1\nproperty int vertex2\nend_header"
    path.write_bytes(path.read_bytes().replace(b"end_header", edges) + b"0 1\n")
    with pytest.raises(BadInputError, match=r"house.ply: holds no triangles \(not drawn: edges\); export it again"):
        load_meshes(path)


SOLID = """solid {name}
  facet normal 0 0 1
    outer loop
      vertex 0 0 {z}
      vertex 1 0 {z}
      vertex 0 1 {z}
    endloop
  endfacet
endsolid {name}
"""


def stl(folder: Path, content: bytes) -> Path:
    path = folder / "part.stl"
    path.write_bytes(content)
    return path


def binary_stl(triangles: Sequence[Any], promised: int | None = None) -> bytes:
    rows = b"".join(np.array([0, 0, 1, *np.ravel(corners)], np.float32).tobytes() + bytes(2) for corners in triangles)
    return b"solid, in binary".ljust(80) + struct.pack("<I", len(triangles) if promised is None else promised) + rows


def test_each_solid_of_an_ascii_stl_is_a_mesh(tmp_path: Path) -> None:
    text = SOLID.format(name="low", z=0) + SOLID.format(name="High", z=2.5e-1)
    low, high = load_meshes(stl(tmp_path, text.encode())).meshes
    assert (low.name, high.name) == ("low", "High")
    assert faces_of(high) == [((0, 0, 0.25), (1, 0, 0.25), (0, 1, 0.25))]
    np.testing.assert_allclose(high.normal, [[0, 0, 1]] * 3)


@pytest.mark.parametrize("ends", ["\r", " ", "\n" + 5000 * "\n"])
def test_white_space_of_any_kind_separates_the_words_of_an_ascii_stl(tmp_path: Path, ends: str) -> None:
    text = ends.join(SOLID.format(name="Geh\xe4use", z="0.5").splitlines())
    mesh = only(stl(tmp_path, text.encode("latin-1")))
    assert len(mesh.triangles) == 1


def test_bytes_behind_the_facets_of_a_binary_stl_are_left_out(tmp_path: Path) -> None:
    facets = binary_stl([[[0, 0, 0], [2, 0, 0], [0, 1, 0]]])
    assert len(only(stl(tmp_path, facets + b"\0")).triangles) == 1


def test_a_binary_stl_may_begin_as_an_ascii_one(tmp_path: Path) -> None:
    mesh = only(stl(tmp_path, binary_stl([[[0, 0, 0], [2, 0, 0], [0, 1, 0]], [[0, 0, 0], [0, 1, 0], [0, 0, 1]]])))
    assert mesh.name == "part.stl"
    assert area(mesh) == pytest.approx(1.5)
    np.testing.assert_allclose(mesh.normal[mesh.triangles], [[[0, 0, 1]] * 3, [[1, 0, 0]] * 3])


@pytest.mark.parametrize(
    ("content", "complaint"),
    [
        (binary_stl([np.eye(3)], promised=2), "neither an ASCII STL nor a binary one of the stated length"),
        (binary_stl([np.eye(3)])[:-1], "neither an ASCII STL nor a binary one of the stated length"),
        (binary_stl([np.nan * np.eye(3)]), "a vertex that is not finite"),
        (binary_stl([]), "holds no triangles"),
        (SOLID.format(name="a", z=0).encode() + SOLID.format(name="b", z=1).encode()[:-12], "has 2 facets, of which 1"),
        (SOLID.format(name="a", z="x").encode(), "part.stl"),
        (SOLID.format(name="a", z="").encode(), "part.stl"),
    ],
)
def test_a_damaged_stl_is_refused(tmp_path: Path, content: bytes, complaint: str) -> None:
    path = stl(tmp_path, content)
    with pytest.raises(BadInputError, match=r"part\.stl") as caught:
        load_meshes(path)
    assert complaint in str(caught.value)
