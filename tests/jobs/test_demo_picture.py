from collections.abc import Sequence
from pathlib import Path

import numpy as np
import pytest

from wlr_render.evaluation.metrics import summary
from wlr_render.jobs.demo_picture import (
    CLOSE_UP_SHARE,
    Panorama,
    busiest_place,
    close_up_camera,
    misalignment_caption,
    overview_camera,
    save_picture,
)
from wlr_render.scene.image_files import read_png

TANGENTS = np.array([[-0.4, -0.1], [0.2, 0.3], [0.0, 0.1]])


def test_the_overview_holds_all_tangents_at_its_width() -> None:
    camera = overview_camera(TANGENTS)
    assert camera.width_px == pytest.approx(720, abs=5)
    pixel = camera.pixel_of_tangents(TANGENTS)
    assert (pixel > 0).all()
    assert (pixel < [camera.width_px, camera.height_px]).all()
    assert camera.focal_px[0] == pytest.approx(camera.focal_px[1])


@pytest.mark.parametrize("centre", [[0.0, 0.1], [-9.0, 9.0], [0.2, -0.1]])
def test_the_close_up_is_a_square_window_within_the_overview(centre: Sequence[float]) -> None:
    overview = overview_camera(TANGENTS)
    window = close_up_camera(overview, np.array(centre))
    side = window.tangent_max - window.tangent_min
    np.testing.assert_allclose(side, CLOSE_UP_SHARE * (overview.tangent_max - overview.tangent_min)[0])
    assert (window.tangent_min >= overview.tangent_min - 1e-12).all()
    assert (window.tangent_max <= overview.tangent_max + 1e-12).all()
    if centre == [0.0, 0.1]:
        np.testing.assert_allclose(0.5 * (window.tangent_min + window.tangent_max), centre)


def test_the_busiest_place_is_where_the_edges_are() -> None:
    camera = overview_camera(TANGENTS)
    picture = np.full((camera.height_px, camera.width_px, 3), 60, np.uint8)
    noise = np.random.default_rng(3).integers(0, 256, (60, 60, 3))
    picture[200:260, 430:490] = noise
    place = camera.pixel_of_tangents(busiest_place(camera, picture))
    # Any window that holds the whole patch, of side 60 px, has all the edges.
    slack = 0.5 * (CLOSE_UP_SHARE * camera.width_px - 60) + 2
    assert np.abs(place - [460, 230]).max() <= slack


def test_the_caption_says_the_figures_in_arcminutes() -> None:
    text = misalignment_caption(summary(np.arange(101) / 10))
    assert text == "off by 5' median\n9.5' at 95 %, 10' at most"


def test_the_picture_shows_every_panorama_with_its_close_up(tmp_path: Path) -> None:
    overview = overview_camera(TANGENTS)
    window = close_up_camera(overview, np.array([0.1, 0.1]))
    colours = [(200, 30, 30), (30, 160, 30), (30, 30, 200)]
    panoramas = [
        Panorama(
            f"way {k}",
            np.full((overview.height_px, overview.width_px, 3), colour, np.uint8),
            np.full((window.height_px, window.width_px, 3), np.array(colour) // 2, np.uint8),
            "off",
        )
        for k, colour in enumerate(colours)
    ]
    path = save_picture(tmp_path / "picture.png", panoramas, (overview, window), "heading")
    picture = read_png(path).astype(int)
    columns = []
    for colour in colours:
        for shade in (np.array(colour), np.array(colour) // 2):
            where = np.argwhere((np.abs(picture - shade) <= 2).all(axis=-1))
            assert len(where) > 20_000
            columns.append(where.mean(axis=0))
    rows, across = np.array(columns).reshape(3, 2, 2).transpose(2, 1, 0)
    assert (rows[0] < rows[1]).all()  # close-ups lie below
    assert (np.diff(across, axis=1) > 100).all()  # in the given order
    np.testing.assert_allclose(across[0], across[1], atol=30)
    # The yellow frame in the first overview stands where the close-up looks.
    yellow, first = (np.argwhere((np.abs(picture - c) <= 2).all(axis=-1)) for c in ((255, 255, 0), colours[0]))
    framed = yellow[yellow[:, 1] <= first[:, 1].max()].mean(axis=0)
    share = (framed - first.min(axis=0)) / np.ptp(first, axis=0)
    centre = overview.pixel_of_tangents(np.array([0.1, 0.1]))[::-1] / [overview.height_px, overview.width_px]
    np.testing.assert_allclose(share, centre, atol=0.01)
    assert [path.name for path in tmp_path.iterdir()] == ["picture.png"]
