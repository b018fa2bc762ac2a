"""Opens a page in headless Chromium and tells what the browser thinks of it."""

import shutil
import subprocess
from dataclasses import dataclass
from pathlib import Path

import pytest
from present import present

CHROMIUM = next(filter(None, map(shutil.which, ("chromium", "chromium-browser", "google-chrome"))), None)
needs_browser = pytest.mark.skipif(CHROMIUM is None, reason="no Chromium here: install Debian's package chromium")


@dataclass(frozen=True)
class OpenedPage:
    """The page after its scripts have run."""

    dom: str
    console: list[str]

    @property
    def plots(self) -> int:
        """Number of Plotly figures that were drawn."""
        return self.dom.count('class="plot-container plotly"')


def open_page(path: Path, folder: Path) -> OpenedPage:
    """Load a file without network; `folder` takes the browser's profile."""
    command = [
        present(CHROMIUM), "--headless", "--no-sandbox", "--disable-gpu", "--disable-dev-shm-usage",
        "--enable-logging=stderr", "--log-level=0", "--host-resolver-rules=MAP * ~NOTFOUND",
        f"--user-data-dir={folder}/profile", "--virtual-time-budget=20000", "--dump-dom", path.resolve().as_uri(),
    ]  # fmt: skip
    result = subprocess.run(command, capture_output=True, text=True, timeout=120)
    console = [line for line in result.stderr.splitlines() if "CONSOLE" in line]
    assert "<body" in result.stdout, result.stderr[-2000:]
    return OpenedPage(result.stdout, console)
