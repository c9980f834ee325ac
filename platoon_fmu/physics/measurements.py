"""All manoeuvres of the physics validation, driven with one FMU."""

from __future__ import annotations

from dataclasses import dataclass

from fmpy.fmi1 import FMICallException

from platoon_fmu.errors import FmuError
from platoon_fmu.importer import OpenFmu
from platoon_fmu.parameters import VehicleParameters
from platoon_fmu.physics.circular import CircularDriving, circular_driving
from platoon_fmu.physics.coast_down import CoastDown, coast_down
from platoon_fmu.physics.convergence import Convergence, convergence
from platoon_fmu.physics.drive import declared_parameters
from platoon_fmu.physics.energy import EnergyBalance, energy_balance
from platoon_fmu.physics.friction_limit import FrictionLimit, friction_limit
from platoon_fmu.physics.stability import Stability, oversteer_stability
from platoon_fmu.physics.standstill import Standstill, standstill
from platoon_fmu.physics.step_steer import StepSteer, step_steer
from platoon_fmu.physics.symmetry import MirrorSymmetry, mirror_symmetry


@dataclass(frozen=True)
class Measurements:
    """The result of each manoeuvre, and the FMU's declared parameters, which give the expected values."""

    P: VehicleParameters
    circular: CircularDriving
    step_steer: StepSteer
    coast_down: CoastDown
    energy: EnergyBalance
    symmetry: MirrorSymmetry
    friction: FrictionLimit
    standstill: Standstill
    stability: Stability
    convergence: Convergence


def measure(fmu: OpenFmu) -> Measurements:
    """Drives all manoeuvres; takes some seconds.

    Args:
        fmu: the vehicle, with Model Exchange and Co-Simulation.

    Raises:
        FmuError: it is not the vehicle, cannot be loaded, or refuses a call.
    """
    P = declared_parameters(fmu)
    try:
        # First, because it is not possible with every set of parameters.
        stability = oversteer_stability(fmu, P)
        return Measurements(
            P=P,
            circular=circular_driving(fmu, P),
            step_steer=step_steer(fmu, P),
            coast_down=coast_down(fmu, P),
            energy=energy_balance(fmu, P),
            symmetry=mirror_symmetry(fmu),
            friction=friction_limit(fmu, P),
            standstill=standstill(fmu, P),
            stability=stability,
            convergence=convergence(fmu),
        )
    except FMICallException as error:
        raise FmuError(f"the FMU cannot be driven: {error}") from error
