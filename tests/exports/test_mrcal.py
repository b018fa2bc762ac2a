import ast
import math
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any, Literal

import numpy as np
import pytest
from scipy.interpolate import NdBSpline
from scipy.spatial.transform import Rotation

from benchmarks.exports.readers import has_mrcal, points_of_pixels, projected_by_mrcal
from wlr_render.errors import BadInputError
from wlr_render.exports.export_view import ExportedView
from wlr_render.exports.mrcal import Mrcal
from wlr_render.jobs.export import views_from_centres
from wlr_render.jobs.export_options import ExportOptions
from wlr_render.numerics.arrays import FloatArray
from wlr_render.warp.raster_camera import RasterPlace


def written(view: "Damaged | ExportedView", folder: Path) -> Path:
    (path,) = Mrcal().write([view], folder)
    return path


def rms(difference: FloatArray) -> float:
    return float(np.sqrt(np.mean(np.sum(difference**2, axis=-1))))


@pytest.mark.slow
@pytest.mark.parametrize(
    ("device", "axes", "camera", "depth_m"),
    [("freeform40", "device", "viewpoint", None), ("birdbath28", "field", "nearest", 0.5)],
)
def test_mrcal_projects_points_to_the_pixels_that_show_them(
    device: str, axes: Literal["field", "device"], camera: RasterPlace, depth_m: float | None, tmp_path: Path
) -> None:
    if not has_mrcal():
        pytest.skip("mrcal is not installed: apt-get install python3-mrcal")
    options = ExportOptions(device, format="mrcal", source_axes=axes, source_camera=camera, depth_m=depth_m)
    view = views_from_centres(options)["right"]
    pixel, points = points_of_pixels(view, depth_m or 1e6)
    found, size = projected_by_mrcal(written(view, tmp_path), points, tmp_path)
    assert size == list(view.panel_size_px)
    assert rms(found - pixel) <= 0.002
    assert np.abs(found - pixel).max() <= 0.005


def projected(path: Path, points: FloatArray) -> FloatArray:
    """Pixels by the published formula of the lens model, with SciPy's splines."""
    model = ast.literal_eval(path.read_text())
    words = dict(word.split("=") for word in model["lensmodel"].split("_") if "=" in word)
    columns, rows, field_deg = (int(words[name]) for name in ("Nx", "Ny", "deg"))
    focal, centre = np.split(np.array(model["intrinsics"][:4]), 2)
    control = np.reshape(model["intrinsics"][4:], (rows, columns, 2))
    pose = np.array(model["extrinsics"])
    x, y, z = (Rotation.from_rotvec(pose[:3]).apply(points) + pose[3:]).T
    u = np.stack([x, y], axis=-1) * (2 / (np.sqrt(x**2 + y**2 + z**2) + z))[:, None]
    step = 2 * 2 * math.tan(math.radians(field_deg) / 4) / (columns - 3)
    knots = tuple((np.arange(n + 4) - 2 - (n - 1) / 2) * step for n in (rows, columns))
    return np.asarray((u + NdBSpline(knots, control, 3)(u[:, ::-1])) * focal + centre)


def test_the_published_formula_gives_the_same_pixels(view: ExportedView, tmp_path: Path) -> None:
    pixel, points = points_of_pixels(view, 1e6)
    assert rms(projected(written(view, tmp_path), points) - pixel) <= 0.002


def test_a_model_is_for_its_depth(view: ExportedView, tmp_path: Path) -> None:
    near = replace(view, depth_m=0.25)
    pixel, points = points_of_pixels(near, 0.25)
    path = written(near, tmp_path)
    assert rms(projected(path, points) - pixel) <= 0.002
    pixel, points = points_of_pixels(near, 1e6)
    assert rms(projected(path, points) - pixel) > 0.05
    assert "# depth_m: 0.25\n" in path.read_text()


def test_comments_state_the_error_and_the_loss(view: ExportedView, tmp_path: Path) -> None:
    comments = [line for line in written(view, tmp_path).read_text().splitlines() if line.startswith("# ")]
    assert "holds for this pupil and for points at this depth only" in comments[0]
    assert "px rms" in comments[1]
    assert any(line.startswith("# loses: ") and "pupil displaced by 2 mm" in line for line in comments)
    assert "# eye: right" in comments


class Damaged(ExportedView):
    """A view whose rays are changed by `damage`."""

    damage: Callable[..., Any]

    def rays_at(self, colour: str, pixel: FloatArray, viewpoint: FloatArray | None = None) -> FloatArray:
        return np.asarray(self.damage(super().rays_at(colour, pixel, viewpoint), pixel))


def damaged(view: ExportedView, damage: Callable[..., Any]) -> Damaged:
    changed = Damaged(**{name: getattr(view, name) for name in ExportedView.__dataclass_fields__})
    object.__setattr__(changed, "damage", damage)
    return changed


def test_a_field_that_folds_is_refused(view: ExportedView, tmp_path: Path) -> None:
    with pytest.raises(BadInputError, match="not a continuous function of the direction; choose another format"):
        written(damaged(view, lambda rays, pixel: np.abs(rays)), tmp_path)
    assert not list(tmp_path.iterdir())


def test_pixels_without_a_ray_are_left_out_of_the_fit(view: ExportedView, tmp_path: Path) -> None:
    def without_a_corner(rays: FloatArray, pixel: FloatArray) -> FloatArray:
        return np.where(pixel.sum(axis=-1, keepdims=True) < 60, np.nan, rays)

    holed = damaged(view, without_a_corner)
    pixel, points = points_of_pixels(holed, 1e6)
    assert len(pixel) < len(points_of_pixels(view, 1e6)[0])
    assert rms(projected(written(holed, tmp_path), points) - pixel) <= 0.002


def test_too_few_rays_are_refused(view: ExportedView, tmp_path: Path) -> None:
    with pytest.raises(BadInputError, match=r"fewer than 100 of the sampled pixels of .* have a ray for right; check"):
        written(
            damaged(view, lambda rays, pixel: np.where(pixel.sum(axis=-1, keepdims=True) < 20, rays, np.nan)), tmp_path
        )
