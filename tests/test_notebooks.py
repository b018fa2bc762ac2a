"""The notebooks run as they stand, hold no outputs, and their text states no number that a cell does not print."""

import os
import re
import shutil
from pathlib import Path
from typing import Any

import nbformat
import pytest
from nbclient import NotebookClient

EXAMPLES = Path(__file__).resolve().parent.parent / "examples"
NOTEBOOKS = sorted((EXAMPLES / "notebooks").glob("*.ipynb"))
PICTURES = {"01_calibrate_and_render": 2, "02_diagnose_a_bench": 1, "03_error_budget": 2}
WORDS = {
    "01_calibrate_and_render": ["Model of northstar", "our model, pupil near a corner: 0.0", "arcmin in the median"],
    "02_diagnose_a_bench": ["Explained: printed size of the target", "[target] scale = [0.997"],
    "03_error_budget": ["arcmin rms at 1 m", "Improve this first: head tracker: noise"],
}
NBFORMAT: Any = nbformat  # has no types
CODE_OR_LINK = re.compile(r"`[^`]*`|\]\([^)]*\)")
NUMBER = re.compile(r"\d+(?:\.\d+)?")


def read(path: Path) -> Any:
    return NBFORMAT.read(path, as_version=4)


def stated_numbers(notebook: Any) -> set[Any]:
    text = "\n".join(cell.source for cell in notebook.cells if cell.cell_type == "markdown")
    return set(NUMBER.findall(CODE_OR_LINK.sub("", text)))


def shown(notebook: Any) -> tuple[str, int]:
    """Text and pictures that the cells of a notebook show."""
    texts, pictures = [], 0
    for output in (output for cell in notebook.cells for output in cell.get("outputs", [])):
        data = output.get("data", {})
        pictures += "image/png" in data
        texts.append(output.get("text") or data.get("text/html") or data.get("text/plain", ""))
    return "\n".join(texts), pictures


@pytest.mark.parametrize("path", NOTEBOOKS, ids=lambda path: path.stem)
def test_a_notebook_holds_no_outputs_and_is_valid(path: Path) -> None:
    notebook = read(path)
    nbformat.validate(notebook)
    code = [cell for cell in notebook.cells if cell.cell_type == "code"]
    assert all(cell.outputs == [] and cell.execution_count is None for cell in code)
    assert notebook.metadata.keys() == {"kernelspec", "language_info"}


@pytest.mark.slow
@pytest.mark.parametrize("path", NOTEBOOKS, ids=lambda path: path.stem)
def test_a_notebook_runs_and_prints_the_numbers_of_its_text(path: Path, tmp_path: Path) -> None:
    shutil.copytree(EXAMPLES / "data", tmp_path / "data")
    folder = tmp_path / "notebooks"
    folder.mkdir()
    notebook = read(path)
    environment = os.environ | {"OPENBLAS_NUM_THREADS": "1", "IPYTHONDIR": str(tmp_path / "ipython")}
    NotebookClient(notebook, timeout=300, resources={"metadata": {"path": str(folder)}}).execute(env=environment)
    text, pictures = shown(notebook)
    for words in WORDS[path.stem]:
        assert words in text
    assert pictures == PICTURES[path.stem]
    assert stated_numbers(notebook) <= set(NUMBER.findall(text))
    assert {entry.name for entry in folder.iterdir()} <= {"out"}


def test_every_notebook_is_tested() -> None:
    assert {path.stem for path in NOTEBOOKS} == set(WORDS)
