import base64
import json
import re
from pathlib import Path

import cv2
import numpy as np
from present import present

from wlr_render.captures.decoded import DecodeOptions
from wlr_render.captures.patterns.catalogue import make_pattern
from wlr_render.captures.patterns.show_page import write_show_page
from wlr_render.captures.photographs import photographs_in, read_each
from wlr_render.mappings import Panel

PANEL = Panel(20, 12)


def test_the_pictures_written_decode_to_the_panel(tmp_path: Path) -> None:
    pattern = make_pattern("gray", PANEL)
    paths = write_show_page(tmp_path, pattern)
    assert paths[2].name == "002_u_bit_4.png"
    assert paths == photographs_in(tmp_path)
    decoded = pattern.decode(read_each(paths), DecodeOptions(end_of_scale=np.inf))
    np.testing.assert_allclose(decoded.pixel, PANEL.pixel_centres())


def test_the_page_holds_all_pictures_in_order_and_needs_nothing_else(tmp_path: Path) -> None:
    pattern = make_pattern("gray-fringes", PANEL)
    write_show_page(tmp_path, pattern)
    page = (tmp_path / "show.html").read_text(encoding="utf-8")
    content = json.loads(present(re.search(r"const code = (.*);\n", page)).group(1))
    assert content["names"] == list(pattern.names())
    assert (content["width"], content["height"]) == (20, 12)
    for index, address in enumerate(content["pictures"]):
        packed = np.frombuffer(base64.b64decode(address.split(",")[1]), dtype=np.uint8)
        assert np.array_equal(present(cv2.imdecode(packed, cv2.IMREAD_UNCHANGED)), pattern.image(index))
    assert "http" not in page
