"""The eye's picture closes the circle: a panel driven by the truth's own mappings lands on the real object."""

from dataclasses import replace
from pathlib import Path
from typing import cast

import numpy as np
import pytest
from flat_image import FlatImage
from gl_scenes import at, lit, unlit
from numpy.typing import NDArray
from present import narrowed
from small_headsets import changed_device
from toy_headsets import LateralOffset

from wlr_render.draw.painters import TracedPainter
from wlr_render.draw.ray_tracing import EyeView, RayRenderer, eye_view
from wlr_render.geometry import directions, transforms
from wlr_render.geometry.pinhole import Pinhole
from wlr_render.mappings import DisplayMapping, Eye, Panel, QueryResult, Status
from wlr_render.numerics.arrays import FloatArray
from wlr_render.numerics.srgb import decode_srgb
from wlr_render.optics.device_file import load_device
from wlr_render.optics.traced_mappings import traced_eye
from wlr_render.scene.scene import Scene
from wlr_render.scene.shapes import construction

HEAD_POSE = at(0.2, 1.4, 0.5, transforms.rotation_about("y", 0.3))


@pytest.fixture(params=["flat image behind a prism plate", "no_optics", "flat_mirror"])
def headset(request: pytest.FixtureRequest, flat_image_headset: Eye, tmp_path: Path) -> Eye:
    fewer = {"no_optics": ("[1280, 720]", "[320, 180]"), "flat_mirror": ("[1920, 1080]", "[480, 270]")}
    if request.param in fewer:
        return traced_eye(load_device(changed_device(tmp_path, request.param, fewer[request.param])))
    display = narrowed(flat_image_headset.display, FlatImage)
    return replace(flat_image_headset, display=replace(display, panel=Panel(420, 300)))


def ball_and_board() -> Scene:
    board = construction.dot_board(columns=9, rows=7, pitch_m=0.04, diameter_m=0.02)
    wall = construction.plane(9, 9, (0.2, 0.25, 0.3))
    return lit(
        (board, HEAD_POSE @ at(-0.02, 0.01, -0.9)),
        (construction.ball(0.05), HEAD_POSE @ at(0.04, -0.02, -0.6)),
        (wall, HEAD_POSE @ at(0, 0, -2)),
    )


def eyeball_camera(headset: Eye, viewpoint: FloatArray) -> Pinhole:
    """Sees the middle four fifths of the panel, at about its resolution."""
    panel = headset.display.panel
    inner = panel.size_px * (0.1 + 0.8 * np.array([[0.0, 0.0], [1, 0], [0, 1], [1, 1]]))
    tangents = directions.tangents_of_dir(headset.display.view_dir_of_pixel(inner, viewpoint).value)
    return Pinhole.covering(tangents, panel.width_px / np.ptp(tangents[:, 0]), margin_px=0)


def shift_px(picture: NDArray[np.uint8], reference: NDArray[np.uint8]) -> FloatArray:
    """By how many pixels (right, down) a picture lies beside another, by least squares of the brightness gradient."""
    picture, reference = (decode_srgb(x)[..., 1].astype(float) for x in (picture, reference))
    down, right = np.gradient(0.5 * (picture + reference))
    gradient = np.stack([right.ravel(), down.ravel()], axis=1)
    return np.asarray(np.linalg.lstsq(gradient, (reference - picture).ravel(), rcond=None)[0])


def test_a_panel_driven_by_the_truth_shows_the_real_object_where_it_is(headset: Eye) -> None:
    viewpoint = headset.eye_box.at(np.array([0.8, -0.7, 0.6]))
    renderer = RayRenderer(ball_and_board())
    seen = eye_view(headset, renderer, viewpoint, HEAD_POSE, eyeball_camera(headset, viewpoint))
    painter = TracedPainter(headset, renderer, supersample=2, shadows=True)
    virtual = seen.with_display(painter.paint(viewpoint, HEAD_POSE).colour, see_through=0.0)
    assert np.corrcoef(virtual.ravel(), seen.real.ravel())[0, 1] > 0.98
    # What is left is the jagged edges of the eyeball camera's own picture.
    assert np.abs(shift_px(virtual, seen.real)).max() < 0.1
    # A picture for another viewpoint does not land there.
    elsewhere = painter.paint(headset.eye_box.at(np.array([-0.8, 0.7, 0.6])), HEAD_POSE)
    assert np.abs(shift_px(seen.with_display(elsewhere.colour, see_through=0.0), seen.real)).max() > 0.3


def test_the_panel_is_seen_where_the_display_mapping_says(headset: Eye) -> None:
    viewpoint = headset.eye_box.centre
    camera = eyeball_camera(headset, viewpoint)
    seen = eye_view(headset, RayRenderer(ball_and_board()), viewpoint, HEAD_POSE, camera)
    forward = headset.display.view_dir_of_pixel(seen.panel_pixel.reshape(-1, 2), viewpoint)
    assert forward.ok.all()
    tangents = directions.tangents_of_dir(forward.value).reshape(seen.panel_pixel.shape)
    np.testing.assert_allclose(tangents, camera.pixel_centre_tangents(), atol=1e-9)


def test_the_real_scene_is_seen_with_its_shadows_and_through_the_optics(flat_image_headset: Eye) -> None:
    viewpoint, scene = flat_image_headset.eye_box.centre, ball_and_board()
    camera = Pinhole(50, 40, np.array([-0.1, -0.1]), np.array([0.15, 0.1]))
    seen = eye_view(flat_image_headset, RayRenderer(scene), viewpoint, HEAD_POSE, camera)
    view_dir = directions.dir_of_tangents(camera.pixel_centre_tangents())
    ray = flat_image_headset.see_through.real_ray_of_view_dir(view_dir, viewpoint).value
    origin = transforms.apply(HEAD_POSE, ray[..., :3])
    direction = transforms.rotate(HEAD_POSE, ray[..., 3:])
    np.testing.assert_array_equal(seen.real, RayRenderer(scene).render_rays(origin, direction, shadows=True).colour)


def test_light_adds_up() -> None:
    rng = np.random.default_rng(6)
    real, shown = (rng.integers(0, 256, (5, 6, 3)).astype(np.uint8) for _ in range(2))
    centres = np.stack(np.meshgrid(np.arange(6) + 0.5, np.arange(5) + 0.5), axis=-1)
    seen = EyeView(real, centres)
    both = decode_srgb(seen.with_display(shown, gain=0.3, see_through=0.6))
    # A code is worth at most 0.9 % of full light.
    np.testing.assert_allclose(both, 0.3 * decode_srgb(shown) + 0.6 * decode_srgb(real), atol=0.005)
    np.testing.assert_array_equal(seen.with_display(shown, gain=0.0), real)
    np.testing.assert_array_equal(seen.with_display(shown, see_through=0.0), shown)
    np.testing.assert_array_equal(seen.with_display(np.full_like(shown, 255)), 255)


def test_between_panel_pixels_light_is_averaged_and_not_codes() -> None:
    shown = np.zeros((1, 2, 3), np.uint8)
    shown[0, 1] = 255
    half_way = EyeView(np.zeros((1, 1, 3), np.uint8), np.array([[[1.0, 0.5]]]))
    np.testing.assert_array_equal(half_way.with_display(shown), 188)


def test_beside_the_panel_there_is_only_the_world() -> None:
    real = np.full((2, 2, 3), 90, np.uint8)
    pixel = np.array([[[np.nan, np.nan], [-0.2, 1.0]], [[1.0, 1.0], [1.5, 0.5]]])
    lit_up = EyeView(real, pixel).with_display(np.full((2, 2, 3), 200, np.uint8))
    np.testing.assert_array_equal((lit_up > 90).all(axis=-1), [[False, False], [True, True]])


def test_where_the_eye_sees_no_world_it_is_dark(toy_headset: Eye) -> None:
    blocked = replace(narrowed(toy_headset.see_through, LateralOffset), offset_m=np.nan)
    headset = replace(toy_headset, see_through=blocked, display=cast(DisplayMapping, _Unseen()))
    scene = unlit((construction.plane(9, 9), at(0, 0, -1)))
    camera = Pinhole(3, 2, -np.ones(2), np.ones(2))
    seen = eye_view(headset, RayRenderer(scene), headset.eye_box.centre, np.eye(4), camera)
    assert (seen.real == 0).all()


class _Unseen:
    def pixel_of_view_dir(self, view_dir: FloatArray, viewpoint: object, warm_start: object = None) -> QueryResult:
        shape = view_dir.shape[:-1]
        return QueryResult(np.full((*shape, 2), np.nan), np.full(shape, Status.CLIPPED, np.uint8))
