"""Centres of discs whose pictures a known lens bends, from the centres of area of these pictures."""

import numpy as np
import pytest
from captures.boards.board_pictures import BARREL, BOARD, exposed, light_of, pose, truth
from present import present

from wlr_render.captures.boards.board import Board
from wlr_render.captures.boards.board_design import design_board
from wlr_render.captures.boards.circle_grid import CircleGrid
from wlr_render.captures.boards.lattice_shape import Discs, lattice_shape
from wlr_render.geometry.transforms import apply, rigid, rotation_about
from wlr_render.lenses.lens_camera import LensCamera
from wlr_render.numerics.arrays import FloatArray

FEW = design_board(12, 9, 0.036)
BENT = np.array([0.277, 1.284, 7e-4, 0.0, 20.3, 0.715, 1.138, 20.3])
LENSES = {
    "rational": LensCamera((640, 512), np.full(2, 678.0), np.array([325.0, 252.0]), BENT, "rational"),
    "brown": LensCamera((640, 512), np.full(2, 678.0), np.array([325.0, 252.0]), np.array([-0.2, 0.3, 1e-3, 0, 0])),
    "fisheye": LensCamera((640, 512), np.full(2, 400.0), np.array([325.0, 252.0]), np.full(4, -0.02), "fisheye"),
}
RINGS, AROUND = np.sqrt((np.arange(16) + 0.5) / 16), np.linspace(0, 2 * np.pi, 32, endpoint=False)
DISC = (RINGS[:, None, None] * np.stack([np.cos(AROUND), np.sin(AROUND)], axis=-1)).reshape(-1, 2)
"""Points of equal areas of the unit disc."""


def centroids(lens: LensCamera, camera_from_board: FloatArray, point: FloatArray, radius: FloatArray) -> FloatArray:
    """Centres of area (n, 2) of the pictures of discs, by many points of each and the area of their pictures."""

    def seen(place: FloatArray) -> FloatArray:
        return lens.pixel_of_point(apply(camera_from_board, np.concatenate([place, 0 * place[..., :1]], axis=-1)))

    place, step = point[:, None, :2] + radius[:, None, None] * DISC, 1e-4 * radius.min()
    right, down = (seen(place + step * axis) - seen(place - step * axis) for axis in np.eye(2))
    area = np.abs(right[..., 0] * down[..., 1] - right[..., 1] * down[..., 0])
    return np.asarray(np.sum(area[..., None] * seen(place), axis=1) / np.sum(area, axis=1)[:, None])


@pytest.mark.parametrize("tilt_deg", [0.0, 25.0])
@pytest.mark.parametrize("kind", LENSES)
def test_centres_are_those_of_the_discs_where_the_lens_bends_their_pictures(kind: str, tilt_deg: float) -> None:
    lens = LENSES[kind]
    camera_from_board = rigid(rotation_about("y", np.deg2rad(tilt_deg)), np.array([0.01, 0.0, 0.42]))
    index = FEW.indices()
    true = lens.pixel_of_point(apply(camera_from_board, FEW.point_of(index)))
    inside = np.all((true > 20) & (true < np.array(lens.size_px) - 20), axis=1)
    index, true = index[inside], true[inside]
    point, radius = FEW.point_of(index), 0.5 * FEW.diameter_of(index)
    centroid = centroids(lens, camera_from_board, point, radius)
    assert len(index) > 50
    assert np.abs(centroid - true).max() > 0.04
    found = Discs(centroid, radius).centres(lens, point, centroid)
    assert np.abs(found - true).max() < 0.01
    by_neighbours = centroid - lattice_shape(index, centroid).centroid_shift(radius / FEW.pitch_m)
    if kind == "rational":
        assert np.abs(by_neighbours - true).max() > 0.1, "what the finder does without the lens"


@pytest.mark.parametrize(
    "board", [BOARD, CircleGrid(5, 9, 0.012, 0.012, 0.02, staggered=True)], ids=["two sizes", "circles"]
)
def test_what_a_finder_hands_on_gives_the_centres_again(board: Board) -> None:
    camera_from_board = pose(tilt_deg=20.0, distance_m=0.26)
    seen = board.find(exposed(light_of(BARREL, camera_from_board, board)))
    point = board.point_of(seen.index)
    found = present(seen.discs).centres(BARREL, point, seen.pixel)
    true = truth(BARREL, camera_from_board, seen.index, board)
    assert np.abs(found - true).max() < 0.02
    half = seen.only(np.arange(len(seen)) % 2 == 0)
    np.testing.assert_array_equal(present(half.discs).centroid, present(seen.discs).centroid[::2])


def test_a_place_without_a_direction_keeps_its_pixel() -> None:
    lens = LENSES["rational"]
    pixel = np.array([[300.0, 200.0], [360.0, 200.0], [5000.0, 200.0]])
    point = np.array([[0.0, 0.0, 0.0], [0.036, 0.0, 0.0], [0.072, 0.0, 0.0]])
    found = Discs(pixel + 0.1, np.full(3, 0.01)).centres(lens, point, pixel)
    assert np.isfinite(found).all()
    np.testing.assert_array_equal(found[2], pixel[2])
