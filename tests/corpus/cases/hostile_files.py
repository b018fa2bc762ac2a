"""Files that are no such files: each reader meets each of them."""

import os
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Literal

from corpus.base_texts import PHOTO_SESSION
from corpus.case import Case, Change, nothing, several, written

RENDER = ("--backend", "cpu", "--out", "out")
DIAGNOSE = ("--max-causes", "0", "--causes", "stage_scale", "--out", "out")
PREDICT = ("predict", "bench/bench.toml", "bench", "--out", "out")
SCENE = ("scene.toml", "box.obj")
PAIRS = ("verify", "pairs", "board.toml", "--calibration", "calibration", "--out", "out")
PAIRS_FILES = ("pairs", "board.toml", "calibration")
PHOTOS = ("calibrate", "photos", "--workers", "1", "--out", "out")
OPTICS = ("--panel", "64x48", "--panel-mm", "10x8", "--glasses", "glasses.agf", "--out", "out")
DECODE = ("decode", "codes", "--panel", "64x48", "--pattern", "gray", "--out", "out")


@dataclass(frozen=True)
class Reader:
    """A file that some command reads: its kind and name, the command, the files that it needs, and their preparation.

    `text` says whether the file is text; `valid` what the command makes of the file as it is.
    """

    kind: str
    file: str
    arguments: tuple[str, ...]
    files: tuple[str, ...]
    prepare: Change = nothing
    text: bool = True
    valid: Literal["right", "any"] = "right"


def _lens(name: str) -> Change:
    """State a camera's lens by a file in the photographic session."""
    numbers = "focal_px = [60.0, 60.0]\nopencv_centre_px = [31.5, 23.5]\ndistortion = [0.1, 0.0, 0.0, 0.0, 0.0]"
    assert numbers in PHOTO_SESSION
    text = PHOTO_SESSION.replace(numbers, f'lens_file = "{name}"', 1)

    def change(folder: Path) -> None:
        (folder / name).rename(folder / "photos" / name)
        (folder / "photos" / "session.toml").write_text(text, encoding="utf-8")

    return change


def _plain_table(folder: Path) -> None:
    import gzip

    packed = folder / "bench" / "display.csv.gz"
    (folder / "bench" / "display.csv").write_bytes(gzip.decompress(packed.read_bytes()))
    packed.unlink()


def _render_of(file: str, *others: str) -> tuple[tuple[str, ...], tuple[str, ...]]:
    return ("render", "device.toml", file, *RENDER), ("device.toml", file.split("/")[0], *others)


READERS = (
    Reader("device", "device.toml", ("render", "device.toml", "scene.toml", *RENDER), ("device.toml", *SCENE)),
    Reader("scene", "scene.toml", *_render_of("scene.toml", "box.obj")),
    Reader("model", "model.json", ("render", "model.json", "scene.toml", *RENDER), ("model.json", *SCENE)),
    Reader("mesh glb", "textured.glb", *_render_of("textured.glb"), text=False),
    Reader("mesh gltf", "gltf/box.gltf", *_render_of("gltf/box.gltf")),
    Reader("mesh gltf buffer", "gltf/gltf_buffer_0.bin", *_render_of("gltf/box.gltf"), text=False),
    Reader("mesh obj", "box.obj", *_render_of("box.obj")),
    Reader("mesh obj material", "textured/material.mtl", *_render_of("textured/box.obj")),
    Reader("mesh obj texture", "textured/material_0.png", *_render_of("textured/box.obj"), text=False),
    Reader("mesh ply", "box.ply", *_render_of("box.ply")),
    Reader("mesh ply binary", "binary.ply", *_render_of("binary.ply"), text=False),
    Reader("mesh stl", "ascii.stl", *_render_of("ascii.stl")),
    Reader("mesh stl binary", "box.stl", *_render_of("box.stl"), text=False),
    *(
        Reader(f"trajectory {name}", name, (*_render_of("scene.toml")[0], option, name), ("device.toml", name, *SCENE))
        for option, name in (("--head", "head.txt"), ("--head", "head.csv"), ("--eye-track", "eyes.txt"), ("--eye-track", "gaze.txt"))
    ),
    Reader("captures", "captures.npz", ("calibrate", "captures.npz", "--degree", "1", "--see-through-degree", "1", "--out", "out"), ("captures.npz",), text=False),
    Reader("bench", "bench/bench.toml", ("diagnose", "bench", *DIAGNOSE), ("bench",)),
    Reader("bench table", "bench/display.csv", PREDICT, ("bench",), _plain_table),
    Reader("bench packed table", "bench/display.csv.gz", PREDICT, ("bench",), text=False),
    Reader("causes", "causes.py", ("diagnose", "bench", "--show-cause", "stage_scale", "--add-causes", "causes.py", "--out", "out"), ("bench", "causes.py")),
    Reader("photo session", "photos/session.toml", PHOTOS, ("photos",), valid="any"),
    Reader("photograph of session", "photos/bare.png", PHOTOS, ("photos",), text=False, valid="any"),
    *(
        Reader(f"lens {name}", f"photos/{name}", PHOTOS, ("photos", name), _lens(name), valid="any")
        for name in ("lens.yaml", "lens.xml", "lens.cameramodel")
    ),
    *(
        Reader(f"optics {file}", file, ("import-lens", lens, *OPTICS), (lens, "glasses.agf"))
        for file, lens in (
            ("lens.zmx", "lens.zmx"),
            ("lens.seq", "lens.seq"),
            ("optiland.json", "optiland.json"),
            ("rayoptics.roa", "rayoptics.roa"),
            ("glasses.agf", "lens.zmx"),
        )
    ),
    Reader("report", "report.json", ("import-lens", "lens.zmx", *OPTICS, "--against", "report.json"), ("lens.zmx", "glasses.agf", "report.json")),
    Reader("board", "board.toml", PAIRS, PAIRS_FILES),
    Reader("station", "calibration/station-right.json", PAIRS, PAIRS_FILES),
    Reader("photograph of pairs", "pairs/a_on.png", PAIRS, PAIRS_FILES, text=False),
    Reader("photograph of code", "codes/03.png", DECODE, ("codes",), text=False),
    Reader(
        "decode camera",
        "camera.toml",
        (*DECODE, "--camera", "camera.toml"),
        ("codes",),
        written("camera.toml", "bits = 8\n"),
    ),
)  # fmt: skip


def _put(content: bytes) -> Callable[[Path], None]:
    def put(path: Path) -> None:
        path.unlink()
        path.write_bytes(content)

    return put


def _remove(path: Path) -> None:
    path.unlink()


def _folder(path: Path) -> None:
    path.unlink()
    path.mkdir()


def _pipe(path: Path) -> None:
    path.unlink()
    os.mkfifo(path)


def _link(target: str) -> Callable[[Path], None]:
    def link(path: Path) -> None:
        path.unlink()
        path.symlink_to(path.name if target == "itself" else target)

    return link


def _sparse(path: Path) -> None:
    """Two gigabytes of zeros after the content, which take no space on the disk and more memory than is allowed."""
    os.truncate(path, 2 << 30)


def _half(path: Path) -> None:
    content = path.read_bytes()
    path.write_bytes(content[: len(content) // 2])


def _reencoded(encoding: str) -> Callable[[Path], None]:
    def reencode(path: Path) -> None:
        path.write_bytes(path.read_bytes().decode("utf-8").encode(encoding))

    return reencode


# By name: the spoiling, and whether a reader may accept the result.
EVERY: dict[str, tuple[Callable[[Path], object], bool]] = {
    "missing": (_remove, False),
    "empty": (_put(b""), False),
    "is a folder": (_folder, False),
    "is a pipe": (_pipe, False),
    "is endless": (_link("/dev/zero"), False),
    "is a link to itself": (_link("itself"), False),
    "has 2 GB of zeros": (_sparse, False),
    "is noise": (_put(bytes(range(256)) * 40), False),
    "is cut in half": (_half, True),
}
TEXT_ONLY: dict[str, tuple[Callable[[Path], object], bool]] = {
    "is UTF-16": (_reencoded("utf-16"), False),
    "begins with a byte order mark": (_reencoded("utf-8-sig"), True),
    "is one long line": (_put(b"x" * 20_000_000), False),
    "is nested deeply": (_put(b"a = " + b"[" * 100_000 + b"]" * 100_000), False),
    "has escapes": (_put("\x1b[31mred\u202e = \x07".encode()), False),
}


def cases() -> Iterator[Case]:
    valid = {(reader.arguments, reader.prepare): reader for reader in reversed(READERS)}
    for reader in valid.values():
        yield Case(f"{reader.kind}: valid", reader.arguments, reader.files, reader.prepare, (), reader.valid)
    for reader in READERS:
        for title, (spoil, may_pass) in (EVERY | (TEXT_ONLY if reader.text else {})).items():
            yield Case(
                f"{reader.kind}: {title}",
                reader.arguments,
                reader.files,
                several([reader.prepare, _spoiling(reader.file, spoil)]),
                (f"{Path(reader.file).name}|{_named(reader)}",) if not may_pass else (),
                _expected(reader, title, may_pass),
                "" if title == "missing" else reader.file,
            )


def _named(reader: Reader) -> str:
    """What the user named, which a sentence may name in place of a file that it refers to."""
    named = {"mesh gltf buffer": "box.gltf", "photograph of pairs": "pairs: holds no pairs"}
    return named.get(reader.kind, Path(reader.file).name)


def _spoiling(file: str, spoil: Callable[[Path], object]) -> Change:
    return lambda folder: spoil(folder / file)


def _expected(reader: Reader, title: str, may_pass: bool) -> Literal["read", "any", "refused"]:
    if title == "begins with a byte order mark":
        return "read"
    return "any" if may_pass or _forgiving(reader, title) else "refused"


def _forgiving(reader: Reader, title: str) -> bool:
    """One table of a session is enough, and the numbers of a code's photographs say which is missing.

    Zemax writes UTF-16, which is read of all lens programs; trimesh reads it where charset_normalizer is installed.
    """
    if reader.file in ("lens.zmx", "lens.seq", "glasses.agf", "box.obj") and title == "is UTF-16":
        return True
    return title == "missing" and reader.kind in ("bench table", "bench packed table", "photograph of code")
