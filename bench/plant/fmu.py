"""One FMU instance for co-simulation, called with preallocated arrays (FMI 2.0.4, section 4).

fmpy loads the library and declares its functions. Its getters and setters allocate new ctypes arrays at every call,
which costs twice the FMU's step, so the library's functions are called directly with preallocated arguments.
"""

import hashlib
import os
import shutil
import tempfile
import zipfile
from collections.abc import Callable, Collection, Mapping
from ctypes import c_double, c_uint
from pathlib import Path
from typing import Any

from fmpy.fmi1 import FMICallException
from fmpy.fmi2 import FMU2Slave, fmi2True, fmi2Warning

from bench.errors import RunFailed
from bench.plant.description import FmuDescription


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
    """The values of a fixed list of variables, and the arguments that FMI's get and set take for them."""

    def __init__(self, description: FmuDescription, names: Collection[str], component: Any) -> None:
        missing = [name for name in names if name not in description.references]
        if missing:
            raise RunFailed(f"the FMU has no variable {', '.join(missing)}; rebuild it: platoon fmu build")
        references = (c_uint * len(names))(*(description.references[name] for name in names))
        self.values = (c_double * len(names))()
        self.arguments = (component, references, len(names), self.values)


class FmuInstance:
    """One vehicle: an instance in the FMU's library."""

    def __init__(self, description: FmuDescription, folder: Path, name: str, start: Mapping[str, float]) -> None:
        """Create the instance `name` of the FMU unpacked in `folder`, with the parameters `start`, at time 0.

        Raises:
            RunFailed: the FMU has no binary for this machine, or refuses its start values.
        """
        self.name = name
        try:
            self._slave = FMU2Slave(
                guid=description.guid,
                unzipDirectory=str(folder),
                modelIdentifier=description.model_identifier,
                instanceName=name,
            )
        except Exception as error:
            raise RunFailed(f"{name}: the FMU cannot be loaded on this machine: {error}") from error
        try:
            # With logging on, the FMU prints its error messages, which end up in the reported last output.
            self._slave.instantiate(loggingOn=True)
        except Exception as error:
            raise RunFailed(f"{name}: the FMU cannot be loaded on this machine: it creates no instance") from error
        library, component = self._slave.dll, self._slave.component
        self._get_real, self._set_real, self._do_step = library.fmi2GetReal, library.fmi2SetReal, library.fmi2DoStep
        self._component = component
        self._outputs = _Values(description, description.outputs, component)
        self._inputs = _Values(description, description.inputs, component)
        parameters = _Values(description, start, component)
        parameters.values[:] = list(start.values())
        self._call(self._slave.setupExperiment)
        self._check("fmi2SetReal", self._set_real(*parameters.arguments))
        self._call(self._slave.enterInitializationMode)
        self._call(self._slave.exitInitializationMode)
        self._check("fmi2GetReal", self._get_real(*self._inputs.arguments))

    def outputs(self) -> list[float]:
        """Return all outputs in the description's order, in the FMU's units.

        Raises:
            RunFailed: the FMU cannot calculate them.
        """
        self._check("fmi2GetReal", self._get_real(*self._outputs.arguments))
        return self._outputs.values[:]

    def inputs(self) -> list[float]:
        """Return the inputs as last set, in the description's order."""
        return self._inputs.values[:]

    def step(self, time_s: float, length_s: float, inputs: list[float]) -> None:
        """Set all inputs, in the description's order, and advance by `length_s` s from `time_s`.

        Raises:
            RunFailed: the FMU does not accept the inputs or the step fails.
        """
        self._inputs.values[:] = [*inputs]
        self._check("fmi2SetReal", self._set_real(*self._inputs.arguments))
        self._check("fmi2DoStep", self._do_step(self._component, time_s, length_s, fmi2True))

    def close(self) -> None:
        """Free the instance."""
        self._call(self._slave.terminate)
        self._slave.freeInstance()

    def _check(self, function: str, status: int) -> None:
        if status > fmi2Warning:
            raise RunFailed(f"the FMU of {self.name} failed: {FMICallException(function, status)}")

    def _call(self, function: Callable[[], Any]) -> None:
        try:
            function()
        except FMICallException as error:
            raise RunFailed(f"the FMU of {self.name} failed: {error}") from error
