"""What the verbs of the command line share: a verb's frame, and options and checks that several have."""

import argparse
from collections.abc import Callable
from pathlib import Path
from typing import TypeAlias

Command = Callable[[argparse.Namespace], None]
Verbs: TypeAlias = "argparse._SubParsersAction[argparse.ArgumentParser]"


def new_verb(verbs: Verbs, name: str, command: Command, text: str, out: bool = True) -> argparse.ArgumentParser:
    """A verb with the options that all have; `--out` only if it writes elsewhere than where it is told to work."""
    parser: argparse.ArgumentParser = verbs.add_parser(
        name, help=text, description=text, formatter_class=argparse.ArgumentDefaultsHelpFormatter
    )
    parser.set_defaults(command=command)
    if out:
        parser.add_argument("--out", type=Path, default=Path("out") / name, help="folder for the results")
    parser.add_argument("--debug", action="store_true", help="show the traceback of a fault")
    return parser


def add_eye(parser: argparse._ActionsContainer) -> None:
    """Which eye of a headset."""
    parser.add_argument("--eye", choices=("left", "right"), default="right", help="which eye")


def add_seed(parser: argparse._ActionsContainer) -> None:
    """Of all random numbers."""
    parser.add_argument("--seed", type=seed, default=1, help="of all random numbers")


def add_backend(parser: argparse._ActionsContainer) -> None:
    """Who rasterises."""
    parser.add_argument(
        "--backend",
        choices=("auto", "egl", "osmesa", "cpu"),
        default="auto",
        help="who rasterises: OpenGL by EGL or OSMesa, or the CPU; auto takes the first that works",
    )


def count(text: str) -> int:
    """A whole number of 1 or more."""
    value = int(text)
    if value < 1:
        raise argparse.ArgumentTypeError(f"{value} is not 1 or more")
    return value


def seed(text: str) -> int:
    """A whole number of 0 or more."""
    value = int(text)
    if value < 0:
        raise argparse.ArgumentTypeError(f"{value} is not 0 or more")
    return value


def few(text: str) -> int:
    """Degrees and rays per pixel and axis: beyond this they only cost time."""
    value = count(text)
    if value > 12:
        raise argparse.ArgumentTypeError(f"{value} is more than 12")
    return value


def not_negative(text: str) -> float:
    """A finite number of 0 or more."""
    value = float(text)
    if not 0 <= value < float("inf"):
        raise argparse.ArgumentTypeError(f"{value} is not a number of 0 or more")
    return value


def size(text: str) -> tuple[int, int]:
    """Width and height, e.g. 1920x1080."""
    width, cross, height = text.lower().partition("x")
    if not (cross and width.isdigit() and height.isdigit()):
        raise argparse.ArgumentTypeError(f"'{text}' is not a width and a height, as in 1920x1080")
    return count(width), count(height)
