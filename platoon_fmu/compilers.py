"""The platforms for which binaries can be built, and their C compilers.

`native` is this machine, using the system's compiler. The named platforms use zig's compiler, which includes headers
and C libraries for each, so that any machine can build for all of them.
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

# No contraction to fused multiply-adds: every processor then rounds alike, except in sin, cos and atan, which are the C
# library's. No errno: nothing reads it after sqrt.
COMPILER_FLAGS = ("-std=c99", "-O2", "-fPIC", "-ffp-contract=off", "-fno-math-errno", "-fvisibility=hidden")


@dataclass(frozen=True)
class Platform:
    """A system and a processor.

    Attributes:
        name: FMI 3.0's platform tuple, section 2.5.1.4.
        suffix: of a shared library's file name.
        target: zig's name for it, with the oldest C library or system on which the binary runs.
        patience: how long zig takes the first time, if long: it also compiles parts of the C library.
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
    """A C compiler that builds shared libraries for one platform.

    Attributes:
        platform: the platform.
        command: the program and its leading arguments.
        linking: arguments for linking a stripped shared library.
        identity: the compiler's version, on which the library's bytes depend besides the command.
        licenses: by file name, of the code that the compiler itself links into the library.
    """

    platform: Platform
    command: tuple[str, ...]
    linking: tuple[str, ...]
    identity: str
    licenses: Mapping[str, Path] = field(default_factory=dict)

    def library(self, name: str, sources: Mapping[str, bytes], inputs: Sequence[str]) -> bytes:
        """A shared library, compiled in a separate folder with relative names, so that it contains no paths.

        Args:
            name: of the library, without suffix.
            sources: C files and headers by name.
            inputs: the C files among them to compile.

        Raises:
            FmuError: the compiler fails; the text contains its output.
        """
        with tempfile.TemporaryDirectory(prefix="vehicle-fmu-") as folder:
            directory = Path(folder)
            for file, content in sources.items():
                (directory / file).write_bytes(content)
            library = f"{name}{self.platform.suffix}"
            _run([*self.command, *COMPILER_FLAGS, *inputs, "-o", library, *self.linking], directory)
            return (directory / library).read_bytes()


def compilers(names: Sequence[str]) -> tuple[Compiler, ...]:
    """A compiler for each named platform, without duplicates.

    Args:
        names: keys of `PLATFORMS`, or `native`; a named platform takes precedence over `native` of the same name.

    Raises:
        UnknownPlatform: an unknown platform, or no platform.
        FmuError: a compiler is not installed.
    """
    unknown = [name for name in names if name not in (NATIVE, *PLATFORMS)]
    if unknown or not names:
        raise UnknownPlatform(f"unknown platform '{', '.join(unknown)}'; allowed: {NATIVE}, {', '.join(PLATFORMS)}")
    found = [_zig(platform) for platform in PLATFORMS.values() if platform.name in names]
    if NATIVE in names and this_platform().name not in names:
        found.append(_system())
    return tuple(found)


def this_platform() -> Platform:
    """The platform of this machine.

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
            # Apple's linker no longer supports -s.
            strip = () if here.suffix == ".dylib" else ("-s",)
            return Compiler(here, (path,), ("-shared", *strip, "-lm"), _run([path, "--version"], _HERE))
    raise FmuError(
        "no C compiler found (tried cc, gcc, clang); FMU and bench are compiled; on Debian: apt install gcc libc6-dev"
    )


def _zig(target: Platform) -> Compiler:
    found = importlib.util.find_spec("ziglang")
    if found is None or found.origin is None:
        raise FmuError(
            f"building for {target.name} needs zig's C compiler, which is not installed: pip install ziglang"
        )
    folder = Path(found.origin).parent
    command = (str(folder / "zig"), "cc", "-target", target.target)
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
