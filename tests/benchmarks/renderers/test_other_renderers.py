"""Renderers that nobody here wrote meet a headset's rays where they meet the triangles in 64 bits.

Bounds hold for every ray. Distances of 32 bits have the rounding of coordinates, which grazing rays multiply. Only a
ray that passes an edge within 1 um may see either side of it.
"""

from collections.abc import Callable
from dataclasses import replace
from importlib.util import find_spec
from pathlib import Path

import numpy as np
import pytest
from present import as_number, narrowed

from benchmarks.renderers import study
from benchmarks.renderers.casting import LIBRARIES, Library, blender_positions, right_distances
from benchmarks.renderers.study import along_ray, differences
from wlr_render.draw.ray_intersections import SceneTracer
from wlr_render.geometry import transforms
from wlr_render.numerics.arrays import Float32Array
from wlr_render.optics.device_file import load_device
from wlr_render.optics.traced_mappings import traced_eye
from wlr_render.report.blocks import ReportTable
from wlr_render.scene.scene import Scene
from wlr_render.scene.scene_file import load_scene
from wlr_render.warp.ray_map import RayMap, choose_plan, ray_map

POSE = transforms.rigid(transforms.rotation_about("y", 0.05), np.array([0.01, 0.02, 0.03]))


@pytest.fixture(scope="module")
def rays() -> RayMap:
    """Every fourth pixel of a North Star headset, the middle ones without a ray."""
    eye = traced_eye(load_device("northstar"), "right")
    every = ray_map(eye, eye.eye_box.centre + [0.002, 0.001, 0.0], choose_plan(eye))
    slope_offset = every.slope_offset[:, ::4, ::4].copy()
    slope_offset[:, 200, 170:190] = np.nan
    return replace(every, slope_offset=slope_offset, status=every.status[::4, ::4])


MOST_UM = {"warp": 0.25}
"""Largest difference of distance in um; 10 where a library's own distance of 32 bits is taken."""


@pytest.mark.slow
@pytest.mark.parametrize("scene", ["sculpture", "desk"])
@pytest.mark.parametrize("library", LIBRARIES, ids=lambda library: library.module)
def test_ray_casters_meet_the_same_surfaces_to_ten_micrometres_and_warp_to_rounding(
    rays: RayMap, request: pytest.FixtureRequest, library: Library, scene: str
) -> None:
    if not library.is_installed:
        pytest.skip(f"{library.package} is not installed: pip install {library.package}.")
    if library.module == "mitsuba":
        request.getfixturevalue("mitsuba")  # skips where it finds no LLVM
    loaded = load_scene(scene)
    finite = np.isfinite(rays.slope_offset).all(axis=0).ravel()
    origin, direction = (each[finite] for each in rays.world_rays(POSE))
    expected = right_distances(loaded, origin, direction)
    assert np.isfinite(expected[0]).mean() > 0.3
    beside_an_edge = ~(expected == expected[0]).all(axis=0)
    assert beside_an_edge.mean() < 2e-3
    found = differences(library.caster(loaded)(origin, direction), expected)
    other_side, in_one_only, median, _, most, _ = map(as_number, found)
    assert other_side <= 1
    assert in_one_only == 0
    assert median < 0.1
    assert most < MOST_UM.get(library.module, 10.0)


@pytest.mark.parametrize("scene", ["sculpture", "desk"])
def test_blenders_cycles_meets_the_same_surfaces(rays: RayMap, scene: str) -> None:
    if find_spec("bpy") is None:
        pytest.skip("Blender is not installed; docs/renderers.md has the command, for Python 3.11.")
    position = blender_positions(rays, POSE, scene)
    origin, direction = rays.world_rays(POSE)
    expected = right_distances(load_scene(scene), origin, direction)
    distance = along_ray(position, origin, direction)
    other_side, in_one_only, median, _, most, _ = map(as_number, differences(distance, expected))
    assert other_side <= 3
    assert in_one_only == 0
    assert median < 0.2
    assert most < 100.0


def test_differences_take_either_side_of_an_edge_and_count_what_neither_explains() -> None:
    expected = np.array([[2, 2, 2, 2, np.inf, 2], [2, 3, 3, 2, 2, 2]], float)
    distance = np.array([2 + 3e-6, 3, 2.5, np.inf, 2, 2], np.float32)
    other_side, in_one_only, median, _, most, beyond = differences(distance, expected)
    assert (other_side, in_one_only, beyond) == (2, 1, 2)
    assert median == 0.0
    assert most == pytest.approx(0.5e6)


class Shifted:
    """A stand-in for a library: Embree, with three rays that are wrong."""

    module, is_installed, name = "shifted", True, "shifted 1.0"

    @staticmethod
    def caster(scene: Scene) -> Callable[[Float32Array, Float32Array], Float32Array]:
        tracer = SceneTracer(scene)

        def cast(origin: Float32Array, direction: Float32Array) -> Float32Array:
            distance = tracer.intersect(origin, direction).distance.copy()
            hit = np.flatnonzero(np.isfinite(distance))
            distance[hit[:2]] += np.float32(0.001)
            distance[hit[2]] = np.inf
            return distance

        return cast


def test_the_benchmark_counts_and_measures_what_differs(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path, straight_device: str, scene_file: str
) -> None:
    monkeypatch.setattr(study, "LIBRARIES", (Shifted(),))
    monkeypatch.setattr(study, "find_spec", lambda name: None)
    options = study.RenderersOptions(
        straight_device, scenes=(scene_file,), rounds=1, out=tmp_path / "out", record=tmp_path
    )
    (table,) = study.run(options).blocks
    embree, (name, other_side, in_one_only, median, _, most, beyond, _, _) = narrowed(table, ReportTable).rows
    assert embree[:3] == ["Embree", 0, 0]
    assert (name, other_side, in_one_only, beyond) == ("shifted 1.0", 0, 1, 2)
    assert as_number(median) < 0.1
    assert most == pytest.approx(1000, rel=1e-3)
    assert "shifted 1.0" in (tmp_path / "renderers.md").read_text("utf-8")
