"""Renderers that nobody here wrote meet a headset's rays where Embree meets them."""

from dataclasses import replace
from importlib.util import find_spec

import numpy as np
import pytest

from benchmarks.renderers import study
from benchmarks.renderers.casting import LIBRARIES, blender_positions
from benchmarks.renderers.study import differences
from wlr_render.errors import BadInputError
from wlr_render.geometry import transforms
from wlr_render.optics.device_file import load_device
from wlr_render.optics.traced_mappings import traced_eye
from wlr_render.rendering.ray_intersections import SceneTracer
from wlr_render.rendering.ray_map import choose_plan, ray_map
from wlr_render.rendering.scene_file import load_scene

POSE = transforms.rigid(transforms.rotation_about("y", 0.05), np.array([0.01, 0.02, 0.03]))


@pytest.fixture(scope="module")
def rays():
    """Every fourth pixel of a North Star headset, the middle ones without a ray."""
    eye = traced_eye(load_device("northstar"), "right")
    every = ray_map(eye, eye.eye_box.centre + [0.002, 0.001, 0.0], choose_plan(eye))
    slope_offset = every.slope_offset[:, ::4, ::4].copy()
    slope_offset[:, 200, 170:190] = np.nan
    return replace(every, slope_offset=slope_offset, status=every.status[::4, ::4])


@pytest.mark.parametrize("scene", ["sculpture", "desk"])
@pytest.mark.parametrize("library", LIBRARIES, ids=lambda library: library.module)
def test_ray_casters_meet_what_embree_meets_to_a_micrometre(rays, request, library, scene):
    if not library.is_installed:
        pytest.skip(f"{library.package} is not installed: pip install {library.package}.")
    if library.module == "mitsuba":
        request.getfixturevalue("mitsuba")  # skips where it finds no LLVM
    loaded = load_scene(scene)
    finite = np.isfinite(rays.slope_offset).all(axis=0).ravel()
    origin, direction = (each[finite] for each in rays.world_rays(POSE))
    expected = SceneTracer(loaded).intersect(origin, direction).distance
    assert np.isfinite(expected).mean() > 0.3
    found = differences(library.caster(loaded)(origin, direction), expected)
    in_one_only, beyond_a_micrometre = found[0], found[-1]
    assert in_one_only == 0
    assert beyond_a_micrometre < 1e-4 * len(expected)  # these meet an edge


@pytest.mark.parametrize("scene", ["sculpture", "desk"])
def test_blenders_cycles_meets_what_embree_meets(rays, scene):
    if find_spec("bpy") is None:
        pytest.skip("Blender is not installed: pip install bpy, with Python 3.11.")
    position = blender_positions(rays, POSE, scene)
    origin, direction = rays.world_rays(POSE)
    hits = SceneTracer(load_scene(scene)).intersect(origin, direction)
    hit = np.isfinite(hits.distance)
    np.testing.assert_array_equal((position != 0).any(axis=1), hit)
    expected = origin + np.where(hit, hits.distance, 0)[:, None] * direction
    difference = np.linalg.norm(position - expected, axis=1)[hit]
    assert np.median(difference) < 2e-7
    assert np.quantile(difference, 0.99) < 1e-6


class Shifted:
    """A stand-in for a library: Embree, with three rays that are wrong."""

    module, is_installed, name = "shifted", True, "shifted 1.0"

    @staticmethod
    def caster(scene):
        tracer = SceneTracer(scene)

        def cast(origin, direction):
            distance = tracer.intersect(origin, direction).distance.copy()
            hit = np.flatnonzero(np.isfinite(distance))
            distance[hit[:2]] += np.float32(0.001)
            distance[hit[2]] = np.inf
            return distance

        return cast


def test_the_benchmark_counts_and_measures_what_differs(monkeypatch, tmp_path, straight_device, scene_file):
    monkeypatch.setattr(study, "LIBRARIES", (Shifted(),))
    monkeypatch.setattr(study, "find_spec", lambda name: None)
    options = study.RenderersOptions(
        straight_device, scenes=(scene_file,), rounds=1, out=tmp_path / "out", record=tmp_path
    )
    (table,) = study.run(options).blocks
    ((name, in_one_only, median, _, most, beyond, _, _),) = table.rows
    assert (name, in_one_only, median, beyond) == ("shifted 1.0", 1, 0.0, 2)
    assert most == pytest.approx(1000, rel=1e-3)
    assert "shifted 1.0" in (tmp_path / "renderers.md").read_text("utf-8")


def test_the_benchmark_without_any_renderer_is_refused(monkeypatch, tmp_path):
    monkeypatch.setattr(study, "LIBRARIES", ())
    monkeypatch.setattr(study, "find_spec", lambda name: None)
    with pytest.raises(BadInputError, match="None of the renderers is installed"):
        study.run(study.RenderersOptions(out=tmp_path))
