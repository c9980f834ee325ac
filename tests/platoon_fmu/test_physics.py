"""The validated physics: every figure of every manoeuvre, for both versions of FMI, and that each could be missed."""

from __future__ import annotations

import copy
from dataclasses import replace

import numpy as np
import pytest

from platoon_fmu.importer import Instance, Kind, OpenFmu
from platoon_fmu.parameters import VehicleParameters
from platoon_fmu.physics import convergence, energy, reference, stability
from platoon_fmu.physics.circular import circular_driving
from platoon_fmu.physics.coast_down import coast_down
from platoon_fmu.physics.drive import Car, declared_parameters, of_wheels
from platoon_fmu.physics.figure import at_most, between, near
from platoon_fmu.physics.friction_limit import friction_limit
from platoon_fmu.physics.measurements import measure
from platoon_fmu.physics.standstill import standstill
from platoon_fmu.physics.step_steer import response, step_steer
from platoon_fmu.physics.symmetry import mirror_symmetry

P = VehicleParameters()
TABLE = reference.table_stiffness(P)
OVERSTEERING = reference.table_stiffness(P, **stability.LAMBDAS)
MANOEUVRES = {
    "circular": 4,
    "step_steer": 5,
    "coast_down": 2,
    "energy": 2,
    "symmetry": 1,
    "friction": 8,
    "standstill": 4,
    "stability": 4,
    "convergence": 3,
}


@pytest.fixture(scope="module")
def measurements(open_fmu2):
    return measure(open_fmu2)


def figures_of(measurements):
    """The figures of all manoeuvres, by name; as many of each as there should be."""
    figures = {}
    for manoeuvre, count in MANOEUVRES.items():
        found = getattr(measurements, manoeuvre).figures
        assert len({figure.name for figure in found}) == count
        figures.update({figure.name: figure for figure in found})
    return figures


def test_all_figures_are_met(measurements):
    assert [figure for figure in figures_of(measurements).values() if not figure.met] == []


def test_all_figures_are_met_with_fmi_3_and_the_same(measurements, open_fmu3):
    figures = figures_of(measure(open_fmu3))
    assert [figure for figure in figures.values() if not figure.met] == []
    for name, figure in figures_of(measurements).items():
        # Where nothing but rounding is measured the values may differ.
        assert figures[name].measured == pytest.approx(figure.measured, rel=1e-6, abs=1e-13), name


def test_the_analytic_figures_of_table_1():
    assert reference.understeer_gradient(P, TABLE) == pytest.approx(2.709e-3, rel=2e-4)
    assert reference.yaw_rate_gain(P, TABLE, 20.0) == pytest.approx(4.898, rel=2e-4)
    assert reference.critical_speed(P, OVERSTEERING) == pytest.approx(28.14, rel=2e-4)
    assert pytest.approx(0.3256, rel=1e-3) == P.C_a
    assert pytest.approx(P.M * P.g) == 2 * (P.F_zf + P.F_zr)


def test_the_figures_asked_for_are_measured_within_their_tolerances(measurements):
    found = {name: figure.measured for name, figure in figures_of(measurements).items()}
    assert found["Understeer gradient"] == pytest.approx(2.709e-3, rel=0.02)
    assert 0.9 < found["Greatest lateral acceleration over μ g"] < 1.01
    assert found["Yaw-rate gain at 20 m/s"] == pytest.approx(4.898, rel=0.02)
    assert found["Critical speed"] == pytest.approx(28.14, rel=0.02)
    assert found["Deceleration, wheels locked, μ = 0.8"] == pytest.approx((0.8 + 0.018) * 9.8, rel=1e-3)
    assert found["Acceleration, wheels spinning, μ = 0.8"] == pytest.approx((0.8 - 0.018) * 9.8, rel=1e-3)
    assert found["Greatest difference over the greatest value"] < 1e-9
    assert found["Greatest change of any state in 60 s of standing, SI units"] == 0.0
    assert found["Order of the fixed-step solver"] == pytest.approx(4.0, abs=0.5)


@pytest.mark.parametrize(
    ("manoeuvre", "parameter", "factor", "missed"),
    [
        (circular_driving, "C_f", 1.05, {"Understeer gradient", "Understeer gradient, running loads"}),
        (circular_driving, "load_peak", 3.0, {"Understeer gradient, running loads"}),
        (circular_driving, "K_phi", 1.01, {"Roll gradient"}),
        (circular_driving, "mu_a", 0.9, {"Greatest lateral acceleration over μ g"}),
        (
            step_steer,
            "C_r",
            0.93,
            {"Yaw-rate gain at 20 m/s", "Response time to 90 %", "Peak response time", "Overshoot"},
        ),
        (step_steer, "C_phi", 0.8, {"Peak response time"}),
        (step_steer, "I_w", 1.5, {"Response time to 90 %"}),
        (coast_down, "I_w", 1.01, {"Time from 40 to 10 m/s", "Greatest deviation of the speed"}),
        (
            friction_limit,
            "mu_d",
            1.1,
            {"Deceleration, wheels locked, μ = 0.8", "Acceleration, wheels spinning, μ = 0.1"},
        ),
        (friction_limit, "C_d", 2.0, {"Sliding distance from 25 to 2 m/s, μ = 0.8"}),
        (standstill, "I_w", 1.5, {"Speed after 5 s with 200 N m on each wheel"}),
        (stability.oversteer_stability, "C_r", 1.02, {"Critical speed", "Growth rate 4 % above"}),
        (stability.oversteer_stability, "load_peak", 3.0, {"Critical speed, running loads", "Decay rate 4 % below"}),
        (energy.energy_balance, "C_phi", 1.1, {"Energy not accounted for over the throughput"}),
        (energy.energy_balance, "I_w", 2.0, {"Least energy lost in any step of 1 ms over the throughput"}),
    ],
)
def test_another_car_than_expected_misses_the_figures(open_fmu2, manoeuvre, parameter, factor, missed):
    """Expectations of a car that is a little other than the FMU's."""
    figures = manoeuvre(open_fmu2, replace(P, **{parameter: factor * getattr(P, parameter)})).figures
    assert missed <= {figure.name for figure in figures if not figure.met}


def test_a_path_that_is_not_mirrored_would_show(open_fmu2):
    found = mirror_symmetry(open_fmu2)
    assert found.Y[-1] > 10.0
    assert np.abs(found.Y - found.Y_mirrored).max() < 1e-9
    with Car(open_fmu2, {"v_x_start": 25.0, "steering_angle": -0.08}) as car:
        assert car.record(2.0, 0.01, ("Y",))["Y"][-1] < -1.0


# figures


def test_a_figure_is_met_inside_its_band_and_never_where_it_is_no_number():
    def of(measured):
        return near("a", measured, -2.0, relative=0.1, source="")

    assert [of(value).met for value in (-2.2, -1.8, -2.21, -1.79, float("nan"))] == [True, True, False, False, False]
    assert near("a", 1.5, 1.0, absolute=0.5, source="").met
    assert not near("a", 1.5, 1.0, absolute=0.4, source="").met
    assert not near("a", 1.0, float("nan"), relative=0.1, source="").met
    assert between("a", 2.0, 1.0, float("inf"), source="").met
    assert not between("a", 0.5, 1.0, float("inf"), source="").met
    assert not at_most("a", 1.1, 1.0, source="").met


# the references themselves


def test_the_closed_forms_solve_their_equations():
    t = np.linspace(0.0, 60.0, 6001)
    F_roll = P.mu_d * P.M * P.g
    coasting = reference.coast_down_speed(P, 40.0, t)
    pulled = reference.pull_away_speed(P, 3000.0, t)
    for v, force in ((coasting, 0.0), (pulled, 3000.0)):
        slope = (v[2:] - v[:-2]) / (t[2:] - t[:-2])
        expected = (force - F_roll - P.C_a * v[1:-1] ** 2) / reference.effective_mass(P)
        assert slope == pytest.approx(expected, rel=1e-5)
    assert (coasting[0], pulled[0]) == (pytest.approx(40.0), 0.0)
    assert np.interp(-25.0, -coasting, t) == pytest.approx(reference.coast_down_time(P, 40.0, 25.0), rel=1e-6)


def test_the_sliding_distance_is_the_integral_over_speed():
    v = np.linspace(2.0, 25.0, 20001)
    integrand = P.M * v / ((0.8 + P.mu_d) * P.M * P.g + P.C_a * v**2)
    assert reference.sliding_distance(P, 0.8, 25.0, 2.0) == pytest.approx(np.trapezoid(integrand, v), rel=1e-8)


@pytest.mark.parametrize("v", [5.0, 20.0, 40.0])
def test_the_two_track_model_settles_to_the_bicycles_steady_state(v):
    A, B = reference.two_track(P, TABLE, v)
    steady = np.linalg.solve(A, -B)
    assert steady[1] == pytest.approx(reference.yaw_rate_gain(P, TABLE, v), rel=1e-12)
    assert steady[2] / (v * steady[1]) == pytest.approx(reference.roll_gradient(P), rel=1e-12)
    t = np.linspace(0.0, 10.0, 1001)
    assert reference.step_response(A, B, t)[-1] == pytest.approx(steady, rel=1e-6)


def test_the_two_track_model_needs_its_roll(open_fmu2):
    """Were the body not to roll, the response would be another than the FMU's."""
    C = reference.running_stiffness(P)
    t = np.linspace(0.0, 2.0, 2001)
    with_roll = reference.step_response(*reference.two_track(P, C, 20.0), t)[:, 1]
    stiff = reference.step_response(*reference.two_track(replace(P, h_s=1e-6), C, 20.0), t)[:, 1]
    tolerance = step_steer(open_fmu2, P).tolerance
    assert np.abs(with_roll - stiff).max() > 5 * tolerance * with_roll[-1]


@pytest.mark.parametrize("lambdas", [(0.0, 0.0), (1.0, -1.0), (-1.0, 1.0)])
@pytest.mark.parametrize("v", [8.0, 20.0, 45.0])
def test_the_fmu_linearised_has_the_two_track_models_eigenvalues(open_fmu2, v, lambdas):
    expected = np.linalg.eigvals(reference.two_track(P, reference.running_stiffness(P, *lambdas), v)[0])
    with Instance(open_fmu2, Kind.MODEL_EXCHANGE) as model:
        model.start(dict(zip(("lambda_f", "lambda_r"), lambdas, strict=True)))
        found = np.linalg.eigvals(stability.linearised(model, P, v))
    # The FMU has the two load transfers' lags besides.
    for eigenvalue in expected:
        assert np.abs(found - eigenvalue).min() < 1e-4 * abs(eigenvalue)


def test_response_figures_of_a_known_response():
    t = np.linspace(0.0, 40.0, 40001)
    damping, frequency = 0.5, 2.0
    damped = frequency * np.sqrt(1 - damping**2)
    swinging = np.cos(damped * t) + damping / np.sqrt(1 - damping**2) * np.sin(damped * t)
    found = response(t, 3.0 * (1 - np.exp(-damping * frequency * t) * swinging))
    assert found.steady == pytest.approx(3.0, rel=1e-6)
    assert found.peak_time == pytest.approx(np.pi / damped, rel=1e-5)
    assert found.overshoot == pytest.approx(np.exp(-np.pi * damping / np.sqrt(1 - damping**2)), rel=1e-5)
    first_order = response(t, 1 - np.exp(-t))
    assert first_order.rise_time == pytest.approx(np.log(10.0), rel=1e-6)


# the manoeuvres themselves


def test_the_convergence_manoeuvre_is_smooth(open_fmu2):
    names = (*of_wheels("alpha"), *of_wheels("kappa"), *of_wheels("F_z"), *of_wheels("F_x"), *of_wheels("F_y"))
    with Car(open_fmu2, convergence._START) as car:
        trace = car.record(convergence.LONG_S, 0.001, names)
    assert trace.wheels("alpha").min() > 0.0
    assert trace.wheels("kappa")[:, 1:].min() > 0.0
    assert trace.wheels("F_z").min() > 1000.0
    used = np.hypot(trace.wheels("F_x"), trace.wheels("F_y")) / trace.wheels("F_z")
    assert used.max() < 0.95 * P.mu_a


def test_an_fmu_without_a_solvers_parameters_is_measured_by_its_communication_step(open_fmu2):
    description = copy.copy(open_fmu2.description)
    description.modelVariables = [v for v in description.modelVariables if not v.name.startswith("solver")]
    found = convergence.convergence(OpenFmu(open_fmu2.folder, description))
    assert found.order == pytest.approx(4.0, abs=0.5)
    assert found.steps.max() <= 1e-3
    assert len(found.tolerances) == 0
    assert len(found.figures) == 1


def test_tightened_tolerances_lower_the_adaptive_solvers_error(measurements):
    errors = measurements.convergence.adaptive_errors
    assert (np.diff(errors) < 0).all()


def test_work_comes_in_where_it_should(open_fmu2):
    ledgers = {ledger.name: ledger for ledger in energy.energy_balance(open_fmu2, P).ledgers}
    ice, spin, gale = (
        ledgers[name] for name in ("Wheels spun up from rest on ice", "Spin from 30 m/s", "Gale from all sides")
    )
    assert ice.by_torques[-1] > 1e5
    assert not ice.by_forces.any()
    assert not spin.by_torques.any()
    assert not spin.by_forces.any()
    assert abs(gale.by_forces[-1]) > 1e5


def test_declared_parameters_are_the_packages(open_fmu):
    assert declared_parameters(open_fmu) == P
