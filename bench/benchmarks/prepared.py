"""An FMI 2.0 FMU's binary called by plain ctypes, the fastest way from Python.

There is nothing but ctypes between Python and the binary, and every array and argument is allocated once.
`bench.plant.fmu` does nearly the same, with the checks and copies that a plant needs.
"""

from collections.abc import Callable
from ctypes import CDLL, c_double, c_int, c_size_t, c_uint, c_void_p
from typing import Any

from bench.errors import RunFailed
from platoon_fmu.importer import Instance

Step = Callable[[float, float], None]
"""Advances from a time (s) by a step (s), setting all inputs before and getting all outputs after."""


class PreparedCalls:
    """Arrays and arguments for a started co-simulation instance.

    Attributes:
        input_names, output_names: in the modelDescription's order.
        inputs, outputs: their values, as ctypes arrays; the inputs start with the instance's values.
    """

    def __init__(self, instance: Instance) -> None:
        """Prepare the calls for one instance, which must outlive this object."""
        variables = instance.fmu.description.modelVariables
        self.input_names = [v.name for v in variables if v.causality == "input"]
        self.output_names = [v.name for v in variables if v.causality == "output"]
        self.inputs = (c_double * len(self.input_names))(*instance.get(*self.input_names))
        self.outputs = (c_double * len(self.output_names))()
        self._input_references = (c_uint * len(self.input_names))(*instance.references(self.input_names))
        self._output_references = (c_uint * len(self.output_names))(*instance.references(self.output_names))
        self._instance = instance

    def by_ctypes(self) -> Step:
        """Return the step by ctypes alone; it raises RunFailed if the FMU refuses it."""
        # A separate library object, because fmpy sets the argument types of its own one.
        library = CDLL(self._instance.raw.dll._name)
        set_real, do_step, get_real = library.fmi2SetReal, library.fmi2DoStep, library.fmi2GetReal
        component, start, length, forward = c_void_p(self._instance.raw.component), c_double(), c_double(), c_int(1)
        inputs: tuple[Any, ...] = (component, self._input_references, c_size_t(len(self.inputs)), self.inputs)
        outputs: tuple[Any, ...] = (component, self._output_references, c_size_t(len(self.outputs)), self.outputs)

        def step(time: float, h: float) -> None:
            start.value, length.value = time, h
            if set_real(*inputs) or do_step(component, start, length, forward) or get_real(*outputs):
                raise RunFailed(f"the FMU refused a step from {time} s: {self._instance.said}")

        return step

    def by_fmpy(self) -> Step:
        """Return the step by fmpy's functions with the same arrays; they raise an error if the FMU refuses it."""
        raw = self._instance.raw
        set_real, do_step, get_real, component = raw.fmi2SetReal, raw.fmi2DoStep, raw.fmi2GetReal, raw.component
        inputs: tuple[Any, ...] = (component, self._input_references, len(self.inputs), self.inputs)
        outputs: tuple[Any, ...] = (component, self._output_references, len(self.outputs), self.outputs)

        def step(time: float, h: float) -> None:
            set_real(*inputs)
            do_step(component, time, h, 1)
            get_real(*outputs)

        return step

    def by_fmpys_lists(self) -> Step:
        """Return the step by fmpy's setReal, doStep and getReal, which convert lists to new arrays at every call."""
        raw, values = self._instance.raw, list(self.inputs)
        inputs, outputs = list(self._input_references), list(self._output_references)

        def step(time: float, h: float) -> None:
            raw.setReal(inputs, values)
            raw.doStep(time, h)
            raw.getReal(outputs)

        return step
