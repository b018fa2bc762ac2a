from dataclasses import replace

import numpy as np
import pytest
from present import present

from benchmarks.simulated_lab.later_places import later_visits, target_at
from wlr_render.geometry import transforms
from wlr_render.optics.device_file import load_device
from wlr_render.simulation.photographs.imperfections import BenchImperfections
from wlr_render.simulation.photographs.photo_bench import Family, PhotoBench, PhotoBenchOptions, design_photo_bench


def bench_of(device: str, family: Family = "polynomial") -> PhotoBench:
    options = PhotoBenchOptions(camera_px=(640, 512), imperfections=BenchImperfections.none(), family=family)
    return design_photo_bench(load_device(device), "right", options)


@pytest.mark.parametrize("device", ["birdbath28", "plane_plate"])
def test_a_target_is_tilted_and_shifted_and_still_seen(device: str) -> None:
    bench = bench_of(device)
    for target, depth in zip(bench.device_from_target, bench.options.target_depths_m, strict=True):
        np.testing.assert_allclose(target_at(bench, depth), target, rtol=0, atol=1e-12)
    frontal, tilted, shifted = target_at(bench, 0.5), target_at(bench, 0.5, 20.0), target_at(bench, 0.5, 0.0, 0.06)
    assert np.array_equal(tilted[:3, 3], frontal[:3, 3])
    assert np.arccos(frontal[:3, 2] @ tilted[:3, 2]) == pytest.approx(np.deg2rad(20.0), abs=0.02)
    assert np.allclose(shifted[:3, :3], frontal[:3, :3], rtol=0, atol=1e-12)
    assert np.linalg.norm(shifted[:3, 3] - frontal[:3, 3]) == pytest.approx(np.hypot(0.06, 0.03))
    point = bench.board.point_of(bench.board.indices())
    for target in (tilted, shifted):
        for lens, camera in (
            (bench.eyeball.camera, bench.camera_at(np.zeros(3))),
            (bench.tracking.camera, bench.device_from_tracking),
        ):
            pixel = lens.pixel_of_point(transforms.apply(transforms.inverse(camera) @ target, point))
            assert np.all((pixel > 0) & (pixel < np.array(lens.size_px)), axis=-1).sum() >= 20


def test_later_visits_are_those_of_a_warm_camera() -> None:
    at, bench = np.array([[0.001, 0.0, 0.0], [-0.002, 0.001, 0.0]]), bench_of("plane_plate", "workshop")
    drifting = replace(bench, workshop=present(bench.workshop).only("drift"))
    warm, cold = (later_visits(each, at, np.random.default_rng(1)) for each in (drifting, bench_of("plane_plate")))
    turn = [
        one.device_from_camera[:3, :3] @ two.device_from_camera[:3, :3].T for one, two in zip(warm, cold, strict=True)
    ]
    np.testing.assert_allclose(turn[0], turn[1], atol=1e-12)
    assert np.abs(turn[0] - np.eye(3)).max() > 1e-6
