"""The noise of sensors: as wide as stated, the same for the same seed, and in nothing but what is measured."""

from contextlib import ExitStack
from itertools import pairwise

import numpy as np
import pytest

from bench.errors import BadInput
from bench.plant.noise import SensorNoise, sensor_noise
from bench.plant.plant import _STATE
from bench.scenario import load
from bench.scenario.model import Noise
from tests.plant.test_plant import ALONE, Rig

ALL = Noise(
    position_m=0.1,
    yaw_rad=0.01,
    roll_rad=0.02,
    velocity_mps=0.3,
    yaw_rate_radps=0.04,
    acceleration_mps2=0.5,
    wheel_speed_radps=0.6,
)
SIGMAS = [0.1, 0.1, 0.01, 0.02, 0.3, 0.3, 0.04, 0.5, 0.5, 0.6, 0.6, 0.6, 0.6]


def table(noise: Noise, seed: int = 1, vehicle: int = 1, cycles: int = 4000) -> np.ndarray:
    source = SensorNoise(noise, seed, vehicle)
    return np.array([list(source.at(cycle).values()) for cycle in range(cycles)])


def test_every_signal_about_the_vehicles_state_has_noise_of_its_key():
    signals = [signal for signals in _STATE.values() for signal in signals]
    assert list(SensorNoise(ALL, 1, 1).at(0)) == signals
    assert len(SIGMAS) == len(signals)


def test_noise_is_white_gaussian_and_independent_between_signals():
    errors = table(ALL) / SIGMAS
    assert np.abs(errors.mean(axis=0)).max() < 0.06
    assert np.abs(errors.std(axis=0) - 1.0).max() < 0.05
    within = (np.abs(errors) < 1.0).mean(axis=0)
    assert np.abs(within - 0.6827).max() < 0.03
    correlation = np.corrcoef(np.hstack([errors[1:], errors[:-1]]).T) - np.eye(2 * len(SIGMAS))
    assert np.abs(correlation).max() < 0.07


def test_seed_vehicle_and_cycle_decide_and_other_signals_do_not():
    first = table(ALL, cycles=50)
    assert np.array_equal(first, table(ALL, cycles=50))
    for other in (table(ALL, seed=2, cycles=50), table(ALL, vehicle=2, cycles=50)):
        assert not np.any(first == other)
    only = table(Noise(yaw_rad=0.01), cycles=50)
    assert np.array_equal(only[:, 2], first[:, 2])
    assert not only[:, [0, 1, *range(3, 13)]].any()
    assert all(not np.array_equal(one, next_one) for one, next_one in pairwise(first))


def test_noise_is_in_what_is_measured_and_not_in_the_truth():
    rows = []
    for more in ([], ["noise.position_m=0.5", "noise.wheel_speed_radps=3.0"]):
        with ExitStack() as stack:
            rig = Rig(load("formation", [*ALONE, *more]), stack)
            rig.sync(0)
            rows.append((rig.published(), rig.truth))
    (exact, truth), (noisy, same_truth) = rows
    assert truth == same_truth
    errors = SensorNoise(Noise(position_m=0.5, wheel_speed_radps=3.0), 1, 1).at(0)
    for message, signals in exact.items():
        for signal, value in signals.items():
            if signal in errors:
                assert noisy[message][signal] == pytest.approx(value + errors[signal], abs=5e-4), signal
    assert noisy["VehiclePosition"]["X"] != exact["VehiclePosition"]["X"]
    assert noisy["VehicleMotion"]["YawRate"] == exact["VehicleMotion"]["YawRate"]


def test_without_noise_nothing_is_drawn_and_a_wrong_one_is_refused():
    assert sensor_noise(load("formation"), 1) is None
    assert sensor_noise(load("formation", ["noise.roll_rad=0.1"]), 3) is not None
    with pytest.raises(
        BadInput, match=r"noise.position_m = -0.1 is not allowed; allowed: a finite number from 0 to 10"
    ):
        load("formation", ["noise.position_m=-0.1"])
