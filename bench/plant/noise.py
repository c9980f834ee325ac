"""The noise of a vehicle's sensors: white, Gaussian, independent between signals, vehicles and cycles.

It is what sensors have when nothing is wrong; a sensor that has become noisy is a fault, `bench.faults.sensors`.
"""

from collections.abc import Mapping

from bench.control.random_numbers import RandomNumbers, mixed
from bench.scenario import Scenario
from bench.scenario.model import Noise

_STREAM = 0x534E
"""Keeps these numbers apart from others that follow from the scenario's seed."""

_KEYS: Mapping[str, str] = {
    "X": "position_m",
    "Y": "position_m",
    "Yaw": "yaw_rad",
    "Roll": "roll_rad",
    "VelocityX": "velocity_mps",
    "VelocityY": "velocity_mps",
    "YawRate": "yaw_rate_radps",
    "AccelerationX": "acceleration_mps2",
    "AccelerationY": "acceleration_mps2",
    "WheelSpeedFL": "wheel_speed_radps",
    "WheelSpeedFR": "wheel_speed_radps",
    "WheelSpeedRL": "wheel_speed_radps",
    "WheelSpeedRR": "wheel_speed_radps",
}
"""The key of `Noise` of each signal about the vehicle's state. The order decides on the numbers."""


class SensorNoise:
    """The noise of one vehicle's sensors; the same seed, vehicle and cycle give the same."""

    def __init__(self, noise: Noise, seed: int, vehicle: int) -> None:
        """Draw for vehicle number `vehicle` of a scenario with this `seed` and `noise`."""
        self._sigmas = {signal: float(getattr(noise, key)) for signal, key in _KEYS.items()}
        self._seed = seed
        self._vehicle = vehicle

    def at(self, cycle: int) -> dict[str, float]:
        """Return the error of each signal in a cycle, in the signal's unit.

        Each signal has numbers of its own, whatever the standard deviations of the others.
        """
        numbers = RandomNumbers(mixed(_STREAM, self._seed, self._vehicle, cycle))
        return {signal: sigma * numbers.normal() for signal, sigma in self._sigmas.items()}


def sensor_noise(scenario: Scenario, vehicle: int) -> SensorNoise | None:
    """Return the noise of a vehicle's sensors, None if they have none."""
    if not any(dict(scenario.noise).values()):
        return None
    return SensorNoise(scenario.noise, scenario.seed, vehicle)
