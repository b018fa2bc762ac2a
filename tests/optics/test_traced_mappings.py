"""The exact mappings: round trips on every shipped device, closed-form devices, statuses, batch shapes."""

from collections.abc import Mapping, Sequence
from pathlib import Path

import numpy as np
import pytest
from present import narrowed, present
from small_headsets import changed_device

from wlr_render.errors import BadInputError
from wlr_render.geometry import rays
from wlr_render.geometry.directions import dir_of_tangents, normalised
from wlr_render.geometry.transforms import apply
from wlr_render.io.atomic_files import resource, shipped_names
from wlr_render.mappings import Eye, Status
from wlr_render.numerics.arrays import FloatArray
from wlr_render.optics.device_file import load_device
from wlr_render.optics.sag_surfaces import SagSurface
from wlr_render.optics.surfaces import Conic
from wlr_render.optics.traced_mappings import traced_eye
from wlr_render.optics.tracer import trace

DEVICES = shipped_names("devices", ".toml")
CORNERS = np.stack(np.meshgrid([-1, 1], [-1, 1], [-1, 1]), axis=-1).reshape(-1, 3)


@pytest.fixture(scope="module")
def mappings() -> dict[str, Eye]:
    return {name: traced_eye(load_device(name)) for name in DEVICES}


def queries(eye: Eye, count: int = 400, seed: int = 11) -> tuple[FloatArray, FloatArray]:
    """Pixels over the whole panel, its corners included, and viewpoints over the whole box, its corners included."""
    rng = np.random.default_rng(seed)
    pixel = rng.uniform(0, 1, (count, 2))
    unit = rng.uniform(-1, 1, (count, 3))
    pairs = [(corner, place) for corner in CORNERS for place in ([0, 0], [0, 1], [1, 0], [1, 1])]
    unit[: len(pairs)] = [corner for corner, _ in pairs]
    pixel[: len(pairs)] = [place for _, place in pairs]
    return pixel * eye.display.panel.size_px, eye.eye_box.at(unit)


@pytest.mark.parametrize("name", DEVICES)
def test_display_round_trip_over_the_whole_panel_and_eye_box(mappings: Mapping[str, Eye], name: str) -> None:
    eye = mappings[name]
    pixel, viewpoint = queries(eye)
    seen = eye.display.view_dir_of_pixel(pixel, viewpoint)
    assert (seen.status == Status.OK).all(), "the whole panel is seen from the whole eye box"
    np.testing.assert_allclose(np.linalg.norm(seen.value, axis=-1), 1.0, atol=1e-15)
    back = eye.display.pixel_of_view_dir(seen.value, viewpoint)
    assert back.ok.all()
    np.testing.assert_allclose(back.value, pixel, atol=2e-9)


@pytest.mark.parametrize("name", DEVICES)
@pytest.mark.parametrize("distance", [0.3, 2.0, 1e4])
def test_see_through_round_trip_over_the_displays_field(
    mappings: Mapping[str, Eye], name: str, distance: float
) -> None:
    """Real points from 0.3 m to infinity, seen wherever the display is seen."""
    eye = mappings[name]
    pixel, viewpoint = queries(eye)
    view_dir = eye.display.view_dir_of_pixel(pixel, viewpoint).value
    ray = eye.see_through.real_ray_of_view_dir(view_dir, viewpoint)
    assert ray.ok.all(), "see-through covers the display's field"
    origin, direction = rays.split(ray.value)
    point = origin + distance * direction
    seen = eye.see_through.view_dir_of_real_point(point, viewpoint)
    assert seen.ok.all()
    np.testing.assert_allclose(seen.value, view_dir, atol=1e-12)
    again = eye.see_through.real_ray_of_view_dir(seen.value, viewpoint)
    assert np.max(rays.distance_to_point(again.value, point) / distance) < 1e-12


@pytest.mark.parametrize("name", ["northstar", "prism5701202", "no_optics"])
def test_directions_of_real_points_cover_the_display_as_well(mappings: Mapping[str, Eye], name: str) -> None:
    """A virtual point anywhere in the field at 0.3 m and beyond has a view direction, not only those shot at."""
    eye = mappings[name]
    pixel, viewpoint = queries(eye, 100)
    straight = eye.display.view_dir_of_pixel(pixel, viewpoint).value
    assert eye.see_through.view_dir_of_real_point(viewpoint + 0.3 * straight, viewpoint).ok.all()


@pytest.mark.parametrize("lead", [(), (1,), (3, 1, 2)])
def test_batch_shapes_broadcasting_and_warm_start(mappings: Mapping[str, Eye], lead: tuple[int, ...]) -> None:
    eye = mappings["northstar"]
    count = int(np.prod(lead))
    pixel, viewpoint = queries(eye)
    pixel, viewpoint = pixel[:count].reshape(*lead, 2), viewpoint[40]
    seen = eye.display.view_dir_of_pixel(pixel, viewpoint)
    assert seen.value.shape == (*lead, 3)
    assert seen.status.shape == lead
    again = eye.display.view_dir_of_pixel(pixel, viewpoint + 1e-4, seen.warm_start)
    cold = eye.display.view_dir_of_pixel(pixel, viewpoint + 1e-4)
    np.testing.assert_allclose(again.value, cold.value, atol=1e-11)
    assert eye.display.pixel_of_view_dir(seen.value, viewpoint).value.shape == (*lead, 2)
    ray = eye.see_through.real_ray_of_view_dir(seen.value, viewpoint)
    assert ray.value.shape == (*lead, 6)
    point = viewpoint + seen.value
    first = eye.see_through.view_dir_of_real_point(point, viewpoint)
    second = eye.see_through.view_dir_of_real_point(point, viewpoint, first.warm_start)
    assert first.value.shape == (*lead, 3)
    np.testing.assert_allclose(second.value, first.value, atol=1e-12)


def test_more_queries_than_a_block_and_a_useless_warm_start(mappings: Mapping[str, Eye]) -> None:
    eye = mappings["no_optics"]
    pixel, viewpoint = queries(eye, 70_000)
    useless = np.full(pixel.shape, np.nan)
    seen = eye.display.view_dir_of_pixel(pixel, viewpoint, useless)
    panel = load_device("no_optics").eyes["right"].panel
    np.testing.assert_allclose(seen.value, normalised(panel.point_of_pixel(pixel) - viewpoint), atol=1e-12)


def test_a_warm_start_that_is_far_off_loses_no_answer(mappings: Mapping[str, Eye]) -> None:
    eye = mappings["birdbath28"]
    pixel, viewpoint = queries(eye)
    seen = eye.display.view_dir_of_pixel(pixel, viewpoint)
    again = eye.display.view_dir_of_pixel(pixel, viewpoint, present(seen.warm_start) + 0.6)
    np.testing.assert_allclose(again.value, seen.value, atol=1e-9)


@pytest.mark.parametrize("name", ["flat_mirror", "plane_plate", "tilted_plate"])
def test_flat_mirror_shows_the_panels_mirror_image(mappings: Mapping[str, Eye], name: str) -> None:
    """All three show the panel in a mirror through (0, 0, -40 mm) with its normal half-way between up and back."""
    eye = mappings[name]
    pixel, viewpoint = queries(eye)
    point = load_device(name).eyes["right"].panel.point_of_pixel(pixel)
    normal = np.array([0.0, np.sqrt(0.5), np.sqrt(0.5)])
    image = point - 2 * ((point - [0, 0, -0.04]) @ normal)[:, None] * normal
    seen = eye.display.view_dir_of_pixel(pixel, viewpoint)
    np.testing.assert_allclose(seen.value, normalised(image - viewpoint), atol=1e-12)


@pytest.mark.parametrize("name", ["no_optics", "flat_mirror", "prism5701202"])
def test_without_a_see_through_path_the_world_is_straight(mappings: Mapping[str, Eye], name: str) -> None:
    eye = mappings[name]
    _, viewpoint = queries(eye, 50)
    point = viewpoint + np.random.default_rng(12).uniform([-1, -1, -3], [1, 1, -0.3], (50, 3))
    seen = eye.see_through.view_dir_of_real_point(point, viewpoint)
    np.testing.assert_allclose(seen.value, normalised(point - viewpoint), atol=1e-12)


@pytest.mark.parametrize(
    ("name", "normal", "thickness"),
    [("plane_plate", [0.0, 0.0, -1.0], 0.005), ("tilted_plate", [0.0, -np.sqrt(0.5), -np.sqrt(0.5)], 0.005)],
)
def test_plate_shifts_rays_by_the_textbook_amount_and_turns_none(
    mappings: Mapping[str, Eye], name: str, normal: Sequence[float], thickness: float
) -> None:
    """Lateral shift t sin a (1 - cos a / sqrt(n^2 - sin^2 a)), towards the side the ray leans to."""
    eye = mappings[name]
    pixel, viewpoint = queries(eye)
    view_dir = eye.display.view_dir_of_pixel(pixel, viewpoint).value
    ray = eye.see_through.real_ray_of_view_dir(view_dir, viewpoint).value
    np.testing.assert_allclose(ray[:, 3:], view_dir, atol=1e-15)
    cosine = view_dir @ normal
    sine = np.sqrt(1 - cosine**2)
    shift = thickness * sine * (1 - cosine / np.sqrt(1.5**2 - sine**2))
    offset = ray[:, :3] - viewpoint
    offset -= np.sum(offset * view_dir, -1, keepdims=True) * view_dir
    np.testing.assert_allclose(np.linalg.norm(offset, axis=-1), shift, atol=1e-15)
    # Glass bends the ray towards the normal, so it leaves shifted along the normal's part across it.
    lean = normal - cosine[:, None] * view_dir
    assert np.all(np.sum(offset * lean, axis=-1) >= 0)


def test_left_eye_mirrors_the_right_one() -> None:
    device = load_device("northstar")
    right, left = traced_eye(device, "right"), traced_eye(device, "left")
    assert (right.eye, left.eye) == ("right", "left")
    pixel, viewpoint = queries(right, 50)
    flip = np.array([-1.0, 1.0, 1.0])
    mirrored_pixel = pixel * [-1, 1] + [1440, 0]
    seen = right.display.view_dir_of_pixel(pixel, viewpoint)
    other = left.display.view_dir_of_pixel(mirrored_pixel, viewpoint * flip)
    np.testing.assert_allclose(other.value, seen.value * flip, atol=1e-12)
    ray = right.see_through.real_ray_of_view_dir(seen.value, viewpoint).value
    other_ray = left.see_through.real_ray_of_view_dir(seen.value * flip, viewpoint * flip).value
    np.testing.assert_allclose(other_ray, ray * np.tile(flip, 2), atol=1e-15)
    # In both eyes a pixel further to the right is seen further to the right.
    for eye in (right, left):
        row = eye.display.view_dir_of_pixel(np.array([[500.0, 600.0], [900.0, 600.0]]), eye.eye_box.centre).value
        assert row[0, 0] < row[1, 0]


def test_statuses_outside_panel_aperture_and_field(mappings: Mapping[str, Eye]) -> None:
    eye = mappings["freeform40"]
    centre = eye.eye_box.centre
    beyond = eye.display.view_dir_of_pixel(np.array([[-1.0, 500.0], [960.0, 540.0], [np.nan, 0.0]]), centre)
    assert beyond.status.tolist() == [Status.CLIPPED, Status.OK, Status.CLIPPED]
    assert np.isnan(beyond.value[[0, 2]]).all()
    aside = dir_of_tangents(np.array([[0.45, 0.0], [2.0, 0.0], [0.0, 0.0]]))
    pixel = eye.display.pixel_of_view_dir(aside, centre)
    assert pixel.status[0] == Status.CLIPPED  # on the combiner, past the panel
    assert pixel.status[1] in (Status.CLIPPED, Status.MISS)
    assert pixel.status[2] == Status.OK
    assert np.isnan(pixel.value[:2]).all()
    world = eye.see_through.real_ray_of_view_dir(aside, centre)
    assert world.status[1] != Status.OK
    assert np.isnan(world.value[1]).all()


def test_points_behind_the_eye_or_before_the_optics_are_missed(mappings: Mapping[str, Eye]) -> None:
    eye = mappings["freeform40"]
    point = np.array([[0.0, 0.0, 1.0], [0.0, 0.0, -0.01], [0.0, 0.0, -1.0], [np.nan, 0.0, -1.0]])
    seen = eye.see_through.view_dir_of_real_point(point, eye.eye_box.centre)
    assert seen.status[:3].tolist() == [Status.MISS, Status.MISS, Status.OK]
    assert not seen.usable[3]


def test_prism_meets_the_patents_figures() -> None:
    """Image height 9.84 mm at 15 degrees and 10 to 30 um spots for a 4 mm pupil, about the patent's own pupil."""
    optics = load_device("prism5701202").eyes["right"]

    def on_panel_mm(pupil: FloatArray, view_dir: FloatArray) -> FloatArray:
        traced = trace(optics.display, pupil, view_dir, 0.5876)
        assert (traced.status == Status.OK).all()
        pose = optics.panel.panel_from_device
        origin, direction = apply(pose, traced.origin), traced.direction @ pose[:3, :3].T
        return 1e3 * (origin - origin[..., 2:] / direction[..., 2:] * direction)[..., :2]

    field = np.deg2rad([[0, 0], [15, 0], [0, 10], [0, -10], [15, 10], [15, -10]])
    view_dir = dir_of_tangents(np.tan(field))
    chief = on_panel_mm(np.zeros(3), view_dir)
    assert chief[1, 0] == pytest.approx(9.84, abs=0.005)
    np.testing.assert_allclose(chief[0], 0.0, atol=1e-3)
    angle = np.linspace(0, 2 * np.pi, 24, endpoint=False)
    ring = np.concatenate([r * np.stack([np.cos(angle), np.sin(angle), 0 * angle], -1) for r in (1e-3, 2e-3)])
    spots = on_panel_mm(ring[:, None, :], view_dir)
    rms_um = 1e3 * np.sqrt(np.mean(np.sum((spots - spots.mean(axis=0)) ** 2, axis=-1), axis=0))
    assert np.all((rms_um > 5) & (rms_um < 30))


@pytest.mark.parametrize(("name", "number"), [("freeform40", 0), ("prism5701202", 0)])
def test_newton_finds_the_first_crossing_inside_the_aperture(
    mappings: Mapping[str, Eye], name: str, number: int
) -> None:
    """Against a plain search along each ray in steps of 5 um."""
    optics = load_device(name).eyes["right"]
    surface = optics.display.steps[number].surface
    assert not isinstance(surface.shape, Conic)
    pixel, viewpoint = queries(mappings[name], 60)
    view_dir = mappings[name].display.view_dir_of_pixel(pixel, viewpoint).value
    met = np.linalg.norm(trace(optics.display, viewpoint, view_dir, 0.55).points[:, number] - viewpoint, axis=-1)
    along = np.arange(0.0, 0.1, 5e-6)
    point = apply(surface.surface_from_device, viewpoint[:, None] + along[:, None] * view_dir[:, None])
    x, y, z = np.moveaxis(point, -1, 0)
    low, high = surface.aperture.low, surface.aperture.high
    inside = (x >= low[0]) & (x <= high[0]) & (y >= low[1]) & (y <= high[1])
    with np.errstate(invalid="ignore"):
        below = z < narrowed(surface.shape, SagSurface).sag_and_slopes(x, y)[0]
    crossing = inside[:, 1:] & (below[:, 1:] != below[:, :-1])
    np.testing.assert_allclose(along[crossing.argmax(axis=1)], met, atol=6e-6)


def test_an_eye_that_is_not_there() -> None:
    with pytest.raises(BadInputError, match="'freeform40' has no left eye; choose right"):
        traced_eye(load_device("freeform40"), "left")


def test_a_panel_that_no_ray_reaches_is_refused(tmp_path: Path) -> None:
    eye = traced_eye(load_device(changed_device(tmp_path, "flat_mirror", ("[0.0, -40.0, 40.0]", "[0.0, 40.0, 40.0]"))))
    with pytest.raises(BadInputError, match="no ray from the middle of the eye box reaches the panel"):
        eye.display.view_dir_of_pixel(np.zeros(2), np.zeros(3))


def test_a_display_whose_pixels_are_not_found_is_refused(tmp_path: Path) -> None:
    text = resource("devices", "freeform40.toml").read_text(encoding="utf-8")
    path = tmp_path / "wavy.toml"
    path.write_text(text.replace("y6 = -7.73169236e-10", "y6 = -2e-6"))
    eye = traced_eye(load_device(path))
    with pytest.raises(BadInputError, match=r"no ray was found from the middle of the eye box to \d+% of the panel's"):
        eye.display.view_dir_of_pixel(eye.display.panel.grid(3, 3), eye.eye_box.centre)


@pytest.mark.parametrize("wavelength_um", [0.0, -0.5, 550.0, np.nan])
def test_a_wavelength_that_is_no_light_is_refused(wavelength_um: float) -> None:
    with pytest.raises(BadInputError, match=r"the wavelength is .*; give micrometres from 0\.3 to 3"):
        traced_eye(load_device("no_optics"), "right", wavelength_um)
