"""Settings of planner and tracker with their ranges and consistency checks.

A separate module, so that reading a scenario does not load the controllers, which is slow.
"""

from dataclasses import dataclass, field
from typing import Annotated, NamedTuple

import numpy as np
from annotated_types import Ge, Gt, Le, Lt
from numpy.typing import NDArray

from bench.control.comfort import ComfortLimits
from platoon_fmu.parameters import VehicleParameters

Vector = NDArray[np.float64]

ADHESION_MIN, ADHESION_MAX = 0.05, 1.5
"""Range of the tyre-road adhesion of a scenario, a fault and the planner."""

Unit = Annotated[float, Ge(1e-3), Le(1e5)]
Weight = Annotated[float, Ge(0), Le(1e6)]
Pair = tuple[Annotated[float, Ge(1e-3), Le(20)], Annotated[float, Ge(1e-3), Le(20)]]


class CostWeights(NamedTuple):
    """Weights of a candidate's cost, `<name>_weight` in `GeneticSettings`."""

    position: float
    velocity: float
    speed: float
    yaw: float
    boundary: float
    comfort: float


@dataclass(frozen=True)
class GeneticSettings:
    """Settings of the search.

    Attributes:
        population: number of candidates per generation.
        generations: number of generations.
        horizon_steps: N_t, number of steps of a rollout.
        horizon_step_s: length of such a step.
        mutation: standard deviation of a mutation, as a fraction of a gain's range.
        ga: bounds of Ga.
        gb: bounds of Gb; a candidate with Gb < Ga is evaluated with Gb = Ga.
        p11: bounds of the longitudinal position gain (1/s^2).
        p12: bounds of the lateral position gain (1/s^2).
        p21: bounds of the longitudinal velocity gain (1/s).
        p22: bounds of the lateral velocity gain (1/s).
        position_weight: cost of a squared formation error (1/m^2).
        velocity_weight: cost of a squared velocity error (s^2/m^2).
        speed_weight: P_1, cost of not using the reachable speed change (s^2/m^2).
        yaw_weight: Q_2, cost of not using the allowed yaw rate (s^2/rad^2).
        boundary_weight: cost of requesting a yaw rate above the limit (s^2/rad^2).
        comfort_weight: cost of accelerating beside the navigation target (s^4/m^2).
    """

    population: Annotated[int, Ge(4), Le(200)] = 8
    generations: Annotated[int, Ge(1), Le(100)] = 5
    horizon_steps: Annotated[int, Ge(2), Le(200)] = 25
    horizon_step_s: Annotated[float, Ge(1e-3), Le(0.1)] = 0.04
    mutation: Annotated[float, Gt(0), Le(1)] = 0.8
    ga: Pair = (0.5, 3.0)
    gb: Pair = (0.5, 5.0)
    p11: Pair = (0.6, 2.0)
    p12: Pair = (0.9, 2.0)
    p21: Pair = (1.6, 4.0)
    p22: Pair = (2.0, 4.0)
    position_weight: Weight = 1.0
    velocity_weight: Weight = 0.3
    speed_weight: Weight = 0.02
    yaw_weight: Weight = 0.5
    boundary_weight: Weight = 20.0
    comfort_weight: Weight = 0.05

    def __post_init__(self) -> None:
        """Check the bounds.

        Raises:
            ValueError: a lower bound is above its upper bound, or the upper bound of Ga is above that of Gb.
        """
        for name in ("ga", "gb", "p11", "p12", "p21", "p22"):
            lower, upper = getattr(self, name)
            if lower > upper:
                raise ValueError(f"{name} = [{lower}, {upper}] must be [lower, upper]")
        if self.ga[1] > self.gb[1]:
            raise ValueError(
                f"ga has upper bound {self.ga[1]} and gb only {self.gb[1]}: Gb must not be below Ga; raise gb"
            )

    def bounds(self) -> tuple[Vector, Vector]:
        """Return lower and upper bounds (6,) of Lambda."""
        pairs = np.array([self.ga, self.gb, self.p11, self.p12, self.p21, self.p22], dtype=np.float64)
        return pairs[:, 0].copy(), pairs[:, 1].copy()

    def weights(self) -> CostWeights:
        """Return the weights of the cost for the compiled rollout."""
        return CostWeights(*(float(getattr(self, f"{name}_weight")) for name in CostWeights._fields))


@dataclass(frozen=True)
class PlannerSettings:
    """Settings of the planner.

    Attributes:
        planning_interval_s: interval of the optimisation of the gains; a multiple of the cycle.
        gain_share: fraction by which the gains in use move towards the optimised ones per interval; 1 would make the
            references jump.
        near_identity_length_m: l of the near-identity diffeomorphism.
        adhesion: tyre-road adhesion mu_a assumed by the planner.
        boundary_share: fraction of the stability boundaries that a reference may use; the remainder allows for tracking
            errors.
        acceleration_max_mps2: largest commanded acceleration and braking.
        yaw_acceleration_max_radps2: largest commanded change of the yaw rate.
        speed_min_mps: lowest commanded speed.
        speed_max_mps: highest commanded speed.
        clearance_m: least distance between bodies that the planner keeps, more than is required of a run.
        slow_down_mps2: braking of a vehicle that leaves the platoon and slows down in its lane.
        emergency_braking_mps2: largest braking to keep clear of a vehicle ahead.
        rejoin_error_m: limit of the position error that a rejoining vehicle acts on, so that it approaches slowly.
        sigma_eps: eps of the sigma-norm.
        reach_factor: r / d, range of the interaction with neighbours, in gaps.
        bump_flat: G_h of the bump function.
        comfort: limits of the references; they give way where clearance or a stability boundary asks for more.
        genetic: settings of the search.
    """

    planning_interval_s: Annotated[float, Gt(0), Le(1)] = 0.05
    gain_share: Annotated[float, Gt(0), Le(1)] = 0.2
    near_identity_length_m: float = 0.9
    adhesion: Annotated[float, Ge(ADHESION_MIN), Le(ADHESION_MAX)] = VehicleParameters().mu_a
    boundary_share: Annotated[float, Ge(0.05), Le(1)] = 0.7
    acceleration_max_mps2: Annotated[float, Ge(0.01), Le(10)] = 3.0
    yaw_acceleration_max_radps2: Annotated[float, Ge(0.01), Le(20)] = 1.5
    speed_min_mps: Annotated[float, Ge(1), Le(60)] = 5.0
    speed_max_mps: Annotated[float, Ge(1), Le(60)] = 45.0
    clearance_m: Annotated[float, Ge(0.3), Le(10)] = 1.2
    slow_down_mps2: Annotated[float, Ge(0.1), Le(5)] = 1.5
    emergency_braking_mps2: Annotated[float, Ge(0.1), Le(10)] = 5.0
    rejoin_error_m: Annotated[float, Ge(0.5), Le(100)] = 6.0
    sigma_eps: Annotated[float, Ge(1e-3), Le(10)] = 0.1
    reach_factor: Annotated[float, Gt(1), Le(5)] = 1.2
    bump_flat: Annotated[float, Gt(0), Lt(1)] = 0.2
    comfort: ComfortLimits = field(default_factory=ComfortLimits)
    genetic: GeneticSettings = field(default_factory=GeneticSettings)


@dataclass(frozen=True)
class TrackerSettings:
    """Settings of the tracker.

    Attributes:
        offset_free: use the disturbance estimate in the target; false only to show its effect.
        independent_axles: robust against independent lambda_f and lambda_r in [-1, 1]; false assumes
            lambda_f = lambda_r as in the paper.
        observer_rate: decay rate rho of the observer's error in one cycle.
        steering_max_rad: largest front steering angle.
        steering_rate_max_radps: its largest rate.
        wheel_force_max_n: largest drive or brake force of one wheel.
        wheel_force_rate_max_nps: its largest rate.
        yaw_moment_share: fraction of the wheel forces reserved for the yaw moment.
        speed_unit_mps: deviation in v_x that costs as much in the robust MPC as one unit of the others.
        lateral_speed_unit_mps: the same for v_y.
        yaw_rate_unit_radps: the same for gamma.
        steering_unit_rad: the same for the steering angle, at `input_weight` 1.
        force_unit_n: the same for the total drive force.
        yaw_moment_unit_nm: the same for the yaw moment.
        input_weight: weight R of the inputs against Q = I.
        solver_tolerance: of the semidefinite programme; its result is certified in any case.
        solver_max_iterations: of the semidefinite programme.
    """

    offset_free: bool = True
    independent_axles: bool = True
    observer_rate: Annotated[float, Ge(0.5), Lt(1)] = 0.9
    steering_max_rad: Annotated[float, Ge(1e-3), Le(1)] = 0.5
    steering_rate_max_radps: Annotated[float, Ge(1e-3), Le(100)] = 3.0
    wheel_force_max_n: Annotated[float, Ge(1), Le(1e5)] = 3000.0
    wheel_force_rate_max_nps: Annotated[float, Ge(1), Le(1e7)] = 60_000.0
    yaw_moment_share: Annotated[float, Gt(0), Lt(1)] = 0.25
    speed_unit_mps: Unit = 1.0
    lateral_speed_unit_mps: Unit = 5.0
    yaw_rate_unit_radps: Unit = 0.2
    steering_unit_rad: Unit = 0.1
    force_unit_n: Unit = 2000.0
    yaw_moment_unit_nm: Unit = 1000.0
    input_weight: Annotated[float, Ge(1e-3), Le(10)] = 1.0
    solver_tolerance: Annotated[float, Ge(1e-9), Le(1e-3)] = 1e-4
    solver_max_iterations: Annotated[int, Ge(5), Le(63)] = 40


def check_length(length: float, speed: float, step_s: float) -> None:
    """Reject an l (m) that makes (15) unstable at a speed (m/s) and step (s).

    Raises:
        ValueError: l is not in (v T/2, 1): the yaw pole of the Euler step is 1 - v T/l.
    """
    least = 0.5 * speed * step_s
    if not least < length < 1.0:
        raise ValueError(
            f"near-identity length {length} m must lie between v T/2 = {least:g} m (v = {speed:g} m/s) and 1 m"
        )


def planning_cycles(interval_s: float, step_s: float) -> int:
    """Return the number of cycles in a planning interval.

    Raises:
        ValueError: the interval is not a multiple of the cycle.
    """
    cycles = round(interval_s / step_s)
    if cycles < 1 or abs(cycles * step_s - interval_s) > 1e-9:
        raise ValueError(f"planning interval {interval_s} s must be a multiple of the cycle, {step_s:g} s")
    return cycles
