"""Comparison of methods on a small experiment: tables, standard errors, a refusal; and the noise of pixels."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from present import as_number
from small_photo_session import in_this_process

from benchmarks import trials
from benchmarks.rivals import comparison as methods_module
from benchmarks.rivals import study
from benchmarks.rivals.method_trials import OUTLIER_PX, MethodTrial, _data, with_pixel_noise
from wlr_render.captures.correspondences import DisplayCaptures
from wlr_render.errors import BadInputError
from wlr_render.geometry.directions import ARCMIN, arcmin_between, dir_of_tangents
from wlr_render.mappings import EyeBox, Panel
from wlr_render.numerics.arrays import FloatArray
from wlr_render.report.blocks import Report

NAMES = ("planar", "linear-table-planar", "spaam")
TITLES = (
    "composite error",
    "display and see-through separately",
    "beyond the captures",
    "cost",
)
BOX = (10.0, 8.0, 6.0)


@pytest.fixture
def small(monkeypatch: pytest.MonkeyPatch) -> None:
    """Two conditions and one number of camera positions."""
    monkeypatch.setattr(methods_module, "CONDITIONS", {"exact": {}, "0.25 px": {"camera_noise_arcmin": 0.25}})
    monkeypatch.setattr(methods_module, "_NOISY", "0.25 px")
    monkeypatch.setattr(methods_module, "COUNTS", (9,))
    monkeypatch.setattr(methods_module, "POSITIONS", 9)


@pytest.fixture
def in_process(monkeypatch: pytest.MonkeyPatch) -> None:
    """Trials run in this process, where a test has changed the methods."""
    monkeypatch.setattr(trials, "as_finished", in_this_process)


def compared(out: Path, names: tuple[str, ...]) -> Report:
    return study.run(study.RivalsOptions(("birdbath28",), methods=names, repeats=2, workers=1, seed=3, out=out))


def captures(view_dir: FloatArray) -> DisplayCaptures:
    """Of one pixel, seen in directions (n, 3)."""
    return DisplayCaptures(
        device="toy",
        eye="right",
        eye_box=EyeBox(np.zeros(3), np.full(3, 0.01)),
        panel=Panel(100, 80),
        viewpoint=np.zeros(3),
        view_dir=view_dir,
        pixel=np.zeros(2),
        capture=np.array(0),
        sigma_arcmin=np.array(0.0),
    )


@pytest.mark.slow
def test_tables_of_methods(small: None, in_process: None, tmp_path: Path) -> None:
    first = compared(tmp_path, NAMES)
    assert [table.title for table in first.tables] == [
        "Conditions",
        "Methods",
        *(f"birdbath28 (right): {title}" for title in TITLES),
    ]
    _, sources, composite, apart, beyond, cost = first.tables
    for table in first.tables:
        assert all(len(row) == len(table.columns) for row in table.rows)
        assert len(set(table.columns)) == len(table.columns)  # keys of the rows in the JSON
    assert [row[0] for row in sources.rows] == list(NAMES)
    errors = ["exact (arcmin)", "0.25 px (arcmin)", "0.25 px +-"]
    assert composite.columns == ["method", *errors, "repetitions at 0.25 px", "no answer (%)"]
    assert [row[0] for row in composite.rows] == ["planar", "linear-table-planar", "spaam"]  # the best first
    for row in composite.rows:
        exact, noisy, standard_error, repetitions, unanswered = map(as_number, row[1:])
        assert repetitions == 2
        assert 0 <= unanswered < 10
        assert 0 < exact <= 1.5 * noisy
        assert 0 < standard_error < 0.5 * noisy
    best = as_number(composite.rows[0][1])
    assert best < 0.7 < as_number(composite.rows[2][1])
    assert {row[0] for row in apart.rows} == {"planar", "linear-table-planar"}  # the two of a lumped one mean nothing
    by_name = {row[0]: row for row in beyond.rows}
    swim = np.sqrt(as_number(by_name["planar"][1]) ** 2 - best**2)
    assert swim == pytest.approx(0.05 * np.sqrt(4.2**2 + 4.6**2 + 1.1**2), rel=0.35)
    assert by_name["planar"][3] == pytest.approx(0.0, abs=1e-6)  # a ray bundle does not contradict itself
    assert by_name["spaam"][2:4] == [None, None]
    assert {row[0] for row in cost.rows} == set(NAMES)
    assert all(as_number(cell) > 0 for row in cost.rows for cell in row[4:7])
    numbers = {row[0]: as_number(row[4]) for row in cost.rows}
    assert numbers["spaam"] < 20 < numbers["linear-table-planar"]
    assert "birdbath28 (right), 0.25 px: planar is best with" in first.verdict


def test_an_unknown_method_is_refused(tmp_path: Path) -> None:
    with pytest.raises(
        BadInputError, match="--methods has spam; did you mean spaam\\? Choose all, or from planar, "
    ) as refused:
        compared(tmp_path, ("planar", "spam"))
    assert "\n" not in str(refused.value)


def test_noise_of_pixels_is_smaller_off_axis_and_smallest_along_the_radius() -> None:
    """A pixel of a pinhole camera covers cos across and cos^2 along the radius of what it does in the middle."""
    angle = np.radians(40.0)
    tangents = np.tan(angle) * np.array([[np.cos(0.3), np.sin(0.3)]])
    exact = captures(np.repeat(dir_of_tangents(tangents), 20_000, axis=0))
    noisy = with_pixel_noise(exact, 2.0, np.random.default_rng(1))
    across = np.cross(exact.view_dir[0], [0.0, 0.0, -1.0])
    across /= np.linalg.norm(across)
    along = np.cross(across, exact.view_dir[0])
    error = (noisy.view_dir - exact.view_dir) / ARCMIN
    radial, other = np.std(error @ along), np.std(error @ across)
    assert radial == pytest.approx(2.0 * np.cos(angle) ** 2, rel=0.02)
    assert other == pytest.approx(2.0 * np.cos(angle), rel=0.02)
    np.testing.assert_allclose(noisy.sigma_arcmin, np.sqrt(radial * other), rtol=0.02)
    assert with_pixel_noise(exact, 0.0, np.random.default_rng(1)) is exact


def test_outliers_are_8_pixels_at_the_share_that_is_asked_for() -> None:
    clean = MethodTrial("birdbath28", "", None, 9, BOX)
    data, wrong = (_data(replace(clean, outliers=share), 3) for share in (0.0, 0.1))
    for eyes in ("planar", "volumetric"):
        (shown, seen), (shown_wrong, seen_wrong) = (getattr(each, eyes).both for each in (data, wrong))
        shift = np.linalg.norm(shown_wrong.pixel - shown.pixel, axis=1)
        turned = arcmin_between(seen_wrong.view_dir, seen.view_dir)
        for size in (shift, turned):
            assert np.mean(size > 1e-6) == pytest.approx(0.1, rel=0.2)
        np.testing.assert_allclose(shift[shift > 1e-6], OUTLIER_PX)
        assert turned.max() <= OUTLIER_PX * (1 + 1e-6)
        assert np.median(turned[turned > 1e-6]) > 0.9 * OUTLIER_PX
