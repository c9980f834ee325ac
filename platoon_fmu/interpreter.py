"""Starts the Python processes of bench and FMU checks: the only place that does (ruff's TID251 refuses any other).

They import what this process can import, except from the working directory: a user's `select.py` there is no part of
the program. Python alone would take it from there with `-m` or `-c`, and for an empty entry in PYTHONPATH.
"""

from __future__ import annotations

import os
import subprocess
import sys
from collections.abc import Mapping
from pathlib import Path
from typing import Any, NoReturn

_PACKAGE = "platoon_fmu"
_ROOT = str(Path(__file__).resolve().parents[1])


def python(
    module: str, *arguments: str, settings: Mapping[str, str] | None = None, **options: Any
) -> subprocess.Popen[bytes]:
    """Start `main()` of a module in a new process.

    Args:
        module: the module; it is imported under its name, not as `__main__`.
        arguments: `sys.argv[1:]` of the process.
        settings: environment variables besides this process's own.
        options: further ones of `subprocess.Popen`.

    Raises:
        OSError: the system does not permit another process.
    """
    command = [*interpreter(), "-c", f"from {module} import main; main()", *arguments]
    environment = os.environ | dict(settings or {}) | {"PYTHONPATH": os.pathsep.join(search_path())}
    return subprocess.Popen(command, env=environment, **options)


def restart() -> NoReturn:
    """Start this program again, in this process and with the same command line."""
    sys.stdout.flush()
    sys.stderr.flush()
    os.execv(sys.executable, [sys.executable, *sys.orig_argv[1:]])  # noqa: TID251 - the one place


def interpreter() -> list[str]:
    """The beginning of a command line that runs Python without the working directory on its search path."""
    return [sys.executable, "-P"]  # noqa: TID251 - the one place


def search_path() -> list[str]:
    """`sys.path` without the working directory, unless PYTHONPATH names it; always with the folder of our packages."""
    here = _real("")
    named = {_real(entry) for entry in os.environ.get("PYTHONPATH", "").split(os.pathsep) if entry}
    entries = [entry for entry in sys.path if entry and (_real(entry) != here or here in named)]
    if _ROOT not in map(_real, entries):
        # Behind the standard library, but before another copy of our packages.
        copies = (place for place, entry in enumerate(entries) if Path(entry, _PACKAGE).is_dir())
        entries.insert(next(copies, len(entries)), _ROOT)
    return entries


def _real(entry: str) -> str:
    try:
        return os.path.realpath(entry or os.curdir)
    except FileNotFoundError:
        # The working directory has been deleted.
        return ""
