"""Held-out errors and their intervals, tables along a line, and the benchmark on the published sets."""

import json
from collections.abc import Callable
from pathlib import Path
from typing import Any, NoReturn

import numpy as np
import pytest
from present import as_number, narrowed

from benchmarks.__main__ import main
from benchmarks.rivals import alignments, reliefs
from benchmarks.rivals.displays import DISPLAYS, line_table
from benchmarks.rivals.held_out import HeldOut, cells, held_out, remark, rms_of
from benchmarks.rivals.samples import fit_structure
from wlr_render.calibration.fit_display import DISPLAY
from wlr_render.captures.correspondences import DisplayCaptures
from wlr_render.errors import BadInputError
from wlr_render.geometry.directions import dir_of_tangents
from wlr_render.mappings import EyeBox, Panel
from wlr_render.numerics.arrays import FloatArray

PANEL = Panel(400, 300)


def test_intervals_hold_the_scatter_of_whole_captures() -> None:
    rng = np.random.default_rng(2)
    group = np.repeat(np.arange(12), 50)
    # Each capture is off by its own amount: rows of one capture are no independent draws.
    offset = rng.normal(0, 1, 12)[group]
    found = HeldOut("one", np.abs(offset + rng.normal(0, 0.1, 600)), group)
    half = HeldOut("other", 0.5 * found.error, group)
    rms, interval, _, own, _ = cells(found, found)
    rms = as_number(rms)
    low, high = (float(word) for word in narrowed(interval, str).split(" to "))
    assert rms == pytest.approx(rms_of(found))
    assert own is None
    assert low < 0.8 * rms < 1.2 * rms < high  # a bootstrap over rows has a tenth of this width
    over, over_interval = cells(half, found)[3:]
    assert over == pytest.approx(0.5)
    assert over_interval == "0.5 to 0.5"  # drawn together: what captures share cancels


def test_a_method_that_refuses_or_lacks_answers_says_so() -> None:
    group = np.repeat([0, 1], 5)

    def refuse(each: object) -> NoReturn:
        raise BadInputError("two positions are too few.")

    reference = HeldOut("reference", np.ones(10), group)
    refused = held_out("a", group, refuse)
    assert cells(refused, reference)[:2] == [None, "refused: two positions are too few."]
    silent = held_out("b", group, lambda each: np.where(np.arange(5) < each, np.nan, 1.0))
    assert remark(silent) == "no answer for 10 % of the readings"
    assert rms_of(silent) == np.inf


def swimming(positions: FloatArray, curved: float = 0.0) -> DisplayCaptures:
    """A display whose directions change linearly along a line of viewpoints, or are curved there."""
    pixel = np.tile(PANEL.grid(12, 10).reshape(-1, 2), (len(positions), 1))
    viewpoint = np.repeat(positions, 120, axis=0)
    unit = pixel / [200, 150] - 1
    depth = viewpoint[:, 2:] * 20
    tangents = 0.4 * unit * (1 + 0.1 * depth + curved * depth**2) * [1, -1]
    box = EyeBox(np.zeros(3), np.full(3, 0.01))
    capture = np.repeat(np.arange(len(positions)), 120)
    return DisplayCaptures(
        device="toy",
        eye="left",
        eye_box=box,
        panel=PANEL,
        viewpoint=viewpoint,
        view_dir=dir_of_tangents(tangents),
        pixel=pixel,
        capture=capture,
        sigma_arcmin=np.array(0.0),
    )


def test_a_table_along_a_line_is_linear_also_beyond_its_ends() -> None:
    direction = np.array([0.1, 0.2, 1.0])
    place = np.array([-0.004, 0.0, 0.003])[:, None] * direction
    model, _ = fit_structure(DISPLAY, swimming(place), "volumetric", line_table)
    tested = swimming(np.array([-0.006, -0.001, 0.002, 0.005])[:, None] * direction)
    found = model.view_dir_of_pixel(tested.pixel, tested.viewpoint).value
    np.testing.assert_allclose(found, tested.view_dir, atol=1e-6)
    bent = swimming(np.array([[-0.006, -0.0012, -0.06]]) * 0.1, curved=3.0)
    model, _ = fit_structure(DISPLAY, swimming(place, curved=3.0), "volumetric", line_table)
    missed = model.view_dir_of_pixel(bent.pixel, bent.viewpoint).value - bent.view_dir
    assert np.abs(missed).max() > 1e-4


def tables(folder: Path, name: str, tmp_path: Path) -> list[dict[str, Any]]:
    assert main(["rivals", "--measured", str(folder.parent), "--sets", name, "--out", str(tmp_path)]) == 0
    found: list[dict[str, Any]] = json.loads((tmp_path / "rivals.json").read_text())["tables"]
    return found


def test_a_plane_fitted_to_other_sittings_beats_an_old_calibration(
    measured_data: Callable[[str], Path], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(alignments, "DISPLAYS", {"plane (DRC)": DISPLAYS["plane (DRC)"]})
    errors, noise = tables(measured_data("itoh_hmd_calibration"), "alignments", tmp_path)
    rms = {row["method"]: row["rms (arcmin)"] for row in errors["rows"]}
    scatter = noise["rows"][-1]["scatter (arcmin)"]
    assert scatter < rms["plane (DRC), fitted to the other sittings"] < 0.6 * rms["SPAAM of another sitting"]


def test_a_point_for_each_pixel_carries_over_to_another_eye_relief(
    measured_data: Callable[[str], Path], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    names = ("plane (DRC)", "ours: point-per-pixel")
    monkeypatch.setattr(reliefs, "DISPLAYS", {name: DISPLAYS[name] for name in names})
    (table,) = tables(measured_data("osvr_hdk13"), "reliefs", tmp_path)
    plane, point = table["rows"]
    for relief in ("0 mm", "2 mm", "5 mm"):
        assert point[f"{relief} left out (arcmin)"] < 0.2 * plane[f"{relief} left out (arcmin)"]
