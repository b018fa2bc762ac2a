"""Objects that hold arrays compare by identity: `==` of arrays is no truth value, and they have no hash."""

import dataclasses
import importlib
import pkgutil
from collections.abc import Iterator
from typing import Any

import pytest

import wlr_render

PACKAGES = ("geometry", "scene", "draw", "warp", "exports", "tracking", "mappings", "jobs.frame_plan")


def modules(name: str) -> Iterator[Any]:
    module = importlib.import_module(f"{wlr_render.__name__}.{name}")
    yield module
    for found in pkgutil.iter_modules(getattr(module, "__path__", [])):
        yield from modules(f"{name}.{found.name}")


@pytest.mark.parametrize("package", PACKAGES)
def test_what_holds_arrays_compares_by_identity(package: str) -> None:
    holding = {
        each
        for module in modules(package)
        for each in vars(module).values()
        if isinstance(each, type) and dataclasses.is_dataclass(each) and each.__module__ == module.__name__
        if any(str(field.type).startswith("numpy.ndarray") for field in dataclasses.fields(each))
    }
    assert holding
    assert [each.__name__ for each in holding if each.__eq__ is not object.__eq__] == []
