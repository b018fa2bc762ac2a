from collections.abc import Mapping
from typing import Any

import numpy as np
import pytest
from numpy import unsignedinteger
from numpy.typing import NDArray

from wlr_render.errors import BadInputError
from wlr_render.simulation.photographs.camera import Sensor

NOISELESS = {"full_well_e": 1e18, "read_noise_e": 0.0}


def rng() -> np.random.Generator:
    return np.random.default_rng(7)


def flat(light: float, shape: tuple[int, int] = (200, 300)) -> NDArray[Any]:
    return np.full(shape, light, np.float32)


@pytest.mark.parametrize(("bits", "kind"), [(8, np.uint8), (10, np.uint16), (12, np.uint16), (16, np.uint16)])
def test_light_is_counted_in_steps_of_the_bits(bits: int, kind: type[unsignedinteger]) -> None:
    ramp = np.linspace(0, 1, 500)[None]
    grey = Sensor(bits, **NOISELESS).expose(ramp, rng())
    assert grey.dtype == kind
    # Half a step, and what a full well of 1e18 electrons still makes noise.
    assert np.abs(grey - ramp * (2**bits - 1)).max() < 0.5 + 1e-3


def test_more_than_full_scale_saturates() -> None:
    grey = Sensor(8, exposure=2.0, **NOISELESS).expose(np.array([[0.2, 0.5, 0.8, 50.0]]), rng())
    np.testing.assert_array_equal(grey, [[102, 255, 255, 255]])


@pytest.mark.parametrize("light", [0.05, 0.3, 0.8])
def test_the_variance_is_that_of_the_electrons(light: float) -> None:
    sensor = Sensor(16, exposure=0.9, full_well_e=5000.0, read_noise_e=20.0)
    electrons = sensor.expose(flat(light), rng()) / 65535 * 5000
    assert electrons.mean() == pytest.approx(0.9 * light * 5000, abs=1.0)
    assert electrons.var() == pytest.approx(0.9 * light * 5000 + 20.0**2, rel=0.02)


@pytest.mark.parametrize(("snr", "read_noise_e"), [(5.0, 5.0), (20.0, 0.0), (20.0, 50.0), (100.0, 5.0)])
def test_light_one_has_the_ratio_that_was_asked_for(snr: float, read_noise_e: float) -> None:
    grey = Sensor.with_snr(snr, bits=16, exposure=0.4, read_noise_e=read_noise_e).expose(flat(1.0), rng())
    assert grey.mean() / grey.std() == pytest.approx(snr, rel=0.02)


def test_corners_lose_the_part_that_vignetting_says() -> None:
    grey = Sensor(16, vignetting=0.4, **NOISELESS).expose(flat(1.0, (301, 401)), rng()) / 65535
    assert grey[150, 200] == pytest.approx(1.0, abs=1e-4)
    assert grey[[0, 0, -1, -1], [0, -1, 0, -1]] == pytest.approx(0.6, abs=4e-3)
    # 0.4 x (200.5 / half diagonal)^2 at the middle of the left edge.
    assert grey[150, 0] == pytest.approx(1 - 0.4 * 200**2 / (150.5**2 + 200.5**2), abs=1e-4)


def test_gamma_bends_the_signal() -> None:
    grey = Sensor(16, gamma=2.2, **NOISELESS).expose(flat(0.25, (1, 1)), rng())
    assert grey[0, 0] / 65535 == pytest.approx(0.25 ** (1 / 2.2), abs=1e-5)


def test_no_light_makes_a_dark_photograph_and_leaves_the_light_alone() -> None:
    light = flat(0.0)
    grey = Sensor(12, read_noise_e=0.0).expose(light, rng())
    assert not grey.any()
    assert not light.any()


def test_the_same_seed_gives_the_same_photograph() -> None:
    first, again = (Sensor().expose(flat(0.5), rng()) for _ in range(2))
    np.testing.assert_array_equal(first, again)


@pytest.mark.parametrize(
    "wrong", [{"bits": 0}, {"bits": 17}, {"exposure": 0.0}, {"full_well_e": -1.0}, {"vignetting": 1.2}, {"gamma": 0.0}]
)
def test_an_impossible_sensor_is_refused(wrong: Mapping[str, Any]) -> None:
    with pytest.raises(BadInputError, match="is impossible"):
        Sensor(**wrong)
