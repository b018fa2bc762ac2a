from pathlib import Path

import numpy as np
import pytest
from present import as_number

from benchmarks.exports import study
from wlr_render.exports.export_view import ExportedView
from wlr_render.jobs.export import views_from_centres
from wlr_render.jobs.export_options import ExportOptions


@pytest.fixture(scope="module")
def view(small_northstar: str) -> ExportedView:
    return views_from_centres(ExportOptions(small_northstar, format="stmap"))["right"]


@pytest.mark.slow
def test_each_reader_that_is_installed_has_a_row_within_the_figures_wanted(view: ExportedView, tmp_path: Path) -> None:
    rows = {row[0]: row[1:] for row in study._rows(view, tmp_path)}
    wanted = {"OpenImageIO st_warp": 0.01, "OpenCV remap": 0.01, "ffmpeg remap": 0.0, "mrcal project": 0.005}
    assert "OpenCV remap" in rows
    for reader, largest in wanted.items():
        if reader in rows:
            assert as_number(rows[reader][-1]) <= largest


def test_no_camera_of_opencv_is_the_panel(view: ExportedView) -> None:
    """With a turned camera: a fixed one misses by a hundred times as much."""
    errors = {terms: np.sqrt(np.mean(study._opencv_errors(view, flags) ** 2)) for terms, flags in study._TERMS.items()}
    assert errors[5] > errors[8] > errors[12] > 0.05
    assert errors[5] < 0.02 * view.panel_size_px[0]
