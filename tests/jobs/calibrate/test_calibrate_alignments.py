"""`calibrate ALIGNMENTS`: from the file of a wearer to a model that other verbs take."""

import tomllib
from pathlib import Path

import numpy as np
import pytest
from present import as_number, narrowed

import wlr_render as wlr
from wlr_render.budget.error_map import ErrorMap
from wlr_render.budget.error_sizes import ErrorSizes
from wlr_render.errors import BadInputError
from wlr_render.geometry.directions import ARCMIN
from wlr_render.io.toml_files import read_toml, write_toml
from wlr_render.jobs.calibrate.calibrate import calibrate
from wlr_render.jobs.calibrate.calibrate_options import CalibrateOptions, FitOptions
from wlr_render.mappings import Eye

EYE = np.array([0.002, -0.001, 0.01])


@pytest.fixture
def alignments(flat_image_headset: Eye, tmp_path: Path) -> Path:
    """Twelve alignments at one metre with a tremor of 3'."""
    rng = np.random.default_rng(4)
    pixel = rng.uniform(0.1, 0.9, (12, 2)) * flat_image_headset.display.panel.size_px
    shown = flat_image_headset.display.view_dir_of_pixel(pixel, EYE).value
    point = EYE - shown / shown[:, 2:] + 0.001 * rng.standard_normal((12, 3))
    box = flat_image_headset.eye_box
    content = {
        "format": "wlr-alignments",
        "version": 1,
        "frame": "openxr",
        "device": "mine",
        "eye": "right",
        "panel_px": [140, 100],
        "eye_box": {"centre_m": box.centre.tolist(), "size_m": box.size.tolist()},
        "alignment": [{"pixel": p.tolist(), "point_m": q.tolist()} for p, q in zip(pixel, point, strict=True)],
    }
    return write_toml(tmp_path / "wearer.toml", content)


def test_a_model_with_predicted_errors_comes_of_alignments(alignments: Path, tmp_path: Path) -> None:
    report = calibrate(CalibrateOptions(str(alignments), out=tmp_path / "out"))
    assert report.verdict.startswith("Right eye: 12 alignments predict points at 1 m to ")
    assert any(step.startswith("Align points at other distances too: all are 1 to 1 m away") for step in report.advice)
    near, middle, far = (as_number(row[1]) for row in report.tables[0].rows)
    # An eye that is off by d shifts points at 0.4 m by (1 / 0.4 - 1 / 1) d against those at 1 m, which were aligned.
    sigma_m = np.array(narrowed(report.record["fit"], dict)["eye_sigma_m"])[:2]
    assert np.sqrt(near**2 - middle**2) == pytest.approx(1.5 * np.linalg.norm(sigma_m) / ARCMIN, rel=0.15)
    assert middle < far
    eye = wlr.open_eye(tmp_path / "out" / "model.json", "right")
    predicted = ErrorMap(eye, ErrorSizes()).at(eye.eye_box.centre, depth_m=1.0)
    assert [each.name for each in predicted.sources if each.rms_arcmin > 0] == ["model: alignments"]
    assert predicted.rms_arcmin == pytest.approx(middle, rel=0.3)


def test_what_is_wrong_in_the_file_is_named(alignments: Path, tmp_path: Path) -> None:
    text = alignments.read_text()
    out = tmp_path / "out"
    for old, new, sentence in (
        ('eye = "right"', 'eye = "third"', "'eye' is 'third'; it must be one of left, right"),
        ("panel_px = [140, 100]", "panel_px = [14, 10]", "of the panel pixels are outside the panel of 14 x 10"),
        ("[[alignment]]", "[[aligned]]", r"key 'alignment' is missing \(found 'aligned' instead\)"),
        ("point_m", "point_mm", "key 'point_m' is missing"),
        ('device = "mine"', 'device = "mine"\nwearer = 3', "unknown key 'wearer'"),
    ):
        assert old in text
        alignments.write_text(text.replace(old, new))
        with pytest.raises(BadInputError, match=sentence):
            calibrate(CalibrateOptions(str(alignments), out=out))
    alignments.write_text(text)
    table = read_toml(alignments)
    assert len(table.tables("alignment")) == 12
    with pytest.raises(BadInputError, match="not used with a file of alignments"):
        calibrate(CalibrateOptions(str(alignments), out=out, fit=FitOptions(degree=2)))
    with pytest.raises(BadInputError, match="not used with a file of alignments"):
        calibrate(CalibrateOptions(str(alignments), out=out, validate=True))
    with pytest.raises(BadInputError, match=r"--seed is used with a device only, and .* is a file of alignments"):
        calibrate(CalibrateOptions(str(alignments), out=out, seed=2))


def test_an_eye_on_the_side_of_the_other_eye_is_doubted(alignments: Path, tmp_path: Path) -> None:
    content = tomllib.loads(alignments.read_text())
    content["eye_box"]["centre_m"][0] += 0.032
    for each in content["alignment"]:
        each["point_m"][0] += 0.032
    for eye, count in (("right", 0), ("left", 1)):
        write_toml(alignments, content | {"eye": eye})
        warnings = calibrate(CalibrateOptions(str(alignments), out=tmp_path / eye)).warnings
        assert sum("is at x = +3" in warning and "where the right eye is" in warning for warning in warnings) == count


def changed(path: Path, number: int, **values: list[float]) -> None:
    """Change keys of one alignment of a file."""
    content = tomllib.loads(path.read_text())
    content["alignment"][number].update(values)
    write_toml(path, content)


def test_a_copy_of_an_alignment_is_no_evidence(alignments: Path, tmp_path: Path) -> None:
    first = tomllib.loads(alignments.read_text())["alignment"][1]
    changed(alignments, 7, **first)
    with pytest.raises(BadInputError, match=r"\[\[alignment\]\] 8 is a copy of \[\[alignment\]\] 2; remove it"):
        calibrate(CalibrateOptions(str(alignments), out=tmp_path / "out"))


def test_the_times_of_some_alignments_alone_are_refused(alignments: Path, tmp_path: Path) -> None:
    content = tomllib.loads(alignments.read_text())
    content["alignment"][0].pop("time_s", None)
    content["alignment"][1]["time_s"] = 3.0
    write_toml(alignments, content)
    with pytest.raises(BadInputError, match=r"'time_s' is given for some alignments only; give it for all"):
        calibrate(CalibrateOptions(str(alignments), out=tmp_path / "out"))


def test_the_first_sentence_names_an_alignment_that_the_others_contradict(alignments: Path, tmp_path: Path) -> None:
    changed(alignments, 3, point_m=[0.3, 0.3, -1.0])
    report = calibrate(CalibrateOptions(str(alignments), out=tmp_path / "out"))
    assert report.verdict.startswith("Right eye: 12 alignments predict points at 1 m to ")
    assert "; the others contradict number 4. One alignment errs by" in report.verdict
    assert "e+0" not in report.verdict
    assert report.advice[0].startswith("Align number 4 again, or remove it from ")


def test_a_mirrored_panel_is_said(alignments: Path, tmp_path: Path) -> None:
    assert not any("mirrored" in each for each in calibrate(CalibrateOptions(str(alignments), out=tmp_path)).warnings)
    for number, each in enumerate(tomllib.loads(alignments.read_text())["alignment"]):
        changed(alignments, number, pixel=[140.0 - each["pixel"][0], each["pixel"][1]])
    report = calibrate(CalibrateOptions(str(alignments), out=tmp_path))
    assert any(each.startswith("The wearer sees the panel mirrored: do the pixels of ") for each in report.warnings)
