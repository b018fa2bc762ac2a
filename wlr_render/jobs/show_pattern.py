"""Write the pictures of a panel code, or show them one by one and photograph each with the camera's own program."""

import contextlib
import os
import shlex
import shutil
import subprocess
import tempfile
import time
from dataclasses import KW_ONLY, dataclass
from pathlib import Path
from typing import Annotated, Literal

from wlr_render.captures.patterns.catalogue import make_pattern
from wlr_render.captures.patterns.show_page import PAGE, write_show_page
from wlr_render.captures.patterns.show_server import ShowServer
from wlr_render.captures.photographs import SUFFIXES
from wlr_render.errors import BadInputError
from wlr_render.io.atomic_files import output_folder
from wlr_render.io.input_files import shown
from wlr_render.io.kept import Kept, recipe_of, signatures_of
from wlr_render.jobs import limits
from wlr_render.jobs.job import job
from wlr_render.jobs.options import (
    Code,
    NoEffect,
    OnlyWith,
    Options,
    ProgressArgument,
    Range,
    described,
    described_size,
    option_group,
)
from wlr_render.jobs.simulate import retaken_warnings
from wlr_render.mappings import Panel
from wlr_render.report.blocks import Report
from wlr_render.work.progress import SILENT, Progress

_LOOK_S = 0.1
_STABLE_S = 0.4  # time without a change after which a file is complete: no camera program pauses for so long
_CAMERA = option_group("Photographs", 1)
_BLACK_S = 2.0  # longest wait for a black page at the end
Suffix = Literal[".png", ".tif", ".tiff", ".bmp", ".pgm", ".jpg", ".npy", ".dng"]


@dataclass(frozen=True)
class PatternOptions(Options):
    """Options of `pattern`."""

    _: KW_ONLY
    panel: Annotated[tuple[int, int], described_size("Pixels of the panel, e.g. 1920x1080."), limits.PIXELS]
    pattern: Annotated[Code, described("Code to show.")] = "gray-fringes"
    channel: Annotated[
        Literal["red", "green", "blue"] | None,
        described("Primary to show the code in (default: white, all of them)."),
    ] = None
    white_every: Annotated[
        int | None,
        described("Show white again after this many pictures and at the end, to repair light that drifts or flickers."),
        Range(at_least=1, at_most=100),
    ] = None
    out: Annotated[
        Path,
        described("Output folder, of the photographs with --photograph; an interrupted run continues there."),
        NoEffect(),
    ] = Path("out/pattern")
    photograph: Annotated[
        str | None,
        described(
            "Show the code picture by picture, and photograph each with this command, which writes the photograph to "
            '{path}, e.g. "gphoto2 --capture-image-and-download --filename {path}".',
            group=_CAMERA,
        ),
        NoEffect(),
    ] = None
    suffix: Annotated[
        Suffix,
        described("Ending of the photographs' names.", group=_CAMERA),
        OnlyWith("photograph"),
        NoEffect(),
    ] = ".png"
    port: Annotated[
        int,
        described("Port of the page at 127.0.0.1.", group=_CAMERA),
        Range(at_least=0, at_most=65535),
        OnlyWith("photograph"),
        NoEffect(),
    ] = 8765
    settle_s: Annotated[
        float,
        described("Seconds from a picture's appearance to its photograph.", group=_CAMERA),
        Range(0, 3600),
        OnlyWith("photograph"),
        NoEffect(),
    ] = 0.2
    timeout_s: Annotated[
        float,
        described("Longest wait for a photograph, in seconds.", group=_CAMERA),
        limits.WAIT_S,
        OnlyWith("photograph"),
        NoEffect(),
    ] = 30.0
    page_timeout_s: Annotated[
        float,
        described("Longest wait for the page, in seconds.", group=_CAMERA),
        limits.WAIT_S,
        OnlyWith("photograph"),
        NoEffect(),
    ] = 300.0


@job
def pattern(options: PatternOptions, *, progress: ProgressArgument = SILENT) -> Report:
    """Write the pictures of a code with a page that shows them, or photograph them on the panel.

    The page fills the screen, with one picture pixel per panel pixel. With `photograph`, only the photographs missing
    from the folder are taken.

    Raises:
        BadInputError: no such code can be made, the folder has other photographs, the page is not opened or does not
            show a picture, or a photograph is not taken; photographs taken before are kept.
    """
    if options.photograph is not None:
        return _photographed(options, options.photograph, progress)
    Kept(options.out, {"job": "pattern"})  # refuses a folder of photographs
    code = make_pattern(options.pattern, Panel(*options.panel))
    pictures = write_show_page(output_folder(options.out), code, options.channel, options.white_every)
    page = options.out / PAGE
    advice = [f"Open {page} on the panel's screen to show them."]
    return Report("Pattern", f"{len(pictures)} pictures of the code {options.pattern}.", advice, files=[page], stem="")


def _photographed(options: PatternOptions, command: str, progress: Progress) -> Report:
    """Photograph the pictures that have no photograph in `options.out` yet."""
    _require_program(words_of(command)[0])
    code = make_pattern(options.pattern, Panel(*options.panel))
    folder = output_folder(options.out)
    with tempfile.TemporaryDirectory() as page_folder:
        pictures = write_show_page(page_folder, code, options.channel, options.white_every)
        paths = [folder / f"{picture.stem}{options.suffix}" for picture in pictures]
        _refuse_others(folder, paths)
        recipe = recipe_of("pattern --photograph", options.recipe_values(), {})
        finished = Kept(folder, recipe, {path: {} for path in paths})
        missing = [number for number, path in enumerate(paths) if finished.unfinished([path])]
        changed = finished.changed(paths)
        if missing:
            with ShowServer(Path(page_folder), code.panel, options.port) as page:
                progress.say(f"open {page.url} on the panel's screen and click on it")
                for number in progress(missing, len(missing), "photographs"):
                    page.show(number, options.page_timeout_s)
                    time.sleep(options.settle_s)
                    finished.begin()
                    take_photograph(command, paths[number], options.timeout_s)
                    finished.add(signatures_of([paths[number]]))
                with contextlib.suppress(BadInputError):  # the photographs are complete even if this fails
                    page.show(len(paths), _BLACK_S)
    return Report(
        "Pattern, photographed",
        f"{len(missing)} photographs taken, {len(paths) - len(missing)} kept from an earlier run: {folder}",
        ["List the folder in session.toml as [[display]] with its stage reading."],
        retaken_warnings(changed),
        stem="",
    )


def _require_program(name: str) -> None:
    """Refuse a command that cannot be run, before the user opens the page."""
    if shutil.which(name) is None:
        raise BadInputError(
            f"--photograph: the program {shown(name)} is not installed; install it, or correct its name."
        )


def _refuse_others(folder: Path, paths: list[Path]) -> None:
    """Refuse a folder with other photographs, which would be read as part of the code."""
    found = (path for path in folder.iterdir() if path.suffix.lower() in SUFFIXES and not path.name.startswith("."))
    others = sorted(path.name for path in set(found) - set(paths))
    if others:
        raise BadInputError(
            f"{folder}: contains {others[0]}, which does not belong to this code; choose another folder."
        )


def words_of(command: str) -> list[str]:
    """Split a command as a shell does; `{path}` is replaced by the photograph's file.

    Raises:
        BadInputError: the command has no `{path}`, or an unclosed quote.
    """
    try:
        words = shlex.split(command)
    except ValueError as error:
        raise BadInputError(f"--photograph {command!r} is not a command ({error}); correct it.") from error
    if not any("{path}" in word for word in words):
        raise BadInputError(
            f"--photograph {command!r} lacks {{path}}, the placeholder for the photograph's file; e.g. "
            '"gphoto2 --capture-image-and-download --filename {path}".'
        )
    return words


def take_photograph(command: str, path: Path, timeout_s: float) -> None:
    """Run a command and wait until it has written a file; the file's name starts with a dot until it is complete.

    Raises:
        BadInputError: the command cannot be run or fails, or no complete file exists after `timeout_s`.
    """
    ends = time.monotonic() + timeout_s
    partial = path.with_name(f".{path.name}")
    partial.unlink(missing_ok=True)
    words = [word.replace("{path}", str(partial)) for word in words_of(command)]
    named = f"{path}: was not taken: `{shlex.join(words)}`"
    # No pipe: reading it would wait for any program that the command leaves running.
    with tempfile.TemporaryFile(mode="w+", errors="replace") as output:
        try:
            status = subprocess.run(words, stdout=output, stderr=subprocess.STDOUT, timeout=timeout_s).returncode
        except OSError as error:
            raise BadInputError(f"{named} cannot be run ({error.strerror}); correct --photograph.") from error
        except subprocess.TimeoutExpired as error:
            raise BadInputError(
                f"{named} did not end within {timeout_s:g} s; try it by hand, or give --timeout-s."
            ) from error
        output.seek(0)
        said = output.read().split("\n")
    if status != 0:
        last = next((line.strip() for line in reversed(said) if line.strip()), "no message")
        raise BadInputError(f"{named} failed with status {status} ({last}); try it by hand, or correct --photograph.")
    size, since = -1, time.monotonic()
    while size <= 0 or time.monotonic() - since < _STABLE_S:
        if time.monotonic() > ends + _STABLE_S:
            what = "was still growing" if size > 0 else "was not written"
            raise BadInputError(f"{named} ended, but its file {what} within {timeout_s:g} s; correct --photograph.")
        time.sleep(_LOOK_S)
        now = partial.stat().st_size if partial.is_file() else -1
        if now != size:
            size, since = now, time.monotonic()
    os.replace(partial, path)
