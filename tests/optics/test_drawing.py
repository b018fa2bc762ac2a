"""Drawings are whole, name what they show, and refuse an eye that is not there."""

import re
from pathlib import Path

import pytest

from wlr_render.errors import BadInputError
from wlr_render.io.atomic_files import resource, shipped_names
from wlr_render.optics.device_file import load_device
from wlr_render.optics.drawing import draw_device


@pytest.mark.parametrize("name", shipped_names("devices", ".toml"))
def test_every_device_can_be_drawn_with_everything_named(name: str, tmp_path: Path) -> None:
    device = load_device(name)
    path = tmp_path / "drawing.svg"
    draw_device(device, "right", path)
    drawing = path.read_text(encoding="utf-8")
    surfaces = [surface.name.replace("_", " ") for surface in device.eyes["right"].surfaces()]
    for text in ("right, x (mm)", "up, y (mm)", "panel", "eye box", "display rays", "see-through rays", *surfaces):
        assert f"<!-- {text} -->" in drawing


def test_arrows_on_the_panel_show_where_u_and_v_grow(tmp_path: Path) -> None:
    """From the side the u axis of the birdbath is seen end on; v is seen there, and u from above."""
    path = tmp_path / "drawing.svg"
    draw_device(load_device("birdbath28"), "right", path)
    drawing = path.read_text(encoding="utf-8")
    side, above = drawing.split("<!-- from above -->")[0], drawing
    assert "<!-- v -->" in side
    assert above.count("<!-- u -->") == 1


def test_surfaces_without_apertures_do_not_run_out_of_the_drawing(tmp_path: Path) -> None:
    text = resource("devices", "birdbath28.toml").read_text(encoding="utf-8")
    bare = tmp_path / "bare.toml"
    bare.write_text("\n".join(line for line in text.splitlines() if not line.startswith("aperture")))
    path = tmp_path / "drawing.svg"
    draw_device(load_device(bare), "right", path)
    ticks = [float(tick.replace("\u2212", "-")) for tick in re.findall(r"<!-- ([\u2212\d.]+) -->", path.read_text())]
    assert 10 < max(map(abs, ticks)) < 300  # millimetres


def test_the_left_eye_as_a_png(tmp_path: Path) -> None:
    path = tmp_path / "left.png"
    draw_device(load_device("northstar"), "left", path)
    assert path.read_bytes().startswith(b"\x89PNG")
    assert list(tmp_path.iterdir()) == [path]


def test_an_eye_that_is_not_there(tmp_path: Path) -> None:
    with pytest.raises(BadInputError, match="'birdbath28' has no left eye; choose right"):
        draw_device(load_device("birdbath28"), "left", tmp_path / "left.png")
