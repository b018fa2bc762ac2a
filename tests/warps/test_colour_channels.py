"""Three models of one eye: each colour is bent as its own model says."""

from dataclasses import dataclass, replace
from typing import cast

import numpy as np
import pytest
from flat_image import PrismPlate
from present import narrowed
from warps.composing import HEAD, Make, clear_of_edges, draw, scene, traced, viewpoint

from benchmarks.scene_source import SceneSource
from wlr_render.draw.ray_tracing import RayRenderer
from wlr_render.geometry import directions, transforms
from wlr_render.mappings import DisplayMapping, Eye, Panel, QueryResult
from wlr_render.numerics.arrays import FloatArray
from wlr_render.warp.composed_frame import ComposedFrame
from wlr_render.warp.compositor import Compositor
from wlr_render.warp.raster_camera import EyePlan


@pytest.mark.gl
def test_each_colour_is_what_its_own_models_rays_meet(compositor: Make, flat_image_headset: Eye) -> None:
    see_through = narrowed(flat_image_headset.see_through, PrismPlate)
    colours = [
        replace(flat_image_headset, see_through=replace(see_through, prism=prism)) for prism in (-0.02, 0.0, 0.02)
    ]
    together, renderer, at = (
        compositor({"right": colours}),
        RayRenderer(scene()),
        viewpoint(colours[0]),
    )
    (camera,) = draw(together, SceneSource(together, scene()), HEAD, at).values()
    picture = together.compose().read().astype(int)
    for channel, model in enumerate(colours):
        truth = traced(model, together.size_px, at, HEAD, renderer)
        eye, drawn_from = transforms.apply(HEAD, at), camera.view.position_in_world
        clear = clear_of_edges(truth, renderer, eye, drawn_from, HEAD, reach_px=1)
        difference = np.abs(picture - truth.colour)[clear].max(axis=0)
        assert clear.mean() > 0.5
        assert difference[channel] <= 2
        assert np.delete(difference, channel).max() > 40


def composed(compositor: Compositor, model: Eye) -> ComposedFrame:
    draw(compositor, SceneSource(compositor, scene()), HEAD, viewpoint(model))
    return compositor.compose()


@pytest.mark.gl
def test_three_models_alike_are_one(compositor: Make, flat_image_headset: Eye) -> None:
    models = flat_image_headset, [flat_image_headset] * 3
    alone, together = (composed(compositor({"right": given}), flat_image_headset) for given in models)
    np.testing.assert_array_equal(together.read(), alone.read())
    assert together.unsolved()["right"] == {name: 3 * count for name, count in alone.unsolved()["right"].items()}


@dataclass(frozen=True)
class Rippled:
    """A display whose directions swing to and fro along the panel's rows."""

    whole: DisplayMapping

    @property
    def panel(self) -> Panel:
        return self.whole.panel

    def view_dir_of_pixel(self, pixel: FloatArray, at: FloatArray, warm_start: object = None) -> QueryResult:
        answer = self.whole.view_dir_of_pixel(pixel, at)
        swing = 1e-4 * np.sin(40 * np.asarray(pixel)[..., 0] / self.panel.width_px)
        value = directions.normalised(answer.value + swing[..., None] * [1.0, 0.0, 0.0])
        return replace(answer, value=value)


@pytest.mark.parametrize("place", range(3))
def test_the_most_curved_colour_says_how_fine_the_lattice_is(flat_image_headset: Eye, place: int) -> None:
    colours = [flat_image_headset] * 3
    colours[place] = replace(flat_image_headset, display=cast(DisplayMapping, Rippled(flat_image_headset.display)))
    flat, together = (
        EyePlan.of(models, (72, 60), 1.0).warp_grid.cell_px for models in ((flat_image_headset,), tuple(colours))
    )
    assert (together < 0.95 * flat).all()
