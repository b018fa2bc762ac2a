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

# Verb, valid files, and its options with values that are out of their range.
RANGES: tuple[tuple[tuple[str, ...], tuple[str, ...], dict[str, tuple[str, ...]]], ...] = (
    (RENDER, (*SMALL, "head.txt"), {
        "--fps": ("1e9", "0", "-1", "nan", "inf", "x", "", "1e308"),
        "--frames": ("0", "-1", "1.5", "nan", "x"),
        "--supersample": ("1000000000", "0", "-1"),
        "--samples": ("1000000000", "0", "-1"),
        "--bounces": ("1000000000", "-1", "1.5"),
        "--resolution": ("1e9", "0", "-1", "nan", "inf"),
        "--eye": ("third", "", "right,left"),
        "--backend": ("magic",),
        "--pack": ("zip", ""),
        "--maps": ("exr",),
        "--method": ("",),
        "--layers": ("magic", ""),
        "--predicted-error": ("0", "-1", "nan", "1e9"),
        "--seed": ("-1", "x"),
        "--workers": ("0", "-1", "1000000000"),
        "--scheduler": ("host", "tcp://127.0.0.1:1"),
    }),
    (EXPORT, (*SMALL, "eyes.txt", "model.json"), {
        "--eye": ("third", "", "left"),
        "--depth-m": ("0", "-1", "nan", "inf", "1e9", "x"),
        "--viewpoint-mm": ("nan", "1", "x"),
        "--pupils": ("0", "1", "-1", "1000000000", "1.5", "x"),
        "--eye-track": ("nowhere.txt", "scene.toml"),
        "--fps": ("1e9", "0", "-1", "nan", "inf", "x"),
        "--frames": ("0", "-1", "1.5", "nan", "x"),
        "--resolution": ("1e9", "0", "-1", "nan", "inf"),
        "--source-size": ("0x0", "-1x5", "10000000x10000000", "x", "640"),
        "--source-axes": ("magic",),
        "--red-model": ("nowhere.json", "model.json"),
    }),
    (BUDGET, SMALL, {
        "--eye": ("third",),
        "--depth-m": ("0", "-1", "nan", "inf", "1e9"),
        "--eye-noise-mm": ("-1", "nan", "1e308", "x"),
        "--eye-latency-ms": ("-1", "nan", "1e308"),
        "--head-noise-deg": ("-1", "nan", "1e308"),
        "--head-speed-m-s": ("-1", "nan", "1e308"),
        "--raster-arcmin": ("-1", "nan", "1e308"),
    }),
    ((*RENDER, "--pack", "webdataset"), SMALL, {"--frames-per-shard": ("0", "-1", "1.5", "nan", "1000000000000", "x")}),
    (IMPORT_LENS, ("lens.zmx", "glasses.agf"), {
        "--panel": ("0x0", "-1x5", "10000000x10000000", "x", "64"),
        "--panel-mm": ("0x0", "-1x5", "1e9x1e9", "nanx1", "x"),
        "--eye": ("third", "both"),
        "--starts-at": ("magic",),
        "--pupil-surface": ("-1", "1000000000", "1.5", "x"),
        "--panel-surface": ("-1", "1000000000", "1.5"),
        "--eye-relief-mm": ("-1", "nan", "inf", "1e9"),
        "--glasses": ("nowhere.agf",),
    }),
    (DEMO, SMALL, {"--viewpoints": ("1000000000", "0", "-1", "1e9", "x"), "--seed": ("-1", "x", "1e400")}),
    (PLAN, SMALL, {
        "--accuracy-arcmin": ("0", "-1", "nan", "1e-300", "inf"),
        "--repeatability-um": ("-1", "nan", "1e308"),
        "--dot-noise-px": ("-1", "nan", "1e308"),
        "--panel-noise-px": ("0", "nan", "1e308"),
        "--camera": ("0x0", "-5x7", "1000000000x1000000000", "x", "640", "640x480x3", "nanxnan"),
        "--depths-m": ("0", "nan", "1e9", "-1", "0.4"),
        "--seconds": ("-1", "nan", "1e308"),
        "--most-places": ("0", "1000000000", "-1"),
        "--seed": ("-1",),
        "--calibration": ("nowhere",),
    }),
    (FIT, ("captures.npz",), {
        "--degree": ("0", "-1", "1000000000", "nan"),
        "--see-through-degree": ("0", "99"),
        "--kind": ("magic",),
        "--bench": ("nowhere.toml",),
        "--prescription": ("nowhere.toml",),
    }),
    (SIMULATED, SMALL, {
        "--viewpoints": ("0", "1000000000", "-1", "1.5"),
        "--noise-arcmin": ("-1", "nan", "inf", "1e308"),
        "--repeatability-um": ("-1", "1e9", "nan"),
        "--turn-jitter-urad": ("-1", "1e308", "nan"),
        "--seed": ("-1",),
    }),
    (SIMULATE, SMALL, {
        "--viewpoints": ("0", "1000000000", "-1"),
        "--camera": ("0x0", "1000000x1000000", "1x1"),
        "--tracking-camera": ("0x0", "1000000x1000000"),
        "--bits": ("9", "0", "1000"),
        "--pupil-mm": ("0", "-1", "nan", "1e9"),
        "--focus-m": ("0", "-1", "nan", "1e9", "inf"),
        "--snr": ("0", "-1", "nan", "1e308"),
        "--depths-m": ("1e9", "0", "-1", "nan"),
        "--stated-axes-deg": ("-1", "nan", "1e308", "400"),
        "--repeatability-um": ("-1", "nan", "1e308"),
        "--turn-urad": ("-1", "nan", "1e308"),
        "--bow-mm": ("nan", "1e308"),
        "--anisotropy": ("nan", "1e308", "-5"),
        "--extrinsics-mm": ("-1", "nan", "1e308"),
        "--extrinsics-deg": ("-1", "nan", "1e308"),
        "--workers": ("0",),
    }),
    (PHOTOGRAPHED, (), {
        "--port": ("-1", "0.5", "99999999"),
        "--settle-s": ("-1", "nan", "inf"),
        "--timeout-s": ("0", "-1", "nan", "inf"),
        "--page-timeout-s": ("0", "-1", "nan"),
        "--photograph": ("", "nothing here", "'{path}"),
        "--suffix": (".exe",),
    }),
    (DECODE, ("codes",), {
        "--panel": ("0x0", "-1x5", "10000000x10000000", "x"),
        "--bits": ("0", "-1", "99", "8.5"),
        "--camera": ("nowhere.toml",),
        "--order": ("magic",),
    }),
    ((*BOARD, "--kind", "charuco"), (), {"--dictionary": ("magic", "", "__class__")}),
    (BOARD, (), {
        "--columns": ("0", "-1", "1000000000", "1.5"),
        "--rows": ("0", "1000000000"),
        "--pitch-mm": ("0", "-1", "nan", "inf", "1e9", "1e-9"),
        "--dpi": ("0", "-1", "1000000000"),
        "--dictionary": ("DICT_4X4_50",),
        "--seed": ("-1",),
    }),
    (PATTERN, (), {
        "--panel": ("10000000x10000000", "0x0", "-5x5", "1e9x1e9", "nanx1", "", "64", "2147483648x1"),
        "--channel": ("magic",),
    }),
    (DIAGNOSE, ("bench",), {
        "--max-causes": ("-1", "x", "1.5"),
        "--causes": ("magic",),
        "--exclude": ("magic",),
        "--add-causes": ("nowhere.py", "a_module_that_is_not_there"),
        "--bench": ("nowhere.toml",),
    }),
)  # fmt: skip

# Every verb with its inputs missing; the first word is the one that must be named.
NOWHERE = {
    "trace": ("trace", "nowhere.toml"),
    "trace by name": ("trace", "nowhere"),
    "render device": ("render", "nowhere.toml", "scene.toml"),
    "render model": ("render", "nowhere.json", "scene.toml"),
    "render scene": ("render", "device.toml", "nowhere.toml"),
    "render mesh": ("render", "device.toml", "nowhere.glb"),
    "render head": ("render", "device.toml", "scene.toml", "--head", "nowhere.txt"),
    "render eyes": ("render", "device.toml", "scene.toml", "--eye-track", "nowhere.txt"),
    "render red model": ("render", "model.json", "scene.toml", "--per-colour", "--red-model", "nowhere.json", "--blue-model", "model.json"),
    "export": ("export", "nowhere.toml", "--format", "stmap"),
    "export by name": ("export", "nowhere", "--format", "stmap"),
    "export track": ("export", "device.toml", "--format", "npz", "--eye-track", "nowhere.txt"),
    "export red model": ("export", "model.json", "--format", "stmap", "--red-model", "nowhere.json", "--blue-model", "model.json"),
    "budget": ("budget", "nowhere.json"),
    "import-lens": ("import-lens", "nowhere.zmx", "--panel", "64x48", "--panel-mm", "10x8"),
    "render misalignment": ("render", "device.toml", "scene.toml", "--misalignment", "nowhere.toml"),
    "demo": ("demo", "nowhere.toml"),
    "demo scene": ("demo", "device.toml", "--scene", "nowhere.toml"),
    "plan": ("plan", "nowhere.toml"),
    "calibrate": ("calibrate", "nowhere"),
    "calibrate captures": ("calibrate", "nowhere.npz"),
    "calibrate device": ("calibrate", "nowhere.toml"),
    "verify": ("verify", "nowhere", "board.toml", "--calibration", "calibration"),
    "verify board": ("verify", "pairs", "nowhere.toml", "--calibration", "calibration"),
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
    for verb, files, options in RANGES:
        words = " ".join(verb[:2]) if verb[0] == "calibrate" else verb[0]
        for option, values in options.items():
            for value in values:
                extra = {
                    "--supersample": ("--method", "raytrace"),
                    "--samples": ("--method", "pathtrace"),
                    "--bounces": ("--method", "pathtrace"),
                }.get(option, ())
                if option in ("--fps", "--frames"):
                    extra = ("--head", "head.txt") if verb[0] == "render" else ("--eye-track", "eyes.txt")
                arguments = (*_without(verb, option), *extra, f"{option}={value}")
                name = (option if not value or option != "--photograph" else "photograph|path|nothing|program",)
                wrong = value if (verb[0], option) == ("decode", "--camera") or option in FILES_AND_NAMES else ""
                names = (f"{option}|{wrong}" if wrong else "|".join((*name, option[2:])),)
                yield Case(f"option {words} {option}={value}", arguments, files, nothing, names)
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
        ("an unknown verb", ("rendr",), ("rendr",)),
        ("an unknown verb of escapes", ("\x1b[31mx\n\u202e",), ("command",)),
        ("an empty verb", ("",), ("command",)),
        ("an unknown option", ("trace", "device.toml", "--magic"), ("magic",)),
        ("an option twice", ("trace", "device.toml", "--eye", "left", "--eye", "right"), ("eye",)),
        ("no argument", ("trace",), ("device|DEVICE",)),
        ("an argument too many", ("trace", "device.toml", "b", "c"), ("b|c",)),
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
