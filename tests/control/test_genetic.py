"""The genetic search: reproducible, never worse than what it starts from, and on the cost that is meant."""

import math
from dataclasses import replace
from itertools import pairwise
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from pydantic import TypeAdapter, ValidationError

from bench.control.boundaries import Boundaries, admissible, boundaries
from bench.control.flocking import GAINS, Field, Gains, Neighbours, acceleration
from bench.control.genetic import Breeding, Candidate, Rollout, Situation, roll_out, search
from bench.control.near_identity import input_rates
from bench.control.settings import CostWeights, GeneticSettings
from platoon_fmu.parameters import VehicleParameters

GA, GB = GAINS.index("Ga"), GAINS.index("Gb")
LENGTH = 0.9
SPEED = 20.0
LIMITS = boundaries(VehicleParameters(), 0.8, 0.7, 3.0, 1.5, 5.0, 45.0)
FIELD = Field(eps=0.1, distance=10.0, reach=12.0, flat=0.2)
STATE = np.array([1.0, 0.5, 0.05, 18.0, 0.02])
TARGET = np.array([4.0, 3.5])
TARGET_V = np.array([SPEED, 0.3])
TARGET_A = np.array([0.4, -0.6])
"""The navigation target: its point S, velocity and acceleration, which is constant here."""

PEERS_Q = np.array([[9.0, 3.0], [-8.0, 0.0]])
PEERS_P = np.array([[21.0, 0.3], [19.0, -0.2]])
LAMBDA = np.array([1.0, 2.0, 0.8, 1.1, 1.9, 2.3])

only = {
    term: CostWeights(**{name: float(name == term) for name in CostWeights._fields}) for term in CostWeights._fields
}
"""For each term of the cost, the weights that leave it alone."""


def targets(steps: int = 25, step_s: float = 0.04) -> np.ndarray:
    """The navigation target at the steps of the horizon, (steps, 6): point, velocity, acceleration."""
    t = step_s * np.arange(steps)[:, None]
    S = TARGET + [LENGTH, 0.0] + t * (TARGET_V + 0.5 * t * TARGET_A)
    return np.hstack([S, TARGET_V + t * TARGET_A, np.broadcast_to(TARGET_A, S.shape)])


def situation(
    state: np.ndarray,
    peers_q: np.ndarray = PEERS_Q,
    peers_p: np.ndarray = PEERS_P,
    target: np.ndarray | None = None,
) -> Situation:
    X, Y, theta, v, gamma = state.tolist()
    others = neighbours(peers_q, peers_p)
    places = targets() if target is None else target
    return Situation(X, Y, math.cos(theta), math.sin(theta), v, gamma, places.ravel(), others)


def neighbours(peers_q: np.ndarray, peers_p: np.ndarray) -> Neighbours:
    others = Neighbours(len(peers_q))
    for place, (q, p) in enumerate(zip(peers_q, peers_p, strict=True)):
        others.put(place, *q, *p)
    return others


def rollout(chosen: GeneticSettings, weights: CostWeights | None = None) -> Rollout:
    weights = weights or chosen.weights()
    return Rollout(FIELD, LIMITS, LENGTH, weights, chosen.horizon_steps, chosen.horizon_step_s)


def cost(
    gains: np.ndarray = LAMBDA,
    state: np.ndarray = STATE,
    peers_q: np.ndarray = PEERS_Q,
    peers_p: np.ndarray = PEERS_P,
    weights: CostWeights | None = None,
) -> float:
    """The compiled cost at one point."""
    return costs([gains], situation(state, peers_q, peers_p), rollout(GeneticSettings(), weights))[0]


def costs(many: list[np.ndarray], where: Situation, judged: Rollout) -> list[float]:
    candidates = [Candidate(gains) for gains in many]
    roll_out(candidates, 0, where, judged)
    return [each.cost for each in candidates]


def find(chosen: GeneticSettings, seed: int, start: np.ndarray | None = None) -> tuple[np.ndarray, float]:
    """A search at the same point."""
    lower, upper = chosen.bounds()
    first = 0.5 * (lower + upper) if start is None else start
    gains, found = search(first, seed, Breeding(chosen), situation(STATE), rollout(chosen))
    return np.array(gains), found


def planned_motion(
    state: np.ndarray, steps: int, step_s: float, limits: Boundaries = LIMITS
) -> list[tuple[np.ndarray, float, float]]:
    """States X, Y, theta, v, gamma at the steps of the horizon, and the squares of two excesses.

    The first is how much more yaw rate was asked for than the boundary allows, the second how much acceleration beside
    that of the target.

    The closed planning model in plain Python, from the statement: the flocking acceleration of the point is held for
    a step, which is integrated in parts short enough for the near-identity length at the speed of the start.
    """
    parts = math.ceil(state[3] * step_s / LENGTH) + 1
    motion = [(state, 0.0, 0.0)]
    for k, target in enumerate(targets(steps, step_s)):
        X, Y, theta, v, gamma = motion[-1][0]
        heading, left = np.array([math.cos(theta), math.sin(theta)]), np.array([-math.sin(theta), math.cos(theta)])
        u = acceleration(
            *(np.array([X, Y]) + LENGTH * heading),
            *(v * heading + LENGTH * gamma * left),
            neighbours(PEERS_Q + k * step_s * PEERS_P, PEERS_P),
            *target[:4],
            Gains(LAMBDA),
            FIELD,
        )
        asked = float(np.sum(np.square(u)))
        u = np.add(u, target[4:])
        too_much = 0.0
        for _ in range(parts):
            dt = step_s / parts
            v_rate, gamma_rate = input_rates(math.cos(theta), math.sin(theta), v, gamma, LENGTH, *u)
            too_much += max(abs(gamma + dt * gamma_rate) - 0.85 * 7.84 / v, 0.0) ** 2 / parts
            v, gamma, _ = admissible(v, gamma, v_rate, gamma_rate, dt, limits)
            X, Y = X + dt * v * math.cos(theta), Y + dt * v * math.sin(theta)
            theta += dt * gamma
        motion.append((np.array([X, Y, theta, v, gamma]), too_much, asked))
    return motion


def plain_costs(state: np.ndarray, steps: int, step_s: float, limits: Boundaries = LIMITS) -> dict[str, float]:
    """Each term of the cost with weight one, from the planned motion."""
    motion = planned_motion(state, steps, step_s, limits)
    X, Y, theta, v, gamma = np.array([s for s, _, _ in motion]).T
    S = np.array([X + LENGTH * np.cos(theta), Y + LENGTH * np.sin(theta)])
    W = np.array(
        [
            v * np.cos(theta) - LENGTH * gamma * np.sin(theta),
            v * np.sin(theta) + LENGTH * gamma * np.cos(theta),
        ]
    )
    target = targets(steps, step_s).T
    before, after = slice(None, -1), slice(1, None)
    speeding_up = v[after] >= v[before]
    furthest = v[before] + step_s * np.where(speeding_up, 9.8 * 1.6 / 0.54, -9.8 * 1.4 / 0.54)
    return {
        "position": ((S[:, before] - target[:2]) ** 2).sum(axis=0).mean(),
        "velocity": ((W[:, before] - target[2:4]) ** 2).sum(axis=0).mean(),
        "speed": ((v[after] - furthest) ** 2).mean(),
        "yaw": ((np.abs(gamma[after]) - 0.85 * 7.84 / v[after]) ** 2).mean(),
        "boundary": sum(too_much for _, too_much, _ in motion[1:]) / steps,
        "comfort": sum(asked for _, _, asked in motion[1:]) / steps,
    }


@pytest.mark.parametrize("term", only)
@pytest.mark.parametrize(
    "state", [STATE, np.array([1.0, -6.0, -0.3, 25.0, 0.2]), np.array([10.0, 3.0, 0.1, 12.0, -0.1])]
)
def test_each_term_of_the_cost_is_the_one_stated(term: str, state: np.ndarray) -> None:
    expected = plain_costs(state, 25, 0.04)[term]
    assert cost(weights=only[term], state=state) == pytest.approx(expected, rel=1e-9, abs=1e-12)


def test_rollouts_may_turn_by_large_angles() -> None:
    """At walking pace a step turns by more than the angles for which the series is used."""
    slow = boundaries(VehicleParameters(), 0.8, 0.7, 3.0, 1.5, 0.5, 45.0)
    state = np.array([3.0, 3.0, 0.3, 0.6, 3.0])
    where = Situation(
        3.0, 3.0, math.cos(0.3), math.sin(0.3), 0.6, 3.0, targets(10, 0.1).ravel(), neighbours(PEERS_Q, PEERS_P)
    )
    judged = Rollout(FIELD, slow, LENGTH, GeneticSettings().weights(), 10, 0.1)
    expected = plain_costs(state, 10, 0.1, slow)
    turn = [other[0][2] - one[0][2] for one, other in pairwise(planned_motion(state, 10, 0.1, slow))]
    assert max(turn) > 2 * 0.1, "two parts of a step"
    total = sum(w * expected[term] for w, term in zip(GeneticSettings().weights(), CostWeights._fields, strict=True))
    assert costs([LAMBDA], where, judged)[0] == pytest.approx(total, rel=1e-9)


@pytest.mark.parametrize("far", [[300.0, 0.0], [-40.0, 3.5], [4.0, -30.0]])
def test_vehicles_out_of_reach_do_not_matter(far: list[float]) -> None:
    more_q, more_p = np.vstack([PEERS_Q, far]), np.vstack([PEERS_P, [20.0, 0.0]])
    assert cost(peers_q=more_q, peers_p=more_p) == cost()


def test_a_vehicle_that_comes_within_reach_matters() -> None:
    more_q, more_p = np.vstack([PEERS_Q, [40.0, 3.0]]), np.vstack([PEERS_P, [-10.0, 0.0]])
    assert cost(peers_q=more_q, peers_p=more_p) != cost()


def test_boundary_term_is_met_at_these_points() -> None:
    """The comparison above would mean nothing for this term if no rollout asked for too much yaw rate."""
    assert plain_costs(np.array([1.0, -6.0, -0.3, 25.0, 0.2]), 25, 0.04)["boundary"] > 0


def test_cost_is_the_weighted_sum_of_its_terms() -> None:
    weights = GeneticSettings().weights()
    total = sum(w * cost(weights=only[term]) for w, term in zip(weights, weights._fields, strict=True))
    assert cost() == pytest.approx(total, rel=1e-12)


def test_formed_platoon_has_no_formation_error() -> None:
    state = np.array([4.0, 3.5, 0.0, SPEED, 0.0])
    nobody = np.zeros((0, 2))
    weights = only["position"]._replace(velocity=1.0, comfort=1.0)
    slot = np.tile([0.0, TARGET[1], SPEED, 0.0, 0.0, 0.0], (25, 1))
    slot[:, 0] = TARGET[0] + LENGTH + 0.04 * SPEED * np.arange(25)
    where = situation(state, nobody, nobody, slot)
    assert costs([LAMBDA], where, rollout(GeneticSettings(), weights))[0] == pytest.approx(0.0, abs=1e-18)


def test_a_situation_can_be_used_again() -> None:
    where = situation(STATE)
    assert costs([LAMBDA], where, rollout(GeneticSettings())) == costs([LAMBDA], where, rollout(GeneticSettings()))


@given(st.lists(st.lists(st.floats(0.5, 3.0), min_size=6, max_size=6).map(np.array), min_size=1, max_size=20))
def test_candidates_rolled_out_side_by_side_do_not_affect_each_other(many: list[np.ndarray]) -> None:
    where, model = situation(STATE), rollout(GeneticSettings())
    assert costs(many, where, model) == [costs([gains], where, model)[0] for gains in many]


def test_same_seed_gives_the_same_answer() -> None:
    one, other = find(GeneticSettings(), 7), find(GeneticSettings(), 7)
    np.testing.assert_array_equal(one[0], other[0])
    assert one[1] == other[1]


def test_seeds_differ() -> None:
    found = {find(GeneticSettings(), seed)[0].tobytes() for seed in range(5)}
    assert len(found) == 5


seeds = st.integers(0, 2**32 - 1)
places = st.lists(st.floats(0, 1), min_size=6, max_size=6).map(np.array)


@settings(max_examples=40)
@given(seeds, places, st.integers(4, 30), st.integers(1, 6))
def test_answer_is_never_worse_than_the_start_and_inside_the_bounds(
    seed: int, place: np.ndarray, population: int, generations: int
) -> None:
    chosen = GeneticSettings(population=population, generations=generations)
    lower, upper = chosen.bounds()
    start = lower + place * (upper - lower)
    start[GB] = max(start[GA], start[GB])
    gains, found = find(chosen, seed, start)
    assert found <= cost(start)
    assert found == pytest.approx(cost(gains), rel=1e-12)
    assert (gains >= lower).all()
    assert (gains <= upper).all()
    assert gains[GB] >= gains[GA]


def test_an_answer_that_is_hardly_better_leaves_the_gains_as_they_are() -> None:
    gains, first = find(GeneticSettings(generations=20, population=40), 1)
    again, second = find(GeneticSettings(), 2, gains)
    np.testing.assert_array_equal(again, gains)
    assert second == pytest.approx(first)


def test_search_finds_better_gains_than_the_middle() -> None:
    lower, upper = GeneticSettings().bounds()
    assert find(GeneticSettings(), 1)[1] < cost(0.5 * (lower + upper))


def test_more_generations_are_never_worse() -> None:
    found = [find(GeneticSettings(generations=n), 3)[1] for n in (1, 2, 4, 8)]
    assert found == sorted(found, reverse=True)


@pytest.mark.parametrize("name", ["ga", "gb", "p11", "p12", "p21", "p22"])
def test_bounds_the_wrong_way_round_are_refused(name: str) -> None:
    with pytest.raises(ValueError, match=rf"{name} = \[9\.0, 8\.0\]"):
        replace(GeneticSettings(gb=(0.5, 20.0)), **{name: (9.0, 8.0)})


def test_ga_that_gb_cannot_reach_is_refused() -> None:
    """Gb is raised to Ga where it is below it, which must not take it out of its own bounds."""
    with pytest.raises(ValueError, match="gb"):
        GeneticSettings(ga=(0.5, 3.0), gb=(0.5, 2.0))


@pytest.mark.parametrize(
    "wrong",
    [
        {"population": 3},
        {"population": 201},
        {"generations": 0},
        {"horizon_steps": 1},
        {"horizon_step_s": 0.0},
        {"horizon_step_s": 0.2},
        {"mutation": 0.0},
        {"ga": (0.0, 1.0)},
        {"gb": (1.0, 21.0)},
        {"yaw_weight": -1.0},
    ],
)
def test_values_out_of_range_are_refused(wrong: dict[str, Any]) -> None:
    with pytest.raises(ValidationError, match=next(iter(wrong))):
        TypeAdapter(GeneticSettings).validate_python(wrong)


def test_bounds_and_weights_come_in_the_documented_order() -> None:
    chosen = GeneticSettings(
        ga=(1, 2), gb=(3, 4), p11=(5, 6), p12=(7, 8), p21=(9, 10), p22=(11, 12),
        position_weight=1, velocity_weight=2, speed_weight=3, yaw_weight=4, boundary_weight=5,
        comfort_weight=6,
    )  # fmt: skip
    lower, upper = chosen.bounds()
    assert lower.tolist() == [1, 3, 5, 7, 9, 11]
    assert upper.tolist() == [2, 4, 6, 8, 10, 12]
    assert chosen.weights() == CostWeights(position=1, velocity=2, speed=3, yaw=4, boundary=5, comfort=6)
