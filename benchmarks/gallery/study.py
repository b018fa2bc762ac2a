"""A gallery: main verbs are run as a user runs them, and one page shows a picture of each run and links its report."""

import dataclasses
import io
import json
import shlex
import shutil
import subprocess
import sys
import tempfile
from collections.abc import Sequence
from dataclasses import KW_ONLY, dataclass
from pathlib import Path
from typing import Annotated

import cv2
import numpy as np
from PIL import Image

from wlr_render.atomic_files import output_folder, write_bytes, write_text
from wlr_render.errors import BadInputError
from wlr_render.jobs.options import Options, ProgressArgument, described
from wlr_render.progress import SILENT
from wlr_render.rendering.srgb import decode_srgb, encode_srgb
from wlr_render.report.blocks import Block, Picture, Report, Section, Text
from wlr_render.report.save import markdown, save_report

_PROGRAM = "./wlr"
_BROWSERS = ("chromium", "chromium-browser", "google-chrome")
_PAGE_PX = (1200, 800)
_WIDTH_PX = 900  # of a picture in the gallery
_MOST_BYTES = 120_000  # of a picture with all its colours
_BROWSER_S = 120


@dataclass(frozen=True)
class GalleryOptions(Options):
    """Options of `gallery`."""

    _: KW_ONLY
    headset: Annotated[
        tuple[str, ...], described("Headsets of the demos.", name=("--headsets", "--headset"), many=True)
    ] = (
        "northstar",
        "freeform40",
        "birdbath28",
        "prism5701202",
    )
    resume: Annotated[bool, described("Keep the runs that an earlier gallery left there.", flag=True)] = False
    record: Annotated[Path | None, described("Folder in which gallery.md and its pictures are kept, too.")] = None
    out: Annotated[Path, described("Output folder.")] = Path("out/gallery")


@dataclass(frozen=True)
class Run:
    """One run of the program, and what the gallery shows of it.

    Attributes:
        title: of its section.
        words: the verb and its options, without the output folder.
        name: of the output folder.
        page: file name of the report's page.
        picture: file name of a picture that the run writes; if empty, a picture of the page is taken.
        plot: number of the plot of the page with which that picture begins.
    """

    title: str
    words: Sequence[str]
    name: str
    page: str = "report.html"
    picture: str = ""
    plot: int = 1

    def command(self, folder: Path) -> list[str]:
        """The words of the command line, without the program's name."""
        return [*self.words, "--out", str(folder / self.name)]


def planned_runs(options: GalleryOptions) -> list[Run]:
    """All runs, in an order in which each finds the files that it needs."""
    model = str(options.out / "calibrate" / "model.json")
    demos = [
        Run(f"Four ways to draw for {each}", ["demo", "--device", each], f"demo-{each}", picture="alignment.png")
        for each in options.headset
    ]
    return [
        *demos,
        Run("A calibration", ["calibrate", "northstar"], "calibrate"),
        Run("An error budget", ["budget", model], "budget", "budget.html", plot=2),
        Run("A diagnosis", ["diagnose", "examples/data/session"], "diagnose", "diagnosis.html", plot=3),
    ]


def run(options: GalleryOptions = GalleryOptions(), *, progress: ProgressArgument = SILENT) -> Report:
    """Run, take pictures, and write index.html, .md and .json.

    Raises:
        BadInputError: there is no browser, a run failed, or a folder cannot be written.
    """
    browser = next(filter(None, map(shutil.which, _BROWSERS)), None)
    if browser is None:
        raise BadInputError("The gallery takes pictures of pages with Chromium, which is not here; install chromium.")
    folder, planned = output_folder(options.out), planned_runs(options)
    pictures = output_folder(folder / "gallery")
    blocks: list[Block] = []
    for each in progress(planned, len(planned), "runs"):
        page = folder / each.name / each.page
        if not (options.resume and page.is_file()):
            _run(each.command(folder))
        source = page.with_name(each.picture).read_bytes() if each.picture else _photographed(browser, page, each.plot)
        blocks += _blocks(each, folder, write_bytes(pictures / f"{each.name}.png", small_picture(source)))
    report = Report(
        "Gallery",
        "Each picture belongs to the run whose command stands above it; the sentence is that run's own verdict.",
        blocks=blocks,
        record={"options": options},
    )
    if options.record is not None:
        keep(report, options.record)
    return save_report(report, folder, "index")


def _run(words: Sequence[str]) -> None:
    done = subprocess.run([sys.executable, "-m", "wlr_render", *words], capture_output=True, text=True)
    if done.returncode:
        last = (done.stderr.strip() or "no message").splitlines()[-1]
        raise BadInputError(f"wlr-render {shlex.join(words)} ended with status {done.returncode}: {last}")


def _blocks(shown: Run, folder: Path, picture: Path) -> list[Block]:
    """Section of one run; its verdict is that of the report's JSON file."""
    page = Path(shown.name) / shown.page
    verdict = json.loads((folder / page).with_suffix(".json").read_text(encoding="utf-8"))["sentence"]
    return [
        Section(shown.title),
        Text(f"`{_PROGRAM} {shlex.join(shown.command(folder))}`"),
        Text(verdict),
        Picture(page.as_posix(), picture, f"{shown.title}. The picture leads to the report.", link=page.as_posix()),
    ]


def _photographed(browser: str, page: Path, plot: int) -> bytes:
    """A picture of a page as PNG, from one of its plots on."""
    with tempfile.TemporaryDirectory() as scratch:
        picture, shown = Path(scratch) / "page.png", Path(scratch) / "page.html"
        # Chromium's pictures of a page that is scrolled are blank: what stands before the plot is hidden instead.
        style = f"<style>header, nav, footer, main > :has(~ figure > #plot{plot}) {{ display: none }}</style>"
        shown.write_text(page.read_text(encoding="utf-8") + style, encoding="utf-8")
        command = [
            browser, "--headless", "--no-sandbox", "--disable-gpu", "--disable-dev-shm-usage", "--hide-scrollbars",
            "--host-resolver-rules=MAP * ~NOTFOUND", f"--user-data-dir={scratch}/profile",
            "--virtual-time-budget=20000", f"--window-size={_PAGE_PX[0]},{_PAGE_PX[1]}", f"--screenshot={picture}",
            shown.as_uri(),
        ]  # fmt: skip
        try:
            subprocess.run(command, capture_output=True, timeout=_BROWSER_S)
            return picture.read_bytes()
        except (subprocess.TimeoutExpired, OSError) as error:
            raise BadInputError(f"{page}: {browser} takes no picture of it; open the page to see why.") from error


def small_picture(png: bytes) -> bytes:
    """A PNG of at most `_WIDTH_PX` across, with a palette if it is large."""
    with Image.open(io.BytesIO(png)) as opened:
        image = opened.convert("RGB")
    if image.width > _WIDTH_PX:
        size = _WIDTH_PX, round(image.height * _WIDTH_PX / image.width)
        light = cv2.resize(decode_srgb(np.asarray(image)), size, interpolation=cv2.INTER_AREA)
        image = Image.fromarray(encode_srgb(light))
    small = _png(image)
    return small if len(small) <= _MOST_BYTES else _png(image.quantize())


def _png(image: Image.Image) -> bytes:
    content = io.BytesIO()
    image.save(content, "PNG", optimize=True)
    return content.getvalue()


def keep(report: Report, folder: Path) -> None:
    """Write FOLDER/gallery.md and its pictures in FOLDER/gallery; links to pages, which are not kept, are left out."""
    blocks: list[Block] = []
    for block in report.blocks:
        if isinstance(block, Picture):
            kept = write_bytes(output_folder(folder / "gallery") / block.path.name, block.path.read_bytes())
            block = dataclasses.replace(block, path=kept, caption=block.caption.partition(".")[0], link="")
        blocks.append(block)
    how = Text(
        "`./wlr bench gallery --record docs` makes this page again; its out/gallery/index.html links the reports."
    )
    kept_report = dataclasses.replace(report, blocks=[how, *blocks])
    write_text(folder / "gallery.md", markdown(kept_report, folder))
