"""Finds the machine code of the hot modules, and loads it in place of their sources.

Each state of the sources has a folder of its own, named by their hash, and it has all modules or does not exist: code
of other sources is never loaded, and compiled modules, which call each other directly, always fit together.
"""

import hashlib
import os
import sys
from collections.abc import Mapping, Sequence
from functools import cache
from importlib.machinery import EXTENSION_SUFFIXES, ExtensionFileLoader, ModuleSpec
from importlib.util import spec_from_file_location
from pathlib import Path
from types import ModuleType

from bench.compiled.modules import COMPILED

INTERPRETED = "PLATOON_INTERPRETED"
"""Environment variable; if it is not empty, all modules are interpreted."""

SUFFIX = EXTENSION_SUFFIXES[0]
"""End of a library's file name: it names the version of Python for which it was compiled."""

ROOT = Path(__file__).resolve().parents[2]
"""The folder of the packages."""

_PROJECT_FILE = "pyproject.toml"


def source_of(module: str) -> Path:
    """Return the file of a module's source."""
    return ROOT / (module.replace(".", "/") + ".py")


def declarations() -> list[Path]:
    """Return the files with the declarations that compiled modules share (`.pxd`)."""
    return [file for file in (source_of(name).with_suffix(".pxd") for name in COMPILED) if file.is_file()]


def in_checkout() -> bool:
    """Return whether the packages are those of a checkout, not installed ones."""
    return (ROOT / _PROJECT_FILE).is_file()


def library_folder() -> Path:
    """Return where libraries are kept: build/ of a checkout, or the user's cache for an installed package."""
    if in_checkout():
        return ROOT / "build" / "compiled"
    # Imported here because a checkout, and with it the tests, need not wait for it.
    import platformdirs

    return platformdirs.user_cache_path("platoon", appauthor=False) / "compiled"


def sources_hash() -> str:
    """Return a hash of the sources of all hot modules and of the version of Python."""
    hashed = hashlib.sha256(SUFFIX.encode())
    for file in (*map(source_of, COMPILED), *declarations()):
        content = file.read_bytes()
        hashed.update(f"\0{file.name}\0{len(content)}\0".encode())
        hashed.update(content)
    return hashed.hexdigest()[:24]


@cache
def current_libraries() -> Path | None:
    """Return the folder with the libraries of the present sources; None if they have not been compiled."""
    folder = library_folder() / sources_hash()
    return folder if folder.is_dir() else None


def is_compiled() -> bool:
    """Return whether this process runs the machine code."""
    return any(isinstance(finder, _Finder) for finder in sys.meta_path)


def is_wanted() -> bool:
    """Return whether the machine code is to be used if there is any."""
    return not os.environ.get(INTERPRETED)


def install() -> None:
    """Load the hot modules' machine code from now on, if it is there and wanted; idempotent."""
    if is_compiled() or not is_wanted():
        return
    folder = current_libraries()
    if folder is not None:
        sys.meta_path.insert(0, _Finder({name: folder / f"{name}{SUFFIX}" for name in COMPILED}))


class _Finder:
    """Finds the libraries of compiled modules by name."""

    def __init__(self, libraries: Mapping[str, Path]) -> None:
        self._libraries = libraries

    def find_spec(
        self,
        fullname: str,
        path: Sequence[str] | None = None,  # noqa: ARG002 - of the protocol
        target: ModuleType | None = None,  # noqa: ARG002 - of the protocol
    ) -> ModuleSpec | None:
        """See `importlib.abc.MetaPathFinder`."""
        library = self._libraries.get(fullname)
        if library is None:
            return None
        return spec_from_file_location(fullname, library, loader=_Loader(fullname, str(library)))


class _Loader(ExtensionFileLoader):
    """Loads a library whose module's `__file__` is its source, as if it were interpreted."""

    def exec_module(self, module: ModuleType) -> None:
        """See `importlib.abc.Loader`."""
        module.__file__ = str(source_of(module.__name__))
        super().exec_module(module)

    def get_source(self, fullname: str) -> str:  # type: ignore[override]
        """Return the source, for tracebacks and `inspect`."""
        return source_of(fullname).read_text(encoding="utf-8")
