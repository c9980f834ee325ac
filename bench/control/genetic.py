# cython: boundscheck=False, wraparound=False, cdivision=True, initializedcheck=False
"""The flocking gains optimised by a genetic algorithm at every planning interval, (34) and (36).

Each candidate Lambda is rolled out with the vehicle's own closed planning model (flocking, near-identity step,
boundaries) while its neighbours move at constant velocity. (34) as printed rewards only the largest speed change
and positive yaw. Here |gamma| is used, and the reward for using the boundaries is weighed against the formation error,
so that the trade-off described in the paper is optimised: fast formation within the boundaries.
"""

from collections.abc import Sequence

import cython

from bench.control.settings import CostWeights, GeneticSettings

if cython.compiled:
    from cython.cimports.bench.control.boundaries import Boundaries, admissible, speed_reach, yaw_rate_max
    from cython.cimports.bench.control.flocking import Field, Gains, Neighbours, acceleration, copied
    from cython.cimports.bench.control.near_identity import input_rates, point, turned, velocity
    from cython.cimports.bench.control.random_numbers import RandomNumbers
    from cython.cimports.libc.math import ceil
else:
    from math import ceil

    from bench.control.boundaries import Boundaries, admissible, speed_reach, yaw_rate_max
    from bench.control.flocking import Field, Gains, Neighbours, acceleration, copied
    from bench.control.near_identity import input_rates, point, turned, velocity
    from bench.control.random_numbers import RandomNumbers

_COUNT = 6


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
        target_x: slot of this vehicle along the road (m); it moves at the platoon's speed.
        target_y: its position to the left (m).
        platoon_speed: m/s.
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
        target: tuple[float, float],
        platoon_speed: float,
        neighbours: Neighbours,
    ) -> None:
        self.X = X
        self.Y = Y
        self.c = c
        self.s = s
        self.v = v
        self.gamma = gamma
        self.target_x, self.target_y = target
        self.platoon_speed = platoon_speed
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
        self.position, self.velocity, self.speed, self.yaw, self.boundary = weights
        self.steps = steps
        self.step_s = step_s


@cython.cclass
class Candidate:
    """One Lambda, and the state of its rollout.

    Attributes:
        gains: Lambda.
        cost: J_1, mean over the horizon.
    """

    def __init__(self, gains: Sequence[float]) -> None:
        self.gains = Gains(gains)
        self.cost = 0.0
        self.X = 0.0
        self.Y = 0.0
        self.c = 1.0
        self.s = 0.0
        self.v = 0.0
        self.gamma = 0.0


@cython.ccall
def roll_out(candidates: list[Candidate], first: cython.int, situation: Situation, rollout: Rollout) -> cython.void:
    """Set the cost of the candidates from number `first` on.

    They are rolled out side by side, step by step: their chains of operations are independent, so that the processor
    works on several at a time.
    """
    count: cython.int = len(candidates)
    i: cython.int
    k: cython.int
    each: Candidate
    for i in range(first, count):
        each = cython.cast(Candidate, candidates[i])
        each.cost = 0.0
        each.X = situation.X
        each.Y = situation.Y
        each.c = situation.c
        each.s = situation.s
        each.v = situation.v
        each.gamma = situation.gamma
    # The Euler step of the yaw rate needs l > v T / 2; the long steps of the horizon are divided accordingly.
    parts: cython.int = cython.cast(cython.int, ceil(situation.v * rollout.step_s / rollout.length)) + 1
    others: Neighbours = copied(situation.neighbours)
    for k in range(rollout.steps):
        ahead: cython.double = situation.platoon_speed * (k * rollout.step_s) + rollout.length
        for i in range(first, count):
            each = cython.cast(Candidate, candidates[i])
            _advance(
                each, others, situation.target_x + ahead, situation.target_y, situation.platoon_speed, parts, rollout
            )
        others.advance(rollout.step_s)
    for i in range(first, count):
        each = cython.cast(Candidate, candidates[i])
        each.cost /= rollout.steps


@cython.cfunc
@cython.exceptval(check=False)
def _advance(
    each: Candidate,
    others: Neighbours,
    q_hat_x: cython.double,
    q_hat_y: cython.double,
    platoon_speed: cython.double,
    parts: cython.int,
    model: Rollout,
) -> cython.void:
    """Roll one candidate out by one step of the horizon, and add its cost."""
    limits: Boundaries = model.limits
    length: cython.double = model.length
    part_s: cython.double = model.step_s / parts
    X: cython.double = each.X
    Y: cython.double = each.Y
    c: cython.double = each.c
    s: cython.double = each.s
    v: cython.double = each.v
    gamma: cython.double = each.gamma
    cost: cython.double = each.cost
    q_x: cython.double
    q_y: cython.double
    p_x: cython.double
    p_y: cython.double
    u_x: cython.double
    u_y: cython.double
    v_rate: cython.double
    gamma_rate: cython.double
    q_x, q_y = point(X, Y, c, s, length)
    p_x, p_y = velocity(c, s, v, gamma, length)
    u_x, u_y = acceleration(q_x, q_y, p_x, p_y, others, q_hat_x, q_hat_y, platoon_speed, 0.0, each.gains, model.field)
    for _ in range(parts):
        v_rate, gamma_rate = input_rates(c, s, v, gamma, length, u_x, u_y)
        asked: cython.double = abs(gamma + part_s * gamma_rate)
        if asked * v > limits.lateral_max:
            over: cython.double = asked - yaw_rate_max(v, limits.mu_g)
            cost += model.boundary * over * over / parts
        v, gamma, _bound = admissible(v, gamma, v_rate, gamma_rate, part_s, limits)
        X += part_s * v * c
        Y += part_s * v * s
        c, s = turned(c, s, part_s * gamma)
    unused_speed: cython.double = v - speed_reach(each.v, v >= each.v, model.step_s, limits)
    unused_yaw: cython.double = abs(gamma) - yaw_rate_max(v, limits.mu_g)
    e_x: cython.double = q_x - q_hat_x
    e_y: cython.double = q_y - q_hat_y
    w_x: cython.double = p_x - platoon_speed
    cost += model.position * (e_x * e_x + e_y * e_y) + model.velocity * (w_x * w_x + p_y * p_y)
    cost += model.speed * unused_speed * unused_speed + model.yaw * unused_yaw * unused_yaw
    each.X = X
    each.Y = Y
    each.c = c
    each.s = s
    each.v = v
    each.gamma = gamma
    each.cost = cost


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

    def middle(self) -> tuple[float, ...]:
        """Return the gains in the middle of the bounds, with Gb raised to Ga where it is below it."""
        middle = Gains([0.5 * (low + high) for low, high in zip(self.lower.values, self.upper.values, strict=True)])
        return tuple(middle.values)


def search(
    start: Sequence[float], seed: int, breeding: Breeding, situation: Situation, rollout: Rollout
) -> tuple[tuple[float, ...], float]:
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
    random = RandomNumbers(seed)
    pool: list[Candidate] = [Candidate(start) for _ in range(breeding.population)]
    spare: list[Candidate] = [Candidate(start) for _ in range(breeding.population)]
    i: cython.int
    for i in range(1, breeding.population):
        _draw(pool[i], breeding, random)
    roll_out(pool, 0, situation, rollout)
    for _ in range(breeding.generations):
        _breed(pool, spare, breeding, random)
        roll_out(spare, 2, situation, rollout)
        pool, spare = spare, pool
    best: Candidate = pool[_best(pool, -1)]
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
def _breed(pool: list[Candidate], bred: list[Candidate], breeding: Breeding, random: RandomNumbers) -> cython.void:
    """Make the next generation: the two best, and children of parents selected by tournaments of two."""
    i: cython.int
    g: cython.int
    first: cython.int = _best(pool, -1)
    second: cython.int = _best(pool, first)
    _copy(pool[first], bred[0])
    _copy(pool[second], bred[1])
    for i in range(2, breeding.population):
        mother: Candidate = _winner(pool, random)
        father: Candidate = _winner(pool, random)
        child: Candidate = bred[i]
        for g in range(_COUNT):
            low: cython.double = breeding.lower.values[g]
            high: cython.double = breeding.upper.values[g]
            share: cython.double = random.uniform()
            value: cython.double = share * mother.gains.values[g] + (1.0 - share) * father.gains.values[g]
            value += breeding.mutation * (high - low) * random.normal()
            child.gains.values[g] = min(max(value, low), high)
        child.gains.complete()


@cython.cfunc
def _winner(pool: list[Candidate], random: RandomNumbers) -> Candidate:
    """Return the better of two candidates drawn at random."""
    one: Candidate = pool[random.below(len(pool))]
    two: Candidate = pool[random.below(len(pool))]
    return one if one.cost < two.cost else two


@cython.cfunc
def _best(pool: list[Candidate], without: cython.int) -> cython.int:
    """Return the number of the best candidate other than number `without`."""
    i: cython.int
    best: cython.int = 1 if without == 0 else 0
    for i in range(len(pool)):
        if i != without and cython.cast(Candidate, pool[i]).cost < cython.cast(Candidate, pool[best]).cost:
            best = i
    return best


@cython.cfunc
def _copy(source: Candidate, to: Candidate) -> cython.void:
    g: cython.int
    for g in range(_COUNT):
        to.gains.values[g] = source.gains.values[g]
    to.gains.complete()
    to.cost = source.cost
