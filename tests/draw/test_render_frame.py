from typing import NoReturn

import pytest
from gl_scenes import at, quad, unlit
from present import present
from toy_headsets import make_headset

import wlr_render as wlr
from wlr_render.draw import render_frame
from wlr_render.draw.scene_raster import SceneRaster
from wlr_render.gl.context import GlContext
from wlr_render.mappings import Eye
from wlr_render.warp.view import View

pytestmark = pytest.mark.gl
WALL = unlit((quad((-9, -9), (9, 9)), at(0, 0, -2)))


@pytest.mark.parametrize("largest_px", [100, 150])
def test_the_intermediate_image_fits_what_opengl_takes(
    toy_headset: Eye, gl_context: GlContext, monkeypatch: pytest.MonkeyPatch, largest_px: int
) -> None:
    monkeypatch.setattr(gl_context, "largest_side_px", largest_px)
    monkeypatch.setattr(gl_context, "release", lambda: None)  # other tests use it
    monkeypatch.setattr(render_frame, "open_scene_raster", lambda scene: SceneRaster(gl_context, scene))
    frame = wlr.render(toy_headset, WALL, method="raster", with_geometry=True)
    assert largest_px - 8 < max(present(frame.view).camera.size_px) <= largest_px
    assert (frame.colour[10:-10, 10:-10] == 255).all()


class DrawnError(Exception):
    """Raised in place of drawing, which takes long at these sizes."""


@pytest.mark.parametrize("side_px", [1440, 3200, 5000, 9000])
def test_large_panels_get_the_finest_image_of_8192_pixels_a_side(
    gl_context: GlContext, monkeypatch: pytest.MonkeyPatch, side_px: int
) -> None:
    cameras = []

    def draw_on_gpu(raster: SceneRaster, view: View, name: str = "") -> NoReturn:
        cameras.append(view.camera)
        raise DrawnError

    monkeypatch.setattr(SceneRaster, "draw_on_gpu", draw_on_gpu)
    with pytest.raises(DrawnError):
        wlr.render(make_headset(side_px, side_px), WALL, method="raster")
    (camera,) = cameras
    if side_px == 1440:
        assert (camera.width_px - 4) * (camera.height_px - 4) == pytest.approx((2.75 * side_px) ** 2, rel=1e-3)
    else:
        assert 8192 - 8 < max(camera.size_px) <= 8192
