"""The functions of FMI 2.0 for co-simulation that the bench calls, as an FMU's library exports them (FMI 2.0.4).

fmpy has all functions of all versions, but loading it takes longer than all else that a plant does before it runs.
"""

from ctypes import (
    CDLL,
    CFUNCTYPE,
    POINTER,
    Structure,
    byref,
    c_char_p,
    c_double,
    c_int,
    c_size_t,
    c_uint,
    c_void_p,
    cast,
)
from pathlib import Path
from typing import Any

TRUE, FALSE = 1, 0
WARNING = 1
"""The highest status of a call that has not failed."""

_STATUS = ("ok", "warning", "discard", "error", "fatal", "pending")
_CO_SIMULATION = 1
_REALS = (c_void_p, POINTER(c_uint), c_size_t, POINTER(c_double))
_ARGUMENTS: dict[str, tuple[Any, ...]] = {
    "fmi2SetupExperiment": (c_void_p, c_int, c_double, c_double, c_int, c_double),
    "fmi2EnterInitializationMode": (c_void_p,),
    "fmi2ExitInitializationMode": (c_void_p,),
    "fmi2GetReal": _REALS,
    "fmi2SetReal": _REALS,
    "fmi2DoStep": (c_void_p, c_double, c_double, c_int),
    "fmi2Terminate": (c_void_p,),
    "fmi2FreeInstance": (c_void_p,),
}
_Logger = CFUNCTYPE(None, c_void_p, c_char_p, c_int, c_char_p, c_char_p)


@_Logger
def _log(_environment: int | None, _instance: bytes, status: int, _category: bytes, text: bytes) -> None:
    """Print a message of an FMU, which ends up in the reported last output."""
    print(f"[{_name(status).upper()}] {text.decode(errors='replace')}")  # noqa: T201 - see above


class _Callbacks(Structure):
    """`fmi2CallbackFunctions`: what an FMU calls."""

    _fields_ = (
        ("logger", _Logger),
        ("allocate_memory", c_void_p),
        ("free_memory", c_void_p),
        ("step_finished", c_void_p),
        ("component_environment", c_void_p),
    )


_LIBC = CDLL(None)
_CALLBACKS = _Callbacks(_log, cast(_LIBC.calloc, c_void_p), cast(_LIBC.free, c_void_p), None, None)


def load(file: Path) -> CDLL:
    """Return an FMU's library, its functions declared.

    Raises:
        OSError: it cannot be loaded.
        AttributeError: it lacks a function.
    """
    library = CDLL(str(file))
    for function, arguments in _ARGUMENTS.items():
        getattr(library, function).argtypes = arguments
    library.fmi2FreeInstance.restype = None
    library.fmi2Instantiate.argtypes = (c_char_p, c_int, c_char_p, c_char_p, POINTER(_Callbacks), c_int, c_int)
    library.fmi2Instantiate.restype = c_void_p
    return library


def instantiate(library: CDLL, name: str, guid: str, resources: Path) -> c_void_p:
    """Return a new instance, null if the FMU refuses; with logging on, it prints why this or a later call fails."""
    place = resources.as_uri().encode()
    return c_void_p(
        library.fmi2Instantiate(name.encode(), _CO_SIMULATION, guid.encode(), place, byref(_CALLBACKS), FALSE, TRUE)
    )


def failure(function: str, status: int) -> str:
    """Return the sentence about a call that has failed."""
    return f"{function} failed with status {status} ({_name(status)})."


def _name(status: int) -> str:
    return _STATUS[status] if 0 <= status < len(_STATUS) else "illegal return code"
