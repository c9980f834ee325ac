"""Sections on properties of every motion: energy, symmetry, and the solvers' convergence."""

from __future__ import annotations

import numpy as np

from platoon_fmu.physics import convergence as convergence_test
from platoon_fmu.physics import symmetry as symmetry_test
from platoon_fmu.physics.energy import Ledger
from platoon_fmu.physics.measurements import Measurements
from platoon_fmu.physics.plot import BLUE, GREEN, INK, ORANGE, PURPLE, Curve, Plot
from platoon_fmu.physics.sections.section import Section


def energy(m: Measurements) -> Section:
    """Energy balance."""
    return Section(
        "energy",
        "Energy balance",
        "",
        "Violent manoeuvres, recorded every 1 ms. The energy is that of translation, yaw, roll, wheel spins and roll "
        "springs, less the potential energy that the leaning body loses; load transfers store none. Wheel torques and "
        "external forces do work; steering does none. The dissipation is this work less the rise in energy and must "
        "never fall. It must equal the losses in tyres (force times slip velocity), air, rolling resistance and roll "
        "dampers, integrated separately. The throughput is the largest energy stored or dissipated.",
        m.energy.figures,
        [_ledger(ledger) for ledger in m.energy.ledgers],
    )


def _ledger(ledger: Ledger) -> Plot:
    curves = [Curve("energy", ledger.t, ledger.energy / 1000, BLUE)]
    for name, work, colour in (("torques", ledger.by_torques, GREEN), ("forces", ledger.by_forces, PURPLE)):
        if np.any(work):
            curves.append(Curve(f"work of {name}", ledger.t, work / 1000, colour))
    curves.append(Curve("lost", ledger.t, ledger.dissipated / 1000, ORANGE))
    curves.append(Curve("accounted", ledger.t, ledger.accounted / 1000, INK, dash=True))
    return Plot(ledger.name, "time [s]", "energy [kJ]", curves)


def symmetry(m: Measurements) -> Section:
    """Mirror symmetry."""
    s = m.symmetry
    path = Plot(
        "Paths of the harder turn",
        "X [m]",
        "Y [m]",
        (
            Curve("to the left", s.X, s.Y, BLUE),
            Curve("to the right, mirrored", s.X_mirrored, s.Y_mirrored, INK, dash=True),
        ),
        caption="X and Y are drawn to different scales.",
    )
    return Section(
        "symmetry",
        "Left and right",
        "",
        f"From {symmetry_test.SPEED:g} m/s, two turns, a gentle and a hard one, with different torques on all "
        "wheels, a side force and a yaw moment, the hard one also with soft tyres, are driven to the left and, with "
        "everything mirrored, to the right. "
        "All states, the lateral acceleration and the tyre loads are compared.",
        s.figures,
        (path,),
    )


def convergence(m: Measurements) -> Section:
    """Convergence of the solvers."""
    c = m.convergence
    order_4 = c.errors[-1] * (c.steps / c.steps[-1]) ** 4
    plots = [
        Plot(
            "Error of the fixed-step solver over its step",
            "step [ms]",
            "error over nominal values [1]",
            (
                Curve("FMU", 1000 * c.steps, c.errors, BLUE, dots=True),
                Curve("order 4", 1000 * c.steps, order_4, INK, dash=True),
            ),
            caption=f"At {1000 * convergence_test.SHORT_S:g} ms, before the wheels' spins, the fastest motion, settle.",
            logarithmic=True,
        )
    ]
    if len(c.tolerances):
        plots.append(
            Plot(
                "Error of the adaptive solver over its tolerance",
                "tolerance [1]",
                "error over nominal values [1]",
                (
                    Curve("FMU", c.tolerances, c.adaptive_errors, BLUE, dots=True),
                    Curve("error = tolerance", c.tolerances, c.tolerances, INK, dash=True),
                ),
                caption=f"After {convergence_test.LONG_S:g} s.",
                logarithmic=True,
            )
        )
    return Section(
        "convergence",
        "Convergence of the solvers",
        "",
        "A turn at 20 m/s with 100 N m on each wheel, started out of equilibrium; all slips keep their sign and no "
        "tyre saturates, so that the model is smooth throughout. The error is the largest of all states at the "
        "end, relative to their nominal values, compared with a solution with much finer steps.",
        c.figures,
        plots,
    )
