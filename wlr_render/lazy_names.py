"""Lazy names of a public module: each is imported from its defining module on first use (PEP 562).

`import wlr_render` loads neither NumPy nor OpenCV; a name loads them if it needs them.
"""

import sys
from importlib import import_module

TYPE_CHECKING = False
if TYPE_CHECKING:  # `typing` is large, and every start of the program imports this module
    from collections.abc import Callable, Mapping, Sequence
    from typing import Any


def lazy_names(
    module: str, places: "Mapping[str, Sequence[str]]", submodules: "Sequence[str]" = ()
) -> "tuple[Callable[[str], Any], Callable[[], list[str]], list[str]]":
    """Return `__getattr__`, `__dir__` and `__all__` of a module.

    Args:
        module: `__name__` of the module.
        places: names by the module that defines them, without "wlr_render.". The last part of a module's path is a name
            for the module, unless the module defines that name.
        submodules: public modules of the package, imported when they are first used as attributes.
    """
    place_of = {name: place for place, names in places.items() for name in names}

    def load(name: str) -> "Any":
        if name in submodules:
            return import_module(f"{module}.{name}")
        if name not in place_of:
            raise AttributeError(f"module '{module}' has no attribute '{name}'")
        place = import_module(f"wlr_render.{place_of[name]}")
        value = getattr(place, name, place) if place.__name__.endswith(f".{name}") else getattr(place, name)
        setattr(sys.modules[module], name, value)
        return value

    return load, lambda: sorted({*vars(sys.modules[module]), *place_of}), list(place_of)
