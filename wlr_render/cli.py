"""Command line: verbs generated from the options of the jobs.

A new verb is a job (options, function, report) and its help text in `HELP`.
"""

import contextlib
import difflib
import os
import re
import sys
import traceback
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, get_args

from cyclopts import (
    App,
    CycloptsError,
    Group,
    MissingArgumentError,
    Parameter,
    Token,
    UnknownCommandError,
    UnusedCliTokensError,
    convert,
)

from wlr_render import __version__
from wlr_render.errors import BadInputError, Terminated

PROGRAM = "wlr-render"
LONGEST_SENTENCE = 960
"""Largest length of an error message in characters: room for the names of all causes or methods."""
START, HEADSET, LAB, MODELS, PICTURES = GROUPS = "Start", "Headset", "Lab", "Models", "Pictures"


@dataclass(frozen=True)
class Verb:
    """A verb: its name on the command line, its group in --help, and its help text."""

    words: str
    group: str
    help: str

    @property
    def function(self) -> str:
        """Module in `wlr_render.jobs` and name of the function that the verb calls, e.g. "trace:trace"."""
        name = self.words.replace("-", "_")
        return f"{_MODULES.get(name, name)}:{name}"


_MODULES = {"plan": "plan.plan", "board": "print_board", "pattern": "show_pattern", "calibrate": "calibrate.calibrate"}
"""Modules of the verbs that have another name than their module."""
HELP = {
    START: {"demo": "Draw a scene four ways for one headset and measure the misalignment of each."},
    HEADSET: {
        "trace": "Draw a device with its rays and tabulate its optical figures.",
        "import-lens": "Convert a lens file of Zemax, CODE V, Optiland or rayoptics into a device file.",
    },
    LAB: {
        "plan": "Plan a session: where to put the camera, and how many photographs reach an accuracy.",
        "board": "Design a calibration board and write it for printing and for calibration.",
        "pattern": "Write the pictures of a panel code with a page that shows them, or photograph each with your "
        "camera.",
        "decode": "Decode photographs of a panel or projector that shows a code.",
        "simulate": "Simulate a session of photographs, as a lab would deliver it.",
    },
    MODELS: {
        "calibrate": "Fit the models of one or both eyes to photographs, a bench session, captures or alignments, or "
        "to a simulated device.",
        "verify": "Measure the misalignment in your own photographs of the drawn target, display off and on.",
        "budget": "State the error budget of a headset: arcminutes by source, pixel by pixel, and what to improve "
        "first.",
        "diagnose": "Compare a measured session with the bench model, find the physical causes of any difference, and "
        "write a corrected bench model.",
        "predict": "Predict the captures of a session with a bench model found elsewhere, e.g. the corrected bench of "
        "another session.",
    },
    PICTURES: {
        "render": "Draw the frames of one or both eyes for a still or moving wearer; pack them as a data set.",
        "export": "Write a headset's warp maps or its model for other programs, with a page that explains the files.",
    },
}
VERBS = tuple(Verb(words, group, text) for group, verbs in HELP.items() for words, text in verbs.items())

RENAMED = {
    "calibrate photos": "calibrate PATH",
    "calibrate captures": "calibrate PATH",
    "calibrate simulate": "calibrate PATH",
    "capture": "pattern --photograph COMMAND",
    "compare": "bench raster",
    "evaluate": "plan DEVICE",
    "hold-out": "diagnose SESSION --hold-out",
    "import": "bench published-data",
    "import-optics": "import-lens FILE",
    "pack": "render HEADSET SCENE --pack webdataset|huggingface",
    "verify pairs": "verify PHOTOGRAPHS BOARD",
    "verify session": "bench simulated-lab --part registration --session SESSION",
}
"""Earlier names of verbs, and their names now; `bench` is a command of a checkout's ./wlr."""

OUTSIDE = "--outside-references"
DEBUG_NOTE = (
    f"Add --debug to any verb for a traceback, and {OUTSIDE} if you trust your files to name files of other folders."
)
EPILOGUE = (
    "HEADSET is a shipped device by name, a device file (.toml) or a fitted model (.json). SCENE is a shipped scene by "
    f"name, a scene file (.toml) or a mesh (.glb, .gltf, .obj, .ply, .stl). {DEBUG_NOTE}"
)


def main(arguments: Sequence[str] | None = None) -> int:
    """Run one verb and return the exit status: 0, 2 for bad input, 1 for a defect, 130 or 143 when interrupted."""
    return run_app(make_app, arguments)


def run_app(make: Callable[[], App], arguments: Sequence[str] | None) -> int:
    """Run one command of an app whose commands are jobs, and return the exit status like `main`."""
    tokens = list(sys.argv[1:] if arguments is None else arguments)
    debug, outside = "--debug" in tokens, OUTSIDE in tokens
    tokens = [token for token in tokens if token not in ("--debug", OUTSIDE)] or ["--help"]
    # Set before numpy is imported: BLAS threads slow thin matrix products down, on a busy machine many times over.
    # Other code distributes work over threads and processes.
    os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")
    app = make()
    try:
        _refuse_empty(tokens)
        if app.name[0] == PROGRAM:
            _refuse_renamed(tokens)
        if outside:
            from wlr_render.io.input_files import outside_references

            with outside_references():
                return _run(app, tokens, debug)
        return _run(app, tokens, debug)
    except BrokenPipeError:
        # The reader has closed the pipe, e.g. `| head`; Python must not report it again at exit.
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
        return 0
    except Terminated:
        return _refuse(app, "terminated; finished files are kept.", 143)
    except KeyboardInterrupt:
        return _refuse(app, "interrupted; finished files are kept.", 130)
    except Exception as error:
        if debug:
            raise
        return _refuse(app, _sentence(error), 2 if _is_of_the_input(error) else 1)


def _refuse_empty(tokens: Sequence[str]) -> None:
    """Reject empty option values: an empty path would mean the current folder."""
    for before, token in zip(("", *tokens), tokens, strict=False):
        name, _, value = (before, "", token) if before.startswith("--") and "=" not in before else token.partition("=")
        if name.startswith("--") and not value.strip() and token != name:
            raise BadInputError(f"{name} is empty; give it a value, or leave it out.")


def _refuse_renamed(tokens: Sequence[str]) -> None:
    """Reject a verb of an earlier version, with a message that names its replacement."""
    for words in (tokens[:2], tokens[:1]):
        new = RENAMED.get(" ".join(words))
        if new is None or (len(words) > 1 and Path(words[1]).exists()):
            continue
        command = f"./wlr {new}, in a checkout of the source" if new.startswith("bench ") else f"{PROGRAM} {new}"
        raise BadInputError(f"'{' '.join(words)}' has another name now: {command}.")


def make_app() -> App:
    """Return the parser of the command line; a verb's module is imported when the verb is used."""
    app = App(
        name=PROGRAM,
        help="World-locked rendering for augmented-reality glasses.",
        help_epilogue=EPILOGUE,
        help_format="plaintext",
        version=__version__,
        version_flags=["--version"],
        default_parameter=Parameter(negative=(), converter=_converted),
    )
    groups = {title: Group(title, sort_key=order) for order, title in enumerate(GROUPS)}
    for verb in VERBS:
        note = EPILOGUE if verb.words in ("render", "export") else DEBUG_NOTE
        function, group = f"wlr_render.jobs.{verb.function}", groups[verb.group]
        app.command(function, name=verb.words, help=verb.help, group=group, help_epilogue=note)
    app.register_install_completion_command()
    return app


def _converted(kind: Any, tokens: Sequence[Token]) -> Any:
    """Convert the text of an option to its type as cyclopts does, but refuse e.g. 1.5 for a whole number."""
    kinds = {kind, *get_args(kind)}
    for token in tokens:
        if int in kinds and not kinds & {float, str} and not re.fullmatch(r"[+-]?[0-9]+", token.value):
            raise ValueError(f"'{token.value}' is not a whole number.")  # cyclopts names the option
    return convert(kind, tokens)


def _run(app: App, tokens: Sequence[str], debug: bool) -> int:
    command, bound, ignored = app.parse_args(tokens, exit_on_error=False, print_error=False)
    if "progress" not in ignored:
        command(*bound.args, **bound.kwargs)  # --help, --version and completion
        return 0
    from wlr_render.library_output import silenced_libraries
    from wlr_render.report.terminal import print_report, terminal_progress

    with contextlib.nullcontext() if debug else silenced_libraries(), terminal_progress() as progress:
        report = command(*bound.args, **bound.kwargs, progress=progress)
    print_report(report)
    if report.faults:
        return _refuse(app, f"{len(report.faults)} faulty item(s) were left out: {', '.join(report.faults)}.", 2)
    return 0


def _is_of_the_input(error: Exception) -> bool:
    """Return whether the user can fix the cause of an exception; other exceptions are defects of the program.

    Of operating system errors, the user can fix file and disk errors. The program must handle failing connections
    and processes itself.
    """
    from socket import gaierror  # imported only when needed, because --help must be quick

    elsewhere = (ConnectionError, TimeoutError, ChildProcessError, ProcessLookupError, gaierror)
    if isinstance(error, elsewhere) and error.filename is None:
        return False
    return isinstance(error, BadInputError | CycloptsError | MemoryError | OSError)


def _sentence(error: Exception) -> str:
    if isinstance(error, UnusedCliTokensError):
        return (
            f"Unexpected argument '{' '.join(error.unused_tokens or ())}'; add --help for the arguments of this verb."
        )
    if isinstance(error, MissingArgumentError) and error.argument is not None and error.keyword is None:
        name = error.argument.name  # --help shows an argument without a dash in capitals
        name = name if error.argument.field_info.is_keyword_only else name.lstrip("-").upper()
        hint = f" Did you{str(error).partition('Did you')[2]}" if "Did you" in str(error) else ""
        return f"{' '.join(error.command_chain or ())} needs {name}; add --help for the arguments of this verb.{hint}"
    if isinstance(error, UnknownCommandError) and error.app is not None:
        # The parser's own sentence would import the modules of all verbs.
        token, verbs = (error.unused_tokens or [""])[0], [name for name in error.app if not name.startswith("-")]
        close = difflib.get_close_matches(token, verbs, 1)
        hint = f' Did you mean "{close[0]}"?' if close else ""
        return f'Unknown command "{token}".{hint} Choose from {", ".join(verbs)}.'
    if isinstance(error, BadInputError | CycloptsError):
        return str(error)
    if isinstance(error, MemoryError):
        return "The memory of this machine is too small for this job; ask for fewer or smaller items."
    if isinstance(error, OSError) and _is_of_the_input(error):
        return f"{error.filename or 'A file'}: cannot be read or written ({error.strerror or error})."
    place = traceback.extract_tb(error.__traceback__)[-1]
    return (
        f"This is a defect of the program: {type(error).__name__} in {Path(place.filename).name}, line {place.lineno} "
        f"({' '.join(str(error).split())[:200]}). Please report it where you got {PROGRAM}, with the output of the "
        "same command and --debug."
    )


def _refuse(app: App, sentence: str, status: int) -> int:
    from wlr_render.report.terminal import say

    if len(sentence) > LONGEST_SENTENCE:  # it repeats a long argument or name
        sentence = f"{sentence[: LONGEST_SENTENCE // 2]} ... {sentence[-LONGEST_SENTENCE // 2 :]}"
    with contextlib.suppress(OSError):  # standard error may be closed
        say(f"{app.name[0]}: {sentence}", error=True)
    return status


if __name__ == "__main__":
    sys.exit(main())
