"""Compiles the host in host/, which is an importer in C, and runs its scenarios with an FMU's binary."""

from __future__ import annotations

import shutil
import subprocess
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cache
from pathlib import Path
from typing import Any

import pytest

from platoon_fmu.compilers import COMPILER_FLAGS
from platoon_fmu.importer import Kind, OpenFmu

_HOST = Path(__file__).resolve().parent / "host"
_WARNINGS = ("-Wall", "-Wextra", "-Wpedantic", "-Werror")
_HOST_FLAGS = ("-std=c11", "-D_POSIX_C_SOURCE=200809L", "-O1", "-g", "-ffp-contract=off", *_WARNINGS)
# CasADi's code has parameters and pragmas of no use.
_OF_SOURCES = ("-Wall", "-Wextra", "-Werror", "-Wno-unused-parameter", "-Wno-unknown-pragmas")
# The host's allocator counts, and can fail (host/memory.c).
_COUNTING = ("-Dmalloc=host_malloc", "-Dcalloc=host_calloc", "-Dfree=host_free")

VALGRIND = (
    "valgrind", "--quiet", "--error-exitcode=99", "--leak-check=full",
    "--show-leak-kinds=definite,indirect,possible", "--errors-for-leak-kinds=definite,indirect,possible",
)  # fmt: skip
HELGRIND = ("valgrind", "--quiet", "--error-exitcode=99", "--tool=helgrind")


@dataclass(frozen=True)
class Make:
    """How host and binary are compiled.

    Attributes:
        flags: for both.
        own_binary: flags for a binary of the FMU's own sources; None takes the one that is packed.
    """

    flags: tuple[str, ...] = ()
    own_binary: tuple[str, ...] | None = None


PACKED = Make()
COUNTED = Make(own_binary=("-O1", *_COUNTING))
# Optimised, the sanitizers take the compiler a minute over the Jacobians.
SANITIZED = Make(
    ("-fsanitize=address,undefined", "-fno-sanitize-recover=all", "-fno-omit-frame-pointer"), ("-O0", "-g", *_COUNTING)
)
THREAD_SANITIZED = Make(("-fsanitize=thread",), ("-O0", "-g"))


@dataclass(frozen=True)
class Output:
    """What a scenario has printed: lines `label: text`."""

    lines: tuple[tuple[str, str], ...]

    def __getitem__(self, label: str) -> str:
        """The text of the one line with the label."""
        (text,) = self.all(label)
        return text

    def all(self, label: str) -> list[str]:
        """The texts of all lines with the label."""
        return [text for found, text in self.lines if found == label]

    def reals(self, label: str) -> list[float]:
        """The values of the one line with the label."""
        return [float.fromhex(value) for value in self[label].split()]


@dataclass(frozen=True)
class Host:
    """A compiled host with all it needs to run.

    Attributes:
        program: the executable.
        binary: the FMU's.
        token: the FMU's guid or instantiation token.
        variables: a file of the FMU's variables, as the host reads it.
    """

    program: Path
    binary: Path
    token: str
    variables: Path

    def run(self, kind: Kind, scenario: str, number: int = 1, under: Sequence[str] = ()) -> Output:
        """Runs a scenario, which must end well.

        Args:
            kind: interface type.
            scenario: its name in host.c.
            number: its argument.
            under: a command that runs the host, such as VALGRIND.
        """
        if under and shutil.which(under[0]) is None:
            pytest.skip(f"{under[0]} is not installed")
        short = "me" if kind is Kind.MODEL_EXCHANGE else "cs"
        arguments = [self.program, self.binary, self.token, self.variables, short, scenario, str(number)]
        done = subprocess.run([*under, *map(str, arguments)], capture_output=True, text=True, check=False)
        assert done.returncode == 0, done.stdout[-2000:] + done.stderr[-4000:]
        assert done.stderr == ""
        pairs = (line.partition(":") for line in done.stdout.splitlines())
        return Output(tuple((label, text.strip()) for label, _, text in pairs))


class Workshop:
    """Compiles hosts in a folder, each one once."""

    def __init__(self, folder: Path) -> None:
        self._folder = folder
        self._hosts: dict[tuple[int, Make], Host] = {}

    def host(self, fmu: OpenFmu, make: Make) -> Host:
        """The host for an FMU."""
        key = fmu.version, make
        if key not in self._hosts:
            folder = self._folder / str(len(self._hosts))
            folder.mkdir()
            self._hosts[key] = _made(fmu, make, folder)
        return self._hosts[key]


@cache
def workshop_in(session: Path) -> Workshop:
    """The one workshop of a session of pytest, for all files of tests, in the session's temporary folder."""
    folder = session / "hosts"
    folder.mkdir()
    return Workshop(folder)


@cache
def _compiler() -> str:
    found = shutil.which("cc") or shutil.which("gcc") or shutil.which("clang")
    assert found, "building the FMU has needed a compiler, too"
    return found


def _made(fmu: OpenFmu, make: Make, folder: Path) -> Host:
    if make.flags:
        _require(make.flags, folder)
    program, headers = folder / "host", fmu.folder / "sources"
    faces = {f"host{version}.c" for version in (2, 3)} - {f"host{fmu.version}.c"}
    sources = [str(path) for path in sorted(_HOST.glob("*.c")) if path.name not in faces]
    # The standard's headers are not ours to keep clean.
    arguments = [*_HOST_FLAGS, *make.flags, f"-I{_HOST}", "-isystem", str(headers), *sources]
    # The binary of own sources calls the host's allocator.
    _compile([*arguments, "-rdynamic", "-o", str(program), "-ldl", "-lm", "-lpthread"])
    if make.own_binary is None:
        (binary,) = fmu.folder.glob("binaries/*/*.so")
    else:
        binary = folder / "Vehicle.so"
        flags = [*COMPILER_FLAGS, *_OF_SOURCES, *make.own_binary, *make.flags]
        _compile([*flags, *map(str, sorted(headers.glob("*.c"))), "-shared", "-o", str(binary), "-lm"])
    variables = folder / "variables.txt"
    variables.write_text(_groups(fmu))
    return Host(program, binary, fmu.description.guid or fmu.description.instantiationToken, variables)


def _compile(arguments: Sequence[str]) -> None:
    done = subprocess.run([_compiler(), *arguments], capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
    assert done.stderr == ""


def _require(flags: Sequence[str], folder: Path) -> None:
    """Skips the test where programs compiled so do not run here."""
    source, program = folder / "nothing.c", folder / "nothing"
    source.write_text("int main(void) { return 0; }\n")
    command = [_compiler(), *flags, str(source), "-o", str(program)]
    if subprocess.run(command, capture_output=True, check=False).returncode != 0:
        pytest.skip(f"the compiler has no {flags[0]}")
    if subprocess.run([program], capture_output=True, check=False).returncode != 0:
        pytest.skip(f"programs with {flags[0]} do not run here")


def _groups(fmu: OpenFmu) -> str:
    """The host's file of variables."""
    variables = fmu.description.modelVariables
    states = {v.derivative.name for v in variables if v.derivative is not None}

    def group(variable: Any) -> str:
        if variable.name in states:
            return "state"
        if variable.derivative is not None:
            return "derivative"
        # The solver's are no parameters of the model: nothing is differentiated over them.
        return "setting" if variable.name.startswith("solver") else variable.causality

    return "".join(f"{group(v)} {v.valueReference} {v.name}\n" for v in variables)
