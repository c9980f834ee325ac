"""Any FMU, driven by the names of its variables: FMI 2.0 and 3.0, Model Exchange and Co-Simulation.

fmpy loads the binary and knows the standard's functions; this puts the differences between versions and kinds behind
one interface, for the checks (`validate`) and the manoeuvres (`manoeuvres`).
"""

from __future__ import annotations

import tempfile
from collections.abc import Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from ctypes import c_double
from dataclasses import dataclass
from enum import StrEnum
from pathlib import Path
from typing import Any

import fmpy
import numpy as np
from fmpy import fmi2, fmi3
from numpy.typing import NDArray

from platoon_fmu.errors import FmuError


class Kind(StrEnum):
    """The interface types of an FMU that this drives."""

    MODEL_EXCHANGE = "Model Exchange"
    CO_SIMULATION = "Co-Simulation"


@dataclass(frozen=True)
class OpenFmu:
    """An unpacked FMU.

    Attributes:
        folder: where it is unpacked.
        description: fmpy's reading of its modelDescription.xml.
    """

    folder: Path
    description: Any

    @property
    def version(self) -> int:
        """The FMI version's first number: 2 or 3."""
        return int(self.description.fmiVersion.split(".")[0])

    def element(self, kind: Kind) -> Any:
        """The element of a kind with its capability flags, as fmpy reads it; None where the FMU has no such kind."""
        return self.description.modelExchange if kind is Kind.MODEL_EXCHANGE else self.description.coSimulation

    @property
    def kinds(self) -> tuple[Kind, ...]:
        """The kinds that the FMU says it has."""
        return tuple(kind for kind in Kind if self.element(kind) is not None)


@contextmanager
def opened(fmu: Path) -> Iterator[OpenFmu]:
    """Unpacks an FMU into a temporary folder.

    Raises:
        FmuError: its modelDescription.xml cannot be read, or it is of another version than FMI 2.0 and 3.0.
    """
    # fmpy changes the working directory while it runs an FMU.
    fmu = fmu.resolve()
    with tempfile.TemporaryDirectory(prefix="fmu-") as folder:
        fmpy.extract(str(fmu), unzipdir=folder)
        description = fmpy.read_model_description(folder, validate=False)
        if description.fmiVersion.split(".")[0] not in ("2", "3"):
            raise FmuError(f"{fmu}: FMI {description.fmiVersion} is not supported; allowed: 2.0 and 3.0")
        yield OpenFmu(Path(folder), description)


_CLASSES = {
    (2, Kind.MODEL_EXCHANGE): fmi2.FMU2Model,
    (2, Kind.CO_SIMULATION): fmi2.FMU2Slave,
    (3, Kind.MODEL_EXCHANGE): fmi3.FMU3Model,
    (3, Kind.CO_SIMULATION): fmi3.FMU3Slave,
}
# The names FMI 2.0 has for what FMI 3.0 calls Float64, Int32 ... .
_ACCESSORS_2 = {"Real": "Real", "Integer": "Integer", "Enumeration": "Integer", "Boolean": "Boolean"}
_CONVERTERS = {"Real": float, "Float32": float, "Float64": float, "Boolean": bool}


class Instance:
    """One instance of an FMU, driven by names; a context manager that frees it.

    Attributes:
        fmu: what it is an instance of.
        kind: its interface type.
        time: the time it has reached [s].
        said: what it has logged, a line each.
        raw: fmpy's own object, for what this class does not carry.
    """

    def __init__(self, fmu: OpenFmu, kind: Kind, name: str = "instance") -> None:
        """Loads the binary and instantiates it.

        Raises:
            FmuError: the FMU has no such kind, its binary does not load, or it refuses to be instantiated.
        """
        element = fmu.element(kind)
        if element is None:
            raise FmuError(f"the FMU has no {kind}")
        self.fmu, self.kind, self.time = fmu, kind, 0.0
        self.said: list[str] = []
        self._variables = {variable.name: variable for variable in fmu.description.modelVariables}
        self._states = [variable.derivative.name for variable in self._derivatives()]
        try:
            self.raw = _CLASSES[fmu.version, kind](
                guid=fmu.description.guid or fmu.description.instantiationToken,
                unzipDirectory=str(fmu.folder),
                modelIdentifier=element.modelIdentifier,
                instanceName=name,
            )
            self._instantiate()
        except Exception as error:
            raise FmuError("; ".join([f"{kind}: cannot be instantiated: {error}", *self.said])) from error

    def _derivatives(self) -> list[Any]:
        # The order of ModelStructure is the order of the state vector.
        listed = [unknown.variable for unknown in self.fmu.description.derivatives]
        return listed or [v for v in self._variables.values() if v.derivative is not None]

    def _instantiate(self) -> None:
        if self.fmu.version == 3:
            self.raw.instantiate(loggingOn=True, logMessage=self._log_3)
            return
        callbacks = fmi2.fmi2CallbackFunctions()
        callbacks.logger = fmi2.fmi2CallbackLoggerTYPE(self._log_2)
        callbacks.allocateMemory = fmi2.fmi2CallbackAllocateMemoryTYPE(fmi2.calloc)
        callbacks.freeMemory = fmi2.fmi2CallbackFreeMemoryTYPE(fmi2.free)
        self.raw.instantiate(callbacks=callbacks, loggingOn=True)

    def _log_2(self, _environment: Any, _name: Any, _status: int, _category: Any, message: bytes) -> None:
        self.said.append(message.decode(errors="replace"))

    def _log_3(self, _environment: Any, _status: int, _category: Any, message: bytes) -> None:
        self.said.append(message.decode(errors="replace"))

    def __enter__(self) -> Instance:
        """The instance itself."""
        return self

    def __exit__(self, *_: object) -> None:
        """Frees the instance."""
        self.free()

    def free(self) -> None:
        """Frees the instance. The library stays loaded, as other instances may live in it."""
        if self.raw.component:
            free = self.raw.fmi3FreeInstance if self.fmu.version == 3 else self.raw.fmi2FreeInstance
            free(self.raw.component)
            self.raw.component = None

    def start(
        self,
        values: Mapping[str, float] | None = None,
        *,
        time: float = 0.0,
        stop_time: float | None = None,
        tolerance: float | None = None,
    ) -> Instance:
        """Sets start values and goes through the initialization to where it is stepped, or integrated.

        Args:
            values: start values of inputs and parameters by name.
            time: start time [s].
            stop_time: stop time [s].
            tolerance: relative tolerance for the FMU's own solver.
        """
        self.time = time
        experiment = {"tolerance": tolerance, "startTime": time, "stopTime": stop_time}
        if self.fmu.version == 2:
            self.raw.setupExperiment(**experiment)
            experiment = {}
        self.set(values or {})
        self.raw.enterInitializationMode(**experiment)
        self.raw.exitInitializationMode()
        if self.kind is Kind.MODEL_EXCHANGE:
            self._settle()
            self.raw.enterContinuousTimeMode()
        return self

    def _settle(self) -> None:
        """Iterates the event that every Model Exchange FMU starts in."""
        update = self.raw.newDiscreteStates if self.fmu.version == 2 else self.raw.updateDiscreteStates
        while update()[0]:
            pass

    def _by_type(self, names: Iterable[str]) -> dict[str, list[str]]:
        groups: dict[str, list[str]] = {}
        for name in names:
            if name not in self._variables:
                raise FmuError(f"the FMU has no variable {name}")
            groups.setdefault(self._variables[name].type, []).append(name)
        return groups

    def _accessor(self, verb: str, type_name: str) -> Any:
        if self.fmu.version == 2:
            return getattr(self.raw, verb + _ACCESSORS_2.get(type_name, type_name))
        return getattr(self.raw, verb + {"Enumeration": "Int64"}.get(type_name, type_name))

    def references(self, names: Iterable[str]) -> list[int]:
        """The value references of variables."""
        return [self._variables[name].valueReference for name in names]

    def set(self, values: Mapping[str, float] | None = None, **more: float) -> None:
        """Sets scalar variables by name."""
        values = {**(values or {}), **more}
        for type_name, names in self._by_type(values).items():
            convert = _CONVERTERS.get(type_name, int)
            self._accessor("set", type_name)(self.references(names), [convert(values[name]) for name in names])

    def get(self, *names: str) -> NDArray[np.float64]:
        """The values of scalar variables by name, in the order asked for."""
        found: dict[str, float] = {}
        for type_name, group in self._by_type(names).items():
            found.update(zip(group, self._accessor("get", type_name)(self.references(group)), strict=True))
        return np.array([found[name] for name in names], dtype=float)

    def __getitem__(self, name: str) -> float:
        """The value of one scalar variable."""
        return float(self.get(name)[0])

    def step(self, h: float) -> None:
        """Co-Simulation: goes h seconds on."""
        self.raw.doStep(currentCommunicationPoint=self.time, communicationStepSize=h)
        self.time += h

    @property
    def state_names(self) -> tuple[str, ...]:
        """The continuous states by name, in the order of the state vector."""
        return tuple(self._states)

    def set_states(self, x: Sequence[float] | NDArray[np.float64], time: float | None = None) -> None:
        """Model Exchange: sets the continuous states, and the time where it is given."""
        if time is not None:
            self.time = time
            self.raw.setTime(time)
        self.raw.setContinuousStates((c_double * len(x))(*x), len(x))

    def states(self) -> NDArray[np.float64]:
        """Model Exchange: the continuous states."""
        x = (c_double * len(self._states))()
        self.raw.getContinuousStates(x, len(x))
        return np.array(x)

    def derivatives(self) -> NDArray[np.float64]:
        """Model Exchange: the derivatives of the continuous states."""
        dx = (c_double * len(self._states))()
        get = self.raw.getDerivatives if self.fmu.version == 2 else self.raw.getContinuousStateDerivatives
        get(dx, len(dx))
        return np.array(dx)

    def directional_derivative(
        self, unknowns: Sequence[str], knowns: Sequence[str], seed: Sequence[float]
    ) -> NDArray[np.float64]:
        """J seed, where J is the Jacobian of the unknowns over the knowns."""
        return np.array(
            self.raw.getDirectionalDerivative(self.references(unknowns), self.references(knowns), list(seed))
        )

    def adjoint_derivative(
        self, unknowns: Sequence[str], knowns: Sequence[str], seed: Sequence[float]
    ) -> NDArray[np.float64]:
        """FMI 3.0: seed^T J, where J is the Jacobian of the unknowns over the knowns; a value for each known."""
        return np.array(
            self.raw.getAdjointDerivative(
                self.references(unknowns), self.references(knowns), list(seed), nSensitivity=len(knowns)
            )
        )

    def save(self) -> Any:
        """A copy of the FMU's state, for `restore`; freed by `discard`."""
        return self.raw.getFMUState()

    def restore(self, state: Any, time: float) -> None:
        """Goes back to a saved state, which was saved at `time`."""
        self.raw.setFMUState(state)
        self.time = time

    def discard(self, state: Any) -> None:
        """Frees a saved state."""
        self.raw.freeFMUState(state)

    def serialise(self) -> bytes:
        """The FMU's state as bytes."""
        state = self.save()
        try:
            return bytes(self.raw.serializeFMUState(state))
        finally:
            self.discard(state)

    def deserialise(self, content: bytes, time: float) -> None:
        """Goes on from a state that `serialise` gave at `time`, in this or another process."""
        state = self.raw.deserializeFMUState(content)
        try:
            self.restore(state, time)
        finally:
            self.discard(state)

    def reset(self) -> None:
        """Back to what instantiation gave; `start` goes on from there."""
        self.raw.reset()
        self.time = 0.0

    def terminate(self) -> None:
        """Ends the simulation; values can still be read."""
        self.raw.terminate()
