"""How comfortable, calm and economical a run was, from the ground truth."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any

import numpy as np
import numpy.typing as npt

from bench.record import Run
from bench.record.comfort import in_order
from bench.scenario import Scenario
from platoon_fmu.wheels import WHEEL_NAMES

Array = npt.NDArray[np.float64]

REVERSAL_GAP_RAD = 2e-3
"""A reversal of the steering is one by more than this angle of the road wheels (rad)."""

_TORQUES = tuple(f"wheel_torque_{wheel}" for wheel in WHEEL_NAMES)
_SPINS = tuple(f"omega_{wheel}" for wheel in WHEEL_NAMES)
_NEEDED = ("a_x", "a_y", "steering_angle", *_TORQUES, *_SPINS)


@dataclass(frozen=True)
class Comfort:
    """The comfort of a run; lists hold one value per vehicle, None where the run was too short for one.

    Accelerations are those of the centre of mass in the vehicle's axes, unfiltered unless they are called weighted;
    jerk is averaged over 0.5 s as in ISO 11270.

    Attributes:
        lateral_acceleration_max_mps2: largest lateral acceleration, to either side.
        lateral_jerk_max_mps3: largest lateral jerk, to either side.
        acceleration_max_mps2: largest forward acceleration.
        braking_max_mps2: largest deceleration, positive.
        longitudinal_jerk_max_mps3: largest longitudinal jerk, of either sign.
        weighted_rms_x_mps2: RMS over the run of the longitudinal acceleration, weighted with W_d of ISO 2631-1.
        weighted_rms_y_mps2: the same of the lateral acceleration.
        weighted_rms_mps2: their vector sum, with k_x = k_y = 1 (comfort: k = 1; health would have 1.4).
        steering_reversals: turning points of the steering angle, see `reversals`.
        steering_rate_rms_radps: RMS of the rate of the road wheels' steering angle.
        driven_energy_j: work done on the wheels by torques in the direction of their spin, see `energies`.
        braked_energy_j: work taken from them by torques against it, positive.
        limits: the limits of comfort of the run, see `limits_of`.
    """

    lateral_acceleration_max_mps2: list[float | None]
    lateral_jerk_max_mps3: list[float | None]
    acceleration_max_mps2: list[float | None]
    braking_max_mps2: list[float | None]
    longitudinal_jerk_max_mps3: list[float | None]
    weighted_rms_x_mps2: list[float | None]
    weighted_rms_y_mps2: list[float | None]
    weighted_rms_mps2: list[float | None]
    steering_reversals: list[int]
    steering_rate_rms_radps: list[float | None]
    driven_energy_j: list[float | None]
    braked_energy_j: list[float | None]
    limits: dict[str, float]


def limits_of(scenario: Scenario) -> dict[str, float]:
    """Return the limits of comfort that a run is shown against, by the columns of `Run.comfort`, m/s^2 and m/s^3.

    They are those its planners were given: the standard's unless the scenario has others. A scenario that has switched
    them off has none, and its run is shown against none: it was not meant to be comfortable.
    """
    limits = scenario.planner.comfort
    if not limits.enabled:
        return {}
    return {
        "a_x": limits.longitudinal_acceleration_mps2,
        "a_y": limits.lateral_acceleration_mps2,
        "jerk_x": limits.longitudinal_jerk_mps3,
        "jerk_y": limits.lateral_jerk_mps3,
    }


def comfort(run: Run) -> Comfort | None:
    """Return the comfort of a run; None if its ground truth lacks accelerations, steering or wheels.

    Raises:
        BadInput: the log has no ground truth or no scenario.
    """
    vehicles = range(1, run.vehicles + 1)
    if not vehicles or any(name not in run.truth(vehicle) for vehicle in vehicles for name in _NEEDED):
        return None
    found = [_of_vehicle(run, vehicle) for vehicle in vehicles]
    return Comfort(**{name: [each[name] for each in found] for name in found[0]}, limits=limits_of(run.scenario))


@np.errstate(invalid="ignore", over="ignore")
def _of_vehicle(run: Run, vehicle: int) -> dict[str, Any]:
    """Return the value for one vehicle of each list of `Comfort`."""
    felt, truth = run.comfort(vehicle), in_order(run.truth(vehicle))
    rms_x, rms_y = _rms(felt["weighted_x"]), _rms(felt["weighted_y"])
    steering = truth["steering_angle"]
    driven, braked = energies(truth["t"], _stacked(truth, _TORQUES), _stacked(truth, _SPINS))
    numbers = {
        "lateral_acceleration_max_mps2": _largest(np.abs(felt["a_y"])),
        "lateral_jerk_max_mps3": _largest(np.abs(felt["jerk_y"])),
        "acceleration_max_mps2": _largest(np.maximum(felt["a_x"], 0.0)),
        "braking_max_mps2": _largest(np.maximum(-felt["a_x"], 0.0)),
        "longitudinal_jerk_max_mps3": _largest(np.abs(felt["jerk_x"])),
        "weighted_rms_x_mps2": rms_x,
        "weighted_rms_y_mps2": rms_y,
        "weighted_rms_mps2": math.hypot(rms_x, rms_y),
        "steering_rate_rms_radps": rate_rms(truth["t"], steering),
        "driven_energy_j": driven,
        "braked_energy_j": braked,
    }
    finite = {name: value if math.isfinite(value) else None for name, value in numbers.items()}
    return {**finite, "steering_reversals": reversals(steering)}


def reversals(angle: Array, gap: float = REVERSAL_GAP_RAD) -> int:
    """Return the number of times a steering angle (n,), rad, turns back by more than `gap` (rad).

    These are the turning points between swings of more than the gap, so that no dither within the gap counts. A swing
    to one side and back has one; a lane change two, and a third if it overshoots. They are the reversals that SAE J2944
    describes, as a number and not a rate, of the road wheels and not of the steering wheel, and without a low pass
    before, since a controller's chatter is to count. The method printed there (Markkula and Engstroem 2006) counts the
    swings instead, and one with pauses several times; held from cycle to cycle, a command is full of pauses.
    """
    count, sense = 0, 0
    low = high = angle[0] if len(angle) else 0.0
    for value in angle.tolist():
        if sense >= 0 and high - value > gap:
            count += sense > 0
            sense, low = -1, value
        elif sense <= 0 and value - low > gap:
            count += sense < 0
            sense, high = 1, value
        low, high = min(low, value), max(high, value)
    return count


def rate_rms(t: Array, angle: Array) -> float:
    """Return the RMS of the rate of an angle (n,) rad at times (n,) s, rad/s; NaN for a single one."""
    steps = np.diff(t)
    if not len(steps):
        return math.nan
    return math.sqrt(float(np.sum(np.diff(angle) ** 2 / steps)) / float(t[-1] - t[0]))


def energies(t: Array, torque: Array, spin: Array) -> tuple[float, float]:
    """Return the energy driven into all wheels, and the energy braked out of them, both positive, J.

    These are the integrals of torque times spin where it is positive and where it is negative, of each wheel by itself:
    torque that only turns the vehicle is driven on one side and braked on the other. What tyres, air and road take is
    part of the driven energy; how much of the braked energy can be recovered depends on the drive.

    Args:
        t: (n,) s.
        torque: (wheels, n) torque that has acted since the time before, N m.
        spin: (wheels, n) speed of the wheels at the time, rad/s.
    """
    work = torque[:, 1:] * 0.5 * (spin[:, 1:] + spin[:, :-1]) * np.diff(t)
    return float(np.maximum(work, 0.0).sum()), float(np.maximum(-work, 0.0).sum())


def _stacked(truth: Any, names: tuple[str, ...]) -> Array:
    return np.stack([truth[name] for name in names])


def _largest(values: Array) -> float:
    """Return the largest of the values that are known; NaN if there is none."""
    known = values[~np.isnan(values)]
    return float(known.max()) if len(known) else math.nan


def _rms(values: Array) -> float:
    return math.sqrt(float(np.mean(values**2))) if len(values) else math.nan
