"""From a lens file to a headset: which surface is the eye, which the panel, whichever way the file's light runs."""

import json
import shlex
import shutil
from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from wlr_render.cli import main
from wlr_render.errors import BadInputError
from wlr_render.geometry.directions import dir_of_tangents
from wlr_render.jobs.import_lens import ImportLensOptions, import_lens
from wlr_render.numerics.arrays import FloatArray
from wlr_render.optics.device import Device
from wlr_render.optics.device_file import load_device
from wlr_render.optics.first_order import first_order
from wlr_render.optics.lens_files.glass_catalogues import GlassCatalogue
from wlr_render.optics.lens_files.lens_file import read_lens_file
from wlr_render.optics.traced_mappings import TracedDisplay
from wlr_render.report.blocks import Report

LENSES = Path(__file__).resolve().parent.parent / "optics" / "data" / "lens_files"
LOUPE = """UNIT MM
SURF 0
  DISZ INFINITY
SURF 1
  STOP
  DISZ 20
SURF 2
  CURV 0.02
  DISZ 5
  GLAS ___BLANK 1 0 1.5 60
SURF 3
  CURV -0.02
  DISZ 45
  DIAM 20 1
SURF 4
  CURV 0.0
  DISZ 0
"""
BACKWARDS = """UNIT MM
SURF 0
  DISZ 45
SURF 1
  CURV 0.02
  DISZ 5
  GLAS ___BLANK 1 0 1.5 60
SURF 2
  CURV -0.02
  DISZ 20
SURF 3
  STOP
  DISZ 100
SURF 4
  DISZ 0
"""


def imported(tmp_path: Path, text: str, **options: Any) -> tuple[Report, Device]:
    file = tmp_path / "lens.zmx"
    file.write_text(text)
    given = ImportLensOptions(file, panel=(800, 600), panel_mm=(16.0, 12.0), out=tmp_path / "out")
    report = import_lens(replace(given, **options))
    return report, load_device(tmp_path / "out" / "lens.toml")


def pixels(device: Device, side: str = "right") -> FloatArray:
    eye = device.eyes[side]
    view_dir = dir_of_tangents(np.array([[0.0, 0.0], [0.1, 0.0], [0.0, 0.05]]))
    return TracedDisplay(eye, 0.5875618).plane_pixel(view_dir, eye.eye_box.centre)[0]


def test_a_loupe_becomes_a_headset_with_an_upright_picture(tmp_path: Path) -> None:
    report, device = imported(tmp_path, LOUPE)
    optics = device.eyes["right"]
    assert [step.surface.name for step in optics.display.steps] == ["s2", "s3"]
    np.testing.assert_allclose(optics.panel.device_from_panel[:3, 3], [0, 0, -0.07], atol=1e-15)
    centre, right, up = pixels(device)
    np.testing.assert_allclose(centre, [400, 300], atol=1e-9)
    # The focal length is 51.4 mm by the lens maker's equation, and the panel's pixels are 0.02 mm.
    assert right - centre == pytest.approx([0.1 * 50 / 0.02, 0.0], rel=0.1)
    assert up - centre == pytest.approx([0.0, -0.05 * 50 / 0.02], rel=0.1)
    assert "the pupil stands at surface 1, the aperture stop, the panel is surface 4" in report.verdict
    assert not report.warnings
    assert report.tables[0].rows[2][:3] == [2, None, "s2"]


def test_the_same_loupe_of_code_v_is_the_same_headset(tmp_path: Path) -> None:
    _, device = imported(tmp_path, LOUPE)
    file = tmp_path / "lens.seq"
    file.write_text("RDM;LEN\nDIM M\nSO 0 1e11\nS 0 20; STO\nS 50 5 1.5 60\nS -50 45; SPS QBF; SCO C3 0.1\nSI 0 0\n")
    report = import_lens(ImportLensOptions(file, panel=(800, 600), panel_mm=(16.0, 12.0), out=tmp_path / "seq"))
    np.testing.assert_allclose(pixels(load_device(tmp_path / "seq" / "lens.toml")), pixels(device), atol=1e-9)
    assert "the type of surface 3 (QBF) is not read" in report.verdict
    assert "2 surfaces of CODE V's lens.seq are the display path" in report.verdict


def test_a_file_that_starts_at_the_panel_gives_the_same_headset(tmp_path: Path) -> None:
    _, forwards = imported(tmp_path, LOUPE)
    _, backwards = imported(tmp_path, BACKWARDS, starts_at="panel")
    assert [step.surface.name for step in backwards.eyes["right"].display.steps] == ["s2", "s1"]
    np.testing.assert_allclose(pixels(backwards), pixels(forwards), atol=1e-9)


def test_eye_centre_side_and_relief_are_taken(tmp_path: Path) -> None:
    _, device = imported(tmp_path, LOUPE, eye_centre_mm=(-32.0, 1.0, 2.0), eye="left", eye_relief_mm=20.0)
    np.testing.assert_allclose(device.eyes["left"].eye_box.centre, [-0.032, 0.001, 0.002], atol=1e-15)
    _, at_stop = imported(tmp_path, LOUPE)
    np.testing.assert_allclose(pixels(device, "left"), pixels(at_stop), atol=1e-9)


def test_semi_diameters_are_apertures_if_asked_for(tmp_path: Path) -> None:
    def high(**options: Any) -> Any:
        return imported(tmp_path, LOUPE, **options)[1].eyes["right"].display.steps[1].surface.aperture.high[0]

    assert np.isinf(high())
    assert high(semi_diameters=True) == pytest.approx(0.02)


@pytest.mark.parametrize(
    ("text", "starts_at"),
    [
        (LOUPE.replace("CURV 0.0\n  DISZ 0", "CURV -0.01\n  DISZ 0"), "eye"),
        (BACKWARDS.replace("  DISZ 45", "  CURV 0.01\n  DISZ 45"), "panel"),
    ],
)
def test_a_bowed_image_makes_a_bowed_panel(tmp_path: Path, text: str, starts_at: str) -> None:
    report, device = imported(tmp_path, text, starts_at=starts_at)
    panel = device.eyes["right"].panel
    edge = panel.point_of_pixel(np.array([800.0, 300.0]))
    # A sphere of 100 mm with its centre towards the eye: its edge is nearer to the eye than its middle.
    assert edge[2] + 0.07 == pytest.approx(0.008**2 / 0.2, rel=1e-6)
    assert report.tables[1].rows[0][1] == "CURV"


@pytest.mark.parametrize(
    ("old", "new", "options", "sentence"),
    [
        ("  STOP\n", "", {}, "names no aperture stop; say where the eye is"),
        ("SURF 1\n  STOP", "SURF 1", {"pupil_surface": 9}, "--pupil-surface is 9; the surfaces are 0 to 4"),
        ("DISZ 20", "DISZ 20", {"pupil_surface": 3}, "cannot stand at surface 3: the optics of surface 2, 3"),
        ("DISZ 20", "DISZ 20", {"starts_at": "panel"}, "surface 0, the panel, lies at infinity"),
        ("DISZ 20", "DISZ 20", {"panel_surface": 1}, "no mirror or glass lies between"),
        ("  GLAS ___BLANK 1 0 1.5 60", "  TYPE PARAXIAL", {}, r"types that are not read: surface 2 .PARAXIAL"),
        ("DISZ 45", "DISZ 4500", {}, r"lens.zmx, as a device.*'centre_mm' has the value -4525; .* convert its unit"),
    ],
)
def test_an_eye_or_panel_that_cannot_be_told_is_refused(
    tmp_path: Path, old: str, new: str, options: Mapping[str, Any], sentence: str
) -> None:
    with pytest.raises(BadInputError, match=sentence):
        imported(tmp_path, LOUPE.replace(old, new), **options)
    assert not (tmp_path / "out").exists()


def test_shapes_that_are_not_read_are_warned_of(tmp_path: Path) -> None:
    text = LOUPE.replace("  CURV -0.02\n", "  TYPE SZERNSAG\n  CURV -0.02\n  XDAT 3 0.2\n")
    report, _ = imported(tmp_path, text)
    assert report.verdict.startswith(
        "The device does not trace as the lens does: the type of surface 3 (SZERNSAG) is not read, and a simpler "
        "surface stands in its place. 2 surfaces of"
    )
    assert report.warnings == [
        "Rays differ from the file's because of surface 3: the table of ignored keys gives the reasons."
    ]


def test_a_surface_that_is_steep_beyond_its_edge_is_read_up_to_its_semi_diameter(tmp_path: Path) -> None:
    text = LOUPE.replace("  CURV 0.02\n", "  TYPE EVENASPH\n  CURV 0.02\n  PARM 8 1e-9\n  DIAM 1 1\n")
    with pytest.raises(BadInputError, match=r"mm per mm within its aperture.* --semi-diameters"):
        imported(tmp_path, text)
    _, device = imported(tmp_path, text, semi_diameters=True)
    assert device.eyes["right"].display.steps[0].surface.aperture.high[0] == pytest.approx(0.001)


def test_a_surface_in_air_of_a_type_that_is_not_read_is_not_said_to_bend_no_ray(tmp_path: Path) -> None:
    text = LOUPE.replace("SURF 4", "SURF 4\n  TYPE BINARY_2\n  PARM 1 1\n  XDAT 3 5\nSURF 5")
    report, _ = imported(tmp_path, text)
    assert "surface 4 (BINARY_2) is not read, and a simpler one or none stands in its place" in report.verdict
    assert report.tables[0].rows[4][4] == "left out: its type is not read"


def test_a_diffractive_element_is_named(tmp_path: Path) -> None:
    file = json.loads((LENSES / "Sasian Triplet.roa").read_text())
    surface = file["optical_model"]["attributes"]["seq_model"]["attributes"]["ifcs"][1]["attributes"]
    surface["phase_element"] = {"__instance_type__": ["rayoptics.oprops.doe", "DiffractiveElement"], "attributes": {}}
    path = tmp_path / "doe.roa"
    path.write_text(json.dumps(file))
    _, lens = read_lens_file(path, GlassCatalogue())
    assert [(note.surface, note.value) for note in lens.ignored if note.part == "shape"] == [(1, "DiffractiveElement")]


def test_a_common_glass_needs_no_catalogue_and_its_source_is_in_the_table(tmp_path: Path) -> None:
    report, device = imported(tmp_path, LOUPE.replace("___BLANK 1 0 1.5 60", "BK7 0 0 1.5 40"))
    assert device.eyes["right"].display.steps[0].medium.index(0.5875618) == pytest.approx(1.5168, abs=5e-6)
    reason = "taken as N-BK7, from this program's catalogue (Schott, Zemax catalogue of 2017-01-20)"
    assert report.tables[1].rows[0] == ["2", "GLAS", "BK7", "no", reason]
    assert not report.warnings
    assert 'formula = "N-BK7"' in report.files[0].read_text()


def test_types_that_are_not_read_are_named_for_all_three_programs(tmp_path: Path) -> None:
    """Optiland's and rayoptics' files with the type of one surface changed to one that is not read."""
    for name, old, new in (
        ("shapes.json", '"EvenAsphere"', '"ZernikePolynomialGeometry"'),
        ("Sasian Triplet.roa", '"Spherical"', '"Zernike"'),
    ):
        text = (LENSES / name).read_text(encoding="utf-8")
        assert old in text
        file = tmp_path / name
        file.write_text(text.replace(old, new, 1))
        _, lens = read_lens_file(file, GlassCatalogue((LENSES / "some_glasses.agf",)))
        assert [note.part for note in lens.ignored if note.value in new] == ["shape"]


def test_glasses_taken_approximately_are_warned_of(tmp_path: Path) -> None:
    text = LOUPE.replace("___BLANK 1 0 1.5 60", "MYGLASS 0 0 1.51 61")
    report, _ = imported(tmp_path, text)
    assert report.warnings == [
        "Glass MYGLASS of surface 2 is taken approximately: in no catalogue: taken by its index 1.51 and Abbe number "
        "61."
    ]


def test_the_size_of_the_glass_database_is_stated(tmp_path: Path) -> None:
    with pytest.raises(BadInputError, match=r"no catalogue has these glasses: MYGLASS .*\(1\.3 GB\)"):
        imported(tmp_path, LOUPE.replace("___BLANK 1 0 1.5 60", "MYGLASS"))


def test_the_advice_is_a_command_that_runs_in_a_folder_with_spaces(tmp_path: Path) -> None:
    folder = tmp_path / "my lenses"
    folder.mkdir()
    report, _ = imported(folder, LOUPE)
    program, *words = shlex.split(report.advice[0].partition(": ")[2])
    assert program == "wlr-render"
    assert main([*words, "--out", str(tmp_path / "traced")]) == 0


def test_the_help_says_that_there_are_no_glass_files_by_default(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["import-lens", "--help"]) == 0
    assert "[default: ]" not in capsys.readouterr().out


@pytest.mark.parametrize("name", ["HoO-V2C18Ex27.zmx", "codev-decentres.seq", "Sasian Triplet.roa", "shapes.json"])
def test_files_of_four_programs_by_the_verb(tmp_path: Path, name: str, capsys: pytest.CaptureFixture[str]) -> None:
    shutil.copy(LENSES / name, tmp_path)
    out = tmp_path / "out"
    command = ["import-lens", str(tmp_path / name), "--panel", "640x480", "--panel-mm", "8x6", "--out", str(out)]
    more = ["--eye-relief-mm", "20", "--glasses", str(LENSES / "some_glasses.agf")]
    assert main(command + more) == 0
    (device,) = out.glob("*.toml")
    assert load_device(device).eyes["right"].panel.pixels.width_px == 640
    record = json.loads((out / "report.json").read_text())
    assert "display path" in capsys.readouterr().out
    assert record["tables"][0]["rows"]


def test_the_focal_length_is_that_of_rayoptics(tmp_path: Path) -> None:
    """Paraxial figures of rayoptics 0.9.8 at 587.56 nm: focal length 50.00099 mm, image 1.15 um before the focus."""
    file = shutil.copy(LENSES / "Sasian Triplet.roa", tmp_path)
    options = ImportLensOptions(
        Path(file), panel=(1000, 1000), panel_mm=(20.0, 20.0), eye_relief_mm=20.0, out=tmp_path / "out"
    )
    import_lens(options)
    imaging = first_order(load_device(tmp_path / "out" / "Sasian_Triplet.toml").eyes["right"], 0.5875618)
    assert imaging is not None
    assert imaging.focal_length_m == pytest.approx((0.05000099, 0.05000099), rel=2e-5)
    assert imaging.vergence_per_m == pytest.approx((1.15e-6 / 0.05**2,) * 2, abs=1e-4)
