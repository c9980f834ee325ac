"""Compiles the hot modules: `make setup` calls it, an installed package before its first run.

Cython translates each file to C, the system's C compiler makes a library of it. A library is kept by the hash of all
that it is made from, so only what has changed is compiled again.
"""

import hashlib
import os
import re
import shutil
import subprocess
import sys
import sysconfig
import tempfile
from collections.abc import Callable, Sequence
from contextlib import suppress
from importlib import metadata
from pathlib import Path
from typing import Any

from bench.compiled.finder import (
    INTERPRETED,
    ROOT,
    SUFFIX,
    current_libraries,
    declarations,
    in_checkout,
    library_folder,
    source_of,
    sources_hash,
)
from bench.compiled.modules import COMPILED
from bench.counts import counted
from bench.errors import BadInput
from platoon_fmu.compilers import compilers
from platoon_fmu.errors import FmuError
from platoon_fmu.interpreter import python

# -ffp-contract=off: the same results on every processor. -fwrapv: as Python's own extensions.
FLAGS = ("-O2", "-fPIC", "-shared", "-fwrapv", "-ffp-contract=off", "-fvisibility=hidden", "-DNDEBUG", "-w")
"""Options of the C compiler."""

LOOP_FLAGS = ("-O3", "-fno-math-errno", "-fno-trapping-math")
"""More of them for `VECTORISED`: none changes what is computed."""

VECTORISED = frozenset(f"bench.control.{name}" for name in ("boundaries", "flocking", "genetic", "near_identity"))
"""The modules with loops over lanes of vehicles, see `bench.control.agents`."""

KEPT = 3
"""Number of states of the sources whose libraries are kept: a process that still runs may load more of its own."""


def compile_modules(say: Callable[[str], None] = lambda _: None) -> Path:
    """Compile what has no current library; return the folder with all of them.

    Args:
        say: called with what takes a while.

    Raises:
        BadInput: there is no Cython, no C compiler, no header file of Python, no place for the libraries, or a file
            cannot be compiled; the message says how to mend it.
    """
    current_libraries.cache_clear()
    found = current_libraries()
    if found is not None:
        return found
    root = library_folder()
    try:
        objects = root / "objects"
        objects.mkdir(parents=True, exist_ok=True)
        state = sources_hash()
        libraries = {name: objects / f"{_key(name)}{SUFFIX}" for name in COMPILED}
        missing = {name: library for name, library in libraries.items() if not library.is_file()}
        if missing:
            say(f"compiling {counted(len(missing), 'module')} (one to three minutes)")
            _compile(list(missing.items()))
        if sources_hash() != state:
            # A file was edited meanwhile, so a library may be of another text than its name says.
            for library in missing.values():
                library.unlink(missing_ok=True)
            return compile_modules(say)
        folder = _collected(root / state, libraries)
    except OSError as error:
        raise BadInput(
            f"the bench is to be compiled, but {root} cannot be written: {error.strerror}; {_mend()}"
        ) from error
    current_libraries.cache_clear()
    _forget_old(root)
    return folder


def require_compiler() -> None:
    """Check that modules can be compiled here.

    Raises:
        BadInput: Cython, a C compiler or a header file of Python is missing; the message says how to install it.
    """
    _cython_version()
    _c_compiler()


def _mend() -> str:
    """Return what to do if the libraries cannot be written."""
    return "make it writable" if in_checkout() else "set XDG_CACHE_HOME to a folder that can"


def _cython_version() -> str:
    try:
        return metadata.version("cython")
    except metadata.PackageNotFoundError:
        raise BadInput("Cython is missing, which compiles the bench: pip install cython") from None


def _key(module: str) -> str:
    """Return a hash of all that a module's library is made from."""
    facts = [SUFFIX, _cython_version(), *FLAGS, *_loop_flags(module), module]
    facts += [file.read_text(encoding="utf-8") for file in (source_of(module), *_declarations_for(module))]
    return hashlib.sha256("\0".join(facts).encode()).hexdigest()[:24]


def _loop_flags(module: str) -> tuple[str, ...]:
    return LOOP_FLAGS if module in VECTORISED else ()


def _declarations_for(module: str) -> list[Path]:
    """Return the declarations of which a module's library is made: its own, and all that it cimports, in turn."""
    files = {file.relative_to(ROOT).with_suffix("").as_posix().replace("/", "."): file for file in declarations()}
    found: dict[str, Path] = {}
    waiting = [source_of(module)]
    if module in files:
        found[module] = files[module]
        waiting.append(files[module])
    while waiting:
        for name in _cimported(waiting.pop().read_text(encoding="utf-8")):
            # Of a package, or by a relative name: all that can be meant.
            beneath = "" if name.startswith(".") else f"{name}.".lstrip(".")
            new = {each for each in files if f"{each}.".startswith(beneath)} - set(found)
            found.update({each: files[each] for each in new})
            waiting += [files[each] for each in new]
    return [found[name] for name in sorted(found)]


_CIMPORTS = (
    re.compile(r"\bcython\.cimports\b\.?([\w.]*)"),
    re.compile(r"^\s*from\s+([\w.]+)\s+cimport\b", re.MULTILINE),
    re.compile(r"^\s*cimport\s+([^\n#]+)", re.MULTILINE),
)
"""How a source or a file of declarations names the modules whose C declarations it uses."""


def _cimported(text: str) -> set[str]:
    """Return the names after each `cimport`: of modules, or of packages; an empty name for that of all."""
    named = [name for form in _CIMPORTS for names in form.findall(text) for name in names.split(",")]
    return {(name.split() or [""])[0] for name in named}


def _collected(folder: Path, libraries: dict[str, Path]) -> Path:
    """Put the libraries into this folder, which appears whole or not at all."""
    partial = Path(tempfile.mkdtemp(dir=folder.parent, prefix=".part-"))
    try:
        partial.chmod(0o755)
        for name, library in libraries.items():
            os.link(library, partial / f"{name}{SUFFIX}")
        # Another process may have been first.
        with suppress(OSError):
            partial.rename(folder)
    finally:
        shutil.rmtree(partial, ignore_errors=True)
    return folder


def _forget_old(root: Path) -> None:
    folders = sorted(
        (folder for folder in root.iterdir() if folder.name != "objects"), key=lambda each: each.stat().st_mtime_ns
    )
    for folder in folders[:-KEPT]:
        shutil.rmtree(folder, ignore_errors=True)
    for library in (root / "objects").iterdir():
        # A library that no folder has any more.
        with suppress(OSError):
            if library.stat().st_nlink == 1:
                library.unlink()


def _compile(work: Sequence[tuple[str, Path]]) -> None:
    """Compile modules to these libraries, in as many processes as there are cores."""
    command = _c_compiler()
    workers = min(len(work), os.cpu_count() or 1)
    # The longest first, dealt in turn.
    ordered = sorted(work, key=lambda each: -source_of(each[0]).stat().st_size)
    shares = [ordered[worker::workers] for worker in range(workers)]
    processes = [
        python(
            "bench.compiled.build",
            "\n".join(command),
            *(f"{name}={library}" for name, library in share),
            stdout=subprocess.DEVNULL,
            stderr=subprocess.PIPE,
            settings={INTERPRETED: "1"},
            # The name of a source in tracebacks is that from here.
            cwd=ROOT,
        )
        for share in shares
    ]
    told = [process.communicate()[1].decode(errors="replace").strip() for process in processes]
    for process, text in zip(processes, told, strict=True):
        if process.returncode:
            raise BadInput(f"a module cannot be compiled:\n{text}")


def _c_compiler() -> list[str]:
    """Return the beginning of the command that compiles a C file to a library.

    Raises:
        BadInput: there is no C compiler, or no header file of Python.
    """
    try:
        compiler = compilers(["native"])[0]
    except FmuError as error:
        raise BadInput(str(error)) from error
    include = Path(sysconfig.get_paths()["include"])
    if not (include / "Python.h").is_file():
        version = f"{sys.version_info.major}.{sys.version_info.minor}"
        raise BadInput(
            f"{include / 'Python.h'} is missing: the bench's hot modules are compiled; on Debian: "
            f"apt install python3-dev (or python{version}-dev)"
        )
    return [compiler.command[0], *FLAGS, f"-I{include}"]


def main() -> None:
    """Without arguments compile all that is not current; a worker has the C compiler's command and its share."""
    if len(sys.argv) == 1:
        compile_modules(lambda text: print(text, flush=True))  # noqa: T201 - for make
        return
    command = sys.argv[1].split("\n")
    try:
        for share in sys.argv[2:]:
            name, _, library = share.partition("=")
            _translate_and_compile(name, Path(library), command)
    except _NotCompiled as error:
        sys.exit(str(error))


class _NotCompiled(Exception):
    """Cython or the C compiler has refused a file."""


def _translate_and_compile(module: str, library: Path, command: Sequence[str]) -> None:
    from Cython.Compiler import Main

    with tempfile.TemporaryDirectory(dir=library.parent, prefix=".part-") as folder:
        c_file = Path(folder, "module.c")
        translate: Any = Main.compile
        result = translate(
            str(source_of(module)),
            output_file=str(c_file),
            include_path=[str(ROOT)],
            full_module_name=module,
            language_level=3,
        )
        if result.num_errors:
            raise _NotCompiled(f"{source_of(module)}: Cython cannot translate it")
        built = Path(folder, library.name)
        compile_ = [*command, *_loop_flags(module), str(c_file), "-o", str(built)]
        done = subprocess.run(compile_, capture_output=True, text=True, check=False)
        if done.returncode:
            raise _NotCompiled(f"{source_of(module)}: {done.stderr.strip()}")
        built.replace(library)


if __name__ == "__main__":
    main()
