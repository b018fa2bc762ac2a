"""Circle grids of another size than stated, with a circle hidden, and turned."""

from dataclasses import replace

import cv2
import numpy as np
import pytest
from captures.boards.board_pictures import CAMERA, exposed, light_of, pose, truth

from wlr_render.captures.boards.board import BoardNotFoundError
from wlr_render.captures.boards.circle_grid import CircleGrid
from wlr_render.numerics.arrays import FloatArray

GRIDS = {
    "rows": CircleGrid(9, 7, 0.016, 0.009, 0.016),
    "staggered": CircleGrid(4, 11, 0.012, 0.01, 0.016, staggered=True),
    "staggered, even rows": CircleGrid(5, 8, 0.014, 0.011, 0.016, staggered=True),
}


def light(grid: CircleGrid, turn_deg: float = 15.0) -> FloatArray:
    return np.asarray(
        cv2.GaussianBlur(light_of(CAMERA, pose(turn_deg, tilt_deg=15, distance_m=0.28), grid, rays=2), (0, 0), 0.7)
    )


@pytest.mark.parametrize("turn_deg", [0, 95, 185, 280])
@pytest.mark.parametrize("name", GRIDS)
def test_circles_are_numbered_whichever_way_the_grid_is_turned(name: str, turn_deg: int) -> None:
    grid = GRIDS[name]
    found = grid.find(exposed(light(grid, turn_deg), snr=40))
    assert len(found) == len(grid.indices())
    there = pose(turn_deg, tilt_deg=15, distance_m=0.28)
    numbered = (found, found.half_turned(grid)) if found.ambiguous_half_turn else (found,)
    assert found.ambiguous_half_turn == (name != "staggered")
    assert min(np.abs(each.pixel - truth(CAMERA, there, each.index, grid)).max() for each in numbered) < 0.2


@pytest.mark.parametrize(
    ("seen", "stated"),
    [
        ("rows", CircleGrid(8, 7, 0.016, 0.009, 0.016)),
        ("rows", CircleGrid(9, 5, 0.016, 0.009, 0.016)),
        ("staggered", CircleGrid(4, 9, 0.012, 0.01, 0.016, staggered=True)),
    ],
)
def test_part_of_a_larger_grid_is_not_taken_for_a_whole_one(seen: str, stated: CircleGrid) -> None:
    with pytest.raises(BoardNotFoundError, match=r"^a\.png: the grid seen has more circles than board\.toml says"):
        stated.find(exposed(light(GRIDS[seen]), snr=40), "a.png")


def test_a_hidden_circle_is_a_grid_not_found() -> None:
    grid = GRIDS["rows"]
    x, y = truth(CAMERA, pose(15.0, tilt_deg=15, distance_m=0.28), np.array([[4, 3]]), grid)[0]
    image = light(grid)
    cv2.circle(image, (int(x), int(y)), 12, 1.0, -1)
    with pytest.raises(BoardNotFoundError, match=r"^a\.png: no circle grid 9 x 7, .* 62 of them on one lattice"):
        grid.find(exposed(image, snr=40), "a.png")


def test_a_radius_stated_as_the_diameter_is_named() -> None:
    grid = GRIDS["rows"]
    wrong = replace(grid, diameter_m=0.5 * grid.diameter_m)
    with pytest.raises(
        BoardNotFoundError, match=r"diameters of 8\.\d to 9\.?\d? mm, where board\.toml has 4\.5; correct"
    ):
        wrong.find(exposed(light(grid), snr=40), "a.png")
