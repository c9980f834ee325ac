"""What numba has compiled of older sources is thrown away before anything loads it.

numba compiles a function anew where its own file has changed, but not where a function that it calls has (a limit that
its documentation states), and it cannot read compiled code that names a class which is gone.
"""

from contextlib import suppress
from pathlib import Path


def drop_stale(folder: Path) -> None:
    """Remove the compiled code beside the sources in `folder` that is older than the newest of them."""
    newest = max((source.stat().st_mtime_ns for source in folder.glob("*.py")), default=0)
    for compiled in folder.glob("__pycache__/*.nb[ic]"):
        # Another process may have removed it, or it belongs to somebody else.
        with suppress(OSError):
            if compiled.stat().st_mtime_ns < newest:
                compiled.unlink()
