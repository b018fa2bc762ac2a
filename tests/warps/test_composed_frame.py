"""A composed frame, corrected or not, shows at every display pixel what the exact ray of each of its colours meets."""

from dataclasses import dataclass, replace
from typing import cast

import numpy as np
import pytest
from flat_image import PrismPlate
from gl_scenes import at
from hardware import allowed, snap_arcmin
from present import narrowed
from warps.composing import (
    CONTEXTS,
    HEAD,
    SMALL,
    Make,
    clear_of_edges,
    draw,
    misplaced_arcmin,
    planar,
    scene,
    traced,
    viewpoint,
)

from benchmarks.scene_source import SceneSource
from wlr_render.draw.ray_tracing import RayRenderer
from wlr_render.geometry import directions, transforms
from wlr_render.mappings import DisplayMapping, Eye, Panel, QueryResult
from wlr_render.numerics.arrays import FloatArray, IntArray
from wlr_render.warp.composed_frame import ComposedFrame
from wlr_render.warp.compositor import Compositor
from wlr_render.warp.raster_camera import EyePlan

LATE = HEAD @ at(
    0.004,
    -0.002,
    0.003,
    transforms.rotation_about("y", np.deg2rad(0.8)) @ transforms.rotation_about("x", np.deg2rad(-0.5)),
)
MOST_ARCMIN, MOST_LATE_ARCMIN = 0.02, 0.05


@pytest.fixture(scope="module")
def renderer() -> RayRenderer:
    return RayRenderer(scene())


def compared(
    compositor: Compositor,
    renderer: RayRenderer,
    mappings: Eye,
    seen: tuple[FloatArray, FloatArray],
    corrected: bool = True,
) -> tuple[FloatArray, IntArray, float]:
    """Misplacement and colour difference at pixels away from edges, for a frame drawn at HEAD and seen elsewhere.

    The third is the misplacement by a step of the positions of the warp grid's vertices.
    """
    drawn_at, (pose, seen_at) = viewpoint(mappings), seen
    source = SceneSource(compositor, scene())
    (camera,) = draw(compositor, source, HEAD, drawn_at).values()
    frame = compositor.compose(
        pose=pose if corrected else None, viewpoint=seen_at if corrected else None, with_source=True
    )
    truth = traced(mappings, compositor.size_px, seen_at, pose, renderer)
    eye = transforms.apply(pose, seen_at)
    clear = clear_of_edges(truth, renderer, eye, camera.view.position_in_world, pose)
    misplaced = misplaced_arcmin(source, camera, frame, truth, pose, seen_at)[clear]
    colour = np.abs(frame.read().astype(int) - truth.colour).max(axis=-1)[clear]
    assert clear.sum() > 0.25 * clear.size
    _, direction = truth.ray_map.world_rays(pose)
    return misplaced, colour, snap_arcmin(direction.astype(float).reshape(*truth.ray_map.shape, 3))


@pytest.mark.parametrize("context", CONTEXTS)
@pytest.mark.slow
def test_it_shows_what_the_exact_rays_meet(compositor: Make, renderer: RayRenderer, headset: Eye, context: str) -> None:
    composed = compositor(headset, context=context)
    misplaced, colour, snapped = compared(composed, renderer, headset, (HEAD, viewpoint(headset)))
    assert misplaced.max() < allowed(composed.context, MOST_ARCMIN, snapped)
    # The boxes' faces and the wall have one colour each, but for the lights' falling off.
    assert np.percentile(colour, 99) <= 2


@pytest.mark.gl
def test_a_lattice_coarser_than_the_display_is_within_its_bound(compositor: Make, renderer: RayRenderer) -> None:
    composed = compositor(planar(), (300, 330), context="egl")
    chosen = composed.plan("right").warp_grid
    assert (chosen.cell_px > 1.1 * composed.plan("right").channels[0].display.panel.size_px / composed.size_px).all()
    misplaced, _, snapped = compared(composed, renderer, planar(), (HEAD, viewpoint(planar())))
    assert misplaced.max() < allowed(composed.context, chosen.bound_arcmin + MOST_ARCMIN, snapped)


@pytest.mark.gl
def test_a_late_pose_and_viewpoint_show_what_a_frame_drawn_then_shows(
    compositor: Make, renderer: RayRenderer, headset: Eye
) -> None:
    late = LATE, viewpoint(headset, -0.6, 0.5, -0.4)
    composed = compositor(headset)
    misplaced, _, snapped = compared(composed, renderer, headset, late)
    assert misplaced.max() < allowed(composed.context, MOST_LATE_ARCMIN, snapped)
    uncorrected, *_ = compared(composed, renderer, headset, late, corrected=False)
    assert np.median(uncorrected) > 20


@pytest.mark.gl
def test_corrections_do_not_depend_on_each_other(compositor: Make, headset: Eye) -> None:
    composed = compositor(headset)
    draw(composed, SceneSource(composed, scene()), HEAD, viewpoint(headset))
    moments = [{}, {"pose": LATE}, {"viewpoint": viewpoint(headset, -0.6, 0.5, -0.4)}]
    pictures = [composed.compose(**moment).read() for moment in moments]
    assert (pictures[0] != pictures[1]).any()
    assert (pictures[0] != pictures[2]).any()
    for moment, picture in [*zip(moments, pictures, strict=True)][::-1]:
        # A solve from another start ends a rounding elsewhere.
        assert np.abs(composed.compose(**moment).read().astype(int) - picture).max() <= 1


@pytest.mark.gl
def test_each_row_of_a_rolling_scan_out_is_that_of_a_frame_at_its_own_pose(compositor: Make, headset: Eye) -> None:
    composed = compositor(headset)
    draw(composed, SceneSource(composed, scene()), HEAD, viewpoint(headset))
    rolling = composed.compose(pose=HEAD, pose_at_last_row=LATE, with_source=True)
    source, picture = rolling.source(), rolling.read()
    for row in (0, 1, 17, SMALL[1] - 1):
        (pose,) = transforms.between(HEAD, LATE, np.array([row / (SMALL[1] - 1)]))
        alone = composed.compose(pose=pose, with_source=True)
        np.testing.assert_allclose(alone.source()[row], source[row], atol=1e-3)
        # How far the filter reaches is told from two rows, which here have one pose.
        assert np.percentile(np.abs(alone.read()[row].astype(int) - picture[row]), 95) <= 2
    np.testing.assert_allclose(pose, LATE, atol=1e-12)


@pytest.mark.gl
def test_a_raster_camera_at_the_viewpoint_gives_the_same_points(
    compositor: Make, renderer: RayRenderer, flat_image_headset: Eye
) -> None:
    headset = flat_image_headset
    seen = viewpoint(headset)
    nearest, paper = (compositor(headset, raster_camera=place) for place in ("nearest", "viewpoint"))
    places = [made.begin_frame(HEAD, seen)["right"].view.position_in_world for made in (nearest, paper)]
    np.testing.assert_allclose(places[1], transforms.apply(HEAD, seen), atol=1e-12)
    assert np.linalg.norm(places[0] - places[1]) > 1e-4
    misplaced, _, snapped = compared(paper, renderer, headset, (HEAD, seen))
    assert misplaced.max() < allowed(paper.context, MOST_ARCMIN, snapped)


@pytest.mark.gl
def test_each_colour_is_what_its_own_models_rays_meet(compositor: Make, flat_image_headset: Eye) -> None:
    see_through = narrowed(flat_image_headset.see_through, PrismPlate)
    colours = [
        replace(flat_image_headset, see_through=replace(see_through, prism=prism)) for prism in (-0.02, 0.0, 0.02)
    ]
    together, renderer, at = (compositor({"right": colours}), RayRenderer(scene()), viewpoint(colours[0]))
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
