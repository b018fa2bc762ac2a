"""Opens a page in headless Chromium and tells what the browser thinks of it."""

import contextlib
import fcntl
import itertools
import json
import os
import select
import shutil
import subprocess
import time
from collections.abc import Iterator
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

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
        *_command(folder), "--enable-logging=stderr", "--log-level=0",
        "--virtual-time-budget=20000", "--dump-dom", path.resolve().as_uri(),
    ]  # fmt: skip
    result = subprocess.run(command, capture_output=True, text=True, timeout=120)
    console = [line for line in result.stderr.splitlines() if "CONSOLE" in line]
    assert "<body" in result.stdout, result.stderr[-2000:]
    return OpenedPage(result.stdout, console)


def _command(folder: Path) -> list[str]:
    return [
        present(CHROMIUM), "--headless", "--no-sandbox", "--disable-gpu", "--disable-dev-shm-usage",
        "--host-resolver-rules=MAP * ~NOTFOUND", f"--user-data-dir={folder}/profile",
    ]  # fmt: skip


@dataclass
class DrivenPage:
    """A page that stays open, driven by the DevTools protocol: real keys, mouse and touch.

    Attributes:
        requested: addresses of all requests of the page.
        said: errors and messages of its scripts.
    """

    read_from: int
    write_to: int
    requested: list[str] = field(default_factory=list)
    said: list[str] = field(default_factory=list)

    def __post_init__(self) -> None:
        self._numbers, self._unread, self._session = itertools.count(1), b"", {}
        target = self.call("Target.createTarget", url="about:blank")["targetId"]
        session = self.call("Target.attachToTarget", targetId=target, flatten=True)["sessionId"]
        self._session = {"sessionId": session}
        for domain in ("Page", "Network", "Runtime"):
            self.call(f"{domain}.enable")

    def call(self, method: str, **parameters: Any) -> Any:
        """Return the result of a method of the DevTools protocol."""
        number = next(self._numbers)
        message = {"id": number, "method": method, "params": parameters, **self._session}
        os.write(self.write_to, json.dumps(message).encode() + b"\0")
        while True:
            reply = self._next()
            if reply.get("id") == number:
                assert "error" not in reply, reply
                return reply["result"]

    def value(self, expression: str) -> Any:
        """Return the JSON value of a script's expression, awaited."""
        result = self.call("Runtime.evaluate", expression=expression, awaitPromise=True, returnByValue=True)
        assert "exceptionDetails" not in result, result
        return result["result"].get("value")

    def open(self, path: Path, ready: str) -> None:
        """Load a file, and wait until an expression is true."""
        self.call("Page.navigate", url=path.resolve().as_uri())
        for _ in range(600):
            if self.value(ready):
                return
            time.sleep(0.1)
        raise AssertionError(f"{path}: {ready} is not true; {self.said}")

    def press(self, key: str) -> None:
        """Press and release a key."""
        for kind in ("keyDown", "keyUp"):
            text = {"text": key} if len(key) == 1 and kind == "keyDown" else {}
            self.call("Input.dispatchKeyEvent", type=kind, key=key, code=key, **text)

    def touch(self, *points: tuple[float, float]) -> None:
        """Put a finger down at the first point (x, y) of the window, move it through the others and lift it."""
        for kind, point in zip(("touchStart", *["touchMove"] * len(points[1:])), points, strict=True):
            self.call("Input.dispatchTouchEvent", type=kind, touchPoints=[{"x": point[0], "y": point[1]}])
        self.call("Input.dispatchTouchEvent", type="touchEnd", touchPoints=[])

    def _next(self) -> dict[str, Any]:
        while b"\0" not in self._unread:
            assert select.select([self.read_from], [], [], 60)[0], "the browser does not answer."
            part = os.read(self.read_from, 1 << 20)
            assert part, "the browser has ended."
            self._unread += part
        first, _, self._unread = self._unread.partition(b"\0")
        message: dict[str, Any] = json.loads(first)
        of = message.get("params", {})
        if message.get("method") == "Network.requestWillBeSent":
            self.requested.append(of["request"]["url"])
        if message.get("method") in ("Runtime.exceptionThrown", "Runtime.consoleAPICalled"):
            self.said.append(json.dumps(of))
        return message


@contextlib.contextmanager
def driven_page(folder: Path, *options: str) -> Iterator[DrivenPage]:
    """Start a browser without network, with options of its command; `folder` takes its profile."""
    ends = [fcntl.fcntl(end, fcntl.F_DUPFD_CLOEXEC, 10) for end in (*os.pipe(), *os.pipe())]
    commands, write_to, read_from, answers = ends
    silent = ((os.POSIX_SPAWN_OPEN, stream, os.devnull, os.O_WRONLY, 0) for stream in (1, 2))
    actions = [(os.POSIX_SPAWN_DUP2, commands, 3), (os.POSIX_SPAWN_DUP2, answers, 4), *silent]
    command = [*_command(folder), "--remote-debugging-pipe", *options]
    process = os.posix_spawn(command[0], command, os.environ, file_actions=actions)
    for end in (commands, answers):
        os.close(end)
    page = DrivenPage(read_from, write_to)
    try:
        yield page
    finally:
        page._session = {}
        page.call("Browser.close")
        os.close(write_to)
        os.waitpid(process, 0)
        os.close(read_from)
