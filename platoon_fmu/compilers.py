"""The platforms there can be a binary for, and the C compilers that make it.

`native` is this machine, compiled for by the system's compiler. The named platforms are compiled for by zig's, which
carries headers and C libraries for each of them, so that any machine can make them all.
"""

from __future__ import annotations

import importlib.metadata
import importlib.util
import platform
import shutil
import subprocess
import sys
import tempfile
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path

from platoon_fmu.errors import FmuError, UnknownPlatform

_HERE = Path(__file__).resolve().parent

NATIVE = "native"

# No contraction to fused multiply-adds: every processor then rounds alike, but for sin, cos and atan, which are the C
# library's. No errno: nobody reads it after sqrt.
COMPILER_FLAGS = ("-std=c99", "-O2", "-fPIC", "-ffp-contract=off", "-fno-math-errno", "-fvisibility=hidden")


@dataclass(frozen=True)
class Platform:
    """A system and a processor.

    Attributes:
        name: FMI 3.0's platform tuple, section 2.5.1.4.
        suffix: what the name of a shared library ends with.
        target: what zig calls it, with the oldest C library or system that the binary runs with.
        patience: how long zig takes the first time, where that wants saying: it compiles the C library's parts.
    """

    name: str
    suffix: str
    target: str = ""
    patience: str = ""


PLATFORMS = {
    p.name: p
    for p in (
        Platform("x86_64-linux", ".so", "x86_64-linux-gnu.2.17"),
        Platform("aarch64-linux", ".so", "aarch64-linux-gnu.2.17"),
        Platform("x86_64-darwin", ".dylib", "x86_64-macos.11.0"),
        Platform("aarch64-darwin", ".dylib", "aarch64-macos.11.0"),
        Platform("x86_64-windows", ".dll", "x86_64-windows-gnu", "the first time this takes about two minutes"),
    )
}


@dataclass(frozen=True)
class Compiler:
    """A C compiler that makes shared libraries for one platform.

    Attributes:
        platform: the platform.
        command: the program and the arguments that go before all others.
        linking: arguments for linking a shared library without its symbols.
        identity: what the library's bytes depend on besides the command: the compiler's version.
        licenses: of what the compiler puts into the library besides the sources' code, by file name.
    """

    platform: Platform
    command: tuple[str, ...]
    linking: tuple[str, ...]
    identity: str
    licenses: Mapping[str, Path] = field(default_factory=dict)

    def library(self, name: str, sources: Mapping[str, bytes], inputs: Sequence[str]) -> bytes:
        """A shared library, compiled in a folder of its own with relative names: no path gets into it.

        Args:
            name: of the library, without suffix.
            sources: C files and headers by name.
            inputs: the C files among them to compile.

        Raises:
            FmuError: the compiler fails; the text says what it said.
        """
        with tempfile.TemporaryDirectory(prefix="vehicle-fmu-") as folder:
            directory = Path(folder)
            for file, content in sources.items():
                (directory / file).write_bytes(content)
            library = f"{name}{self.platform.suffix}"
            _run([*self.command, *COMPILER_FLAGS, *inputs, "-o", library, *self.linking], directory)
            return (directory / library).read_bytes()


def compilers(names: Sequence[str]) -> tuple[Compiler, ...]:
    """A compiler for each of the platforms named, no platform twice.

    Args:
        names: keys of `PLATFORMS`, or `native`; what is named takes precedence over `native` of the same name.

    Raises:
        UnknownPlatform: a platform that does not exist, or none at all.
        FmuError: a compiler that is not installed.
    """
    unknown = [name for name in names if name not in (NATIVE, *PLATFORMS)]
    if unknown or not names:
        raise UnknownPlatform(f"no platform '{', '.join(unknown)}': known are {NATIVE}, {', '.join(PLATFORMS)}")
    found = [_zig(platform) for platform in PLATFORMS.values() if platform.name in names]
    if NATIVE in names and this_platform().name not in names:
        found.append(_system())
    return tuple(found)


def this_platform() -> Platform:
    """The machine this runs on.

    Raises:
        FmuError: its binary cannot be built here.
    """
    suffixes = {"Linux": ".so", "Darwin": ".dylib"}
    machine, system = platform.machine().lower(), platform.system()
    if system not in suffixes:
        raise FmuError(
            f"the system's compiler can build the FMU's binary on Linux and macOS, not on {system} ({machine}); "
            f"name a platform instead of {NATIVE}: {', '.join(PLATFORMS)}"
        )
    processor = {"amd64": "x86_64", "arm64": "aarch64", "i386": "x86", "i686": "x86"}.get(machine, machine)
    if processor == "x86_64" and sys.maxsize < 2**32:
        processor = "x86"
    return Platform(f"{processor}-{system.lower()}", suffixes[system])


def _system() -> Compiler:
    here = this_platform()
    for name in ("cc", "gcc", "clang"):
        path = shutil.which(name)
        if path is not None:
            # Apple's linker knows no -s any more.
            strip = () if here.suffix == ".dylib" else ("-s",)
            return Compiler(here, (path,), ("-shared", *strip, "-lm"), _run([path, "--version"], _HERE))
    raise FmuError(
        "no C compiler found (looked for cc, gcc, clang), which building the FMU needs; "
        "on Debian: apt install gcc libc6-dev"
    )


def _zig(target: Platform) -> Compiler:
    found = importlib.util.find_spec("ziglang")
    if found is None or found.origin is None:
        raise FmuError(
            f"building for {target.name} needs zig's C compiler, which is not installed: pip install ziglang"
        )
    command = (sys.executable, "-m", "ziglang", "cc", "-target", target.target)
    folder = Path(found.origin).parent
    licenses = {"zig.txt": folder / "LICENSE"}
    if target.suffix == ".dll":
        licenses["mingw-w64.txt"] = folder / "lib/libc/mingw/COPYING"
    version = importlib.metadata.version("ziglang")
    return Compiler(target, command, ("-shared", "-s", "-lm"), f"zig {version}", licenses)


def _run(command: list[str], directory: Path) -> str:
    done = subprocess.run(command, cwd=directory, capture_output=True, text=True, check=False)
    if done.returncode != 0:
        raise FmuError(f"`{' '.join(command)}` failed with status {done.returncode}:\n{done.stderr.strip()}")
    return done.stdout
