"""Records: dataclasses whose annotations state how each attribute is stored in a file.

    @dataclass(frozen=True)
    class StageAxis:
        kind: Literal["linear", "rotary"] = "linear"
        sigma: Annotated[float | None, Key("sigma_deg", DEGREES, above=0, most=180)] = None
        pivot: Annotated[FloatArray | None, Key("pivot_mm", POINT, shape=(3,), most=1e4)] = None

`read_record` and `record_keys` follow these annotations, so that a key with its unit, bounds, default and frame is
stated once. A number, text, flag or path without a `Key` is stored under its own name; other attributes without one
are stored elsewhere. An attribute with a default may be omitted from a file, and is omitted in writing if it equals the
default.
"""

import dataclasses
import functools
import inspect
import types
import typing
from collections.abc import Callable, Iterable, Mapping
from dataclasses import MISSING, dataclass, fields, replace
from pathlib import Path
from typing import Annotated, Any, Literal, TypeVar

import numpy as np
from numpy.typing import NDArray

from wlr_render.io.input_files import prefix_errors, shown
from wlr_render.io.toml_files import Table

Array = NDArray[np.float64]
RecordType = TypeVar("RecordType")
_MOST_RECORDS = 100  # most records in an attribute

MM = 1e-3
"""One millimetre in metres."""
HALF_PIXEL = 0.5
"""Offset from a pixel's integer centre in a file to pixels that count from the image's outer corner."""


@dataclass(frozen=True)
class Quantity:
    """A kind of quantity, defined by its conversion between files and this library.

    Attributes:
        of_file: (value in the file, device_from_file (3, 3)) -> value of the attribute.
        to_file: the inverse conversion.
    """

    of_file: Callable[[Any, Array], Any] = lambda value, _: value
    to_file: Callable[[Any, Array], Any] = lambda value, _: value


def scaled(unit: float) -> Quantity:
    """Return the quantity of numbers in a unit of the file, such as 1e-3 for millimetres."""
    return Quantity(lambda value, _: unit * value, lambda value, _: value / unit)


PLAIN = Quantity()
LENGTH = scaled(MM)
DEGREES = Quantity(lambda value, _: np.deg2rad(value), lambda value, _: np.rad2deg(value))
POINT = Quantity(lambda value, axes: MM * axes @ value, lambda value, axes: axes.T @ value / MM)
VECTOR = Quantity(lambda value, axes: axes @ value, lambda value, axes: axes.T @ value)
TURN = Quantity(lambda value, axes: axes @ np.deg2rad(value), lambda value, axes: axes.T @ np.rad2deg(value))
MATRIX = Quantity(lambda value, axes: axes @ value @ axes.T, lambda value, axes: axes.T @ value @ axes)
CAMERA_PIXEL = Quantity(lambda value, _: value + HALF_PIXEL, lambda value, _: value - HALF_PIXEL)


@dataclass(frozen=True)
class Rule:
    """Constraint on the value of a key that bounds do not state.

    Attributes:
        demand: the constraint in words, after "must be".
        holds: whether a value of the file satisfies it.
    """

    demand: str
    holds: Callable[[Any], bool]


@dataclass(frozen=True)
class Place:
    """The place of a file: its folder, and the rotation (3, 3) from its axes to the device frame."""

    folder: Path = Path()
    axes: Array = dataclasses.field(default_factory=functools.partial(np.eye, 3))


@dataclass(frozen=True)
class Key:
    """An attribute that is stored under one key.

    Attributes:
        name: the key; by default the name of the attribute.
        quantity: unit and frame.
        shape: shape of an array: n numbers, or n lists of m numbers; -1 for any n.
        least: smallest number in the unit of the file; None: 0 for whole numbers, else -`most`.
        most: largest number; None: 10^9 for whole numbers, 10^18 for others.
        above: number that all values must exceed.
        digits: number of decimals written; None for all.
        choices: allowed texts; by default the values of a Literal annotation.
        rule: a further constraint.
        always: whether the default is also written.
        type: type of the value in the file, `list` for texts; by default the annotation, without None.
    """

    name: str = ""
    quantity: Quantity = PLAIN
    _: dataclasses.KW_ONLY
    shape: tuple[int, ...] = ()
    least: float | None = None
    most: float | None = None
    above: float | None = None
    digits: int | None = None
    choices: tuple[str, ...] | None = None
    rule: Rule | None = None
    always: bool = False
    type: Any = None

    @property
    def names(self) -> tuple[str, ...]:
        """The key."""
        return (self.name,)

    def read(self, table: Table, place: Place) -> Any:
        """Return the value of the attribute in this library's units and frame.

        Raises:
            BadInputError: the key is missing or faulty; the sentence names it.
        """
        stated = self._stated(table, place)
        if self.rule is not None and not self.rule.holds(stated):
            in_words = shown(stated.tolist() if isinstance(stated, np.ndarray) else stated)
            raise table.fail(f"'{self.name}' is {in_words}; it must be {self.rule.demand}.")
        value = self.quantity.of_file(stated, place.axes)
        return float(value) if isinstance(value, np.floating) else value

    def keys(self, value: Any, place: Place) -> dict[str, Any]:
        """Return the key of a value, the inverse of `read`."""
        in_file = self.quantity.to_file(value, place.axes)
        if isinstance(in_file, Path):
            in_file = str(in_file.relative_to(place.folder) if in_file.is_relative_to(place.folder) else in_file)
        elif isinstance(in_file, np.ndarray | np.number | float | tuple):
            rounded = in_file if self.digits is None else np.round(in_file, self.digits)
            in_file = (np.asarray(rounded, dtype=self.type if self.type is int else None) + 0).tolist()  # no -0.0
        return {self.name: in_file}

    def _stated(self, table: Table, place: Place) -> Any:
        name, origin, items = self.name, typing.get_origin(self.type), typing.get_args(self.type)
        if self.type is bool:
            return table.flag(name, False)
        if self.type is Path:
            return table.path(name, place.folder)
        if self.type is list:
            return table.texts(name)
        if self.type is str or origin is Literal:
            return table.text(name, choices=self.choices or items or None)
        bounds: dict[str, Any] = {
            end: bound for end in ("least", "most", "above") if (bound := getattr(self, end)) is not None
        }
        if self.type is int:
            return table.whole(name, **bounds)
        if self.most is not None:
            bounds.setdefault("least", -self.most)
        if origin is tuple:
            return _as_tuple(items, table, name, bounds)
        match self.shape:
            case ():
                return table.number(name, **bounds)
            case (-1,):
                return table.numbers(name, **bounds)
            case (size,):
                return table.vector(name, size, **bounds)
        return table.vectors(name, self.shape[1], max(self.shape[0], 0) or None, **bounds)


def _as_tuple(items: Any, table: Table, name: str, bounds: Mapping[str, Any]) -> tuple[Any, ...]:
    """Return numbers, or rows of numbers, as a tuple of the types `items`."""
    if columns := typing.get_args(items[0]):
        return tuple(map(tuple, table.vectors(name, len(columns), **bounds).tolist()))
    values = table.numbers(name, **bounds) if items[-1] is ... else table.vector(name, len(items), **bounds)
    if items[0] is int and np.any(values != np.round(values)):
        raise table.fail(f"'{name}' must be whole numbers, not {values.tolist()}.")
    return tuple(map(items[0], values.tolist()))


@dataclass(frozen=True)
class Keys:
    """An attribute that is stored under several keys.

    Attributes:
        parts: the keys.
        join: (value of each part) -> value.
        split: value -> value of each part; the inverse of `join`.
        absent: value of each part that may be omitted from a file, and is omitted in writing; None if no part may be.
    """

    parts: tuple[Key, ...]
    join: Callable[..., Any]
    split: Callable[[Any], Iterable[Any]]
    absent: Any = None

    @property
    def names(self) -> tuple[str, ...]:
        """The keys."""
        return tuple(part.name for part in self.parts)

    def read(self, table: Table, place: Place) -> Any:
        """Return the value; raises as `Key.read`."""
        needed = self.absent is None
        parts = [part.read(table, place) if needed or table.has(part.name) else self.absent for part in self.parts]
        with prefix_errors(table.where):
            return self.join(*parts)

    def keys(self, value: Any, place: Place) -> dict[str, Any]:
        """Return the keys of a value, the inverse of `read`."""
        parts = zip(self.parts, self.split(value), strict=True)
        written = (part.keys(each, place) for part, each in parts if not np.array_equal(each, self.absent))
        return {name: each for keys in written for name, each in keys.items()}


ELSEWHERE = "elsewhere"
"""Mark of an attribute that the record's table does not state."""


@dataclass(frozen=True)
class Attribute:
    """An attribute of a record: its name, its form in a file, and its default (MISSING without one)."""

    name: str
    form: Key | Keys
    default: Any


@functools.cache
def attributes(kind: type) -> tuple[Attribute, ...]:
    """Return the attributes of a record in the order of its file: first its own, then its bases'."""
    hints, own = typing.get_type_hints(kind, include_extras=True), {each.name: each for each in fields(kind)}
    names = dict.fromkeys(name for base in kind.__mro__ for name in inspect.get_annotations(base) if name in own)
    forms = {name: form for name in names if (form := _form_of(name, hints[name])) is not None}
    made = {name: own[name].default_factory for name in forms}
    defaults = {name: own[name].default if make is MISSING else make() for name, make in made.items()}
    return tuple(Attribute(name, form, defaults[name]) for name, form in forms.items())


def _form_of(name: str, hint: Any) -> Key | Keys | None:
    """Return the form of an attribute by its type hint; None for `ELSEWHERE`."""
    is_marked = typing.get_origin(hint) is Annotated
    kind, mark = (hint.__origin__, hint.__metadata__[0]) if is_marked else (hint, Key())
    if typing.get_origin(kind) in (typing.Union, types.UnionType):
        (kind,) = (each for each in typing.get_args(kind) if each is not types.NoneType)
    if mark is ELSEWHERE or not (is_marked or _is_plain(kind)):
        return None
    return replace(mark, name=mark.name or name, type=mark.type or kind) if isinstance(mark, Key) else mark


def _is_plain(kind: Any) -> bool:
    """Return whether values of a type are stored in a file unchanged."""
    items = typing.get_args(kind) if typing.get_origin(kind) is tuple else (kind,)
    return all(
        item in (bool, int, float, str, Path, ...) or typing.get_origin(item) in (Literal, tuple) for item in items
    )


def read_record(kind: type[RecordType], table: Table, place: Place | None = None, /, **given: Any) -> RecordType:
    """Return the record that a table states; every key must be known.

    Args:
        kind: a dataclass.
        table: the table, which is finished.
        place: folder and axes of the file.
        given: attributes that the caller knows.

    Raises:
        BadInputError: a key is missing, unknown or faulty; the sentence names it.
    """
    record = read_part(kind, table, place, **given)
    table.finish()
    return record


def read_part(kind: type[RecordType], table: Table, place: Place | None = None, /, **given: Any) -> RecordType:
    """Return a record like `read_record`; other keys of the table are left to the caller."""
    stated = {
        each.name: each.form.read(table, place or Place())
        for each in attributes(typing.cast(Any, kind))
        if each.name not in given and (each.default is MISSING or any(map(table.has, each.form.names)))
    }
    with prefix_errors(table.where):
        return kind(**given, **stated)


def record_keys(record: Any, place: Place | None = None, defaults: bool = False) -> dict[str, Any]:
    """Return the keys that `read_record` reads; `defaults` includes attributes that equal their default."""
    keys: dict[str, Any] = {}
    for each in attributes(typing.cast(Any, type(record))):
        value = getattr(record, each.name)
        is_default = each.default is not MISSING and np.array_equal(value, each.default)
        if value is not None and (defaults or not is_default or getattr(each.form, "always", False)):
            keys |= each.form.keys(value, place or Place())
    return keys


@dataclass(frozen=True)
class Records(Key):
    """A tuple of records, stored as an array of tables."""

    record: Any = None

    def read(self, table: Table, place: Place) -> tuple[Any, ...]:
        """Return the records; raises as `Key.read`."""
        return tuple(read_record(self.record, each, place) for each in table.tables(self.name, most=_MOST_RECORDS))

    def keys(self, value: tuple[Any, ...], place: Place) -> dict[str, Any]:
        """Return the tables, the inverse of `read`."""
        return {self.name: [record_keys(each, place) for each in value]}
