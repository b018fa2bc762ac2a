"""Prescriptions: the shipped ones are whole, units and frames are right, and faults are named in one sentence."""

import itertools
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from present import narrowed

from wlr_render.errors import BadInputError
from wlr_render.geometry.directions import normalised
from wlr_render.io.atomic_files import shipped_names
from wlr_render.optics.device import Device, Interaction
from wlr_render.optics.device_file import load_device
from wlr_render.optics.media import AIR, FRAUNHOFER_F_D_C_UM, Medium
from wlr_render.optics.raised import Offset
from wlr_render.optics.sag_surfaces import AnamorphicAsphere, Asphere, SagSurface, SumOfProfiles, Toroid, XYPolynomial
from wlr_render.optics.surfaces import Conic
from wlr_render.optics.traced_mappings import traced_eye

GOOD = """
name = "toy"
source = "test"
frame = "opencv"

[[medium]]
name = "glass"
index = 1.5

[[eye]]
side = "right"
display_path = [{ at = "front", do = "reflect" }]
see_through_path = [{ at = "front", do = "refract", into = "glass" }, { at = "back", do = "refract", into = "air" }]
eye_box = { centre_mm = [30, 1, 2], size_mm = [10, 8, 6] }

[eye.panel]
centre_mm = [30, -40, 50]
size_mm = [40, 20]
pixels = [800, 400]
u_axis = [1, 0, 0]
v_axis = [0, 0, -1]

[[eye.surface]]
name = "front"
shape = "conic"
radius_mm = -80
conic = -0.5
origin_mm = [30, 2, 50]
rotate_x_deg = -45
aperture_x_mm = [-30, 30]
aperture_y_mm = [-20, 25]

[[eye.surface]]
name = "back"
shape = "offset"
of = "front"
distance_mm = 3
aperture_x_mm = [-31, 31]
aperture_y_mm = [-21, 26]
"""


CONIC = 'shape = "conic"\nradius_mm = -80\nconic = -0.5'
_RAISED = (
    'shape = "offset"\nof = "front"\ndistance_mm = 3',
    'shape = "raised"\nof = "front"\n'
    'error = [{shape = "bump", height_mm = 0.1, width_mm = 4, origin_mm = [30, 2, 50]}]',
)


def load(tmp_path: Path, text: str) -> Device:
    path = tmp_path / "toy.toml"
    path.write_text(text, encoding="utf-8")
    return load_device(path)


@pytest.mark.parametrize("name", shipped_names("devices", ".toml"))
def test_shipped_devices_load_and_state_their_source(name: str) -> None:
    device = load_device(name)
    assert device.name == name
    assert device.source
    for eye in device.eyes.values():
        np.testing.assert_allclose(
            np.linalg.det(eye.panel.device_from_panel), 1.0, atol=1e-12, err_msg="a panel's pose is rigid"
        )


def test_millimetres_degrees_and_the_opencv_frame_are_converted(tmp_path: Path) -> None:
    eye = load(tmp_path, GOOD).eyes["right"]
    np.testing.assert_allclose(eye.eye_box.centre, [0.030, -0.001, -0.002])
    np.testing.assert_allclose(eye.panel.point_of_pixel(np.array([800.0, 0.0])), [0.05, 0.04, -0.06])
    front, back = eye.surfaces()
    assert narrowed(front.shape, Conic).curvature == pytest.approx(-12.5)
    np.testing.assert_allclose(front.device_from_surface[:3, 3], [0.03, -0.002, -0.05])
    # x right, y down, z forward turned by -45 degrees about x: the surface's z points up and forward.
    np.testing.assert_allclose(front.device_from_surface[:3, 2], [0, -np.sqrt(0.5), -np.sqrt(0.5)], atol=1e-15)
    np.testing.assert_allclose(front.aperture.high, [0.03, 0.025, np.inf])
    assert isinstance(back.shape, Offset)
    assert back.shape.distance == pytest.approx(0.003)
    assert [step.interaction for step in eye.see_through.steps] == [Interaction.REFRACT] * 2
    assert [step.medium.name for step in eye.see_through.steps] == ["glass", "air"]


def test_the_same_numbers_in_the_openxr_frame_are_taken_as_they_are(tmp_path: Path) -> None:
    eye = load(tmp_path, GOOD.replace('"opencv"', '"openxr"')).eyes["right"]
    np.testing.assert_allclose(eye.eye_box.centre, [0.030, 0.001, 0.002])


def test_coefficients_in_millimetres_keep_the_sag(tmp_path: Path) -> None:
    """z mm = 1e-3 x^2 y + 2e-4 y^3 at x = 10 mm, y = 20 mm is 3.6 mm."""
    text = GOOD.replace(CONIC, 'shape = "xy_polynomial"')
    text = text.replace("aperture_y_mm = [-20, 25]", "aperture_y_mm = [-20, 25]\nsag_mm = { x2y = 1e-3, y3 = 2e-4 }")
    shape = load(tmp_path, text).eyes["right"].surfaces()[0].shape
    assert isinstance(shape, XYPolynomial)
    assert shape.sag_and_slopes(np.array([0.01]), np.array([0.02]))[0] == pytest.approx(3.6e-3)


@pytest.mark.parametrize(
    ("lines", "kind", "sag_mm"),
    [
        # 2e-6 (1.5 * 100 + 0.5 * 400)^2 = 0.245 beside an all but flat biconic
        (
            'shape = "anamorphic"\nradius_x_mm = 1e9\nradius_y_mm = 1e9\n'
            "term = [{ order = 4, sag_mm = 2e-6, asymmetry = -0.5 }]",
            AnamorphicAsphere,
            0.245,
        ),
        # 100 - sqrt(100^2 - 10^2) with a straight profile in y
        ('shape = "toroid"\nradius_x_mm = 100\nradius_y_mm = 1e9', Toroid, 100 - np.sqrt(9900)),
        # r^2 = 500 mm^2; without and with a sphere of 100 mm
        ('shape = "asphere"\nsag_mm = { r2 = 1e-3, r4 = 2e-6 }', Asphere, 0.5 + 0.5),
        ('shape = "asphere"\nradius_mm = 100\nsag_mm = { r3 = 1e-5 }', Asphere, 100 - np.sqrt(9500) + 1e-5 * 500**1.5),
        (
            'shape = "sum_of_profiles"\nradius_x_mm = 100\nradius_y_mm = -50',
            SumOfProfiles,
            100 - np.sqrt(9900) - 50 + np.sqrt(2100),
        ),
    ],
)
def test_other_sag_shapes_in_millimetres(tmp_path: Path, lines: str, kind: type[SagSurface], sag_mm: float) -> None:
    text = GOOD.replace(CONIC, lines)
    shape = load(tmp_path, text).eyes["right"].surfaces()[0].shape
    assert isinstance(shape, kind)
    # The first term's larger half is along x for a negative asymmetry.
    x, y = np.array([0.01]), np.array([0.02])
    assert shape.sag_and_slopes(x, y)[0] == pytest.approx(1e-3 * sag_mm, abs=1e-9)


@pytest.mark.parametrize(
    ("given", "wavelength_um", "index"),
    [
        # Schott's data sheet of N-BK7: n_F, n_d, n_C to six digits
        ('formula = "n_bk7_schott"', 0.4861327, 1.52238),
        ('formula = "n_bk7_schott"', 0.5875618, 1.51680),
        ("sellmeier = [[1.0396, 0.0060007], [0.231792, 0.0200179], [1.010469, 103.5607]]", 0.6562725, 1.51432),
        ("nd = 1.62004\nvd = 36.37", 0.5875618, 1.62004),
        ("schott = [[2.25, 0], [0.01, -2]]", 0.5, np.sqrt(2.29)),
        ("sellmeier = [[1.1, -0.25]]", 0.5, np.sqrt(1.55)),
        ("sellmeier = [[1.0, 0.01]]\nschott = [[1.25, 0], [0.01, -2]]", 0.5, np.sqrt(1.29 + 0.25 / 0.24)),
        ('formula = "N-BK7"', 0.6562725, 1.51432),
        ('formula = "S-BSL7"', 0.5875618, 1.51633),
        ("cauchy = [1.5, 0.004, 0.0001]", 0.5, 1.5176),
    ],
)  # fmt: skip
def test_glasses_by_their_published_numbers(tmp_path: Path, given: str, wavelength_um: float, index: float) -> None:
    medium = load(tmp_path, GOOD.replace("index = 1.5", given)).eyes["right"].see_through.steps[0].medium
    assert medium.index(wavelength_um) == pytest.approx(index, abs=5e-6)


@pytest.mark.parametrize(("index", "number"), [(1.5168, 64.17), (1.78472, 25.68), (1.4918, 57.4)])
def test_an_abbe_number_is_met_exactly(index: float, number: float) -> None:
    medium = Medium.abbe("glass", index, number)
    f_line, d_line, c_line = map(medium.index, FRAUNHOFER_F_D_C_UM)
    assert d_line == pytest.approx(index, abs=1e-14)
    assert (d_line - 1) / (f_line - c_line) == pytest.approx(number, rel=1e-10)


@pytest.mark.parametrize(
    ("index", "number", "violet"),
    # n_g of Schott's data sheets: N-BK7, N-SK16, N-SF6
    [(1.51680, 64.17, 1.52668), (1.62041, 60.32, 1.63312), (1.80518, 25.36, 1.84707)],
)
def test_an_abbe_number_gives_the_violet_of_normal_glasses(index: float, number: float, violet: float) -> None:
    assert Medium.abbe("glass", index, number).index(0.4358343) == pytest.approx(violet, abs=7e-4)


@pytest.mark.parametrize("given", ["index = 1.5", 'formula = "pmma_sultanova_2009"'])
def test_a_medium_can_be_shifted_in_index(tmp_path: Path, given: str) -> None:
    plain = load(tmp_path, GOOD.replace("index = 1.5", given)).eyes["right"].see_through.steps[0].medium
    shifted = load(tmp_path, GOOD.replace("index = 1.5", f"{given}\nindex_shift = 0.004"))
    medium = shifted.eyes["right"].see_through.steps[0].medium
    assert [medium.index(um) - plain.index(um) for um in (0.45, 0.65)] == pytest.approx([0.004, 0.004], abs=1e-15)


@pytest.mark.parametrize("axes", ["rotate_x_deg = -45", "z_axis = [1, 2, 2]\nx_axis = [2, 1, -2]"])
def test_a_mirrored_surface_has_its_y_turned_round(tmp_path: Path, axes: str) -> None:
    text = GOOD.replace("rotate_x_deg = -45", axes)
    proper = load(tmp_path, text).eyes["right"].surfaces()[0].device_from_surface
    improper = load(tmp_path, text.replace(axes, f"{axes}\nmirrored = true")).eyes["right"].surfaces()
    np.testing.assert_allclose(improper[0].device_from_surface, proper * [1, -1, 1, 1], atol=1e-16)
    np.testing.assert_array_equal(improper[1].device_from_surface, improper[0].device_from_surface)


def test_an_aperture_is_open_along_an_axis_that_is_left_out(tmp_path: Path) -> None:
    aperture = load(tmp_path, GOOD.replace("aperture_x_mm = [-30, 30]\n", "")).eyes["right"].surfaces()[0].aperture
    np.testing.assert_allclose([aperture.low, aperture.high], [[-np.inf, -0.02, -np.inf], [np.inf, 0.025, np.inf]])


def test_other_eye_is_mirrored(tmp_path: Path) -> None:
    device = load(tmp_path, GOOD.replace('side = "right"', 'side = "right"\nalso_mirrored = true'))
    right, left = device.eyes["right"], device.eyes["left"]
    np.testing.assert_allclose(left.eye_box.centre, right.eye_box.centre * [-1, 1, 1])
    pixel = np.array([123.0, 45.0])
    other = np.array([800.0 - 123.0, 45.0])
    np.testing.assert_allclose(
        left.panel.point_of_pixel(pixel), right.panel.point_of_pixel(other) * [-1, 1, 1], atol=1e-16
    )


@pytest.mark.parametrize(
    ("old", "new", "sentence"),
    [
        ("conic = -0.5", "conik = -0.5", r"surface\]\] number 1: unknown key 'conik'; did you mean 'conic'"),
        ("radius_mm = -80", "radius_m = -0.08", "key 'radius_mm' is missing .found 'radius_m' instead"),
        ("radius_mm = -80", "radius_mm = 0", "'radius_mm' is 0.0; it must be a length other than 0"),
        ('at = "back"', 'at = "bak"', "'at' names the surface 'bak', which is not defined .front, back"),
        ('into = "glass"', 'into = "glas"', "'into' names the medium 'glas', which is not defined .air, glass"),
        ('of = "front"', 'of = "rear"', "'of' names the earlier surface 'rear', which is not defined .front"),
        ('do = "reflect"', 'do = "bounce"', "'do' is 'bounce'; it must be one of refract, reflect, total_reflect"),
        ('shape = "conic"', 'shape = "cone"', "'shape' is 'cone'; it must be one of plane"),
        (
            "v_axis = [0, 0, -1]",
            "v_axis = [0, 0, -1]\ncurvature_per_m = [1]",
            "'curvature_per_m' must be a list of 2",
        ),
        (_RAISED[0], _RAISED[1].replace("bump", "cone"), "'shape' is 'cone'; it must be one of anamorphic"),
        (
            _RAISED[0],
            _RAISED[1].replace("width_mm = 4", "width_mm = 0"),
            "'width_mm' has the value 0; it must be above 0",
        ),
        (_RAISED[0], _RAISED[1].replace("height_mm", "heigt_mm"), "'height_mm' is missing .found 'heigt_mm'"),
        (_RAISED[0], 'shape = "raised"\nof = "front"', "'error' is missing"),
        ('frame = "opencv"', 'frame = "opengl"', "'frame' is 'opengl'; it must be one of opencv, openxr"),
        ("index = 1.5", "index = -1.5", "'index' has the value -1.5; it must be 1 or more"),
        ("index = 1.5", "index = 1.5\nindex_shift = -0.6", "the index at 0.45 um is 0.9; a refractive"),
        ("index = 1.5", 'formula = "bk7"', "'formula' is 'bk7'; choose one of .*N-BK7.*'sellmeier', or by 'nd'"),
        ("index = 1.5", "", "give the index by one of index, formula, sellmeier, .*; none is there"),
        ("index = 1.5", "index = 1.5\nnd = 1.5", "; index and nd is there"),
        ("index = 1.5", "nd = 1.5", "key 'vd' is missing"),
        ("index = 1.5", "nd = 1.5\nvd = 0.58", "'vd' has the value 0.58; it must be 5 or more"),
        ("index = 1.5", "sellmeier = [[1.1, 0.01], [1e-6, 0.36]]", "the index is infinite at 0.6 um, in visible light"),
        ("index = 1.5", "sellmeier = [[1.1, 0.01]]\nindex = 1.5", "by one of index, .*; index and sellmeier is there"),
        ("index = 1.5", "sellmeier = [[1.1, 0.23]]", "the index at 0.45 um is nan"),
        ("index = 1.5", "cauchy = []", "'cauchy' must be 1 to 5 numbers"),
        ("index = 1.5", "schott = [[2.25, 99]]", "'schott' must be pairs"),
        ("index = 1.5", "index = 15", "'index' has the value 15; it must be 1 or more, and at most 5"),
        ("index = 1.5", "index = 1e400", "'index' must be finite"),
        ("radius_mm = -80", "radius_mm = 1e15", r"'radius_mm' has the value 1e\+15; it must be .* at most 1e\+12"),
        (
            CONIC,
            'shape = "xy_polynomial"\nsag_mm = { y6 = -1 }',
            r"surface\]\] number 1: rises .* mm per mm within its aperture, more than the plausible 20",
        ),
        (
            "origin_mm = [30, 2, 50]",
            "origin_mm = [30, 2, 30000]",
            "'origin_mm' has the value 30000; it must be .* at most 2000: correct it, or convert",
        ),
        ("aperture_x_mm = [-30, 30]", "aperture_x_mm = [-30, 30000]", "at most 2000: correct it, or convert its unit"),
        (
            "size_mm = [10, 8, 6]",
            "size_mm = [10000, 8, 6]",
            r"\[eye_box\]: 'size_mm' has the value 10000; it must be .* at most 200",
        ),
        (
            "size_mm = [10, 8, 6]",
            "size_mm = [0.01, 0.008, 0.006]",
            r"'size_mm' is .*; it must be 0.1 or more on some axis, in millimetres",
        ),
        (
            "size_mm = [40, 20]",
            "size_mm = [40000, 20]",
            r"\[panel\]: 'size_mm' has the value 40000; it must be 0.5 or more",
        ),
        (
            "pixels = [800, 400]",
            "pixels = [1000000000, 400]",
            r"\[panel\] 'pixels': has 1000000000x400 pixels, more than",
        ),
        (
            "eye_box = {",
            "field_deg = [-130, 130, -10, 10]\neye_box = {",
            "'field_deg' has the value -130; it must be -89 or more",
        ),
        ('source = "test"', f'source = "{9000 * "x"}"', "'source' has 9000 characters; shorten it"),
        (
            'display_path = [{ at = "front", do = "reflect" }]',
            "display_path = [" + 101 * '{ at = "front", do = "reflect" }, ' + "]",
            "'display_path' has 101 entries; 100 is the most that is read",
        ),
        ("index = 1.5", "index = 1.5\nindex_shift = nan", "'index_shift' must be finite"),
        ("pixels = [800, 400]", "pixels = [800, 400.5]", "'pixels' is .*; it must be two whole numbers"),
        ("size_mm = [40, 20]", "size_mm = [40, 0]", r"'size_mm' has the value 0; it must be 0.5 or more"),
        ("size_mm = [10, 8, 6]", "size_mm = [10, 8, -6]", "'size_mm' has the value -6; it must be above 0"),
        ("v_axis = [0, 0, -1]", "v_axis = [1, 0, -1]", "'u_axis' and 'v_axis' must be perpendicular"),
        ("aperture_x_mm = [-30, 30]", "aperture_x_mm = [30, -30]", "low below high"),
        ('name = "back"', 'name = "front"', "there is already a surface 'front'"),
        ('{ at = "back", do = "refract", into = "air" }', '{ at = "back", do = "reflect" }', "must end in air"),
        (', { at = "back", do = "refract", into = "air" }', "", "must end in air"),
    ],
)
def test_faults_are_named(tmp_path: Path, old: str, new: str, sentence: str) -> None:
    assert old in GOOD
    with pytest.raises(BadInputError, match=sentence):
        load(tmp_path, GOOD.replace(old, new))


@pytest.mark.parametrize(
    "name", ["../../x", "a/b", "a\\\\b", "C:x", "/x", "..", ".hidden", "-flag", "a b", "a\\u001b[2J", "a\\n", ""]
)
def test_a_name_that_leads_out_of_the_output_folder_or_is_no_plain_one_is_refused(tmp_path: Path, name: str) -> None:
    with pytest.raises(BadInputError, match=r"toy\.toml: 'name' is .*; output files are named after it: use letters"):
        load(tmp_path, GOOD.replace('name = "toy"', f'name = "{name}"'))


def test_a_name_may_hold_letters_digits_and_marks_within(tmp_path: Path) -> None:
    assert load(tmp_path, GOOD.replace('name = "toy"', 'name = "Prüfling_2.1-b"')).name == "Prüfling_2.1-b"


def test_unused_surfaces_double_eyes_and_no_eye_are_refused(tmp_path: Path) -> None:
    lonely = GOOD[GOOD.index("[[eye.surface]]") : GOOD.index('[[eye.surface]]\nname = "back"')]
    with pytest.raises(BadInputError, match="surface 'third' is in no path"):
        load(tmp_path, GOOD + lonely.replace('"front"', '"third"'))
    with pytest.raises(BadInputError, match="the right eye is already given"):
        load(tmp_path, GOOD + GOOD[GOOD.index("[[eye]]") :])
    with pytest.raises(BadInputError, match=r"there is no \[\[eye\]\]"):
        load(tmp_path, GOOD[: GOOD.index("[[medium]]")] + "eye = []\n")


@pytest.mark.parametrize(
    ("shape", "sag_mm", "sentence"),
    [
        ("asphere", "{ r1 = 1e-3 }", "'r1' is not a term in r of order 2 to 20; write r2"),
        ("asphere", "{ r22 = 1 }", "of order 2 to 20"),
        ("asphere", "{}", "such as r4"),
        ("xy_polynomial", "{ z2 = 1.0 }", "'z2' is not a term"),
        ("xy_polynomial", "{}", "coefficients are missing"),
        ("xy_polynomial", "{ x99999y = 1 }", "'x99999y' is not a term in x and y of order 0 to 20"),
    ],
)
def test_terms_of_a_sag_are_checked(tmp_path: Path, shape: str, sag_mm: str, sentence: str) -> None:
    with pytest.raises(BadInputError, match=sentence):
        load(tmp_path, GOOD.replace(CONIC, f'shape = "{shape}"\nsag_mm = {sag_mm}'))


def test_unknown_name_lists_the_shipped_ones() -> None:
    with pytest.raises(BadInputError, match="northstar"):
        load_device("northstat")


@pytest.mark.parametrize(
    ("old", "new", "sentence"),
    [
        ("radius_mm = -80", "radius_mm = 1e-9", "toy: every see-through ray .* is lost .81 "),
        ("origin_mm = [30, 2, 50]", "origin_mm = [30, 2, -50]", "toy: every see-through ray"),
        ("centre_mm = [30, -40, 50]", "centre_mm = [30, -40, -1500]", "toy: no ray from the middle of the eye box"),
    ],
)
def test_a_device_that_loses_every_ray_says_so(tmp_path: Path, old: str, new: str, sentence: str) -> None:
    assert old in GOOD
    device = load(tmp_path, GOOD.replace(old, new))
    with pytest.raises(BadInputError, match=sentence):
        traced_eye(device).display.view_dir_of_pixel(np.array([400.0, 200.0]), np.array([0.03, -0.001, -0.002]))


def test_surfaces_stated_by_one_another_end_somewhere(tmp_path: Path) -> None:
    more = "".join(
        f'[[eye.surface]]\nname = "{name}"\nshape = "offset"\nof = "{base}"\ndistance_mm = 1\n'
        for base, name in itertools.pairwise(["front", *"abcdefg"])
    )
    with pytest.raises(BadInputError, match="'of' leads through more than 6 surfaces"):
        load(tmp_path, GOOD + more)


def test_a_raised_surface_can_be_raised_again(tmp_path: Path) -> None:
    """The surface between is in no path, but another one is stated by it."""
    again = GOOD.replace(*_RAISED).replace('name = "back"', 'name = "between"')
    again += f'\n[[eye.surface]]\nname = "back"\n{_RAISED[1].replace("front", "between")}\n'
    shape = load(tmp_path, again).eyes["right"].surfaces()[1].shape
    assert len(narrowed(shape, Offset).errors) == 2
    with pytest.raises(BadInputError, match="surface 'between' is in no path"):
        load(tmp_path, again.replace('of = "between"', 'of = "front"'))


@pytest.mark.parametrize("name", ["model.json", "MODEL.JSON"])
def test_a_model_given_as_a_device_is_named_as_one(tmp_path: Path, monkeypatch: pytest.MonkeyPatch, name: str) -> None:
    """Also by a name without a folder."""
    (tmp_path / name).write_text('{"format": "wlr-eye-model"}')
    monkeypatch.chdir(tmp_path)
    for spec in (tmp_path / name, name):
        with pytest.raises(BadInputError, match=rf"{name}: is a model file, .* a device is needed: .* render, export"):
            load_device(spec)


def test_media_change_in_both_paths_and_air_stays_air() -> None:
    eye = load_device("birdbath28").eyes["right"]
    changed = eye.with_media(lambda medium: medium.shifted(0.02).shifted(-0.005))
    for path, before in ((changed.display, eye.display), (changed.see_through, eye.see_through)):
        for step, old in zip(path.steps, before.steps, strict=True):
            assert step.surface is old.surface
            assert step.interaction is old.interaction
            rise = step.medium.index(0.5) - old.medium.index(0.5)
            assert abs(rise - (0.0 if old.medium is AIR else 0.015)) < 1e-15
            assert step.medium.name == old.medium.name
    assert {step.medium.name for step in changed.display.steps} == {"pmma", "air"}


@pytest.mark.parametrize("curvature", [(0.0, 0.0), (0.8, -0.5), (-6.0, 3.0)])
def test_rays_to_points_of_a_bowed_panel_find_their_pixels(curvature: tuple[float, float]) -> None:
    panel = replace(load_device("northstar").eyes["right"].panel, curvature=np.array(curvature))
    rng = np.random.default_rng(1)
    pixel = rng.uniform(0.0, 1.0, (200, 2)) * panel.pixels.size_px
    point, normal = panel.point_of_pixel(pixel), panel.device_from_panel[:3, 2]
    direction = normalised(normal + rng.uniform(-0.3, 0.3, (200, 3)))
    np.testing.assert_allclose(panel.pixel_of_ray(point - 0.05 * direction, direction), pixel, atol=1e-9)
    assert np.isnan(panel.pixel_of_ray(point + 0.05 * direction, direction)).all()
    height = (point - panel.device_from_panel[:3, 3]) @ normal
    half = 0.5 * panel.size * [1.0, 0.0]
    edge = panel.point_of_pixel(panel.pixels.size_px * [1.0, 0.5]) - panel.device_from_panel[:3, 3]
    assert edge @ normal == pytest.approx(0.5 * curvature[0] * half[0] ** 2, abs=1e-15)
    assert np.ptp(height) > 0.0 or curvature == (0.0, 0.0)
