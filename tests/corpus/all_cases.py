"""All cases of the corpus."""

from corpus.case import Case
from corpus.cases import (
    benches_and_devices,
    hostile_files,
    lens_files,
    meshes_and_pictures,
    models_and_captures,
    options,
    structured,
    tables,
)

MODULES = (
    benches_and_devices,
    hostile_files,
    lens_files,
    meshes_and_pictures,
    models_and_captures,
    options,
    structured,
    tables,
)


def all_cases() -> list[Case]:
    """Every case; their names differ."""
    found = [case for module in MODULES for case in module.cases()]
    names = [case.name for case in found]
    assert len(set(names)) == len(names), sorted(name for name in names if names.count(name) > 1)
    return found
