"""Builds Vehicle.fmu: equations -> C -> binaries -> modelDescription -> zip.

The same inputs give the same bytes. An FMU whose inputs have not changed is not rebuilt; checking this reads a few
files and imports nothing heavy.
"""

from __future__ import annotations

import hashlib
import importlib.metadata
import importlib.util
import json
import sys
import tempfile
import zipfile
import zlib
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from pathlib import Path

from platoon_fmu.compilers import NATIVE, Compiler, compilers
from platoon_fmu.errors import FmuError
from platoon_fmu.universal import universal_binary
from platoon_fmu.versions import FMI2, FMI3, Version

IDENTIFIER = "Vehicle"

_PACKAGE = Path(__file__).resolve().parent
_PROJECT = _PACKAGE.parent
# The parts of this package on which the FMU's bytes depend, besides fmi/.
_MODULES = (
    *("build", "codegen", "compilers", "contents", "documentation", "errors", "interface", "model_description"),
    *("parameters", "tyre", "universal", "vehicle", "versions", "wheels"),
)
_DATA = ("documentation.html", "icon.png", "icon.svg", "license.txt")
_EPOCH = (1980, 1, 1, 0, 0, 0)


@dataclass(frozen=True)
class Step:
    """The next step of a build.

    Attributes:
        done: number of completed steps.
        total: number of steps of the whole build.
        text: what it does; if it is slow, also how long it takes.
    """

    done: int
    total: int
    text: str


def _standard_headers(version: Version) -> list[Path]:
    """The standard's headers (2-clause BSD), which fmpy includes."""
    found = importlib.util.find_spec("fmpy")
    if found is None or found.origin is None:
        raise FmuError("the FMI headers are part of the package fmpy, which is not installed: pip install fmpy")
    folder = Path(found.origin).parent / "c-code"
    headers = [folder / name for name in version.headers]
    missing = [path.name for path in headers if not path.is_file()]
    if missing:
        raise FmuError(f"{folder} lacks {', '.join(missing)}: reinstall fmpy")
    return headers


def _hand_written(version: Version) -> list[Path]:
    """The C files and headers of fmi/, without the API files of the other versions."""
    others = {other.face for other in (FMI2, FMI3)} - {version.face}
    return [path for path in sorted(_PACKAGE.glob("fmi/*.[ch]")) if path.name not in others]


def _source_hash(version: Version) -> str:
    """A hash of the files on which the FMU's bytes depend: this package's and the standard's headers."""
    digest = hashlib.sha256()
    own = [_PACKAGE / name for name in (*(f"{module}.py" for module in _MODULES), *_DATA)]
    for path in (*own, *_hand_written(version), *_standard_headers(version)):
        digest.update(f"{path.name}\0".encode())
        digest.update(hashlib.sha256(path.read_bytes()).digest())
    return digest.hexdigest()


def _fingerprint(version: Version, chosen: Sequence[Compiler]) -> str:
    """A hash of everything on which the FMU's bytes depend: files and tools."""
    tools = {
        "sources": _source_hash(version),
        "casadi": importlib.metadata.version("casadi"),
        "compilers": [(c.platform.name, c.command, c.linking, c.identity) for c in chosen],
        "python": sys.version_info[:2],
        "zlib": zlib.ZLIB_RUNTIME_VERSION,
    }
    return hashlib.sha256(json.dumps(tools, sort_keys=True).encode()).hexdigest()


def _sha256(path: Path) -> str:
    return hashlib.sha256(path.read_bytes()).hexdigest()


def _is_current(fmu: Path, record: Path, fingerprint: str) -> bool:
    """Whether the FMU was built from the current inputs and is complete."""
    if not (fmu.is_file() and record.is_file()):
        return False
    try:
        recorded = json.loads(record.read_text())
    except ValueError:
        return False
    return bool(recorded == {"inputs": fingerprint, "fmu": _sha256(fmu)})


def _members(version: Version, chosen: Sequence[Compiler], on_step: Callable[[Step], None]) -> dict[str, bytes]:
    """The FMU's files by path."""
    total = len(chosen) + 1
    on_step(Step(0, total, f"{version.file}: generating the model's C code"))
    # CasADi is slow to import and only needed here.
    from platoon_fmu import contents

    code = contents.sources(version, IDENTIFIER, _hand_written(version), _standard_headers(version))
    members = contents.members(version, IDENTIFIER, code)
    binaries: dict[str, list[bytes]] = {}
    for done, compiler in enumerate(chosen, start=1):
        target = compiler.platform
        patience = f" ({target.patience})" if target.patience else ""
        on_step(Step(done, total, f"{version.file}: compiling for {target.name}{patience}"))
        library = compiler.library(IDENTIFIER, code.files, code.inputs)
        for folder in version.folders_of(target.name):
            binaries.setdefault(f"binaries/{folder}/{IDENTIFIER}{target.suffix}", []).append(library)
        members |= {f"documentation/licenses/{name}": path.read_bytes() for name, path in compiler.licenses.items()}
    return members | {path: universal_binary(libraries) for path, libraries in binaries.items()}


def _write_zip(path: Path, members: Mapping[str, bytes]) -> None:
    with zipfile.ZipFile(path, "w") as archive:
        for name in sorted(members):
            entry = zipfile.ZipInfo(name, date_time=_EPOCH)
            entry.compress_type = zipfile.ZIP_DEFLATED
            entry.create_system = 3  # Unix, on every system
            entry.external_attr = 0o644 << 16
            archive.writestr(entry, members[name], compresslevel=9)


@contextmanager
def _aside(directory: Path) -> Iterator[Path]:
    """A temporary directory in `directory`, which is created if missing and removed again if the work fails.

    Raises:
        OSError: it cannot be created.
    """
    missing = [path for path in (directory, *directory.parents) if not path.exists()]
    try:
        directory.mkdir(parents=True, exist_ok=True)
        with tempfile.TemporaryDirectory(prefix=f".{IDENTIFIER}-", dir=directory) as aside:
            yield Path(aside)
    except BaseException:
        for path in missing:
            with suppress(OSError):
                path.rmdir()
        raise


def build(
    directory: Path,
    *,
    version: Version = FMI2,
    platforms: Sequence[str] = (NATIVE,),
    on_step: Callable[[Step], None] = lambda _: None,
) -> Path:
    """Builds an FMU in a directory, unless the one there was built from the same inputs.

    Args:
        directory: where to put it; created if missing. A small record of the FMU's inputs is kept beside it.
        version: of the standard; it determines the FMU's file name.
        platforms: for which the FMU gets binaries: names in `compilers.PLATFORMS`, or `native`.
        on_step: called before each step of a needed build (each takes a few seconds unless its text says otherwise).

    Returns:
        The path of the FMU.

    Raises:
        FmuError: unknown platform, no C compiler, no FMI headers, or the compiler fails.
        OSError: the directory cannot be created or written to; checked before building where possible.
    """
    fmu, record = directory / version.file, directory / f"{version.file}.json"
    chosen = compilers(platforms)
    fingerprint = _fingerprint(version, chosen)
    if _is_current(fmu, record, fingerprint):
        return fmu
    # Written to a temporary file and renamed, so that a concurrent reader always opens a complete FMU.
    with _aside(directory) as aside:
        new = aside / fmu.name
        _write_zip(new, _members(version, chosen, on_step))
        new.replace(fmu)
        new_record = aside / record.name
        new_record.write_text(json.dumps({"inputs": fingerprint, "fmu": _sha256(fmu)}) + "\n")
        new_record.replace(record)
    return fmu


def in_checkout() -> bool:
    """Whether this package runs from a checkout of the project (set up by `make setup`) rather than installed."""
    return (_PROJECT / "pyproject.toml").is_file()


def default_directory() -> Path:
    """The folder of the FMU that the bench drives: build/ of a checkout, or the user's cache for an installed package.

    In the cache, each version of this package and each state of its sources has a separate folder.
    """
    if in_checkout():
        return _PROJECT / "build"
    # Imported here because a checkout, and with it the tests, need not wait for it.
    import platformdirs

    release = importlib.metadata.version("platoon")
    return platformdirs.user_cache_path("platoon", appauthor=False) / f"{release}-{_source_hash(FMI2)[:16]}"


def default_fmu(on_step: Callable[[Step], None] = lambda _: None) -> Path:
    """The FMU in `default_directory` that the bench drives, of FMI 2; an installed package builds it on first use.

    Args:
        on_step: as for `build`, called if it has to be built.

    Raises:
        FmuError: in a checkout: it has not been built; installed: it cannot be built or written to the cache.
    """
    directory = default_directory()
    fmu = directory / FMI2.file
    if fmu.is_file():
        return fmu
    if in_checkout():
        raise FmuError(f"{fmu} does not exist: build it with `platoon fmu build` (`make setup` does this)")
    try:
        return build(directory, on_step=on_step)
    except OSError as error:
        raise FmuError(
            f"the vehicle FMU cannot be written to {directory}: {error.strerror}; "
            "set XDG_CACHE_HOME to a writable folder"
        ) from error
