"""The binary of an FMU for co-simulation, as ctypes loads it (FMI 2.0.4, sections 2.1 and 4.2).

Only the functions that the bench calls, so that the start of a run does not wait for a whole importer. `platoon fmu
check` and the tests drive the FMU with importers of others.
"""

from collections.abc import Collection, Mapping
from ctypes import CDLL, CFUNCTYPE, POINTER, Structure, byref, c_char_p, c_double, c_int, c_size_t, c_uint, c_void_p
from ctypes import cast as pointer_cast
from pathlib import Path
from typing import Any

from platoon_fmu.compilers import this_platform
from platoon_fmu.errors import FmuError
from platoon_fmu.versions import FMI2

WARNING = 1
"""The worst fmi2Status with which a function has done its work."""

_STATUSES = ("ok", "warning", "discard", "error", "fatal", "pending")
_CO_SIMULATION = 1
_NO, _YES = 0, 1

_Logger = CFUNCTYPE(None, c_void_p, c_char_p, c_int, c_char_p, c_char_p)
_Allocate = CFUNCTYPE(c_void_p, c_size_t, c_size_t)
_Free = CFUNCTYPE(None, c_void_p)

_FUNCTIONS: Mapping[str, tuple[Any, tuple[Any, ...]]] = {
    "fmi2SetupExperiment": (c_int, (c_void_p, c_int, c_double, c_double, c_int, c_double)),
    "fmi2EnterInitializationMode": (c_int, (c_void_p,)),
    "fmi2ExitInitializationMode": (c_int, (c_void_p,)),
    "fmi2GetReal": (c_int, (c_void_p, POINTER(c_uint), c_size_t, POINTER(c_double))),
    "fmi2SetReal": (c_int, (c_void_p, POINTER(c_uint), c_size_t, POINTER(c_double))),
    "fmi2DoStep": (c_int, (c_void_p, c_double, c_double, c_int)),
    "fmi2Terminate": (c_int, (c_void_p,)),
    "fmi2FreeInstance": (None, (c_void_p,)),
}
"""The functions of an instance: result and arguments."""


class _Callbacks(Structure):
    """The type fmi2CallbackFunctions."""

    _fields_ = (
        ("logger", _Logger),
        ("allocateMemory", _Allocate),
        ("freeMemory", _Free),
        ("stepFinished", c_void_p),
        ("componentEnvironment", c_void_p),
    )


class FmiError(Exception):
    """A function of the FMU has not done its work."""


def failure(function: str, status: int) -> FmiError:
    """Return the error of a function that returned a status worse than `WARNING`."""
    return FmiError(f"{function} failed with status {status} ({_STATUSES[status]})")


class Component:
    """One instance in an FMU's library.

    Attributes:
        handle: its fmi2Component.
        library: the loaded library; its functions are those of `_FUNCTIONS`.
    """

    def __init__(self, folder: Path, model_identifier: str, guid: str, name: str) -> None:
        """Load the FMU unpacked in `folder` and instantiate it.

        Raises:
            FmiError: there is no binary for this machine, it cannot be loaded, or it creates no instance.
        """
        try:
            self.library = CDLL(str(_binary(folder, model_identifier)))
            instantiate = self.library.fmi2Instantiate
            for function, (result, arguments) in _FUNCTIONS.items():
                found = getattr(self.library, function)
                found.restype, found.argtypes = result, arguments
        except (OSError, AttributeError, FmuError) as error:
            raise FmiError(str(error)) from error
        instantiate.restype = c_void_p
        system = CDLL(None)
        # The FMU keeps a pointer to them. With logging on, it prints its errors, which end up in the last output.
        self._callbacks = _Callbacks(_Logger(_say), _of(system.calloc, _Allocate), _of(system.free, _Free))
        self.handle = instantiate(
            name.encode(),
            _CO_SIMULATION,
            guid.encode(),
            (folder / "resources").absolute().as_uri().encode(),
            byref(self._callbacks),
            _NO,
            _YES,
        )
        if self.handle is None:
            raise FmiError("it creates no instance")

    def start(self, references: Collection[int], values: Collection[float]) -> None:
        """Set parameters and initialize the instance at time 0.

        Raises:
            FmiError: it refuses.
        """
        self._call("fmi2SetupExperiment", _NO, 0.0, 0.0, _NO, 0.0)
        count = len(references)
        self._call("fmi2SetReal", (c_uint * count)(*references), count, (c_double * count)(*values))
        self._call("fmi2EnterInitializationMode")
        self._call("fmi2ExitInitializationMode")

    def end(self) -> None:
        """Terminate and free the instance.

        Raises:
            FmiError: it does not terminate; it is not freed.
        """
        self._call("fmi2Terminate")
        self.library.fmi2FreeInstance(self.handle)

    def _call(self, function: str, *arguments: Any) -> None:
        status = getattr(self.library, function)(self.handle, *arguments)
        if status > WARNING:
            raise failure(function, status)


def _say(_environment: int, _name: bytes, status: int, _category: bytes, message: bytes) -> None:
    print(f"[{_STATUSES[status].upper()}] {message.decode(errors='replace')}")  # noqa: T201 - see where it is passed


def _of(function: Any, kind: Any) -> Any:
    """Return a function of the C library as a callback."""
    return pointer_cast(function, kind)


def _binary(folder: Path, model_identifier: str) -> Path:
    """Return the path of an FMU's library for this machine.

    Raises:
        FmiError: there is none.
        FmuError: this is not a machine for which the bench can build one.
    """
    here = this_platform()
    file = f"{model_identifier}{here.suffix}"
    paths = [folder / "binaries" / place / file for place in FMI2.folders_of(here.name)]
    for path in paths:
        if path.is_file():
            return path.absolute()
    raise FmiError(f"there is no {' or '.join(map(str, paths))}")
