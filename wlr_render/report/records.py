"""Conversion of records to JSON."""

import dataclasses
import enum
import math
from collections.abc import Mapping, Sequence, Set
from pathlib import PurePath
from typing import Any

import numpy as np


def to_jsonable(value: object) -> object:
    """Convert a record to types that JSON supports.

    Dataclasses become objects with one key per field (fields whose metadata has `"json": False` are omitted), arrays
    become nested lists, enumerations their values, and paths text. NaN and infinity become null.

    Raises:
        TypeError: a value of another type.
    """
    if value is None or isinstance(value, str | bool | int):
        return value.value if isinstance(value, enum.Enum) else value
    if isinstance(value, float | np.floating):
        return float(value) if math.isfinite(value) else None
    if isinstance(value, np.generic):
        return to_jsonable(value.item())
    if isinstance(value, enum.Enum):
        return to_jsonable(value.value)
    if isinstance(value, np.ndarray):
        return to_jsonable(value.tolist())
    if isinstance(value, PurePath):
        return str(value)
    if dataclasses.is_dataclass(value) and not isinstance(value, type):
        return {name: to_jsonable(item) for name, item in fields_of(value).items()}
    if isinstance(value, Mapping):
        return {str(key): to_jsonable(item) for key, item in value.items()}
    if isinstance(value, Sequence | Set):
        return [to_jsonable(item) for item in value]
    raise TypeError(f"cannot convert a {type(value).__name__} to JSON")


def fields_of(record: Any) -> dict[str, Any]:
    """Return the fields of a dataclass that its JSON contains, unconverted."""
    kept = [field.name for field in dataclasses.fields(record) if field.metadata.get("json", True)]
    return {name: getattr(record, name) for name in kept}
