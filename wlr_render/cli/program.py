"""The command line: parses, calls one study, prints. No formulas.

A new verb is one `_add_...` function, which says its options and what runs, and its place in `ADDED_BY` of its module.
"""

import argparse
import os
import sys
from collections.abc import Sequence

from wlr_render.cli import drawing, measuring, photographing
from wlr_render.cli.options import Command
from wlr_render.errors import BadInputError
from wlr_render.terminal import say


def main(arguments: Sequence[str] | None = None) -> int:
    """Run one verb; returns the exit status: 0, 2 for bad input, 130 when interrupted."""
    args = _parser().parse_args(arguments)
    # Before numpy is imported: on thin matrix products BLAS threads are slower than none, many times so on a machine
    # that is busy otherwise. Work is shared out over threads and processes elsewhere.
    os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")
    command: Command = args.command
    try:
        command(args)
    except BadInputError as error:
        if args.debug:
            raise
        say(f"wlr-render: {error}", error=True)
        return 2
    except BrokenPipeError:
        # Whoever read the output has seen enough, e.g. `| head`; Python must not complain again when it exits.
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
        return 0
    except KeyboardInterrupt:
        say("wlr-render: interrupted; what is finished is kept.", error=True)
        return 130
    return 0


def _parser() -> argparse.ArgumentParser:
    parser = argparse.ArgumentParser(
        prog="wlr-render",
        description="World-locked rendering for augmented-reality glasses.",
        epilog="HEADSET is a shipped device by name, a device file (.toml) or a fitted model (.json); SCENE a shipped "
        "scene by name, a scene file (.toml) or a mesh (.glb, .gltf, .obj, .ply). Frames, units and pixels: "
        "docs/conventions.md.",
    )
    verbs = parser.add_subparsers(required=True, metavar="VERB")
    for add in (*drawing.ADDED_BY, *photographing.ADDED_BY, *measuring.ADDED_BY):
        add(verbs)
    return parser
