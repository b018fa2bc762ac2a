import json
import re
from collections.abc import Sequence
from pathlib import Path

import pytest
from present import as_number, present

from wlr_render.io.atomic_files import resource
from wlr_render.jobs.options import Eyes
from wlr_render.jobs.trace import TraceOptions, imaging_warnings, loss_warnings, trace
from wlr_render.optics.device_file import load_device
from wlr_render.optics.drawing import draw_device
from wlr_render.optics.first_order import first_order
from wlr_render.optics.media import FRAUNHOFER_F_D_C_UM
from wlr_render.optics.ray_losses import display_losses
from wlr_render.report.blocks import Report, ReportTable
from wlr_render.scene.image_files import read_png


def traced(device: str, folder: Path, eye: Eyes = "right") -> Report:
    return trace(TraceOptions(device, eye=eye, out=folder))


@pytest.mark.slow
def test_figures_and_drawing_of_an_eye_are_written(tmp_path: Path, straight_device: str) -> None:
    report = traced(straight_device, tmp_path / "out", "left")
    names = ["no_optics-left.png", "report.html", "report.json", "report.md"]
    assert sorted(path.name for path in report.files) == names
    assert sorted(path.name for path in (tmp_path / "out").iterdir()) == names
    assert read_png(tmp_path / "out" / "no_optics-left.png").std() > 5
    record = json.loads((tmp_path / "out" / "report.json").read_text())
    rows = {row["figure"]: row for row in record["tables"][0]["rows"]}
    # Without optics nothing is bent or coloured, and 1 mm is 6.9 arcmin at the panel's half metre.
    assert rows["see-through deviation at infinity"]["max (arcmin)"] < 1e-9
    assert rows["see-through colour, blue to red"]["max (arcmin)"] < 1e-9
    assert rows["pupil swim per mm in y"]["max (arcmin)"] == pytest.approx(6.875, rel=0.01)
    colours = record["tables"][1]["rows"]
    assert [row["against green"] for row in colours] == ["red", "blue"]
    assert all(row["world ray max"] < 1e-6 for row in colours)


def test_colour_comes_from_the_two_ends_of_the_spectrum(tmp_path: Path, small_northstar: str) -> None:
    rows = {row[0]: row[1:] for row in traced(small_northstar, tmp_path).tables[0].rows}
    mean, _, maximum = rows["see-through colour, blue to red"]
    assert 0 < as_number(mean) < as_number(maximum) < as_number(rows["see-through deviation at infinity"][0])


def test_both_eyes_are_traced_and_mirror_each_other(tmp_path: Path, small_northstar: str) -> None:
    report = traced(small_northstar, tmp_path, "both")
    assert [path.suffix for path in report.files].count(".png") == 2
    left, _, _, _, right, *_ = report.tables
    assert left.rows[0][1] == pytest.approx(right.rows[0][1], rel=1e-9)


def birdbath(tmp_path: Path, *changes: tuple[str, str], name: str = "changed") -> str:
    """A device file of the birdbath with parts of its text changed."""
    text = resource("devices", "birdbath28.toml").read_text(encoding="utf-8")
    for old, new in changes:
        assert re.search(old, text), old
        text = re.sub(old, new, text)
    path = tmp_path / f"{name}.toml"
    path.write_text(text)
    return str(path)


WRONG_SIGN = (r"radius_mm = -56\.0", "radius_mm = 56.0")
NO_FIELD = (r"field_deg = .*", "")
NO_APERTURES = (r"(?m)^aperture.*$", "")


def table(report: Report, title: str) -> ReportTable:
    return next(each for each in report.tables if each.title == title)


def test_a_mirror_of_the_wrong_sign_is_warned_about(tmp_path: Path) -> None:
    assert traced("birdbath28", tmp_path / "right").warnings == []
    few, sign, near, nearer = traced(birdbath(tmp_path, WRONG_SIGN), tmp_path / "wrong").warnings
    assert few.startswith("Only 42 of 525 rays over the nominal field of the right eye reach the panel. The first to")
    assert few.endswith("is 'plate_far': of 525 rays that reach it, 256 fall outside its aperture.")
    assert sign.startswith(
        "With 'mirror' bent to the other side, 525 of 525 rays would reach the panel: check the sign"
    )
    assert "0.051 m before the eye, where nobody can focus" in near
    assert nearer.startswith(
        "With 'mirror' bent to the other side, the virtual image would lie 2 m away (0.49 dioptres)"
    )


def test_a_wrong_sign_is_found_without_a_stated_field_and_without_apertures(tmp_path: Path) -> None:
    warnings = traced(birdbath(tmp_path, WRONG_SIGN, NO_FIELD, NO_APERTURES), tmp_path / "wrong").warnings
    assert "where nobody can focus" in warnings[0]
    assert warnings[1].startswith("With 'mirror' bent to the other side, the virtual image would lie 2 m away (0.49")


def test_a_panel_out_of_reach_is_drawn_and_explained(tmp_path: Path) -> None:
    report = traced(birdbath(tmp_path, (r"field_deg = .*", "field_deg = [60, 70, 60, 70]")), tmp_path / "out")
    assert "0 of 525 rays reach the panel" in report.verdict
    assert any("no direction of the nominal field of the right eye meets the panel" in each for each in report.warnings)
    rows = table(report, "Rays along the display path").rows
    assert rows[0][2] == 525
    assert rows[-1][3] == 0
    assert read_png(tmp_path / "out" / "birdbath28-right.png").std() > 5


@pytest.mark.parametrize(
    ("change", "surface", "reason"),
    [
        ((r"centre_mm = \[0\.0, -11\.0267, 21\.4097\]", "centre_mm = [0.0, 31.0, 21.4]"), "panel", "run away from it"),
        ((r"centre_mm = \[0\.0, -11\.0267, 21\.4097\]", "centre_mm = [0.0, -11.0, 61.4]"), "panel", "pass beside"),
        ((r"origin_mm = \[0\.0, 0\.0, 38\.0\]", "origin_mm = [0.0, 0.0, -38.0]"), "mirror", "it lies behind them"),
        ((r"radius_mm = -56\.0", "radius_mm = -9.0"), "mirror", "miss it"),
        (
            (r'\{ at = "mirror", do = "reflect" \}', '{ at = "mirror", do = "total_reflect" }'),
            "mirror",
            "below the critical angle",
        ),
    ],
)
def test_the_surface_that_loses_the_rays_is_named(
    tmp_path: Path, change: tuple[str, str], surface: str, reason: str
) -> None:
    optics = load_device(birdbath(tmp_path, change)).eyes["right"]
    first, *_ = loss_warnings(optics, "right", display_losses(optics, 0.55))
    assert f"The first to lose many is '{surface}'" in first
    assert reason in first


def test_focal_length_image_distance_and_distortion_are_those_of_closed_form(
    tmp_path: Path, straight_device: str
) -> None:
    """Without optics the panel itself is seen: as far as it stands, not magnified, not distorted."""
    rows = {row[0]: row[1:] for row in table(traced(straight_device, tmp_path), "Imaging of the panel").rows}
    assert rows["focal length (mm)"] == pytest.approx([500.0, 500.0], rel=1e-6)
    assert rows["distance of the virtual image (m)"] == pytest.approx([0.5, 0.5], rel=1e-6)
    assert rows["magnification, virtual image to panel"] == pytest.approx([1.0, 1.0], rel=1e-6)
    assert as_number(rows["distortion, largest (%)"][0]) < 1e-6


def test_a_spherical_mirror_images_as_its_equation_says(tmp_path: Path) -> None:
    rows = {row[0]: row[1:] for row in table(traced("birdbath28", tmp_path), "Imaging of the panel").rows}
    focal, distance = rows["focal length (mm)"][0], rows["distance of the virtual image (m)"][0]
    assert focal == pytest.approx(28.0, abs=0.5)  # half the radius
    # The panel stands 27.63 mm before the mirror, air for glass: 1 / (1/28 - 1/27.63) is 2.1 m behind it.
    assert distance == pytest.approx(2.05, abs=0.1)
    assert rows["distortion, largest (%)"][0] == pytest.approx(4.5, abs=0.2)


def test_axes_stay_with_the_device_where_rays_and_surfaces_have_no_end(tmp_path: Path) -> None:
    device = load_device(birdbath(tmp_path, NO_APERTURES, (r"rotate_x_deg = 45.0", "rotate_x_deg = 80.0")))
    path = tmp_path / "drawing.svg"
    draw_device(device, "right", path)
    ticks = [float(tick.replace("\u2212", "-")) for tick in re.findall(r"<!-- ([\u2212\d.]+) -->", path.read_text())]
    assert 10 < max(map(abs, ticks)) < 300  # millimetres


GUIDE = (Path(__file__).resolve().parents[2] / "docs" / "your-headset.md").read_text(encoding="utf-8")
STEPS = ['  { at = "mirror", do = "reflect" },\n', '  { at = "splitter", do = "reflect" },\n']


NO_FIELD_OF_GUIDE = ("field_deg = [-18, 18, -10, 10]\n", "")


def of_the_guide(tmp_path: Path, *changes: tuple[str, str], surfaces: int = 2) -> str:
    """A file with the birdbath of docs/your-headset.md, its first surfaces only, and parts of its text replaced."""
    text = present(re.search(r"```toml\n(.*?)```", GUIDE, re.DOTALL))[1]
    text = "[[eye.surface]]".join(text.split("[[eye.surface]]")[: 1 + surfaces])
    for old, new in changes:
        assert old in text
        text = text.replace(old, new)
    path = tmp_path / "mine.toml"
    path.write_text(text)
    return str(path)


def test_the_headline_states_the_image_distance_at_the_middle_of_the_field(tmp_path: Path) -> None:
    """The panel of the guide stands in the focus: aberrations swim as if the image were 2 m away, but it is not."""
    report = traced(of_the_guide(tmp_path), tmp_path / "focus")
    assert "virtual image at infinity, picture upright, real" in report.verdict
    assert any("Mean parallax distance 1.95 m in x" in note for note in report.tables[0].notes)
    assert table(report, "Imaging of the panel").rows[2][1] == pytest.approx(0.0, abs=1e-3)
    near = traced(of_the_guide(tmp_path, ("[0, -12, 20]", "[0, -11, 20]")), tmp_path / "near")
    # 29 mm before a mirror of 30 mm focal length, 38 mm before the eye: 1 / (1/29 - 1/30) + 38 mm.
    assert "virtual image 0.91 m away (1.1 dioptres)" in near.verdict


def test_both_distances_of_an_astigmatic_image_are_stated(tmp_path: Path) -> None:
    assert re.search(
        r"virtual image 1\.\d m away \(.* dioptres\) along x and 2\.\d m away \(.* dioptres\) along y, picture bottom",
        traced("freeform40", tmp_path).verdict,
    )


@pytest.mark.parametrize(
    ("u", "v", "short", "remedy"),
    [
        ("[1, 0, 0]", "[0, 0, -1]", "bottom up", "reverse v_axis."),
        ("[-1, 0, 0]", "[0, 0, 1]", "mirrored", "reverse u_axis."),
        ("[-1, 0, 0]", "[0, 0, -1]", "turned by 180 degrees", "reverse u_axis and v_axis."),
        ("[0, 0, 1]", "[1, 0, 0]", "turned by 90 degrees and mirrored", "with them."),
        ("[0, 0, 1]", "[-1, 0, 0]", "turned by 90 degrees", "with them."),
    ],
)
def test_a_picture_that_does_not_appear_upright_is_noticed(
    tmp_path: Path, u: str, v: str, short: str, remedy: str
) -> None:
    axes = ("u_axis = [1, 0, 0]\nv_axis = [0, 0, 1]", f"u_axis = {u}\nv_axis = {v}")
    report = traced(of_the_guide(tmp_path, axes), tmp_path / "out")
    assert f", picture {short}, " in report.verdict
    (warning,) = report.warnings
    assert f"appear {short}." in warning.replace("appears", "appear")
    assert warning.endswith(remedy)


def test_an_upright_picture_is_stated(tmp_path: Path) -> None:
    notes = table(traced(of_the_guide(tmp_path), tmp_path / "out"), "Imaging of the panel").notes
    assert notes[-1] == "Orientation: u runs to the wearer's right, v downwards: the picture is upright."


TOROID = 'shape = "toroid"\nradius_x_mm = {}\nradius_y_mm = {}'


@pytest.mark.parametrize(
    ("old", "new", "hint"),
    [
        (
            "".join(STEPS),
            "".join(STEPS[::-1]),
            "With 'mirror' before 'splitter', 525 of 525 rays would reach the panel: check the order of display_path.",
        ),
        (
            'shape = "conic"\nradius_mm = -60',
            TOROID.format(60, -60),
            "With radius_x_mm of 'mirror' of the other sign, 525 of 525 rays would reach the panel: check the sign of "
            "radius_x_mm.",
        ),
        (
            'shape = "conic"\nradius_mm = -60',
            TOROID.format(-60, 60).replace("toroid", "anamorphic"),
            "With radius_y_mm of 'mirror' of the other sign, 525 of 525 rays would reach the panel: check the sign of "
            "radius_y_mm.",
        ),
        (
            "rotate_x_deg = 45",
            "rotate_x_deg = -45",
            "With 'splitter' turned the other way, 525 of 525 rays would reach the panel: check the sign of its "
            "rotate_x_deg, or of its z_axis, and on which side the panel stands.",
        ),
    ],
)
def test_one_mistake_of_the_description_is_named(tmp_path: Path, old: str, new: str, hint: str) -> None:
    optics = load_device(of_the_guide(tmp_path, (old, new))).eyes["right"]
    _, *hints = loss_warnings(optics, "right", display_losses(optics, 0.55))
    assert hints == [hint]


def test_a_panel_out_of_focus_is_named_before_the_radii(tmp_path: Path) -> None:
    report = traced(of_the_guide(tmp_path, ("[0, -12, 20]", "[0, -22, 20]")), tmp_path / "out")
    (warning,) = report.warnings
    assert warning.endswith("check the distance of the panel (its centre_mm) first, then the radii.")


def test_rays_that_run_away_from_the_panel_are_counted_apart_from_those_that_miss_its_plane(tmp_path: Path) -> None:
    optics = load_device(of_the_guide(tmp_path, ("[0, -12, 20]", "[0, 12, 20]"))).eyes["right"]
    reasons = display_losses(optics, 0.55)[-1].reasons
    assert reasons["run away from it, for it lies behind them"] == 525
    assert reasons["miss its plane"] == 0


@pytest.mark.parametrize("changes", [[], [NO_FIELD_OF_GUIDE]], ids=["field stated", "no field"])
def test_without_a_display_path_there_is_a_drawing_and_no_figure(
    tmp_path: Path, changes: Sequence[tuple[str, str]]
) -> None:
    """Step 1 of the guide."""
    empty = ("[\n" + "".join(STEPS) + "]", "[]")
    report = traced(of_the_guide(tmp_path, empty, *changes, surfaces=0), tmp_path / "out")
    assert "nothing bends the rays yet" in report.verdict
    assert not re.search(r"nan|-|per pixel", report.verdict)
    assert not report.warnings
    assert not report.tables
    assert (tmp_path / "out" / "mine-right.png").exists()


def test_a_panel_that_is_not_seen_straight_ahead_has_no_field_there(tmp_path: Path) -> None:
    """Step 2 of the guide: the mirror alone."""
    report = traced(of_the_guide(tmp_path, (STEPS[1], ""), NO_FIELD_OF_GUIDE, surfaces=1), tmp_path / "out")
    assert "panel not seen straight ahead" in report.verdict
    assert "not seen horizontally" in report.tables[0].notes[0]
    assert "nan" not in report.tables[0].notes[0]


def test_the_guide_is_true(tmp_path: Path) -> None:
    """The file of docs/your-headset.md has no fault, and with the other sign those that the guide prints."""
    guide = GUIDE
    text = present(re.search(r"```toml\n(.*?)```", guide, re.DOTALL))[1]
    said = present(re.search(r"```text\n(.*?)```", guide, re.DOTALL))[1].splitlines()
    files = {radius: tmp_path / f"of{radius}.toml" for radius in (-60, 60)}
    for radius, file in files.items():
        file.write_text(text.replace("radius_mm = -60", f"radius_mm = {radius}"))
    right = traced(str(files[-60]), tmp_path / "right")
    assert right.warnings == []
    assert table(right, "Imaging of the panel").rows[0][1] == pytest.approx(30.0, abs=0.1)
    optics = load_device(files[60]).eyes["right"]
    wavelength_um = FRAUNHOFER_F_D_C_UM[1]
    sentences = loss_warnings(optics, "right", display_losses(optics, wavelength_um))
    sentences += imaging_warnings(optics, "right", first_order(optics, wavelength_um))
    assert sentences[: len(said)] == said
