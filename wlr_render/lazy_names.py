"""Lazy names of a public module: each is imported from its defining module on first use (PEP 562).

A module states its names once, as the imports that type checkers and editors read. `import wlr_render` loads neither
NumPy nor OpenCV; a name loads them if it needs them.
"""

import sys
from importlib import import_module

TYPE_CHECKING = False
if TYPE_CHECKING:  # `typing` is large, and every start of the program imports this module
    from collections.abc import Callable, Sequence
    from typing import Any


def lazy_names(
    module: str, path: str, submodules: "Sequence[str]" = ()
) -> "tuple[Callable[[str], Any], Callable[[], list[str]], list[str]]":
    """Return `__getattr__`, `__dir__` and `__all__` of a module.

    Args:
        module: `__name__` of the module.
        path: its source, whose indented lines `from PLACE import NAME as NAME, ...` state the names.
        submodules: public modules of the package, imported when they are first used as attributes.
    """
    place_of: dict[str, str] = {}
    with open(path, encoding="utf-8") as source:
        for line in source:
            if line.startswith("    from "):
                place, _, names = line.removeprefix("    from ").partition(" import ")
                place_of |= {each.split(" as ")[0]: place for each in names.strip().split(", ")}

    def load(name: str) -> "Any":
        if name in submodules:
            return import_module(f"{module}.{name}")
        if name not in place_of:
            raise AttributeError(f"module '{module}' has no attribute '{name}'")
        place = place_of[name]
        value = import_module(f"{place}.{name}") if place == module else getattr(import_module(place), name)
        setattr(sys.modules[module], name, value)
        return value

    return load, lambda: sorted({*vars(sys.modules[module]), *place_of}), list(place_of)
