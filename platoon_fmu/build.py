"""Builds Vehicle.fmu: equations -> C -> binary -> modelDescription -> zip.

The same inputs give the same bytes. An FMU whose inputs have not changed is not built again; finding that out
reads a few files and imports nothing heavy, since a start of the bench passes through here.
"""

from __future__ import annotations

import hashlib
import importlib.metadata
import importlib.util
import json
import platform
import shutil
import subprocess
import sys
import tempfile
import uuid
import zipfile
import zlib
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from pathlib import Path

from platoon_fmu.errors import FmuError

IDENTIFIER = "Vehicle"
SOLVER_STEP_S = 0.001
VERSION = "1.0"

# No contraction to fused multiply-adds: every processor then rounds alike. No errno: nobody reads it after sqrt.
COMPILER_FLAGS = ("-std=c99", "-O2", "-fPIC", "-ffp-contract=off", "-fno-math-errno", "-fvisibility=hidden")
LINKER_FLAGS = ("-shared", "-s", "-lm")

_PACKAGE = Path(__file__).resolve().parent
_PROJECT = _PACKAGE.parent
_HAND_WRITTEN = ("core.c", "solver.c", "fmi2.c")
_GENERATED = ("vehicle.c", "equations.c")
_OWN_HEADERS = ("core.h", "model.h", "solver.h")
_STANDARD_HEADERS = ("fmi2Functions.h", "fmi2FunctionTypes.h", "fmi2TypesPlatform.h")
_EPOCH = (1980, 1, 1, 0, 0, 0)


@dataclass(frozen=True)
class _Platform:
    """Where FMI 2.0 looks for a binary, and the suffix it has there."""

    folder: str
    suffix: str


def _this_platform() -> _Platform:
    bits = 64 if sys.maxsize > 2**32 else 32
    machine, system = platform.machine().lower(), platform.system()
    known = {"Linux": _Platform(f"linux{bits}", ".so"), "Darwin": _Platform(f"darwin{bits}", ".dylib")}
    if system not in known:
        raise FmuError(f"the FMU's binary can be built on Linux and macOS, not on {system} ({machine})")
    if system == "Linux" and machine not in ("x86_64", "amd64", "i386", "i686"):
        # FMI 2.0 names folders for x86 only; this is what FMI 3.0 and fmpy call the rest.
        return _Platform(f"{machine}-linux", ".so")
    return known[system]


def _standard_headers() -> Path:
    """The folder of the standard's headers (2-clause BSD), which fmpy carries."""
    found = importlib.util.find_spec("fmpy")
    if found is None or found.origin is None:
        raise FmuError("the FMI headers come with the package fmpy, which is not installed: pip install fmpy")
    folder = Path(found.origin).parent / "c-code"
    missing = [name for name in _STANDARD_HEADERS if not (folder / name).is_file()]
    if missing:
        raise FmuError(f"{folder} lacks {', '.join(missing)}: install fmpy again")
    return folder


def _compiler() -> str:
    for name in ("cc", "gcc", "clang"):
        path = shutil.which(name)
        if path is not None:
            return path
    raise FmuError(
        "no C compiler found (looked for cc, gcc, clang), which building the FMU needs; "
        "on Debian: apt install gcc libc6-dev"
    )


def _run(command: list[str], directory: Path) -> str:
    done = subprocess.run(command, cwd=directory, capture_output=True, text=True, check=False)
    if done.returncode != 0:
        raise FmuError(f"`{' '.join(command)}` failed with status {done.returncode}:\n{done.stderr.strip()}")
    return done.stdout


def _fingerprint() -> str:
    """A hash of all that the FMU's bytes depend on: this package, the standard's headers, the tools."""
    digest = hashlib.sha256()
    files = [*sorted(_PACKAGE.glob("*.py")), *sorted(_PACKAGE.glob("fmi/*.[ch]"))]
    files += [_standard_headers() / name for name in _STANDARD_HEADERS]
    for path in files:
        digest.update(f"{path.name}\0".encode())
        digest.update(hashlib.sha256(path.read_bytes()).digest())
    compiler = _compiler()
    tools = {
        "casadi": importlib.metadata.version("casadi"),
        "compiler": compiler,
        "compiler version": _run([compiler, "--version"], _PACKAGE),
        "platform": _this_platform().folder,
        "python": sys.version_info[:2],
        "zlib": zlib.ZLIB_RUNTIME_VERSION,
    }
    digest.update(json.dumps(tools, sort_keys=True).encode())
    return digest.hexdigest()


def _sha256(path: Path) -> str:
    return hashlib.sha256(path.read_bytes()).hexdigest()


def _is_current(fmu: Path, record: Path, fingerprint: str) -> bool:
    """Whether the FMU is the one that was built from what is here now, and is whole."""
    if not (fmu.is_file() and record.is_file()):
        return False
    try:
        recorded = json.loads(record.read_text())
    except ValueError:
        return False
    return bool(recorded == {"inputs": fingerprint, "fmu": _sha256(fmu)})


def _sources() -> tuple[dict[str, bytes], bytes]:
    """The files of sources/ by name, and the modelDescription."""
    # CasADi takes long to import, and is needed only here.
    from platoon_fmu import codegen, model_description

    model = codegen.symbolic_model()
    headers = _standard_headers()
    files = {name: (_PACKAGE / "fmi" / name).read_bytes() for name in (*_HAND_WRITTEN, *_OWN_HEADERS)}
    files |= {name: (headers / name).read_bytes() for name in _STANDARD_HEADERS}
    files["equations.c"] = codegen.equations_c(model).encode()

    simulating, initial = codegen.dependencies(model)

    def description(token: str) -> bytes:
        return model_description.fmi2_xml(
            token=token,
            identifier=IDENTIFIER,
            version=VERSION,
            sources=(*_HAND_WRITTEN, *_GENERATED),
            simulating=simulating,
            initial=initial,
        )

    # The token is a hash of all else: it tells a binary from a modelDescription that it does not belong to.
    digest = hashlib.sha256(description("") + codegen.table_c("", SOLVER_STEP_S).encode())
    for name in sorted(files):
        digest.update(files[name])
    token = f"{{{uuid.UUID(bytes=digest.digest()[:16])}}}"
    files["vehicle.c"] = codegen.table_c(token, SOLVER_STEP_S).encode()
    return files, description(token)


def _compile(sources: dict[str, bytes], suffix: str) -> bytes:
    """The shared library, compiled in a folder of its own with relative names: no path gets into it."""
    compiler = _compiler()
    with tempfile.TemporaryDirectory(prefix="vehicle-fmu-") as folder:
        directory = Path(folder)
        for name, content in sources.items():
            (directory / name).write_bytes(content)
        library = f"{IDENTIFIER}{suffix}"
        inputs = (*_HAND_WRITTEN, *_GENERATED)
        _run([compiler, *COMPILER_FLAGS, *inputs, "-o", library, *LINKER_FLAGS], directory)
        return (directory / library).read_bytes()


def _write_zip(path: Path, members: dict[str, bytes]) -> None:
    with zipfile.ZipFile(path, "w") as archive:
        for name in sorted(members):
            entry = zipfile.ZipInfo(name, date_time=_EPOCH)
            entry.compress_type = zipfile.ZIP_DEFLATED
            entry.external_attr = 0o644 << 16
            archive.writestr(entry, members[name], compresslevel=9)


@contextmanager
def _aside(directory: Path) -> Iterator[Path]:
    """A temporary directory in `directory`, which is made where missing, and unmade again where the work fails.

    Raises:
        OSError: there can be none.
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


def build(directory: Path, *, on_start: Callable[[], None] | None = None) -> Path:
    """Builds Vehicle.fmu in a directory, unless the one there was built from the same inputs.

    Args:
        directory: where to put it; made where missing. Beside the FMU a small record of its inputs is kept.
        on_start: called once if a build is needed, before it starts (it takes a few seconds).

    Returns:
        The path of the FMU.

    Raises:
        FmuError: no C compiler, no FMI headers, or a compiler that fails.
        OSError: the directory cannot be made or written to; where that shows at once, nothing is built first.
    """
    fmu, record = directory / f"{IDENTIFIER}.fmu", directory / f"{IDENTIFIER}.fmu.json"
    fingerprint = _fingerprint()
    if _is_current(fmu, record, fingerprint):
        return fmu
    # Written aside and moved into place, so that whoever opens the FMU meanwhile sees a whole one.
    with _aside(directory) as aside:
        if on_start is not None:
            on_start()
        target = _this_platform()
        sources, description = _sources()
        members = {
            "modelDescription.xml": description,
            f"binaries/{target.folder}/{IDENTIFIER}{target.suffix}": _compile(sources, target.suffix),
            **{f"sources/{name}": content for name, content in sources.items()},
        }
        new = aside / fmu.name
        _write_zip(new, members)
        new.replace(fmu)
        new_record = aside / record.name
        new_record.write_text(json.dumps({"inputs": fingerprint, "fmu": _sha256(fmu)}) + "\n")
        new_record.replace(record)
    return fmu


def default_directory() -> Path:
    """Where `make setup` builds: build/ of the project; for an installed package, of the working directory."""
    root = _PROJECT if (_PROJECT / "pyproject.toml").is_file() else Path.cwd()
    return root / "build"


def default_fmu() -> Path:
    """The FMU in `default_directory`.

    Raises:
        FmuError: it has not been built.
    """
    fmu = default_directory() / f"{IDENTIFIER}.fmu"
    if not fmu.is_file():
        raise FmuError(f"there is no {fmu}: build it with `platoon fmu build` (`make setup` does)")
    return fmu
