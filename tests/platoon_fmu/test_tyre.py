"""The tyre against its formula in numpy, its initial slopes and the friction circle."""

from __future__ import annotations

import casadi as ca
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from platoon_fmu import tyre

_NAMES = ("kappa", "tan_alpha", "C_x", "C_y", "F_z", "F_z0", "mu", "load_peak")
_symbols = {name: ca.SX.sym(name) for name in _NAMES}
_function = ca.Function("tyre", list(_symbols.values()), list(tyre.forces(**_symbols)))
NOMINAL = {"C_x": 60e3, "C_y": 52.7e3, "F_z": 4500.0, "F_z0": 4500.0, "mu": 0.8, "load_peak": 2.0}


def force(kappa: float, tan_alpha: float, **changes: float) -> tuple[float, float]:
    values = {"kappa": kappa, "tan_alpha": tan_alpha, **NOMINAL, **changes}
    F_x, F_y = _function(*(values[name] for name in _NAMES))
    return float(F_x), float(F_y)


def brush(kappa: float, tan_alpha: float, C_x: float, C_y: float, limit: float) -> np.ndarray:
    """The textbook brush model: parabolic fall-off to the limit at three times the linear force."""
    linear = np.array([C_x * kappa, C_y * tan_alpha])
    f = float(np.hypot(*linear))
    if f == 0:
        return linear
    size = f - f**2 / (3 * limit) + f**3 / (27 * limit**2) if f < 3 * limit else limit
    return linear / f * size


slip = st.floats(-50, 50)


@given(slip, slip, st.floats(0, 12e3), st.floats(0.01, 1.5), st.floats(0.6, 1.4))
def test_never_outside_the_friction_circle(kappa, tan_alpha, F_z, mu, change):
    F_x, F_y = force(kappa, tan_alpha, F_z=F_z, mu=mu, C_y=change * NOMINAL["C_y"])
    # Below the smallest normal number (2e-308) a load has fewer digits than the comparison asks for.
    assert np.hypot(F_x, F_y) <= mu * F_z * (1 + 1e-12) + 1e-307


@given(st.floats(-0.5, 0.5), st.floats(-0.5, 0.5), st.floats(0.05, 1.2))
def test_is_the_brush_model(kappa, tan_alpha, mu):
    expected = brush(kappa, tan_alpha, NOMINAL["C_x"], NOMINAL["C_y"], mu * NOMINAL["F_z"])
    assert force(kappa, tan_alpha, mu=mu) == pytest.approx(expected, rel=1e-9, abs=1e-6)


@given(slip, slip)
def test_force_opposes_the_slip_and_mirrors(kappa, tan_alpha):
    F_x, F_y = force(kappa, tan_alpha)
    assert F_x * kappa >= 0
    assert F_y * tan_alpha >= 0
    assert force(kappa, -tan_alpha) == (F_x, -F_y)
    assert force(-kappa, tan_alpha) == (-F_x, F_y)


def test_initial_slopes_at_static_load():
    h = 1e-8
    assert (force(0, h)[1] - force(0, -h)[1]) / (2 * h) == pytest.approx(NOMINAL["C_y"], rel=1e-6)
    assert (force(h, 0)[0] - force(-h, 0)[0]) / (2 * h) == pytest.approx(NOMINAL["C_x"], rel=1e-6)


def test_load_dependence_is_degressive():
    def slope(n: float) -> float:
        return force(0, 1e-8, F_z=n * NOMINAL["F_z0"])[1] / 1e-8

    light, static, heavy = slope(0.5), slope(1.0), slope(1.5)
    assert light < static < heavy
    assert light + heavy < 2 * static
    assert slope(0.0) == 0.0


def test_sliding_force_is_the_limit_and_pure_slips_saturate():
    assert force(0, 5)[1] == pytest.approx(0.8 * 4500)
    assert force(-1, 0)[0] == pytest.approx(-0.8 * 4500)


@given(st.floats(-60, 60), st.floats(0.5, 10))
def test_regularised_speed(v, v_slip):
    value = float(tyre.regularised_speed(ca.DM(v), v_slip))
    if abs(v) >= v_slip:
        assert value == abs(v)
    else:
        assert value == pytest.approx((v**2 + v_slip**2) / (2 * v_slip))
        assert value >= v_slip / 2 * (1 - 1e-12)


def test_gradient_is_finite_at_rest():
    gradient = ca.jacobian(ca.vertcat(*tyre.forces(**_symbols)), ca.vertcat(*_symbols.values()))
    at = ca.Function("at", list(_symbols.values()), [gradient])
    values = {"kappa": 0.0, "tan_alpha": 0.0, **NOMINAL, "F_z": 0.0}
    assert np.isfinite(np.array(at(*(values[name] for name in _NAMES)))).all()
