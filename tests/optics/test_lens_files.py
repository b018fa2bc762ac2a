"""Lens files of Zemax, CODE V, Optiland and rayoptics: rays as these programs trace them; faults.

Stored rays and their origin: data/lens_files/README.md, make_lens_file_rays.py.
"""

import json
import pathlib
from collections.abc import Mapping, Sequence

import numpy as np
import pytest
from optics.make_lens_file_rays import (
    FOLDER,
    OPTILAND,
    RAYOPTICS,
    STORED,
    WAVELENGTH_UM,
    starting_rays,
    trace_with_optiland,
)
from present import narrowed, present

from wlr_render.errors import BadInputError
from wlr_render.extras import install_command
from wlr_render.mappings import Status
from wlr_render.numerics.arrays import FloatArray
from wlr_render.optics.device import Interaction, Path, PlacedSurface, Step
from wlr_render.optics.lens_files.glass_catalogues import GlassCatalogue
from wlr_render.optics.lens_files.lens_file import read_lens_file
from wlr_render.optics.lens_files.sequence import LensFile
from wlr_render.optics.media import Medium
from wlr_render.optics.sag_surfaces import AnamorphicAsphere, Asphere, SagSurface, SumOfProfiles, Toroid, XYPolynomial
from wlr_render.optics.surfaces import Conic
from wlr_render.optics.tracer import trace

CATALOGUE = GlassCatalogue((FOLDER / "some_glasses.agf",))


def path_of(lens: LensFile) -> tuple[Path, list[int]]:
    """Path through the surfaces that bend rays, in the file's frame, and their places after the object."""
    places = [place for place in range(1, len(lens.surfaces)) if lens.bends_rays(place)]
    steps = []
    for place in places:
        each = lens.surfaces[place]
        placed = PlacedSurface(f"s{place}", each.shape, each.file_from_surface, each.aperture)
        steps.append(Step(placed, Interaction.REFLECT if each.reflects else Interaction.REFRACT, each.medium))
    return Path(tuple(steps)), places


def assert_same_rays(path: pathlib.Path, rays: FloatArray) -> None:
    """Rays in mm: origin, direction, points on every surface after the object, last direction; 1e-9 mm and 1e-9 rad."""
    _, lens = read_lens_file(path, CATALOGUE)
    optics, places = path_of(lens)
    assert rays.shape[1] == len(lens.surfaces) + 2
    traced = trace(optics, 1e-3 * rays[:, 0], rays[:, 1], WAVELENGTH_UM)
    assert not np.isnan(rays).any()
    assert not (traced.status == Status.MISS).any()
    np.testing.assert_allclose(1e3 * traced.points, rays[:, [place + 1 for place in places]], rtol=0, atol=1e-9)
    np.testing.assert_allclose(traced.direction, rays[:, -1], rtol=0, atol=1e-9)
    # The image, where the panel would be.
    image = lens.surfaces[-1].file_from_surface
    in_image = (rays[:, -2] - 1e3 * image[:3, 3]) @ image[:3, :3]
    np.testing.assert_allclose(in_image[:, 2], 0.0, atol=1e-9)


@pytest.mark.parametrize("name", [*OPTILAND, *RAYOPTICS])
def test_stored_rays_of_other_programs(name: str) -> None:
    with np.load(STORED) as stored:
        assert_same_rays(FOLDER / name, stored[name])


@pytest.mark.oracle
@pytest.mark.parametrize("name", OPTILAND)
def test_live_rays_of_optiland(name: str) -> None:
    pytest.importorskip("optiland", reason="Optiland is not installed: pip install '.[oracle]'")
    origin, direction = starting_rays(*OPTILAND[name], seed=77)
    found = trace_with_optiland(FOLDER / name, origin, direction)
    assert_same_rays(FOLDER / name, np.concatenate([origin[:, None], direction[:, None], found], axis=1))


@pytest.mark.oracle
@pytest.mark.parametrize(("name", "maker"), [("N-BK7", "schott"), ("SK16", "hikari"), ("F2", "hikari"), ("J-LAK7", "")])
def test_glasses_of_the_database_are_those_of_optiland(name: str, maker: str) -> None:
    materials = pytest.importorskip("optiland.materials", reason="Optiland is not installed: pip install '.[glasses]'")
    glass = present(GlassCatalogue().find(name, (maker,) if maker else ())).medium
    expected = materials.Material(name, reference=maker) if maker else materials.Material(name)
    for wavelength_um in (0.45, 0.55, 0.65):
        assert glass.index(wavelength_um) == pytest.approx(np.asarray(expected.n(wavelength_um)).item(), abs=1e-12)


ZMX = """VERS 1
MODE SEQ
UNIT MM X W X CM MR CPMM
NAME test
SURF 0
  TYPE STANDARD
  CURV 0.0
  DISZ INFINITY
SURF 1
  STOP
  TYPE STANDARD
  CURV 0.0
  DISZ 20
SURF 2
  TYPE STANDARD
  COMM front face
  CURV 0.025 0 0 0 0 ""
  CONI -0.5
  DISZ 4
  GLAS ___BLANK 1 0 1.5168 64.17
  DIAM 15 1 0 0 1 ""
SURF 3
  TYPE STANDARD
  CURV -0.01
  DISZ 30
  CLAP 0 12 0
SURF 4
  TYPE STANDARD
  CURV 0.0
  DISZ 0
"""


def lens_of(tmp_path: pathlib.Path, text: str, encoding: str = "utf-8") -> LensFile:
    path = tmp_path / "lens.zmx"
    path.write_bytes(text.encode(encoding))
    return read_lens_file(path, CATALOGUE)[1]


@pytest.mark.parametrize("encoding", ["utf-8", "utf-8-sig", "utf-16", "utf-16-le", "utf-16-be", "latin-1"])
def test_zemax_text_of_every_encoding(tmp_path: pathlib.Path, encoding: str) -> None:
    lens = lens_of(tmp_path, ZMX.replace("front face", "Fläche"), encoding)
    assert [surface.number for surface in lens.surfaces] == [0, 1, 2, 3, 4]
    front = lens.surfaces[2]
    assert front.label == "Fläche"
    shape = narrowed(front.shape, Conic)
    assert shape.curvature == pytest.approx(25.0)
    assert shape.conic == -0.5
    np.testing.assert_allclose(front.file_from_surface[:3, 3], [0, 0, 0.02])
    assert front.medium.index(0.5875618) == pytest.approx(1.5168)
    np.testing.assert_allclose(lens.surfaces[3].aperture.high[:2], 0.012)
    assert lens.surfaces[1].is_stop


@pytest.mark.parametrize(("unit", "metres"), [("IN", 0.0254), ("CM", 0.01), ("METER", 1.0)])
def test_zemax_units_of_length(tmp_path: pathlib.Path, unit: str, metres: float) -> None:
    lens = lens_of(tmp_path, ZMX.replace("UNIT MM", f"UNIT {unit}"))
    assert narrowed(lens.surfaces[2].shape, Conic).curvature == pytest.approx(0.025 / metres)
    assert lens.surfaces[4].file_from_surface[2, 3] == pytest.approx(54 * metres)


# Types whose surface is not their conic even if every parameter is 0.
BENDING_WITHOUT_PARAMETERS = ("FRESNELS", "GEN_FRES", "PARAXIAL", "GRINSUR1", "NONSEQCO", "US_LENS.DLL", "SOMETHING")
SPHERE = "  TYPE STANDARD\n  CURV -0.01\n"
X, Y = np.array([0.004]), np.array([-0.003])


@pytest.mark.parametrize(
    ("lines", "kind", "sag"),
    [
        ("TYPE EVENASPH\n CURV 0.0\n PARM 1 1e-3\n PARM 2 2e-5", Asphere, 1e-3 * 25 + 2e-5 * 625),
        ("TYPE ODDASPHE\n CURV 0.0\n PARM 2 1e-3\n PARM 3 2e-4", Asphere, 1e-3 * 25 + 2e-4 * 125),
        ("TYPE XASPHERE\n CURV 0.0\n XDAT 1 2\n XDAT 2 10\n XDAT 3 0.1\n XDAT 4 0.3", Asphere, 0.1 / 4 + 0.3 / 16),
        (
            "TYPE BICONICX\n CURV 0.02\n CONI -1\n PARM 1 40\n PARM 2 -0.5",
            AnamorphicAsphere,
            (0.025 * 16 + 0.02 * 9) / (1 + np.sqrt(1 - 0.5 * 0.025**2 * 16)),
        ),
        ("TYPE BICONICX\n CURV 0.02\n CONI -1\n PARM 1 0", AnamorphicAsphere, 0.02 * 9 / 2),
        ("TYPE TOROIDAL\n CURV 0.02\n CONI -1\n PARM 1 0", SumOfProfiles, 0.02 * 9 / 2),
        ("TYPE TOROIDAL\n CURV 0.02\n PARM 1 40", Toroid, 40 - np.sqrt((40 - (50 - np.sqrt(2500 - 9))) ** 2 - 16)),
        # x, y, x2, xy, y2 of coordinates over 10 mm
        (
            "TYPE XPOLYNOM\n CURV 0.0\n XDAT 1 5\n XDAT 2 10\n XDAT 3 0.1\n XDAT 4 0.2\n XDAT 5 0.3\n XDAT 6 0.4\n"
            "XDAT 7 0.5",
            XYPolynomial,
            0.1 * 0.4 + 0.2 * -0.3 + 0.3 * 0.16 + 0.4 * -0.12 + 0.5 * 0.09,
        ),
    ],
)  # fmt: skip
def test_shapes_of_zemax_have_the_sag_of_its_manual(
    tmp_path: pathlib.Path, lines: str, kind: type[SagSurface], sag: float
) -> None:
    text = ZMX.replace(SPHERE, "".join(f"  {line.strip()}\n" for line in lines.splitlines()))
    lens = lens_of(tmp_path, text)
    assert not any(note.bends_rays for note in lens.ignored)
    shape = lens.surfaces[3].shape
    assert isinstance(shape, kind)
    assert 1e3 * shape.sag_and_slopes(X, Y)[0] == pytest.approx(sag, rel=1e-12)


def test_coordinate_breaks_turn_and_shift_what_follows_and_back(tmp_path: pathlib.Path) -> None:
    """The matrix is that of Zemax's own article on tilts, R = Rx Ry Rz; the second break undoes the first."""
    values = ["PARM 1 1.5", "PARM 2 -2", "PARM 3 10", "PARM 4 -20", "PARM 5 30"]
    there = "SURF 2\n  TYPE COORDBRK\n  DISZ 0\n" + "".join(f"  {value}\n" for value in values)
    back = "SURF 4\n  TYPE COORDBRK\n  DISZ 0\n  PARM 6 1\n" + "".join(
        f"  {' '.join(value.split()[:2])} {-float(value.split()[2])}\n" for value in values
    )
    middle = "SURF 3\n  TYPE STANDARD\n  DISZ 0\n"
    text = ZMX.replace("SURF 4", "SURF 7").replace("SURF 3", "SURF 6").replace("SURF 2", "SURF 5")
    lens = lens_of(tmp_path, text.replace("SURF 5", there + middle + back + "SURF 5"))
    turned, front = lens.surfaces[2].file_from_surface, lens.surfaces[3].file_from_surface
    a, b, c = np.deg2rad([10, -20, 30])
    np.testing.assert_allclose(turned[0, :3], [np.cos(b) * np.cos(c), -np.cos(b) * np.sin(c), np.sin(b)], atol=1e-15)
    np.testing.assert_allclose(turned[1:3, 2], [-np.sin(a) * np.cos(b), np.cos(a) * np.cos(b)], atol=1e-15)
    np.testing.assert_allclose(turned[:3, 3], [1.5e-3, -2e-3, 20e-3], atol=1e-15)
    np.testing.assert_allclose(front, np.block([[np.eye(3), np.array([[0], [0], [0.02]])], [0, 0, 0, 1]]), atol=1e-15)


@pytest.mark.parametrize(
    ("old", "new", "key", "bends_rays"),
    [
        (SPHERE, "  TYPE SZERNSAG\n  CURV -0.01\n  XDAT 3 0.2\n", "TYPE", True),
        (SPHERE, "  TYPE SZERNSAG\n  CURV -0.01\n  PARM 3 0.2\n  XDAT 3 0\n", "TYPE", True),
        (SPHERE, "  TYPE SZERNSAG\n  CURV -0.01\n", "TYPE", False),
        *((SPHERE, f"  TYPE {kind}\n  CURV -0.01\n", "TYPE", True) for kind in BENDING_WITHOUT_PARAMETERS),
        ("  CLAP 0 12 0\n", "  ELAP 5 12\n", "ELAP", False),
        ("MODE SEQ\n", "MODE SEQ\nENVD 2.0E+1 1 0\nMNUM 2 1\nENVD 30 1 1\n", "MNUM", True),
        ("MODE SEQ\n", "MODE SEQ\nENVD 30 1 1\n", "ENVD", True),
        (SPHERE, "  TYPE EVENASPH\n  CURV -0.01\n  PARM 11 1e-30\n", "PARM", True),
        (SPHERE, "  TYPE ODDASPHE\n  CURV -0.01\n  PARM 1 0.1\n", "PARM", True),
        (SPHERE, "  TYPE TOROIDAL\n  CURV -0.01\n  PARM 1 30\n  PARM 2 0.1\n", "PARM", True),
        (SPHERE, SPHERE + "  SCBD 1 0 0 0 0 9.0E+1 0 0\n", "SCBD", True),
        (SPHERE, SPHERE + "  IGNR 1\n", "IGNR", True),
        (SPHERE, SPHERE + "  IGNR 0\n", "IGNR", False),
        (SPHERE, SPHERE + "  UDAD something\n", "UDAD", False),
        ("  CLAP 0 12 0\n", "  CLAP 3 12 0\n", "CLAP", False),
        ("MODE SEQ\n", "MODE SEQ\nMNUM 3 1\n", "MNUM", True),
    ],
)
def test_ignored_keys_are_named(tmp_path: pathlib.Path, old: str, new: str, key: str, bends_rays: bool) -> None:
    assert old in ZMX
    lens = lens_of(tmp_path, ZMX.replace(old, new))
    assert (key, bends_rays) in [(note.key, note.bends_rays) for note in lens.ignored]


@pytest.mark.parametrize(
    ("old", "new", "sentence"),
    [
        ("MODE SEQ", "MODE NSC", r"line 2: MODE is 'NSC'; only sequential"),
        ("UNIT MM", "UNIT FURLONG", "UNIT is 'furlong'"),
        ("CURV -0.01", "CURV x", r"line 24: value 1 of CURV is 'x'; it must be a number"),
        ("DISZ 30", "DISZ INFINITY", "value 1 of DISZ is 'INFINITY'"),
        ("DISZ 30", "DISZ 1e300", "must be a number of at most"),
        ("SURF 3", "SURF 9", "surface '9' follows 2"),
        ("GLAS ___BLANK 1 0 1.5168 64.17", "GLAS NOSUCH 0 0 1.5 40", r"has these glasses: NOSUCH .surface 2"),
        ("1.5168 64.17", "15.168 64.17", "line 20: glass '___BLANK': the index at 0.45 um is 15"),
        (SPHERE, "  TYPE EVENASPH\n  PARM 1000000000 1\n", "PARM has the number 1e"),
        (ZMX, "hello\n", "has no line 'SURF'"),
        (ZMX, "SURF 0\nSURF 1\n", "has 2 surfaces"),
        (ZMX, "{}", "is not a lens file of Zemax"),
        (ZMX, '{"surface_group": {"surfaces": []}}', "has 0 surfaces"),
        (ZMX, '{"optical_model": {}}', "key 'attributes' is missing"),
    ],
)  # fmt: skip
def test_faults_of_lens_files_are_named(
    tmp_path: pathlib.Path, without_optiland: None, old: str, new: str, sentence: str
) -> None:
    assert old in ZMX
    with pytest.raises(BadInputError, match=sentence):
        lens_of(tmp_path, ZMX.replace(old, new))


def test_a_glass_with_its_own_numbers_stands_in_for_a_catalogue(tmp_path: pathlib.Path, without_optiland: None) -> None:
    lens = lens_of(tmp_path, ZMX.replace("___BLANK 1 0 1.5168 64.17", "MYPLASTIC 0 0 1.5312 56.0"))
    assert lens.surfaces[2].medium.index(0.5875618) == pytest.approx(1.5312)
    (note,) = (note for note in lens.ignored if note.key == "GLAS")
    assert "in no catalogue: taken by its index 1.5312 and Abbe number 56" in note.reason


@pytest.mark.parametrize("numbers", ["0 0 0 0 0 0 0 0 0 0", "0 0 1.5 40", "0 0", ""])
def test_zeros_beside_the_name_of_a_glass_state_no_index(
    tmp_path: pathlib.Path, without_optiland: None, numbers: str
) -> None:
    found = lens_of(tmp_path, ZMX.replace("___BLANK 1 0 1.5168 64.17", f"N-BK7 {numbers}"))
    assert found.surfaces[2].medium.index(0.5875618) == pytest.approx(1.5168, abs=5e-6)
    with pytest.raises(BadInputError, match=r"no catalogue has these glasses: NOSUCH .surface 2.*--glasses"):
        lens_of(tmp_path, ZMX.replace("___BLANK 1 0 1.5168 64.17", f"NOSUCH {numbers}"))


def test_a_glass_by_its_six_digit_code(tmp_path: pathlib.Path, without_optiland: None) -> None:
    lens = lens_of(tmp_path, ZMX.replace("___BLANK 1 0 1.5168 64.17", "517642 0 0 0 0"))
    assert lens.surfaces[2].medium.index(0.5875618) == pytest.approx(1.517)
    assert [note.part for note in lens.ignored if note.key == "GLAS"] == ["glass"]


def test_the_partial_dispersion_of_a_model_glass_is_read(tmp_path: pathlib.Path) -> None:
    files = ZMX, ZMX.replace("64.17", "64.17 0.01")
    normal, other = (lens_of(tmp_path, text).surfaces[2].medium.index for text in files)
    differences = [index(0.4358343) - index(0.4861327) for index in (normal, other)]
    assert differences[1] - differences[0] == pytest.approx(0.01 * 0.5168 / 64.17)


def test_lines_of_a_surface_need_no_indent(tmp_path: pathlib.Path) -> None:
    lens = lens_of(tmp_path, "\n".join(line.strip() for line in ZMX.splitlines()))
    assert lens.surfaces[2].medium.index(0.5875618) == pytest.approx(1.5168)
    assert lens.surfaces[4].file_from_surface[2, 3] == pytest.approx(0.054)


def test_a_comment_with_a_separator_of_latin_1_hides_no_lines(tmp_path: pathlib.Path) -> None:
    lens = lens_of(tmp_path, ZMX.replace("  DIAM 15", "  COMM a\x85GLAS MIRROR\x0cCURV 9\n  DIAM 15"), "latin-1")
    assert lens.surfaces[2].medium.index(0.5875618) == pytest.approx(1.5168)
    assert narrowed(lens.surfaces[2].shape, Conic).curvature == pytest.approx(25.0)
    assert not lens.surfaces[2].reflects


@pytest.mark.parametrize("name", ["LAK", "BK", "LAN"])
def test_a_catalogue_glass_is_no_model_glass_because_of_its_letters(tmp_path: pathlib.Path, name: str) -> None:
    """Zemax writes ___BLANK for a glass by index and Abbe number; these names have letters of it only."""
    catalogue = tmp_path / "a.agf"
    catalogue.write_text(f"NM {name} 1 0 1.5 40\nCD 2.56 0 0 0 0 0\n")
    path = tmp_path / "lens.zmx"
    path.write_text(ZMX.replace("___BLANK 1 0 1.5168 64.17", f"{name} 0 0 1.5168 64.17"))
    glass = read_lens_file(path, GlassCatalogue((catalogue,)))[1].surfaces[2].medium
    assert (glass.name, glass.index(0.5)) == (name, 1.6)


def test_a_glass_in_no_catalogue_is_refused_with_the_command_that_installs_one(
    tmp_path: pathlib.Path, without_optiland: None
) -> None:
    name = "NOSUCH"
    shapes = (FOLDER / "shapes.json").read_text().replace('"SK16"', f'"{name}"')
    decentred = json.loads((FOLDER / "decentred.roa").read_text())
    medium = decentred["optical_model"]["attributes"]["seq_model"]["attributes"]["gaps"][1]["attributes"]["medium"]
    medium["attributes"] = {"label": name}
    for content in (ZMX.replace("___BLANK 1 0 1.5168 64.17", f"{name} 0 0 1.5 40"), shapes, json.dumps(decentred)):
        path = tmp_path / "lens"
        path.write_text(content)
        with pytest.raises(BadInputError) as refused:
            read_lens_file(path, CATALOGUE)
        assert "no catalogue has th" in str(refused.value)
        assert name in str(refused.value)
        assert str(refused.value).endswith(f"{install_command('glasses')}")


def test_a_catalogue_file_is_searched_by_name(tmp_path: pathlib.Path) -> None:
    lens = lens_of(tmp_path, ZMX.replace("___BLANK 1 0 1.5168 64.17", "n-bk7 0 0 1.5 40"))
    assert lens.surfaces[2].medium.index(0.5875618) == pytest.approx(1.51680, abs=5e-6)


def test_the_first_glass_of_a_name_counts_and_each_file_is_read_once(tmp_path: pathlib.Path) -> None:
    first, second = tmp_path / "first.agf", tmp_path / "second.agf"
    first.write_text("NM A 1 0 1.5 40\nCD 2.25 0 0 0 0 0\nNM A 1 0 1.5 40\nCD 4 0 0 0 0 0\n")
    second.write_text("NM a 1 0 1.5 40\nCD 9 0 0 0 0 0\nNM B 1 0 1.5 40\nCD 2.56 0 0 0 0 0 0 0 0 0\n")
    catalogue = GlassCatalogue((first, second))
    assert present(catalogue.find("a")).medium.index(0.5) == 1.5
    first.unlink()
    second.unlink()
    assert present(catalogue.find("B")).medium.index(0.5) == 1.6


@pytest.mark.parametrize(
    ("content", "sentence"),
    [
        ("NM ODD 99 0 1.5 40\nCD 1 2 3 4 5 6\n", "line 2: glass 'ODD' has the formula 99; Zemax has formulas 1 to 13"),
        ("NM ODD 1 0 1.5 40\n", "line 1: glass 'ODD' has 0 coefficients"),
        ("NM ODD 1 0 1.5 40\nCD 2.5 0 0 0 0\n", r"line 2: glass 'ODD' has 5 coefficients; formula 1 \(Schott\) has 6"),
        ("NM ODD 1 0 1.5 40\nCD 2.5 0 0 0 0 0 0.01 0 0 0\n", r"has 10 coefficients; formula 1 .*has 6, and zeros"),
        ("NM ODD 2 0 1.5 40\nCD 1 0.01 0 0 0 0 1 0.02 0 0\n", r"has 10 coefficients; formula 2 .*has 6, and zeros"),
        ("NM ODD 1 0 1.5 40\nCD nan 0 0 0 0 0\n", "the index at 0.45 um is nan"),
        ("NM ODD x 0 1.5 40\nCD 2.5 0 0 0 0 0\n", "has coefficients that are not numbers"),
        ("a,b,c\n", "has no line 'NM' of a glass, so this is not a glass catalogue"),
    ],
)
def test_faults_of_catalogue_files_are_named(tmp_path: pathlib.Path, content: str, sentence: str) -> None:
    bad = tmp_path / "bad.agf"
    bad.write_text(content)
    with pytest.raises(BadInputError, match=rf"bad\.agf: .*{sentence}"):
        GlassCatalogue((bad,)).find("odd")


@pytest.mark.parametrize("kind", ["tilt", ["bend"], {}])
def test_a_decentre_of_another_kind_is_refused(
    tmp_path: pathlib.Path, kind: Mapping[object, object] | Sequence[str] | str
) -> None:
    file = json.loads((FOLDER / "decentred.roa").read_text())
    surfaces = file["optical_model"]["attributes"]["seq_model"]["attributes"]["ifcs"]
    decentre = next(each["attributes"]["decenter"] for each in surfaces if each["attributes"]["decenter"])
    decentre["attributes"].pop("dtype", None)
    decentre["attributes"]["_dtype"] = kind
    path = tmp_path / "lens.roa"
    path.write_text(json.dumps(file))
    with pytest.raises(BadInputError, match=r"the decentre is .*; it must be one of bend, dec and return"):
        read_lens_file(path, CATALOGUE)


def test_planes_are_planes(tmp_path: pathlib.Path) -> None:
    assert lens_of(tmp_path, ZMX).surfaces[4].shape == Conic(0.0)


def test_a_mirror_of_an_older_optiland_is_a_mirror(tmp_path: pathlib.Path) -> None:
    file = json.loads((FOLDER / "shapes.json").read_text())
    surface = file["surface_group"]["surfaces"][3]
    del surface["interaction_model"]
    surface["is_reflective"] = True
    path = tmp_path / "old.json"
    path.write_text(json.dumps(file))
    _, lens = read_lens_file(path, CATALOGUE)
    assert [each.number for each in lens.surfaces if each.reflects] == [3, 6]


@pytest.mark.parametrize("found", ["N-SF99", "sf99"])
def test_a_glass_of_a_similar_name_is_told(tmp_path: pathlib.Path, monkeypatch: pytest.MonkeyPatch, found: str) -> None:
    monkeypatch.setattr(
        "wlr_render.optics.lens_files.glass_catalogues._glass_of_optiland",
        lambda name, makers: Medium.abbe(found, 1.67271, 32.25),
    )
    path = tmp_path / "lens.zmx"
    path.write_text(ZMX.replace("___BLANK 1 0 1.5168 64.17", "SF99 0 0 1.5 40"))
    _, lens = read_lens_file(path, GlassCatalogue())
    notes = [note for note in lens.ignored if note.key == "GLAS"]
    assert [note.bends_rays for note in notes] == ([True] if found == "N-SF99" else [])


@pytest.mark.oracle
def test_optilands_nearest_name_is_not_taken_for_the_glass() -> None:
    pytest.importorskip("optiland.materials", reason="Optiland is not installed: pip install '.[glasses]'")
    assert present(GlassCatalogue().find("SF8", ("schott",))).medium.name != "SF8"
    assert present(GlassCatalogue().find("N-SF8", ("schott",))).medium.name == "N-SF8"
