"""One FMU instance for co-simulation, called with preallocated arrays (FMI 2.0.4, section 4).

Getting, setting and stepping are called a hundred times a second: in machine code as C functions, declared in
`fmi2.pxd`, otherwise by ctypes.
"""

from __future__ import annotations

import hashlib
import os
import shutil
import tempfile
import zipfile
from array import array
from collections.abc import Collection, Mapping
from ctypes import POINTER, c_double, c_uint, c_void_p, cast
from pathlib import Path
from typing import Any

import cython

from bench.errors import RunFailed
from bench.plant.description import FmuDescription
from bench.plant.library import WARNING, Component, FmiError, failure

if cython.compiled:
    from cython.cimports.bench.plant.fmi2 import AccessReal, DoStep

_WARNING: int = WARNING
_TRUE = 1


def unpack(fmu: Path) -> Path:
    """Return the folder with the contents of `fmu`, unpacked beside it on first use.

    It is not a temporary folder, which a killed plant would leave behind.

    Raises:
        RunFailed: it cannot be unpacked there.
    """
    digest = hashlib.sha256(fmu.read_bytes()).hexdigest()[:16]
    folder = fmu.parent / f"{fmu.stem}.unpacked" / digest
    if folder.is_dir():
        return folder
    try:
        folder.parent.mkdir(exist_ok=True)
        partial = Path(tempfile.mkdtemp(dir=folder.parent, prefix=".part-"))
        try:
            with zipfile.ZipFile(fmu) as archive:
                archive.extractall(partial)
            os.rename(partial, folder)  # noqa: PTH104 - must fail if another plant was first
        except OSError:
            shutil.rmtree(partial, ignore_errors=True)
            if not folder.is_dir():
                raise
    except OSError as error:
        raise RunFailed(f"{fmu} cannot be unpacked to {folder.parent}: {error}") from error
    return folder


class _Values:
    """The values of a fixed list of variables, and the arguments that FMI's get and set take for them.

    Attributes:
        references: the value reference of each variable.
        values: the value of each.
        first_reference, first: pointers to the first of these.
        count: number of variables.
    """

    def __init__(self, description: FmuDescription, names: Collection[str]) -> None:
        missing = [name for name in names if name not in description.references]
        if missing:
            raise RunFailed(f"the FMU has no variable {', '.join(missing)}; rebuild it: platoon fmu build")
        self.references = array("I", [description.references[name] for name in names])
        self.values = array("d", bytes(8 * len(names)))
        self.count = len(names)
        references, values = self.references.buffer_info()[0], self.values.buffer_info()[0]
        if cython.compiled:
            self.first_reference = cython.cast("unsigned int *", cython.cast(cython.size_t, references))
            self.first = cython.cast("double *", cython.cast(cython.size_t, values))
        else:
            self.first_reference = cast(references, POINTER(c_uint))
            self.first = cast(values, POINTER(c_double))


class FmuInstance:
    """One vehicle: an instance in the FMU's library.

    Attributes:
        name: its name.
    """

    def __init__(self, description: FmuDescription, folder: Path, name: str, start: Mapping[str, float]) -> None:
        """Create the instance `name` of the FMU unpacked in `folder`, with the parameters `start`, at time 0.

        Raises:
            RunFailed: the FMU has no binary for this machine, or refuses its start values.
        """
        self.name = name
        self._outputs = _Values(description, description.outputs)
        self._inputs = _Values(description, description.inputs)
        parameters = _Values(description, start)
        try:
            self._component = Component(folder, description.model_identifier, description.guid, name)
        except FmiError as error:
            raise RunFailed(f"{name}: the FMU cannot be loaded on this machine: {error}") from error
        library, handle = self._component.library, self._component.handle
        if cython.compiled:
            self._handle = cython.cast(cython.p_void, cython.cast(cython.size_t, handle))
            self._get_real = cython.cast(AccessReal, cython.cast(cython.size_t, _place_of(library.fmi2GetReal)))
            self._set_real = cython.cast(AccessReal, cython.cast(cython.size_t, _place_of(library.fmi2SetReal)))
            self._do_step = cython.cast(DoStep, cython.cast(cython.size_t, _place_of(library.fmi2DoStep)))
        else:
            self._handle = handle
            self._get_real, self._set_real = library.fmi2GetReal, library.fmi2SetReal
            self._do_step = library.fmi2DoStep
        try:
            self._component.start(parameters.references, list(start.values()))
        except FmiError as error:
            raise self._failed(error) from error
        self._get(self._inputs)

    def outputs(self) -> array[float]:
        """Return all outputs in the description's order, in the FMU's units; they change with the next call.

        Raises:
            RunFailed: the FMU cannot calculate them.
        """
        self._get(self._outputs)
        return self._outputs.values

    def inputs(self) -> array[float]:
        """Return the inputs as last set, in the description's order; they change with the next step."""
        return self._inputs.values

    def step(self, time_s: cython.double, length_s: cython.double, inputs: Collection[float]) -> None:
        """Set all inputs, in the description's order, and advance by `length_s` s from `time_s`.

        Raises:
            RunFailed: the FMU does not accept the inputs or the step fails.
        """
        values = self._inputs
        for place, value in enumerate(inputs):
            values.values[place] = value
        self._check("fmi2SetReal", self._set_real(self._handle, values.first_reference, values.count, values.first))
        self._check("fmi2DoStep", self._do_step(self._handle, time_s, length_s, _TRUE))

    def close(self) -> None:
        """Free the instance.

        Raises:
            RunFailed: it does not terminate.
        """
        try:
            self._component.end()
        except FmiError as error:
            raise self._failed(error) from error

    def _get(self, of: _Values) -> None:
        self._check("fmi2GetReal", self._get_real(self._handle, of.first_reference, of.count, of.first))

    def _check(self, function: str, status: cython.int) -> None:
        if status > _WARNING:
            raise self._failed(failure(function, status))

    def _failed(self, error: FmiError) -> RunFailed:
        return RunFailed(f"the FMU of {self.name} failed: {error}")


def _place_of(function: Any) -> int:
    """Return where a function of a library begins."""
    return cast(function, c_void_p).value or 0
