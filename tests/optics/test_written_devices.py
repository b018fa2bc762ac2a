"""A saved device is read back as the same one: the same light, the same names, wherever its parts were moved."""

import pathlib
from dataclasses import replace

import numpy as np
import pytest

from wlr_render.geometry.directions import dir_of_tangents
from wlr_render.geometry.transforms import rigid, rotation_of_quaternion
from wlr_render.io.atomic_files import shipped_names
from wlr_render.mappings import Status
from wlr_render.numerics.arrays import FloatArray
from wlr_render.optics.assembly import combiner_middle
from wlr_render.optics.device import ClearAperture, Device, EyeOptics, Interaction, Path, PlacedSurface, Step, mirrored
from wlr_render.optics.device_file import load_device, save_device
from wlr_render.optics.media import AIR, Medium
from wlr_render.optics.raised import FormError, Offset, raised
from wlr_render.optics.sag_surfaces import (
    AnamorphicAsphere,
    AnamorphicTerm,
    Asphere,
    GaussianBump,
    SumOfProfiles,
    Toroid,
    XYPolynomial,
)
from wlr_render.optics.surfaces import Conic, Ellipsoid, Shape
from wlr_render.optics.traced_mappings import TracedDisplay, TracedSeeThrough

WAVELENGTH_UM = 0.6
# Some rounding units of a pixel position of 1000; northstar's axes are made unit vectors anew when they are read.
SAME_PX = 1e-11
SAME = 1e-14
GLASS = Medium.constant("glass", 1.5)


def saved(device: Device, tmp_path: pathlib.Path) -> Device:
    return load_device(save_device(device, tmp_path / "saved.toml"))


def sights(eye: EyeOptics, count: int = 300) -> tuple[FloatArray, FloatArray]:
    """View directions and viewpoints all over the field and the eye box."""
    rng = np.random.default_rng(1)
    low, high = ([-0.3, -0.3], [0.3, 0.3]) if eye.field is None else (eye.field.low, eye.field.high)
    viewpoint = eye.eye_box.centre + eye.eye_box.size * rng.uniform(-0.5, 0.5, (count, 3))
    return dir_of_tangents(rng.uniform(low, high, (count, 2))), viewpoint


def assert_same_light(eye: EyeOptics, other: EyeOptics) -> None:
    view_dir, viewpoint = sights(eye)
    for mapping, query, tolerance in (
        (TracedDisplay, "pixel_of_view_dir", SAME_PX),
        (TracedSeeThrough, "real_ray_of_view_dir", SAME),
    ):
        expected = getattr(mapping(eye, WAVELENGTH_UM), query)(view_dir, viewpoint)
        found = getattr(mapping(other, WAVELENGTH_UM), query)(view_dir, viewpoint)
        assert (expected.status == Status.OK).mean() > 0.5, "too few rays arrive to compare"
        np.testing.assert_array_equal(found.status, expected.status)
        np.testing.assert_allclose(found.value, expected.value, rtol=0, atol=tolerance)


def assert_same_parts(eye: EyeOptics, other: EyeOptics) -> None:
    for path, read in ((eye.display, other.display), (eye.see_through, other.see_through)):
        assert [step.surface.name for step in read.steps] == [step.surface.name for step in path.steps]
        assert [step.interaction for step in read.steps] == [step.interaction for step in path.steps]
        assert [step.medium.name for step in read.steps] == [step.medium.name for step in path.steps]
    for surface, placed in zip(eye.surfaces(), other.surfaces(), strict=True):
        np.testing.assert_allclose(placed.device_from_surface, surface.device_from_surface, rtol=0, atol=1e-15)
        np.testing.assert_allclose(placed.aperture.low, surface.aperture.low, rtol=1e-15)
        np.testing.assert_allclose(placed.aperture.high, surface.aperture.high, rtol=1e-15)
    assert other.panel.pixels == eye.panel.pixels
    np.testing.assert_allclose(other.panel.size, eye.panel.size, rtol=1e-15)
    np.testing.assert_allclose(other.panel.device_from_panel, eye.panel.device_from_panel, rtol=0, atol=1e-15)
    np.testing.assert_allclose(other.eye_box.centre, eye.eye_box.centre, rtol=1e-15)
    np.testing.assert_allclose(other.eye_box.size, eye.eye_box.size, rtol=1e-15)
    assert (other.field is None) == (eye.field is None)
    if eye.field is not None:
        assert other.field is not None
        np.testing.assert_allclose([other.field.low, other.field.high], [eye.field.low, eye.field.high], rtol=1e-15)


def assert_same(device: Device, other: Device) -> None:
    assert (other.name, other.source, list(other.eyes)) == (device.name, device.source, list(device.eyes))
    for side, eye in device.eyes.items():
        assert_same_parts(eye, other.eyes[side])
        assert_same_light(eye, other.eyes[side])


def small_motion(seed: int, size: float = 1e-3) -> FloatArray:
    """A rotation by about `size` radians about a random axis, and a shift by about `size` metres."""
    rng = np.random.default_rng(seed)
    xyzw = np.append(0.5 * size * rng.normal(size=3), 1.0)
    return rigid(rotation_of_quaternion(xyzw / np.linalg.norm(xyzw)), size * rng.normal(size=3))


def moved(eye: EyeOptics, motion: FloatArray) -> EyeOptics:
    return eye.with_surfaces(lambda s: replace(s, device_from_surface=motion @ s.device_from_surface))


def moved_panel(eye: EyeOptics, motion: FloatArray) -> EyeOptics:
    return replace(eye, panel=replace(eye.panel, device_from_panel=motion @ eye.panel.device_from_panel))


@pytest.mark.parametrize("name", shipped_names("devices", ".toml"))
def test_every_shipped_device_survives_with_all_its_parts_moved(tmp_path: pathlib.Path, name: str) -> None:
    """Each eye its own way, so that a left eye can no longer be written as the right one's mirror image."""
    device = load_device(name)
    eyes = {
        side: moved_panel(moved(eye, small_motion(seed)), small_motion(seed + 10)).with_media(lambda m: m.shifted(0.01))
        for seed, (side, eye) in enumerate(device.eyes.items())
    }
    changed = replace(device, eyes=eyes)
    assert_same(changed, saved(changed, tmp_path))


def test_mirror_images_are_written_once(tmp_path: pathlib.Path) -> None:
    device = load_device("northstar")
    text = save_device(device, tmp_path / "saved.toml").read_text()
    assert text.count("[[eye]]") == 1
    eyes = {"right": device.eyes["right"], "left": moved_panel(device.eyes["left"], small_motion(0, 1e-9))}
    text = save_device(replace(device, eyes=eyes), tmp_path / "saved.toml").read_text()
    assert text.count("[[eye]]") == 2


def test_a_left_eye_alone_keeps_its_mirrored_surfaces(tmp_path: pathlib.Path) -> None:
    device = load_device("northstar")
    alone = replace(device, eyes={"left": device.eyes["left"]})
    assert_same(alone, saved(alone, tmp_path))
    assert_same_parts(mirrored(saved(alone, tmp_path).eyes["left"]), device.eyes["right"])


@pytest.mark.parametrize("name", ["northstar", "freeform40", "birdbath28"])
def test_form_errors_of_surfaces_and_a_bowed_panel_survive_in_both_eyes(tmp_path: pathlib.Path, name: str) -> None:
    """Two errors of each surface, one of them askew, in an eye and in its mirror image."""
    device = load_device(name)
    eye = device.eyes["right"]
    middle = combiner_middle(eye)
    saddle = XYPolynomial(np.array([[0.0, 0.0, -0.02], [0.0, 0.0, 0.0], [0.02, 0.0, 0.0]]))

    def deformed(surface: PlacedSurface) -> PlacedSurface:
        places = [surface.surface_from_device @ rigid(np.eye(3), middle), small_motion(3, 0.1)]
        errors = zip((saddle, GaussianBump(1e-5, 4e-3)), places, strict=True)
        shape = surface.shape
        for sag, place in errors:
            shape = raised(shape, FormError(sag, place))
        return replace(surface, shape=shape)

    changed = replace(eye.with_surfaces(deformed), panel=replace(eye.panel, curvature=np.array([0.3, -0.5])))
    both = replace(device, eyes={"right": changed, "left": mirrored(changed)})
    text = save_device(both, tmp_path / "saved.toml").read_text()
    assert text.count("[[eye]]") == 1
    assert_same(both, saved(both, tmp_path))
    assert_same(
        replace(both, eyes={"left": mirrored(changed)}),
        saved(replace(both, eyes={"left": mirrored(changed)}), tmp_path),
    )
    view_dir, viewpoint = sights(eye, 50)
    seen, flat = (TracedDisplay(each, WAVELENGTH_UM).plane_pixel(view_dir, viewpoint)[0] for each in (changed, eye))
    assert np.nanmax(np.abs(seen - flat)) > 1.0
    across = TracedDisplay(both.eyes["left"], WAVELENGTH_UM).plane_pixel(
        *(v * [-1, 1, 1] for v in (view_dir, viewpoint))
    )
    width = eye.panel.pixels.width_px
    np.testing.assert_allclose(across[0] * [-1, 1] + [width, 0], seen, atol=1e-9)


@pytest.mark.parametrize("which", ["inner", "outer"])
def test_an_offset_that_left_its_base_keeps_its_place(tmp_path: pathlib.Path, which: str) -> None:
    device = load_device("northstar")
    motion = small_motion(3)
    eye = device.eyes["right"].with_surfaces(
        lambda s: replace(s, device_from_surface=motion @ s.device_from_surface) if s.name == which else s
    )
    changed = replace(device, eyes={"right": eye})
    read = saved(changed, tmp_path)
    assert_same(changed, read)
    assert 'of = "inner_base"' in (tmp_path / "saved.toml").read_text()
    assert_same(changed, saved(read, tmp_path))


def device_of_plate(front: PlacedSurface, back: PlacedSurface, medium: Medium = GLASS) -> Device:
    """No optics to the panel, and an element of two surfaces before the world."""
    device = load_device("no_optics")
    steps = tuple(Step(s, Interaction.REFRACT, m) for s, m in zip((front, back), (medium, AIR), strict=True))
    return replace(device, eyes={"right": replace(device.eyes["right"], see_through=Path(steps))})


def surface_at(
    name: str,
    shape: Shape,
    depth: float,
    low: tuple[float, float, float] = (-0.05, -0.05, -np.inf),
    high: tuple[float, float, float] = (0.05, 0.05, np.inf),
) -> PlacedSurface:
    return PlacedSurface(
        name, shape, rigid(np.eye(3), np.array([0, 0, -depth])), ClearAperture(np.array(low), np.array(high))
    )


BUMP = FormError(GaussianBump(1e-5, 4e-3), np.eye(4))
BACK = surface_at("back", Conic(0.0), 0.06)


@pytest.mark.parametrize(
    "shape",
    [
        Conic(0.0),
        Conic(-7.0, -1.3),
        Toroid(-0.3, 0.2),
        XYPolynomial(np.zeros((1, 1))),
        XYPolynomial(np.array([[1e-3, 2e-3, 0.5], [3e-3, -0.4, 0.0], [0.3, 0.1, 7.0]]), -5.0, 0.2),
        XYPolynomial(np.eye(12)[:, :3] * 0.02),
        AnamorphicAsphere((-4.0, 3.0)),
        AnamorphicAsphere((-4.0, 0.0)),
        Asphere((0.5, 0.0, -300.0, 7.0), -3.0, 0.4),
        Asphere((0.0,)),
        SumOfProfiles((0.0, 3.0), (0.5, -2.0)),
        AnamorphicAsphere((-4.0, 3.0), (0.1, -2.0), (AnamorphicTerm(4, 4e-8, -0.2), AnamorphicTerm(6, -3e-11, 1.5))),
        Offset(Conic(5.0), 1.5e-3),
        Offset(Offset(Toroid(-0.3, 0.2), -1e-3), 2e-3),
        Offset(raised(Conic(5.0), BUMP), 1e-3),
        raised(Offset(raised(Toroid(-0.3, 0.2), BUMP), 1e-3), BUMP),
    ],
)
def test_every_shape_survives(tmp_path: pathlib.Path, shape: Shape) -> None:
    """Offsets here have bases, and these bases of their own, that no path meets."""
    device = device_of_plate(surface_at("front", shape, 0.04), BACK)
    assert_same(device, saved(device, tmp_path))


def test_a_whole_ellipsoid_and_open_apertures_survive(tmp_path: pathlib.Path) -> None:
    """The far side of an ellipsoid, told from the near one by z, behind a plate without edges."""
    plate = surface_at("front", Conic(0.0), 0.01, low=(-np.inf,) * 3, high=(np.inf,) * 3)
    shell = surface_at(
        "shell", Ellipsoid(np.array([0.1, 0.12, 0.05])), 0.02, low=(-0.09, -0.09, -0.06), high=(0.09, 0.09, 0)
    )
    device = device_of_plate(plate, shell)
    assert_same(device, saved(device, tmp_path))


def test_surface_and_base_names_do_not_collide(tmp_path: pathlib.Path) -> None:
    front = surface_at("front", Offset(Conic(5.0), 1e-3), 0.04)
    device = device_of_plate(front, replace(BACK, name="front_base"))
    assert_same(device, saved(device, tmp_path))


def test_media_with_one_name_that_differ_between_the_eyes_are_distinguished(tmp_path: pathlib.Path) -> None:
    device = load_device("northstar")
    eyes = dict(device.eyes, left=device.eyes["left"].with_media(lambda medium: medium.shifted(0.004)))
    read = saved(replace(device, eyes=eyes), tmp_path)
    for side, name, shift in (("right", "pmma", 0.0), ("left", "pmma_left", 0.004)):
        medium = read.eyes[side].see_through.steps[0].medium
        assert (medium.name, medium.index_shift) == (name, shift)
        assert_same_light(eyes[side], read.eyes[side])


@pytest.mark.parametrize(
    "medium",
    [
        Medium("flint", ((1.5, 0.02), (0.3, 0.0))),
        Medium("both", ((1.1, 0.02), (0.2, -0.01), (0.1, 0.0)), powers=((0.2, 0.0), (0.01, -2.0), (-0.002, 2.0))),
        Medium("schott", powers=((1.2, 0.0), (-0.01, 2.0), (0.011, -2.0))),
        Medium("schott", ((0.2, 0.0),), powers=((1.0, 0.0), (0.011, -2.0))),
        Medium.cauchy("cauchy", ((1.5, 0.0), (0.004, -2.0))),
        Medium.abbe("abbe", 1.62, 36.0),
    ],
)
def test_every_dispersion_survives(tmp_path: pathlib.Path, medium: Medium) -> None:
    device = device_of_plate(surface_at("front", Conic(0.0), 0.04), BACK, medium)
    first = save_device(device, tmp_path / "first.toml")
    read = load_device(first).eyes["right"].see_through.steps[0].medium
    assert read.name == medium.name
    for wavelength_um in (0.4, 0.55, 0.7):
        assert read.index(wavelength_um) == pytest.approx(medium.index(wavelength_um), abs=1e-15)
    assert save_device(load_device(first), tmp_path / "second.toml").read_text() == first.read_text()
