"""Command lines: options out of range, of another kind, and paths that are something else."""

from collections.abc import Iterator

from corpus.case import Case, nothing

SMALL = ("lens.zmx", "glasses.agf", "device.toml", "scene.toml", "box.obj")
RENDER = ("render", "device.toml", "scene.toml", "--backend", "cpu", "--out", "out")
DEMO = ("demo", "device.toml", "--scene", "scene.toml", "--backend", "cpu", "--out", "out")
PLAN = ("plan", "device.toml", "--out", "out")
FIT = ("calibrate", "captures.npz", "--out", "out")
SIMULATED = ("calibrate", "device.toml", "--out", "out")
SIMULATE = ("simulate", "device.toml", "--workers", "1", "--out", "out")
PHOTOGRAPHED = ("pattern", "--panel", "64x48", "--photograph", "true {path}", "--page-timeout-s", "1", "--out", "out")
DECODE = ("decode", "codes", "--panel", "64x48", "--pattern", "gray", "--out", "out")
BOARD = ("board", "--out", "out")
PATTERN = ("pattern", "--panel", "64x48", "--out", "out")
DIAGNOSE = ("diagnose", "bench", "--out", "out")
EXPORT = ("export", "device.toml", "--format", "stmap", "--out", "out")
BUDGET = ("budget", "device.toml", "--out", "out")
IMPORT_LENS = ("import-lens", "lens.zmx", "--panel", "64x48", "--panel-mm", "10x8", "--glasses", "glasses.agf", "--out", "out")  # fmt: skip

# Options whose wrong value is named, and not they themselves.
FILES_AND_NAMES = ("--add-causes", "--bench", "--causes", "--calibration", "--prescription", "--exclude", "--eye-track", "--glasses")  # fmt: skip

# Verb, valid files, and its options with values that are no values of theirs. tests/test_cli.py gives every number of
# every verb a value beyond each limit, and every choice another word.
VALUES: tuple[tuple[tuple[str, ...], tuple[str, ...], dict[str, tuple[str, ...]]], ...] = (
    (RENDER, (*SMALL, "head.txt"), {
        "--fps": ("x", ""),
        "--frames": ("1.5", "1e400"),
        "--eye": ("", "right,left"),
        "--layers": ("magic", ""),
        "--scheduler": ("host", "tcp://127.0.0.1:1"),
    }),
    (EXPORT, (*SMALL, "eyes.txt", "model.json"), {
        "--eye": ("left",),
        "--viewpoint-mm": ("1", "x"),
        "--eye-track": ("nowhere.txt", "scene.toml"),
        "--source-size": ("0x0", "-1x5", "10000000x10000000", "x", "640"),
        "--red-model": ("nowhere.json", "model.json"),
    }),
    (IMPORT_LENS, ("lens.zmx", "glasses.agf"), {
        "--panel-mm": ("x",),
        "--eye": ("both",),
        "--glasses": ("nowhere.agf",),
    }),
    (PLAN, SMALL, {
        "--camera": ("640x480x3", "nanxnan"),
        "--depths-m": ("0.4",),
        "--calibration": ("nowhere",),
    }),
    (FIT, ("captures.npz",), {"--bench": ("nowhere.toml",), "--prescription": ("nowhere.toml",)}),
    (SIMULATE, SMALL, {"--bits": ("9", "1000")}),
    (PHOTOGRAPHED, (), {"--photograph": ("", "nothing here", "'{path}")}),
    (DECODE, ("codes",), {"--camera": ("nowhere.toml",)}),
    ((*BOARD, "--kind", "charuco"), (), {"--dictionary": ("magic", "", "__class__")}),
    (BOARD, (), {"--dictionary": ("DICT_4X4_50",)}),
    (PATTERN, (), {"--panel": ("", "64", "2147483648x1")}),
    (DIAGNOSE, ("bench",), {
        "--causes": ("magic",),
        "--exclude": ("magic",),
        "--add-causes": ("nowhere.py", "a_module_that_is_not_there"),
        "--bench": ("nowhere.toml",),
    }),
)  # fmt: skip

# Verbs with an input missing that is no file of hostile_files.py; the first word is the one that must be named.
NOWHERE = {
    "trace": ("trace", "nowhere.toml"),
    "trace by name": ("trace", "nowhere"),
    "render red model": ("render", "model.json", "scene.toml", "--per-colour", "--red-model", "nowhere.json", "--blue-model", "model.json"),
    "export": ("export", "nowhere.toml", "--format", "stmap"),
    "export by name": ("export", "nowhere", "--format", "stmap"),
    "export track": ("export", "device.toml", "--format", "npz", "--eye-track", "nowhere.txt"),
    "export red model": ("export", "model.json", "--format", "stmap", "--red-model", "nowhere.json", "--blue-model", "model.json"),
    "budget": ("budget", "nowhere.json"),
    "render misalignment": ("render", "device.toml", "scene.toml", "--misalignment", "nowhere.toml"),
    "demo": ("demo", "nowhere.toml"),
    "demo scene": ("demo", "device.toml", "--scene", "nowhere.toml"),
    "plan": ("plan", "nowhere.toml"),
    "calibrate": ("calibrate", "nowhere"),
    "calibrate device": ("calibrate", "nowhere.toml"),
    "verify": ("verify", "nowhere", "board.toml", "--calibration", "calibration"),
    "verify calibration": ("verify", "pairs", "board.toml", "--calibration", "nowhere"),
    "diagnose": ("diagnose", "nowhere"),
    "predict": ("predict", "nowhere.toml", "bench"),
    "predict session": ("predict", "bench", "nowhere"),
    "decode": ("decode", "nowhere", "--panel", "64x48"),
    "simulate": ("simulate", "nowhere.toml"),
}  # fmt: skip

OUTPUTS = {
    "render": RENDER,
    "demo": DEMO,
    "trace": ("trace", "device.toml", "--out", "out"),
    "export": EXPORT,
    "budget": BUDGET,
    "import-lens": IMPORT_LENS,
    "plan": PLAN,
    "calibrate captures": FIT,
    "calibrate device": SIMULATED,
    "calibrate photographs": ("calibrate", "photos", "--workers", "1", "--out", "out"),
    "verify": ("verify", "pairs", "board.toml", "--calibration", "calibration", "--out", "out"),
    "diagnose": DIAGNOSE,
    "predict": ("predict", "bench", "bench", "--out", "out"),
    "decode": DECODE,
    "board": BOARD,
    "pattern": PATTERN,
    "simulate": SIMULATE,
    "pattern, photographed": PHOTOGRAPHED,
}
ALL = ("device.toml", "scene.toml", "box.obj", "model.json", "captures.npz", "bench", "photos", "calibration", "pairs", "board.toml", "codes")  # fmt: skip


def cases() -> Iterator[Case]:
    for verb, files, options in VALUES:
        for option, values in options.items():
            for value in values:
                extra = ("--head", "head.txt") if option in ("--fps", "--frames") else ()
                arguments = (*_without(verb, option), *extra, f"{option}={value}")
                name = (option if not value or option != "--photograph" else "photograph|path|nothing|program",)
                wrong = value if (verb[0], option) == ("decode", "--camera") or option in FILES_AND_NAMES else ""
                names = (f"{option}|{wrong}" if wrong else "|".join((*name, option[2:])),)
                yield Case(f"option {verb[0]} {option}={value}", arguments, files, nothing, names)
    for title, arguments in NOWHERE.items():
        yield Case(f"option nowhere: {title}", (*arguments, "--out", "out"), ALL, nothing, ("nowhere",))
    for title, arguments in OUTPUTS.items():
        files = tuple(name for name in ALL if name in arguments or name in ("scene.toml", "box.obj"))
        for where, place in (
            ("a file", "device.toml"),
            ("inside a file", "device.toml/out"),
            ("a device", "/dev/null/out"),
            ("too long", "x" * 300),
        ):
            given = tuple(place if each == "out" else each for each in arguments)
            yield Case(f"output {title}: is {where}", given, tuple({*files, "device.toml"}), nothing, (place[:40],))
    yield from _words()


def _without(verb: tuple[str, ...], option: str) -> tuple[str, ...]:
    """A command without an option that is given again."""
    if option not in verb:
        return verb
    at = verb.index(option)
    return verb[:at] + verb[at + 2 :]


def _words() -> Iterator[Case]:
    for title, arguments, names in (
        ("an unknown verb of escapes", ("\x1b[31mx\n\u202e",), ("command",)),
        ("an empty verb", ("",), ("command",)),
        ("an option twice", ("trace", "device.toml", "--eye", "left", "--eye", "right"), ("eye",)),
        ("an empty argument", ("trace", ""), ("''|device|name",)),
        ("an argument with a nul", ("trace", "a\x00b.toml"), ("a",)),
        ("an argument of escapes", ("trace", "\x1b[31mx.toml\n\u202e"), ("x.toml",)),
        ("an argument of 5000 characters", ("trace", "x" * 5000 + ".toml"), ()),
        ("a folder for a device", ("trace", "bench"), ("bench",)),
        ("a mesh for a device", ("trace", "box.obj"), ("box.obj",)),
        ("a device for a scene", ("render", "device.toml", "device.toml", "--out", "out"), ("device.toml",)),
        ("a scene for a device", ("render", "scene.toml", "scene.toml", "--out", "out"), ("scene.toml",)),
        ("captures for a model", ("render", "captures.npz", "scene.toml", "--out", "out"), ("captures.npz",)),
        ("photographs for a bench session", ("diagnose", "photos", "--out", "out"), ("photos",)),
        ("a model for captures", ("calibrate", "model.json", "--out", "out"), ("model.json",)),
        (
            "the left eye of a right device",
            ("render", "device.toml", "scene.toml", "--eye", "left", "--out", "out"),
            ("left",),
        ),
    ):
        yield Case(f"option words: {title}", arguments, ALL, nothing, names)
