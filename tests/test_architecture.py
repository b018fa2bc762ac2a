"""A folder is a stage of the data flow; imports point down. docs/architecture.md has the table."""

import ast
from pathlib import Path

import pytest

PACKAGE = Path(__file__).resolve().parent.parent / "wlr_render"

LAYER = {
    "errors": 0,
    "files": 0,
    "geometry": 0,
    "numerics": 0,
    "mappings": 1,
    "optics": 2,
    "captures": 2,
    "models": 2,
    "tracking": 2,
    "simulation": 3,
    "calibration": 3,
    "rendering": 3,
    "evaluation": 4,
    "compositing": 4,
    "diagnosis": 5,
    "studies": 6,
    "terminal": 7,
    "cli": 7,
}
# Within layer 0 files imports errors and geometry imports numerics; the command line imports its terminal.
ALLOWED_SIDEWAYS = {("files", "errors"), ("geometry", "numerics"), ("cli", "terminal")}
# What a package of a lower layer must still not be seen by (the measured path never sees the truth).
FORBIDDEN = {
    "simulation": {"models"},
    "calibration": {"optics"},
    "rendering": {"optics", "captures", "models"},
    "evaluation": {"optics", "simulation", "models"},
    "compositing": {"optics", "captures", "models", "simulation", "calibration", "tracking"},
}
DOORS = {
    "moderngl": {
        "rendering/gl.py",
        "rendering/osmesa.py",
        "studies/speed/baselines.py",
        "studies/speed/baselines_warp.py",
    },
    "OpenGL": {"rendering/gl.py", "rendering/osmesa.py", "rendering/intermediate_view.py"},
    "pyrender": {"rendering/intermediate_view.py"},
    "trimesh": {"rendering/mesh_file.py"},
    "embreex": {"rendering/raytrace.py", "studies/speed/baselines.py"},
    "argparse": {"cli"},
    "rich": {"terminal"},
}
FILES = sorted(PACKAGE.rglob("*.py"))


def imports(path: Path) -> set[str]:
    found = set()
    for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
        if isinstance(node, ast.Import):
            found.update(alias.name for alias in node.names)
        elif isinstance(node, ast.ImportFrom):
            assert node.level == 0, f"{path}: write imports in full"
            found.update(f"{node.module}.{alias.name}" for alias in node.names)
    return found


def stage(path: Path) -> str:
    return path.relative_to(PACKAGE).parts[0].removesuffix(".py")


@pytest.mark.parametrize("path", FILES, ids=lambda p: str(p.relative_to(PACKAGE)))
def test_imports_point_down(path):
    own = stage(path)
    if own == "__init__":
        return
    assert own in LAYER, f"{path}: give this stage a layer here and in docs/architecture.md"
    for name in imports(path):
        parts = name.split(".")
        if parts[0] != "wlr_render":
            continue
        other = parts[1] if len(parts) > 1 else "__init__"
        if other == own or (own, other) in ALLOWED_SIDEWAYS:
            continue
        assert other in LAYER, f"{path} imports {name}"
        assert LAYER[other] < LAYER[own], f"{path} (layer {LAYER[own]}) imports {name} (layer {LAYER[other]})"
        assert other not in FORBIDDEN.get(own, ()), f"{path}: {own} must not know {other}"


@pytest.mark.parametrize("path", FILES, ids=lambda p: str(p.relative_to(PACKAGE)))
def test_each_third_party_has_one_door(path):
    place = str(path.relative_to(PACKAGE))
    for name in imports(path):
        doors = DOORS.get(name.split(".")[0])
        if doors is not None:
            assert place in doors or stage(path) in doors, f"{place} imports {name}; its door is {sorted(doors)}"


def test_init_files_only_list_names():
    for path in PACKAGE.rglob("__init__.py"):
        for node in ast.parse(path.read_text(encoding="utf-8")).body:
            assert isinstance(node, ast.Expr | ast.Import | ast.ImportFrom | ast.Assign), (
                f"{path}: {ast.dump(node)[:80]}"
            )
