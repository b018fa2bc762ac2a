"""The page that a server tells which picture to show."""

import json
import re
import shutil
import subprocess
import urllib.error
import urllib.request
from pathlib import Path
from typing import Any

import pytest
from present import present

from wlr_render.captures.patterns.catalogue import make_pattern
from wlr_render.captures.patterns.show_page import PAGE, write_show_page
from wlr_render.captures.patterns.show_server import ShowServer
from wlr_render.errors import BadInputError
from wlr_render.mappings import Panel

PANEL = Panel(20, 12)
NODE = shutil.which("node")

# What the page needs of a browser; prints the pictures that it shows.
BROWSER = """
const elements = {img: {style: {}, decode: async () => {}}, p: {}};
globalThis.document = {documentElement: {}, querySelector: name => elements[name], set title(text) {
  console.log(JSON.stringify([text, elements.img.hidden ? "" : elements.img.src]));
}};
globalThis.location = {search: SEARCH, replace: address => {
  console.log(JSON.stringify(["to", address]));
  process.exit();
}};
globalThis.addEventListener = () => {};
globalThis.requestAnimationFrame = done => setTimeout(done, 5);
Object.assign(globalThis, {innerWidth: 10, innerHeight: 6, devicePixelRatio: RATIO});
const web = fetch;
globalThis.fetch = (address, options) => web("PAGE/" + address, options);
"""


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    write_show_page(tmp_path / "shown", make_pattern("gray", PANEL))
    return tmp_path / "shown"


def asked(url: str) -> tuple[Any, Any]:
    with urllib.request.urlopen(url, timeout=10) as answer:
        return answer.url, answer.read()


def page_in_node(folder: Path, address: str, ratio: int = 2) -> subprocess.Popen[str]:
    """The page's script, run by Node."""
    script = present(re.search(r"<script>(.*)</script>", (folder / PAGE).read_text(encoding="utf-8"), re.DOTALL)).group(
        1
    )
    browser = BROWSER.replace("SEARCH", json.dumps("?remote=now")).replace("RATIO", str(ratio))
    program = folder.parent / "page.js"
    program.write_text(browser.replace("PAGE", address.rsplit("/", 1)[0]) + script, encoding="utf-8")
    return subprocess.Popen([present(NODE), str(program)], stdout=subprocess.PIPE, text=True)


@pytest.mark.slow
@pytest.mark.skipif(NODE is None, reason="no Node here: install Debian's package nodejs")
def test_the_page_shows_what_the_server_asks_for(folder: Path) -> None:
    content = json.loads(
        present(re.search(r"const code = (.*);\n", (folder / PAGE).read_text(encoding="utf-8"))).group(1)
    )
    with ShowServer(folder, PANEL, 0) as server:
        page = page_in_node(folder, asked(server.url)[0])
        try:
            for number in (0, 3, 1, len(content["names"])):
                server.show(number, 10)
        finally:
            page.kill()
    shown = [json.loads(line) for line in present(page.stdout).read().splitlines() if line.startswith("[")]
    expected = [[f"{n} {content['names'][n]}", content["pictures"][n]] for n in (0, 3, 1)]
    assert shown == [*expected, ["all shown", ""]]


@pytest.mark.skipif(NODE is None, reason="no Node here: install Debian's package nodejs")
def test_a_window_smaller_than_the_panel_is_refused(folder: Path) -> None:
    with ShowServer(folder, PANEL, 0) as server:
        page = page_in_node(folder, asked(server.url)[0], ratio=1)
        try:
            with pytest.raises(BadInputError, match="the window has 10 x 6 pixels, the panel 20 x 12; make it full"):
                server.show(0, 2)
        finally:
            page.kill()
    assert present(page.stdout).read() == ""


@pytest.mark.skipif(NODE is None, reason="no Node here: install Debian's package nodejs")
def test_a_page_of_another_code_goes_to_the_new_one(folder: Path, tmp_path: Path) -> None:
    with ShowServer(folder, PANEL, 0) as server:
        address = asked(server.url)[0]
        write_show_page(tmp_path / "other", make_pattern("gray", Panel(24, 12)))
        port = int(present(re.search(r":(\d+)/", server.url)).group(1))
    with ShowServer(tmp_path / "other", PANEL, port):
        page = page_in_node(folder, address)
        assert json.loads(page.communicate(timeout=20)[0]) == ["to", "/"]


def test_a_program_of_ones_own_may_show_the_pictures(folder: Path) -> None:
    with ShowServer(folder, PANEL, 0) as server:
        root = f"{server.url}{server.key}/"
        assert asked(server.url)[0] == f"{root}{PAGE}?remote"
        assert asked(f"{server.url}?now")[0] == f"{root}{PAGE}?remote=now"
        assert json.loads(asked(f"{root}state?shown=-1&width=20&height=12")[1]) == {"show": -1}
        assert asked(f"{root}000_white.png")[1] == (folder / "000_white.png").read_bytes()
        for wrong, status in ((f"{root}state", 400), (f"{server.url}000_white.png", 404), (f"{root}../secret", 404)):
            with pytest.raises(urllib.error.HTTPError) as refused:
                asked(wrong)
            assert refused.value.code == status
            refused.value.close()


def test_why_a_picture_is_not_shown(folder: Path) -> None:
    with ShowServer(folder, PANEL, 0) as server:
        with pytest.raises(BadInputError, match=f"picture 0 was not shown within 0.1 s: no page asked .* {server.url}"):
            server.show(0, 0.1)
        server.answer(0, (20, 12))
        server.show(0, 0.1)
        with pytest.raises(BadInputError, match="the page no longer answers"):
            server.show(1, 0.1)
        port = int(present(re.search(r":(\d+)/", server.url)).group(1))
        with pytest.raises(BadInputError, match=f"port {port} cannot be used .*; choose another with --port"):
            ShowServer(folder, PANEL, port)
