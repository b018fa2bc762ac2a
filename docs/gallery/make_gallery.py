"""Run the program as the gallery shows it, and write docs/gallery.md and its pictures.

From the root of a checkout: `.venv/bin/python docs/gallery/make_gallery.py`. It takes five minutes and needs
Chromium, for pictures of pages.
"""

import json
import shlex
import subprocess
import sys
import tempfile
from io import BytesIO
from pathlib import Path
from typing import NamedTuple

from PIL import Image

PAGE = Path(__file__).resolve().parent.parent / "gallery.md"
OUT = Path("out/gallery")
PAGE_PX = (1200, 800)
WIDTH_PX = 900  # of a picture in the gallery
MOST_BYTES = 120_000  # of a picture with all its colours


class Run(NamedTuple):
    """One run of the program: its section's title, its words, the name of its folder, and its picture.

    The picture is a file that the run writes, a page itself too, or the report's plots from one number on.
    """

    title: str
    words: str
    name: str
    picture: str | int
    page: str = "report.html"


RUNS = (
    *(
        Run(f"Four ways to draw for {device}", f"demo {device}", f"demo-{device}", "alignment.png")
        for device in ("northstar", "freeform40", "birdbath28", "prism5701202")
    ),
    Run("A calibration", "calibrate northstar", "calibrate", 1),
    Run("A page that moves", f"export {OUT}/calibrate/model.json --format page", "page", "right-page.html"),
    Run("An error budget", f"budget {OUT}/calibrate/model.json", "budget", 2, "budget.html"),
    Run("A diagnosis", "diagnose examples/data/session", "diagnose", 3, "diagnosis.html"),
)
"""In an order in which each finds the files that it needs."""


def main() -> None:
    """Run, take pictures, and write the page."""
    parts = [
        "# Gallery\n",
        "Each picture belongs to the run whose command stands above it; the sentence is that run's own verdict.\n",
        "`.venv/bin/python docs/gallery/make_gallery.py` makes this page again.\n",
    ]
    for run in RUNS:
        folder = OUT / run.name
        command = [*run.words.split(), "--out", str(folder)]
        subprocess.run([sys.executable, "-m", "wlr_render", *command], check=True)
        page = folder / run.page
        verdict = json.loads(page.with_suffix(".json").read_text(encoding="utf-8"))["sentence"]
        if isinstance(run.picture, int):
            whole = photographed(page, run.picture)
        else:
            file = folder / run.picture
            whole = photographed(file) if file.suffix == ".html" else file.read_bytes()
        picture = PAGE.with_suffix("") / f"{run.name}.png"
        picture.write_bytes(small(whole))
        parts += [f"## {run.title}\n", f"`./wlr {shlex.join(command)}`\n", f"{verdict}\n"]
        parts += [f"![{run.title}](gallery/{picture.name})\n"]
    PAGE.write_text("\n".join(parts), encoding="utf-8")


def photographed(page: Path, plot: int = 0) -> bytes:
    """Return a picture of a page as PNG, from its top or from one of its plots on."""
    with tempfile.TemporaryDirectory() as scratch:
        picture, shown = Path(scratch) / "page.png", Path(scratch) / "page.html"
        # Chromium's pictures of a scrolled page are blank; what stands before the plot is hidden instead.
        style = f"<style>header, nav, footer, main > :has(~ figure > #plot{plot}) {{ display: none }}</style>"
        shown.write_text(page.read_text(encoding="utf-8") + style, encoding="utf-8")
        command = ["chromium", "--headless", "--no-sandbox", "--disable-gpu", "--disable-dev-shm-usage"]
        command += ["--hide-scrollbars", "--host-resolver-rules=MAP * ~NOTFOUND", f"--user-data-dir={scratch}/profile"]
        command += ["--virtual-time-budget=20000000", f"--window-size={PAGE_PX[0]},{PAGE_PX[1]}"]
        subprocess.run([*command, f"--screenshot={picture}", shown.as_uri()], capture_output=True, timeout=120)
        return picture.read_bytes()


def small(png: bytes) -> bytes:
    """Return a PNG of at most `WIDTH_PX` across, with a palette if it is large."""
    image = Image.open(BytesIO(png)).convert("RGB")
    if image.width > WIDTH_PX:
        image = image.resize((WIDTH_PX, round(image.height * WIDTH_PX / image.width)), Image.Resampling.BOX)
    whole = encoded(image)
    return whole if len(whole) <= MOST_BYTES else encoded(image.quantize())


def encoded(image: Image.Image) -> bytes:
    """Return a picture as PNG."""
    content = BytesIO()
    image.save(content, "PNG", optimize=True)
    return content.getvalue()


if __name__ == "__main__":
    main()
