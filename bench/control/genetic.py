"""The flocking gains optimised by a genetic algorithm at every planning interval, (34) and (36).

Each candidate Lambda is rolled out with the vehicle's own closed planning model (flocking, near-identity step,
boundaries) while its neighbours move at constant velocity. (34) as printed rewards the largest speed change and
positive yaw only. Here |gamma| is used, and the reward for using the boundaries stands against the formation error it
is there to remove, so that what is optimised is the trade-off the paper describes: formed fast, inside the boundaries.
"""

import numpy as np
from numba import njit
from numpy.typing import NDArray

from bench.control.boundaries import admissible, speed_reach, yaw_rate_max
from bench.control.flocking import acceleration
from bench.control.near_identity import input_rates, point, velocity

Vector = NDArray[np.float64]
Matrix = NDArray[np.float64]


@njit(cache=True)
def rollout_cost(
    gains: Vector,
    state: Vector,
    target: Vector,
    platoon_speed: float,
    peers_q: Matrix,
    peers_p: Matrix,
    field: Vector,
    limits: Vector,
    length: float,
    weights: Vector,
    steps: int,
    step_s: float,
) -> float:
    """J_1 of one candidate, mean over the horizon.

    Args:
        gains: (6,) Lambda.
        state: (5,) X, Y (m), theta (rad), reference v (m/s) and gamma (rad/s).
        target: (2,) slot of this vehicle now (m); it moves at the platoon's speed.
        platoon_speed: m/s.
        peers_q: (n, 2) points of the others now (m).
        peers_p: (n, 2) their velocities (m/s).
        field: (4,) eps, d, r, G_h of the flocking law.
        limits: (8,) of `Boundaries.as_vector`.
        length: near-identity length l (m).
        weights: (5,) of `GeneticSettings.weights` (see `settings`).
        steps: N_t.
        step_s: s.
    """
    X, Y, theta, v, gamma = state[0], state[1], state[2], state[3], state[4]
    others = peers_q.copy()
    q, p, q_hat = np.empty(2), np.empty(2), np.empty(2)
    p_hat = np.array([platoon_speed, 0.0])
    # The Euler step of the yaw rate needs l > v T / 2; the long steps of the horizon are divided to keep to that.
    parts = int(np.ceil(v * step_s / length)) + 1
    part_s = step_s / parts
    cost = 0.0
    for k in range(steps):
        q_hat[0] = target[0] + platoon_speed * k * step_s + length
        q_hat[1] = target[1]
        q[0], q[1] = point(X, Y, theta, length)
        p[0], p[1] = velocity(theta, v, gamma, length)
        u_x, u_y = acceleration(q, p, others, peers_p, q_hat, p_hat, gains, field[0], field[1], field[2], field[3])
        v_before = v
        for _ in range(parts):
            v_rate, gamma_rate = input_rates(theta, v, gamma, length, u_x, u_y)
            gamma_max = yaw_rate_max(v, limits[0])
            over = abs(gamma + part_s * gamma_rate) - gamma_max
            if over > 0.0:
                cost += weights[4] * over * over / parts
            v, gamma, _ = admissible(v, gamma, v_rate, gamma_rate, part_s, limits)
            X += part_s * v * np.cos(theta)
            Y += part_s * v * np.sin(theta)
            theta += part_s * gamma
        for j in range(others.shape[0]):
            others[j, 0] += step_s * peers_p[j, 0]
            others[j, 1] += step_s * peers_p[j, 1]
        reach = speed_reach(v_before, v >= v_before, step_s, limits)
        unused_speed = v - reach
        unused_yaw = abs(gamma) - yaw_rate_max(v, limits[0])
        e_x, e_y = q[0] - q_hat[0], q[1] - q_hat[1]
        w_x, w_y = p[0] - p_hat[0], p[1]
        cost += weights[0] * (e_x * e_x + e_y * e_y) + weights[1] * (w_x * w_x + w_y * w_y)
        cost += weights[2] * unused_speed * unused_speed + weights[3] * unused_yaw * unused_yaw
    return cost / steps


@njit(cache=True)
def search(
    start: Vector,
    lower: Vector,
    upper: Vector,
    population: int,
    generations: int,
    mutation: float,
    seed: int,
    state: Vector,
    target: Vector,
    platoon_speed: float,
    peers_q: Matrix,
    peers_p: Matrix,
    field: Vector,
    limits: Vector,
    length: float,
    weights: Vector,
    steps: int,
    step_s: float,
) -> tuple[Vector, float]:
    """The best Lambda found (6,) and its cost; the same arguments give the same answer.

    The last interval's gains always compete, so the cost never exceeds theirs; the two best of each generation live
    on, parents are chosen by tournaments of two, children are blends of two parents, and mutations are normal.

    Args:
        start: (6,) gains of the last interval.
        lower: (6,) bounds.
        upper: (6,) bounds.
        population: candidates.
        generations: how often they are bred.
        mutation: standard deviation of a mutation as a share of the range.
        seed: of the random numbers.
        state: as in `rollout_cost`, like all that follow.
        target: slot.
        platoon_speed: m/s.
        peers_q: the others' points.
        peers_p: their velocities.
        field: of the flocking law.
        limits: the boundaries.
        length: near-identity length.
        weights: of the cost.
        steps: of the rollout.
        step_s: s.
    """
    np.random.seed(seed)
    n = start.size
    span = upper - lower
    pool = np.empty((population, n))
    for i in range(population):
        for g in range(n):
            pool[i, g] = start[g] if i == 0 else lower[g] + span[g] * np.random.random()
        pool[i, 1] = max(pool[i, 0], pool[i, 1])
    costs = np.empty(population)
    for i in range(population):
        costs[i] = rollout_cost(
            pool[i], state, target, platoon_speed, peers_q, peers_p, field, limits, length, weights, steps, step_s
        )
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
            bred[i, 1] = max(bred[i, 0], bred[i, 1])
            bred_costs[i] = rollout_cost(
                bred[i], state, target, platoon_speed, peers_q, peers_p, field, limits, length, weights, steps, step_s
            )
        pool, costs = bred, bred_costs
    best = np.argmin(costs)
    return pool[best].copy(), costs[best]
