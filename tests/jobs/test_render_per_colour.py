from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray
from small_headsets import prism_of_plastic

from wlr_render.draw.raster_painter import WarpedPainter
from wlr_render.draw.scene_raster import SceneRaster
from wlr_render.evaluation.lateral_colour import lateral_colour
from wlr_render.geometry import directions
from wlr_render.gl.context import GlContext
from wlr_render.jobs.headset import open_colours
from wlr_render.jobs.render import render
from wlr_render.jobs.render_options import RenderOptions
from wlr_render.mappings import Eye
from wlr_render.numerics.srgb import decode_srgb
from wlr_render.scene.image_files import read_map, read_png
from wlr_render.scene.scene_file import load_scene

WHITE_DISC = """
format = "wlr-scene"
version = 1
frame = "openxr"
ambient = [1.0, 1.0, 1.0]

[[object]]
name = "disc"
shape = "sphere"
radius_m = 0.1
colour = [1.0, 1.0, 1.0]
position_m = [-0.25, 0.15, -1.5]
"""


@pytest.fixture
def colourful(tmp_path: Path) -> RenderOptions:
    """A white disc near a corner of what a prism of 320 x 240 pixels shows."""
    scene = tmp_path / "disc.toml"
    scene.write_text(WHITE_DISC, encoding="utf-8")
    return RenderOptions(prism_of_plastic(tmp_path, 320, 240), str(scene), out=tmp_path / "colours")


def seen_middles(picture: NDArray[np.uint8], channels: tuple[Eye, ...]) -> NDArray[Any]:
    """Directions (3, 3) in which the eye sees the middle of what each colour of a picture shows."""
    light = decode_srgb(picture).astype(float)
    v, u = np.indices(light.shape[:2]) + 0.5
    middle = np.stack([(light * axis[..., None]).sum(axis=(0, 1)) for axis in (u, v)], axis=-1)
    pixel = middle / light.sum(axis=(0, 1))[:, None]
    centre = channels[0].eye_box.centre
    return np.array(
        [each.display.view_dir_of_pixel(at, centre).value for each, at in zip(channels, pixel, strict=True)]
    )


@pytest.mark.slow
@pytest.mark.parametrize(
    ("way", "unseen_arcmin"),
    [
        # Edges are sampled once a pixel, each colour's elsewhere: a twentieth of a pixel is seen of that.
        ({"method": "raster", "resolution": 2.0}, 0.25),
        ({"method": "raytrace", "backend": "auto", "supersample": 4}, 0.05),
    ],
    ids=["raster", "raytrace"],
)
def test_a_white_disc_has_no_fringe_where_each_colour_has_its_map(
    colourful: RenderOptions, way: Mapping[str, Any], unseen_arcmin: float
) -> None:
    """Seen through the prism, whose glass spreads the colours of one pixel."""
    channels = open_colours(colourful.headset)
    fringe = {}
    for per_colour in (False, True):
        job = replace(colourful, per_colour=per_colour, out=colourful.out / str(per_colour), **way)
        render(job)
        red, green, blue = seen_middles(read_png(job.out / "right-000000.png"), channels)
        fringe[per_colour] = directions.arcmin_between(np.stack([red, blue]), green)
    centre = channels[1].eye_box.centre
    pixel = channels[1].display.pixel_of_view_dir(green[None], centre).value
    spread = [lateral_colour(channels[1], other, centre, pixel)["display"][0] for other in channels[::2]]
    np.testing.assert_allclose(fringe[False], spread, rtol=0.05)
    assert fringe[False].min() > 0.6
    assert fringe[True].max() < unseen_arcmin


@pytest.mark.slow
def test_the_picture_and_the_maps_are_those_of_the_three_colours(
    colourful: RenderOptions, gl_context: GlContext
) -> None:
    render(replace(colourful, per_colour=True, maps="tiff"))
    channels, raster = open_colours(colourful.headset), SceneRaster(gl_context, load_scene(colourful.scene))
    drawn = read_png(colourful.out / "right-000000.png")
    painter = WarpedPainter(channels, raster, colourful.resolution)
    frame = painter.paint(channels[0].eye_box.centre, np.eye(4), with_geometry=True)
    np.testing.assert_array_equal(drawn, frame.colour)
    assert (drawn[..., 0] != drawn[..., 2]).any()
    for colour, source in zip(("red", "green", "blue"), frame.sources, strict=True):
        np.testing.assert_array_equal(read_map(colourful.out / f"right-000000-{colour}.tiff"), source)
    # Frame, metadata, ledger and the report as three files; maps and from where they were drawn.
    assert len(list(colourful.out.iterdir())) == 10
