"""The checks behind `platoon doctor`: what this machine can do, and how to install what is missing."""

import importlib.metadata
import os
import platform
import shutil
import subprocess
import sys
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path

from bench.bus.link.address import Address, settle
from bench.bus.link.opening import open_link
from bench.cli.machine_code import SLOWER
from bench.compiled.build import require_compiler
from bench.compiled.finder import INTERPRETED, current_libraries, is_wanted
from bench.errors import BadInput, BenchError
from bench.vcan.machine import require_packages
from platoon_fmu.build import default_fmu
from platoon_fmu.errors import FmuError

LEAST_PYTHON = (3, 11)
WANTED_CORES = 2
WANTED_BUFFER_BYTES = 8 * 1024 * 1024
"""Receive buffer (bytes) with which no frame of a run is lost."""

_COMPILERS = ("cc", "gcc", "clang")
_PACKAGES = ("casadi", "clarabel", "cvxpy", "cython", "fmpy", "mcap", "numpy", "python-can", "cantools", "pydantic")


@dataclass(frozen=True)
class Finding:
    """One thing that was checked.

    Attributes:
        subject: what was checked.
        fine: whether it is as required.
        found: what is there.
        mend: what to do if it is not.
        needed: whether no run works without it.
    """

    subject: str
    fine: bool
    found: str
    mend: str = ""
    needed: bool = False


def examine(logs: Path) -> Iterator[Finding]:
    """Examine this machine, one finding after the other.

    Args:
        logs: the directory that runs are written to.
    """
    yield _python()
    yield _packages()
    yield _compiler()
    yield _machine_code()
    yield _fmu()
    yield _bus("bus udp", "udp", "UDP multicast reaches this host")
    yield _bus("bus vcan", "vcan", "SocketCAN links vcan0 to vcan3 are up")
    yield _small_kernel()
    yield _receive_buffer()
    yield _cores()
    yield _writable(logs)


def _python() -> Finding:
    found = f"{platform.python_version()} on {platform.platform()}"
    wanted = ".".join(map(str, LEAST_PYTHON))
    return Finding("Python", sys.version_info >= LEAST_PYTHON, found, f"install Python {wanted} or newer", True)


def _packages() -> Finding:
    versions, missing = [], []
    for name in _PACKAGES:
        try:
            versions.append(f"{name} {importlib.metadata.version(name)}")
        except importlib.metadata.PackageNotFoundError:
            missing.append(name)
    found = ", ".join(versions) + (f"; missing: {', '.join(missing)}" if missing else "")
    return Finding("packages", not missing, found, "make setup", True)


def _compiler() -> Finding:
    path = next(filter(None, map(shutil.which, _COMPILERS)), None)
    mend = "needed to build the FMU; on Debian or Ubuntu: sudo apt-get install gcc libc6-dev"
    if path is None:
        return Finding("C compiler", False, f"none of {', '.join(_COMPILERS)}", mend)
    options = [path, "-fsyntax-only", "-x", "c", "-"]
    tried = subprocess.run(options, input="#include <math.h>\n", capture_output=True, text=True, check=False)
    if tried.returncode:
        return Finding("C compiler", False, f"{path} without the C library's headers", mend)
    version = subprocess.run([path, "--version"], capture_output=True, text=True, check=False).stdout
    return Finding("C compiler", True, version.partition("\n")[0] or path)


def _machine_code() -> Finding:
    if not is_wanted():
        found = f"the bench is interpreted, {SLOWER}, as {INTERPRETED} is set"
        return Finding("machine code", False, found, f"unset {INTERPRETED}")
    folder = current_libraries()
    if folder is not None:
        return Finding("machine code", True, f"the bench is compiled, in {folder}")
    try:
        require_compiler()
    except BadInput as error:
        return Finding("machine code", False, str(error), f"or interpreted, {SLOWER}: {INTERPRETED}=1", True)
    return Finding("machine code", False, "the bench is not compiled", "the next run does it, in one to three minutes")


def _fmu() -> Finding:
    try:
        fmu = default_fmu()
    except FmuError as error:
        return Finding("vehicle FMU", False, str(error), "platoon fmu build", True)
    return Finding("vehicle FMU", True, f"{fmu} ({fmu.stat().st_size // 1024} KiB)")


def _bus(subject: str, address: str, found: str) -> Finding:
    """Open the buses of three vehicles as a run would."""

    def attempt() -> None:
        with settle(Address.parse(address), 3) as settled, open_link("v2v", settled):
            pass

    problem = _refusal(attempt)
    if problem is None:
        return Finding(subject, True, found)
    reason, _, commands = problem.partition("\n")
    return Finding(subject, False, reason, commands)


def _small_kernel() -> Finding:
    try:
        require_packages()
    except BadInput as error:
        found, _, mend = str(error).partition("\n")
        return Finding("platoon vcan", False, found.removeprefix("platoon vcan: "), mend)
    return Finding("platoon vcan", True, "user-mode Linux is installed, for a kernel with CAN links")


def _refusal(attempt: Callable[[], None]) -> str | None:
    try:
        attempt()
    except BenchError as error:
        return str(error)
    return None


def _receive_buffer() -> Finding:
    limit = Path("/proc/sys/net/core/rmem_max")
    if not limit.is_file():
        return Finding("receive buffer", True, "the system's limit cannot be read")
    allowed = int(limit.read_text())
    # Root may go beyond the limit (SO_RCVBUFFORCE).
    fine = allowed >= WANTED_BUFFER_BYTES or os.geteuid() == 0
    found = f"up to {allowed // 1024} KiB" + (", any size as root" if os.geteuid() == 0 else "")
    return Finding("receive buffer", fine, found, f"sudo sysctl -w net.core.rmem_max={WANTED_BUFFER_BYTES}")


def _cores() -> Finding:
    cores = len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1
    mend = f"runs work, but slower than with {WANTED_CORES} or more"
    return Finding("cores", cores >= WANTED_CORES, str(cores), mend)


def _writable(logs: Path) -> Finding:
    place = logs if logs.exists() else logs.parent
    fine = place.is_dir() and os.access(place, os.W_OK)
    free = f", {shutil.disk_usage(place).free / 1e9:.1f} GB free" if place.is_dir() else ""
    return Finding("logs", fine, f"{logs.absolute()}{free}", "name another place with --out", True)
