from collections.abc import Callable
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

from benchmarks.simulated_lab.exact_views import panel_position
from wlr_render.errors import BadInputError
from wlr_render.geometry.directions import ARCMIN
from wlr_render.geometry.transforms import OPENXR_FROM_OPENCV, inverse, rigid, rotate, rotation_about
from wlr_render.lenses.lens_camera import LensCamera
from wlr_render.numerics.arrays import Float32Array, FloatArray
from wlr_render.optics.device import ClearAperture, EyeOptics, PlacedSurface
from wlr_render.optics.device_file import load_device
from wlr_render.optics.traced_mappings import TracedDisplay
from wlr_render.simulation.photographs.camera import SimulatedLens
from wlr_render.simulation.photographs.camera_view import CameraView
from wlr_render.simulation.photographs.pixel_map import PixelMap

LOOKING_AHEAD = rigid(OPENXR_FROM_OPENCV, np.zeros(3))
BROWN = np.array([-0.1, 0.03, 1e-3, -5e-4, 0.0])


def camera(size_px: tuple[int, int], focal: float, distortion: NDArray[Any] | None = None) -> LensCamera:
    lens = () if distortion is None else (distortion,)
    return LensCamera(size_px, np.array([focal, focal]), 0.5 * np.array(size_px, dtype=float), *lens)


def optics(name: str) -> EyeOptics:
    return load_device(name).eyes["right"]


def sight(name: str, lens: SimulatedLens, pose: FloatArray = LOOKING_AHEAD, samples: int = 16) -> CameraView:
    return CameraView.through_optics(optics(name), lens, pose, samples)


def place_at_depth(depth_m: float) -> list[Any]:
    """Radiance that tells where rays meet the plane z = -depth: x and y in turn."""

    def axis(number: int) -> Callable[[Any], Any]:
        def radiance(ray: Float32Array) -> Any:
            along = (-depth_m - ray[..., 2]) / ray[..., 5]
            return ray[..., number] + along * ray[..., 3 + number]

        return radiance

    return [axis(0), axis(1)]


def pixel_centres(size_px: tuple[int, int]) -> NDArray[Any]:
    return np.stack(np.meshgrid(np.arange(size_px[0]) + 0.5, np.arange(size_px[1]) + 0.5), axis=-1)


def uniform(value: int = 255, shape: tuple[int, int] = (720, 1280)) -> NDArray[np.uint8]:
    return np.full(shape, value, np.uint8)


def test_a_bare_panel_is_photographed_pixel_by_pixel() -> None:
    # 0.25 mm pixels at 500 mm: with 2000 px per tangent each is one camera pixel, and the middles coincide.
    picture = np.zeros((720, 1280), np.uint8)
    picture[:, 640 + 5] = 255
    light = sight("no_optics", SimulatedLens(camera((64, 48), 2000.0), 0.0)).panel_light(picture, gamma=1.0)
    # A pixel seen through a box of one pixel and the ramp of a quarter: 1/16 of it falls into the neighbours.
    np.testing.assert_allclose(light[:, 37], 15 / 16, atol=0.01)
    np.testing.assert_allclose(light[:, [36, 38]], 1 / 32, atol=0.01)
    assert np.abs(light[:, [35, 39]]).max() < 1e-6


@pytest.mark.parametrize("name", ["no_optics", "flat_mirror", "freeform40"])
def test_a_uniform_panel_gives_uniform_light_up_to_its_edge_and_none_beyond(name: str) -> None:
    lens = SimulatedLens(camera((96, 64), 100.0, BROWN))
    eye = optics(name)
    light = sight(name, lens).panel_light(uniform(255, (eye.panel.pixels.height_px, eye.panel.pixels.width_px)))
    seen = panel_position(eye, lens.camera, LOOKING_AHEAD, pixel_centres((96, 64)))
    inner = np.abs(seen.value / eye.panel.pixels.size_px - 0.5).max(axis=-1) < 0.44
    assert 300 < inner.sum() < 5000
    finer = panel_position(eye, lens.camera, LOOKING_AHEAD, pixel_centres((768, 512)) / 8)
    np.testing.assert_allclose(light[inner], 1.0, atol=1e-5)
    assert light.min() == 0.0
    assert light.max() < 1.0 + 1e-5
    assert light.sum() == pytest.approx(finer.ok.sum() / 64, rel=0.005)


def test_a_picture_and_its_negative_add_up_to_white() -> None:
    one = sight("flat_mirror", SimulatedLens(camera((80, 60), 150.0)))
    picture = np.random.default_rng(2).integers(0, 256, (1080, 1920), dtype=np.uint8)
    both = one.panel_light(picture, 1.0) + one.panel_light(255 - picture, 1.0)
    np.testing.assert_allclose(both, one.panel_light(uniform(255, (1080, 1920)), 1.0), atol=2e-5)


def test_a_panel_shines_by_its_gamma() -> None:
    one = sight("no_optics", SimulatedLens(camera((12, 10), 2000.0)), samples=4)
    np.testing.assert_allclose(one.panel_light(uniform(128)), (128 / 255) ** 2.2, atol=1e-6)


def test_the_mirrored_panel_stands_on_its_place() -> None:
    # The mirror image of the flat mirror's panel lies 80 mm ahead, 48 mm wide, 1920 px; u runs to the right.
    picture = np.zeros((1080, 1920), np.uint8)
    picture[:, :960] = 255
    light = sight("flat_mirror", SimulatedLens(camera((80, 60), 400.0), 0.0)).panel_light(picture)
    np.testing.assert_allclose(light[:, :39], 1.0, atol=1e-5)
    np.testing.assert_allclose(light[:, 41:], 0.0, atol=1e-5)


def test_the_edge_of_a_mirror_cuts_the_panel_off() -> None:
    def narrowed(surface: PlacedSurface) -> PlacedSurface:
        high = np.array([0.005, *surface.aperture.high[1:]])
        return replace(surface, aperture=ClearAperture(surface.aperture.low, high))

    lens = SimulatedLens(camera((140, 61), 400.0), 0.0)
    one = CameraView.through_optics(optics("flat_mirror").with_surfaces(narrowed), lens, LOOKING_AHEAD)
    middle = one.panel_light(uniform(255, (1080, 1920)))[30]
    # 5 mm at the mirror's 40 mm are 50 pixels right of the middle, well within the panel's picture.
    np.testing.assert_allclose(middle[:119], 1.0, atol=1e-5)
    np.testing.assert_allclose(middle[121:], 0.0, atol=1e-5)


@pytest.mark.parametrize("name", ["no_optics", "freeform40", "birdbath28"])
def test_spots_on_the_panel_land_where_exact_rays_say(name: str) -> None:
    eye = optics(name)
    lens = SimulatedLens(camera((240, 180), 1200.0, BROWN), 0.0)
    spots = np.floor(eye.panel.pixels.grid(24, 18)).astype(int).reshape(-1, 2)
    picture = np.zeros((eye.panel.pixels.height_px, eye.panel.pixels.width_px), np.uint8)
    for u, v in spots:
        picture[v - 5 : v + 5, u - 5 : u + 5] = 255
    light = sight(name, lens).panel_light(picture)
    view_dir = TracedDisplay(eye, 0.55).view_dir_of_pixel(spots.astype(float), LOOKING_AHEAD[:3, 3]).value
    expected = lens.camera.pixel_of_point(rotate(inverse(LOOKING_AHEAD), view_dir))
    inside = np.all((expected > 12) & (expected < np.array([228, 168])), axis=-1)
    assert inside.sum() >= 12
    at = pixel_centres((240, 180))
    error = []
    for pixel in expected[inside]:
        weight = np.where(np.abs(at - pixel).max(axis=-1) < 9, light, 0.0)
        error.append(np.average(at.reshape(-1, 2), axis=0, weights=weight.ravel()) - pixel)
    # Curvature of the mapping and the 16 samples leave some hundredths of a pixel, but no common shift.
    np.testing.assert_allclose(error, 0.0, atol=0.04)
    np.testing.assert_allclose(np.mean(error, axis=0), 0.0, atol=0.005)


def test_the_world_through_a_plate_is_shifted_by_the_closed_form() -> None:
    lens = SimulatedLens(camera((60, 40), 150.0, BROWN), 0.0)
    one = sight("plane_plate", lens, samples=1)
    tangents = lens.camera.tangents_of_pixel(pixel_centres((60, 40))) * [1, -1]
    angle = np.arctan(np.linalg.norm(tangents, axis=-1))
    # By t (tan a - tan a') along the plane, a' the angle in the glass of t = 5 mm, n = 1.5.
    shift = 0.005 * (np.tan(angle) - np.tan(np.arcsin(np.sin(angle) / 1.5)))
    expected = tangents * (0.8 - (shift / np.tan(angle)))[..., None]
    for axis, radiance in enumerate(place_at_depth(0.8)):
        np.testing.assert_allclose(one.world_light(radiance), expected[..., axis], atol=2e-6)


def test_a_turned_camera_without_headset_sees_straight_rays_in_the_frame_that_it_is_given() -> None:
    lens = SimulatedLens(camera((60, 40), 100.0, BROWN), 0.001, 2.0)
    pose = rigid(OPENXR_FROM_OPENCV @ rotation_about("y", 0.3), np.array([0.1, -0.2, 0.3]))
    one = CameraView.without_headset(lens, pose, samples=2)
    direction = lens.camera.dir_of_pixel(pixel_centres((60, 40))) @ pose[:3, :3].T
    expected = pose[:3, 3] + (-1.0 - 0.3) / direction[..., 2:] * direction
    for axis, radiance in enumerate(place_at_depth(1.0)):
        # Second order in the pixel: the mean over a pixel is not quite its middle.
        np.testing.assert_allclose(one.world_light(radiance), expected[..., axis], atol=2e-5)
    length = one.world_light(lambda ray: np.linalg.norm(ray[..., 3:], axis=-1))
    np.testing.assert_allclose(length, 1.0, atol=1e-6)


def test_a_uniform_world_gives_uniform_light_wherever_a_ray_comes_in() -> None:
    lens = SimulatedLens(camera((90, 60), 60.0), 0.004, 0.5)
    light = sight("freeform40", lens).world_light(lambda ray: np.where(np.isnan(ray[..., 0]), np.nan, 0.7))
    assert light.max() == pytest.approx(0.7, abs=1e-6)
    assert light.min() == 0.0  # beyond the combiner's edge
    assert np.mean(np.abs(light - 0.7) < 1e-6) > 0.3


@pytest.mark.parametrize(("name", "focal"), [("freeform40", 250.0), ("northstar", 250.0), ("birdbath28", 250.0)])
def test_interpolated_rays_are_exact_ones_to_a_hundredth(
    name: str, focal: float, monkeypatch: pytest.MonkeyPatch
) -> None:
    eye = optics(name)
    pose = rigid(OPENXR_FROM_OPENCV, eye.eye_box.centre)
    lens = SimulatedLens(camera((240, 180), focal, BROWN))
    rng, panel_px, world_arcmin = np.random.default_rng(0), [], []

    def measured(
        exact: Callable[..., Any],
        size_px: tuple[int, int],
        offset: FloatArray,
        tolerance: FloatArray,
        make: Callable[..., PixelMap] = PixelMap.sample,
    ) -> PixelMap:
        """Compare the interpolated pixels, at 500 random ones of them, with exact rays."""
        made = make(exact, size_px, offset, tolerance)
        interpolated = made.lit.copy()
        interpolated[made.alone[:, 0], made.alone[:, 1]] = False
        place = rng.permutation(np.argwhere(interpolated))[:500]
        error = made.planes()[:, place[:, 0], place[:, 1]].T - exact(place[:, ::-1] + 0.5 + offset)[0]
        if len(tolerance) == 2:
            panel_px.append(np.abs(error).max())
        else:  # a point at 0.3 m
            angle = np.linalg.norm(error[:, :2], axis=-1) / 0.3 + np.linalg.norm(error[:, 2:], axis=-1)
            world_arcmin.append(angle.max() / ARCMIN)
        return made

    with monkeypatch.context() as patch:
        patch.setattr(PixelMap, "sample", measured)
        CameraView.through_optics(eye, lens, pose, samples=4)
    assert len(panel_px) == len(world_arcmin) == 4
    assert 0.0 < max(panel_px) < 0.01
    assert 0.0 < max(world_arcmin) < 0.01

    one = CameraView.through_optics(eye, lens, pose, samples=1)
    seen = panel_position(eye, lens.camera, pose, pixel_centres((240, 180)))
    there = np.moveaxis(one.on_panel[0].planes(), 0, -1)[seen.ok]
    assert seen.ok.mean() > 0.3
    np.testing.assert_allclose(there, seen.value[seen.ok], atol=0.01)
    assert one.on_panel[0].lit[seen.ok].all()


@pytest.mark.parametrize(("depth_m", "focus_m"), [(0.4, 1.0), (1.0, 0.5), (0.5, float("inf")), (0.8, 0.8)])
def test_a_spot_is_blurred_by_the_thin_lens_formula(depth_m: float, focus_m: float) -> None:
    pupil_m, focal = 0.004, 1500.0

    def variance(pupil_diameter_m: float) -> float:
        radius = 3.0 * depth_m / focal  # three pixels

        def spot(ray: Float32Array) -> Float32Array:
            x, y = (radiance(ray) for radiance in place_at_depth(depth_m))
            return np.asarray(np.hypot(x, y) < radius, np.float32)

        lens = SimulatedLens(camera((40, 40), focal), pupil_diameter_m, focus_m)
        light = CameraView.without_headset(lens, LOOKING_AHEAD, samples=64).world_light(spot)
        mean = np.average(np.arange(40), weights=light.sum(axis=0))
        return float(np.average((np.arange(40) - mean) ** 2, weights=light.sum(axis=0)))

    # A uniform disc has a variance of diameter^2 / 16 along each axis.
    blur_px = 4.0 * np.sqrt(max(variance(pupil_m) - variance(0.0), 0.0))
    assert blur_px == pytest.approx(focal * pupil_m * abs(1 / depth_m - 1 / focus_m), rel=0.04, abs=0.3)


def test_distortion_moves_a_spot_as_the_camera_says() -> None:
    lens = SimulatedLens(camera((80, 60), 100.0, 3 * BROWN), 0.001, 1.0)
    point = np.array([0.27, 0.17])

    def spot(ray: Float32Array) -> Float32Array:
        x, y = (radiance(ray) for radiance in place_at_depth(1.0))
        return np.asarray(np.hypot(x - point[0], y - point[1]) < 0.03, np.float32)

    light = CameraView.without_headset(lens, LOOKING_AHEAD, samples=64).world_light(spot)
    found = np.array(
        [np.average(np.arange(80) + 0.5, weights=light.sum(0)), np.average(np.arange(60) + 0.5, weights=light.sum(1))]
    )
    np.testing.assert_allclose(found, lens.camera.pixel_of_tangents(point * [1, -1]), atol=0.1)


def test_a_camera_that_looks_away_takes_a_dark_picture() -> None:
    backwards = rigid(OPENXR_FROM_OPENCV @ rotation_about("y", np.pi), np.zeros(3))
    one = sight("flat_mirror", SimulatedLens(camera((20, 10), 30.0)), backwards, samples=2)
    assert not one.panel_light(uniform(255, (1080, 1920))).any()
    through_freeform = sight("freeform40", SimulatedLens(camera((20, 10), 30.0)), backwards, samples=2)
    assert not through_freeform.world_light(lambda ray: np.ones(ray.shape[:-1])).any()


def test_without_headset_there_is_no_panel() -> None:
    one = CameraView.without_headset(SimulatedLens(camera((20, 10), 30.0)), LOOKING_AHEAD, samples=2)
    light = one.panel_light(uniform())
    assert light.shape == (10, 20)
    assert not light.any()


def test_what_radiance_does_not_know_is_dark() -> None:
    one = CameraView.without_headset(SimulatedLens(camera((20, 10), 30.0)), LOOKING_AHEAD, samples=2)
    assert not one.world_light(lambda ray: np.full(ray.shape[:-1], np.nan)).any()


@pytest.mark.parametrize("image", [uniform(1, (1280, 720)), np.ones((720, 1280))])
def test_an_image_that_the_panel_cannot_show_is_refused(image: NDArray[Any]) -> None:
    with pytest.raises(BadInputError, match="1280 x 720"):
        sight("no_optics", SimulatedLens(camera((12, 10), 300.0)), samples=1).panel_light(image)
