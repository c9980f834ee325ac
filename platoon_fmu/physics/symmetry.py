"""Mirror symmetry: a manoeuvre to the left is the mirror image of the one to the right, within rounding."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from platoon_fmu.importer import OpenFmu
from platoon_fmu.physics.drive import STATES, Array, Car, of_wheels
from platoon_fmu.physics.figure import Figure, at_most
from platoon_fmu.wheels import WHEEL_NAMES

SPEED = 25.0
"""Speed of the test [m/s]."""
_SECONDS = 2.0
_ANGLES = (0.01, 0.08)
_TORQUES = ((-100.0, 50.0, 150.0, 80.0), (-900.0, 300.0, 200.0, -50.0))
_INFLATIONS = ((1.0, 1.0, 1.0, 1.0), (0.4, 0.9, 1.0, 0.0))
_MIRRORED = {"Y", "psi", "phi", "v_y", "gamma", "p", "load_transfer_y"}
_NAMES = (*STATES, "a_y", *of_wheels("F_z"))
# fl, rl, rr, fr become fr, rr, rl, fl.
_SIDES = str.maketrans("lr", "rl")


@dataclass(frozen=True)
class MirrorSymmetry:
    """The paths of the harder turn to the left, and to the right mirrored, (rows,) [m]; and the metrics."""

    X: Array
    Y: Array
    X_mirrored: Array
    Y_mirrored: Array
    figures: tuple[Figure, ...]


def mirror_symmetry(fmu: OpenFmu) -> MirrorSymmetry:
    """Drives turns with uneven torques, tyres and external forces, and their mirror images.

    Args:
        fmu: the vehicle.
    """
    largest, left, right = 0.0, {}, {}
    for angle in _ANGLES:
        left, right = _drive(fmu, angle, +1), _drive(fmu, angle, -1)
        for name in _NAMES:
            scale = max(float(np.abs(left[name]).max()), 1e-3)
            largest = max(largest, float(np.abs(left[name] - right[name]).max()) / scale)
    figures = (
        at_most(
            "Greatest difference over the greatest value",
            largest,
            1e-9,
            source="the vehicle's left and right halves are identical; only rounding differs",
        ),
    )
    return MirrorSymmetry(left["X"], left["Y"], right["X"], right["Y"], figures)


def _drive(fmu: OpenFmu, angle: float, side: int) -> dict[str, Array]:
    """The series of a turn to the left (side 1), or mirrored, to the right (side -1), by name."""
    series: dict[str, list[Array]] = {name: [] for name in _NAMES}
    with Car(fmu, {"v_x_start": SPEED}) as car:
        for torques, inflations in zip(_TORQUES, _INFLATIONS, strict=True):
            car.torque(*torques[::side])
            car.set(dict(zip(of_wheels("inflation"), inflations[::side], strict=True)))
            car.set(steering_angle=side * angle, force_y=side * 100.0, moment_z=side * 50.0)
            trace = car.record(_SECONDS, 0.01, _NAMES)
            for name in _NAMES:
                source = name if side > 0 else _other_side(name)
                sign = side if name in _MIRRORED or name == "a_y" else 1
                series[name].append(sign * trace[source])
    return {name: np.concatenate(parts) for name, parts in series.items()}


def _other_side(name: str) -> str:
    stem, _, wheel = name.rpartition("_")
    return f"{stem}_{wheel[0]}{wheel[1:].translate(_SIDES)}" if wheel in WHEEL_NAMES else name
