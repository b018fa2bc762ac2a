"""Errors of a workshop that captures alone show."""

from typing import Any

import numpy as np
from numpy.typing import NDArray

from benchmarks.accuracy.lab_errors import OF_NOISE, LabWorkshop
from wlr_render.simulation.workshop import rms

WORKSHOP = LabWorkshop(3)
PICTURE = np.stack(np.meshgrid(np.linspace(-0.8, 0.8, 23), np.linspace(-0.6, 0.6, 19)), axis=-1).reshape(-1, 2)


def test_bumped_visits_are_one_or_two_of_the_stated_size() -> None:
    for seed in range(20):
        size = 1e6 * np.linalg.norm(LabWorkshop(seed, bump_um=(300.0, 300.0)).bumps(25), axis=1)
        np.testing.assert_allclose(size[size > 0], 300.0)
        assert 1 <= np.count_nonzero(size) <= 2


def noise_of(name: tuple[str, ...], count: int = 200) -> NDArray[Any]:
    rng = np.random.default_rng(1)
    return np.stack([WORKSHOP.only(*name).noise(PICTURE, rng) for _ in range(count)])


def test_noise_has_its_rms_and_each_shape() -> None:
    radius = np.linalg.norm(PICTURE, axis=1)
    white, tails, rim, shared, gross = (noise_of(name) for name in ((), *[(each,) for each in OF_NOISE]))
    for noise in (white, tails, rim, shared):
        np.testing.assert_allclose(rms(noise), 1.0, rtol=0.05)
    assert np.mean(tails**4) / np.mean(tails**2) ** 2 > 4.0
    assert rms(rim[:, radius > 0.9]) > 1.5 * rms(rim[:, radius < 0.3])
    grid = shared[..., 0].reshape(-1, 19, 23)
    near = [np.mean(grid[:, :, lag:] * grid[:, :, : 23 - lag]) for lag in (1, 3, 6)]
    assert near[0] > 0.3
    assert 0.01 < near[1] < 0.2
    assert abs(near[2]) < 0.03
    wild = np.linalg.norm(gross, axis=-1) > 5.0
    assert 0.005 < wild.mean() < 0.015
    assert radius[np.nonzero(wild)[1]].mean() > 0.75


def test_a_switch_moves_its_error_alone() -> None:
    def parts(workshop: LabWorkshop) -> tuple[NDArray[Any], NDArray[Any]]:
        rng = np.random.default_rng(5)
        return workshop.bumps(30), np.stack([workshop.noise(PICTURE, rng) for _ in range(3)])

    bumps, noise = parts(WORKSHOP.only())
    for name in ("bumped", *OF_NOISE):
        moved = [np.any(one != other) for one, other in zip(parts(WORKSHOP.only(name)), (bumps, noise), strict=True)]
        assert moved == ([True, False] if name == "bumped" else [False, True])
