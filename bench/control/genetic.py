"""The flocking gains optimised by a genetic algorithm at every planning interval, (34) and (36).

Each candidate Lambda is rolled out with the vehicle's own closed planning model (flocking, near-identity step,
boundaries) while its neighbours move at constant velocity. (34) as printed rewards only the largest speed change
and positive yaw. Here |gamma| is used, and the reward for using the boundaries is weighed against the formation error,
so that the trade-off described in the paper is optimised: fast formation within the boundaries.
"""

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from bench.control.boundaries import Boundaries, admissible, speed_reach, yaw_rate_max
from bench.control.compiled import njit
from bench.control.flocking import GA, GB, Field, acceleration
from bench.control.near_identity import input_rates, point, velocity
from bench.control.settings import CostWeights

Vector = NDArray[np.float64]
Matrix = NDArray[np.float64]


class Situation(NamedTuple):
    """A vehicle, its slot and the others at the start of an interval.

    Attributes:
        X: own position along the road (m).
        Y: own position to the left (m).
        theta: own course (rad).
        v: reference speed (m/s).
        gamma: reference yaw rate (rad/s).
        target: (2,) slot of this vehicle (m); it moves at the platoon's speed.
        platoon_speed: m/s.
        peers_q: (n, 2) points of the others (m).
        peers_p: (n, 2) their velocities (m/s).
    """

    X: float
    Y: float
    theta: float
    v: float
    gamma: float
    target: Vector
    platoon_speed: float
    peers_q: Matrix
    peers_p: Matrix


class Rollout(NamedTuple):
    """The planning model with which each candidate is rolled out, and its cost.

    Attributes:
        field: of the flocking law.
        limits: the boundaries.
        length: near-identity length l (m).
        weights: of the cost.
        steps: N_t.
        step_s: s.
    """

    field: Field
    limits: Boundaries
    length: float
    weights: CostWeights
    steps: int
    step_s: float


class Breeding(NamedTuple):
    """Parameters of the genetic algorithm.

    Attributes:
        lower: (6,) lower bounds of Lambda.
        upper: (6,) upper bounds.
        population: number of candidates.
        generations: number of generations.
        mutation: standard deviation of a mutation as a fraction of the range.
    """

    lower: Vector
    upper: Vector
    population: int
    generations: int
    mutation: float


@njit(cache=True)
def rollout_cost(gains: Vector, situation: Situation, rollout: Rollout) -> float:
    """J_1 of one candidate Lambda (6,), mean over the horizon."""
    X, Y, theta, v, gamma, target, platoon_speed, peers_q, peers_p = situation
    field, limits, length, weights, steps, step_s = rollout
    others = peers_q.copy()
    q, p, q_hat = np.empty(2), np.empty(2), np.empty(2)
    p_hat = np.array([platoon_speed, 0.0])
    # The Euler step of the yaw rate needs l > v T / 2; the long steps of the horizon are divided accordingly.
    parts = int(np.ceil(v * step_s / length)) + 1
    part_s = step_s / parts
    cost = 0.0
    for k in range(steps):
        q_hat[0] = target[0] + platoon_speed * k * step_s + length
        q_hat[1] = target[1]
        q[0], q[1] = point(X, Y, theta, length)
        p[0], p[1] = velocity(theta, v, gamma, length)
        u_x, u_y = acceleration(q, p, others, peers_p, q_hat, p_hat, gains, field)
        v_before = v
        for _ in range(parts):
            v_rate, gamma_rate = input_rates(theta, v, gamma, length, u_x, u_y)
            gamma_max = yaw_rate_max(v, limits.mu_g)
            over = abs(gamma + part_s * gamma_rate) - gamma_max
            if over > 0.0:
                cost += weights.boundary * over * over / parts
            v, gamma, _ = admissible(v, gamma, v_rate, gamma_rate, part_s, limits)
            X += part_s * v * np.cos(theta)
            Y += part_s * v * np.sin(theta)
            theta += part_s * gamma
        for j in range(others.shape[0]):
            others[j, 0] += step_s * peers_p[j, 0]
            others[j, 1] += step_s * peers_p[j, 1]
        reach = speed_reach(v_before, v >= v_before, step_s, limits)
        unused_speed = v - reach
        unused_yaw = abs(gamma) - yaw_rate_max(v, limits.mu_g)
        e_x, e_y = q[0] - q_hat[0], q[1] - q_hat[1]
        w_x, w_y = p[0] - p_hat[0], p[1]
        cost += weights.position * (e_x * e_x + e_y * e_y) + weights.velocity * (w_x * w_x + w_y * w_y)
        cost += weights.speed * unused_speed * unused_speed + weights.yaw * unused_yaw * unused_yaw
    return cost / steps


@njit(cache=True)
def search(
    start: Vector, seed: int, breeding: Breeding, situation: Situation, rollout: Rollout
) -> tuple[Vector, float]:
    """The best Lambda found (6,) and its cost; the same arguments give the same result.

    The gains of the last interval always compete, so the cost never exceeds theirs. The two best candidates of each
    generation survive, tournaments of two select parents, children blend two parents, and mutations are normal.

    Args:
        start: (6,) gains of the last interval.
        seed: seed of the random numbers.
        breeding: parameters of the genetic algorithm.
        situation: initial situation of the rollouts.
        rollout: model and cost of the rollouts.
    """
    lower, upper, population, generations, mutation = breeding
    np.random.seed(seed)
    n = start.size
    span = upper - lower
    pool = np.empty((population, n))
    for i in range(population):
        for g in range(n):
            pool[i, g] = start[g] if i == 0 else lower[g] + span[g] * np.random.random()
        pool[i, GB] = max(pool[i, GA], pool[i, GB])
    costs = np.empty(population)
    for i in range(population):
        costs[i] = rollout_cost(pool[i], situation, rollout)
    for _ in range(generations):
        order = np.argsort(costs)
        bred = np.empty((population, n))
        bred_costs = np.empty(population)
        for i in range(2):
            bred[i] = pool[order[i]]
            bred_costs[i] = costs[order[i]]
        for i in range(2, population):
            one, two = np.random.randint(0, population), np.random.randint(0, population)
            mother = one if costs[one] < costs[two] else two
            one, two = np.random.randint(0, population), np.random.randint(0, population)
            father = one if costs[one] < costs[two] else two
            for g in range(n):
                share = np.random.random()
                value = share * pool[mother, g] + (1.0 - share) * pool[father, g]
                value += mutation * span[g] * np.random.normal()
                bred[i, g] = min(max(value, lower[g]), upper[g])
            bred[i, GB] = max(bred[i, GA], bred[i, GB])
            bred_costs[i] = rollout_cost(bred[i], situation, rollout)
        pool, costs = bred, bred_costs
    best = np.argmin(costs)
    return pool[best].copy(), costs[best]
