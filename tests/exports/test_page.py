"""The format `page` in a real browser: its panel against Python's warp, its figures, keys, mouse, touch and network."""

import gzip
import itertools
import json
import re
from base64 import b64decode
from collections.abc import Iterator
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest
from browser import DrivenPage, driven_page, needs_browser
from fitted_eyes import captures, fitted_eye
from present import present
from warps.own_warps import OpenGl, Warp

from wlr_render import StoredDepth
from wlr_render.budget.error_map import predicted_error
from wlr_render.budget.error_sizes import ErrorSizes
from wlr_render.calibration.fit_display import fit_display
from wlr_render.engine import DepthKind
from wlr_render.errors import BadInputError
from wlr_render.evaluation.misalignment import misalignment_arcmin
from wlr_render.exports import page as module
from wlr_render.exports.export_view import ExportedView, Origin, view_from_centre
from wlr_render.exports.page import Page
from wlr_render.geometry import transforms
from wlr_render.geometry.pinhole import Pinhole
from wlr_render.gl.context import GlContext
from wlr_render.mappings import Eye
from wlr_render.numerics.arrays import FloatArray
from wlr_render.numerics.srgb import encode_srgb
from wlr_render.warp.ray_map import solve_pixels
from wlr_render.warp.view import View, image_from_ray_map
from wlr_render.warp.warp_mesh import WarpMesh

pytestmark = [needs_browser, pytest.mark.slow]
NAME = "</script>north<b>star"
READY = "document.documentElement?.dataset.ready === 'yes'"
POSES = [
    ("planar", (0.0, 0.0, 0.0), 0.0, 0.0),
    ("planar", (0.8, -0.6, 0.7), 4.0, -3.0),
    ("static", (-0.9, 0.5, 0), 0, 6),
]
"""Method, pupil in half eye boxes, and turns of the head to the left and up, degrees."""


@dataclass(frozen=True)
class Opened:
    """A page of a small panel, in a browser."""

    view: ExportedView
    path: Path
    data: dict[str, Any]
    browser: DrivenPage

    @property
    def eye(self) -> Eye:
        return self.view.channels[0]

    def change(self, method: str, pupil: Any, left_deg: float = 0.0, up_deg: float = 0.0) -> FloatArray:
        """Set the state of the page, and draw; returns the viewpoint."""
        turns = f"yaw: {np.deg2rad(left_deg)}, pitch: {np.deg2rad(up_deg)}"
        self.browser.value(f"change({{method: '{method}', pupil: {list(pupil)}, {turns}}}); draw(); 0")
        return self.eye.eye_box.at(np.array(pupil, dtype=float))

    def state(self, name: str) -> Any:
        return self.browser.value(f"state.{name}")


@pytest.fixture(scope="module")
def opened(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Opened]:
    eye, folder = fitted_eye("northstar", 5), tmp_path_factory.mktemp("page")
    predictors = (partial(predicted_error, eye, ErrorSizes()),)
    view = view_from_centre((eye,), Origin(NAME, {}, {}), is_turned=True, predictors=predictors)
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(module, "MOST_PX", 200)
        (path,) = Page().write([view], folder)
    found = re.search(r'id="data">(.*?)</script>', path.read_text(encoding="utf-8"), re.DOTALL)
    assert found
    with driven_page(folder) as browser:
        browser.open(path, READY)
        yield Opened(view, path, json.loads(found[1]), browser)


def panel_codes(page: Opened) -> FloatArray:
    width, height = page.data["panel_px"]
    read = (
        f"(() => {{ draw(); const px = new Uint8Array({4 * width * height});"
        f"gl.readPixels(0, canvas.height - {height}, {width}, {height}, gl.RGBA, gl.UNSIGNED_BYTE, px);"
        "return Array.from(px); })()"
    )
    return np.array(page.browser.value(read), float).reshape(height, width, 4)[::-1, :, :3]


def codes_of_python(page: Opened, context: GlContext, viewpoint: FloatArray, rays_at: FloatArray, head: Any) -> Any:
    """The warp of the page's picture by OpenGL, along rays that Python solves on a finer mesh."""
    data, (width, height) = page.data, page.data["picture_px"]
    bits = np.frombuffer(gzip.decompress(b64decode(data["inverse_depth"])), np.uint8).reshape(2, height, width)
    depth = ((bits[0] + 256.0 * bits[1]) / 65535).astype(np.float32)
    codes = present(cv2.imdecode(np.frombuffer(b64decode(data["picture"]), np.uint8), cv2.IMREAD_COLOR))[..., ::-1]
    left, right, bottom, top = data["picture_borders"]
    camera = Pinhole(width, height, np.array([left, bottom]), np.array([right, top]))
    mesh = WarpMesh(page.eye, data["panel_px"], tolerance_arcmin=0.03)
    axes = mesh.camera(np.eye(4), page.eye.eye_box.centre).view.device_from_camera
    source = View(camera, page.eye.eye_box.centre, np.eye(4), page.view.source.device_from_camera)
    rows = camera.image_from_camera @ image_from_ray_map(source, viewpoint, axes, head)
    stored = StoredDepth(DepthKind.WINDOW, np.inf, 1 / data["nearest"])
    warp = Warp(np.ascontiguousarray(codes), depth, rows, stored, data["nearest"], 1)
    light = OpenGl(context, "300 es").drawn(warp, tuple(data["panel_px"]), mesh, mesh.rays(rays_at)[0])
    return encode_srgb(light).astype(float)


@pytest.mark.gl
@pytest.mark.parametrize(("method", "pupil", "left_deg", "up_deg"), POSES)
def test_panel_pixels_are_those_of_python(
    opened: Opened, gl_context: GlContext, method: str, pupil: Any, left_deg: float, up_deg: float
) -> None:
    viewpoint = opened.change(method, pupil, left_deg, up_deg)
    got = panel_codes(opened)
    yaw, pitch = (transforms.rotation_about(*each) for each in (("y", np.deg2rad(left_deg)), ("x", np.deg2rad(up_deg))))
    head = transforms.rigid(yaw @ pitch, np.zeros(3))
    rays_at = opened.eye.eye_box.centre if method == "static" else viewpoint
    due = codes_of_python(opened, gl_context, viewpoint, rays_at, head)
    off = np.abs(got - due).max(axis=-1)
    print(f"{method}: {np.bincount(off.astype(int).ravel())[:12]} pixels by codes off, largest {off.max():.0f}")
    assert np.ptp(due) > 150
    assert off.max() <= 2


@pytest.mark.parametrize("method", ["naive", "static", "planar"])
def test_the_scene_fills_both_pictures_at_the_limits_of_pupil_and_head(opened: Opened, method: str) -> None:
    count = (
        "(() => { draw(); const [w, h] = [canvas.width, canvas.height], px = new Uint8Array(4 * w * h);"
        "gl.readPixels(0, 0, w, h, gl.RGBA, gl.UNSIGNED_BYTE, px); let black = 0;"
        "for (let k = 0; k < w * h; ++k) if (k % w < panelPx[0] || k % w >= panelPx[0] + GAP)"
        "  black += px[4 * k] + px[4 * k + 1] + px[4 * k + 2] === 0;"
        "return black; })()"
    )
    turn_deg = np.rad2deg(opened.data["most_turn"])
    for left, up, pupil in itertools.product((-turn_deg, turn_deg), (-turn_deg, turn_deg), (-1, 1)):
        opened.change(method, (pupil, -pupil, -1), left, up)
        assert opened.browser.value(count) == 0, (left, up, pupil)
    assert 1.0 / opened.data["nearest"] > module._NEAREST_M


@pytest.mark.parametrize("pupil", [(0.0, 0.0, 0.0), (0.7, -0.8, 0.5)])
def test_misalignment_is_that_of_python(opened: Opened, pupil: Any) -> None:
    viewpoint, eye = opened.change("planar", pupil), opened.eye
    columns, rows = opened.data["map"]
    pixel, axes = eye.display.panel.grid(columns, rows).reshape(-1, 2), opened.view.source.device_from_camera
    for method in ("static", "planar"):
        from_ = eye.eye_box.centre if method == "static" else viewpoint
        a, b, c, d = solve_pixels(eye, axes, pixel, from_).slope_offset.T
        point = viewpoint + np.stack([a + c, b + d, -np.ones_like(a)], axis=-1) @ axes.T
        due = misalignment_arcmin(eye, viewpoint, pixel, point)
        got = np.array(opened.browser.value(f"misalignment('{method}', viewpoint())"))
        np.testing.assert_allclose(got, due, atol=0.01, err_msg=method)
    error = predicted_error(eye, ErrorSizes(), viewpoint, np.inf).at_pixel(pixel)
    got = np.array(opened.browser.value("predicted(viewpoint())"))
    assert np.sqrt(np.mean((got / error - 1) ** 2)) < 0.1


def test_no_figure_is_smaller_than_the_models_are_true(opened: Opened) -> None:
    opened.change("planar", (0.2, 0.1, 0))
    rows = opened.browser.value("[...byId('figures').rows].map(row => [...row.cells].map(cell => cell.textContent))")
    assert rows[2] == ["planar", "below 0.01'", "below 0.01'"]
    assert all(re.fullmatch(r"\d+(\.\d+)?'", text) for row in rows[:2] for text in row[1:])


def test_naive_is_that_of_the_demo(opened: Opened) -> None:
    """The demo's flat picture is fitted to the readings of captures: its weights of the panel's parts differ."""
    eye, centre = opened.eye, opened.eye.eye_box.centre
    flat = fit_display(captures("northstar", "static").both[0], "static", 1).mapping
    pixel = eye.display.panel.grid(*opened.data["map"]).reshape(-1, 2)
    towards = flat.view_dir_of_pixel(pixel, centre).value
    due = misalignment_arcmin(eye, centre, pixel, centre + towards / -towards[:, 2:])
    opened.change("naive", (0, 0, 0))
    got = np.array(opened.browser.value("misalignment('naive', viewpoint())"))
    assert np.sqrt(np.mean(got**2)) == pytest.approx(np.sqrt(np.mean(due**2)), rel=0.1)
    assert np.median(got) > 100


def middle_of(page: Opened, name: str) -> tuple[float, float]:
    box = page.browser.value(
        f"(() => {{ byId('{name}').scrollIntoView(); return byId('{name}').getBoundingClientRect().toJSON(); }})()"
    )
    return box["x"] + box["width"] / 2, box["y"] + box["height"] / 2


def test_keys_choose_the_method_move_the_pupil_and_turn_the_head(opened: Opened) -> None:
    browser = opened.browser
    opened.change("planar", (0, 0, 0))
    browser.press("2")
    assert opened.state("method") == "static"
    browser.value("byId('pad').focus()")
    for key in ("ArrowRight", "ArrowUp", "ArrowUp", "PageDown"):
        browser.press(key)
    assert opened.state("pupil") == pytest.approx(np.array([0.5, 1.0, -0.5]) * 1e-3 / opened.eye.eye_box.size)
    browser.value("byId('pictures').focus()")
    browser.press("ArrowLeft")
    assert (opened.state("yaw"), opened.state("pitch")) == (pytest.approx(np.deg2rad(0.5)), 0)
    for _ in range(40):
        browser.press("ArrowDown")
    assert opened.state("pitch") == pytest.approx(-opened.data["most_turn"])


def test_touch_moves_the_pupil_and_turns_the_head(opened: Opened) -> None:
    opened.change("planar", (0, 0, 0))
    x, y = middle_of(opened, "pad")
    opened.browser.touch((x, y), (x + 20, y), (x + 20, y - 30))
    across, up, along = opened.state("pupil")
    assert across == pytest.approx(2 / 3 * up, rel=0.05)
    assert (up > 0.2, along) == (True, 0)
    x, y = middle_of(opened, "pictures")
    opened.browser.touch((x, y), (x + 12, y), (x + 12, y + 6))
    assert opened.state("yaw") == pytest.approx(2 * opened.state("pitch"), rel=1e-3)
    assert opened.state("yaw") > 0.005


def test_the_page_is_whole_and_names_what_it_is(opened: Opened) -> None:
    """No request but the file's own, no error, the headset's name as text, and that the page is a simulation."""
    assert [each for each in opened.browser.requested if not each.startswith(("data:", "blob:"))] == [
        opened.path.as_uri()
    ]
    assert opened.browser.said == []
    verdict = opened.browser.value("byId('verdict').textContent")
    assert "simulation" in verdict
    assert NAME in verdict
    assert opened.browser.value("document.querySelectorAll('b').length") == 0


def test_devices_are_refused(northstar_view: ExportedView, tmp_path: Path) -> None:
    with pytest.raises(BadInputError, match="the formats c and page hold planar models only; calibrate the headset"):
        list(Page().write([northstar_view], tmp_path))
    assert not list(tmp_path.iterdir())
