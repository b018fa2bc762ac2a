"""Devices, scenes and benches whose numbers are finite and of the right kind, and still impossible."""

from collections.abc import Iterator

from corpus.case import Case, Expected, nothing, replaced, several, written

RENDER = ("render", "device.toml", "scene.toml", "--backend", "cpu", "--out", "out")
FILES = ("device.toml", "scene.toml", "box.obj")
DIAGNOSE = ("diagnose", "bench", "--max-causes", "0", "--causes", "stage_scale", "--out", "out")

# By name: old and new text of the device, and a word of the sentence.
DEVICES: dict[str, tuple[str, str, str]] = {
    "a negative eye box": ("size_mm = [10", "size_mm = [-10", "size_mm"),
    "an eye box of no size": ("size_mm = [10", "size_mm = [0", "size_mm"),
    "an eye box of 10 metres": ("size_mm = [10", "size_mm = [10000", "size_mm"),
    "an eye box in metres": ("size_mm = [10.0, 8.0, 6.0]", "size_mm = [0.010, 0.008, 0.006]", "size_mm"),
    "a panel of 1e9 pixels": ("pixels = [32", "pixels = [1000000000", "pixels"),
    "a panel of 1e5 x 1e5 pixels": ("pixels = [32, 18]", "pixels = [100000, 100000]", "pixels"),
    "a panel of -32 pixels": ("pixels = [32", "pixels = [-32", "pixels"),
    "no right eye": ('side = "right"', 'side = "left"', "right"),
    "a third eye": ('side = "right"', 'side = "third"', "side"),
    "another frame": ('frame = "opencv"', 'frame = "magic"', "frame"),
    "an unknown key": ('frame = "opencv"', 'frame = "opencv"\nmagic = 5', "magic"),
    "a key twice": ('frame = "opencv"', 'frame = "opencv"\nframe = "openxr"', "line 5"),
}
NAMES = {
    "a name that is a path above": '"../../x"',
    "an absolute name": '"/corpus-absolute"',
    "a name of escapes": '"\\u001b[31mred\\u0007"',
    "a name of lines": '"a\\nwlr-render: forged"',
    "a name that turns right to left": '"\\u202eabc"',
    "an empty name": '""',
    "a name of 100000 characters": '"' + "x" * 100_000 + '"',
    "a name that is a dot": '".."',
    "a name of markup": '"[bold red]x[/] <script>alert(1)</script>"',
}
FIELDS = {
    "a field of 260 degrees": "[-130, 130, -11, 11]",
    "a field of 1e308 degrees": "[-1e308, 1e308, -11, 11]",
    "a field of nan": "[nan, 20, -11, 11]",
    "a field from right to left": "[20, -20, -11, 11]",
    "a field of no width": "[5, 5, -11, 11]",
    "a field of three numbers": "[-20, 20, -11]",
}
SCENES: dict[str, tuple[str, str, str]] = {
    "a negative light": ("colour = [0.6", "colour = [-0.6", "colour"),
    "a light of 1e30": ("colour = [0.6", "colour = [1e30", "colour"),
    "a negative ambient": ("ambient = [0.3", "ambient = [-0.3", "ambient"),
    "a light without direction": ("direction = [0.3, -0.8, -0.5]", "direction = [0, 0, 0]", "direction"),
    "a ball of -1": ("radius_m = 0.06", "radius_m = -0.06", "radius_m"),
    "a ball of 0": ("radius_m = 0.06", "radius_m = 0", "radius_m"),
    "a ball of 1e30": ("radius_m = 0.06", "radius_m = 1e30", "radius_m|ball"),
    "a ball at 1e30": ("position_m = [0.03", "position_m = [1e30", "position_m|ball"),
    "a scale of 0": ("scale = 0.5", "scale = 0", "scale"),
    "a scale of 1e30": ("scale = 0.5", "scale = 1e30", "scale|box"),
    "a quaternion of zeros": ("quaternion_xyzw = [0, 0, 0, 1]", "quaternion_xyzw = [0, 0, 0, 0]", "quaternion_xyzw"),
    "a shape that is no shape": ('shape = "ball"', 'shape = "magic"', "shape"),
    "a shape by a private name": ('shape = "ball"', 'shape = "__class__"', "shape"),
    "a mesh above": ('mesh = "box.obj"', 'mesh = "../box.obj"', "mesh|box.obj"),
    "a mesh by an absolute path": ('mesh = "box.obj"', 'mesh = "/etc/passwd"', "passwd"),
    "a mesh that is not there": ('mesh = "box.obj"', 'mesh = "nowhere.obj"', "nowhere.obj"),
    "a mesh that is endless": ('mesh = "box.obj"', 'mesh = "/dev/zero"', "zero"),
    "a mesh that is itself": ('mesh = "box.obj"', 'mesh = "scene.toml"', "scene.toml"),
    "an unknown key": ("radius_m = 0.06", "radius_m = 0.06\nmagic = 5", "magic"),
    "an unknown table": ("[[light]]", "[[magic]]\nx = 1\n[[light]]", "magic"),
    "version 99": ("version = 1", "version = 99", "version"),
    "another frame": ('frame = "openxr"', 'frame = "opencv"', "frame"),
    "both a mesh and a shape": ('shape = "ball"', 'shape = "ball"\nmesh = "box.obj"', "mesh"),
}
BENCHES: dict[str, tuple[str, str, str]] = {
    "a negative focal length": ("fx = ", "fx = -", "fx"),
    "a noise of 0": ("point_sigma_px = 0.1", "point_sigma_px = 0", "point_sigma_px"),
    "a unit of metres": ('unit = "mm"', 'unit = "m"', "unit"),
    "version 99": ("version = 1", "version = 99", "version"),
    "a pitch in micrometres": ("pitch_mm = 30", "pitch_mm = 30000", "pitch_mm|seethrough"),
    "a pitch of -1": ("pitch_mm = 30", "pitch_mm = -30", "pitch_mm"),
    "a width of 0": ("width = 1280", "width = 0", "width"),
    "a width of 1e9": ("width = 1280", "width = 1000000000", "width"),
    "a stage in metres": ("origin = [32.0", "origin = [0.032", "origin|stage|display"),
    "an unknown key": ("width = 1280", "width = 1280\nmagic = 5", "magic"),
    "a name of escapes": ('device = "northstar"', 'device = "\\u001b[31mx\\n"', "device|x"),
    "a prior of no sigma": ("version = 1", "version = 1\nprior = {latency = {latency = [0, 0]}}", "latency"),
    "a prior of a negative sigma": ("version = 1", "version = 1\nprior = {latency = {latency = [0, -1]}}", "latency"),
    "a prior of an unknown cause": ("version = 1", "version = 1\nprior = {magic = {x = [0, 1]}}", "magic"),
}


def cases() -> Iterator[Case]:
    for title, (old, new, word) in DEVICES.items():
        yield Case(f"device: {title}", RENDER, FILES, replaced("device.toml", old, new), (word,))
    for title, name in NAMES.items():
        change = replaced("device.toml", 'name = "', f"name = {name} # ")
        traced = ("trace", "device.toml", "--out", "out")
        yield Case(f"device of trace: {title}", traced, FILES, change, (), "any")
    for title, field in FIELDS.items():
        change = replaced("device.toml", 'side = "right"', f'side = "right"\nfield_deg = {field}')
        yield Case(f"device: {title}", RENDER, FILES, change, ("device.toml", "field_deg"))
    for title, (old, new, word) in SCENES.items():
        expected: Expected = "warned" if "1e30" in title else "refused"
        yield Case(f"scene: {title}", RENDER, FILES, replaced("scene.toml", old, new), (word,), expected)
    behind = replaced("scene.toml", "position_m = [0, 0, -1.5]", "position_m = [0, 0, 900]")
    behind = several([behind, written("behind.toml", BEHIND)])
    arguments = ("render", "device.toml", "behind.toml", *RENDER[3:])
    yield Case(
        "scene: everything behind the wearer", arguments, FILES, behind, ("nothing|Nothing|empty|no object",), "warned"
    )
    for title, (old, new, word) in BENCHES.items():
        expected = "any" if "in micrometres" in title else "refused"
        yield Case(
            f"bench: {title}",
            DIAGNOSE,
            ("bench",),
            replaced("bench/bench.toml", old, new),
            (word,) if expected == "refused" else (),
            expected,
        )
    long = written("device.toml", "a = 1\n" * 17_000_000)
    yield Case("device: 100 MB of TOML", RENDER, FILES, long, ("device.toml",))
    yield Case(
        "render: valid model", ("render", "model.json", *RENDER[2:]), ("model.json", *FILES), nothing, (), "right"
    )


BEHIND = """
format = "wlr-scene"
version = 1
frame = "openxr"

[[object]]
shape = "ball"
radius_m = 0.06
position_m = [0, 0, 5]
"""
