"""Local web server of a code's page, which selects the picture that the page shows.

Ten times a second the page requests the number of the picture and reports the one on the screen. Another program can do
the same, for a panel that cannot show web pages: `GET /` redirects to `/KEY/show.html`; `GET
/KEY/state?shown=2&width=1920&height=1080` returns `{"show": 3}`. The numbers count from 0 in the order of
`Pattern.names`; -1 before the first picture, and the number of pictures after the last one, for black.
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

_ROUNDING_PX = 2  # rounding error of the window size on a scaled display


class ShowServer:
    """Web server of a folder from `write_show_page`; a context manager.

    Attributes:
        url: address of the page.
    """

    def __init__(self, folder: Path, panel: Panel, port: int) -> None:
        """Serve a folder at localhost.

        Args:
            folder: folder of the page.
            panel: panel, which is the least size of the window in pixels.
            port: port; 0 for any free one.

        Raises:
            BadInputError: the port is in use.
        """
        self._panel = panel
        self._wanted, self._shown, self._window = -1, -1, (0, 0)
        self._changed = threading.Condition()
        # The key is a part of the address, so that an open page of another code notices the change.
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
        """Wait until the page shows a picture.

        Raises:
            BadInputError: the page does not show it within `timeout_s`; the message states the reason.
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
        """Record the picture that the page shows, and return the one to show."""
        with self._changed:
            self._shown, self._window = shown, window
            self._changed.notify_all()
            return {"show": self._wanted if self._fits() else -1}

    def _fits(self) -> bool:
        width, height = self._window
        return width >= self._panel.width_px - _ROUNDING_PX and height >= self._panel.height_px - _ROUNDING_PX


class _Handler(SimpleHTTPRequestHandler):
    """Request handler for the address `/`, the state, and the files of the folder."""

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
        """Log nothing: the page polls ten times a second."""
