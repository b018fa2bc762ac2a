from pathlib import Path

import numpy as np
import pytest
from numpy.typing import NDArray

from benchmarks.monado.comparison import EYE_CODES, position_errors
from benchmarks.monado.study import MonadoOptions, run
from wlr_render.errors import BadInputError
from wlr_render.exports.export_view import ExportedView
from wlr_render.jobs.export import views_from_centres
from wlr_render.jobs.export_options import ExportOptions

FOV = np.array([-0.9, 0.8, 1.1, -1.0])  # left, right, up, down


@pytest.fixture(scope="module")
def view(small_northstar: str) -> ExportedView:
    return views_from_centres(ExportOptions(small_northstar, format="stmap", source_axes="device"))["right"]


def window_of(view: ExportedView) -> NDArray[np.uint8]:
    """What an exact compositor shows in a window of half the panel's size, in whole codes."""
    width, height = (size // 2 for size in view.panel_size_px)
    u, v = np.meshgrid(2 * (np.arange(width) + 0.5), 2 * (np.arange(height) + 0.5))
    tangents = view.tangents(np.moveaxis(view.rays_at("all", np.stack([u, v], axis=-1)), -1, 0))
    left, right, up, down = np.tan(FOV)
    window = np.full((height, width, 3), EYE_CODES[view.eye], np.uint8)
    window[..., 0] = np.rint(255 * (tangents[..., 0] - left) / (right - left))
    window[..., 1] = np.rint(255 * (up - tangents[..., 1]) / (up - down))
    return window


def on_screen(window: NDArray[np.uint8]) -> NDArray[np.uint8]:
    screen = np.zeros((400, 500, 3), np.uint8)
    screen[: window.shape[0], 30 : 30 + window.shape[1]] = window
    return screen


def test_an_exact_window_differs_by_rounding_alone(view: ExportedView) -> None:
    for errors in position_errors(on_screen(window_of(view)), FOV, view):
        assert errors.window_px == (90, 100)
        assert errors.rms == pytest.approx(0.29, abs=0.02)
        assert errors.largest <= 0.5
        assert errors.largest_block_mean < 0.05
        assert errors.reversed_rms > 5


def test_a_shifted_window_is_wrong(view: ExportedView) -> None:
    across, down = position_errors(on_screen(np.roll(window_of(view), 3, axis=1)[:, 3:]), FOV, view)
    assert across.rms > 1
    assert down.rms < across.rms


def test_without_root_the_benchmark_names_what_it_needs(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    monkeypatch.setattr("os.geteuid", lambda: 1000)
    with pytest.raises(BadInputError, match="apt-get install debootstrap"):
        run(MonadoOptions(tmp_path / "debian"))
    assert not list(tmp_path.iterdir())
