"""Traces of a lens at several eye reliefs, drawn here in closed form, read as captures of a display."""

from collections.abc import Sequence
from pathlib import Path

import numpy as np
import pytest

from benchmarks.published_data.osvr_hdk13 import (
    PANEL,
    PIXEL_MM,
    LensTable,
    read_osvr_captures,
    read_osvr_hdk13,
)
from wlr_render.numerics.arrays import FloatArray


def lens_file(path: Path, scale: float, field: Sequence[float] | FloatArray = (-4.0, 0.0, 4.0)) -> LensTable:
    rows = [(x, y, scale * x, scale * y) for x in field for y in field]
    path.write_text("\n".join("\t".join(f"{v:.2E}" for v in row) for row in rows) + "\nRay Error at 9 9\n")
    return read_osvr_hdk13(path)


FIELD = np.arange(-20.0, 21.0, 4.0)


@pytest.fixture
def lens_folder(tmp_path: Path) -> Path:
    """A lens whose scale grows with the eye relief, and a table that is not numbered."""
    for relief, scale in ((9, 0.70), (11, 0.71), (14, 0.72)):
        lens_file(tmp_path / f"{relief}_mm_Eye_Relief_trimmed.txt", scale, FIELD)
    lens_file(tmp_path / "Nominal_trimmed.txt", 0.705, FIELD)
    return tmp_path


def test_tables_become_captures_from_their_eye_reliefs(lens_folder: Path) -> None:
    found = read_osvr_captures(lens_folder)
    assert len(found) == 3 * len(FIELD) ** 2
    np.testing.assert_allclose(1e3 * found.viewpoint[::121], [[0, 0, -2.5], [0, 0, -0.5], [0, 0, 2.5]], atol=1e-12)
    tangent = -found.view_dir[:, :2] / found.view_dir[:, 2:]
    field = np.degrees(np.arctan(tangent))
    scale = np.array([0.70, 0.71, 0.72])[found.capture][:, None]
    # Up is up on the screen, and down in its pixels.
    off = found.pixel - (0.5 * PANEL.size_px + scale * field * [1, -1] / PIXEL_MM)
    assert np.abs(off).max() < 0.1 / PIXEL_MM
    # Angles and millimetres are printed to 0.01 below 10, to 0.1 from there.
    edge = np.abs(field).min(axis=1) > 15
    assert found.sigma_arcmin[edge] == pytest.approx(60 * 0.1 / np.sqrt(12) * np.hypot(1, 1 / 0.71), rel=0.02)
    assert found.sigma_arcmin.min() == pytest.approx(60 * 0.01 / np.sqrt(12) * np.hypot(1, 1 / 0.71), rel=0.02)
