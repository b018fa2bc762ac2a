"""Options of jobs: a frozen dataclass each, whose fields state help text, unit, range and default once.

The command line is generated from them and converts its text to their types. The dataclasses check ranges and choices,
so that scripts and the terminal get the same error messages.
"""

import contextlib
import dataclasses
import inspect
import math
import types
import typing
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any, Literal

from cyclopts import Group, Parameter, Token

from wlr_render.errors import BadInputError
from wlr_render.io.input_files import shown
from wlr_render.io.kept import file_of
from wlr_render.work.progress import Progress
from wlr_render.work.workers import WorkerPool


@dataclass(frozen=True)
class Range:
    """Limits of a number, of each number of a sequence, and of the product of the numbers of a size.

    Every option states both ends: a value beyond them is a typo, or would fill the disk or the memory.
    A value other than 0 and below `least_size` is most likely not in `unit`.
    """

    at_least: float = -math.inf
    at_most: float = math.inf
    above: float = -math.inf
    product: float = math.inf
    least_size: float = 0.0
    unit: str = ""

    def sentence(self) -> str:
        """Return the limits in words, with a question about the unit if there is one."""
        return self.short() + (" (is it in another unit?)" if self.unit else "")

    def short(self) -> str:
        """Return the limits in words as --help states them, e.g. "between 5 and 1000"."""
        unit = f" {self.unit}" if self.unit else ""
        most = f"{self.at_most:.12g}{unit}"
        if self.above > -math.inf:
            return f"a finite number above {self.above:g}" + (
                f" and at most {most}" if self.at_most < math.inf else unit
            )
        if self.at_most < math.inf:
            zero, least = ("0, or ", self.least_size) if self.least_size else ("", self.at_least)
            return f"{zero}between {least:g} and {most}"
        return f"a finite number of {self.at_least:g} or more{unit}" if self.at_least > -math.inf else "a finite number"

    def admits(self, value: float) -> bool:
        """Return whether a number lies within the limits."""
        # Compare with infinity, because `math.isfinite` fails for very large whole numbers.
        is_within = -math.inf < value < math.inf and self.at_least <= value <= self.at_most and value > self.above
        return is_within and not 0 < value < self.least_size


@dataclass(frozen=True)
class OnlyWith:
    """Condition that another option has one of these values or, without values, that it is given at all."""

    option: str
    values: tuple[object, ...] = ()


@dataclass(frozen=True)
class NoEffect:
    """Mark of an option that does not change the content of the files in a job's ledger (`io/kept.py`)."""


def described(
    text: str,
    *,
    name: str | tuple[str, ...] | None = None,
    flag: bool = False,
    many: bool = False,
    group: Group | None = None,
) -> Parameter:
    """Return the parameter of an option with its help text, under the heading `group`.

    `name` (or several) replaces the name of the field; `many` allows several values.
    """
    listed = (lambda values: " ".join(map(str, values))) if many else None
    stated = Parameter(help=text, name=name, show_default=False if flag else listed, consume_multiple=many or None)
    return stated if group is None else Parameter.combine(stated, Parameter(group=group))


def option_group(title: str, order: int) -> Group:
    """Return a heading for options in --help; headings are sorted by `order`, below options without a heading."""
    return Group(title, sort_key=order)


@Parameter(name="*")
@dataclass(frozen=True)
class Options:
    """Base of all options: checks choices and ranges, and refuses options that the others make meaningless."""

    def __init_subclass__(cls, **more: Any) -> None:
        super().__init_subclass__(**more)
        cls.__annotations__ = {name: _with_range(hint) for name, hint in inspect.get_annotations(cls).items()}

    def __post_init__(self) -> None:
        hints, annotated = (typing.get_type_hints(type(self), include_extras=extras) for extras in (False, True))
        for field in dataclasses.fields(self):
            value = getattr(self, field.name)
            self._check_choice(field.name, value, hints[field.name])
            for note in _notes(annotated[field.name]):
                if isinstance(note, Range):
                    self._check_range(field.name, value, note)
                elif isinstance(note, OnlyWith) and value != _default(field):
                    self._check_used(field.name, note)

    def recipe_values(self, sha256: Mapping[str, str] | None = None) -> dict[str, Any]:
        """Return the options that change a job's files, by flag, for `kept.recipe_of`.

        Args:
            sha256: hashes of the files that options name, by option.
        """
        hints, hashes = typing.get_type_hints(type(self), include_extras=True), sha256 or {}
        names = [each.name for each in dataclasses.fields(self) if NoEffect() not in _notes(hints[each.name])]
        values = {name: getattr(self, name) for name in names}
        stated: dict[str, Any] = {}
        for name, value in values.items():
            if isinstance(value, Options):
                stated |= value.recipe_values()
            else:
                is_file = isinstance(value, Path) or name in hashes
                stated[flag_of(type(self), name)] = file_of(value, hashes.get(name, "")) if is_file else value
        return stated

    def _check_product(self, at_most: int, what: str, *names: str) -> None:
        """Limit the product of several options.

        Raises:
            BadInputError: the product exceeds the limit.
        """
        counts = [len(each) if isinstance(each, tuple) else each for each in (getattr(self, name) for name in names)]
        if math.prod(counts) > at_most:
            flags = " x ".join(
                f"{flag_of(type(self), name)} {count}" for name, count in zip(names, counts, strict=True)
            )
            raise BadInputError(f"{flags} are {math.prod(counts)} {what}; it must be at most {at_most}.")

    def _check_choice(self, name: str, value: object, hint: object) -> None:
        several = typing.get_origin(hint) is tuple and isinstance(value, tuple)
        choices = _choices(typing.get_args(hint)[0] if several else hint)
        for each in value if several and isinstance(value, tuple) else (value,):
            if choices and each not in choices:
                known = ", ".join(str(choice) for choice in choices if choice is not None)
                raise BadInputError(f"{flag_of(type(self), name)} is {each}; choose from {known}.")

    def _check_range(self, name: str, value: object, limits: Range) -> None:
        numbers: Sequence[Any] = value if isinstance(value, Sequence) else [value]
        for number in numbers:
            if number is not None and not limits.admits(number):
                raise BadInputError(f"{flag_of(type(self), name)} is {shown(number)}; it must be {limits.sentence()}.")
        if isinstance(value, Sequence) and math.prod(numbers) > limits.product:
            size = "x".join(map(str, numbers))
            raise BadInputError(
                f"{flag_of(type(self), name)} is {size}; it must be at most {limits.product:.12g} in all."
            )

    def _check_used(self, name: str, needs: OnlyWith) -> None:
        given, needed = getattr(self, needs.option), flag_of(type(self), needs.option)
        if not needs.values:
            if not given:
                raise BadInputError(
                    f"{flag_of(type(self), name)} is used with {needed} only; leave it out, or give {needed}."
                )
        elif not any(value in needs.values for value in (given if isinstance(given, tuple) else (given,))):
            wanted = " or ".join(f"{needed} {value}" for value in needs.values)
            raise BadInputError(
                f"{flag_of(type(self), name)} is used with {wanted} only; leave it out, or give {wanted}."
            )


def flag_of(options: type[Options], field: str) -> str:
    """Return the name of an option on the command line, e.g. "--noise-arcmin"."""
    for note in _notes(typing.get_type_hints(options, include_extras=True)[field]):
        if isinstance(note, Parameter) and note.name:
            return str(next(iter(note.name)))
    return "--" + field.replace("_", "-")


def _with_range(hint: Any) -> Any:
    """Return a type whose help text, if it has one, also states its range."""
    notes = _notes(hint)
    ranges = [note.short() for note in notes if isinstance(note, Range)]
    for number, note in enumerate(notes):
        if ranges and isinstance(note, Parameter) and note.help:
            stated = Parameter.combine(note, Parameter(help=f"{note.help} Range: {ranges[0]}."))
            return Annotated[(hint.__origin__, *notes[:number], stated, *notes[number + 1 :])]
    return hint


def _notes(hint: object) -> tuple[object, ...]:
    return getattr(hint, "__metadata__", ())


def _choices(hint: object) -> tuple[object, ...]:
    """Return the values of a type that is a Literal, with or without None; empty for other types."""
    if typing.get_origin(hint) is Literal:
        return typing.get_args(hint)
    parts = typing.get_args(hint) if typing.get_origin(hint) in (typing.Union, types.UnionType) else ()
    named = [_choices(part) for part in parts if part is not type(None)]
    return (*named[0], None) if len(named) == 1 and named[0] else ()


def _default(field: "dataclasses.Field[object]") -> object:
    return field.default_factory() if field.default_factory is not dataclasses.MISSING else field.default


ProgressArgument = Annotated[Progress, Parameter(parse=False)]
"""Type of a job's `progress` argument, which the command line does not offer."""
Code = Literal["gray", "fringes", "gray-fringes"]
EyeName = Literal["left", "right"]
Eyes = Literal["left", "right", "both"]
WORK = option_group("Work", 99)
"""Group of the options that say who does the work."""
Backend = Annotated[
    Literal["auto", "egl", "osmesa", "cpu"],
    described(
        "OpenGL through EGL or OSMesa (auto: the first that opens). With cpu, or without OpenGL, frames are ray "
        "traced.",
        group=WORK,
    ),
    NoEffect(),
]
SEEDS = Range(at_least=0, at_most=2**32 - 1)
Seed = Annotated[int, described("Seed of all random numbers."), SEEDS]
WORKERS = Range(at_least=1, at_most=256)
Workers = Annotated[
    int | None,
    described("Number of processes (default: one per core, fewer where memory limits).", group=WORK),
    WORKERS,
    NoEffect(),
]
Scheduler = Annotated[
    str | None,
    described(
        "Address of a Dask scheduler, e.g. tcp://host:8786: its workers do the work, instead of processes of this "
        "machine (docs/clusters.md).",
        group=WORK,
    ),
    NoEffect(),
]

Against = Annotated[
    Path | None,
    described("Compare with this earlier report of the verb: a folder, also that of --out, or a file."),
    NoEffect(),
]
"""Type of the field `against` of the options of each verb that writes a report; `jobs/job.py` makes the comparison."""


class SpreadOptions(Options):
    """Base of the options of verbs whose work is spread over processes or machines."""

    # Only annotations: as fields of the base they would precede a verb's options. Each verb states them in place.
    workers: int | None
    scheduler: str | None

    def __post_init__(self) -> None:
        super().__post_init__()
        if self.workers is not None and self.scheduler is not None:
            raise BadInputError("--workers has no effect with --scheduler, which has its own workers; leave out one.")

    @property
    def worker_pool(self) -> WorkerPool:
        """The processes or machines that do the work."""
        return WorkerPool(self.workers, self.scheduler)


Degree = Range(at_least=1, at_most=12)
"""Limits of polynomial degrees: more only costs time."""


def described_size(text: str, *, optional: bool = False, in_mm: bool = False, group: Group | None = None) -> Parameter:
    """Return the parameter of a size option, in pixels, e.g. 1920x1080, or in millimetres, e.g. 10.1x5.7."""
    kind, wanted = (float, "mm, e.g. 10.1x5.7") if in_mm else (int, "pixels, e.g. 1280x1024")

    def converted(_: type, tokens: Sequence[Token]) -> tuple[float, ...]:
        with contextlib.suppress(ValueError):
            width, height = map(kind, tokens[0].value.lower().split("x"))
            return width, height
        raise BadInputError(f"'{tokens[0].value}' is not width and height in {wanted}.")

    stated = Parameter(
        converter=converted,
        n_tokens=1,
        accepts_keys=False,
        metavar="WxH",
        help=text,
        show_default=None if optional else lambda size: f"{size[0]}x{size[1]}",
    )
    return stated if group is None else Parameter.combine(stated, Parameter(group=group))


def eyes_of(eye: Eyes) -> tuple[EyeName, ...]:
    """Return the eyes that an `--eye` option names."""
    return ("left", "right") if eye == "both" else (eye,)


def seed_of(seed: int, eye: str, stream: int = 0) -> list[int]:
    """Return the seed of the random numbers of one eye and purpose, so that both eyes do not get mirrored noise.

    numpy ignores zeros at the end of a seed: the right eye's numbers of stream 0 are the numbers of
    `default_rng(seed)`.
    """
    return [seed, stream, ("right", "left").index(eye)]


def folder_of_eye(folder: Path, eye: EyeName, eyes: Eyes) -> Path:
    """Return the folder of one eye's files: the output folder, or its subfolder "left" or "right" for both eyes."""
    return folder / eye if eyes == "both" else folder
