"""Meshes, textures and photographs that promise more than they hold, or hold what nobody can draw."""

import io
import json
import struct
import zlib
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import numpy as np

from corpus.case import Case, Change, Expected, edited, replaced, several, written
from corpus.cases.hostile_files import DECODE, PAIRS, PAIRS_FILES
from corpus.damage import HUGE

END = ("--backend", "cpu", "--out", "out")


def png(width: int, height: int, depth: int = 8, colour: int = 0, rows: int = 0) -> bytes:
    """A PNG of any size whose first rows are there, as zeros; colour 0 is grey, 2 is RGB."""

    def chunk(name: bytes, content: bytes) -> bytes:
        return struct.pack(">I", len(content)) + name + content + struct.pack(">I", zlib.crc32(name + content))

    pixels = zlib_of_zeros(rows * (1 + width * depth // 8 * (3 if colour == 2 else 1)))
    header = struct.pack(">IIBBBBB", width, height, depth, colour, 0, 0, 0)
    return b"\x89PNG\r\n\x1a\n" + chunk(b"IHDR", header) + chunk(b"IDAT", pixels) + chunk(b"IEND", b"")


def zlib_of_zeros(count: int) -> bytes:
    """A zlib stream of many zeros, made of copies of a compressed mebibyte."""

    def packed(length: int, ends: int) -> bytes:
        packer = zlib.compressobj(9, wbits=-zlib.MAX_WBITS)
        return packer.compress(bytes(length)) + packer.flush(ends)

    whole, rest = divmod(count, 1 << 20)
    checksum = struct.pack(">HH", count % 65521, 1)  # Adler-32 of zeros
    return b"\x78\xda" + whole * packed(1 << 20, zlib.Z_FULL_FLUSH) + packed(rest, zlib.Z_FINISH) + checksum


def npy(array: Any, pickled: bool = False) -> bytes:
    content = io.BytesIO()
    np.save(content, array, allow_pickle=pickled)
    return content.getvalue()


def _npy_promise(shape: str) -> bytes:
    text = f"{{'descr': '|u1', 'fortran_order': False, 'shape': {shape}, }}".encode()
    text += b" " * ((64 - (len(text) + 11) % 64) % 64) + b"\n"
    return b"\x93NUMPY\x01\x00" + struct.pack("<H", len(text)) + text + bytes(100)


def _tiff_promise() -> bytes:
    """A TIFF of 100000 x 100000 pixels whose strip lies beyond the end."""
    tags = [
        (256, 100_000),
        (257, 100_000),
        (258, 8),
        (259, 1),
        (262, 1),
        (273, 500),
        (277, 1),
        (278, 100_000),
        (279, 9),
    ]
    entries = b"".join(struct.pack("<HHII", tag, 4, 1, value) for tag, value in tags)
    return b"II*\x00" + struct.pack("<IH", 8, len(tags)) + entries + struct.pack("<I", 0)


# By name: ending, content. None of them is a photograph that fits the others.
PICTURES: dict[str, tuple[str, bytes]] = {
    "a PNG of 60000 x 60000": (".png", png(60_000, 60_000, rows=2)),
    "a PNG bomb of 30000 x 30000": (".png", png(30_000, 30_000, rows=30_000)),
    "a PNG of 2147483647 x 1": (".png", png(2**31 - 1, 1)),
    "a PNG of no pixels": (".png", png(0, 0)),
    "a PNG without its rows": (".png", png(64, 48, rows=5)),
    "a PNG that is text": (".png", b"this is a picture, believe me\n" * 20),
    "a PNG of 16 bits": (".png", png(64, 48, depth=16, rows=48)),
    "a PNG of another size": (".png", png(12, 7, rows=7)),
    "a PNG in colour": (".png", png(64, 48, colour=2, rows=48)),
    "a TIFF that promises": (".tiff", _tiff_promise()),
    "a TIFF cut": (".tiff", _tiff_promise()[:40]),
    "an array that promises": (".npy", _npy_promise("(1000000, 1000000)")),
    "an array of objects": (".npy", npy(np.array([{"a": 1}], dtype=object), pickled=True)),
    "an array of nan": (".npy", npy(np.full((48, 64), np.nan))),
    "an array of 1e308": (".npy", npy(np.full((48, 64), 1e308))),
    "an array of text": (".npy", npy(np.array([["a"] * 64] * 48))),
    "an array of complex numbers": (".npy", npy(np.ones((48, 64), complex))),
    "an array of five axes": (".npy", npy(np.zeros((2, 2, 2, 2, 2), np.uint8))),
    "an array of no pixels": (".npy", npy(np.zeros((0, 64), np.uint8))),
    "an array below zero": (".npy", npy(np.full((48, 64), -7, np.int16))),
    "an array of a negative shape": (".npy", _npy_promise("(-1, 5)")),
    "a JPEG of a few bytes": (".jpg", b"\xff\xd8\xff\xe0" + bytes(20)),
    "a PGM of 1e9 pixels": (".pgm", b"P5 100000 100000 255\n" + bytes(100)),
    "a bitmap of a negative size": (
        ".bmp",
        b"BM" + struct.pack("<IIIIiiHHIIiiII", 54, 0, 54, 40, -5, 7, 1, 24, 0, 0, 0, 0, 0, 0),
    ),
    "a raw file of zeros": (".dng", bytes(5000)),
}


def _picture_cases() -> Iterator[Case]:
    for title, (ending, content) in PICTURES.items():
        name = f"03{ending}"
        swap = several([lambda folder: (folder / "codes" / "03.png").unlink(), written(f"codes/{name}", content)])
        mild = title in ("a PNG of 16 bits", "a PNG in colour", "an array below zero")
        yield Case(
            f"photograph of code: {title}",
            DECODE,
            ("codes",),
            swap,
            () if mild else (name,),
            "any" if mild else "refused",
        )
        if ending == ".png":
            picture = written("pairs/a_on.png", content)
            names = () if mild else ("a_on.png|a_off",)
            yield Case(
                f"photograph of pairs: {title}", PAIRS, PAIRS_FILES, picture, names, "any" if mild else "refused"
            )
            texture = written("textured/material_0.png", content)
            fine = title in ("a PNG of another size", "a PNG of 16 bits", "a PNG in colour")
            arguments = ("render", "device.toml", "textured/box.obj", *END)
            yield Case(
                f"mesh texture: {title}",
                arguments,
                ("device.toml", "textured"),
                texture,
                () if fine else ("box.obj|material",),
                "any" if fine else "refused",
            )


def gltf(change: Callable[[Any], object]) -> Change:
    """Change the JSON of the glTF file."""

    def edit(content: bytes) -> bytes:
        text = json.loads(content)
        change(text)
        return json.dumps(text).encode()

    return edited("gltf/box.gltf", edit)


def _node(**keys: Any) -> Change:
    return gltf(lambda text: text["nodes"][-1].update(keys))


def _matrix(value: float) -> list[float]:
    return [value, 0, 0, 0, 0, 1, 0, 0, 0, 0, 1, 0, 0, 0, 0, 1]


def _accessor(**keys: Any) -> Change:
    return gltf(lambda text: text["accessors"][0].update(keys))


def _texture(uri: str) -> Change:
    def change(text: Any) -> None:
        text["images"], text["textures"] = [{"uri": uri}], [{"source": 0}]
        text["materials"] = [{"pbrMetallicRoughness": {"baseColorTexture": {"index": 0}}}]
        for mesh in text["meshes"]:
            mesh["primitives"][0]["material"] = 0
            mesh["primitives"][0]["attributes"]["TEXCOORD_0"] = mesh["primitives"][0]["attributes"]["POSITION"]

    return gltf(change)


def _light(**light: Any) -> Change:
    def change(text: Any) -> None:
        text["extensionsUsed"] = ["KHR_lights_punctual"]
        text["extensions"] = {"KHR_lights_punctual": {"lights": [{"type": "point", **light}]}}
        text["nodes"][-1]["extensions"] = {"KHR_lights_punctual": {"light": 0}}

    return gltf(change)


GLTF: dict[str, Change] = {
    "a matrix of nan": _node(matrix=_matrix(np.nan)),
    "a matrix of 1e39": _node(matrix=_matrix(1e39)),
    "a matrix of zeros": _node(matrix=[0] * 16),
    "a matrix of 3 numbers": _node(matrix=[1, 2, 3]),
    "a matrix of text": _node(matrix="identity"),
    "a matrix of huge integers": _node(matrix=_matrix(HUGE)),
    "a scale of inf": _node(scale=[np.inf, 1, 1]),
    "a translation of 1e300": _node(translation=[1e300, 0, 0]),
    "a translation of 1e39": _node(translation=[1e39, 0, 0]),
    "a buffer in the folder above": gltf(lambda text: text["buffers"][0].update(uri="../outside.bin")),
    "a buffer by an absolute path": gltf(lambda text: text["buffers"][0].update(uri="/etc/passwd")),
    "a buffer that is endless": gltf(lambda text: text["buffers"][0].update(uri="/dev/zero")),
    "a buffer by http": gltf(lambda text: text["buffers"][0].update(uri="http://127.0.0.1:9/x.bin")),
    "a buffer of broken base64": gltf(lambda text: text["buffers"][0].update(uri="data:application/octet-stream;base64,####")),
    "a buffer by a number": gltf(lambda text: text["buffers"][0].update(uri=5)),
    "no buffers": gltf(lambda text: text.pop("buffers")),
    "a buffer view of -5": gltf(lambda text: text["bufferViews"][0].update(byteOffset=-5)),
    "-5 vertices": _accessor(count=-5),
    "a material that is not there": gltf(lambda text: text["meshes"][0]["primitives"][0].update(material=77)),
    "an accessor that is not there": gltf(lambda text: text["meshes"][0]["primitives"][0]["attributes"].update(POSITION=77)),
    "meshes that are a number": gltf(lambda text: text.update(meshes=5)),
    "a texture that is no picture": _texture("gltf_buffer_0.bin"),
    "a texture of broken base64": _texture("data:image/png;base64,AAAA"),
    "a texture of another format": _texture("picture.exr"),
    "a negative light": _light(intensity=-5),
    "a light of nan": _light(intensity=np.nan),
    "a light of 1e308": _light(intensity=1e308),
    "a light of a negative colour": _light(color=[-1, 0, 0]),
    "a light of four colours": _light(color=[1, 1, 1, 1]),
    "a light of no kind": _light(type="magic"),
}  # fmt: skip

GLB: dict[str, Change] = {
    "a length of 4 GB": edited("textured.glb", lambda content: content[:8] + b"\xff" * 4 + content[12:]),
    "a chunk of 4 GB": edited("textured.glb", lambda content: content[:12] + b"\xff" * 4 + content[16:]),
    "version 1": edited("textured.glb", lambda content: content[:4] + b"\x01\0\0\0" + content[8:]),
    "a header alone": edited("textured.glb", lambda content: content[:12]),
    "no binary chunk": edited("textured.glb", lambda content: content[: 20 + int.from_bytes(content[12:16], "little")]),
    "a broken texture": edited(
        "textured.glb", lambda content: content.replace(b"IDAT", b"IDAX").replace(b"IHDR", b"IHDX")
    ),
}

PLY: dict[str, Change] = {
    "1e9 vertices": edited("box.ply", lambda content: content.replace(b"vertex 8", b"vertex 1000000000")),
    "fewer faces than there are": edited("box.ply", lambda content: content.replace(b"face 12", b"face 7")),
    "1e9 faces": edited("box.ply", lambda content: content.replace(b"face 12", b"face 1000000000")),
    "a vertex of 1e39": edited("box.ply", lambda content: content.replace(b"-0.1", b"1e39", 1)),
    "a vertex of 1e300": edited("box.ply", lambda content: content.replace(b"-0.1", b"1e300", 1)),
    "an unknown type": edited("box.ply", lambda content: content.replace(b"float", b"magic", 1)),
}
BINARY_PLY: dict[str, Change] = {
    "1e9 vertices": edited("binary.ply", lambda content: content.replace(b"vertex 8", b"vertex 1000000000")),
    "1e9 faces": edited("binary.ply", lambda content: content.replace(b"face 12", b"face 1000000000")),
    "the last face cut": edited("binary.ply", lambda content: content[:-7]),
    "a face of vertex 2147483647": edited("binary.ply", lambda content: content[:-4] + b"\xff\xff\xff\x7f"),
}
OBJ: dict[str, Change] = {
    "a vertex of nan": replaced("box.obj", "v 0.1", "v nan"),
    "a vertex of 1e39": replaced("box.obj", "v 0.1", "v 1e39"),
    "a vertex of 1e308": replaced("box.obj", "v 0.1", "v 1e308"),
    "a vertex of text": replaced("box.obj", "v 0.1", "v abc"),
    "a face of vertex -99": edited("box.obj", lambda content: content + b"f -99 1 2\n"),
    "a face of text": edited("box.obj", lambda content: content + b"f a b c\n"),
    "only flat faces": edited("box.obj", lambda content: b"v 0 0 0\nv 1 0 0\nv 2 0 0\nf 1 2 3\n"),
    "a material above": edited("box.obj", lambda content: b"mtllib ../../etc/passwd\nusemtl a\n" + content),
    "in millimetres": edited("box.obj", lambda content: content.replace(b"0.1", b"100.0")),
}  # fmt: skip


def cases() -> Iterator[Case]:
    yield from _picture_cases()
    for title, change in GLTF.items():
        yield _mesh("gltf", "gltf/box.gltf", title, change)
    for title, change in GLB.items():
        yield _mesh("glb", "textured.glb", title, change)
    for title, change in PLY.items():
        yield _mesh("ply", "box.ply", title, change)
    for title, change in BINARY_PLY.items():
        yield _mesh("binary ply", "binary.ply", title, change)
    for title, change in OBJ.items():
        yield _mesh("obj", "box.obj", title, change)
    outside = several([written("outside.obj", "v 0 0 -1\nv 1 0 -1\nv 0 1 -1\nf 1 2 3\n"), _in_subfolder])
    arguments = ("render", "device.toml", "inner/scene.toml", *END)
    yield Case(
        "scene: a mesh in the folder above",
        arguments,
        ("device.toml", "scene.toml"),
        outside,
        ("scene.toml", "outside.obj"),
    )


_FINE = {"a length of 4 GB", "fewer faces than there are"}
_WARNED = {"in millimetres", "a matrix of zeros"}


def _mesh(kind: str, file: str, title: str, change: Change) -> Case:
    arguments = ("render", "device.toml", file, *END)
    name = Path(file).name
    expected: Expected = "any" if title in _FINE else "warned" if title in _WARNED else "refused"
    names = () if expected == "any" else (f"{name}|nothing",) if expected == "warned" else (name,)
    return Case(f"mesh {kind}: {title}", arguments, ("device.toml", file.split("/")[0]), change, names, expected)


def _in_subfolder(folder: Path) -> None:
    (folder / "inner").mkdir()
    text = (folder / "scene.toml").read_text(encoding="utf-8").replace('"box.obj"', '"../outside.obj"')
    (folder / "scene.toml").unlink()
    (folder / "inner" / "scene.toml").write_text(text, encoding="utf-8")
