"""Serve the page of a code on this machine, and say which picture it shows.

The page asks for the number of the picture ten times a second and answers with the one that is on the screen. A program
of your own can do the same, for a panel that shows no web pages: `GET /` redirects to `/KEY/show.html`;
`GET /KEY/state?shown=2&width=1920&height=1080` returns `{"show": 3}`. The numbers count from 0 in the order of
`Pattern.names`; -1 before the first picture and as many as there are pictures after the last, for black.
"""

import hashlib
import json
import threading
from functools import partial
from http import HTTPStatus
from http.server import SimpleHTTPRequestHandler, ThreadingHTTPServer
from pathlib import Path
from types import TracebackType
from urllib.parse import parse_qs, urlsplit

from wlr_render.captures.patterns.show_page import PAGE
from wlr_render.errors import BadInputError
from wlr_render.mappings import Panel

_ROUNDING_PX = 2  # of a window's size where the system scales it


class ShowServer:
    """A server of a folder that `write_show_page` wrote; a context manager.

    Attributes:
        url: address of the page.
    """

    def __init__(self, folder: Path, panel: Panel, port: int) -> None:
        """Serve a folder at localhost.

        Args:
            folder: of the page.
            panel: a window must have as many pixels at least.
            port: 0 for any that is free.

        Raises:
            BadInputError: the port is in use.
        """
        self._panel = panel
        self._wanted, self._shown, self._window = -1, -1, (0, 0)
        self._changed = threading.Condition()
        # Part of the address, so that a page of another code that is still open notices.
        self.key = hashlib.sha256((folder / PAGE).read_bytes()).hexdigest()[:12]
        handler = partial(_Handler, page=self, directory=str(folder))
        try:
            self._server = ThreadingHTTPServer(("127.0.0.1", port), handler)
        except (OSError, OverflowError) as error:
            raise BadInputError(f"port {port} cannot be used ({error}); choose another with --port.") from error
        self.url = f"http://127.0.0.1:{self._server.server_port}/"

    def __enter__(self) -> "ShowServer":
        threading.Thread(target=self._server.serve_forever, args=(0.05,), daemon=True).start()
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self._server.shutdown()
        self._server.server_close()

    def show(self, number: int, timeout_s: float) -> None:
        """Return when the page shows a picture.

        Raises:
            BadInputError: it does not within `timeout_s`; the sentence says why.
        """
        with self._changed:
            self._wanted = number
            if self._changed.wait_for(lambda: self._shown == number and self._fits(), timeout_s):
                return
            width, height = self._window
            size = f"{self._panel.width_px} x {self._panel.height_px}"
            if not width:
                what = f"no page asked for a picture; open {self.url} on the panel's screen and click on it"
            elif not self._fits():
                what = f"the window has {width} x {height} pixels, the panel {size}; make it full screen on the panel"
            else:
                what = f"the page no longer answers; open {self.url} on the panel's screen again and keep it in front"
        raise BadInputError(f"picture {number} was not shown within {timeout_s:g} s: {what}.")

    def answer(self, shown: int, window: tuple[int, int]) -> dict[str, int]:
        """Note what the page shows, and say what it is to show."""
        with self._changed:
            self._shown, self._window = shown, window
            self._changed.notify_all()
            return {"show": self._wanted if self._fits() else -1}

    def _fits(self) -> bool:
        width, height = self._window
        return width >= self._panel.width_px - _ROUNDING_PX and height >= self._panel.height_px - _ROUNDING_PX


class _Handler(SimpleHTTPRequestHandler):
    """The address `/`, the state, and the files of the folder."""

    def __init__(self, *arguments: object, page: ShowServer, directory: str) -> None:
        self._page = page
        super().__init__(*arguments, directory=directory)  # type: ignore[arg-type]

    def do_GET(self) -> None:
        address, root = urlsplit(self.path), f"/{self._page.key}/"
        if address.path == "/":
            self.send_response(HTTPStatus.FOUND)
            self.send_header("Location", f"{root}{PAGE}?remote{'=now' if address.query == 'now' else ''}")
            self.end_headers()
        elif address.path == f"{root}state":
            self._state(parse_qs(address.query))
        elif address.path.startswith(root):
            self.path = self.path.removeprefix(root[:-1])
            super().do_GET()
        else:
            self.send_error(HTTPStatus.NOT_FOUND)

    def _state(self, query: dict[str, list[str]]) -> None:
        try:
            shown, width, height = (int(query[key][0]) for key in ("shown", "width", "height"))
        except (KeyError, ValueError):
            self.send_error(HTTPStatus.BAD_REQUEST, "give shown, width and height as whole numbers")
            return
        content = json.dumps(self._page.answer(shown, (width, height))).encode()
        self.send_response(HTTPStatus.OK)
        self.send_header("Content-Type", "application/json")
        self.send_header("Content-Length", str(len(content)))
        self.end_headers()
        self.wfile.write(content)

    def log_message(self, *arguments: object) -> None:
        """Ten requests a second are no news."""
