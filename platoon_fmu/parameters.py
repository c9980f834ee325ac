"""The vehicle's parameters: Table 1 of the paper, and named assumptions for values that the paper does not give.

Pure data with no dependencies, so that a controller may read the nominal values without the model.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Any

TABLE_1 = "the paper, Table 1"

LAMBDA_MIN, LAMBDA_MAX = -1.0, 1.0
"""Range of lambda, the uncertainty of an axle's cornering stiffness: C (1 + `cornering_variation` lambda)."""


def _parameter(
    value: float, unit: str, description: str, source: str, *, minimum: float = 0.0, maximum: float | None = None
) -> Any:
    """A dataclass field with its unit, meaning, source and allowed range as metadata."""
    metadata = {
        "unit": unit,
        "description": description,
        "source": source,
        "minimum": minimum,
        "maximum": maximum,
    }
    return field(default=value, metadata=metadata)


@dataclass(frozen=True)
class Body:
    """The outline of a vehicle seen from above: a rectangle around its centre of mass.

    Attributes:
        length: m.
        width: without mirrors, m.
    """

    length: float
    width: float


BODY = Body(length=4.5, width=1.8)
"""Assumed: a typical passenger car around the wheelbase and track width of Table 1."""


@dataclass(frozen=True)
class VehicleParameters:
    """The vehicle, in SI units and radians; each field's unit, meaning and source are in its metadata.

    `C_f`, `C_r` and `C_x` are per tyre at its static load. Heights are above the ground.
    """

    M: float = _parameter(1723.0, "kg", "vehicle mass", TABLE_1, minimum=1.0)
    I_z: float = _parameter(4175.0, "kg.m2", "yaw moment of inertia", TABLE_1, minimum=1.0)
    l_f: float = _parameter(1.4, "m", "distance from the centre of mass to the front axle", TABLE_1, minimum=0.1)
    l_r: float = _parameter(1.6, "m", "distance from the centre of mass to the rear axle", TABLE_1, minimum=0.1)
    l_t: float = _parameter(1.54, "m", "track width, front and rear", TABLE_1, minimum=0.1)
    g: float = _parameter(9.8, "m/s2", "gravitational acceleration", TABLE_1)
    rho: float = _parameter(1.206, "kg/m3", "air density", TABLE_1)
    S_d: float = _parameter(1.8, "m2", "frontal area", TABLE_1)
    mu_a: float = _parameter(0.8, "1", "tyre-road adhesion coefficient: the start value of the input mu", TABLE_1)
    mu_d: float = _parameter(0.018, "1", "rolling resistance coefficient", TABLE_1)
    C_f: float = _parameter(52_700.0, "N/rad", "cornering stiffness of a front tyre", TABLE_1)
    C_r: float = _parameter(66_900.0, "N/rad", "cornering stiffness of a rear tyre", TABLE_1)
    cornering_variation: float = _parameter(
        0.4,
        "1",
        "relative change of an axle's cornering stiffness at lambda = 1",
        "the paper: 'up to +-40 %'",
        maximum=0.99,
    )
    C_d: float = _parameter(0.30, "1", "drag coefficient", "assumed: typical passenger car")
    h: float = _parameter(0.54, "m", "height of the centre of mass", "assumed: typical passenger car")
    m_s: float = _parameter(
        1500.0, "kg", "sprung mass", "assumed: 87 % of the vehicle; the remainder is four wheels with hub motors"
    )
    I_x: float = _parameter(
        600.0,
        "kg.m2",
        "roll moment of inertia of the sprung mass about its own centre",
        "assumed: radius of gyration 0.63 m",
        minimum=1.0,
    )
    h_s: float = _parameter(
        0.45,
        "m",
        "roll arm: height of the sprung mass's centre above the roll axis",
        "assumed: puts the roll axis 0.13 m above the ground",
    )
    K_phi: float = _parameter(
        82_000.0, "N.m/rad", "roll stiffness", "assumed: 5 degrees of roll at 1 g of lateral acceleration"
    )
    C_phi: float = _parameter(
        5_000.0, "N.m.s/rad", "roll damping", "assumed: a damping ratio of 0.36 at 1.7 Hz, a comfortable car"
    )
    roll_share_f: float = _parameter(
        0.55,
        "1",
        "front axle's share of the roll stiffness",
        "assumed: near the front axle's share of weight",
        maximum=1.0,
    )
    tau_z: float = _parameter(
        0.05,
        "s",
        "time constant of load transfer (longitudinal, and lateral through the roll centres)",
        "assumed: a quarter period of a stiff pitch mode; it also breaks the algebraic loop force - load",
        minimum=0.005,
    )
    R_w: float = _parameter(0.30, "m", "rolling radius of a wheel", "assumed: 195/65 R15", minimum=0.05)
    I_w: float = _parameter(
        1.2, "kg.m2", "spin moment of inertia of a wheel", "assumed: tyre, rim, brake and motor rotor", minimum=0.1
    )
    C_x: float = _parameter(
        60_000.0, "N", "longitudinal stiffness of a tyre, per unit slip ratio", "assumed: 14 times its static load"
    )
    load_peak: float = _parameter(
        1.5,
        "1",
        "load over static load at which a tyre's slip stiffness peaks",
        "assumed: a tyre near its rated load; Pacejka 2012, section 4.3, parameter p_Ky2",
        minimum=1.0,
    )
    K_z: float = _parameter(
        200_000.0,
        "N/m",
        "vertical stiffness of a sound tyre; K_phi contains it",
        "assumed: 195/65 R15 at nominal pressure, 22 mm of deflection under its static load",
        minimum=10_000.0,
    )
    flat_vertical: float = _parameter(
        0.2,
        "1",
        "vertical stiffness of a flat tyre over a sound one's",
        "assumed: the load left on a front wheel deflects the tyre by 0.1 m, onto its rim",
        minimum=0.05,
        maximum=1.0,
    )
    flat_cornering: float = _parameter(
        0.25,
        "1",
        "cornering stiffness of a flat tyre over a sound one's",
        "assumed: blow-out studies report a fifth to a third",
        maximum=1.0,
    )
    flat_longitudinal: float = _parameter(
        0.5,
        "1",
        "longitudinal stiffness of a flat tyre over a sound one's",
        "assumed: falls less than the cornering stiffness, as the belt is stiff along its circumference",
        maximum=1.0,
    )
    flat_rolling: float = _parameter(
        0.28,
        "1",
        "rolling resistance coefficient of a flat tyre in addition to mu_d",
        "assumed: 0.3 in total, 17 times a sound tyre's; blow-out studies report 10 to 30 times",
        maximum=1.0,
    )
    flat_radius: float = _parameter(
        0.92,
        "1",
        "rolling radius of a flat tyre over a sound one's",
        "assumed: a radial tyre's belt keeps its length, so the rolling radius shrinks by a third of the deflection",
        minimum=0.5,
        maximum=1.0,
    )
    v_slip: float = _parameter(
        5.0,
        "m/s",
        "speed below which slips are regularised; exact at or above it",
        "chosen: at rest the wheel-spin pole R_w^2 C_x/(I_w v_slip/2) is 1800 1/s, stable in steps of 1 ms",
        minimum=0.1,
    )
    v_roll: float = _parameter(
        0.5, "m/s", "speed below which rolling resistance fades to zero", "chosen: no chatter at rest", minimum=0.01
    )

    @property
    def L(self) -> float:
        """Wheelbase [m]."""
        return self.l_f + self.l_r

    @property
    def C_a(self) -> float:
        """Aerodynamic drag coefficient C_a = rho S_d C_d / 2 [kg/m]: the drag is C_a v_x^2."""
        return self.rho * self.S_d * self.C_d / 2

    @property
    def F_zf(self) -> float:
        """Static load of a front tyre [N]."""
        return self.M * self.g * self.l_r / (2 * self.L)

    @property
    def F_zr(self) -> float:
        """Static load of a rear tyre [N]."""
        return self.M * self.g * self.l_f / (2 * self.L)
