"""What budgets of the small fitted headset share."""

import numpy as np
import pytest
from memo import memoised, shared_folder

from wlr_render.mappings import Eye
from wlr_render.warp.choose_grid import choose_warp_grid


@pytest.fixture
def known_warp_grid(
    tmp_path_factory: pytest.TempPathFactory, small_panel_model: Eye, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The warp grid of that headset is chosen once: the covariance of its models, which tests change, is not in it."""
    chosen = memoised(choose_warp_grid, shared_folder(tmp_path_factory))(small_panel_model, np.eye(3))
    monkeypatch.setattr("wlr_render.jobs.budget.choose_warp_grid", lambda *_: chosen)


@pytest.fixture(autouse=True)
def choices_of_this_room(choices_made_once: None) -> None:
    """Every job in this process starts with the choices that were made for its headset."""
