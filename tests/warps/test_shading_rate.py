"""How coarsely the intermediate image may be shaded."""

import numpy as np
import pytest
from numpy.typing import NDArray

from wlr_render.errors import BadInputError
from wlr_render.mappings import Eye
from wlr_render.optics.device_file import load_device
from wlr_render.optics.traced_mappings import traced_eye
from wlr_render.warp.raster_camera import EyePlan
from wlr_render.warp.ray_map import solve_pixels
from wlr_render.warp.warp_mesh import WarpMesh

# Of Vulkan and Direct3D 12: (width, height) of a block by the code of a tile.
BLOCKS = {10: (4, 4), 9: (4, 2), 6: (2, 4), 5: (2, 2), 4: (2, 1), 1: (1, 2), 0: (1, 1)}


def plan_of(eye: Eye, size_px: tuple[int, int], resolution: float, margin: float = 0.0) -> EyePlan:
    return EyePlan.of((eye,), size_px, resolution, late_margin=margin)


@pytest.mark.parametrize(
    ("size_px", "resolution", "code"),
    [
        ((140, 100), 1.3, 0),
        ((140, 100), 3.0, 5),
        ((140, 100), 6.0, 10),
        ((70, 200), 2.2, 4),
        ((280, 50), 2.2, 1),
        ((100, 145), 4.4, 9),
        ((200, 70), 4.4, 6),
    ],
)
def test_a_flat_picture_has_one_rate(
    flat_image_headset: Eye, size_px: tuple[int, int], resolution: float, code: int
) -> None:
    """Its pixels are 1.4 m / width by 1 m / height, at 2 m: the smallest from the eye box's far end."""
    plan = plan_of(flat_image_headset, size_px, resolution)
    box = flat_image_headset.eye_box
    far_m = 2.0 + box.centre[2] + 0.5 * box.size[2]
    across, down = plan.camera.focal_px * [1.4, 1.0] / size_px / far_m
    fits = [each for each, (width, height) in BLOCKS.items() if width <= across and height <= down]
    assert fits[0] == code
    rate = plan.shading_rate((16, 8))
    assert rate.dtype == np.uint8
    assert rate.shape == tuple(-(-side // tile) for side, tile in zip(plan.camera.size_px[::-1], (8, 16), strict=True))
    assert (rate == code).all()


def test_tiles_that_no_ray_meets_are_the_coarsest(flat_image_headset: Eye) -> None:
    """The picture in front of the eye leaves the margin free, unless the head turns into it."""
    narrow, wide = (plan_of(flat_image_headset, (140, 100), 1.3, margin) for margin in (0.0, 0.3))
    assert (wide.shading_rate((8, 8))[:-1, :-1] == 0).all()  # the last tiles may hold the rounded part of a pixel only
    seen = EyePlan(**{**vars(wide), "late_margin": 0.0}).shading_rate((8, 8))
    border = int(0.3 * wide.camera.focal_px[0]) // 8
    assert (seen[:border] == 10).all()
    assert (seen[:, -border:] == 10).all()
    inner = seen[border + 1 : -border - 1, border + 1 : -border - 1]
    assert (inner == 0).all()
    assert abs(np.subtract(inner.shape, narrow.shading_rate((8, 8)).shape)).max() <= 2


def display_px(eye: Eye, plan: EyePlan, rng: np.random.Generator) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Places of random rays in the image (n, 2), and display pixels per image pixel there (n, 2, 2), by differences."""
    pixel = rng.uniform(0.01, 0.99, (400, 2)) * eye.display.panel.size_px
    viewpoint = eye.eye_box.at(rng.uniform(-1, 1, 3))
    step = np.diag(eye.display.panel.size_px / plan.size_px)
    at = np.concatenate([pixel, pixel + step[0], pixel + step[1]])
    slopes = solve_pixels(eye, plan.device_from_camera, at, viewpoint).slope_offset[:, :2].reshape(3, -1, 2)
    place = plan.camera.pixel_of_tangents(slopes.astype(np.float64))
    known = np.isfinite(place).all(axis=(0, 2))
    sides = (place[1:] - place[0])[:, known]
    return place[0, known], np.linalg.inv(np.moveaxis(sides, 0, -1))


@pytest.mark.parametrize(("device", "margin"), [("northstar", 0.02), ("freeform40", 0.0)])
def test_no_block_covers_more_than_a_display_pixel(device: str, margin: float) -> None:
    eye, rng = traced_eye(load_device(device), "right"), np.random.default_rng(3)
    plan = plan_of(eye, (360, 400), 3.0, margin)
    rate = plan.shading_rate((8, 8))
    met, coarse = np.zeros(rate.shape, bool), 0
    for _ in range(10):
        place, of_image = display_px(eye, plan, rng)
        turned = place + rng.uniform(-1, 1, 2) * margin * plan.camera.focal_px
        column, row = np.clip(turned // 8, 0, np.array(rate.shape[::-1]) - 1).astype(int).T
        met[row, column] = True
        block = np.array([BLOCKS[code] for code in rate[row, column].tolist()])
        covers = (np.abs(of_image) @ block[..., None])[..., 0].max(axis=-1)
        assert np.where(block.prod(axis=-1) > 1, covers, 0).max() < 1.02
        coarse += (block.prod(axis=-1) > 1).sum()
    assert not met[rate == 10].any()
    assert (rate == 10).mean() > 0.03
    assert coarse > 100


def test_a_mesh_has_the_rates_of_its_camera(flat_image_headset: Eye) -> None:
    mesh = WarpMesh(flat_image_headset, (140, 100), resolution=3.0, late_margin_deg=0.0)
    assert (mesh.shading_rate() == 5).all()
    for tile in ((16, 0), (16.5, 16), (16,), "16"):
        with pytest.raises(BadInputError, match=r"give \(width, height\) of a tile"):
            mesh.shading_rate(tile)  # type: ignore[arg-type]
