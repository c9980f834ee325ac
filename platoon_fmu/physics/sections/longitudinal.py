"""Sections on longitudinal manoeuvres: coast-down, the friction limit, standstill."""

from __future__ import annotations

import numpy as np

from platoon_fmu.physics import coast_down as coast_test
from platoon_fmu.physics import standstill as standstill_test
from platoon_fmu.physics.friction_limit import START_SPEED, Slide
from platoon_fmu.physics.measurements import Measurements
from platoon_fmu.physics.plot import BLUE, INK, ORANGE, Curve, Plot
from platoon_fmu.physics.sections.section import Section


def coast_down(m: Measurements) -> Section:
    """Coast-down."""
    c = m.coast_down
    speed = Plot(
        "Speed while coasting",
        "time [s]",
        "speed v_x [m/s]",
        (Curve("FMU", c.t, c.v_x, BLUE), Curve("closed form", c.t, c.expected, INK, dash=True)),
    )
    tolerance = 1000 * coast_test.slip_tolerance(m.P) * coast_test.START_SPEED
    difference = Plot(
        "FMU less closed form",
        "time [s]",
        "speed difference [mm/s]",
        (
            Curve("difference", c.t, 1000 * (c.v_x - c.expected), BLUE),
            Curve("tolerance", c.t[[0, -1]], np.full(2, tolerance), INK, dash=True),
        ),
    )
    return Section(
        "coast-down",
        "Coast-down",
        "",
        f"From {coast_test.START_SPEED:g} m/s the car coasts straight ahead with no torque on any wheel, against air "
        "drag and rolling resistance; the wheels' inertia adds to its mass. In the closed form the wheels roll without "
        "slip; the tolerance is the share of the car's energy that the wheels gain by slip.",
        c.figures,
        (speed, difference),
    )


def friction(m: Measurements) -> Section:
    """Braking and acceleration at the friction limit."""
    locked, spinning = m.friction.locked, m.friction.spinning
    return Section(
        "friction",
        "Braking and acceleration at the friction limit",
        "",
        f"Braking: from {START_SPEED:g} m/s straight ahead a brake locks all wheels until the car "
        "stops. Acceleration: from rest all wheels are driven with twice the torque that friction transmits, and spin. "
        "Both on the nominal and on a slippery road. Accelerations are due to tyre forces (air drag excluded), means "
        "over the time during which all tyres slide.",
        m.friction.figures,
        (
            _speeds("Braking, wheels locked", locked),
            _accelerations("Deceleration by tyre forces", locked),
            _speeds("Acceleration, wheels spinning", spinning),
            _accelerations("Acceleration by tyre forces", spinning),
        ),
    )


def _speeds(title: str, slides: tuple[Slide, Slide]) -> Plot:
    curves = []
    for slide, colour in zip(slides, (BLUE, ORANGE), strict=True):
        curves.append(Curve(f"car, μ = {slide.mu:g}", slide.t, slide.v_x, colour))
        curves.append(Curve(f"rims, μ = {slide.mu:g}", slide.t, slide.rim_speeds.mean(axis=0), colour, dash=True))
    top = 1.1 * max(float(slide.v_x.max()) for slide in slides)
    caption = "Rim speed is R_w ω; curves outside the plot are faster." if slides[0].expected_a > 0 else ""
    return Plot(title, "time [s]", "speed [m/s]", curves, caption, y_range=(-0.05 * top, top))


def _accelerations(title: str, slides: tuple[Slide, Slide]) -> Plot:
    curves = []
    for slide, colour in zip(slides, (BLUE, ORANGE), strict=True):
        curves.append(Curve(f"FMU, μ = {slide.mu:g}", slide.t, np.abs(slide.ground_a), colour))
        expected = np.full(2, abs(slide.expected_a))
        curves.append(Curve("", slide.t[[0, -1]], expected, INK, dash=True))
    curves[-1] = Curve("expected", curves[-1].x, curves[-1].y, INK, dash=True)
    return Plot(title, "time [s]", "acceleration, magnitude [m/s²]", curves)


def standstill(m: Measurements) -> Section:
    """Standstill, pulling away and stopping."""
    s = m.standstill
    shown = s.t <= standstill_test.PULL_S + 10.0
    speed = Plot(
        "Pulling away and stopping",
        "time from pulling away [s]",
        "speed v_x [m/s]",
        (
            Curve("FMU", s.t[shown], s.v_x[shown], BLUE),
            Curve("closed form", s.t_expected, s.v_expected, INK, dash=True),
        ),
        caption=f"The brake is applied at {standstill_test.PULL_S:g} s.",
    )
    return Section(
        "standstill",
        "Standstill, pulling away and stopping",
        "",
        f"The car stands for {standstill_test.REST_S:g} s with its wheels steered by 0.3 rad. Then, with straight "
        f"wheels, {standstill_test.TORQUE:g} N m on each wheel accelerate it for {standstill_test.PULL_S:g} s, a brake "
        f"stops it, and it stands until {standstill_test.STOP_S:g} s after braking began.",
        s.figures,
        (speed,),
    )
