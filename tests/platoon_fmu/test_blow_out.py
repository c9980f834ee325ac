"""Tyres that lose their pressure: what a blow-out at one wheel does to the car, and nothing where all are sound."""

from __future__ import annotations

from dataclasses import fields, replace

import numpy as np
import pytest
from scipy.optimize import brentq

from platoon_fmu import interface
from platoon_fmu.importer import Kind
from platoon_fmu.parameters import VehicleParameters
from platoon_fmu.physics import energy

P = VehicleParameters()
WHEELS = ("fl", "rl", "rr", "fr")
UNKNOWNS = [v.name for v in (*interface.STATES, *interface.DERIVATIVES, *interface.OUTPUTS)]
OF_FLAT_TYRES = ["K_z", *(field.name for field in fields(P) if field.name.startswith("flat_"))]
ON_SOFT_TYRES = [each for each in energy.MANOEUVRES if "inflation_fl" in each.start]


def flat(*wheels: str) -> dict[str, float]:
    return {f"inflation_{wheel}": 0.0 for wheel in wheels}


@pytest.fixture
def straight(make_car):
    """A function that drives straight on from 20 m/s for a time, wheels rolling freely, with some tyres flat."""

    def drive(seconds, *wheels):
        car = make_car().start(v_x_start=20.0)
        car.set(flat(*wheels))
        car.run(seconds)
        return car

    return drive


def test_tyres_are_sound_unless_told_otherwise(make_any):
    car = make_any().start()
    assert car.wheels("inflation").tolist() == [1.0] * 4


@pytest.mark.parametrize("name", OF_FLAT_TYRES)
def test_sound_tyres_do_not_depend_on_what_a_flat_one_is_like(make_any, name):
    """Not by a bit."""
    rows = []
    for value in (getattr(P, name), 0.7 * getattr(P, name)):
        car = make_any().start(**{name: value}, v_x_start=22.0, v_y_start=0.5)
        car.torque(300.0, -100.0, 50.0, -900.0)
        car.set(steering_angle=-0.04, lambda_f=0.3)
        rows.append(car.run(1.0, names=UNKNOWNS))
    assert rows[0].tobytes() == rows[1].tobytes()
    assert np.abs(rows[0]).max() > 100.0


@pytest.mark.parametrize(("wheel", "side"), [("fl", 1), ("rl", 1), ("rr", -1), ("fr", -1)])
def test_the_car_turns_to_the_side_of_the_flat_tyre(straight, wheel, side):
    car = straight(1.0, wheel)
    assert side * car["gamma"] > 0.01
    assert side * car["Y"] > 0.1
    assert side * car["phi"] < -0.01


def test_a_flat_tyre_brakes_by_its_rolling_resistance(straight):
    car, sound = straight(1.0, "fl"), straight(1.0)
    drag = P.flat_rolling * car["F_z_fl"]
    # The wheels are slowed too: the road takes up a little more at the flat one, and less at the others.
    assert car["F_x_fl"] == pytest.approx(-drag, rel=0.03)
    more = (car["a_x"] - sound["a_x"]) * (P.M + 4 * P.I_w / P.R_w**2)
    assert more == pytest.approx(-drag, rel=0.03)


@pytest.mark.parametrize(("wheel", "side"), [("fl", 1), ("rl", 1), ("rr", -1), ("fr", -1)])
def test_its_drag_turns_the_car(make_car, wheel, side):
    """As soon as its wheel turns steadily, and while the car runs straight on, there is no other yaw moment."""
    car = make_car(Kind.MODEL_EXCHANGE).start(v_x_start=20.0, **flat(wheel))
    x, spin = car.states(), car.state_names.index(f"omega_{wheel}")

    def spin_up(omega):
        x[spin] = omega
        car.set_states(x)
        return car[f"der(omega_{wheel})"]

    spin_up(brentq(spin_up, 50.0, 80.0, xtol=1e-12))
    moment = side * P.l_t / 2 * P.flat_rolling * car[f"F_z_{wheel}"]
    assert car["der(gamma)"] * P.I_z == pytest.approx(moment, rel=1e-6)
    assert abs(moment) > 600.0


def test_a_steady_wheel_has_the_torque_of_its_drag(make_car):
    car = make_car().start(v_x_start=20.0)
    car.set(flat("rr"))
    radius = P.flat_radius * P.R_w
    for _ in range(500):
        car.torque(0.0, 0.0, P.flat_rolling * radius * car["F_z_rr"], 0.0)
        car.step()
    assert car["F_x_rr"] == pytest.approx(0.0, abs=20.0)
    assert radius * car["omega_rr"] == pytest.approx(car["v_x"], rel=1e-3)


@pytest.mark.parametrize("wheel", WHEELS)
@pytest.mark.parametrize("inflation", [0.0, 0.5])
def test_stiffnesses_fall_to_what_is_left_of_them(make_car, wheel, inflation):
    """Forces over small slips, over the stiffness that a sound tyre has under the same load."""
    car = make_car(Kind.MODEL_EXCHANGE).start()
    x = dict.fromkeys(car.state_names, 0.0)
    x |= {"v_x": 20.0, "v_y": -1e-4, **dict.fromkeys((f"omega_{w}" for w in WHEELS), 20.0 / P.R_w)}
    car.set({f"inflation_{wheel}": inflation})
    radius = P.R_w * (1 - (1 - P.flat_radius) * (1 - inflation))
    x[f"omega_{wheel}"] = 20.0 * (1 + 1e-5) / radius
    car.set_states(list(x.values()))
    front = wheel.startswith("f")
    n = car[f"F_z_{wheel}"] / (P.F_zf if front else P.F_zr)
    grown = n * (P.load_peak**2 + 1) / (P.load_peak**2 + n**2)
    C_y, C_x = (P.C_f if front else P.C_r) * grown, P.C_x * grown
    left_y, left_x = ((1 - (1 - q) * (1 - inflation)) for q in (P.flat_cornering, P.flat_longitudinal))
    assert car[f"F_y_{wheel}"] / 5e-6 == pytest.approx(left_y * C_y, rel=1e-3)
    assert car[f"F_x_{wheel}"] / 1e-5 == pytest.approx(left_x * C_x, rel=1e-3)


def standing(inflation: dict[str, float]) -> tuple[list[float], float]:
    """Loads of a standing car [N], in the order of WHEELS, and its roll angle [rad].

    From the equilibrium of body, two axles with roll springs and four tyres: linear equations in phi, the axles' tilts
    and the loads that they move from left to right.
    """
    soft = {
        w: 1 / (P.K_z * (P.flat_vertical + (1 - P.flat_vertical) * inflation.get(w, 1.0))) - 1 / P.K_z for w in WHEELS
    }
    K = {"f": P.roll_share_f * P.K_phi, "r": (1 - P.roll_share_f) * P.K_phi}
    load = {"f": P.F_zf, "r": P.F_zr}
    # Unknown: phi, tilt_f, tilt_r, moved_f, moved_r.
    A, b = np.zeros((5, 5)), np.zeros(5)
    A[0, 0], A[0, 3:] = P.m_s * P.g * P.h_s, -P.l_t
    for row, axle in ((1, "f"), (2, "r")):
        A[row, [0, row, row + 2]] = K[axle], -K[axle], -P.l_t
        left, right = soft[f"{axle}l"], soft[f"{axle}r"]
        A[row + 2, [row, row + 2]] = P.l_t, -(left + right)
        b[row + 2] = load[axle] * (right - left)
    phi, _, _, moved_f, moved_r = np.linalg.solve(A, b)
    return [P.F_zf - moved_f, P.F_zr - moved_r, P.F_zr + moved_r, P.F_zf + moved_f], phi


@pytest.mark.parametrize(
    "inflation", [{"fl": 0.0}, {"rr": 0.0}, {"fl": 0.0, "fr": 0.0}, {"rl": 0.3, "rr": 0.7, "fr": 0.1}, {}]
)
def test_loads_of_a_standing_car_are_those_of_its_springs(make_car, inflation):
    car = make_car().start()
    car.set({f"inflation_{wheel}": value for wheel, value in inflation.items()})
    car.run(10.0)
    loads, phi = standing(inflation)
    assert car.wheels("F_z") == pytest.approx(loads, rel=1e-6)
    assert car["phi"] == pytest.approx(phi, abs=1e-9)
    assert sum(car.wheels("F_z")) == pytest.approx(P.M * P.g)


def test_load_moves_from_the_flat_tyre_and_its_diagonal_which_brings_the_rim_down():
    (fl, rl, rr, fr), _ = standing({"fl": 0.0})
    assert fl < 0.9 * P.F_zf
    assert rr < 0.9 * P.F_zr
    assert fr > 1.1 * P.F_zf
    assert rl > 1.1 * P.F_zr
    # Between the tread and the rim of a 195/65 R15 there are 0.13 m less the sidewalls folded up.
    assert 0.08 < fl / (P.flat_vertical * P.K_z) < 0.12


def test_in_a_bend_the_flat_tyre_gives_up_most_of_its_lateral_force(make_car):
    forces = {}
    for wheels in ((), ("fr",)):
        car = make_car().start(v_x_start=20.0)
        car.cruise(5.0, 20.0, steering_angle=0.02, **flat(*wheels))
        forces[wheels] = car.wheels("F_y")
        path = car["gamma"]
        assert path > 0.02
    assert forces[("fr",)][3] < 0.45 * forces[()][3]


@pytest.mark.parametrize("wheel", WHEELS)
def test_is_smooth_from_sound_to_flat(make_car, wheel):
    """Where a kink is, second differences over the step squared grow as steps become smaller."""
    car = make_car(Kind.MODEL_EXCHANGE).start(v_x_start=20.0, v_y_start=0.2, gamma_start=0.1)
    names = [v.name for v in (*interface.DERIVATIVES, *interface.OUTPUTS)]
    curvature = []
    for count in (401, 1601):
        rows = []
        for inflation in np.linspace(0.0, 1.0, count):
            car.set({f"inflation_{wheel}": float(inflation)})
            rows.append(car.get(*names))
        curvature.append(np.abs(np.diff(rows, n=2, axis=0)).max(axis=0) * (count - 1) ** 2)
    coarse, fine = curvature
    assert (fine <= 1.2 * coarse + 1e-3 * np.abs(rows).max(axis=0)).all()
    assert fine.max() > 1.0


def test_a_locked_flat_wheel_has_friction_only(make_car):
    car = make_car().start(v_x_start=20.0)
    car.set(flat("fl"))
    car.torque(-4000.0, 0.0, 0.0, 0.0)
    car.run(0.05)
    car.torque(-1200.0, 0.0, 0.0, 0.0)
    for _ in range(100):
        car.step(0.001)
        assert np.hypot(car["F_x_fl"], car["F_y_fl"]) <= P.mu_a * car["F_z_fl"] * (1 + 1e-9)


@pytest.mark.parametrize("speed", [3.0, -3.0])
def test_rolls_out_to_rest_without_chatter(make_car, speed):
    car = make_car().start(v_x_start=speed)
    car.set(flat("fl", "rl"), inflation_fr=0.4)
    speeds = np.abs(car.run(30.0, names=["v_x"])[:, 0])
    assert (np.diff(speeds) < 1e-9).all()
    assert speeds[-1] < 1e-6
    assert np.abs(car.wheels("omega")).max() < 1e-6


@pytest.mark.parametrize("manoeuvre", ON_SOFT_TYRES, ids=lambda manoeuvre: manoeuvre.name)
def test_no_energy_comes_from_soft_tyres_and_all_is_accounted_for(open_fmu2, manoeuvre):
    found = energy.ledger(open_fmu2, P, manoeuvre)
    assert found.least_loss > -1e-12
    assert found.residual < 1e-5
    assert found.dissipated[-1] > 0.3 * found.throughput


@pytest.mark.parametrize("name", OF_FLAT_TYRES)
def test_energy_is_accounted_for_by_the_flat_tyres_that_there_are(open_fmu2, name):
    """Slip stiffnesses are in the forces that the FMU gives; all else would show."""
    other = replace(P, **{name: 0.9 * getattr(P, name)})
    residual = max(energy.ledger(open_fmu2, other, manoeuvre).residual for manoeuvre in ON_SOFT_TYRES)
    assert (residual > 1e-5) is (name not in ("flat_cornering", "flat_longitudinal"))


@pytest.mark.parametrize("solver", [1, 2])
def test_a_blow_out_at_speed_is_no_trouble_for_the_solvers(make_car, solver):
    car = make_car().start(v_x_start=40.0, solver=solver)
    car.set(steering_angle=0.01)
    car.run(0.5)
    car.set(flat("fr"))
    car.run(3.0)
    assert np.isfinite(car.get(*UNKNOWNS)).all()
    assert 10.0 < car["v_x"] < 40.0
