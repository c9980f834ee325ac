"""timing_host.c, compiled and loaded: the FMU's run times when called from C."""

import ctypes
from collections.abc import Callable, Sequence
from ctypes import POINTER, c_double, c_size_t, c_uint, c_void_p
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from bench.errors import RunFailed
from platoon_fmu.compilers import NATIVE, compilers
from platoon_fmu.importer import Instance, OpenFmu

_SOURCE = Path(__file__).with_suffix(".c")
_MODEL = ("vehicle.c", "equations.c")
"""The FMU's sources that are linked into the host."""

_ARRAY = POINTER(c_double)
_REFERENCES = POINTER(c_uint)

Points = NDArray[np.float64]
"""States at which the model is evaluated, in turn: (points, states)."""


class TimingHost:
    """The loops of timing_host.c: each returns the mean seconds per unit of work; RunFailed if a call is refused."""

    def __init__(self, fmu2: OpenFmu, fmu3: OpenFmu, folder: Path) -> None:
        """Compile the host in `folder` with the FMUs' sources and their compiler options.

        Raises:
            FmuError: there is no C compiler, or it fails.
        """
        sources = {path.name: path.read_bytes() for path in _sources(fmu3)}
        sources |= {path.name: path.read_bytes() for path in (*_sources(fmu2), _SOURCE)}
        compiler = compilers((NATIVE,))[0]
        library = folder / f"timing_host{compiler.platform.suffix}"
        library.write_bytes(compiler.library("timing_host", sources, (_SOURCE.name, *_MODEL)))
        self._library = ctypes.CDLL(str(library))

    def _call(self, name: str, *arguments: object) -> float:
        function = getattr(self._library, name)
        function.restype = c_double
        seconds = float(function(*arguments))
        if seconds < 0.0:
            raise RunFailed(f"the FMU refused a call of {name}")
        return seconds

    def model(self, points: Points, calls: int) -> float:
        """One right-hand side of the model, without any FMI."""
        return self._call("time_model", points.ctypes.data_as(_ARRAY), c_size_t(len(points)), c_size_t(calls))

    def right_hand_side(self, instance: Instance, points: Points, calls: int) -> float:
        """One right-hand side of an FMI 2.0 instance for Model Exchange: states in, derivatives out."""
        functions = _functions(instance, "SetContinuousStates", "GetDerivatives")
        return self._call("time_right_hand_side", *functions, *_points(points), c_size_t(calls))

    def directional(self, instance: Instance, points: Points, calls: int) -> float:
        """The derivatives' Jacobian with respect to the states, from a directional derivative for each state."""
        functions = _functions(instance, "SetContinuousStates", "GetDirectionalDerivative")
        derivatives = [unknown.variable.valueReference for unknown in instance.fmu.description.derivatives]
        references = (_references(instance.references(instance.state_names)), _references(derivatives))
        return self._call("time_directional", *functions, *references, *_points(points), c_size_t(calls))

    def differences(self, instance: Instance, points: Points, calls: int) -> float:
        """The same Jacobian from central differences: two right-hand sides for each state."""
        functions = _functions(instance, "SetContinuousStates", "GetDerivatives")
        return self._call("time_differences", *functions, *_points(points), c_size_t(calls))

    def steps(self, instances: Sequence[Instance], h: float, steps: int) -> Callable[[], float]:
        """Return a measure that does `steps` steps of `h` s with each instance in turn, per step and instance.

        The instances are of one FMU and at the same time; they continue from call to call.
        """
        version = instances[0].fmu.version
        components = (c_void_p * len(instances))(*(instance.raw.component for instance in instances))
        (step, _) = _functions(instances[0], "DoStep")

        def seconds() -> float:
            arguments = (c_size_t(len(instances)), c_double(instances[0].time), c_double(h), c_size_t(steps))
            result = self._call(f"time_steps_{version}", step, components, *arguments)
            for instance in instances:
                instance.time += steps * h
            return result

        return seconds


def _sources(fmu: OpenFmu) -> list[Path]:
    return sorted((fmu.folder / "sources").glob("*.[ch]"))


def _functions(instance: Instance, *names: str) -> tuple[c_void_p, ...]:
    """Return the addresses of functions in the FMU's binary, and the instance."""
    functions = (getattr(instance.raw.dll, f"fmi{instance.fmu.version}{name}") for name in names)
    return (*(ctypes.cast(function, c_void_p) for function in functions), c_void_p(instance.raw.component))


def _points(points: Points) -> tuple[object, ...]:
    return points.ctypes.data_as(_ARRAY), c_size_t(points.shape[0]), c_size_t(points.shape[1])


def _references(references: Sequence[int]) -> object:
    return ctypes.cast((c_uint * len(references))(*references), _REFERENCES)
