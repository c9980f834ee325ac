"""The flocking law against its printed formulas, worked values and what it must do by symmetry."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from bench.control import flocking
from bench.control.flocking import Field, Gains, Neighbours, acceleration, bump, offset, sigma_norm

EPS = 0.1
D = 10.0
R = 12.0
FLAT = 0.2
NO_GOAL = np.array([1.0, 2.0, 0.0, 0.0, 0.0, 0.0])

gains = st.builds(
    lambda ga, more, p: np.array([ga, ga + more, *p]),
    st.floats(0.1, 4),
    st.floats(0, 4),
    st.tuples(*[st.floats(0, 4)] * 4),
)
points = st.lists(st.tuples(st.floats(-20, 20), st.floats(-20, 20)), min_size=1, max_size=5).map(np.array)
pair = st.tuples(st.floats(-20, 20), st.floats(-20, 20)).map(np.array)


def law(
    q: np.ndarray,
    p: np.ndarray,
    peers_q: np.ndarray,
    peers_p: np.ndarray,
    q_hat: np.ndarray,
    p_hat: np.ndarray,
    lam: np.ndarray,
    reach: float = R,
    flat: float = FLAT,
) -> np.ndarray:
    field = Field(EPS, D, reach, flat)
    return np.array(acceleration(*q, *p, neighbours(peers_q, peers_p), *q_hat, *p_hat, Gains(lam), field))


def neighbours(peers_q: np.ndarray, peers_p: np.ndarray) -> Neighbours:
    others = Neighbours(len(peers_q))
    for place, (q, p) in enumerate(zip(peers_q, peers_p, strict=True)):
        others.put(place, *q, *p)
    return others


def action(z: float, Ga: float, Gb: float) -> float:
    return flocking.action(z, Ga, Gb, offset(Ga, Gb))


def printed(
    q: np.ndarray,
    p: np.ndarray,
    peers_q: np.ndarray,
    peers_p: np.ndarray,
    q_hat: np.ndarray,
    p_hat: np.ndarray,
    lam: np.ndarray,
) -> np.ndarray:
    """(6)-(10) and (33) written down again, with arrays over the neighbours."""
    Ga, Gb, p11, p12, p21, p22 = lam
    away = peers_q - q
    near = np.linalg.norm(away, axis=1) < R
    away, relative = away[near], (peers_p - p)[near]
    squared = (away**2).sum(axis=1)
    r_a = (np.sqrt(1 + EPS * R**2) - 1) / EPS
    d_a = (np.sqrt(1 + EPS * D**2) - 1) / EPS
    z = (np.sqrt(1 + EPS * squared) - 1) / EPS
    rho = np.where(z / r_a < FLAT, 1.0, (1 + np.cos(np.pi * (z / r_a - FLAT) / (1 - FLAT))) / 2)
    Gc = np.abs(Ga - Gb) / np.sqrt(4 * Ga * Gb)
    sigma_1 = (z - d_a + Gc) / np.sqrt(1 + (z - d_a + Gc) ** 2)
    phi = ((Ga + Gb) * sigma_1 + (Ga - Gb)) / 2
    n = away / np.sqrt(1 + EPS * squared)[:, None]
    gradient = ((rho * phi)[:, None] * n).sum(axis=0)
    consensus = (rho[:, None] * relative).sum(axis=0)
    return gradient + consensus - np.diag([p11, p12]) @ (q - q_hat) - np.diag([p21, p22]) @ (p - p_hat)


def pull(apart: float, lam: np.ndarray = NO_GOAL) -> float:
    """The force towards a neighbour that stands `apart` metres ahead; negative pushes away."""
    zero = np.zeros(2)
    u = law(zero, zero, np.array([[apart, 0.0]]), np.zeros((1, 2)), zero, zero, lam)
    assert u[1] == 0.0
    return float(u[0])


def test_sigma_norm_worked_values() -> None:
    assert sigma_norm(10.0, 0.1) == pytest.approx(10 * (np.sqrt(11) - 1), rel=1e-14)
    assert sigma_norm(10.0, 0.1) == pytest.approx(23.16625, abs=1e-5)
    assert sigma_norm(0.0, 0.1) == 0.0


@given(st.floats(1e-3, 1.0))
def test_sigma_norm_is_quadratic_near_zero_and_linear_far_away(eps: float) -> None:
    assert sigma_norm(0.01, eps) == pytest.approx(0.5 * 0.01**2, rel=1e-4)
    assert sigma_norm(1e8, eps) == pytest.approx(1e8 / np.sqrt(eps), rel=1e-4)


@given(st.floats(0, 100), st.floats(1e-3, 10))
def test_sigma_norm_grows_with_distance(distance: float, more: float) -> None:
    assert sigma_norm(distance + more, EPS) > sigma_norm(distance, EPS)


@given(gains)
def test_action_is_zero_at_zero(lam: np.ndarray) -> None:
    assert action(0.0, lam[0], lam[1]) == pytest.approx(0.0, abs=1e-12)


@given(gains, st.floats(0.01, 30))
def test_action_repels_below_and_attracts_above(lam: np.ndarray, z: float) -> None:
    Ga, Gb = lam[:2]
    assert -Gb < action(-z, Ga, Gb) < 0 < action(z, Ga, Gb) < Ga


@given(st.floats(0.1, 5), st.floats(0, 30))
def test_equal_gains_make_the_action_odd(G: float, z: float) -> None:
    assert action(-z, G, G) == pytest.approx(-action(z, G, G), abs=1e-12)
    assert action(z, G, G) == pytest.approx(G * z / np.sqrt(1 + z * z), abs=1e-12)


def test_action_worked_values() -> None:
    """Ga 1, Gb 4: Gc = 3/4, and sigma_1(3/4) = 3/5, sigma_1(-3/4) = -3/5."""
    assert action(-0.75, 1.0, 4.0) == pytest.approx(-1.5)
    assert action(-1.5, 1.0, 4.0) == pytest.approx(-3.0)


@given(st.floats(0.05, 0.9))
def test_bump_is_flat_then_falls_to_zero_without_a_kink(flat: float) -> None:
    z = np.linspace(0, 1.2, 2401)
    values = np.array([bump(x, flat) for x in z])
    assert (values[z < flat] == 1.0).all()
    assert (values[z > 1.0] == 0.0).all()
    assert (np.diff(values) <= 1e-15).all()
    assert bump(0.5 * (1 + flat), flat) == pytest.approx(0.5)
    # Its steepest slope is pi / (2 (1 - flat)), and its slope itself changes by at most that times pi / (1 - flat).
    step = z[1] - z[0]
    steepest = np.pi / (2 * (1 - flat))
    assert np.abs(np.diff(values)).max() <= steepest * step * (1 + 1e-9)
    assert np.abs(np.diff(values, 2)).max() <= steepest * np.pi / (1 - flat) * step**2 * 1.001 + 1e-12


def test_bump_is_zero_outside_its_domain() -> None:
    assert bump(-0.1, FLAT) == 0.0
    assert bump(1.0, FLAT) == 0.0


@given(gains)
def test_no_force_at_the_wanted_distance(lam: np.ndarray) -> None:
    lam[2:] = 0.0
    assert pull(D, lam) == pytest.approx(0.0, abs=1e-12)


@given(gains, st.floats(0.5, 9.9), st.floats(10.1, 11.9))
def test_too_near_repels_and_too_far_attracts(lam: np.ndarray, near: float, far: float) -> None:
    lam[2:] = 0.0
    assert pull(near, lam) < 0 < pull(far, lam)


@given(gains, st.floats(R, 100))
def test_beyond_reach_there_is_neither_force_nor_consensus(lam: np.ndarray, apart: float) -> None:
    lam[2:] = 0.0
    zero = np.zeros(2)
    peer = np.array([[apart * np.cos(0.3), apart * np.sin(0.3)]])
    # A hair beyond the reach, so that rounding of the distance does not count.
    u = law(zero, zero, 1.000001 * peer, np.array([[5.0, -5.0]]), zero, zero, lam)
    np.testing.assert_array_equal(u, 0.0)


def test_force_fades_out_at_the_reach() -> None:
    assert pull(R - 1e-6) == pytest.approx(0.0, abs=1e-9)


@given(pair, pair, points, pair, pair, gains, st.data())
def test_law_is_the_printed_one(
    q: np.ndarray,
    p: np.ndarray,
    peers_q: np.ndarray,
    q_hat: np.ndarray,
    p_hat: np.ndarray,
    lam: np.ndarray,
    data: st.DataObject,
) -> None:
    n = len(peers_q)
    peers_p = np.array(data.draw(st.lists(st.tuples(*[st.floats(-30, 30)] * 2), min_size=n, max_size=n)))
    np.testing.assert_allclose(
        law(q, p, peers_q, peers_p, q_hat, p_hat, lam),
        printed(q, p, peers_q, peers_p, q_hat, p_hat, lam),
        rtol=1e-9,
        atol=1e-9,
    )


# Whole quarters of a metre, so that a shift changes no rounding at the edge of the reach.
grid = st.integers(-60, 60).map(lambda n: n / 4)
grid_pair = st.tuples(grid, grid).map(np.array)
grid_points = st.lists(st.tuples(grid, grid), min_size=1, max_size=4).map(np.array)


@given(grid_pair, grid_pair, grid_points, grid_pair, grid_pair, gains)
def test_shifting_everything_changes_nothing(
    q: np.ndarray, p: np.ndarray, peers_q: np.ndarray, shift: np.ndarray, boost: np.ndarray, lam: np.ndarray
) -> None:
    zero, peers_p = np.zeros(2), np.tile(p, (len(peers_q), 1)) + 1.0
    there = law(q, p, peers_q, peers_p, zero, zero, lam)
    shifted = law(q + shift, p + boost, peers_q + shift, peers_p + boost, zero + shift, zero + boost, lam)
    np.testing.assert_allclose(shifted, there, rtol=1e-9, atol=1e-9)


@given(grid_pair, grid_pair, grid_points, grid_pair, grid_pair, gains)
def test_mirroring_left_and_right_mirrors_the_answer(
    q: np.ndarray, p: np.ndarray, peers_q: np.ndarray, q_hat: np.ndarray, p_hat: np.ndarray, lam: np.ndarray
) -> None:
    mirror = np.array([1.0, -1.0])
    peers_p = np.tile(p, (len(peers_q), 1)) - 2.0
    plain = law(q, p, peers_q, peers_p, q_hat, p_hat, lam)
    mirrored = law(q * mirror, p * mirror, peers_q * mirror, peers_p * mirror, q_hat * mirror, p_hat * mirror, lam)
    np.testing.assert_allclose(mirrored, plain * mirror, rtol=1e-12, atol=1e-12)


@given(grid_pair, grid_pair, grid_pair, grid_pair, gains)
def test_two_agents_pull_at_each_other_equally(
    q: np.ndarray, p: np.ndarray, other_q: np.ndarray, other_p: np.ndarray, lam: np.ndarray
) -> None:
    lam[2:] = 0.0
    zero = np.zeros(2)
    one = law(q, p, other_q[None], other_p[None], zero, zero, lam)
    other = law(other_q, other_p, q[None], p[None], zero, zero, lam)
    np.testing.assert_allclose(one, -other, rtol=1e-12, atol=1e-12)
