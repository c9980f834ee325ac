"""Sections on lateral manoeuvres: circular driving, step steer, the oversteering car."""

from __future__ import annotations

import numpy as np

from platoon_fmu.physics import circular as circular_test
from platoon_fmu.physics import stability as stability_test
from platoon_fmu.physics import step_steer as step_test
from platoon_fmu.physics.measurements import Measurements
from platoon_fmu.physics.numbers import bound
from platoon_fmu.physics.plot import BLUE, INK, ORANGE, Curve, Plot
from platoon_fmu.physics.reference import roll_gradient, running_stiffness, understeer_gradient
from platoon_fmu.physics.sections.section import Section

_DEGREES = 180 / np.pi


def circular(m: Measurements) -> Section:
    """Steady-state circular driving."""
    P, c = m.P, m.circular
    K_us = understeer_gradient(P, running_stiffness(P))
    a_y = np.array([0.0, P.mu_a * P.g])
    line = (P.L / circular_test.SPEED**2 + K_us) * a_y
    angles = Plot(
        "Steering angle over lateral acceleration",
        "lateral acceleration a_y [m/s²]",
        "steering angle δ [°]",
        (
            Curve("FMU", c.a_y, c.delta * _DEGREES, BLUE, dots=True),
            Curve("linear: L/R + K_us a_y", a_y, line * _DEGREES, INK, dash=True),
        ),
        caption=f"K_us = {K_us:.4g} s²/m is {K_us * _DEGREES * P.g:.3g}° per g. Road-wheel angles throughout.",
    )
    slips = Plot(
        "Mean slip angles of the axles",
        "lateral acceleration a_y [m/s²]",
        "slip angle [°]",
        (
            Curve("front", c.a_y, c.alpha_f * _DEGREES, BLUE, dots=True),
            Curve("rear", c.a_y, c.alpha_r * _DEGREES, ORANGE, dots=True),
        ),
        caption="Positive if the tyre pushes to the left, into the turn.",
    )
    roll = Plot(
        "Roll angle over lateral acceleration",
        "lateral acceleration a_y [m/s²]",
        "roll angle φ [°]",
        (
            Curve("FMU", c.a_y, c.phi * _DEGREES, BLUE, dots=True),
            Curve("roll gradient times a_y", a_y, roll_gradient(P) * a_y * _DEGREES, INK, dash=True),
        ),
    )
    return Section(
        "circular",
        "Steady-state circular driving",
        "ISO 4138, constant-speed test method",
        f"The speed is held at {circular_test.SPEED:g} m/s by an external force at the centre of mass, so that the "
        f"tyres transmit no drive force. The steering angle is raised in steps from 0 to {c.delta[-1]:.2f} rad, each "
        f"held for {circular_test.HOLD_S:g} s; the final values of each step are used. The gradients are the slopes at "
        f"a_y = 0 of cubics fitted up to {circular_test.LINEAR_RANGE:g} m/s².",
        c.figures,
        (angles, slips, roll),
    )


def step_steer(m: Measurements) -> Section:
    """Step steer."""
    s = m.step_steer
    shown = s.t <= 2.0
    t, steady = s.t[shown], s.linear[-1]
    band = np.full(2, 100 * s.tolerance)
    response = Plot(
        "Yaw rate after the step, over steering angle",
        "time from the step [s]",
        "yaw rate / steering angle [1/s]",
        (
            Curve(f"FMU, {bound(step_test.SMALL_ANGLE)} rad", t, s.small[shown], BLUE),
            Curve(f"FMU, {s.standard_angle:.3f} rad", t, s.standard[shown], ORANGE),
            Curve("linear two-track model", t, s.linear[shown], INK, dash=True),
        ),
        caption=f"The larger step is the standard's level of about {step_test.STANDARD_ACCELERATION:g} m/s²; there "
        "the tyres are no longer linear, so it has no expected values.",
    )
    difference = Plot(
        "Small step less linear model, over the steady yaw rate",
        "time from the step [s]",
        "difference [%]",
        (
            Curve("FMU − linear", t, 100 * (s.small - s.linear)[shown] / steady, BLUE),
            Curve("tolerance", t[[0, -1]], band, INK, dash=True),
            Curve("", t[[0, -1]], -band, INK, dash=True),
        ),
    )
    return Section(
        "step-steer",
        "Step steer",
        "ISO 7401, step input",
        f"At a constant {step_test.SPEED:g} m/s the steering angle steps by {bound(step_test.SMALL_ANGLE)} rad, where "
        "tyres are still linear. The response is compared with that of the linear two-track model: lateral velocity, "
        "yaw, roll and four wheel spins, with linear tyres at each wheel's own position, their stiffnesses at the "
        "loads of straight driving. Times are measured from the step. The tolerance is derived: a brush tyre is below "
        f"its initial slope by r/3, r = C_f δ/(μ F_z), and twice this is {100 * s.tolerance:.2g} %.",
        s.figures,
        (response, difference),
    )


def stability(m: Measurements) -> Section:
    """The oversteering car."""
    s = m.stability
    eigenvalues = Plot(
        "Greatest real part of the lateral eigenvalues",
        "speed [m/s]",
        "real part [1/s]",
        (
            Curve("FMU, linearised", s.speeds, s.real_parts, BLUE, dots=True),
            Curve("linear two-track model", s.speeds, s.linear, INK, dash=True),
            Curve("", s.speeds[[0, -1]], np.zeros(2), INK),
        ),
        caption="Unstable above zero.",
    )
    tests = ((s.below, BLUE), (s.above, ORANGE))
    disturbed = Plot(
        "Yaw rate after a steering pulse",
        "time [s]",
        "yaw rate [10⁻³ rad/s]",
        [Curve(f"{each.speed:.2f} m/s", each.t, 1000 * each.gamma, colour) for each, colour in tests],
        caption="A pulse of 10⁻⁶ rad for 0.5 s, so small that tyres stay linear while the motion grows.",
    )
    return Section(
        "stability",
        "The oversteering car and its critical speed",
        "",
        "With λ_f = +1 and λ_r = −1 the front axle is 40 % stiffer and the rear axle 40 % softer. The Model Exchange "
        "derivatives are linearised at straight driving by central differences to find the speed at which an "
        "eigenvalue crosses zero. In the time domain a steering pulse disturbs the car "
        f"{100 * stability_test.DISTANCE:g} % below and above the expected critical speed; the rate is fitted "
        "to the second half.",
        s.figures,
        (eigenvalues, disturbed),
    )
