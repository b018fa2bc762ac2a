"""`__init__.py` files hold no code; two of them are public pages. Who may import whom is in pyproject.toml."""

import ast
from pathlib import Path

PACKAGE = Path(__file__).resolve().parent.parent / "wlr_render"


PUBLIC_PAGES = {PACKAGE / "__init__.py", PACKAGE / "geometry" / "__init__.py"}  # tests/test_public_names.py


def test_init_files_only_list_names() -> None:
    for path in set(PACKAGE.rglob("__init__.py")) - PUBLIC_PAGES:
        for node in ast.parse(path.read_text(encoding="utf-8")).body:
            assert isinstance(node, ast.Expr | ast.Import | ast.ImportFrom | ast.Assign), f"{path}: line {node.lineno}"
