"""CODE V lens files: rays of the same lens in Zemax's format, closed forms, notes on commands, and faults.

Rays as rayoptics traces two of them: test_lens_files.
"""

from itertools import pairwise
from pathlib import Path

import numpy as np
import pytest
from optics.make_lens_file_rays import FOLDER
from optics.test_lens_files import CATALOGUE, path_of
from present import present

from wlr_render.errors import BadInputError
from wlr_render.numerics.arrays import FloatArray
from wlr_render.optics.lens_files.glass_catalogues import GlassCatalogue
from wlr_render.optics.lens_files.lens_file import read_lens_file
from wlr_render.optics.lens_files.sequence import LensFile
from wlr_render.optics.sag_surfaces import AnamorphicAsphere
from wlr_render.optics.surfaces import Conic
from wlr_render.optics.tracer import trace

D_UM = 0.5875618
SEQ = """RDM;LEN "VERSION: 11.2"
TITLE 'one lens'
EPD 8.0
DIM M
WL 656.3 587.6 486.1
YAN 0.0 5.0
SO 0.0 0.1e14
S 0.0 20.0
  STO
S 40.0 4.0 1.5168 64.17 ! front
S -100.0 30.0
SI 0.0 0.0
GO
"""
ZMX = """MODE SEQ
UNIT MM
SURF 0
  DISZ INFINITY
SURF 1
  STOP
  DISZ 20
SURF 2
  TYPE STANDARD
  CURV 0.025
  DISZ 4
  GLAS ___BLANK 1 0 1.5168 64.17
SURF 3
  CURV -0.01
  DISZ 30
SURF 4
  DISZ 0
"""
FRONT = "S 40.0 4.0 1.5168 64.17 ! front\n"
BACK = "S -100.0 30.0\n"


def lens_of(tmp_path: Path, text: str, name: str = "lens.seq") -> LensFile:
    path = tmp_path / name
    path.write_text(text)
    return read_lens_file(path, GlassCatalogue(CATALOGUE.files))[1]


def rays(lens: LensFile) -> FloatArray:
    """Points on the surfaces that bend rays, and last directions, of rays within 4 mm and 3 degrees."""
    rng = np.random.default_rng(3)
    origin = np.stack([*rng.uniform(-4e-3, 4e-3, (2, 50)), np.full(50, -0.01)], axis=-1)
    direction = np.stack([*rng.uniform(-0.05, 0.05, (2, 50)), np.ones(50)], axis=-1)
    traced = trace(path_of(lens)[0], origin, direction / np.linalg.norm(direction, axis=-1, keepdims=True), D_UM)
    found = np.concatenate([traced.points.reshape(50, -1), traced.direction], axis=-1)
    assert np.isfinite(found).all()
    return found


@pytest.mark.parametrize(
    ("commands", "lines"),
    [
        ("", ""),
        ("CON\nK -0.5", "CONI -0.5"),
        ("CYL; RDX 0; CON; K -0.5", "CONI -0.5"),
        ("asp; k -0.5; a 1e-6; b -2e-8 ; c 1E-10", "TYPE EVENASPH\nCONI -0.5\nPARM 2 1e-6\nPARM 3 -2e-8\nPARM 4 1e-10"),
        ("ASP\nJ 1e-18", "TYPE XASPHERE\nXDAT 1 10\nXDAT 2 1\nXDAT 12 1e-18"),
        ("SPS ODD 0.0\nSCO K -0.5\nSCO AR2 1e-4; SCO AR3 2e-5", "TYPE ODDASPHE\nCONI -0.5\nPARM 2 1e-4\nPARM 3 2e-5"),
        ("SPS ODD 2.0\nSCO C1 -0.5\nSCO C3 4e-4", "TYPE ODDASPHE\nCONI -0.5\nPARM 2 1e-4"),
        (
            "SPS XYP 10\nSCO K -0.5\nSCO C3 0.01; SCO C5 0.02; SCO Y2 0.03; SCO X2Y -0.01",
            "TYPE XPOLYNOM\nCONI -0.5\nXDAT 1 7\nXDAT 2 10\nXDAT 4 0.01\nXDAT 6 0.02\nXDAT 7 0.03\nXDAT 9 -0.01",
        ),
        (
            "SPS XYP\nSCO NRADIUS 10\nSCO C66 1e-3; SCO C11 1e-3",
            "TYPE XPOLYNOM\nXDAT 1 65\nXDAT 2 10\nXDAT 12 1e-3\nXDAT 67 1e-3",
        ),
        ("YTO\nRDX 50", "TYPE TOROIDAL\nPARM 1 50"),
        ("CYL\nRDX 0", "TYPE TOROIDAL\nPARM 1 0"),
        ("XTO\nCUY 0\nCUX 0.02\nK -0.5", "TYPE BICONICX\nCURV 0\nPARM 1 50\nPARM 2 -0.5"),
        ("AAS\nCUX 0.02\nKX -0.5; KY 0.2", "TYPE BICONICX\nCONI 0.2\nPARM 1 50\nPARM 2 -0.5"),
        ("RDY 50; CUY -0.02", "CURV -0.02"),
        ("GLA 1.6 50", "GLAS ___BLANK 1 0 1.6 50"),
        ("THI 6.5; GLA NBK7_SCHOTT", "DISZ 6.5\nGLAS N-BK7 0 0 1.5 40"),
        ("GLA 516800.641700", "GLAS ___BLANK 1 0 1.5168 64.17"),
        ("GLA S2 517642", "GLAS ___BLANK 1 0 1.517 64.2"),
        ("GLA S2 517.642", "GLAS ___BLANK 1 0 1.517 64.2"),
    ],
)
def test_a_surface_traces_as_that_of_zemax(tmp_path: Path, commands: str, lines: str) -> None:
    ours = lens_of(tmp_path, SEQ.replace(FRONT, f"{FRONT}{commands}\n"))
    zemax = lens_of(tmp_path, ZMX.replace("SURF 3", f"{lines}\nSURF 3"), "lens.zmx")
    assert not [note for note in ours.ignored if note.bends_rays]
    np.testing.assert_allclose(rays(ours), rays(zemax), rtol=0, atol=1e-12)
    blue = [lens.surfaces[2].medium.index(0.45) for lens in (ours, zemax)]
    assert blue[0] == pytest.approx(blue[1], abs=1e-12)


@pytest.mark.parametrize(
    ("old", "new"),
    [
        ("RDM;LEN", "RDM N;LEN"),
        ("DIM M", "DIM C"),
        ("DIM M", "DIM I"),
        (FRONT, "S 40.0 &\n 4.0&\n  1.5168 64.17\n"),
        (FRONT, "S 40.0 4.0;GLA 1.5168 64.17\n"),
        (FRONT, "S2 40.0 4.0 1.5168 64.17\n"),
        (BACK, "S -100.0 30.0\nRDY S2 40 ! again\n"),
        ("SI 0.0 0.0\n", ""),
        ("SI 0.0 0.0\n", "SI 0.0 0.0\nTHI S3 30; SLB S1 'eye!; no comment'\n"),
        ("SI 0.0 0.0\n", "SI 0.0 0.0\nS4 0.0 0.0\n"),
        ("S -100.0 30.0", "S -100.0 28.5"),
    ],
)
def test_forms_of_the_same_lens(tmp_path: Path, old: str, new: str) -> None:
    assert old in SEQ
    text = SEQ.replace(old, new)
    if new == "RDM N;LEN":
        text = text.replace("S 40.0", "S 0.025").replace("S -100.0", "S -0.01")
    text = text.replace("SI 0.0 0.0", "SI 0.0 1.5") if "28.5" in new else text
    if old == "DIM M":
        radius, back, *thicknesses = (each / (10.0 if new == "DIM C" else 25.4) for each in (40, -100, 20, 4, 30))
        text = text.replace("S 0.0 20.0", f"S 0.0 {thicknesses[0]}").replace(BACK, f"S {back} {thicknesses[2]}\n")
        text = text.replace("S 40.0 4.0", f"S {radius} {thicknesses[1]}")
    lens, plain = lens_of(tmp_path, text), lens_of(tmp_path, SEQ)
    np.testing.assert_allclose(rays(lens), rays(plain), rtol=0, atol=1e-12)
    np.testing.assert_allclose(lens.surfaces[-1].file_from_surface, plain.surfaces[-1].file_from_surface, atol=1e-15)
    assert (lens.title, len(lens.surfaces)) == ("one lens", 5)
    assert [surface.is_stop for surface in lens.surfaces] == [False, True, False, False, False]
    assert lens.surfaces[1].label == ("eye!; no comment" if "SLB" in new else "")


def test_an_ampersand_in_quotes_does_not_continue_the_line(tmp_path: Path) -> None:
    lens = lens_of(tmp_path, SEQ.replace("TITLE 'one lens'", "TITLE 'one &'"))
    assert (lens.title, len(lens.surfaces)) == ("one &", 5)
    np.testing.assert_allclose(rays(lens), rays(lens_of(tmp_path, SEQ)), rtol=0, atol=1e-12)


def test_the_stop_is_where_the_last_command_says(tmp_path: Path) -> None:
    lens = lens_of(tmp_path, SEQ.replace("GO", "STO S3"))
    assert [surface.number for surface in lens.surfaces if surface.is_stop] == [3]


FOLD = "LEN\nDIM M\nSO 0 1e11\nS 0 50\nSTO\nS 0 -30 REFL\n{}\nSI 0 0\n"


@pytest.mark.parametrize(("command", "angle"), [("ADE", 20.0), ("ADE", -35.0), ("BDE", 20.0), ("BDE", -35.0)])
def test_the_axis_follows_the_light_at_a_bend(tmp_path: Path, command: str, angle: float) -> None:
    """Left-handed about x and y: ADE turns the mirror's normal from z to y, BDE from z to -x."""
    lens = lens_of(tmp_path, FOLD.format(f"{command} {angle}\nBEN"))
    assert not lens.ignored
    mirror, image = (lens.surfaces[place].file_from_surface for place in (2, 3))
    sine, cosine = np.sin(np.deg2rad(angle)), np.cos(np.deg2rad(angle))
    side = np.array([0.0, 1.0, 0.0] if command == "ADE" else [-1.0, 0.0, 0.0])
    axis = np.array([0.0, 0.0, 1.0])
    np.testing.assert_allclose(mirror[:3, 2], sine * side + cosine * axis, atol=1e-15)
    traced = trace(path_of(lens)[0], np.zeros((1, 3)), axis[None], D_UM)
    reflected = -np.sin(2 * np.deg2rad(angle)) * side - np.cos(2 * np.deg2rad(angle)) * axis
    np.testing.assert_allclose(traced.direction[0], reflected, atol=1e-15)
    np.testing.assert_allclose(image[:3, 3], [0, 0, 0.05] + 0.03 * reflected, atol=1e-15)
    np.testing.assert_allclose(image[:3, 2], -reflected, atol=1e-15)


@pytest.mark.parametrize(
    ("kind", "place", "turn"),
    [("", (1, 2, 58), 30), ("DAR", (0, 0, 55), 0), ("REV", (-1 * np.cos(np.pi / 6) - 1, 0.5 - np.sqrt(3), 52), -30)],
)
def test_axes_behind_a_decentre(tmp_path: Path, kind: str, place: tuple[float, float, int], turn: int) -> None:
    """CDE is right-handed; behind REV the axes are turned back, then shifted back along the turned axes."""
    lens = lens_of(tmp_path, FOLD.format(f"{kind}\nXDE 1; YDE 2; ZDE 3\nCDE 30").replace("-30 REFL", "5"))
    image = lens.surfaces[3].file_from_surface
    np.testing.assert_allclose(1e3 * image[:3, 3], place, atol=1e-12)
    angle = np.deg2rad(turn)
    np.testing.assert_allclose(image[:3, 0], [np.cos(angle), np.sin(angle), 0.0], atol=1e-15)


def test_three_decentred_mirrors_are_in_focus(tmp_path: Path) -> None:
    """A telescope that rayoptics publishes; a wrong sign of ADE blurs its image."""
    _, lens = read_lens_file(FOLDER / "three-mirrors.seq", CATALOGUE)
    stop, image = (lens.surfaces[place].file_from_surface for place in (3, 6))
    side = np.linspace(-0.15, 0.15, 121)
    origin = np.stack([*(axis.ravel() for axis in np.meshgrid(side, side)), np.full(121**2, -0.01)], axis=-1)
    traced = trace(path_of(lens)[0], origin, np.tile([0.0, 0.0, 1.0], (len(origin), 1)), 0.5)
    first, after = traced.points[:, 0], traced.points[:, 1] - traced.points[:, 0]
    at_stop = first + after * ((stop[:3, 3] - first) @ stop[:3, 2] / (after @ stop[:3, 2]))[:, None]
    passed = np.linalg.norm(at_stop - stop[:3, 3], axis=1) < 0.0239  # HMY at the stop in CODE V's listing
    last, after = traced.points[passed, -1], traced.direction[passed]
    spot = last + after * ((image[:3, 3] - last) @ image[:3, 2] / (after @ image[:3, 2]))[:, None]
    assert len(spot) > 100
    assert (spot.std(axis=0) < 2e-6).all()


@pytest.mark.parametrize(
    ("commands", "key", "bends_rays", "part"),
    [
        ("SPS ZRN\nSCO C4 0.1", "SPS", True, "shape"),
        ("SPS QBF\nSCO NRADIUS 20; SCO C3 0", "SPS", False, "shape"),
        ("SPS UD1", "SPS", True, "shape"),
        ("DIF DOE\nHOR 1.0; HWL 587; HCT R; HCO C1 -0.001", "DIF", True, "shape"),
        ("ASP\nCUF 0.01", "CUF", True, "other"),
        ("A 1e-5", "A", True, "other"),
        ("SPS ODD\nSCO AR1 0.1", "SCO", True, "other"),
        ("SPS ODD\nSCO AR22 1e-30", "SCO", True, "other"),
        ("SPS XYP\nSCO C999 1", "SCO", True, "other"),
        ("SPS XYP\nSCO X20Y2 1", "SCO", True, "other"),
        ("YTO\nRDX 50; K -1", "K", True, "other"),
        ("YTO\nRDX 50; A 1e-5", "A to D", True, "other"),
        ("YTO", "CUX", True, "other"),
        ("XTO\nRDX 50", "XTO", True, "other"),
        ("RET S1", "RET", True, "other"),
        ("GLB S1\nXDE 1", "GLB", True, "other"),
        ("XOD 1", "XOD", True, "other"),
        ("ADE 3; BDE 2; BEN", "BEN", True, "other"),
        ("ZOO 2\nZOO THI S2 4 5", "ZOO", True, "other"),
        ("TEM 60", "TEM", True, "other"),
        ("PRE 0", "PRE", True, "other"),
        ("IN other.seq", "IN", True, "other"),
        ("THI HMY 0.0", "THI", False, "other"),
        ("CUY UMY -0.2", "CUY", False, "other"),
        ("PIK RDY S2 Z1 RDY S3 Z1 -1", "PIK", False, "other"),
        ("PIM", "PIM", False, "other"),
        ("CIR 10", "CIR", False, "other"),
        ("CIR OBS 3", "CIR", False, "other"),
        ("REX 5; ARO 30", "ARO", False, "other"),
        ("REX L'A' 5; REX L'B' 6", "REX", False, "other"),
        ("FOO 3", "FOO", False, "other"),
        ("'' 3; ' ' 4", "''", False, "other"),
    ],
)
def test_commands_that_are_not_read_are_named(
    tmp_path: Path, commands: str, key: str, bends_rays: bool, part: str
) -> None:
    lens = lens_of(tmp_path, SEQ.replace(FRONT, f"{FRONT}{commands}\n"))
    assert (key, bends_rays, part) in [(note.key, note.bends_rays, note.part) for note in lens.ignored]


def test_commands_without_effect_on_rays_are_not_listed(tmp_path: Path) -> None:
    quiet = "CCY 0; THC 100; CUF 0.0; XDE 0.0; XDC 100; VUY 0.0 0.1; WTF 1 1; TEM 20.0; PRE 760; TIT Z2 'far'"
    lens = lens_of(tmp_path, SEQ.replace("GO", f"{quiet}\nGO"))
    assert [note.key for note in lens.ignored] == ["GLA"]
    assert lens.title == "one lens"


@pytest.mark.parametrize(
    ("commands", "low", "high"),
    [
        ("CIR CLR 10; ADX 1; ADY -2", (-9, -12), (11, 8)),
        ("REX 5; REY 3", (-5, -3), (5, 3)),
        ("REX L'SET' 5", (-5, -np.inf), (5, np.inf)),
        ("CIR 4; REX 5; REY 3", (-4, -3), (4, 3)),
        ("ELX 5; ELY 3", (-5, -3), (5, 3)),
        ("CIR EDG 10", (-np.inf, -np.inf), (np.inf, np.inf)),
    ],
)
def test_clear_apertures(tmp_path: Path, commands: str, low: tuple[float, float], high: tuple[float, float]) -> None:
    surface = lens_of(tmp_path, SEQ.replace(FRONT, f"{FRONT}{commands}\n")).surfaces[2]
    np.testing.assert_allclose(1e3 * surface.aperture.low[:2], low)
    np.testing.assert_allclose(1e3 * surface.aperture.high[:2], high)
    np.testing.assert_allclose(surface.semi_diameter, 0.01 if "EDG" in commands else np.nan)


@pytest.mark.parametrize(("unit", "first", "second"), [("M", 1e-5, 2e-7), ("C", 1e-2, 2e-2)])
def test_terms_of_an_anamorphic_asphere(tmp_path: Path, unit: str, first: float, second: float) -> None:
    text = SEQ.replace("DIM M", f"DIM {unit}")
    lens = lens_of(tmp_path, text.replace(FRONT, f"{FRONT}AAS; CUX 0; CUY 0; AR {first}; AP 0.2; BR {second}\n"))
    shape = lens.surfaces[2].shape
    assert isinstance(shape, AnamorphicAsphere)
    inner = 0.8 * 16 + 1.2 * 9
    sag = shape.sag_and_slopes(np.array([0.004]), np.array([-0.003]))[0]
    assert 1e3 * sag == pytest.approx(1e-5 * inner**2 + 2e-7 * 25**3, rel=1e-12)


@pytest.mark.parametrize("mirror", ["S 0.0 -10.0 REFL", "S 0.0 -10.0 1.5168 64.17 REFL", "S 0.0 -10\nRMD REFL"])
def test_a_mirror_has_the_medium_before_it_behind_it(tmp_path: Path, mirror: str) -> None:
    lens = lens_of(tmp_path, SEQ.replace(BACK, f"{mirror}\n{BACK}"))
    assert [surface.reflects for surface in lens.surfaces] == [False, False, False, True, False, False]
    assert lens.surfaces[3].medium == lens.surfaces[2].medium


@pytest.mark.parametrize(
    ("name", "asked"),
    [
        ("NSF99_SCHOTT", ("N-SF99", ("schott",))),
        ("SF99_SCHOTT", ("SF99", ("schott",))),
        ("SLAL99_OHARA", ("S-LAL99", ("ohara",))),
        ("NSF99", ("NSF99", ())),
    ],
)
def test_glasses_are_looked_up_as_their_makers_write_them(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, name: str, asked: tuple[str, tuple[str]]
) -> None:
    queries = []
    monkeypatch.setattr(
        "wlr_render.optics.lens_files.glass_catalogues._glass_of_optiland", lambda *query: queries.append(query)
    )
    with pytest.raises(BadInputError, match=asked[0]):
        lens_of(tmp_path, SEQ.replace("1.5168 64.17", name))
    assert queries == [asked]


PRIVATE = "PRV\n  PWL 656.2725 587.5618 486.1327\n  {}\nEND\n"


def test_private_glasses(tmp_path: Path) -> None:
    """A private glass has its indices, also if PRV follows the surfaces, or Laurent's formula (NOA61: n_d 1.5597)."""
    text = SEQ.replace("1.5168 64.17", "'MINE'")
    lens = lens_of(tmp_path, text.replace("GO", PRIVATE.format("'MINE' 1.61 1.62 1.63")))
    medium = lens.surfaces[2].medium
    indices = [medium.index(wave) for wave in (0.6562725, 0.5875618, 0.4861327)]
    np.testing.assert_allclose(indices, [1.61, 1.62, 1.63], atol=1e-12)
    assert [(note.key, note.part) for note in lens.ignored] == [("PRV", "glass")]
    laurent = PRIVATE.format("'MINE' LAU 2.36390625 0.0 0.025493134 -0.000580235 -0.349933e-5 0.445404e-7")
    lens = lens_of(tmp_path, text.replace("SO 0.0", laurent + "SO 0.0"))
    assert lens.surfaces[2].medium.index(D_UM) == pytest.approx(1.5597, abs=1e-4)
    assert not lens.ignored


def test_many_private_indices_are_fitted(tmp_path: Path) -> None:
    waves = np.linspace(400.0, 1600.0, 20)
    indices = [present(CATALOGUE.find("N-BK7")).medium.index(1e-3 * wave) for wave in waves]
    stated = "PRV\nPWL" + "&\n".join(f" {wave}" for wave in waves) + "\nMINE" + "".join(f" {n:.4f}" for n in indices)
    lens = lens_of(tmp_path, SEQ.replace("1.5168 64.17", "MINE").replace("SO 0.0", f"{stated}\nEND\nSO 0.0"))
    assert lens.surfaces[2].medium.index(0.55) == pytest.approx(
        present(CATALOGUE.find("N-BK7")).medium.index(0.55), abs=1e-4
    )


@pytest.mark.parametrize(
    ("old", "new", "sentence"),
    [
        ("S 40.0 4.0", "S x 4.0", r"line 10: value 1 of S is 'x'; it must be a number"),
        (FRONT, f"{FRONT}THI 1e13\n", "line 11: value 1 of THI is '1e13'"),
        ("S 40.0 4.0", "S 40.0 4.0 1.5x", "line 10: value 3 of S is '1.5x'"),
        (BACK, "S -100.0\n", "line 11: value 2 of S is ''"),
        ("S 40.0 4.0", "S 40.0 1e13", r"line 10: value 2 of S is '1e13'; it must be a number of at most 1e\+12"),
        (FRONT, f"{FRONT}ASP; A nan\n", "line 11: value 1 of A is 'nan'"),
        (FRONT, f"{FRONT}K S9 -1\n", "line 11: surface S9 does not exist yet"),
        (FRONT, f"{FRONT}CIR -3\n", "line 11: CIR is -3; it must be larger than 0"),
        (FRONT, f"{FRONT}SPS XYP 1e-30\n", "line 11: NRADIUS is 1e-30"),
        ("S 40.0 4.0", "S7 40.0 4.0", "line 10: surface 'S7' follows S1; surfaces are stated in their order"),
        ("SO 0.0 0.1e14\n", "", "line 7: surface 'S' follows nothing"),
        ("GO", "S 0 1", "line 13: surface 'S' follows the image SI"),
        ("DIM M", "DIM FURLONG", "line 4: DIM is 'FURLONG'; it must be M"),
        ("TITLE 'one lens'", "TITLE 'one lens", "line 2: a text in quotes does not end in its line"),
        ("1.5168 64.17", "15.168 64.17", "line 10: glass '15.168': the index"),
        ("1.5168 64.17", "XSUCH_SCHOTT", r"no catalogue has these glasses: XSUCH .surface 2"),
        ("1.5168 64.17", "_SCHOTT", r"no catalogue has these glasses: _SCHOTT .surface 2"),
        ("1.5168 64.17", "NOSUCH\n" + PRIVATE.format("NOSUCH SEL 1 2 3"), "line 13: glass 'NOSUCH': a private glass"),
        ("1.5168 64.17", "NOSUCH\n" + PRIVATE.format("NOSUCH 1.5 1.6"), "line 13: glass 'NOSUCH': a private glass"),
        (SEQ, "LEN\nSO 0 1\nSI 0 0\n", "has 2 surfaces"),
        (SEQ, "LEN\n", "has 0 surfaces"),
    ],
)  # fmt: skip
def test_faults_are_named(tmp_path: Path, without_optiland: None, old: str, new: str, sentence: str) -> None:
    assert old in SEQ
    with pytest.raises(BadInputError, match=rf"lens\.seq: .*{sentence}"):
        lens_of(tmp_path, SEQ.replace(old, new))


def test_planes_and_thicknesses(tmp_path: Path) -> None:
    lens = lens_of(tmp_path, SEQ)
    assert lens.surfaces[1].shape == Conic(0.0)
    assert not np.isfinite(lens.surfaces[0].file_from_surface).any()
    places = [surface.file_from_surface[2, 3] for surface in lens.surfaces[1:]]
    np.testing.assert_allclose([b - a for a, b in pairwise(places)], [0.02, 0.004, 0.03], atol=1e-15)
