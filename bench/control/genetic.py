# cython: boundscheck=False, wraparound=False, cdivision=True, initializedcheck=False
"""The flocking gains optimised by a genetic algorithm at every planning interval, (34) and (36).

Each candidate Lambda is rolled out with the vehicle's own closed planning model (flocking, near-identity step,
boundaries) while its neighbours move at constant velocity. (34) as printed rewards only the largest speed change
and positive yaw. Here |gamma| is used, and the reward for using the boundaries is weighed against the formation error,
so that the trade-off described in the paper is optimised: fast formation within the boundaries.
"""

from array import array
from collections.abc import Iterable, Sequence

import cython

from bench.control.settings import CostWeights, GeneticSettings

if cython.compiled:
    from cython.cimports.bench.control.agents import LANES, Agents
    from cython.cimports.bench.control.boundaries import Boundaries, limit, set_speeds_reach, set_yaw_rates_max
    from cython.cimports.bench.control.flocking import Field, Gains, Neighbours, accelerate, take_gains
    from cython.cimports.bench.control.near_identity import locate, move, request
    from cython.cimports.bench.control.random_numbers import RandomNumbers
    from cython.cimports.libc.math import ceil
else:
    from math import ceil

    from bench.control.agents import LANES, Agents
    from bench.control.boundaries import Boundaries, limit, set_speeds_reach, set_yaw_rates_max
    from bench.control.flocking import Field, Gains, Neighbours, accelerate, take_gains
    from bench.control.near_identity import locate, move, request
    from bench.control.random_numbers import RandomNumbers

_COUNT = 6

MUTATED = 0.3
"""Share of a child's gains that mutate."""

BEYOND = 2.0
"""How far a child can lie from the worse parent, in distances to the better one."""


NOTICEABLE = 0.05
"""Fraction by which a cost must fall for the gains to change."""

UNNOTICED = 1e-4
"""Difference of costs below which the gains do not change, however small the cost."""


@cython.cclass
class Situation:
    """A vehicle, its slot and the others at the start of an interval.

    Attributes:
        X: own position along the road (m).
        Y: own position to the left (m).
        c: cosine of the own course.
        s: its sine.
        v: reference speed (m/s).
        gamma: reference yaw rate (rad/s).
        targets: the navigation target at each step of the horizon: point (m, m), velocity (m/s, m/s) and acceleration
            (m/s^2, m/s^2), one after the other.
        neighbours: points and velocities of the others.
    """

    def __init__(
        self,
        X: float,
        Y: float,
        c: float,
        s: float,
        v: float,
        gamma: float,
        targets: Iterable[float],
        neighbours: Neighbours,
    ) -> None:
        self.X = X
        self.Y = Y
        self.c = c
        self.s = s
        self.v = v
        self.gamma = gamma
        self.targets = array("d", targets)
        self.neighbours = neighbours


@cython.cclass
class Rollout:
    """The planning model with which each candidate is rolled out, and its cost.

    Args:
        field: of the flocking law.
        limits: the boundaries.
        length: near-identity length l (m).
        weights: of the cost.
        steps: N_t.
        step_s: s.
    """

    def __init__(
        self, field: Field, limits: Boundaries, length: float, weights: CostWeights, steps: int, step_s: float
    ) -> None:
        self.field = field
        self.limits = limits
        self.length = length
        self.position, self.velocity, self.speed, self.yaw, self.boundary, self.comfort = weights
        self.steps = steps
        self.step_s = step_s


@cython.cclass
class Candidate:
    """One Lambda and its cost.

    Attributes:
        gains: Lambda.
        cost: J_1, mean over the horizon.
    """

    def __init__(self, gains: Sequence[float]) -> None:
        self.gains = Gains(gains)
        self.cost = 0.0


@cython.ccall
def roll_out(candidates: list[Candidate], first: cython.int, situation: Situation, rollout: Rollout) -> cython.void:
    """Set the cost of the candidates from number `first` on: as many side by side as there are lanes."""
    agents: Agents = Agents()
    count: cython.int = len(candidates)
    i: cython.int
    while first < count:
        for i in range(LANES):
            # The last lanes repeat a candidate where there are no more.
            take_gains(agents, i, cython.cast(Candidate, candidates[min(first + i, count - 1)]).gains)
        _roll_out_lanes(agents, situation, rollout)
        for i in range(min(LANES, count - first)):
            cython.cast(Candidate, candidates[first + i]).cost = agents.cost[i]
        first += LANES


@cython.cfunc
@cython.exceptval(check=False)
def _roll_out_lanes(agents: Agents, situation: Situation, model: Rollout) -> cython.void:
    """Roll out agents whose gains are set from the same situation, and set their costs."""
    i: cython.int
    k: cython.int
    for i in range(LANES):
        agents.cost[i] = 0.0
        agents.X[i] = situation.X
        agents.Y[i] = situation.Y
        agents.c[i] = situation.c
        agents.s[i] = situation.s
        agents.v[i] = situation.v
        agents.gamma[i] = situation.gamma
    set_yaw_rates_max(agents, model.limits)
    # The Euler step of the yaw rate needs l > v T / 2; the long steps of the horizon are divided accordingly.
    parts: cython.int = cython.cast(cython.int, ceil(situation.v * model.step_s / model.length)) + 1
    for k in range(model.steps):
        _advance(agents, k, parts, situation, model)
    for i in range(LANES):
        agents.cost[i] /= model.steps


@cython.cfunc
@cython.exceptval(check=False)
def _advance(agents: Agents, k: cython.int, parts: cython.int, situation: Situation, model: Rollout) -> cython.void:
    """Roll out by step k of the horizon, and add its costs, (34)."""
    part_s: cython.double = model.step_s / parts
    q_hat_x: cython.double = situation.targets[6 * k]
    q_hat_y: cython.double = situation.targets[6 * k + 1]
    p_hat_x: cython.double = situation.targets[6 * k + 2]
    p_hat_y: cython.double = situation.targets[6 * k + 3]
    u_hat_x: cython.double = situation.targets[6 * k + 4]
    u_hat_y: cython.double = situation.targets[6 * k + 5]
    i: cython.int
    locate(agents, model.length)
    accelerate(agents, situation.neighbours, k * model.step_s, q_hat_x, q_hat_y, p_hat_x, p_hat_y, model.field)
    for i in range(LANES):
        agents.v_before[i] = agents.v[i]
        e_x: cython.double = agents.q_x[i] - q_hat_x
        e_y: cython.double = agents.q_y[i] - q_hat_y
        w_x: cython.double = agents.p_x[i] - p_hat_x
        w_y: cython.double = agents.p_y[i] - p_hat_y
        u_x: cython.double = agents.u_x[i]
        u_y: cython.double = agents.u_y[i]
        agents.cost[i] += model.position * (e_x * e_x + e_y * e_y) + model.velocity * (w_x * w_x + w_y * w_y)
        agents.cost[i] += model.comfort * (u_x * u_x + u_y * u_y)
        agents.u_x[i] = u_x + u_hat_x
        agents.u_y[i] = u_y + u_hat_y
    for _ in range(parts):
        request(agents, model.length)
        for i in range(LANES):
            over: cython.double = max(abs(agents.gamma[i] + part_s * agents.gamma_rate[i]) - agents.gamma_max[i], 0.0)
            agents.cost[i] += model.boundary * over * over / parts
        limit(agents, part_s, model.limits)
        set_yaw_rates_max(agents, model.limits)
        move(agents, part_s)
    set_speeds_reach(agents, model.step_s, model.limits)
    for i in range(LANES):
        unused_speed: cython.double = agents.v[i] - agents.v_reach[i]
        unused_yaw: cython.double = abs(agents.gamma[i]) - agents.gamma_max[i]
        agents.cost[i] += model.speed * unused_speed * unused_speed + model.yaw * unused_yaw * unused_yaw


@cython.cclass
class Breeding:
    """Parameters of the genetic algorithm.

    Args:
        settings: of the search.
    """

    def __init__(self, settings: GeneticSettings) -> None:
        lower, upper = settings.bounds()
        self.lower = Gains(lower)
        self.upper = Gains(upper)
        self.population = settings.population
        self.generations = settings.generations
        self.mutation = settings.mutation
        self.pool = [Candidate(lower.tolist()) for _ in range(2 * settings.population)]

    def middle(self) -> tuple[float, ...]:
        """Return the gains in the middle of the bounds, with Gb raised to Ga where it is below it."""
        middle = Gains([0.5 * (low + high) for low, high in zip(self.lower.values, self.upper.values, strict=True)])
        return tuple(middle.values)


def search(
    start: Sequence[float], seed: int, breeding: Breeding, situation: Situation, rollout: Rollout
) -> tuple[tuple[float, ...], float]:
    """The best Lambda found (6,) and its cost; the same arguments give the same result.

    The first generation has the gains of the last interval, as many mutations of them as fit into half of it, and
    random ones. Of each generation and its children the best survive, so the cost never exceeds that of the last
    gains. Tournaments of two select parents; a child of two lies on the way from the worse one to the better one or
    beyond it, which soon reaches the bounds, where the best gains often are.

    Args:
        start: (6,) gains of the last interval.
        seed: seed of the random numbers.
        breeding: parameters of the genetic algorithm.
        situation: initial situation of the rollouts.
        rollout: model and cost of the rollouts.
    """
    random = RandomNumbers(seed)
    # The better half and its children, which replace the worse half.
    pool: list[Candidate] = breeding.pool
    half: cython.int = breeding.population
    i: cython.int
    last: Candidate = pool[0]
    last.gains = Gains(start)
    for i in range(1, half):
        if 2 * i < half:
            _mutate(last, pool[i], 1.0, breeding, random)
        else:
            _draw(pool[i], breeding, random)
    parents: list[Candidate] = pool[:half]
    roll_out(parents, 0, situation, rollout)
    at_start: cython.double = last.cost
    _sort(parents)
    pool[:half] = parents
    for _ in range(breeding.generations):
        for i in range(half, 2 * half):
            _cross(_winner(pool, half, random), _winner(pool, half, random), pool[i], random)
            _mutate(pool[i], pool[i], MUTATED, breeding, random)
        roll_out(pool, half, situation, rollout)
        _sort(pool)
    best: Candidate = pool[0]
    if best.cost > at_start * (1.0 - NOTICEABLE) - UNNOTICED:
        return tuple(start), at_start
    return tuple(best.gains.values), best.cost


@cython.cfunc
def _draw(each: Candidate, breeding: Breeding, random: RandomNumbers) -> cython.void:
    """Set a candidate's gains to random ones within the bounds."""
    g: cython.int
    for g in range(_COUNT):
        low: cython.double = breeding.lower.values[g]
        each.gains.values[g] = low + (breeding.upper.values[g] - low) * random.uniform()
    each.gains.complete()


@cython.cfunc
def _cross(one: Candidate, other: Candidate, child: Candidate, random: RandomNumbers) -> cython.void:
    """Set a child's gains to ones on the ways from the worse parent to the better one or as far again beyond it."""
    better: Candidate = one if one.cost < other.cost else other
    worse: Candidate = other if one.cost < other.cost else one
    g: cython.int
    for g in range(_COUNT):
        way: cython.double = better.gains.values[g] - worse.gains.values[g]
        child.gains.values[g] = worse.gains.values[g] + BEYOND * random.uniform() * way


@cython.cfunc
def _mutate(
    source: Candidate, to: Candidate, share: cython.double, breeding: Breeding, random: RandomNumbers
) -> cython.void:
    """Set a candidate's gains to another's, a share of them changed at random, within the bounds."""
    g: cython.int
    for g in range(_COUNT):
        low: cython.double = breeding.lower.values[g]
        high: cython.double = breeding.upper.values[g]
        value: cython.double = source.gains.values[g]
        if random.uniform() < share:
            value += breeding.mutation * (high - low) * random.normal()
        to.gains.values[g] = min(max(value, low), high)
    to.gains.complete()


@cython.cfunc
def _winner(pool: list[Candidate], count: cython.int, random: RandomNumbers) -> Candidate:
    """Return the better of two candidates drawn at random from the first `count`."""
    one: Candidate = cython.cast(Candidate, pool[random.below(count)])
    two: Candidate = cython.cast(Candidate, pool[random.below(count)])
    return one if one.cost < two.cost else two


@cython.cfunc
def _sort(pool: list[Candidate]) -> cython.void:
    """Sort candidates by their cost; equal ones keep their order."""
    i: cython.int
    j: cython.int
    for i in range(1, len(pool)):
        each: Candidate = cython.cast(Candidate, pool[i])
        j = i
        while j > 0 and cython.cast(Candidate, pool[j - 1]).cost > each.cost:
            pool[j] = pool[j - 1]
            j -= 1
        pool[j] = each
