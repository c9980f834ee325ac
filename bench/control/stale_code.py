"""Deletes code that numba compiled from older sources, before it is loaded.

numba recompiles a function if its own file has changed, but not if a function that it calls has (a documented limit),
and it cannot load compiled code that refers to a deleted class.
"""

from contextlib import suppress
from pathlib import Path


def drop_stale(folder: Path) -> None:
    """Delete compiled code of the sources in `folder` that is older than the newest source."""
    newest = max((source.stat().st_mtime_ns for source in folder.glob("*.py")), default=0)
    for compiled in folder.glob("__pycache__/*.nb[ic]"):
        # Another process may have deleted it, or another user owns it.
        with suppress(OSError):
            if compiled.stat().st_mtime_ns < newest:
                compiled.unlink()
