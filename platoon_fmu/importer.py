"""Any FMU, driven by the names of its variables: FMI 2.0 and 3.0, Model Exchange and Co-Simulation.

fmpy loads the binary and wraps the standard's functions; this module hides the differences between versions and kinds
behind one interface, for the checks (`dynamic_checks`) and the manoeuvres (`physics`).
"""

from __future__ import annotations

import math
import os
import tempfile
from collections.abc import Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from ctypes import CDLL, c_double
from dataclasses import dataclass
from enum import StrEnum
from pathlib import Path
from typing import Any

import fmpy
import numpy as np
from fmpy import fmi2, fmi3
from numpy.typing import NDArray

from platoon_fmu import archive
from platoon_fmu.errors import FmuError
from platoon_fmu.versions import FMI2, FMI3

#: A variable's values: one number or text, or for an array all elements, row by row.
Value = float | int | bool | str
Values = Sequence[Value] | NDArray[np.float64]


class Kind(StrEnum):
    """The supported interface types of an FMU."""

    MODEL_EXCHANGE = "Model Exchange"
    CO_SIMULATION = "Co-Simulation"


# The capability flags whose names differ between FMI 2.0 and FMI 3.0.
_FLAGS_2 = {
    "canGetAndSetFMUState": "canGetAndSetFMUstate",
    "canSerializeFMUState": "canSerializeFMUstate",
    "providesDirectionalDerivatives": "providesDirectionalDerivative",
}


@dataclass(frozen=True)
class OpenFmu:
    """An unpacked FMU.

    Attributes:
        folder: where it is unpacked.
        description: its modelDescription.xml as parsed by fmpy.
    """

    folder: Path
    description: Any

    @staticmethod
    def unpacked(folder: Path) -> OpenFmu:
        """An FMU that is already unpacked in a folder."""
        return OpenFmu(folder, fmpy.read_model_description(str(folder), validate=False))

    @property
    def version(self) -> int:
        """The major FMI version: 2 or 3."""
        return int(self.description.fmiVersion.split(".")[0])

    def element(self, kind: Kind) -> Any:
        """A kind's element with its capability flags, as parsed by fmpy; None if the FMU lacks this kind."""
        return self.description.modelExchange if kind is Kind.MODEL_EXCHANGE else self.description.coSimulation

    def claims(self, kind: Kind, flag: str) -> bool:
        """Whether a capability flag of a kind is set.

        Args:
            kind: one that the FMU has.
            flag: its name in FMI 3.0.
        """
        content = (self.folder / archive.DESCRIPTION).read_bytes()
        attributes = archive.interface_types(content)[kind.replace(" ", "").replace("-", "")]
        return attributes.get(self.flag_name(flag)) in ("true", "1")

    def flag_name(self, flag: str) -> str:
        """The name of an FMI 3.0 capability flag in the FMU's own version."""
        return _FLAGS_2.get(flag, flag) if self.version == 2 else flag

    @property
    def kinds(self) -> tuple[Kind, ...]:
        """The kinds that the FMU declares."""
        return tuple(kind for kind in Kind if self.element(kind) is not None)

    @property
    def platforms(self) -> tuple[str, ...]:
        """The platforms for which it has a binary, named as its folders in binaries/."""
        files = self.folder.glob("binaries/**/*")
        return archive.platforms(path.relative_to(self.folder).as_posix() for path in files)

    @property
    def runs_here(self) -> bool:
        """Whether it has a folder in binaries/ for this platform."""
        return any(folder.is_dir() for folder in self._folders())

    def library(self, kind: Kind) -> Path:
        """The binary of a kind for this platform.

        Raises:
            FmuError: there is none.
        """
        name = f"{self.element(kind).modelIdentifier}{fmpy.sharedLibraryExtension}"
        for folder in self._folders():
            if (folder / name).is_file():
                return folder / name
        here = ", ".join(f"{folder.relative_to(self.folder)}/{name}" for folder in self._folders())
        raise FmuError(f"has no binary for {kind} on this platform, expected at {here}")

    def _folders(self) -> list[Path]:
        version = FMI2 if self.version == 2 else FMI3
        here = fmpy.platform_tuple
        return [self.folder / "binaries" / name for name in dict.fromkeys((*version.folders_of(here), here))]


@contextmanager
def opened(fmu: Path) -> Iterator[OpenFmu]:
    """Unpacks an FMU into a temporary folder.

    Raises:
        FmuError: it is missing, damaged, not an FMU, or of a version other than FMI 2.0 and 3.0.
    """
    description = archive.read_description(fmu)
    with tempfile.TemporaryDirectory(prefix="fmu-") as folder:
        archive.unpack(fmu, Path(folder))
        yield OpenFmu(Path(folder), description)


_CLASSES = {
    (2, Kind.MODEL_EXCHANGE): fmi2.FMU2Model,
    (2, Kind.CO_SIMULATION): fmi2.FMU2Slave,
    (3, Kind.MODEL_EXCHANGE): fmi3.FMU3Model,
    (3, Kind.CO_SIMULATION): fmi3.FMU3Slave,
}
# Types whose getters and setters are named after another type.
_ACCESSORS = {2: {"Enumeration": "Integer"}, 3: {"Enumeration": "Int64"}}
_CONVERTERS: dict[str, type] = {"Real": float, "Float32": float, "Float64": float, "Boolean": bool, "String": str}
# Limit of event iterations, which may otherwise never end.
_MOST_ITERATIONS = 1000


def load(fmu: OpenFmu, kind: Kind, name: str = "instance") -> Any:
    """Loads an FMU's binary.

    Returns:
        fmpy's object, not yet instantiated.

    Raises:
        FmuError: there is no binary for this platform, it does not load, or it lacks functions of the standard.
    """
    library, wanted = fmu.library(kind), _CLASSES[fmu.version, kind]
    # fmpy changes the working directory to load a binary, and does not restore it after a failure.
    here = Path.cwd()
    try:
        return wanted(
            guid=fmu.description.instantiationToken or "",
            unzipDirectory=str(fmu.folder),
            modelIdentifier=fmu.element(kind).modelIdentifier,
            instanceName=name,
            libraryPath=str(library),
        )
    except AttributeError as error:
        functions = [name for name in dir(wanted) if name.startswith(f"fmi{fmu.version}")]
        missing = [name for name in functions if not hasattr(CDLL(str(library)), name)]
        raise FmuError(f"its binary for {kind} lacks functions of the standard: {', '.join(missing)}") from error
    except Exception as error:
        reason = str(error).removeprefix(f"Failed to load shared library {library}. ")
        raise FmuError(f"its binary for {kind} cannot be loaded: {reason}") from error
    finally:
        os.chdir(here)


class Instance:
    """One instance of an FMU, driven by names; a context manager that frees it.

    Attributes:
        fmu: the FMU it was created from.
        kind: its interface type.
        time: the time it has reached [s].
        next_event_time: Model Exchange: the time of the next event announced by the FMU [s], or None.
        said: its log messages, one line each.
        complaints: those of them logged as a warning or an error.
        raw: fmpy's own object, for functions not wrapped here.
    """

    def __init__(self, fmu: OpenFmu, kind: Kind, name: str = "instance") -> None:
        """Loads the binary and instantiates it.

        Raises:
            FmuError: the FMU has no such kind, its binary does not load, or it refuses to be instantiated.
        """
        if fmu.element(kind) is None:
            raise FmuError(f"the FMU has no {kind}")
        self.fmu, self.kind, self.time = fmu, kind, 0.0
        self.next_event_time: float | None = None
        self.said: list[str] = []
        self.complaints: list[str] = []
        self._variables = {variable.name: variable for variable in fmu.description.modelVariables}
        # The order of ModelStructure is the order of the state vector.
        self._states = [unknown.variable.derivative for unknown in fmu.description.derivatives]
        self.raw = load(fmu, kind, name)
        try:
            self._instantiate()
        except Exception as error:
            raise FmuError("; ".join([f"{kind}: cannot be instantiated: {error}", *self.said])) from error

    def _instantiate(self) -> None:
        if self.fmu.version == 3:
            self.raw.instantiate(loggingOn=True, logMessage=self._log_3)
            return
        callbacks = fmi2.fmi2CallbackFunctions()
        callbacks.logger = fmi2.fmi2CallbackLoggerTYPE(self._log_2)
        callbacks.allocateMemory = fmi2.fmi2CallbackAllocateMemoryTYPE(fmi2.calloc)
        callbacks.freeMemory = fmi2.fmi2CallbackFreeMemoryTYPE(fmi2.free)
        self.raw.instantiate(callbacks=callbacks, loggingOn=True)

    def _log_2(self, _environment: Any, _name: Any, status: int, category: Any, message: bytes | None) -> None:
        self._log_3(None, status, category, message)

    def _log_3(self, _environment: Any, status: int, _category: Any, message: bytes | None) -> None:
        line = (message or b"").decode(errors="replace")
        self.said.append(line)
        if status >= fmi2.fmi2Warning:
            self.complaints.append(line)

    def __enter__(self) -> Instance:
        """The instance itself."""
        return self

    def __exit__(self, *_: object) -> None:
        """Frees the instance."""
        self.free()

    def free(self) -> None:
        """Frees the instance. The library stays loaded, because other instances may use it."""
        if self.raw.component:
            free = self.raw.fmi3FreeInstance if self.fmu.version == 3 else self.raw.fmi2FreeInstance
            free(self.raw.component)
            self.raw.component = None

    def start(
        self,
        values: Mapping[str, Value | Values] | None = None,
        *,
        time: float = 0.0,
        stop_time: float | None = None,
        tolerance: float | None = None,
    ) -> Instance:
        """Sets start values and completes the initialization, ready for stepping or integration.

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
            # Every Model Exchange FMU starts in Event Mode.
            self._settle()
            self.raw.enterContinuousTimeMode()
        return self

    def _settle(self) -> None:
        """Iterates an event until it settles."""
        update = self.raw.newDiscreteStates if self.fmu.version == 2 else self.raw.updateDiscreteStates
        for _ in range(_MOST_ITERATIONS):
            again, terminate, _, _, announced, time = update()
            if terminate:
                raise FmuError(f"at t = {self.time:g} s the FMU asks to end the simulation")
            if not again:
                self.next_event_time = time if announced else None
                return
        raise FmuError(f"the event at t = {self.time:g} s does not settle within {_MOST_ITERATIONS} iterations")

    def _by_type(self, names: Iterable[str]) -> dict[str, list[str]]:
        groups: dict[str, list[str]] = {}
        for name in names:
            if name not in self._variables:
                raise FmuError(f"the FMU has no variable {name}")
            groups.setdefault(self._variables[name].type, []).append(name)
        return groups

    def _accessor(self, verb: str, type_name: str) -> Any:
        return getattr(self.raw, verb + _ACCESSORS[self.fmu.version].get(type_name, type_name))

    def references(self, names: Iterable[str]) -> list[int]:
        """The value references of variables."""
        return [self._variables[name].valueReference for name in names]

    def size(self, *names: str) -> int:
        """Total number of elements of variables."""
        return sum(math.prod(self._variables[name].shape or ()) for name in names)

    def set(self, values: Mapping[str, Value | Values] | None = None, **more: Value | Values) -> None:
        """Sets variables by name, arrays by all their elements in row-major order."""
        values = {**(values or {}), **more}
        for type_name, names in self._by_type(values).items():
            convert = _CONVERTERS.get(type_name, int)
            flat = [convert(element) for name in names for element in _elements(values[name])]
            self._accessor("set", type_name)(self.references(names), flat)

    def read(self, *names: str) -> dict[str, tuple[Value, ...]]:
        """The values of variables of any type except Binary and Clock, by name, arrays in row-major order."""
        found: dict[str, tuple[Value, ...]] = {}
        for type_name, group in self._by_type(names).items():
            options = {} if self.fmu.version == 2 else {"nValues": self.size(*group)}
            flat = iter(self._accessor("get", type_name)(self.references(group), **options))
            convert = _CONVERTERS.get(type_name, int)
            found.update({name: tuple(convert(next(flat)) for _ in range(self.size(name))) for name in group})
        return {name: found[name] for name in names}

    def get(self, *names: str) -> NDArray[np.float64]:
        """The values of numeric variables by name, in the order requested, arrays in row-major order."""
        return np.array([element for values in self.read(*names).values() for element in values], dtype=float)

    def __getitem__(self, name: str) -> float:
        """The value of one scalar variable."""
        return float(self.get(name)[0])

    def step(self, h: float) -> None:
        """Co-Simulation: advances by h seconds.

        Raises:
            FmuError: the FMU asks to end the simulation.
        """
        # noSetFMUStatePriorToCurrentPoint is false: an earlier state may be restored at any time.
        answer = self.raw.doStep(
            currentCommunicationPoint=self.time, communicationStepSize=h, noSetFMUStatePriorToCurrentPoint=False
        )
        self.time += h
        if answer is not None and answer[1]:
            raise FmuError(f"at t = {self.time:g} s the FMU asks to end the simulation")

    @property
    def state_names(self) -> tuple[str, ...]:
        """The continuous states by name, in the order of the state vector."""
        return tuple(state.name for state in self._states)

    def set_states(self, x: Sequence[float] | NDArray[np.float64], time: float | None = None) -> None:
        """Model Exchange: sets the continuous states, and the time if given."""
        if time is not None:
            self.time = time
            self.raw.setTime(time)
        if len(x) or self._states:
            self.raw.setContinuousStates((c_double * len(x))(*x), len(x))

    def states(self) -> NDArray[np.float64]:
        """Model Exchange: the continuous states."""
        return self._state_vector(self.raw.getContinuousStates)

    def derivatives(self) -> NDArray[np.float64]:
        """Model Exchange: the derivatives of the continuous states."""
        if self.fmu.version == 2:
            return self._state_vector(self.raw.getDerivatives)
        return self._state_vector(self.raw.getContinuousStateDerivatives)

    def _state_vector(self, get: Any) -> NDArray[np.float64]:
        vector = (c_double * self.size(*self.state_names))()
        if len(vector):
            get(vector, len(vector))
        return np.array(vector)

    def complete_step(self) -> None:
        """Model Exchange: completes an integrator step; handles an event if the FMU requests one or one is due.

        Raises:
            FmuError: the FMU asks to end the simulation, or an event does not settle.
        """
        event = self.next_event_time is not None and self.time >= self.next_event_time
        if self.fmu.element(self.kind).needsCompletedIntegratorStep:
            asked, terminate = self.raw.completedIntegratorStep(noSetFMUStatePriorToCurrentPoint=False)
            if terminate:
                raise FmuError(f"at t = {self.time:g} s the FMU asks to end the simulation")
            event = event or asked
        if event:
            self.raw.enterEventMode()
            self._settle()
            self.raw.enterContinuousTimeMode()

    def directional_derivative(
        self, unknowns: Sequence[str], knowns: Sequence[str], seed: Sequence[float] | NDArray[np.float64]
    ) -> NDArray[np.float64]:
        """J seed, where J is the Jacobian of the unknowns with respect to the knowns, arrays in row-major order."""
        options = {} if self.fmu.version == 2 else {"nSensitivity": self.size(*unknowns)}
        derivative = self.raw.getDirectionalDerivative
        return np.array(derivative(self.references(unknowns), self.references(knowns), list(seed), **options))

    def adjoint_derivative(
        self, unknowns: Sequence[str], knowns: Sequence[str], seed: Sequence[float] | NDArray[np.float64]
    ) -> NDArray[np.float64]:
        """FMI 3.0: seed^T J, with J the Jacobian of the unknowns with respect to the knowns; one value per known."""
        return np.array(
            self.raw.getAdjointDerivative(
                self.references(unknowns), self.references(knowns), list(seed), nSensitivity=self.size(*knowns)
            )
        )

    def save(self) -> Any:
        """A copy of the FMU's state, for `restore`; freed by `discard`."""
        return self.raw.getFMUState()

    def restore(self, state: Any, time: float) -> None:
        """Restores a state that was saved at `time`."""
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
        """Restores a state returned by `serialise` at `time`, in this or another process."""
        state = self.raw.deserializeFMUState(content)
        try:
            self.restore(state, time)
        finally:
            self.discard(state)

    def reset(self) -> None:
        """Resets to the state after instantiation; call `start` next."""
        self.raw.reset()
        self.time = 0.0

    def terminate(self) -> None:
        """Terminates the simulation; values can still be read."""
        self.raw.terminate()


def _elements(values: Value | Values) -> Iterable[Value]:
    if isinstance(values, (str, float, int, bool)):
        return (values,)
    return np.ravel(values).tolist() if isinstance(values, np.ndarray) else values
