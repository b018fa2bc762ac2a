"""Tables and trajectories: text files of numbers, and folders of several of them."""

import gzip
from collections.abc import Callable, Iterator
from pathlib import Path

from corpus.base_texts import EYES, GAZE, HEAD, HEAD_CSV, LENS_MRCAL, LENS_YAML, PHOTO_SESSION
from corpus.case import Case, Change, Expected, edited, replaced, several, written
from corpus.cases.hostile_files import DECODE, PHOTOS

END = ("--backend", "cpu", "--out", "out")
RENDER_FILES = ("device.toml", "scene.toml", "box.obj")
PREDICT = ("predict", "bench/bench.toml", "bench", "--out", "out")
DIAGNOSE = ("diagnose", "bench", "--max-causes", "0", "--causes", "stage_scale", "--out", "out")


def _text(old: str, change: Callable[[str], str]) -> str:
    new = change(old)
    assert new != old
    return new


# By name: file, option, text. Each is refused.
TRAJECTORIES: dict[str, tuple[str, str]] = {
    "a time of nan": ("head.txt", HEAD + "nan 0 0 0 0 0 0 1\n"),
    "a time of inf": ("head.txt", HEAD + "inf 0 0 0 0 0 0 1\n"),
    "a place of 1e308": ("head.txt", HEAD + "0.5 1e308 0 0 0 0 0 1\n"),
    "a time of 1e18": ("head.txt", HEAD + "1e18 0 0 0 0 0 0 1\n"),
    "escapes": ("head.txt", HEAD + "0.5 \x1b[31m 0 0 0 0 0 1\n"),
    "EuRoC below zero": ("head.csv", "5,0,0,0,1,0,0,0\n-5,0,0,0,1,0,0,0\n"),
    "EuRoC of huge times": ("head.csv", HEAD_CSV + "9" * 400 + ",0,0,0,1,0,0,0\n"),
    "EuRoC too short": ("head.csv", HEAD_CSV + "900000000,0,0\n"),
    "eyes far away": ("eyes.txt", EYES + "0.5 right 1e6 0 0\n"),
    "eyes at 1e308": ("eyes.txt", EYES + "0.5 right 1e308 0 0\n"),
    "only left eyes": ("eyes.txt", EYES.replace("right", "left")),
    "no header": ("eyes.txt", "0.0 right 0 0 0\n"),
    "an unknown kind": ("eyes.txt", EYES.replace("viewpoint", "magic")),
    "a gaze backwards": ("gaze.txt", GAZE + "0.5 right 0 0 1\n"),
    "a gaze of no length": ("gaze.txt", GAZE + "0.5 right 0 0 0\n"),
    "a gaze without a centre": ("gaze.txt", GAZE.replace("rotation_centre_right_m", "rotation_centre_left_m")),
    "a centre of nan": ("gaze.txt", GAZE.replace("0 0 0.0105", "0 nan 0")),
    "a pupil distance of inf": ("gaze.txt", GAZE.replace("distance_m: 0.0105", "distance_m: inf")),
    "a pupil distance in millimetres": ("gaze.txt", GAZE.replace("distance_m: 0.0105", "distance_m: 10.5")),
}


def _table(change: Callable[[list[str]], object]) -> Change:
    """Change the lines of the table of panel positions."""

    def edit(content: bytes) -> bytes:
        lines = gzip.decompress(content).decode().splitlines()
        result = change(lines)
        return gzip.compress("\n".join(result if isinstance(result, list) else lines).encode() + b"\n", 1)

    return edited("bench/display.csv.gz", edit)


def _cell(column: str, value: str | Callable[[float], float], every: bool = False) -> Change:
    def change(lines: list[str]) -> None:
        at = lines[0].split(",").index(column)
        for row in range(1, len(lines) if every else 2):
            cells = lines[row].split(",")
            cells[at] = value if isinstance(value, str) else repr(value(float(cells[at])))
            lines[row] = ",".join(cells)

    return _table(change)


def _without_tables(folder: Path) -> None:
    for path in (folder / "bench").glob("*.csv.gz"):
        path.unlink()


BENCH: dict[str, Change] = {
    "stage in metres": _cell("stage_x_mm", lambda x: x / 1000, every=True),
    "stage in micrometres": _cell("stage_x_mm", lambda x: 1000 * x, every=True),
    "pixels a million off": _cell("pixel_u", lambda u: u + 1e6, every=True),
    "camera pixels a million off": _cell("camera_u", lambda u: u + 1e6, every=True),
    "a capture of -1": _cell("capture", "-1"),
    "a row too long": _table(lambda lines: [*lines, lines[-1] + ",7"]),
    "one row": _table(lambda lines: lines[:2]),
    "semicolons": _table(lambda lines: [line.replace(",", ";") for line in lines]),
    "escapes in its header": _table(lambda lines: [lines[0] + ",\x1b[31m\u202e", *[f"{x},1" for x in lines[1:]]]),
    "rows twice": _table(lambda lines: [*lines, *lines[1:]]),
    "both kinds of table": several([lambda f: (f / "bench" / "display.csv").write_bytes(b"capture\n1\n")]),
    "no tables": _without_tables,
    "no bench.toml": several([lambda f: (f / "bench" / "bench.toml").unlink()]),
    "a device in the folder above": several(
        [replaced("bench/bench.toml", 'device = "northstar"', 'device = "../device.toml"')]
    ),
    "a device by an absolute path": replaced("bench/bench.toml", 'device = "northstar"', 'device = "/etc/passwd.toml"'),
    "an unknown device": replaced("bench/bench.toml", 'device = "northstar"', 'device = "southstar"'),
}  # fmt: skip

PHOTO: dict[str, tuple[str, str, str]] = {
    "a photograph by an absolute path": ('"bare.png"', '"/etc/hostname.png"', "hostname.png"),
    "a photograph that is not there": ('"bare.png"', '"nowhere.png"', "nowhere.png"),
    "a photograph that is endless": ('"bare.png"', '"/dev/zero"', "zero"),
    "a board by an absolute path": ('board = "board.toml"', 'board = "/etc/passwd"', "passwd"),
    "a folder of pictures that is not there": ('photographs = "shown"', 'photographs = "nowhere"', "nowhere"),
    "a negative eye box": ("[10.0, 8.0, 6.0]", "[-10.0, 8.0, 6.0]", "size_mm"),
    "a rotation of nan": ("[[1.0, 0.0, 0.0], [0.0", "[[nan, 0.0, 0.0], [0.0", "rotation"),
    "a distortion of 1e308": ("distortion = [0.1,", "distortion = [1e308,", "distortion"),
    "a name of escapes": ('device = "a headset"', 'device = "a\\u001b[31m\\nforged: \\u202e"', "session.toml|photograph|board|dots"),
    "a million target poses": ("target_pose = 0", "target_pose = 1000000000", "target_pose|target pose"),
}  # fmt: skip

LENSES: dict[str, tuple[str, str]] = {
    "a negative image": ("lens.yaml", _text(LENS_YAML, lambda text: text.replace("width: 64", "width: -64"))),
    "an entity bomb": ("lens.xml", '<?xml version="1.0"?><!DOCTYPE l [<!ENTITY a "aaaaaaaaaa">]><opencv_storage>&a;</opencv_storage>'),
    "a call": ("lens.cameramodel", "__import__('os').system('touch hacked')"),
    "intrinsics of text": ("lens.cameramodel", _text(LENS_MRCAL, lambda text: text.replace("60.0, 60.0", "'a', 60.0"))),
    "1e9 knots": ("lens.cameramodel", _text(LENS_MRCAL, lambda text: text.replace("OPENCV5", "SPLINED_STEREOGRAPHIC_order=3_Nx=100000_Ny=100000_fov_x_deg=120"))),
}  # fmt: skip

CAUSES: dict[str, str] = {
    "a syntax error": "def (\n",
    "an error": "raise RuntimeError('\\x1b[31mboom\\nforged')\n",
    "an exit": "import sys\nsys.exit(0)\n",
    "an endless recursion": "def f():\n    f()\nf()\n",
    "no CAUSES": "x = 1\n",
    "CAUSES of numbers": "CAUSES = [1, 2]\n",
    "CAUSES that is a number": "CAUSES = 5\n",
    "a missing module": "import a_module_that_is_not_there\n",
}


def cases() -> Iterator[Case]:
    for title, (file, text) in TRAJECTORIES.items():
        option = "--head" if file.startswith("head") else "--eye-track"
        arguments: tuple[str, ...] = ("render", "device.toml", "scene.toml", option, file, "--frames", "3", *END)
        expected: Expected = (
            "warned" if "far away" in title or title in ("a time of 1e18", "a place of 1e308") else "refused"
        )
        yield Case(f"trajectory {file}: {title}", arguments, RENDER_FILES, written(file, text), (file,), expected)
    for title, change in BENCH.items():
        words = (
            ("bench",)
            if title in ("no tables", "no bench.toml", "stage in metres") or "device" in title
            else ("display.csv",)
        )
        expected = "right" if title == "semicolons" else "any" if title in ("rows twice", "one row") else "refused"
        yield Case(
            f"bench table: {title}",
            PREDICT,
            ("bench", "device.toml"),
            change,
            words if expected == "refused" else (),
            expected,
        )
    for title, (old, new, word) in PHOTO.items():
        assert old in PHOTO_SESSION, title
        yield Case(
            f"photo session: {title}",
            PHOTOS,
            ("photos", "board.toml", "codes"),
            replaced("photos/session.toml", old, new),
            (word,),
        )
    for title, (file, text) in LENSES.items():
        stated = several([written(f"photos/{file}", text), _lens_stated(file)])
        yield Case(f"lens: {title}", PHOTOS, ("photos",), stated, (file,))
    for title, text in CAUSES.items():
        arguments = (*DIAGNOSE, "--add-causes", "causes.py")
        yield Case(f"causes: {title}", arguments, ("bench",), written("causes.py", text), ("causes.py",))
    yield from _codes()


def _lens_stated(name: str) -> Change:
    numbers = "focal_px = [60.0, 60.0]\nopencv_centre_px = [31.5, 23.5]\ndistortion = [0.1, 0.0, 0.0, 0.0, 0.0]"
    return replaced("photos/session.toml", numbers, f'lens_file = "{name}"')


def _codes() -> Iterator[Case]:
    camera = (*DECODE, "--camera", "camera.toml")
    for title, text, word in (
        ("bits of 1e9", "bits = 1000000000\n", "bits"),
        ("bits of text", 'bits = "many"\n', "bits"),
        ("an unknown key", "bits = 8\nmagic = 5\n", "magic"),
        ("a dark frame above", 'bits = 8\ndark = "../x.png"\n', "dark|x.png"),
    ):
        yield Case(f"decode camera: {title}", camera, ("codes",), written("camera.toml", text), ("camera.toml", word))
    for title, text in (
        ("broken TOML", "[[["),
        ("a picture above", '[[photograph]]\nfile = "../x.png"\nimage = 0\n'),
        ("image 1e9", '[[photograph]]\nfile = "00.png"\nimage = 1000000000\n'),
        ("a number", "photograph = 5\n"),
    ):
        yield Case(
            f"decode manifest: {title}", DECODE, ("codes",), written("codes/manifest.toml", text), ("manifest.toml",)
        )
    yield Case(
        "decode: a photograph missing", DECODE, ("codes",), lambda f: (f / "codes/07.png").unlink(), expected="any"
    )
    yield Case(
        "decode: a photograph too many",
        DECODE,
        ("codes",),
        lambda f: (f / "codes/99.png").write_bytes((f / "codes/07.png").read_bytes()),
        ("codes|photograph",),
    )
    yield Case("decode: an empty folder", DECODE, (), lambda f: (f / "codes").mkdir(), ("codes",))
