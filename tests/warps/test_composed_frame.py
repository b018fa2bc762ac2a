"""A composed frame shows, at every display pixel, what that pixel's exact ray meets; so does a corrected one."""

import numpy as np
import pytest
from gl_scenes import at
from hardware import allowed, snap_arcmin
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
from wlr_render.geometry import transforms
from wlr_render.mappings import Eye
from wlr_render.numerics.arrays import FloatArray, IntArray
from wlr_render.warp.compositor import Compositor

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
@pytest.mark.slow
def test_a_lattice_coarser_than_the_display_is_within_its_bound(compositor: Make, renderer: RayRenderer) -> None:
    composed = compositor(planar(), (300, 330), context="egl")
    chosen = composed.plan("right").warp_grid
    assert (chosen.cell_px > 1.1 * composed.plan("right").channels[0].display.panel.size_px / composed.size_px).all()
    misplaced, _, snapped = compared(composed, renderer, planar(), (HEAD, viewpoint(planar())))
    assert misplaced.max() < allowed(composed.context, chosen.bound_arcmin + MOST_ARCMIN, snapped)


@pytest.mark.slow
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


@pytest.mark.slow
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
