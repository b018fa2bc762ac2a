"""`__init__.py` files list names and hold no code; who may import whom is in pyproject.toml (import-linter)."""

import ast
from pathlib import Path

PACKAGE = Path(__file__).resolve().parent.parent / "wlr_render"


def test_init_files_only_list_names():
    for path in PACKAGE.rglob("__init__.py"):
        for node in ast.parse(path.read_text(encoding="utf-8")).body:
            assert isinstance(node, ast.Expr | ast.Import | ast.ImportFrom | ast.Assign), f"{path}: line {node.lineno}"
