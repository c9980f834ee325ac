"""The binaries for all platforms: what they export and need, that they are reproducible, and that they drive alike.

The FMUs are built once for the whole run of the tests: in `make test` for all platforms but Windows, for which zig
takes minutes where it has never done so on this machine, and in `make nightly` for all.
"""

from __future__ import annotations

import hashlib
import os
import re
import shutil
import struct
import subprocess
import sys
import zipfile
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path
from xml.etree import ElementTree as ET

import fmpy
import numpy as np
import pytest
from fmpy.validation import validate_fmu

from platoon_fmu import build as builder
from platoon_fmu import interface
from platoon_fmu.compilers import PLATFORMS, compilers
from platoon_fmu.errors import FmuError
from platoon_fmu.universal import universal_binary
from platoon_fmu.versions import FMI2, FMI3, Version
from tests.conftest import Once

HEADERS = Path(fmpy.__file__).parent / "c-code"
LINUX = ("x86_64-linux", "aarch64-linux")
DARWIN = ("x86_64-darwin", "aarch64-darwin")
WINDOWS = "x86_64-windows"
QUICK = tuple(name for name in PLATFORMS if name != WINDOWS)
VERSIONS = [pytest.param(version, id=f"fmi{version.name}") for version in (FMI2, FMI3)]
NIGHTLY_VERSIONS = [pytest.param(*each.values, id=each.id, marks=pytest.mark.nightly) for each in VERSIONS]


@dataclass(frozen=True)
class Built:
    """An FMU for several platforms."""

    version: Version
    path: Path
    platforms: tuple[str, ...]

    def read(self, member: str) -> bytes:
        with zipfile.ZipFile(self.path) as archive:
            return archive.read(member)

    def binary(self, platform: str) -> bytes:
        """The binary that an importer on a platform finds."""
        folder = self.version.folders_of(platform)[-1]
        content = self.read(f"binaries/{folder}/Vehicle{PLATFORMS[platform].suffix}")
        return next(iter(slices(content).values())) if content.startswith(b"\xca\xfe\xba\xbe") else content


def both_versions(once: Once, name: str, platforms: tuple[str, ...]) -> dict[Version, Built]:
    folders = {
        version: once(f"{name}-{version.name}", lambda f, v=version: builder.build(f, version=v, platforms=platforms))
        for version in (FMI2, FMI3)
    }
    return {version: Built(version, next(folder.glob("*.fmu")), platforms) for version, folder in folders.items()}


@pytest.fixture(scope="session")
def quick(once: Once) -> Mapping[Version, Built]:
    """Both versions, for all platforms but Windows."""
    return both_versions(once, "quick-platforms", QUICK)


@pytest.fixture(scope="session")
def all_platforms(once: Once) -> Mapping[Version, Built]:
    """Both versions, for all platforms."""
    return both_versions(once, "all-platforms", tuple(PLATFORMS))


@pytest.fixture(scope="session")
def native(fmu_path: Path, fmu3_path: Path) -> Mapping[Version, Path]:
    """The FMUs for this platform."""
    return {FMI2: fmu_path, FMI3: fmu3_path}


@pytest.fixture(params=NIGHTLY_VERSIONS)
def complete(request: pytest.FixtureRequest, all_platforms: Mapping[Version, Built]) -> Built:
    """The FMU for all platforms, for each version in turn."""
    return all_platforms[request.param]


@pytest.fixture(
    params=[
        *VERSIONS,
        *(pytest.param(*each.values, id=f"{each.id}-all", marks=each.marks) for each in NIGHTLY_VERSIONS),
    ]
)
def built(request: pytest.FixtureRequest) -> Built:
    """The FMU for most platforms, and in the long form for all, for each version in turn."""
    every = request.node.get_closest_marker("nightly") is not None
    found: Mapping[Version, Built] = request.getfixturevalue("all_platforms" if every else "quick")
    return found[request.param]


# ---- what is in the FMU ----


def test_one_fmu_holds_its_platforms_and_is_valid(built):
    with zipfile.ZipFile(built.path) as archive:
        binaries = {name for name in archive.namelist() if name.startswith("binaries/")}
    if built.version is FMI2:
        folders = {"linux64": ".so", "darwin64": ".dylib", "aarch64-linux": ".so", "aarch64-darwin": ".dylib"}
        folders |= {"win64": ".dll"} if WINDOWS in built.platforms else {}
    else:
        folders = {name: PLATFORMS[name].suffix for name in built.platforms}
    assert binaries == {f"binaries/{folder}/Vehicle{suffix}" for folder, suffix in folders.items()}
    assert validate_fmu(str(built.path)) == []
    expected = {"linux64", "darwin64"} | ({"win64"} if WINDOWS in built.platforms else set())
    assert expected <= set(fmpy.supported_platforms(str(built.path)))


def test_the_fmu_is_small(built):
    assert built.path.stat().st_size < 1_500_000


def test_the_licenses_of_what_the_compiler_adds_are_inside(built):
    assert b"Permission is hereby granted" in built.read("documentation/licenses/zig.txt")
    if WINDOWS in built.platforms:
        assert b"Zope Public License" in built.read("documentation/licenses/mingw-w64.txt")


# ---- exports and needs ----


def cstring(content: bytes, start: int) -> str:
    return content[start : content.index(b"\0", start)].decode()


def elf(*command: str, content: bytes, folder: Path) -> str:
    """What a tool of binutils says of an ELF binary, whatever its processor."""
    path = folder / "library"
    path.write_bytes(content)
    return subprocess.run([*command, str(path)], capture_output=True, text=True, check=True).stdout


def elf_exports(content: bytes, folder: Path) -> set[str]:
    lines = elf("nm", "-D", "--defined-only", content=content, folder=folder).splitlines()
    return {line.split()[-1] for line in lines}


class Pe:
    """A Windows library: its exports and the libraries it needs (Microsoft, PE Format)."""

    def __init__(self, content: bytes) -> None:
        self._content = content
        (header,) = struct.unpack_from("<I", content, 0x3C)
        assert content[header : header + 4] == b"PE\0\0"
        _, sections, optional = struct.unpack_from("<HH12xH", content, header + 4)
        self._sections = [
            struct.unpack_from("<IIII", content, header + 24 + optional + 40 * i + 8) for i in range(sections)
        ]
        # The directory of a 64-bit optional header: exports, then imports.
        self._exports, self._imports = (
            struct.unpack_from("<I", content, header + 24 + 112 + 8 * i)[0] for i in range(2)
        )

    def _at(self, address: int) -> int:
        for size, start, _, raw in self._sections:
            if start <= address < start + size:
                return address - start + raw
        raise AssertionError(f"no section holds {address:#x}")

    def exports(self) -> set[str]:
        count, _, names = struct.unpack_from("<III", self._content, self._at(self._exports) + 24)
        found = struct.unpack_from(f"<{count}I", self._content, self._at(names))
        return {cstring(self._content, self._at(name)) for name in found}

    def needs(self) -> set[str]:
        found, entry = set(), self._at(self._imports)
        while name := struct.unpack_from("<I", self._content, entry + 12)[0]:
            found.add(cstring(self._content, self._at(name)))
            entry += 20
        return found


class MachO:
    """A macOS library, by its load commands (Apple, <mach-o/loader.h>)."""

    NEEDS, SIGNATURE, DYLD_INFO, BUILD = 0xC, 0x1D, 0x80000022, 0x32

    def __init__(self, content: bytes) -> None:
        self.content = content
        magic, self.processor = struct.unpack_from("<II", content)
        assert magic == 0xFEEDFACF
        (count,) = struct.unpack_from("<I", content, 16)
        self.commands: list[tuple[int, bytes]] = []
        at = 32
        for _ in range(count):
            command, size = struct.unpack_from("<II", content, at)
            self.commands.append((command, content[at : at + size]))
            at += size

    def command(self, wanted: int) -> bytes:
        (found,) = [content for command, content in self.commands if command == wanted]
        return found

    def exports(self) -> set[str]:
        """What the loader lets others find: a tree of the names' parts, each with the offset of its node."""
        offset, size = struct.unpack_from("<II", self.command(self.DYLD_INFO), 40)
        tree = self.content[offset : offset + size]

        def number(at: int) -> tuple[int, int]:
            value, shift = 0, 0
            while True:
                value |= (tree[at] & 0x7F) << shift
                at, shift = at + 1, shift + 7
                if not tree[at - 1] & 0x80:
                    return value, at

        def names(at: int, so_far: str) -> set[str]:
            terminal, at = number(at)
            found = {so_far} if terminal else set()
            at += terminal
            children, at = tree[at], at + 1
            for _ in range(children):
                part = cstring(tree, at)
                child, at = number(at + len(part) + 1)
                found |= names(child, so_far + part)
            return found

        return names(0, "")

    def needs(self) -> set[str]:
        return {cstring(content, 24) for command, content in self.commands if command == self.NEEDS}

    def oldest_system(self) -> tuple[int, int]:
        _, minimum = struct.unpack_from("<II", self.command(self.BUILD), 8)
        return minimum >> 16, minimum >> 8 & 0xFF


def slices(universal: bytes) -> dict[int, bytes]:
    """The binaries of a universal one, by processor."""
    magic, count = struct.unpack_from(">II", universal)
    assert magic == 0xCAFEBABE
    found = {}
    for i in range(count):
        processor, _, offset, size, alignment = struct.unpack_from(">5I", universal, 8 + 20 * i)
        assert offset % 2**alignment == 0
        assert alignment == 14
        found[processor] = universal[offset : offset + size]
    return found


def declared(version: Version) -> set[str]:
    """The functions that the standard's header declares."""
    text = (HEADERS / version.headers[0]).read_text()
    found = set(re.findall(rf"{version.prefix}\w+TYPE\s+({version.prefix}\w+);", text))
    assert len(found) > 40
    return found


def exported(platform: str, content: bytes, folder: Path) -> set[str]:
    if platform in LINUX:
        return elf_exports(content, folder)
    if platform in DARWIN:
        # The two are the linker's own, and zig's cannot be told to hide them; they name the library's header.
        own = {"___dso_handle", "__mh_dylib_header"}
        return {name.removeprefix("_") for name in MachO(content).exports() - own}
    return Pe(content).exports()


def test_the_standards_functions_are_exported_and_nothing_else(built, tmp_path):
    for platform in built.platforms:
        assert exported(platform, built.binary(platform), tmp_path) == declared(built.version), platform


@pytest.mark.skipif(sys.platform != "linux", reason="reads an ELF binary")
@pytest.mark.parametrize("version", VERSIONS)
def test_the_native_binary_exports_the_standards_functions_and_nothing_else(version, native, tmp_path):
    with zipfile.ZipFile(native[version]) as archive:
        (name,) = [name for name in archive.namelist() if name.startswith("binaries/")]
        assert elf_exports(archive.read(name), tmp_path) == declared(version)


@pytest.mark.parametrize("platform", LINUX)
def test_linux_binaries_need_an_old_c_library_only(built, platform, tmp_path):
    content = built.binary(platform)
    dynamic = elf("readelf", "--dynamic", "--wide", content=content, folder=tmp_path)
    assert set(re.findall(r"\(NEEDED\).*\[(.*)\]", dynamic)) == {"libc.so.6", "libm.so.6"}
    assert "RPATH" not in dynamic
    assert "RUNPATH" not in dynamic
    versions = re.findall(r"Name: (\w+)_([\d.]+)", elf("readelf", "-V", "--wide", content=content, folder=tmp_path))
    assert {name for name, _ in versions} == {"GLIBC"}
    assert max(tuple(map(int, number.split("."))) for _, number in versions) <= (2, 17)


def test_the_windows_binary_needs_windows_only(complete):
    needs = {name.lower() for name in Pe(complete.binary(WINDOWS)).needs()}
    assert "kernel32.dll" in needs
    assert {name for name in needs if not name.startswith("api-ms-win-crt-")} == {"kernel32.dll"}


@pytest.mark.parametrize("platform", DARWIN)
def test_macos_binaries_need_macos_11_only(built, platform):
    library = MachO(built.binary(platform))
    assert library.needs() == {"/usr/lib/libSystem.B.dylib"}
    assert library.oldest_system() == (11, 0)


# ---- macOS: one binary for both processors, signed where it has to be ----


def assert_signed(content: bytes) -> None:
    """The ad-hoc signature holds for every page of a Mach-O (Apple, cs_blobs.h)."""
    offset, _ = struct.unpack_from("<II", MachO(content).command(MachO.SIGNATURE), 8)
    magic, _, count = struct.unpack_from(">III", content, offset)
    assert magic == 0xFADE0CC0
    blobs = dict(struct.unpack_from(">II", content, offset + 12 + 8 * i) for i in range(count))
    directory = offset + blobs[0]
    magic, _, _, flags, hashes, _, _, pages, limit = struct.unpack_from(">9I", content, directory)
    size, kind, _, page_log2 = struct.unpack_from(">4B", content, directory + 36)
    assert (magic, flags & 2, size, kind) == (0xFADE0C02, 2, 32, 2)
    assert limit == offset
    assert pages == -(-limit // 2**page_log2)
    for i in range(pages):
        page = content[i << page_log2 : min(limit, (i + 1) << page_log2)]
        at = directory + hashes + size * i
        assert hashlib.sha256(page).digest() == content[at : at + size]


def test_fmi2_has_one_signed_binary_for_both_of_macos_processors(quick):
    fmu = quick[FMI2]
    both = slices(fmu.read("binaries/darwin64/Vehicle.dylib"))
    assert set(both) == {0x01000007, 0x0100000C}  # x86-64, arm64
    assert all(MachO(content).processor == processor for processor, content in both.items())
    assert both[0x0100000C] == fmu.read("binaries/aarch64-darwin/Vehicle.dylib")
    assert_signed(both[0x0100000C])


def test_fmi3_binary_for_apples_processors_is_signed(quick):
    content = quick[FMI3].binary("aarch64-darwin")
    assert_signed(content)
    broken = bytearray(content)
    broken[5000] ^= 1
    with pytest.raises(AssertionError):
        assert_signed(bytes(broken))


def test_a_universal_binary_is_made_of_mach_o_only(quick):
    library = quick[FMI3].binary("x86_64-darwin")
    assert universal_binary([library]) == library
    with pytest.raises(ValueError, match="not a 64-bit Mach-O"):
        universal_binary([library, quick[FMI3].binary("x86_64-linux")])


# ---- reproducible ----


def test_all_platforms_built_twice_give_the_same_bytes(complete, tmp_path):
    again = builder.build(tmp_path / "else where", version=complete.version, platforms=complete.platforms)
    assert again.read_bytes() == complete.path.read_bytes()


def test_another_directory_gives_the_same_binary(quick, tmp_path):
    fmu = Built(FMI3, builder.build(tmp_path / "else where", version=FMI3, platforms=DARWIN[1:]), DARWIN[1:])
    assert fmu.binary(DARWIN[1]) == quick[FMI3].binary(DARWIN[1])


@pytest.mark.nightly
@pytest.mark.parametrize("platform", ["aarch64-linux", "aarch64-darwin"])
def test_fresh_caches_and_another_directory_give_the_same_binary(quick, platform, tmp_path, monkeypatch):
    for name in ("ZIG_GLOBAL_CACHE_DIR", "ZIG_LOCAL_CACHE_DIR"):
        monkeypatch.setenv(name, str(tmp_path / name))
    (tmp_path / "temporary").mkdir()
    monkeypatch.setattr("tempfile.tempdir", str(tmp_path / "temporary"))
    fmu = Built(FMI3, builder.build(tmp_path / "built", version=FMI3, platforms=[platform]), (platform,))
    assert any((tmp_path / "ZIG_GLOBAL_CACHE_DIR").rglob("*"))
    assert fmu.binary(platform) == quick[FMI3].binary(platform)


def test_the_named_platform_takes_precedence_over_native(monkeypatch):
    monkeypatch.setattr("platform.system", lambda: "Linux")
    monkeypatch.setattr("platform.machine", lambda: "x86_64")
    (compiler,) = compilers(["native", "x86_64-linux", "x86_64-linux"])
    assert Path(compiler.command[0]).parent.name == "ziglang"


def test_native_says_where_it_cannot_be_built(monkeypatch):
    monkeypatch.setattr("platform.system", lambda: "Windows")
    with pytest.raises(FmuError, match=r"Linux and macOS, not on Windows.*x86_64-windows"):
        compilers(["native"])


# ---- driven ----

STEPS = 500
SETTINGS = {
    "v_x_start": 20.0,
    "steering_angle": 0.05,
    "wheel_torque_fl": 150.0,
    "wheel_torque_rl": -300.0,
    "mu": 0.7,
    "force_y": 200.0,
}
UNKNOWNS = (*interface.STATES, *interface.DERIVATIVES, *interface.OUTPUTS)


def token(fmu: Built) -> str:
    root = ET.fromstring(fmu.read("modelDescription.xml"))
    return str(root.get("guid") or root.get("instantiationToken"))


def compiled_host(platform: str, version: Version, folder: Path) -> str:
    """The program that drives, compiled for a platform as the binaries are, so that zig's libraries serve for both."""
    (compiler,) = compilers([platform])
    options = ["-std=c99", "-O2", "-s", f"-I{HEADERS}", *(["-DFMI3"] if version is FMI3 else [])]
    libraries = ["-ldl"] if platform in LINUX else []
    source = Path(__file__).with_name("platform_host.c")
    command = [*compiler.command, *options, str(source), "-o", f"host-{platform}.exe", *libraries]
    subprocess.run(command, cwd=folder, check=True)
    return f"./host-{platform}.exe"


@pytest.fixture
def drive(built: Built, tmp_path: Path) -> Callable[..., np.ndarray]:
    """Drives a binary, or that of the FMU, by a program of its platform; all values, (steps, unknowns)."""

    def run(
        platform: str, *emulator: str, binary: bytes = b"", environment: Mapping[str, str] | None = None
    ) -> np.ndarray:
        library = tmp_path / f"Vehicle{PLATFORMS[platform].suffix}"
        library.write_bytes(binary or built.binary(platform))
        host = compiled_host(platform, built.version, tmp_path)
        references = {variable.name: i for i, variable in enumerate(interface.VARIABLES)}
        settings = [f"{references[name]}={value}" for name, value in SETTINGS.items()]
        done = subprocess.run(
            [*emulator, host, f"./{library.name}", token(built), str(STEPS), *settings, "0", str(len(UNKNOWNS) - 1)],
            cwd=tmp_path,
            env={**os.environ, **(environment or {})},
            capture_output=True,
            text=True,
            check=False,
        )
        assert done.returncode == 0, done.stdout + done.stderr
        bits = np.array([[int(word, 16) for word in line.split()] for line in done.stdout.splitlines()], np.uint64)
        assert bits.shape == (STEPS, len(UNKNOWNS))
        return bits.view(np.float64)

    return run


@pytest.fixture
def here(drive: Callable[..., np.ndarray]) -> np.ndarray:
    """The same drive on this machine, which must be one of x86-64 with Linux."""
    if (sys.platform, os.uname().machine) != ("linux", "x86_64"):
        pytest.skip("compares with a drive on x86-64 and Linux, which this machine is not")
    values = drive("x86_64-linux")
    names = [variable.name for variable in UNKNOWNS]
    assert values[-1, names.index("X")] > 20
    assert values[-1, names.index("gamma")] > 0.1
    return values


def test_the_native_binary_drives_as_the_portable_one_does(built, native, drive, here):
    binary = Built(built.version, native[built.version], ("x86_64-linux",)).binary("x86_64-linux")
    assert binary != built.binary("x86_64-linux")
    np.testing.assert_array_equal(drive("x86_64-linux", binary=binary), here)


def test_aarch64_drives_as_x86_64_does_bit_by_bit(drive, here):
    system = Path("/usr/aarch64-linux-gnu")
    emulator = shutil.which("qemu-aarch64")
    if emulator is None or not (system / "lib/ld-linux-aarch64.so.1").exists():
        pytest.skip("runs an arm64 binary: apt install qemu-user libc6-arm64-cross")
    there = drive("aarch64-linux", emulator, "-L", str(system))
    # sin, cos and atan are glibc's; it takes fused multiply-adds where the processor has them, as all of arm64 do.
    if "fma" in Path("/proc/cpuinfo").read_text().split():
        np.testing.assert_array_equal(there, here)
    else:
        np.testing.assert_allclose(there, here, rtol=1e-12, atol=1e-12)


def test_windows_drives_as_linux_does(built, drive, here, tmp_path):
    found = [shutil.which("wine64"), shutil.which("wine"), shutil.which("wine64", path="/usr/lib/wine")]
    if WINDOWS not in built.platforms:
        pytest.skip("make nightly builds for Windows")
    emulator = next(filter(None, found), None)
    if emulator is None:
        pytest.skip("runs a Windows binary: apt install --no-install-recommends wine64")
    # Without the installers of Mono and Gecko that wine offers for a new prefix.
    environment = {"WINEPREFIX": str(tmp_path / "wine"), "WINEDEBUG": "-all", "WINEDLLOVERRIDES": "mscoree=;mshtml="}
    there = drive("x86_64-windows", emulator, environment=environment)
    # The last bits of sin, cos and atan are the C library's.
    np.testing.assert_allclose(there, here, rtol=1e-12, atol=1e-12)
