"""The public names: what they are, that they load and are documented, and that examples and documents use no others."""

import ast
import inspect
import json
import re
import subprocess
import sys
from collections.abc import Iterator
from importlib import import_module
from pathlib import Path
from typing import Any

import pytest
from present import narrowed, present

import wlr_render as wlr
from wlr_render.gl.context import GlContext

ROOT = Path(__file__).resolve().parent.parent
NAMES = (
    *("open_eye", "Eye", "Status", "load_captures", "load_session", "simulate", "Captures", "calibrate", "Calibration"),
    *("compare", "ErrorMap", "ErrorSizes", "diagnose", "Diagnosis", "Cause", "load_scene", "render", "Frame"),
    *("world_rays", "export", "Compositor", "WarpMesh", "StoredDepth", "ViewpointFilter", "RotatingEye"),
    "BadInputError",
)
MODULES = ("wlr_render", "wlr_render.engine", "wlr_render.files", "wlr_render.geometry")
CONSTANTS = {"PANEL_KEPT"}
BLOCK = re.compile(r"^```python\n(.*?)^```", re.DOTALL | re.MULTILINE)
IMPORT = re.compile(r"^\s*(?:from|import) wlr_render\b.*$", re.MULTILINE)
API = (ROOT / "docs" / "api.md").read_text(encoding="utf-8")


def users_code() -> Iterator[tuple[str, str]]:
    """The Python code that users copy, by where it stands."""
    for path in sorted((ROOT / "examples").glob("*.py")):
        yield path.name, path.read_text(encoding="utf-8")
    for path in sorted((ROOT / "examples" / "notebooks").glob("*.ipynb")):
        cells = json.loads(path.read_text(encoding="utf-8"))["cells"]
        yield path.name, "\n".join("".join(cell["source"]) for cell in cells if cell["cell_type"] == "code")
    for path in [ROOT / "README.md", *sorted((ROOT / "docs").glob("*.md"))]:
        for number, block in enumerate(BLOCK.findall(path.read_text(encoding="utf-8"))):
            yield f"{path.name}-{number}", block


CODE = dict(users_code())
PROGRAMS = BLOCK.findall(API)
ARE_EXAMPLES = {0: "01_world_rays", 1: "02_calibrate", 3: "05_diagnose"}  # which tests/test_examples.py runs


def names_of_static_imports(module: str) -> dict[Any, Any]:
    """Names and their modules as type checkers and editors see them."""
    tree = ast.parse(Path(present(import_module(module).__file__)).read_text(encoding="utf-8"))
    branch = next(node for node in tree.body if isinstance(node, ast.If))
    imports = [narrowed(node, ast.ImportFrom) for node in branch.body]
    return {alias.asname: (node.module, alias.name) for node in imports for alias in node.names}


def test_the_package_has_the_names_of_the_plan() -> None:
    assert sorted(vars(wlr)["__all__"]) == sorted(NAMES)
    assert set(NAMES) <= set(dir(wlr))


@pytest.mark.parametrize("module", MODULES[1:])
def test_the_other_public_modules_are_attributes_of_the_package(module: str) -> None:
    """Also in a process that has not imported them."""
    assert wlr.__getattr__(module.partition(".")[2]) is import_module(module)


@pytest.mark.parametrize("module", MODULES)
def test_editors_see_the_names_that_load(module: str) -> None:
    public, static = import_module(module), names_of_static_imports(module)
    assert sorted(static) == sorted(public.__all__)
    for name, (place, original) in static.items():
        home = import_module(place)
        expected = getattr(home, original) if hasattr(home, original) else import_module(f"{place}.{original}")
        assert getattr(public, name) is expected, name


@pytest.mark.parametrize("module", MODULES)
def test_every_name_has_a_docstring(module: str) -> None:
    public = import_module(module)
    missing = [name for name in public.__all__ if name not in CONSTANTS and not inspect.getdoc(getattr(public, name))]
    assert not missing


@pytest.mark.parametrize("module", MODULES)
def test_the_document_lists_every_name(module: str) -> None:
    lost = [name for name in import_module(module).__all__ if f"`{name}`" not in API]
    assert not lost


@pytest.mark.parametrize("name", ["open_eyes", "files_", "__wrapped__"])
def test_another_name_is_an_attribute_error(name: str) -> None:
    with pytest.raises(AttributeError, match=f"module 'wlr_render' has no attribute '{name}'"):
        getattr(wlr, name)


def test_the_import_loads_no_large_library() -> None:
    """Of a fresh process: `import wlr_render` takes a few milliseconds."""
    script = "import sys, wlr_render; print(*{name.partition('.')[0] for name in sys.modules})"
    loaded = subprocess.run([sys.executable, "-c", script], capture_output=True, text=True, check=True).stdout.split()
    assert "wlr_render" in loaded
    assert not {"numpy", "scipy", "cv2", "moderngl", "trimesh", "matplotlib", "cyclopts", "rich"} & set(loaded)


START = """
import sys, importlib
from flat_image import flat_image_eye
from wlr_render import WarpMesh, cli

def rooms():
    return {".".join(name.split(".")[:2]) for name in sys.modules if name.startswith("scipy.")}

for verb in cli.VERBS:
    importlib.import_module("wlr_render.jobs." + verb.function.partition(":")[0])
print(*rooms() & {"scipy.linalg", "scipy.optimize", "scipy.signal", "scipy.sparse", "scipy.spatial", "scipy.stats"})
WarpMesh(flat_image_eye(), (64, 48))
print("scipy.spatial" in rooms())
"""


@pytest.mark.slow
def test_verbs_start_without_scipy_and_no_frame_waits_for_it() -> None:
    """SciPy's subpackages take up to 4 s to load, longer than most refusals and small jobs take."""
    printed = subprocess.run([sys.executable, "-c", START], capture_output=True, text=True, cwd=ROOT / "tests")
    assert printed.stdout.splitlines() == ["", "True"], printed.stderr


@pytest.mark.parametrize("where", CODE)
def test_code_for_users_imports_public_names_only(where: str) -> None:
    source = CODE[where]
    lines = [line for line in IMPORT.findall(source) if not line.rstrip().endswith("(")]
    found = [node for line in lines for node in ast.parse(line.strip()).body]
    if where.endswith(".py") or where.endswith(".ipynb"):
        found = list(ast.walk(ast.parse(source)))
    for node in found:
        if isinstance(node, ast.Import):
            assert {alias.name for alias in node.names if alias.name.startswith("wlr_render")} <= set(MODULES)
        if isinstance(node, ast.ImportFrom) and (node.module or "").startswith("wlr_render"):
            assert node.module in MODULES
            assert {alias.name for alias in node.names} <= set(import_module(node.module).__all__)
    used = set(re.findall(r"\bwlr\.(\w+)", source))
    assert used <= set(NAMES) | {"__all__"}


def code_only(source: str) -> str:
    """A program without its docstring, comments and empty lines."""
    tree = ast.parse(source)
    body = [node for node in tree.body if not (isinstance(node, ast.Expr) and isinstance(node.value, ast.Constant))]
    return ast.unparse(ast.Module(body, []))


def test_there_are_five_programs_of_at_most_nine_lines() -> None:
    assert len(PROGRAMS) == 5
    assert max(len(program.splitlines()) for program in PROGRAMS) <= 9
    assert BLOCK.findall((ROOT / "README.md").read_text(encoding="utf-8")) == PROGRAMS


@pytest.mark.parametrize("number", ARE_EXAMPLES)
def test_programs_are_the_first_examples(number: int) -> None:
    example = CODE[f"{ARE_EXAMPLES[number]}.py"].replace("from pathlib import Path\n", "")
    example = example.replace('Path(__file__).parent / "data" / "session"', '"examples/data/session"')
    assert code_only(PROGRAMS[number]) == code_only(example)


@pytest.fixture(scope="module")
def fitted(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder with a fitted model, of few captures."""
    folder = tmp_path_factory.mktemp("programs")
    captures = wlr.simulate(wlr.open_eye("birdbath28"), positions=9, grid=(9, 7))
    captures.save(folder / "captures.npz")
    wlr.calibrate(wlr.load_captures(folder / "captures.npz"), "static").save(folder / "birdbath28.json")
    return folder


@pytest.mark.slow
def test_the_program_that_draws(
    fitted: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.chdir(fitted)
    exec(PROGRAMS[2], {})
    assert re.fullmatch(r"predicted registration error \d+\.\d+ arcmin rms\n", capsys.readouterr().out)
    assert (fitted / "panel.png").stat().st_size > 10_000


@pytest.mark.gl
def test_the_program_of_a_render_engine(fitted: Path, gl_context: GlContext, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(fitted)
    names: dict[str, Any] = {}
    exec(PROGRAMS[4], names)
    assert names["panel"].shape == (480, 640, 3)
    assert (names["panel"] == 128).any()


@pytest.mark.slow
def test_an_export_is_named_after_the_eye_and_unknown_choices_are_refused(tmp_path: Path) -> None:
    eye = wlr.open_eye("birdbath28")
    (path,) = (path for path in wlr.export(eye, tmp_path, "npz") if path.suffix == ".npz")
    assert path.name == "right-rays.npz"
    with pytest.raises(wlr.BadInputError, match="format is 'monado'; choose from stmap"):
        wlr.export(eye, tmp_path, "monado")
    with pytest.raises(wlr.BadInputError, match="method is 'rastr'; choose from raytrace, raster"):
        wlr.render(eye, wlr.load_scene("desk"), method="rastr")  # type: ignore[arg-type]  # a wrong word is refused
