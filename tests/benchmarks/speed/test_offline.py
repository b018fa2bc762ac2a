"""The measuring, not the measurements: an error that is one."""

from pathlib import Path

import numpy as np
import pytest
from numpy.typing import NDArray
from present import as_number

from benchmarks.speed import offline
from benchmarks.speed.workload import Workload, bench_scene
from wlr_render.gl.context import GlContext
from wlr_render.mappings import Eye
from wlr_render.numerics.arrays import FloatArray
from wlr_render.scene.image_files import write_png
from wlr_render.warp.ray_map import NEAREST_M, RayMap, RayMapPlan, ray_map


def test_the_fast_map_is_exact_to_a_fiftieth_of_a_pixel(small_panel_model: Eye) -> None:
    viewpoint = small_panel_model.eye_box.at(np.array([0.9, 0.9, -0.9]))
    assert 0 < offline.map_error_px(small_panel_model, viewpoint) < 0.02


@pytest.mark.parametrize("component", [0, 3])
def test_the_maps_error_is_that_of_its_worst_pixel(
    small_panel_model: Eye, monkeypatch: pytest.MonkeyPatch, component: int
) -> None:
    """One pixel is moved by a third of a pixel, at infinity by its tangent or at 0.25 m by its offset."""

    def with_a_fault(mappings: Eye, viewpoint: FloatArray, plan: RayMapPlan) -> RayMap:
        field = ray_map(mappings, viewpoint, plan)
        a, b = field.slope_offset[0, 40, 30:32], field.slope_offset[1, 40:42, 30]
        pixel_size = min(abs(np.diff(a)[0]), abs(np.diff(b)[0]))
        field.slope_offset[component, 40, 30] += pixel_size / 3 * (1.0 if component == 0 else NEAREST_M)
        return field

    monkeypatch.setattr(offline, "ray_map", with_a_fault)
    error = offline.map_error_px(small_panel_model, small_panel_model.eye_box.centre)
    assert error == pytest.approx(1 / 3, rel=0.1)


@pytest.mark.gl
def test_frames_are_timed_with_their_files_and_without(
    small_panel_model: Eye, gl_context: GlContext, monkeypatch: pytest.MonkeyPatch
) -> None:
    written = list[str]()

    def spy(path: Path, colour: NDArray[np.uint8]) -> Path:
        written.append(path.name)
        return write_png(path, colour)

    monkeypatch.setattr("wlr_render.jobs.frame_drawing.write_png", spy)
    work = Workload({"right": small_panel_model}, bench_scene(2000), np.zeros((2, 3)))
    ((_, with_files, alone, ratio, _),) = offline.written_rows(work, "auto")
    assert str(with_files).endswith(" frames/s")
    assert str(alone).endswith(" frames/s")
    assert as_number(ratio) > 0
    assert sorted(written) == sorted(["right-000000.png", "right-000001.png"] * (offline._SEQUENCES + 1))
